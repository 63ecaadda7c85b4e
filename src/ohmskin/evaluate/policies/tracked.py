"""Few injections per frame and a memory: contacts that move or appear, none at all, and what choosing costs."""

import time
from dataclasses import dataclass
from itertools import product, repeat

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.flaws import SOUND, Flaw
from ohmskin.evaluate.policies.schemes import scheme
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.setup import PERIOD, setup
from ohmskin.evaluate.worlds import contact
from ohmskin.scan import DrivePattern, Frame
from ohmskin.sensing import Scan

FASTEST = 3e-3  # metres per frame
_RIM = 15e-3  # metres between a path and the rim
_SWING = 40  # frames from rest to the highest speed and back
_TURN = 0.15  # radians per frame by which a path may well turn
MISS = 30e-3  # metres; a contact placed further away counts as missed
SETTLE = 10  # frames of a moving contact that do not count: it is found in them
NEAR = 12e-3  # metres; a contact reported so close to a new one is that one
_MARGIN = 10e-3  # metres from a contact to the rim
APART = 25e-3  # metres between contacts
_BEFORE = 25  # frames in which those already there are found and tracked, or nothing happens
_PATIENCE = 20  # frames in which a new one may be found


@dataclass(frozen=True)
class Moving:
    """One contact on a winding path, with a speed that varies between 0 and `FASTEST`; each seed has its own path.

    Within a frame the contact is at rest.

    Args:
        world, decibels, readers, flaw, first: As for `Static`.
        seeds: Paths, each with noise of its own.
        frames: Length of a path.
        schemes: Drives for estimates frame by frame; keys, see `schemes.scheme`.
        trackers: Drives for the reader that tracks contacts from frame to frame; keys likewise.
    """

    world: str
    decibels: float
    seeds: int
    frames: int
    schemes: tuple[str, ...] = ("16I", "16P/16")
    readers: tuple[str, ...] = ("centroid", "fit")
    trackers: tuple[str, ...] = ("16T/2", "16T/4", "16T/8", "rotating/4", "rotating best/4")
    flaw: Flaw = SOUND
    first: int = 0

    def run(self) -> Result:
        """Results: ``truth`` (n_seeds, n_frames, 2); ``framewise`` (n_schemes, n_readers, n_seeds, n_frames, 2) and
        ``tracked`` (n_trackers, n_seeds, n_frames, 2), where the strongest contact is reported, NaN where none is;
        ``std`` (n_trackers, n_seeds, n_frames), the root of the variance of x and y that the tracker states;
        ``count`` (same), contacts reported. All in metres.
        """
        where = setup(self.world, self.decibels, flaw=self.flaw)
        shape = (self.seeds, self.frames)
        truth = np.stack([path(self.first + seed, self.frames) for seed in range(self.seeds)])
        framewise = np.full((len(self.schemes), len(self.readers), *shape, 2), np.nan)
        tracked = np.full((len(self.trackers), *shape, 2), np.nan)
        std, count = np.full((len(self.trackers), *shape), np.nan), np.zeros((len(self.trackers), *shape), int)
        for seed in range(self.seeds):
            frames = [(contact(self.world, *place),) for place in truth[seed]]
            for (s, key), (e, reader) in product(enumerate(self.schemes), enumerate(self.readers)):
                mode = scheme(key, reader)
                seen = (where.simulate(mode, there, self.first + seed, k) for k, there in enumerate(frames))
                framewise[s, e, seed] = [view.strongest for view in seen]
            for t, key in enumerate(self.trackers):
                for k, percept in enumerate(where.follow(scheme(key, "tracked, driven"), frames, self.first + seed)):
                    count[t, seed, k] = len(percept.contacts)
                    if percept.contacts:
                        strongest = max(percept.contacts, key=lambda c: c.strength)
                        tracked[t, seed, k] = strongest.position
                        std[t, seed, k] = np.sqrt(np.trace(np.asarray(strongest.covariance, float)))
        return {"truth": truth, "framewise": framewise, "tracked": tracked, "std": std, "count": count}


def moving_errors(result: Result) -> tuple[Floats, Floats]:
    """Mean errors in a `result` over a path but its start (m): by frames (n_schemes, n_readers, n_seeds), and tracked
    (n_trackers, n_seeds)."""
    framewise, tracked = (errors(result, name)[..., SETTLE:].mean(axis=-1) for name in ("framewise", "tracked"))
    return framewise, tracked


