"""Simulated gestures: contacts as a skin reports them over time, with everything about them random.

Sizes of skins, rates of frames, speeds, forces, places, numbers of fingers, noise of place and strength, frames in
which a contact is missed, names that are lost: all are drawn anew for each gesture.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.contacts import Contact
from ohmskin.gestures.model import GESTURES

Stream = list[tuple[float, tuple[Contact, ...]]]
_CONFIRM = 3  # frames before a contact is reported
_QUIET = 0.4  # s after it, without contacts


@dataclass(frozen=True)
class SimulatedFinger:
    """One finger of a gesture.

    Args:
        began, lasted: When it begins to press, and for how long (s).
        path: (n, 2) places at even times (m).
        force: (n,) how hard it presses, against its usual (1).
    """

    began: float
    lasted: float
    path: Floats
    force: Floats

    def at(self, time: float) -> tuple[Floats, float] | None:
        """Place (2,) (m) and force (1) at a time (s); None while it does not press."""
        share = (time - self.began) / self.lasted
        if not 0 <= share < 1:
            return None
        along = np.linspace(0, 1, len(self.path))
        place = np.array([np.interp(share, along, axis) for axis in self.path.T])
        return place, float(np.interp(share, np.linspace(0, 1, len(self.force)), self.force))


def fingers(gesture: str, size: float, random: np.random.Generator) -> list[SimulatedFinger]:
    """What the fingers of a gesture do, on a square sheet of that side (m)."""
    margin = 0.1 * size
    at = random.uniform(margin, size - margin, 2)
    drift = 0.1 * random.normal(size=2) * 10e-3
    if gesture == "tap":
        lasted = random.uniform(0.05, 0.3)
        return [SimulatedFinger(0.0, lasted, at + np.outer([0, 1], drift), np.sin(np.linspace(0.3, np.pi - 0.3, 9)))]
    if gesture == "stroke":
        length = random.uniform(0.15, 0.7) * size
        length = max(length, 25e-3)
        speed = random.uniform(0.04, 0.4)
        turn, bend = random.uniform(0, 2 * np.pi), random.uniform(-1, 1)
        angles = turn + bend * np.linspace(-0.5, 0.5, 12)
        steps = np.column_stack([np.cos(angles), np.sin(angles)]) * length / 12
        path = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
        low, high = path.min(axis=0), path.max(axis=0)
        path += random.uniform(0.03 * size - low, np.maximum(0.97 * size - high, 0.03 * size - low + 1e-6))
        force = 1 + 0.25 * random.normal(size=6)
        return [SimulatedFinger(0.0, length / speed, path, np.clip(force, 0.4, 2.0))]
    ramp, hold = random.uniform(0.1, 1.0), random.uniform(0.5, 3.5)
    n = 40
    times = np.linspace(0, ramp + hold, n)
    rise = np.clip(times / ramp, 0.15, 1.0) * (1 + random.uniform(-0.2, 0.4) * times / times[-1])
    if gesture == "push":
        return [SimulatedFinger(0.0, ramp + hold, at + np.outer([0, 1], 2 * drift), rise)]
    count, apart = int(random.integers(2, 5)), random.uniform(28e-3, max(min(0.09, 0.4 * size), 30e-3))
    turns = random.uniform(0, 2 * np.pi) + np.arange(count) * 2 * np.pi / count + 0.3 * random.normal(size=count)
    radius = apart / (2 * np.sin(np.pi / count))
    at = np.clip(at, radius, size - radius)
    places = at + radius * np.column_stack([np.cos(turns), np.sin(turns)])
    strengths = random.uniform(0.6, 1.4, count)
    return [
        SimulatedFinger(random.uniform(0, 0.15), ramp + hold, place + np.outer([0, 1], drift), strength * rise)
        for place, strength in zip(np.clip(places, 0.02 * size, 0.98 * size), strengths, strict=True)
    ]


def as_seen(pressing: Sequence[SimulatedFinger], random: np.random.Generator) -> Stream:
    """The contacts that a skin reports of fingers, frame by frame, with noise."""
    period = 1 / np.exp(random.uniform(np.log(15), np.log(120)))
    noise, uneven = np.exp(random.uniform(np.log(0.3e-3), np.log(5e-3))), random.uniform(0.02, 0.25)
    missed, usual = random.uniform(0, 0.06), np.exp(random.uniform(np.log(1e-5), np.log(1e-3)))
    least, seen = random.uniform(0.05, 0.4), [0] * len(pressing)
    names = list(range(1, 1 + len(pressing)))
    frames: Stream = []
    for time in np.arange(0.0, max(one.began + one.lasted for one in pressing) + _QUIET, period):
        contacts = []
        for k, finger in enumerate(pressing):
            now = finger.at(float(time) - 0.01)
            if now is None or now[1] < least or random.uniform() < missed:
                seen[k] = 0 if now is None or now[1] < least else seen[k]
                continue
            seen[k] += 1
            if seen[k] >= _CONFIRM:
                if random.uniform() < 0.002:
                    names[k] = max(names) + 1
                x, y = (now[0] + noise * random.normal(size=2)).tolist()
                strength = usual * now[1] * max(1 + uneven * random.normal(), 0.1)
                contacts.append(Contact((x, y), 1e-4, strength, 1.0, 0.5, names[k]))
        frames.append((float(time), tuple(contacts)))
    return frames


def simulated(seed: int, count: int, size: tuple[float, float] = (0.1, 0.5)) -> Iterator[tuple[str, Stream]]:
    """So many gestures in turn, each with its contacts over time; sheets have sides of a range (m)."""
    random = np.random.default_rng(seed)
    for number in range(count):
        gesture = GESTURES[number % len(GESTURES)]
        yield gesture, as_seen(fingers(gesture, random.uniform(*size), random), random)
