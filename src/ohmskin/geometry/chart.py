"""Charts: flat maps of curved skins, true to angles.

Everything that senses works on a map of the skin in the plane. The map is conformal: a small square of the skin is a
small square of the map, `scale` times smaller. A sheet of the same conductance per square everywhere then has the same
potentials on the map as on the skin, whatever its curvature, so that forward model, drives, images and contacts need
know nothing of space; only lengths and areas need the scale. A flat skin is its own map.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ohmskin.arrays import Floats
from ohmskin.errors import GeometryError
from ohmskin.geometry.band import Band
from ohmskin.geometry.domain import Disc, Domain, Rectangle
from ohmskin.geometry.holes import Hole, with_holes

_FINE = 2001  # places along a profile
_MOST_UNEVEN = 4.0  # of the largest scale of a map over the smallest


class Chart(Protocol):
    """A flat map of a skin in space. Places (n, 2) are on the map, points (n, 3) in space, both in metres."""

    @property
    def domain(self) -> Domain:
        """The map's outline; its area is that of the skin."""

    @property
    def flat(self) -> bool:
        """Whether lengths on the map are lengths on the skin."""

    def points(self, places: ArrayLike) -> Floats:
        """The points (n, 3) at places (n, 2)."""

    def frames(self, places: ArrayLike) -> Floats:
        """At places (n, 2), as rows of (n, 3, 3): the directions of the map's x and y, and the outward normal."""

    def scale(self, places: ArrayLike) -> Floats:
        """Metres on the skin for a metre on the map (n,), at places (n, 2)."""

    def project(self, points: ArrayLike) -> tuple[Floats, Floats]:
        """The places (n, 2) closest to points (n, 3), and the distances of the points from them (m)."""


def _places(places: ArrayLike) -> Floats:
    return np.asarray(places, float).reshape(-1, 2)


def check_even(scale: Floats) -> None:
    """Raise GeometryError if the scale of a map (n,) is far larger in one place than in another."""
    if scale.max() > _MOST_UNEVEN * scale.min():
        uneven = f"the map of this skin is {scale.max() / scale.min():.2g} times as fine in one place as in another"
        raise GeometryError(f"{uneven}, {_MOST_UNEVEN:g} are allowed; cut it into two skins")


@dataclass(frozen=True)
class FlatChart:
    """The `Chart` of a flat skin in the plane z = 0, its own map.

    Args:
        domain: Its shape.
    """

    domain: Domain
    flat = True

    def points(self, places: ArrayLike) -> Floats:
        return np.column_stack([_places(places), np.zeros(len(_places(places)))])

    def frames(self, places: ArrayLike) -> Floats:
        return np.tile(np.eye(3), (len(_places(places)), 1, 1))

    def scale(self, places: ArrayLike) -> Floats:
        return np.ones(len(_places(places)))

    def project(self, points: ArrayLike) -> tuple[Floats, Floats]:
        given = np.asarray(points, float).reshape(-1, 3)
        places = given[:, :2]
        away = np.maximum(-self.domain.depth(places), 0.0)
        return places, np.hypot(away, given[:, 2])


