"""The flat shapes a skin can have. A domain knows its inside and its rim; meshing and layout build on those two."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import GeometryError


class Domain(Protocol):
    """A flat shape, with an outer rim and perhaps holes."""

    @property
    def area(self) -> float:
        """Area (m2)."""

    @property
    def perimeter(self) -> float:
        """Length of the rim (m)."""

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) in metres."""

    @property
    def corners(self) -> Floats:
        """Arc lengths (n_corners,) of rim points that a mesh must keep (m)."""

    @property
    def holes(self) -> "tuple[Domain, ...]":
        """The holes in it."""

    @property
    def period(self) -> float:
        """Length along x after which a closed band meets itself (m); 0 of all others."""

    def depth(self, points: ArrayLike) -> Floats:
        """Distance (n,) of points (n, 2) from the rim, positive inside (m)."""

    def rim(self, arc: ArrayLike) -> Floats:
        """Points (n, 2) on the rim at arc lengths (n,), counterclockwise (m)."""

    def arc(self, points: ArrayLike) -> Floats:
        """Arc lengths (n,) of points (n, 2) that lie on the rim (m)."""

    def __hash__(self) -> int:
        """Equal shapes, or the same ones, are one key of a cache."""


def _positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise GeometryError(f"{name} is {value!r}; it must be a positive length in metres")


@dataclass(frozen=True)
class Rectangle:
    """A `Domain`: a rectangle with its lower left corner at the origin; the rim starts there, counterclockwise.

    Args:
        width: Extent along x (m).
        height: Extent along y (m).

    Raises:
        GeometryError: If one is not positive.
    """

    width: float
    height: float
    holes = ()
    period = 0.0

    def __post_init__(self) -> None:
        _positive("rectangle width", self.width)
        _positive("rectangle height", self.height)

    @property
    def area(self) -> float:
        return self.width * self.height

    @property
    def perimeter(self) -> float:
        return 2 * (self.width + self.height)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        return (0.0, 0.0, self.width, self.height)

    @property
    def corners(self) -> Floats:
        w, h = self.width, self.height
        return np.array([0.0, w, w + h, 2 * w + h])

    def depth(self, points: ArrayLike) -> Floats:
        x, y = np.asarray(points, float).T
        depth: Floats = np.minimum.reduce([x, self.width - x, y, self.height - y])
        return depth

    def rim(self, arc: ArrayLike) -> Floats:
        knots = np.append(self.corners, self.perimeter)
        s = np.mod(np.asarray(arc, float), self.perimeter)
        x = np.interp(s, knots, [0, self.width, self.width, 0, 0])
        y = np.interp(s, knots, [0, 0, self.height, self.height, 0])
        return np.column_stack([x, y])

    def arc(self, points: ArrayLike) -> Floats:
        x, y = np.asarray(points, float).T
        w, h = self.width, self.height
        distances = np.stack([y, w - x, h - y, x])
        arcs = np.stack([x, w + y, 2 * w + h - x, 2 * (w + h) - y])
        chosen: Floats = arcs[np.argmin(distances, axis=0), np.arange(len(x))]
        return np.mod(chosen, self.perimeter)


@dataclass(frozen=True)
class Disc:
    """A `Domain`: a disc about the origin; the rim starts on the positive x axis and runs counterclockwise.

    Args:
        radius: Radius (m).

    Raises:
        GeometryError: If it is not positive.
    """

    radius: float
    holes = ()
    period = 0.0

    def __post_init__(self) -> None:
        _positive("disc radius", self.radius)

    @property
    def area(self) -> float:
        return float(np.pi * self.radius**2)

    @property
    def perimeter(self) -> float:
        return float(2 * np.pi * self.radius)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        return (-self.radius, -self.radius, self.radius, self.radius)

    @property
    def corners(self) -> Floats:
        return np.empty(0)

    def depth(self, points: ArrayLike) -> Floats:
        depth: Floats = self.radius - np.linalg.norm(np.asarray(points, float), axis=-1)
        return depth

    def rim(self, arc: ArrayLike) -> Floats:
        angle = np.asarray(arc, float) / self.radius
        return self.radius * np.column_stack([np.cos(angle), np.sin(angle)])

    def arc(self, points: ArrayLike) -> Floats:
        x, y = np.asarray(points, float).T
        arc: Floats = np.mod(np.arctan2(y, x), 2 * np.pi) * self.radius
        return arc
