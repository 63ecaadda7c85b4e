"""Holes cut into a flat shape or into a closed band."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import GeometryError
from ohmskin.geometry.band import Edge
from ohmskin.geometry.domain import Domain
from ohmskin.geometry.periodic import folded
from ohmskin.geometry.polygon import Polygon

_ROUND = 24  # corners of a round hole
_MOST_HOLES, _MOST_CORNERS = 100, 400
_LOOKED_AT = 400  # places along the rim of a hole that must be on the sheet

Hole = tuple[float, ...] | tuple[tuple[float, ...], ...]
"""[x, y, radius], or the corners [x, y] in order (m)."""


class Cutout:
    """A polygonal hole; its x may be anywhere round a closed band.

    Args:
        polygon: Its outline.
        period: Of the band, 0 of other sheets (m).
    """

    holes = ()

    def __init__(self, polygon: Polygon, period: float = 0.0) -> None:
        self.polygon, self.period = polygon, period
        self.area, self.perimeter, self.bounds = polygon.area, polygon.perimeter, polygon.bounds
        self.corners: Floats = polygon.corners
        self._middle = sum(polygon.bounds[::2]) / 2

    def _nearest_turn(self, points: ArrayLike) -> Floats:
        """Points (n, 2) as many turns away as the hole is."""
        near = np.array(points, float)
        if self.period:
            near[..., 0] -= self.period * np.rint((near[..., 0] - self._middle) / self.period)
        return near

    def depth(self, points: ArrayLike) -> Floats:
        return self.polygon.depth(self._nearest_turn(points))

    def rim(self, arc: ArrayLike) -> Floats:
        return folded(self.polygon.rim(arc), self.period)

    def arc(self, points: ArrayLike) -> Floats:
        return self.polygon.arc(self._nearest_turn(points))


class Holed:
    """A shape with polygonal holes; its rim is that of the whole shape.

    Args:
        base: The shape, perhaps with holes of its own or a closed band.
        holes: Corners (n, 2) of each hole (m), in order; round a closed band x may go beyond the seam.

    Attributes:
        base: The shape.
        holes: Its own ones, then these.

    Raises:
        GeometryError: If a hole crosses itself, is not inside, or overlaps another.
    """

    def __init__(self, base: Domain, holes: Sequence[ArrayLike]) -> None:
        self.base, self.period = base, base.period
        self.perimeter, self.bounds = base.perimeter, base.bounds
        self.corners: Floats = base.corners
        cutouts = list[Cutout]()
        for number, corners in enumerate(holes):
            try:
                hole = Cutout(Polygon(corners), self.period)
            except GeometryError as error:
                raise GeometryError(f"hole {number}: {error}") from None
            rim = hole.rim(np.append(np.linspace(0, hole.perimeter, _LOOKED_AT), hole.corners))
            if self.period and np.ptp(hole.polygon.vertices[:, 0]) > 0.9 * self.period:
                raise GeometryError(f"hole {number} goes round the sleeve; describe two skins")
            inner = (own.rim(np.zeros(1)) for own in base.holes if not isinstance(own, Edge))
            if (base.depth(rim) <= 0).any() or any((hole.depth(place) > 0).any() for place in inner):
                raise GeometryError(f"hole {number} is not inside the sheet, or overlaps a hole of its mesh; move it")
            for other, before in enumerate(cutouts):
                if (before.depth(rim) >= 0).any() or (hole.depth(before.rim(before.corners)) >= 0).any():
                    raise GeometryError(f"holes {other} and {number} overlap; join them to one")
            cutouts.append(hole)
        self.cutouts = tuple(cutouts)
        self.holes: tuple[Domain, ...] = (*base.holes, *cutouts)
        self.area = base.area - sum(hole.area for hole in self.cutouts)

    def __repr__(self) -> str:
        return f"{self.base} with {len(self.cutouts)} holes"

    def depth(self, points: ArrayLike) -> Floats:
        depth: Floats = np.minimum.reduce([self.base.depth(points), *(-hole.depth(points) for hole in self.cutouts)])
        return depth

    def rim(self, arc: ArrayLike) -> Floats:
        return self.base.rim(arc)

    def arc(self, points: ArrayLike) -> Floats:
        return self.base.arc(points)


def with_holes(domain: Domain, holes: Sequence[Hole], scale: Callable[[ArrayLike], Floats] | None = None) -> Domain:
    """A map with holes, or itself if there are none.

    Args:
        domain: The map.
        holes: Each [x, y, radius], round on the skin, or its corners [x, y] (m).
        scale: Metres on the skin for a metre on the map (n,), at places (n, 2); 1 unless given.

    Raises:
        GeometryError: As `Holed`; also if there are too many.
    """
    if not holes:
        return domain
    if len(holes) > _MOST_HOLES or any(len(hole) > _MOST_CORNERS for hole in holes):
        raise GeometryError(f"a sheet has {_MOST_HOLES} holes at most, and a hole {_MOST_CORNERS} corners")
    angle = 2 * np.pi * (np.arange(_ROUND) + 0.5) / _ROUND
    same_area = np.sqrt(2 * np.pi / _ROUND / np.sin(2 * np.pi / _ROUND))
    outlines = []
    for number, given in enumerate(holes):
        corners = np.array(given, float)
        if corners.ndim == 1:
            if not corners[2] > 0:
                raise GeometryError(f"hole {number} has a radius of {corners[2]:g} m; it must be positive")
            radius = same_area * corners[2] / (1.0 if scale is None else float(scale(corners[None, :2])[0]))
            corners = corners[:2] + radius * np.column_stack([np.cos(angle), np.sin(angle)])
        outlines.append(corners)
    return Holed(domain, outlines)


def without_holes(domain: Domain) -> Domain:
    """The shape without the holes that were cut into it by `with_holes`."""
    return domain.base if isinstance(domain, Holed) else domain


def clipped(corners: Floats, low: float, high: float) -> Floats:
    """The part (n, 2) of a polygon between x = `low` and x = `high` (Sutherland and Hodgman 1974); perhaps nothing."""
    for sign, bound in ((1.0, low), (-1.0, -high)):
        inside = sign * corners[:, 0] - bound
        kept = []
        for here, there, a, b in zip(corners, np.roll(corners, -1, axis=0), inside, np.roll(inside, -1), strict=True):
            if a >= 0:
                kept.append(here)
            if a * b < 0:
                kept.append(here + a / (a - b) * (there - here))
        corners = np.reshape(kept, (-1, 2))
    return corners
