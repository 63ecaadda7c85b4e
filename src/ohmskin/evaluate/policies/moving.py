"""Contacts that move: few injections per frame and a memory, against whole scans without one."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.evaluate.flaws import SOUND, Flaw
from ohmskin.evaluate.policies.schemes import scheme
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.setup import PERIOD, setup
from ohmskin.evaluate.worlds import contact

FASTEST = 3e-3  # metres per frame
_MARGIN = 15e-3  # metres between a path and the rim
_SWING = 40  # frames from rest to the highest speed and back
_TURN = 0.15  # radians per frame by which a path may well turn


@dataclass(frozen=True)
class Moving:
    """One contact on a winding path, its speed going up and down between 0 and `FASTEST`; each seed has a path of its
    own.

    Within a frame the contact is at rest.

    Args:
        world: One of `worlds.WORLDS`.
        decibels: Noise level (dB).
        seeds: Paths, each with noise of its own.
        frames: Length of a path.
        schemes: What is driven frame by frame; keys, see `schemes.scheme`.
        readers: Of `ohmskin.sensing.READERS`, for these.
        trackers: What is driven for the reader that tracks contacts from frame to frame; keys likewise.
        flaw: What is wrong with the model or the skin.
        first: Number of the first seed.
    """

    world: str
    decibels: float
    seeds: int
    frames: int
    schemes: tuple[str, ...] = ("16I", "16P/16")
    readers: tuple[str, ...] = ("centroid", "fit")
    trackers: tuple[str, ...] = ("16T/2", "16T/4", "16T/8", "rotating/4")
    flaw: Flaw = SOUND
    first: int = 0

    def run(self) -> Result:
        """Results: ``truth`` (n_seeds, n_frames, 2); ``framewise`` (n_schemes, n_readers, n_seeds, n_frames, 2) and
        ``tracked`` (n_trackers, n_seeds, n_frames, 2), where the strongest contact is reported, NaN where none is;
        ``std`` (n_trackers, n_seeds, n_frames), the root of the variance of x and y that the tracker claims;
        ``count`` (same), contacts reported. All in metres.
        """
        where = setup(self.world, self.decibels, flaw=self.flaw)
        shape = (self.seeds, self.frames)
        truth = np.stack([path(self.first + seed, self.frames) for seed in range(self.seeds)])
        framewise = np.full((len(self.schemes), len(self.readers), *shape, 2), np.nan)
        tracked = np.full((len(self.trackers), *shape, 2), np.nan)
        std, count = np.full((len(self.trackers), *shape), np.nan), np.zeros((len(self.trackers), *shape), int)
        for seed in range(self.seeds):
            tracking = [where.sensor(scheme(key, "tracked")) for key in self.trackers]
            states = [sensor.start() for sensor in tracking]
            for k, place in enumerate(truth[seed]):
                contacts = (contact(self.world, *place),)
                for (s, key), (e, reader) in product(enumerate(self.schemes), enumerate(self.readers)):
                    framewise[s, e, seed, k] = where.see(scheme(key, reader), contacts, self.first + seed, k).strongest
                for t, sensor in enumerate(tracking):
                    scan = where.scan(contacts, self.first + seed, k, time=PERIOD * k)
                    states[t], percept = sensor.step(states[t], scan)
                    count[t, seed, k] = len(percept.contacts)
                    if percept.contacts:
                        strongest = max(percept.contacts, key=lambda c: c.strength)
                        tracked[t, seed, k] = strongest.position
                        std[t, seed, k] = np.sqrt(np.trace(np.asarray(strongest.covariance, float)))
        return {"truth": truth, "framewise": framewise, "tracked": tracked, "std": std, "count": count}


def path(seed: int, frames: int) -> Floats:
    """A winding path (frames, 2) in metres that turns back `_MARGIN` before the rim."""
    random = np.random.default_rng([seed, 3])
    at, heading, phase = random.uniform(0.05, 0.15, 2), random.uniform(0, 2 * np.pi), random.uniform(0, 2 * np.pi)
    places = np.empty((frames, 2))
    for k in range(frames):
        places[k] = at
        speed = FASTEST * (1 - np.cos(2 * np.pi * k / _SWING + phase)) / 2
        heading += _TURN * random.standard_normal()
        step = speed * np.array([np.cos(heading), np.sin(heading)])
        away = (at + step < _MARGIN) | (at + step > 0.2 - _MARGIN)
        step = np.where(away, -step, step)
        heading = float(np.arctan2(step[1], step[0])) if away.any() else heading
        at = at + step
    return places
