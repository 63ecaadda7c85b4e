"""New contacts: how many frames pass until they are found, and how many are invented on a quiet skin."""

from dataclasses import dataclass, replace

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.evaluate.policies.schemes import scheme
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.setup import PERIOD, setup
from ohmskin.evaluate.worlds import Contacts, contact

NEAR = 20e-3  # metres; a contact reported so close to a new one is that one
_MARGIN = 10e-3  # metres from a contact to the rim
APART = 50e-3  # metres between contacts
_BEFORE = 25  # frames in which those already there are found and tracked, or nothing happens
_PATIENCE = 20  # frames in which a new one may be found


@dataclass(frozen=True)
class Detection:
    """A new contact appears while none, one or several others are tracked; all rest.

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
        """Results: ``frames`` (n_trials,), the frame in which the new contact is first reported within `NEAR` of where
        it is, 1 being the first in which it is there; infinite if it is not found in 20. ``error`` (n_trials,), how
        far it then is from the truth (m). ``ready`` (n_trials,), whether all others were reported just before;
        ``ghosts`` (n_trials,), most contacts reported beyond those there.
        """
        where = setup(self.world, self.decibels)
        sensor = where.sensor(scheme(f"16T/{self.injections}", "tracked"))
        frames, error = np.full(self.trials, np.inf), np.full(self.trials, np.nan)
        ready, ghosts = np.zeros(self.trials, bool), np.zeros(self.trials, int)
        for trial in range(self.trials):
            places = apart(np.random.default_rng([trial, self.others, 5]), self.others + 1)
            contacts: Contacts = tuple(contact(self.world, *place) for place in places)
            # the round of exploring injections may be anywhere when the contact comes
            state = replace(sensor.start(), turn=trial)
            for k in range(_BEFORE + _PATIENCE):
                there = contacts[:-1] if k < _BEFORE else contacts
                state, percept = sensor.step(state, where.scan(there, trial, k, time=PERIOD * k))
                found = [c.position for c in percept.contacts]
                if _BEFORE // 2 <= k < _BEFORE:
                    ghosts[trial] = max(ghosts[trial], len(found) - self.others)
                if k == _BEFORE - 1:
                    ready[trial] = all(near(found, place) < NEAR for place in places[:-1])
                if k >= _BEFORE and (away := near(found, places[-1])) < NEAR:
                    frames[trial], error[trial] = k + 1 - _BEFORE, away
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
        where = setup(self.world, self.decibels)
        sensor, known, busy = where.sensor(scheme(f"16T/{self.injections}", "tracked")), set(), 0
        state = sensor.start()
        for k in range(self.frames):
            state, percept = sensor.step(state, where.scan((), 9, self.seed, k, time=PERIOD * k))
            known |= {c.id for c in percept.contacts}
            busy += bool(percept.contacts)
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
