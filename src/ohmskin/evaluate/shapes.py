"""What touches the skin: flat shapes that know how far a point is from them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import OhmskinError

SHAPES = ("disc", "square", "ring", "cross", "L")
_BAR = 1 / 3  # width of the bars of a cross or an L, as a share of the side of its bounding square
_HOLE = 1 / 2  # radius of the hole of a ring, as a share of its own


@dataclass(frozen=True)
class Shape:
    """A contact of one of the `SHAPES`. Hashable, so that its effects can be cached.

    Args:
        kind: One of `SHAPES`.
        position: Centre of its bounding square (x, y) in metres.
        radius: Half the side of its bounding square (m); the radius of a disc.
        strength: Pressure (Pa) on a pressed skin, relative change of conductivity on a sheet of discs.
        angle: Rotation about its centre, counterclockwise (rad).

    Raises:
        OhmskinError: If the kind is unknown or a value is out of range.
    """

    kind: str
    position: tuple[float, float]
    radius: float
    strength: float
    angle: float = field(default=0.0, repr=False)

    def __post_init__(self) -> None:
        if self.kind not in SHAPES:
            raise OhmskinError(f"no contact shape {self.kind!r}; choose from {', '.join(SHAPES)}")
        if not (np.isfinite([*self.position, self.angle]).all() and 0 < self.radius < 10 and 0 <= self.strength < 1e9):
            raise OhmskinError(f"{self} has a position, radius, strength or angle that is out of range")

    @property
    def area(self) -> float:
        """Area of the shape (m2)."""
        bars = 4 * (2 * _BAR - _BAR**2)
        shares = {"disc": np.pi, "square": 4.0, "ring": np.pi * (1 - _HOLE**2), "cross": bars, "L": bars}
        return shares[self.kind] * self.radius**2

    def distance(self, points: ArrayLike) -> Floats:
        """Distance of points (n, 2) from the shape (m); zero or negative inside. Exact outside, except near corners."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        u, v = ((np.asarray(points, float) - self.position) @ np.array([[cos, -sin], [sin, cos]])).T
        r, half = self.radius, _BAR * self.radius
        if self.kind == "disc":
            away: Floats = np.hypot(u, v) - r
        elif self.kind == "square":
            away = _box(u, v, -r, r, -r, r)
        elif self.kind == "ring":
            away = np.maximum(np.hypot(u, v) - r, _HOLE * r - np.hypot(u, v))
        elif self.kind == "cross":
            away = np.minimum(_box(u, v, -r, r, -half, half), _box(u, v, -half, half, -r, r))
        else:
            away = np.minimum(_box(u, v, -r, -r + 2 * half, -r, r), _box(u, v, -r, r, -r, -r + 2 * half))
        return away


def _box(u: Floats, v: Floats, left: float, right: float, low: float, high: float) -> Floats:
    x, y = np.maximum(left - u, u - right), np.maximum(low - v, v - high)
    away: Floats = np.hypot(np.maximum(x, 0), np.maximum(y, 0)) + np.minimum(np.maximum(x, y), 0)
    return away


def disc(x: float, y: float, radius: float, strength: float) -> Shape:
    """A round contact.

    Args:
        x, y: Its centre (m).
        radius: Its radius (m).
        strength: Relative change of conductivity, or pressure (Pa).

    Raises:
        OhmskinError: If a value is out of range.
    """
    return Shape("disc", (float(x), float(y)), float(radius), float(strength))
