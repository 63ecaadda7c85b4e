"""New contacts: how many frames pass until they are found, and how many are invented on a quiet skin."""

from dataclasses import dataclass

import numpy as np

from ohmskin.evaluate.policies.follow import Follower
from ohmskin.evaluate.policies.lab import lab
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.worlds import Contacts, contact
from ohmskin.geometry.domain import Floats

NEAR = 20e-3  # metres; a contact reported so close to a new one is that one
_MARGIN = 10e-3  # metres from a contact to the rim
APART = 50e-3  # metres between contacts
_WARM = 25  # frames in which those already there are found and followed, or nothing happens
_PATIENCE = 20  # frames in which a new one may be found


@dataclass(frozen=True)
class Detection:
    """A new contact appears while none, one or several others are followed; all rest.

    Args:
        world: One of `worlds.WORLDS`.
        decibels: Noise level (dB).
        trials: Each with places and noise of its own.
        others: Contacts already there.
        injections: Per frame.
    """

    world: str
    decibels: float
    trials: int
    others: int
    injections: int = 4

    def run(self) -> Result:
        """Results: ``frames`` (n_trials,), the frame in which the new contact is first reported within `NEAR` of where it is, 1
        being the first in which it is there; infinite if it is not found in 20. ``error`` (n_trials,), how far it then is
        from the truth (m). ``ready`` (n_trials,), whether all others were reported just before; ``ghosts`` (n_trials,),
        most contacts reported beyond those there.
        """
        room = lab(self.world, self.decibels)
        frames, error = np.full(self.trials, np.inf), np.full(self.trials, np.nan)
        ready, ghosts = np.zeros(self.trials, bool), np.zeros(self.trials, int)
        for trial in range(self.trials):
            places = apart(np.random.default_rng([trial, self.others, 5]), self.others + 1)
            contacts: Contacts = tuple(contact(self.world, *place) for place in places)
            tracker = Follower(room, self.injections)
            tracker.turn = trial  # the round of exploring injections may be anywhere when the contact comes
            for k in range(_WARM):
                known = tracker.step(room.scan(contacts[:-1], trial, k))
                if k >= _WARM // 2:
                    ghosts[trial] = max(ghosts[trial], len(known) - self.others)
            ready[trial] = all(near([c.position for c in known], place) < NEAR for place in places[:-1])
            for k in range(_PATIENCE):
                found = tracker.step(room.scan(contacts, trial, _WARM + k))
                away = near([c.position for c in found], places[-1])
                if away < NEAR:
                    frames[trial], error[trial] = k + 1, away
                    break
        return {"frames": frames, "error": error, "ready": ready, "ghosts": ghosts}


@dataclass(frozen=True)
class Quiet:
    """A skin that nothing touches.

    Args:
        world: One of `worlds.WORLDS`.
        decibels: Noise level (dB).
        frames: How many.
        injections: Per frame.
        seed: Of the noise.
    """

    world: str
    decibels: float
    frames: int
    injections: int = 4
    seed: int = 0

    def run(self) -> Result:
        """Results: ``births`` (), contacts reported, each once; ``frames`` (), in which any was reported."""
        room = lab(self.world, self.decibels)
        tracker, known, busy = Follower(room, self.injections), set(), 0
        for k in range(self.frames):
            found = tracker.step(room.scan((), 9, self.seed, k))
            known |= {c.id for c in found}
            busy += bool(found)
        return {"births": np.array(len(known)), "frames": np.array(busy)}


def apart(random: np.random.Generator, count: int) -> Floats:
    """Random places (count, 2) on the sheet, none close to another or to the rim (m)."""
    while True:
        places = random.uniform(_MARGIN, 0.2 - _MARGIN, (count, 2))
        gaps = np.linalg.norm(places[:, None] - places, axis=2) + np.diag(np.full(count, np.inf))
        if gaps.min() > APART:
            return places


def near(found: list[tuple[float, float]], place: Floats) -> float:
    """Distance from a place to the closest of those found (m); infinite if there is none."""
    return float(np.linalg.norm(np.array(found) - place, axis=1).min()) if found else np.inf
