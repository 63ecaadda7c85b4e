"""Where area electrodes touch the skin: quadratures over discs on it and over stretches of its rim."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.sparse as sp

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import GeometryError
from ohmskin.geometry import ElectrodeKind, Electrodes, Mesh
from ohmskin.geometry.mesh import facet_measures, normals
from ohmskin.geometry.polygon import ClosedLine
from ohmskin.geometry.surface import Triangles, closed_walks, closest_on_triangles

_EXACT = {  # barycentric coordinates of points of equal weight, exact to the second degree
    2: np.array([[1 + 3**-0.5, 1 - 3**-0.5], [1 - 3**-0.5, 1 + 3**-0.5]]) / 2,
    3: np.array([[4.0, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6,
}


@dataclass(frozen=True, eq=False)
class ElectrodeQuadrature:
    """The quadrature of one conductor that touches the skin.

    Args:
        at: (n_points, n_nodes) sparse interpolation from nodal values to the points of the quadrature.
        weights: (n_points,) area (m2) or length of rim (m) that each stands for.
    """

    at: sp.csr_array
    weights: Floats

    @property
    def extent(self) -> float:
        """Area of a disc in m2, length of a rim segment in m."""
        return float(self.weights.sum())


def quadratures(mesh: Mesh, electrodes: Electrodes) -> dict[int, ElectrodeQuadrature]:
    """The quadrature of each area electrode, by its number.

    Raises:
        GeometryError: If a disc is not on the mesh, a rim segment not at its rim or longer than it, or two overlap.
    """
    if electrodes.positions.shape[1] != mesh.nodes.shape[1]:
        counts = f"electrodes have {electrodes.positions.shape[1]} coordinates, mesh nodes {mesh.nodes.shape[1]}"
        raise GeometryError(f"{counts}; move both with mapped()")
    numbers = {kind: [k for k, own in enumerate(electrodes.kinds) if own == kind] for kind in ElectrodeKind}
    places, extents = electrodes.positions, electrodes.extents.tolist()
    found = {k: _facets(mesh, electrodes.facets[k], k) for k in numbers[ElectrodeKind.FACETS]}
    if numbers[ElectrodeKind.RIM]:
        rim = Rim(mesh)
        found |= {k: rim.contact(places[k], extents[k], k) for k in numbers[ElectrodeKind.RIM]}
        rim.check_others(electrodes)
    if numbers[ElectrodeKind.DISC]:
        disc = partial(flat_disc, mesh) if mesh.nodes.shape[1] == 2 else Surface(mesh).disc
        for k in numbers[ElectrodeKind.DISC]:
            found[k] = disc(places[k], extents[k])
            if not len(found[k].weights):
                which = f"electrode {k}, a disc of {extents[k]:g} m at {places[k]}"
                raise GeometryError(f"{which}, does not lie on the mesh; move it")
    return found


def _facets(mesh: Mesh, facets: Ints, number: int) -> ElectrodeQuadrature:
    """Facets of the mesh, by points at which products of linear functions are integrated exactly."""
    if facets.shape[1] != mesh.dim or facets.max() >= mesh.n_nodes:
        raise GeometryError(
            f"the facets of electrode {number} are of another mesh; make them with Electrodes.on_mesh()"
        )
    corners = _EXACT[mesh.dim]
    points, sizes = len(corners), facet_measures(mesh.nodes, facets)
    at = mesh.weighted(np.repeat(facets, points, axis=0), np.tile(corners, (len(facets), 1)))
    return ElectrodeQuadrature(at, np.repeat(sizes / points, points))


def disc_points(radius: float, spacing: float) -> tuple[Floats, Floats]:
    """Quadrature of a disc about the origin: points (n, 2) and areas (n,).

    Gauss points of the squared radius times equal angles, symmetric to both axes, so that a disc cut in half or in
    quarters by a straight rim keeps exactly that share; closer than `spacing`, so that no node beneath is missed.
    """
    rings = int(np.clip(np.ceil(1.5 * radius / spacing), 8, 64))
    share, weight = np.polynomial.legendre.leggauss(rings)
    r = radius * np.sqrt((share + 1) / 2)
    angle = (np.arange(4 * rings) + 0.5) * (2 * np.pi / (4 * rings))
    points = r[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    areas = np.repeat(np.pi * radius**2 * weight / 2 / (4 * rings), 4 * rings)
    return points.reshape(-1, 2), areas


def flat_disc(mesh: Mesh, centre: Floats, radius: float) -> ElectrodeQuadrature:
    """The part of a disc that lies on a flat sheet."""
    near = mesh.closest_elements(centre[None], 1)
    points, areas = disc_points(radius, float(np.sqrt(mesh.measures[near].min())))
    at, inside = mesh.interpolation(centre + points)
    return ElectrodeQuadrature(at, areas[inside])


class Surface(Triangles):
    """The triangles of a mesh in space that can be touched: those of a surface, or the faces of a thick skin."""

    def __init__(self, mesh: Mesh) -> None:
        super().__init__(mesh.nodes, mesh.elements if mesh.dim == 2 else mesh.boundary)
        self.mesh = mesh

    def disc(self, centre: Floats, radius: float) -> ElectrodeQuadrature:
        """A disc in the tangent plane at the point of the surface closest to `centre`, pressed on the surface.

        What reaches beyond an edge of the surface is cut off.
        """
        near = np.array(self.centroids.query_ball_point(centre, 2 * self.reach + 2 * radius), np.int64)
        if not len(near):
            return ElectrodeQuadrature(sp.csr_array((0, self.mesh.n_nodes)), np.empty(0))
        corners = self.mesh.nodes[self.triangles[near]]
        across = normals(self.mesh.nodes, self.triangles[near])
        measures = np.linalg.norm(across, axis=1) / 2
        distance, _ = closest_on_triangles(centre[None], corners)
        first = int(distance[0].argmin())
        middle = np.flatnonzero(distance[0] <= distance[0, first] + 1e-9 * radius)
        units = across / (2 * measures[:, None])
        found: list[ElectrodeQuadrature] = []
        while len(middle):  # at an edge of a body several faces meet; the disc lies on the one that has most of it
            along = units[middle] @ units[middle[0]]
            own = np.abs(along) > 0.7
            normal = (across[middle] * np.sign(along)[:, None])[own].sum(axis=0)
            normal /= np.linalg.norm(normal)
            found.append(self._across(centre, radius, normal, near, float(np.sqrt(measures[middle[0]]))))
            middle = middle[~own]
        found.sort(key=lambda contact: -contact.extent)
        if len(found) > 1 and found[1].extent > 0.99 * found[0].extent:
            raise GeometryError(f"a disc at {centre} lies on an edge, as much on one face as on another; move it")
        return found[0]

    def _across(self, centre: Floats, radius: float, normal: Floats, near: Ints, spacing: float) -> ElectrodeQuadrature:
        """A disc across `normal`, pressed on the triangles `near`; what hangs over an edge is cut off."""
        first_axis = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        first_axis /= np.linalg.norm(first_axis)
        frame = np.stack([first_axis, np.cross(normal, first_axis)])
        points, areas = disc_points(radius, spacing)
        points = centre + points @ frame
        nodes, weights, _ = self.project(points, near)
        offset = points - np.einsum("pk,pkd->pd", weights, self.mesh.nodes[nodes])
        sideways = np.linalg.norm(offset - np.outer(offset @ normal, normal), axis=1)
        inside = sideways <= np.abs(offset @ normal) + 1e-9 * radius
        return ElectrodeQuadrature(self.mesh.weighted(nodes[inside], weights[inside]), areas[inside])


class Rim:
    """The rim of a sheet, flat or in space, as closed walks along its edges.

    Raises:
        GeometryError: If the mesh is not a sheet, has no rim, or its rim touches itself.
    """

    def __init__(self, mesh: Mesh) -> None:
        if mesh.dim != 2:
            raise GeometryError("a thick skin has faces, no rim; use Electrodes.with_discs() on its faces")
        if not len(mesh.boundary):
            raise GeometryError("the surface is closed and has no rim; use Electrodes.with_discs()")
        self.mesh = mesh
        self._walks = closed_walks(mesh.boundary)
        self._lines = [ClosedLine(mesh.nodes[walk]) for walk in self._walks]
        self._taken: list[tuple[int, float, float, int]] = []
        self._stretches: dict[int, ClosedLine] = {}

    def contact(self, centre: Floats, length: float, number: int) -> ElectrodeQuadrature:
        """The stretch of `length` (m) about the point of the rim that is closest to `centre`."""
        closest = [line.closest(centre[None]) for line in self._lines]
        off, k, arc = min((float(away[0]), k, float(at[0])) for k, (away, at) in enumerate(closest))
        walk, knots = self._walks[k], self._lines[k].knots
        if off > length / 2:
            away = f"electrode {number} at {centre} is {off:.3g} m off the rim"
            raise GeometryError(f"{away}; move it or use with_discs()")
        if length > knots[-1]:
            raise GeometryError(f"electrode {number} is {length:.3g} m long, its rim {knots[-1]:.3g} m; shorten it")
        for walk_taken, other_arc, other_length, other in self._taken:
            apart = abs((arc - other_arc + knots[-1] / 2) % knots[-1] - knots[-1] / 2)
            if walk_taken == k and apart < (length + other_length) / 2 - 1e-9 * knots[-1]:
                both = f"electrodes {other} and {number} overlap: {apart:.3g} m apart on the rim"
                raise GeometryError(f"{both} with lengths {other_length:.3g} and {length:.3g} m; make them shorter")
        self._taken.append((k, arc, length, number))
        start, end = arc - length / 2, arc + length / 2
        breaks = np.concatenate([knots[:-1] - knots[-1], knots[:-1], knots[:-1] + knots[-1], [2 * knots[-1]]])
        least = 1e-9 * length  # a shorter piece comes from rounding
        cuts = np.concatenate([[start], breaks[(breaks > start + least) & (breaks < end - least)], [end]])
        corners = [np.interp(np.mod(cuts, knots[-1]), knots, along) for along in self._lines[k].points.T]
        self._stretches[number] = ClosedLine(np.column_stack(corners))
        return self._stretch(walk, knots, cuts)

    def check_others(self, electrodes: Electrodes) -> None:
        """Raise GeometryError if a disc or point lies on a stretch."""
        others = [k for k in range(len(electrodes)) if k not in self._stretches]
        radius = electrodes.extents[others]
        for number, stretch in self._stretches.items():
            away = stretch.closest(electrodes.positions[others])[0]
            if len(
                on := np.flatnonzero(away - radius < np.where(radius > 0, -1e-9, 1e-9) * electrodes.extents[number])
            ):
                which = f"electrode {others[on[0]]} ({electrodes.kinds[others[on[0]]]}) lies on electrode {number}"
                raise GeometryError(f"{which}, a stretch of the rim; make them smaller or move one")

    def _stretch(self, walk: Ints, knots: Floats, cuts: Floats) -> ElectrodeQuadrature:
        """Two Gauss points on each edge or part of an edge: exact for products of linear functions."""
        around = knots[-1]
        middle, half = (cuts[1:] + cuts[:-1]) / 2, (cuts[1:] - cuts[:-1]) / 2
        side = np.clip(np.searchsorted(knots, np.mod(middle, around), side="right") - 1, 0, len(knots) - 2)
        step = np.diff(knots)[side]
        centre = (np.mod(middle, around) - knots[side]) / step
        offset = half / step / np.sqrt(3)
        share = np.concatenate([centre - offset, centre + offset])
        nodes = np.column_stack([walk[side], walk[side + 1]])
        at = self.mesh.weighted(np.tile(nodes, (2, 1)), np.column_stack([1 - share, share]))
        return ElectrodeQuadrature(at, np.concatenate([half, half]))