class RevolutionChart:
    """The `Chart` of a surface of revolution about the z axis: part of a turn, all of it, or a cap over the axis.

    The middle of a part of a turn is in the direction of the x axis; the seam of a full turn is on the other side. The
    map of a skin round the axis is a rectangle, or a closed band (`Band`), x round the axis (eastwards, seen from
    above), y along the profile; that of a cap is a disc about the pole.

    Args:
        profile: (n, 2) distance from the axis and height z (m), in the order of the map's y; first the pole of a cap,
            at distance 0. The outward normal is to the right of its direction, of a cap to the left.
        angle: Part of a turn (rad), up to 2 pi; of a cap all of it.
        holes: Cut into it, see `with_holes`; places are on the map.

    Raises:
        GeometryError: If the profile has less than two points or meets the axis, the map would be too uneven, or a hole
            is not on it.
    """

    def __init__(self, profile: ArrayLike, angle: float = 2 * np.pi, holes: Sequence[Hole] = ()) -> None:
        from scipy.integrate import cumulative_simpson  # these take a third of a second, which flat skins need not wait
        from scipy.interpolate import CubicSpline

        given = np.asarray(profile, float)
        if given.ndim != 2 or given.shape[1] != 2 or len(given) < 2 or not np.isfinite(given).all():
            raise GeometryError(
                f"a profile has shape {given.shape}; give [distance from the axis, z] of 2 points or more"
            )
        steps = np.linalg.norm(np.diff(given, axis=0), axis=1)
        if steps.min() <= 1e-6 or given[1:, 0].min() <= 0 or given[0, 0] < 0:
            raise GeometryError("points of a profile coincide or lie on the axis; only a cap's pole may, the first one")
        self._cap = bool(given[0, 0] == 0)
        whole = abs(angle - 2 * np.pi) < 1e-9
        if not 0.1 <= angle <= 2 * np.pi + 1e-9 or (self._cap and not whole):
            raise GeometryError(f"angle is {angle:.4g} rad; it must be 0.1 to 2 pi, of a cap 2 pi")
        self.angle = 2 * np.pi if whole else float(angle)
        curve = CubicSpline(np.append(0.0, np.cumsum(steps)), given) if len(given) > 2 else None
        t = np.linspace(0, steps.sum(), _FINE)
        fine = given[0] + np.outer(t / t[-1], given[1] - given[0]) if curve is None else curve(t)
        r = fine[:, 0]
        if r[1:].min() <= 0:
            raise GeometryError("the profile meets the axis; give more points of it")
        s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1)))
        turn = self.angle
        area = turn * float(cumulative_simpson(r, x=s)[-1])
        if self._cap:
            inner = np.zeros(_FINE)
            inner[1:] = 1 / r[1:] - 1 / s[1:]
            rho = s * np.exp(cumulative_simpson(inner, x=s, initial=0))
            rho *= np.sqrt(area / np.pi) / rho[-1]
            along, scale = rho, np.append(s[1] / rho[1], r[1:] / rho[1:])
            self.domain: Domain = Disc(float(rho[-1]))
        else:
            across = cumulative_simpson(1 / r, x=s, initial=0)
            self._unit = float(np.sqrt(area / (turn * across[-1])))
            along, scale = self._unit * across, r / self._unit
            width, height = turn * self._unit, float(along[-1])
            self.domain = Band(width, height) if whole else Rectangle(width, height)
        check_even(scale)
        self.flat = bool(np.ptp(scale) < 1e-9)
        self._scale, self._profile = CubicSpline(along, scale), CubicSpline(along, fine)
        self._along, self._fine, self._tree = along, fine, cKDTree(fine)
        self.domain = with_holes(self.domain, holes, self.scale)

    def __repr__(self) -> str:
        return f"RevolutionChart({self.domain})"

    def _polar(self, places: ArrayLike) -> tuple[Floats, Floats]:
        """The angle about the axis (n,) (rad), and how far along the profile (n,) (m on the map)."""
        x, y = _places(places).T
        if self._cap:
            return np.arctan2(y, x), np.clip(np.hypot(x, y), 0, self._along[-1])
        return x / self._unit - self.angle / 2, np.clip(y, 0, self._along[-1])

    def points(self, places: ArrayLike) -> Floats:
        phi, along = self._polar(places)
        r, z = self._profile(along).T
        return np.column_stack([r * np.cos(phi), r * np.sin(phi), z])

    def frames(self, places: ArrayLike) -> Floats:
        phi, along = self._polar(places)
        dr, dz = (self._profile(along, 1) / np.linalg.norm(self._profile(along, 1), axis=1, keepdims=True)).T
        cos, sin, none = np.cos(phi), np.sin(phi), np.zeros_like(phi)
        eastwards, onwards = np.column_stack([-sin, cos, none]), np.column_stack([dr * cos, dr * sin, dz])
        if self._cap:  # the map's x and y are turned by the angle against the directions outwards and eastwards
            x = cos[:, None] * onwards - sin[:, None] * eastwards
            y = sin[:, None] * onwards + cos[:, None] * eastwards
        else:
            x, y = eastwards, onwards
        return np.stack([x, y, np.cross(x, y)], axis=1)

    def scale(self, places: ArrayLike) -> Floats:
        return np.asarray(self._scale(self._polar(places)[1]))

    def project(self, points: ArrayLike) -> tuple[Floats, Floats]:
        given = np.asarray(points, float).reshape(-1, 3)
        phi = np.arctan2(given[:, 1], given[:, 0])
        phi = np.clip(phi, -self.angle / 2, self.angle / 2)  # off the end of part of a turn: the closer end
        meridian = np.column_stack([np.hypot(given[:, 0], given[:, 1]), given[:, 2]])
        nearest = self._tree.query(meridian)[1]
        best, along = np.full(len(given), np.inf), np.zeros(len(given))
        for start in (np.maximum(nearest - 1, 0), np.minimum(nearest, _FINE - 2)):
            low, step = self._fine[start], self._fine[start + 1] - self._fine[start]
            share = np.clip(np.sum((meridian - low) * step, axis=1) / np.sum(step**2, axis=1), 0.0, 1.0)
            away = np.linalg.norm(meridian - low - share[:, None] * step, axis=1)
            at = self._along[start] + share * (self._along[start + 1] - self._along[start])
            along, best = np.where(away < best, at, along), np.minimum(away, best)
        if self._cap:
            places = along[:, None] * np.column_stack([np.cos(phi), np.sin(phi)])
        else:
            places = np.column_stack([(phi + self.angle / 2) * self._unit, along])
            if self.domain.period:
                places[:, 0] %= self.domain.period
        return places, np.linalg.norm(self.points(places) - given, axis=1)
