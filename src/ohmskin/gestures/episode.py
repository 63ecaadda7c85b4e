"""One episode of touch, from the first contact until all are lifted, and the features that classify gestures."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import dist, log, log1p
from typing import Protocol

import numpy as np

from ohmskin.arrays import Floats, changed

FEATURES = ("duration", "travel", "speed", "most", "mean count", "spread", "plateau", "rise", "ended")
_FAR, _SMOOTH = 5e-3, 0.06  # m of travel, and s over which places are averaged, as they are noisy
_LEAST = 1e-3  # s
Place = tuple[float, ...]


class ContactLike(Protocol):
    """What counts of a contact: where it is (m) and how strong (m2)."""

    @property
    def position(self) -> tuple[float, ...]: ...

    @property
    def strength(self) -> float: ...


@dataclass(frozen=True, eq=False)
class Episode:
    """Sums over an episode, whose cost in time and memory does not depend on its length.

    Args:
        began, last: Time of its first frame and of its newest one with a contact (s).
        frames: Frames with contacts.
        counts: Sum of their contacts.
        most: Largest number of contacts at once.
        spread: Largest distance between two contacts of a frame (m).
        start, place: First and present middle of the contacts, smoothed (m).
        travel: Largest distance of the middle from the start (m).
        strengths, peak: Sum over frames, and largest, of the strength of all contacts together (m2).
        peaked: First time at which the strength was 90 % of its maximum until then (s).
        ended: Whether all contacts are lifted.
    """

    began: float
    last: float
    frames: int = 0
    counts: int = 0
    most: int = 0
    spread: float = 0.0
    start: Place = ()
    place: Place = field(default=(), repr=False)
    travel: float = 0.0
    strengths: float = 0.0
    peak: float = 0.0
    peaked: float = 0.0
    ended: bool = False

    def after(self, time: float, contacts: Sequence[ContactLike]) -> "Episode":
        """The episode after one more frame, at a `time` (s), with `contacts`, at least one."""
        places = [contact.position for contact in contacts]
        middle = tuple(sum(axis) / len(places) for axis in zip(*places, strict=True))
        early = time - self.began < _SMOOTH or not self.place
        share = 1 / (self.frames + 1) if early else min((time - self.last) / _SMOOTH, 1.0)
        place = (
            middle if not self.place else tuple(p + share * (m - p) for p, m in zip(self.place, middle, strict=True))
        )
        start = place if early or len(places) > self.most else self.start  # a finger more moves the middle
        strength = sum(abs(contact.strength) for contact in contacts)
        spread = max((dist(a, b) for k, a in enumerate(places) for b in places[:k]), default=0.0)
        return changed(
            self,
            last=time,
            frames=self.frames + 1,
            counts=self.counts + len(places),
            most=max(self.most, len(places)),
            spread=max(self.spread, spread),
            start=start,
            place=place,
            travel=max(self.travel, dist(start, place)) if len(places) >= self.most else self.travel,
            strengths=self.strengths + strength,
            peak=max(self.peak, strength),
            peaked=time if strength > 1.1 * self.peak else self.peaked,
        )

    @property
    def duration(self) -> float:
        """How long it has lasted (s)."""
        return self.last - self.began

    @property
    def features(self) -> Floats:
        """(n_features,) `FEATURES`, without units, whatever the size of the skin or the rate of frames."""
        lasted = max(self.duration, _LEAST)
        return np.array(
            [
                log(lasted + 0.02),
                log1p(self.travel / _FAR),
                log1p(self.travel / _FAR / (lasted + 0.1)),
                min(self.most, 4),
                min(self.counts / max(self.frames, 1), 4.0),
                log1p(self.spread / _FAR),
                self.strengths / max(self.frames * self.peak, 1e-300),
                min(max(self.peaked - self.began, 0.0) / lasted, 1.0),
                float(self.ended),
            ]
        )