def path(seed: int, frames: int) -> Floats:
    """A winding path (frames, 2) in metres that turns back `_RIM` before the rim."""
    random = np.random.default_rng([seed, 3])
    at, heading, phase = random.uniform(0.05, 0.15, 2), random.uniform(0, 2 * np.pi), random.uniform(0, 2 * np.pi)
    places = np.empty((frames, 2))
    for k in range(frames):
        places[k] = at
        speed = FASTEST * (1 - np.cos(2 * np.pi * k / _SWING + phase)) / 2
        heading += _TURN * random.standard_normal()
        step = speed * np.array([np.cos(heading), np.sin(heading)])
        away = (at + step < _RIM) | (at + step > 0.2 - _RIM)
        step = np.where(away, -step, step)
        heading = float(np.arctan2(step[1], step[0])) if away.any() else heading
        at = at + step
    return places


@dataclass(frozen=True)
class Detection:
    """A new contact appears while none, one or several others are tracked; no contact moves.

    Args:
        world, decibels: As for `Static`.
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
        it is, 1 being the first in which it is there; infinite if it is not found in 20. ``error`` (n_trials,), its
        position error then (m). ``ready`` (n_trials,), whether all others were reported just before; ``ghosts``
        (n_trials,), largest number of false contacts.
        """
        where = setup(self.world, self.decibels)
        frames, error = np.full(self.trials, np.inf), np.full(self.trials, np.nan)
        ready, ghosts = np.zeros(self.trials, bool), np.zeros(self.trials, int)
        for trial in range(self.trials):
            places = apart(np.random.default_rng([trial, self.others, 5]), self.others + 1)
            contacts = tuple(contact(self.world, *place) for place in places)
            there = [contacts[:-1]] * _BEFORE + [contacts] * _PATIENCE
            # the round of exploring injections may be anywhere when the contact comes
            seen = where.follow(scheme(f"16T/{self.injections}", "tracked, driven"), there, trial, turn=trial)
            for k, percept in enumerate(seen):
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
        world, decibels: As for `Detection`.
        frames: How many.
        mode, reading: What is driven, and the reader, see `schemes.scheme`.
        seed: Of the noise.
    """

    world: str
    decibels: float
    frames: int
    mode: str = "16T/4"
    reading: str = "tracked, driven"
    seed: int = 0

    def run(self) -> Result:
        """Results: ``births`` (), contacts reported; ``frames`` (), frames that showed one when read alone."""
        where = setup(self.world, self.decibels)
        mode, known, busy = scheme(self.mode, self.reading), set[int](), 0
        for percept in where.follow(mode, repeat((), self.frames), 9, self.seed):
            known |= {c.id for c in percept.contacts}
            busy += bool(percept.detections)
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


@dataclass(frozen=True)
class FrameCost:
    """Processor time of the tracker's frame, with several contacts that rest. Another run, or machine, has other
    figures.

    Args:
        decibels: Noise level (dB).
        injections: Per frame.
        contacts: Most contacts.
        frames: Timed frames of each number of contacts.
    """

    decibels: float
    injections: int = 4
    contacts: int = 2
    frames: int = 300

    def run(self) -> Result:
        """Results: ``choose`` and ``update`` (n_contacts + 1, n_frames) in seconds, with 0, 1, ... contacts."""
        where = setup("discs", self.decibels)
        sensor = where.sensor(scheme(f"16T/{self.injections}", "tracked, driven"))
        places = ((0.06, 0.07), (0.14, 0.13), (0.06, 0.15), (0.15, 0.05))
        choose, update = np.empty((2, self.contacts + 1, self.frames))
        for n in range(self.contacts + 1):
            contacts = tuple(contact("discs", *place) for place in places[:n])
            state = sensor.start()
            for k in range(-30, self.frames):  # the first ones find the contacts, and compile
                asked: list[int] = []
                scan = _noting(where.scan(contacts, 4, k + 30, time=PERIOD * (k + 30)), asked)
                started = time.process_time_ns()
                state, _ = sensor.step(state, scan)
                if k >= 0:
                    choose[n, k] = 1e-9 * (asked[0] - started)
                    update[n, k] = 1e-9 * (time.process_time_ns() - asked[1])
        return {"choose": choose, "update": update}


def _noting(scan: Scan, times: list[int]) -> Scan:
    """A scan that notes the processor time (ns) before and after it."""

    def measure(pattern: DrivePattern) -> Frame:
        times.append(time.process_time_ns())
        frame = scan(pattern)
        times.append(time.process_time_ns())
        return frame

    return measure
