"""Sheets cut to any shape, with holes."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import GeometryError


class ClosedLine:
    """A line through points in the plane or in space, the last of which is the first.

    Args:
        points: (n + 1, dim) in metres.

    Attributes:
        knots: (n + 1,) arc length of each point (m).
    """

    def __init__(self, points: Floats) -> None:
        self.points, self._steps = points, np.diff(points, axis=0)
        self.knots: Floats = np.concatenate([[0.0], np.cumsum(np.linalg.norm(self._steps, axis=1))])

    def closest(self, points: ArrayLike) -> tuple[Floats, Floats]:
        """Distances (n,) of points (n, dim) from the line, and the arc lengths (n,) at which it is closest (m)."""
        offset = np.asarray(points, float)[:, None] - self.points[:-1]
        share = np.clip(np.einsum("psd,sd->ps", offset, self._steps) / np.sum(self._steps**2, axis=1), 0.0, 1.0)
        squared = np.sum((offset - share[..., None] * self._steps) ** 2, axis=2)
        row, side = np.arange(len(offset)), squared.argmin(axis=1)
        return np.sqrt(squared[row, side]), self.knots[side] + share[row, side] * np.diff(self.knots)[side]


class Polygon:
    """A `Domain`: a polygon, perhaps with polygonal holes; the rim runs counterclockwise from the first corner given.

    Args:
        outline: Corners (n, 2) in metres, in order, the first not repeated. Turned round if they run clockwise.
        holes: Corners (n, 2) of each hole, likewise.

    Attributes:
        vertices: Corners (n, 2) of the outline, counterclockwise (m).
        holes: The holes, as polygons.

    Raises:
        GeometryError: If an outline has less than three corners or no area, repeats a corner or crosses itself, or a
            hole is not inside, crosses the outline or overlaps another hole.
    """

    period = 0.0

    def __init__(self, outline: ArrayLike, holes: Sequence[ArrayLike] = ()) -> None:
        vertices = np.array(outline, float)
        if vertices.ndim != 2 or vertices.shape[1] != 2 or len(vertices) < 3:
            raise GeometryError(f"polygon corners have shape {vertices.shape}; need (n, 2) with n >= 3")
        if not np.isfinite(vertices).all():
            raise GeometryError(f"polygon corner {int(np.argmin(np.isfinite(vertices).all(1)))} is not finite")
        extent = np.ptp(vertices, axis=0).max()
        steps = np.linalg.norm(np.roll(vertices, -1, axis=0) - vertices, axis=1)
        if steps.min() <= 1e-9 * extent:
            k = int(np.argmin(steps))
            raise GeometryError(f"polygon corners {k} and {(k + 1) % len(vertices)} are at the same place; remove one")
        if _signed_area(vertices) < 0:
            vertices = np.roll(vertices[::-1], 1, axis=0)
        vertices.setflags(write=False)
        self.vertices: Floats = vertices
        self._line = ClosedLine(np.vstack([vertices, vertices[:1]]))
        if (crossing := _first_crossing(self._sides, self._sides)) is not None:
            raise GeometryError(f"polygon sides {crossing[0]} and {crossing[1]} cross; order corners along the outline")
        if abs(_signed_area(vertices)) <= 1e-9 * extent**2:
            raise GeometryError("the corners of a polygon lie on one line; it has no area")
        self.holes: tuple[Polygon, ...] = ()  # until they are known to lie inside
        within = tuple(Polygon(hole) for hole in holes)
        for k, hole in enumerate(within):
            if (self.depth(hole.vertices) <= 0).any() or _first_crossing(self._sides, hole._sides):
                raise GeometryError(f"hole {k} is not inside the outline; move it")
            for j, other in enumerate(within[:k]):
                apart = not _first_crossing(other._sides, hole._sides)
                if not apart or other.depth(hole.vertices[:1])[0] > 0 or hole.depth(other.vertices[:1])[0] > 0:
                    raise GeometryError(f"holes {j} and {k} overlap; join them to one")
        self.holes = within

    def __repr__(self) -> str:
        return f"Polygon({len(self.vertices)} corners, {len(self.holes)} holes)"

    @cached_property
    def _sides(self) -> Floats:
        """Ends (n, 2, 2) of the outline's sides."""
        return np.stack([self._line.points[:-1], self._line.points[1:]], axis=1)

    @property
    def area(self) -> float:
        """Area without the holes (m2)."""
        return float(_signed_area(self.vertices)) - sum(hole.area for hole in self.holes)

    @property
    def perimeter(self) -> float:
        """Length of the outer rim (m)."""
        return float(self._line.knots[-1])

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        (x0, y0), (x1, y1) = self.vertices.min(axis=0), self.vertices.max(axis=0)
        return float(x0), float(y0), float(x1), float(y1)

    @property
    def corners(self) -> Floats:
        return self._line.knots[:-1]

    def depth(self, points: ArrayLike) -> Floats:
        points = np.asarray(points, float)
        distance = self._line.closest(points)[0]
        depth: Floats = np.where(_inside(points, self._sides), distance, -distance)
        for hole in self.holes:
            depth = np.minimum(depth, -hole.depth(points))
        return depth

    def rim(self, arc: ArrayLike) -> Floats:
        s = np.mod(np.asarray(arc, float), self.perimeter)
        return np.column_stack([np.interp(s, self._line.knots, across) for across in self._line.points.T])

    def arc(self, points: ArrayLike) -> Floats:
        return np.asarray(np.mod(self._line.closest(points)[1], self.perimeter))


def _signed_area(vertices: Floats) -> float:
    (x, y), (u, v) = vertices.T, np.roll(vertices, -1, axis=0).T
    return float(np.sum(x * v - u * y) / 2)


def _inside(points: Floats, sides: Floats) -> np.ndarray:
    """Whether a ray from each point (n,) crosses the sides an odd number of times."""
    (x, y), (x0, y0), (x1, y1) = points.T[:, :, None], sides[:, 0].T, sides[:, 1].T
    straddles = (y0 <= y) != (y1 <= y)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossed = straddles & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return np.asarray(np.sum(crossed, axis=1) % 2 == 1)


def _first_crossing(a: Floats, b: Floats) -> tuple[int, int] | None:
    """Two sides of a and b that have a point in common, neighbours of the same outline excepted."""

    def turn(p: Floats, q: Floats, r: Floats) -> Floats:
        u, v = q - p, r - p
        return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    (p, q), (r, s) = (a[:, None, 0], a[:, None, 1]), (b[None, :, 0], b[None, :, 1])
    crossed = (turn(p, q, r) * turn(p, q, s) <= 0) & (turn(r, s, p) * turn(r, s, q) <= 0)
    low = np.maximum(np.minimum(p, q), np.minimum(r, s))
    high = np.minimum(np.maximum(p, q), np.maximum(r, s))
    crossed &= (low <= high).all(axis=2)  # for sides on one line: their boxes meet
    if a is b:
        n = len(a)
        gap = (np.arange(n)[:, None] - np.arange(n)) % n
        crossed &= (gap != 0) & (gap != 1) & (gap != n - 1)
    hits = np.argwhere(crossed)
    return (int(hits[0, 0]), int(hits[0, 1])) if len(hits) else None
