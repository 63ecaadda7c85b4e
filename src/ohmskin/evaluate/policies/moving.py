"""Contacts that move: few injections per frame and a memory, against whole scans without one."""

from dataclasses import dataclass

import numpy as np

from ohmskin.evaluate.policies.follow import Follower
from ohmskin.evaluate.policies.lab import SOUND, Flaw, lab
from ohmskin.evaluate.policies.schemes import ESTIMATORS, scheme
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.worlds import contact
from ohmskin.geometry.domain import Floats

FASTEST = 3e-3  # metres per frame
_MARGIN = 15e-3  # metres between a path and the rim
_SWING = 40  # frames from rest to the highest speed and back
_TURN = 0.15  # radians per frame by which a path may well turn


@dataclass(frozen=True)
class Moving:
    """One contact on a winding path, its speed going up and down between 0 and `FASTEST`; each seed has a path of its own.

    Within a frame the contact is at rest.

    Args:
        world: One of `worlds.WORLDS`.
        decibels: Noise level (dB).
        seeds: Paths, each with noise of its own.
        frames: Length of a path.
        schemes: What is driven frame by frame; keys of `schemes.SCHEMES`.
        estimators: Of `schemes.ESTIMATORS`, for these.
        followers: Injections per frame of trackers.
        flaw: What is wrong with the model or the skin.
        first: Number of the first seed.
    """

    world: str
    decibels: float
    seeds: int
    frames: int
    schemes: tuple[str, ...] = ("16I", "16P/16")
    estimators: tuple[str, ...] = ("centroid", "fit")
    followers: tuple[int, ...] = (2, 4, 8)
    flaw: Flaw = SOUND
    first: int = 0

    def run(self) -> Result:
        """Results: ``truth`` (n_seeds, n_frames, 2); ``framewise`` (n_schemes, n_estimators, n_seeds, n_frames, 2) and ``tracked``
        (n_followers, n_seeds, n_frames, 2), where the strongest contact is reported, NaN where none is; ``std`` (n_followers,
        n_seeds, n_frames), the root of the variance of x and y that the tracker claims; ``count`` (same), contacts reported.
        All in metres.
        """
        room = lab(self.world, self.decibels, self.flaw)
        shape = (self.seeds, self.frames)
        truth = np.stack([path(self.first + seed, self.frames) for seed in range(self.seeds)])
        framewise = np.full((len(self.schemes), len(self.estimators), *shape, 2), np.nan)
        tracked = np.full((len(self.followers), *shape, 2), np.nan)
        std, count = np.full((len(self.followers), *shape), np.nan), np.zeros((len(self.followers), *shape), int)
        for seed in range(self.seeds):
            trackers = [Follower(room, injections) for injections in self.followers]
            for k, place in enumerate(truth[seed]):
                contacts = (contact(self.world, *place),)
                for s, key in enumerate(self.schemes):
                    image, data = scheme(key).gather(room, room.scan(contacts, self.first + seed, k))
                    for e, name in enumerate(self.estimators):
                        framewise[s, e, seed, k] = ESTIMATORS[name](room, image, data)
                for t, tracker in enumerate(trackers):
                    found = tracker.step(room.scan(contacts, self.first + seed, k))
                    count[t, seed, k] = len(found)
                    if found:
                        strongest = max(found, key=lambda c: c.strength)
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
