"""Electrode layouts: where the electrodes are, of what kind, and in what order a scan walks round them."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ohmskin.arrays import Floats, Ints, ReadOnly, real
from ohmskin.errors import GeometryError
from ohmskin.geometry.band import Band
from ohmskin.geometry.domain import Domain, Rectangle
from ohmskin.geometry.mesh import Mesh, facet_measures
from ohmskin.geometry.polygon import Polygon

_AT_CORNER = 0.025  # of the distance of electrodes on a rim


class ElectrodeKind(StrEnum):
    """How an electrode touches the skin."""

    POINT = "point"  #: at one mesh node; its own voltage when driven grows without bound as the mesh is refined
    DISC = "disc"  #: a disc on the sheet, cut off where it reaches beyond the rim; contact impedance in ohm m2
    RIM = "rim"  #: a stretch of the rim of a sheet; contact impedance in ohm m
    FACETS = "facets"  #: facets of one mesh: faces of a body (contact impedance in ohm m2), edges of a rim (in ohm m)


@dataclass(frozen=True, eq=False)
class Electrodes(ReadOnly):
    """Electrodes, numbered ring by ring from the rim inwards, each ring counterclockwise; points unless said otherwise.

    Kinds mix freely: `with_discs`, `with_rim_segments` and `with_points` return a changed copy; `on_mesh` makes
    electrodes of the facets of a mesh.

    Args:
        positions: Electrode centres (n_elec, 2), or (n_elec, 3) in space, in metres.
        rings: Electrode numbers of each ring, the rim first. A base scan walks round the first ring.
        kinds: Kind of each electrode (n_elec,).
        extents: (n_elec,) radius of a disc, length along the rim of a rim segment, 0 for a point (m); area (m2) or
            length (m) of facets.
        contact_impedances: (n_elec,) of a disc or faces in ohm m2, of a rim segment or edges in ohm m, 0 for a point.
        facets: Of each electrode its facets (n_facets, dim), by the nodes of one mesh; none of those of other kinds.

    Raises:
        GeometryError: If positions are not finite, not distinct, fewer than four, or not all named once by `rings`; if
            a kind is unknown; if an extent or contact impedance is not positive or given for a point; if discs overlap.
    """

    positions: Floats
    rings: tuple[tuple[int, ...], ...]
    kinds: tuple[ElectrodeKind, ...] = ()
    extents: Floats = field(default_factory=lambda: np.empty(0))
    contact_impedances: Floats = field(default_factory=lambda: np.empty(0))
    facets: tuple[Ints, ...] = ()

    def __post_init__(self) -> None:
        positions = real(self.positions, "electrode positions are", GeometryError).copy()
        if positions.ndim != 2 or positions.shape[1] not in (2, 3) or len(positions) < 4:
            raise GeometryError(f"electrode positions have shape {positions.shape}; need (n, 2) or (n, 3), n >= 4")
        if not np.isfinite(positions).all():
            raise GeometryError(f"electrode {int(np.argmin(np.isfinite(positions).all(1)))} has a position not finite")
        gaps = np.linalg.norm(positions[:, None] - positions[None], axis=-1) + np.diag(np.full(len(positions), np.inf))
        if gaps.min() < 1e-6:
            a, b = np.unravel_index(np.argmin(gaps), gaps.shape)
            raise GeometryError(f"electrodes {a} and {b} are at the same place {positions[a]}; move one of them")
        named = sorted(e for ring in self.rings for e in ring)
        if named != list(range(len(positions))):
            raise GeometryError(f"rings {self.rings} must name each of the {len(positions)} electrodes exactly once")
        positions.setflags(write=False)
        object.__setattr__(self, "positions", positions)
        self._check_areas(gaps)

    def _check_areas(self, gaps: Floats) -> None:
        count = len(self.positions)
        try:
            kinds = tuple(ElectrodeKind(kind) for kind in self.kinds) or (ElectrodeKind.POINT,) * count
        except ValueError as error:
            raise GeometryError(f"{error}; choose from {', '.join(ElectrodeKind)}") from None
        if len(kinds) != count:
            raise GeometryError(f"{len(kinds)} electrode kinds for {count} electrodes; give one each")
        object.__setattr__(self, "kinds", kinds)
        facets = tuple(self.facets) or (np.empty((0, 2), np.int64),) * count
        if [len(one) > 0 for one in facets] != [kind == ElectrodeKind.FACETS for kind in kinds]:
            raise GeometryError("facets are given for other electrodes than those of kind facets; use on_mesh()")
        object.__setattr__(self, "facets", facets)
        area = self.are_areas
        for name, unit in (("extents", "m"), ("contact_impedances", "ohm m2 for a disc, ohm m on the rim")):
            given = getattr(self, name)
            values = real(given, f"electrode {name} are", GeometryError).copy() if len(given) else np.zeros(count)
            if values.shape != (count,):
                raise GeometryError(f"electrode {name} have shape {values.shape}; give ({count},)")
            wrong = np.where(area, ~(np.isfinite(values) & (values > 0)), values != 0)
            if wrong.any():
                k = int(np.argmax(wrong))
                allowed = f"positive ({unit})" if area[k] else "0 for a point; use with_discs() or with_rim_segments()"
                raise GeometryError(f"{name}[{k}] of a {kinds[k]} electrode is {values[k]:g}; it must be {allowed}")
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        radius = np.where([kind == ElectrodeKind.DISC for kind in kinds], self.extents, 0.0)
        if (gaps < radius[:, None] + radius).any():
            a, b = np.argwhere(gaps < radius[:, None] + radius)[0]
            radii = f"radii {radius[a]:.3g} and {radius[b]:.3g} m"
            apart = f"{gaps[a, b]:.3g} m apart with {radii}"
            raise GeometryError(f"electrodes {a} and {b} overlap: {apart}; make them smaller or move one")

    @property
    def are_areas(self) -> NDArray[np.bool_]:
        """Which electrodes (n_elec,) have an extent and a contact impedance."""
        return np.array([kind != ElectrodeKind.POINT for kind in self.kinds])

    def with_discs(self, radius: ArrayLike, contact_impedance: ArrayLike, which: Iterable[int] | None = None) -> Self:
        """A copy in which the electrodes `which` (all, if None) are discs.

        Args:
            radius: One value or one for each of `which` (m).
            contact_impedance: Resistance times area of the contact, likewise (ohm m2).

        Raises:
            GeometryError: If a number is not an electrode's, a value is not positive, or discs overlap.
        """
        return self._with(ElectrodeKind.DISC, radius, contact_impedance, which)

    def with_rim_segments(
        self, length: ArrayLike, contact_impedance: ArrayLike, which: Iterable[int] | None = None
    ) -> Self:
        """A copy in which the electrodes `which` (all, if None) are stretches of the rim, centred at their positions.

        Args:
            length: Along the rim, one value or one for each of `which` (m).
            contact_impedance: Resistance times length of the contact, likewise (ohm m).

        Raises:
            GeometryError: If a number is not an electrode's, or a value is not positive.
        """
        return self._with(ElectrodeKind.RIM, length, contact_impedance, which)

    def with_points(self, which: Iterable[int] | None = None) -> Self:
        """A copy in which the electrodes `which` (all, if None) are points.

        Raises:
            GeometryError: If a number is not an electrode's.
        """
        return self._with(ElectrodeKind.POINT, 0.0, 0.0, which)

    def with_contact_impedances(self, values: ArrayLike) -> Self:
        """A copy with other contact impedances.

        Args:
            values: One value for all area electrodes, or (n_elec,), 0 for points; above 0, units as of `Electrodes`.

        Raises:
            GeometryError: If one is out of range, or there is not one for each electrode.
        """
        given = real(values, "contact impedances are", GeometryError)
        return replace(self, contact_impedances=np.where(self.are_areas, given, 0.0) if given.ndim == 0 else given)

    def mapped(self, move: Callable[[Floats], ArrayLike]) -> Self:
        """The same electrodes with positions moved by `move`, as by `Mesh.mapped`."""
        return replace(self, positions=np.asarray(move(self.positions), float))

    def _with(self, kind: ElectrodeKind, extent: ArrayLike, impedance: ArrayLike, which: Iterable[int] | None) -> Self:
        numbers = np.arange(len(self)) if which is None else np.fromiter(which, np.int64)
        if len(numbers) and not (numbers.min() >= 0 and numbers.max() < len(self)):
            raise GeometryError(f"electrodes {numbers.tolist()} to change; there are {len(self)} (0..{len(self) - 1})")
        kinds, extents, impedances = list(self.kinds), self.extents.copy(), self.contact_impedances.copy()
        for number in numbers:
            kinds[number] = kind
        extent = real(extent, "electrode extents are", GeometryError)
        impedance = real(impedance, "contact impedances are", GeometryError)
        try:
            extents[numbers], impedances[numbers] = extent, impedance
        except ValueError:
            count = len(numbers)
            raise GeometryError(f"give one size and contact impedance, or one for each of {count} electrodes") from None
        facets = tuple(own[: len(own) * (k not in numbers)] for k, own in enumerate(self.facets))
        return replace(self, kinds=tuple(kinds), extents=extents, contact_impedances=impedances, facets=facets)

    def __len__(self) -> int:
        return len(self.positions)

    @classmethod
    def at(cls, positions: ArrayLike, rings: tuple[tuple[int, ...], ...] | None = None) -> Self:
        """Electrodes at given positions (n_elec, 2) (m); one ring in the given order unless `rings` is given."""
        points = np.asarray(positions, float)
        return cls(points, rings or (tuple(range(len(points))),))

    @classmethod
    def on_mesh(
        cls,
        mesh: Mesh,
        groups: Sequence[ArrayLike],
        contact_impedance: ArrayLike = 0.0,
        rings: tuple[tuple[int, ...], ...] | None = None,
    ) -> Self:
        """Electrodes of a mesh's nodes and facets, as other programs list them; usable with that mesh only.

        Args:
            mesh: Triangles or tetrahedra.
            groups: Of each electrode its facets (n_facets, dim) by their nodes, or the numbers of its nodes (n_nodes,):
                it then consists of those facets of the boundary whose nodes all belong to it (EIDORS' rule). One node
                is a point.
            contact_impedance: One value or (n_elec,), of faces in ohm m2, of edges in ohm m; that of points is ignored.
            rings: As in `at`.

        Raises:
            GeometryError: If a node is not in the mesh, nodes make no facet of its boundary, facets are not of it, or
                two electrodes share one.
        """
        boundary = np.sort(mesh.boundary, axis=1)
        numbered = {tuple(facet): number for number, facet in enumerate(boundary.tolist())}
        kinds, facets, centres, extents = [], list[Ints](), [], []
        owner: dict[int, int] = {}
        for k, given in enumerate(groups):
            group = np.asarray(given)
            if group.dtype.kind not in "iu" or not group.size or group.min() < 0 or group.max() >= mesh.n_nodes:
                raise GeometryError(
                    f"electrode {k} needs nodes 0 to {mesh.n_nodes - 1} of the mesh; it has {given!r:.80}"
                )
            if group.ndim == 2 and group.shape[1] == mesh.dim:
                own = [numbered.get(tuple(facet), -1) for facet in np.sort(group, axis=1).tolist()]
            elif group.ndim == 1 and len(group) > 1:
                own = np.flatnonzero(np.isin(boundary, group).all(axis=1)).tolist()
            elif group.ndim == 1:
                own = []
            else:
                raise GeometryError(f"electrode {k} has shape {group.shape}; give nodes (n,) or facets (n, {mesh.dim})")
            if -1 in own or (group.size > 1 and not own):
                raise GeometryError(
                    f"the nodes of electrode {k} make no facet of the mesh's boundary; check its numbers"
                )
            if shared := [(owner[number], number) for number in own if owner.setdefault(number, k) != k]:
                raise GeometryError(f"electrodes {shared[0][0]} and {k} share a facet, nodes {boundary[shared[0][1]]}")
            chosen = boundary[sorted(set(own))]
            sizes = facet_measures(mesh.nodes, chosen)
            middles = mesh.nodes[chosen].mean(axis=1) if own else mesh.nodes[group]
            kinds.append(ElectrodeKind.FACETS if own else ElectrodeKind.POINT)
            facets.append(chosen)
            extents.append(float(sizes.sum()))
            centres.append(np.average(middles, axis=0, weights=sizes) if own else middles[0])
        areas = np.array(extents) > 0
        impedances = np.where(areas, real(contact_impedance, "contact impedances are", GeometryError), 0.0)
        rings = rings or (tuple(range(len(kinds))),)
        return cls(np.array(centres), rings, tuple(kinds), np.array(extents), impedances, tuple(facets))

    @classmethod
    def rim(cls, domain: Domain, count: int, start: float = 0.0, clockwise: bool = False) -> Self:
        """`count` electrodes evenly spaced along the rim of `domain`; those close to a polygon's corner are put on it.

        Args:
            domain: The sheet.
            count: How many.
            start: Place of the first, as a share of the rim's length counterclockwise from where the rim starts (0 to
                1). On a disc, 0.25 is 12 o'clock.
            clockwise: Number them clockwise.

        Raises:
            GeometryError: If there are fewer than 4 or a fraction of one, or `start` is out of range.
        """
        if count < 4 or count % 1:
            raise GeometryError(f"{count} electrodes on the rim; need a whole number, at least 4")
        if not 0 <= start < 1:
            raise GeometryError(f"start {start} of the rim; it must be from 0 to below 1, a share of the rim's length")
        shares = start + (-1 if clockwise else 1) * np.arange(count) / count
        arcs = np.mod(shares, 1.0) * domain.perimeter
        if isinstance(domain, Polygon):
            arcs = to_corners(domain, arcs)
        return cls.at(domain.rim(arcs))

    @classmethod
    def grid(cls, sheet: Rectangle | Band, columns: int = 4, rows: int = 4, inset: float = 0.0) -> Self:
        """A regular grid that spans the sheet (paper, section IV-A).

        The default 4 x 4 grid has 12 electrodes on the outer ring (0-11) and 4 inside (12-15). Round a closed band the
        columns are evenly spaced; a ring is a row of the lower half and, back again, one of the upper half.

        Args:
            sheet: The sheet.
            columns, rows: Number of electrodes along x and along y, at least 2 each.
            inset: Distance of the outer ring from the rim (m), from 0 to below half of the shorter side.

        Raises:
            GeometryError: If one of them is out of range, or there is a fraction of a column or row.
        """
        if min(columns, rows) < 2 or columns % 1 or rows % 1:
            raise GeometryError(f"a grid of {columns} x {rows} electrodes; need whole numbers, at least 2 x 2")
        x0, y0, x1, y1 = sheet.bounds
        if not 0 <= inset < (y1 - y0 if sheet.period else min(x1 - x0, y1 - y0)) / 2:
            raise GeometryError(f"grid inset {inset} m; it must be from 0 to below half of the sheet's shorter side")
        x = np.linspace(x0 + inset, x1 - inset, columns)
        y = np.linspace(y0 + inset, y1 - inset, rows)
        walks: list[list[tuple[float, float]]] = []  # round each ring, corners and lines of one row twice
        if sheet.period:
            x = x0 + (x1 - x0) * np.arange(columns) / columns
            for low, high in zip(y[: (rows + 1) // 2], y[::-1], strict=False):
                walks.append([(a, low) for a in x] + [(a, high) for a in x[::-1]])
        while len(x) and len(y) and not sheet.period:
            there, back = [(a, y[0]) for a in x] + [(x[-1], b) for b in y], [(a, y[-1]) for a in x[::-1]]
            walks.append(there + back + [(x[0], b) for b in y[::-1]])
            x, y = x[1:-1], y[1:-1]
        numbers: dict[tuple[float, float], int] = {}
        rings = [dict.fromkeys(numbers.setdefault(place, len(numbers)) for place in walk) for walk in walks]
        return cls(np.array(list(numbers)), tuple(tuple(ring) for ring in rings))


def to_corners(domain: Domain, arcs: Floats, within: float | None = None) -> Floats:
    """Arc lengths (n,) of places spread along a rim, those beside a corner moved onto it: a mesh cannot have both.

    Beside it is what is `within` so much of it (m); a fortieth of the places' distance unless given.
    """
    if not len(domain.corners):
        return arcs
    away = domain.corners - arcs[:, None]
    away -= domain.perimeter * np.rint(away / domain.perimeter)
    close = np.abs(away).min(axis=1) < (_AT_CORNER * domain.perimeter / len(arcs) if within is None else within)
    return np.where(close, domain.corners[np.abs(away).argmin(axis=1)], arcs)
