"""A sheet that meets itself: a sleeve round an arm, unrolled."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.geometry.domain import Domain, Rectangle


@dataclass(frozen=True)
class _Closed:
    """What meets itself after its circumference."""

    circumference: float

    @property
    def corners(self) -> Floats:
        return np.empty(0)

    @property
    def perimeter(self) -> float:
        return self.circumference

    @property
    def period(self) -> float:
        return self.circumference

    def arc(self, points: ArrayLike) -> Floats:
        return np.asarray(np.mod(np.asarray(points, float)[..., 0], self.circumference))


@dataclass(frozen=True)
class Edge(_Closed):
    """One of the two rims of a `Band`; the upper one is what the band calls its hole.

    Args:
        circumference: Its length (m).
        y: Where it is (m).
    """

    y: float
    holes = ()
    area = 0.0

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        return (0.0, self.y, self.circumference, self.y)

    def depth(self, points: ArrayLike) -> Floats:
        return -np.abs(np.asarray(points, float)[..., 1] - self.y)

    def rim(self, arc: ArrayLike) -> Floats:
        s = np.mod(np.asarray(arc, float), self.circumference)
        return np.column_stack([s, np.full_like(s, self.y)])


@dataclass(frozen=True)
class Band(_Closed):
    """A `Domain`: a rectangle whose left and right sides are joined, x = 0 and x = `circumference` the same place.

    Its rim is the lower one, y = 0, from x = 0 on; the upper one counts as a hole.

    Args:
        circumference: Extent along x (m).
        height: Extent along y (m).

    Raises:
        GeometryError: If one is not positive.
    """

    height: float

    def __post_init__(self) -> None:
        Rectangle(self.circumference, self.height)  # checks them

    @property
    def area(self) -> float:
        return self.circumference * self.height

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        return (0.0, 0.0, self.circumference, self.height)

    @property
    def holes(self) -> tuple[Domain, ...]:
        return (Edge(self.circumference, self.height),)

    def depth(self, points: ArrayLike) -> Floats:
        y = np.asarray(points, float)[..., 1]
        return np.asarray(np.minimum(y, self.height - y))

    def rim(self, arc: ArrayLike) -> Floats:
        return Edge(self.circumference, 0.0).rim(arc)
