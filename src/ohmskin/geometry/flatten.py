"""Conformal maps of surfaces that are given as triangles: a patch with one rim or with holes, or a closed ring."""

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import eigsh, spsolve

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import GeometryError
from ohmskin.geometry.band import Band
from ohmskin.geometry.chart import check_even
from ohmskin.geometry.domain import Domain
from ohmskin.geometry.holes import Hole, Holed, with_holes
from ohmskin.geometry.mesh import Mesh, normals, used_nodes
from ohmskin.geometry.periodic import folded, shortest
from ohmskin.geometry.polygon import Polygon
from ohmskin.geometry.raster import node_means
from ohmskin.geometry.surface import Triangles, closed_walks, closest_on_triangles, split_edges

_FINE = 40  # edges along the root of the area: longer ones are split
_MOST = 60_000  # triangles
_OUTLINE, _APART = 5e-4, 5e-3  # of the root of the area: error of an outline's corners, and how far they are apart
_LEVEL = 0.3  # correlation of heights with places on a map, below which a patch is level
_MOST_SHEARED = 1.15  # ratio of singular values that 95 % of the area may have


class MeshChart:
    """The `Chart` of a skin on triangles in space: of a patch a polygon, of a ring a closed band (`Band`); holes stay.

    A patch is flattened by spectral conformal parameterisation (Mullen et al. 2008), its rim free; a developable one
    unrolls true to lengths. A ring's y is a harmonic function between its longest rims, its x the conjugate; holes are
    filled to compute them. With several rims, the map with the more uniform scale is used. Upwards on the map is
    upwards in space, along z; of a level patch along y. A band begins where its lower rim has the least x.

    Args:
        surface: Triangles in space, counterclockwise seen from outside.
        holes: More holes, see `with_holes`; places are on the map.

    Attributes:
        flat: Whether lengths on the map are lengths on the skin, to a thousandth.
        sheared: 95 % quantile over the area of the ratio of the map's singular values; 1 is conformal.

    Raises:
        GeometryError: If triangles have mixed orientations, there is no rim, the map would fold, shear or be too
            uneven, or a hole is not on it.
    """

    def __init__(self, surface: Mesh, holes: Sequence[Hole] = ()) -> None:
        if surface.dim != 2 or surface.nodes.shape[1] != 3:
            raise GeometryError("a skin is cut from triangles in space; this mesh has none")
        if surface.n_elem > _MOST:
            raise GeometryError(f"the skin has {surface.n_elem} triangles, {_MOST} are allowed; simplify the mesh")
        _check_turns(surface)
        size = float(np.sqrt(surface.measures.sum())) / _FINE
        rims = sorted(closed_walks(surface.boundary), key=lambda walk: -float(_length(surface.nodes[walk])))
        if not rims:
            raise GeometryError("the surface is closed; cut it open, see cut")
        nodes, filling = _filling(surface, rims[2:])
        carried = np.vstack([np.hstack([surface.nodes, _node_normals(surface)]), np.tile(nodes, 2)])
        added = np.repeat([False, True], [surface.n_elem, len(filling)])
        carried, elements, added = split_edges(carried, np.vstack([surface.elements, filling]), added, size)
        kept = np.unique(elements[~added])
        filled = Mesh(carried[:, :3], elements)
        self._surface, self._normals = Mesh(*used_nodes(filled.nodes, elements[~added])), carried[kept, 3:]
        maps, refused = [], []
        for flatten in (flat_patch, flat_ring)[: len(rims)]:
            try:
                if flatten is flat_patch:
                    flat = flat_patch(self._surface)
                else:
                    ring = flat_ring(filled)
                    flat = Mesh(*used_nodes(ring.nodes, elements[~added]), period=ring.period)
                scale = node_means(flat) @ np.sqrt(self._surface.measures / flat.measures)
                maps.append((float(scale.max() / scale.min()), flat, scale))
            except GeometryError as error:
                refused.append(error)
        if not maps:
            raise refused[-1]
        _, self._flat, self._scale = min(maps, key=lambda found: found[0])
        check_even(self._scale)
        self._jacobians = np.einsum("eid,eik->edk", self._surface.corners, self._flat.gradients)  # (n_elem, 3, 2)
        stretches = np.linalg.svd(self._jacobians, compute_uv=False)
        order = np.argsort(ratio := stretches[:, 0] / stretches[:, 1])
        share = np.cumsum(self._surface.measures[order]) / self._surface.measures.sum()
        self.sheared = float(ratio[order][np.searchsorted(share, 0.95)])
        if self.sheared > _MOST_SHEARED:
            raise GeometryError(
                f"the map of this skin shears squares to {self.sheared:.3g} : 1, {_MOST_SHEARED:g} are allowed; "
                "smooth the mesh or make its triangles finer and more even"
            )
        self.flat = bool(max(abs(self._scale - 1).max(), self.sheared - 1) < 1e-3)
        self._triangles = Triangles(self._surface.nodes, self._surface.elements)
        self.domain: Domain = with_holes(_outline(self._flat), holes, self.scale)

    def __repr__(self) -> str:
        return f"MeshChart({self.domain})"

    def _at(self, places: ArrayLike) -> tuple[Ints, Floats]:
        """The triangle (n,) at places, and barycentric coordinates (n, 3); of a place outside, the closest triangle."""
        flat, given = self._flat, folded(np.asarray(places, float).reshape(-1, 2), self._flat.period)
        element, weights = flat.locate(given)
        if len(out := np.flatnonzero(element < 0)):
            near = flat.closest_elements(given[out], min(24, flat.n_elem)).reshape(len(out), -1)
            corners = flat.corners[near] - given[out, None, None]
            corners += shortest(corners[:, :, :1], flat.period) - corners[:, :, :1]  # beside the place
            corners = np.concatenate([corners, np.zeros((*corners.shape[:3], 1))], axis=3)
            away, inner = closest_on_triangles(np.zeros((len(out), 3)), corners)
            row, best = np.arange(len(out)), away.argmin(axis=1)
            element[out], weights[out] = near[row, best], inner[row, best]
        return element, weights

    def _interpolated(self, places: ArrayLike, values: Floats) -> Floats:
        element, weights = self._at(places)
        return np.asarray(np.einsum("nk,nk...->n...", weights, values[self._flat.elements[element]]))

    def points(self, places: ArrayLike) -> Floats:
        return self._interpolated(places, self._surface.nodes)

    def frames(self, places: ArrayLike) -> Floats:
        normals = self._interpolated(places, self._normals)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        jacobians = self._jacobians[self._at(places)[0]]
        x = jacobians[:, :, 0] + np.cross(jacobians[:, :, 1], normals)  # where the map's x and y both point
        x -= np.sum(x * normals, axis=1, keepdims=True) * normals
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        return np.stack([x, np.cross(normals, x), normals], axis=1)

    def scale(self, places: ArrayLike) -> Floats:
        return self._interpolated(places, self._scale)

    def project(self, points: ArrayLike) -> tuple[Floats, Floats]:
        nodes, weights, distance = self._triangles.project(np.asarray(points, float).reshape(-1, 3))
        corners, around = self._flat.nodes[nodes], self._flat.period
        corners = corners[:, :1] + shortest(corners - corners[:, :1], around)
        return folded(np.einsum("nk,nkd->nd", weights, corners), around), distance


def flat_patch(surface: Mesh) -> Mesh:
    """A `surface` of triangles in space, flattened conformally; its area is kept, its first rim free (m).

    Raises:
        GeometryError: If it would fold over.
    """
    corners = surface.elements
    turn = np.array([[0, 1, -1], [-1, 0, 1], [1, -1, 0]]) / 4j  # z* turn z is the area of a triangle (z_0, z_1, z_2)
    energy = _matrix(surface, _stiffness(surface) / 2 - turn)
    start, end = surface.boundary.T
    length = np.linalg.norm(surface.nodes[end] - surface.nodes[start], axis=1) / 2
    weight = np.bincount(start, length, surface.n_nodes) + np.bincount(end, length, surface.n_nodes)
    shift = -1e-6 / weight.sum()
    begin = np.exp(1j * np.arange(surface.n_nodes))  # anything, but always the same
    _, found = eigsh(energy, 2, sp.diags_array(weight).tocsc(), sigma=shift, v0=begin)
    along = weight @ found  # constants are maps to one point: what is at right angles to them is the map
    z = found @ np.array([along[1], -along[0]])
    z -= z.mean()
    for axis in (2, 1):  # what points to the axis z points up on the map; of a level patch, what points to y
        height = surface.nodes[:, axis] - surface.nodes[:, axis].mean()
        upwards = height @ z
        if abs(upwards) > _LEVEL * np.linalg.norm(height) * np.linalg.norm(z):
            z *= 1j * np.conj(upwards) / abs(upwards)
            break
    flat = np.column_stack([z.real, z.imag])
    areas = np.imag(np.conj(z[corners[:, 1]] - z[corners[:, 0]]) * (z[corners[:, 2]] - z[corners[:, 0]])) / 2
    flat *= np.sqrt(surface.measures.sum() / abs(areas.sum()))
    return _unfolded(flat - flat.min(axis=0), corners)


def flat_ring(surface: Mesh) -> Mesh:
    """A ring of triangles in space with two rims, unrolled to a closed band true to angles; its area is kept (m).

    Raises:
        GeometryError: If it would fold over.
    """
    rims = (walk[:-1] for walk in closed_walks(surface.boundary))
    low, high = sorted(rims, key=lambda walk: float(surface.nodes[walk, 2].mean()))
    stiffness = stiffness_matrix(surface)
    y = np.zeros(surface.n_nodes)
    y[high] = 1.0
    free = np.setdiff1d(np.arange(surface.n_nodes), np.concatenate([low, high]))
    y[free] = spsolve(stiffness[free][:, free], -(stiffness[free] @ y))
    around = float(y @ stiffness @ y)  # what flows from rim to rim is as far as x goes
    ahead = around * _beyond_seam(surface, low, high)
    slope = np.einsum("ek,ekd->ed", y[surface.elements], surface.gradients)
    slope = np.cross(slope, _units(surface)) - np.einsum("ek,ekd->ed", ahead, surface.gradients)
    load = surface.measures[:, None] * np.einsum("ed,ekd->ek", slope, surface.gradients)
    right = np.bincount(surface.elements.ravel(), load.ravel(), surface.n_nodes)
    x = np.zeros(surface.n_nodes)
    x[1:] = spsolve(stiffness[1:][:, 1:], right[1:])
    unit = float(np.sqrt(surface.measures.sum() / around))
    places = folded(unit * np.column_stack([x - x[low[surface.nodes[low, 0].argmin()]], y]), unit * around)
    return _unfolded(places, surface.elements, unit * around)


def stiffness_matrix(surface: Mesh) -> sp.csc_array:
    """Integrals (n_nodes, n_nodes) of the products of the slopes of linear shape functions."""
    return _matrix(surface, _stiffness(surface))


def _matrix(surface: Mesh, own: NDArray) -> sp.csc_array:
    """The sparse matrix (n_nodes, n_nodes) that sums matrices (n_elem, 3, 3) of elements."""
    row, column = np.repeat(surface.elements, 3, axis=1), np.tile(surface.elements, 3)
    return sp.csc_array((own.ravel(), (row.ravel(), column.ravel())), shape=(surface.n_nodes, surface.n_nodes))


def _stiffness(surface: Mesh) -> Floats:
    return np.asarray(np.einsum("e,eid,ejd->eij", surface.measures, surface.gradients, surface.gradients))


def _unfolded(places: Floats, elements: Ints, period: float = 0.0) -> Mesh:
    try:
        flat = Mesh(places, elements, period=period)
    except GeometryError as error:
        raise GeometryError(f"this surface does not lie flat without folds ({error}); cut it into two skins") from None
    if flat.flipped:
        folds = f"{flat.flipped} of {len(elements)} triangles of the map of this skin fold over"
        raise GeometryError(f"{folds}; smooth the mesh, or cut it into two skins")
    return flat


def _beyond_seam(surface: Mesh, low: Ints, high: Ints) -> Floats:
    """Which corners (n_elem, 3) are one turn ahead of what is told of their nodes: those on a seam, seen from its left.

    The seam is the shortest walk along edges from one rim to the other.
    """
    elements, n = surface.elements, surface.n_nodes
    start, end = elements.ravel(), np.roll(elements, -1, axis=1).ravel()
    lengths = np.linalg.norm(surface.nodes[end] - surface.nodes[start], axis=1)
    graph = sp.csr_array((np.tile(lengths, 2), (np.append(start, end), np.append(end, start))), shape=(n, n))
    distance, before, _ = dijkstra(graph, indices=low, min_only=True, return_predecessors=True)
    seam = [int(high[distance[high].argmin()])]
    while before[seam[-1]] >= 0:
        seam.append(int(before[seam[-1]]))
    seam = seam[::-1]
    on_seam = np.isin(elements, seam)
    element, side = np.nonzero(surface.neighbours >= 0)
    across = on_seam[element, side].astype(int) + on_seam[element, (side + 1) % 3]
    other = surface.neighbours[element, side][across == 1]
    beside = sp.csr_array((np.ones(len(other)), (element[across == 1], other)), shape=(surface.n_elem,) * 2)
    left = np.flatnonzero(((elements == seam[0]) & (np.roll(elements, -1, axis=1) == seam[1])).any(axis=1))
    part = connected_components(beside, directed=False)[1]
    return np.asarray(on_seam & (part == part[left[0]])[:, None], float)


def _units(surface: Mesh) -> Floats:
    """Unit normals (n_elem, 3)."""
    return np.asarray(normals(surface.nodes, surface.elements) / (2 * surface.measures[:, None]))


def _node_normals(surface: Mesh) -> Floats:
    """Unit normals (n_nodes, 3): those of the triangles around, each by its angle there."""
    ahead, back = (np.roll(surface.corners, -k, axis=1) - surface.corners for k in (1, 2))
    lengths = np.linalg.norm(ahead, axis=2) * np.linalg.norm(back, axis=2)
    angles = np.arccos(np.clip(np.sum(ahead * back, axis=2) / lengths, -1, 1))
    sums = np.zeros((surface.n_nodes, 3))
    np.add.at(sums, surface.elements, angles[..., None] * _units(surface)[:, None])
    return np.asarray(sums / np.linalg.norm(sums, axis=1, keepdims=True))


def _check_turns(surface: Mesh) -> None:
    """Raise GeometryError if two triangles run along their edge in the same direction."""
    edges = surface.elements[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    numbers, counts = np.unique(edges @ [surface.n_nodes, 1], return_counts=True)
    if len(twice := numbers[counts > 1]):
        edge = [int(node) for node in divmod(int(twice[0]), surface.n_nodes)]
        opposite = f"two triangles at the edge of nodes {edge[0]} and {edge[1]} have opposite orientations"
        raise GeometryError(f"{opposite}; make all normals of the mesh point outwards")


def _filling(surface: Mesh, holes: Sequence[Ints]) -> tuple[Floats, Ints]:
    """Nodes (n, 3) in the middle of holes, as many, and triangles that fill these."""
    nodes, triangles = [np.empty((0, 3))], [np.empty((0, 3), np.int64)]
    for number, walk in enumerate(holes):
        nodes.append(surface.nodes[walk[:-1]].mean(axis=0, keepdims=True))
        start, end = surface.boundary[np.isin(surface.boundary, walk).all(axis=1)].T
        triangles.append(np.column_stack([end, start, np.full(len(start), surface.n_nodes + number)]))
    return np.vstack(nodes), np.vstack(triangles)


def _length(points: Floats) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _outline(flat: Mesh) -> Domain:
    """The domain of a map: a band, or a polygon that follows its rims with few corners."""
    unit = float(np.sqrt(flat.measures.sum()))
    if flat.period:
        band, holes = Band(flat.period, float(flat.nodes[:, 1].max())), []
        for walk in closed_walks(flat.boundary):
            steps = shortest(np.diff(flat.nodes[walk], axis=0), flat.period)
            line = flat.nodes[walk[0]] + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
            if abs(line[-1, 0] - line[0, 0]) < flat.period / 2:  # it does not go round
                holes.append(_with_few_corners(line, unit))
        return Holed(band, holes) if holes else band
    rims = [_with_few_corners(flat.nodes[walk], unit) for walk in closed_walks(flat.boundary)]
    rims.sort(key=lambda rim: -float(np.ptp(rim, axis=0).max()))
    return Polygon(rims[0], rims[1:])


def _with_few_corners(line: Floats, unit: float) -> Floats:
    """Corners of a closed line that follow it closely (Ramer, Douglas and Peucker), no two of them close together."""
    far = int(np.linalg.norm(line - line[0], axis=1).argmax())
    kept, parts = {0, far}, [(0, far), (far, len(line) - 1)]
    while parts:
        first, last = parts.pop()
        step, between = line[last] - line[first], line[first : last + 1] - line[first]
        off = np.abs(between @ np.array([-step[1], step[0]])) / max(float(np.hypot(*step)), 1e-12)
        off[np.linalg.norm(between, axis=1) < _APART * unit] = 0.0
        off[np.linalg.norm(between - step, axis=1) < _APART * unit] = 0.0
        if off.max() > _OUTLINE * unit:
            middle = first + int(off.argmax())
            kept.add(middle)
            parts += [(first, middle), (middle, last)]
    for begin in (0, far):  # where the search began need not be a corner
        order = sorted(kept)
        k = order.index(begin)
        before, after = line[order[k - 1]], line[order[(k + 1) % len(order)]]
        step, between = after - before, line[begin] - before
        if len(order) > 3 and abs(step[0] * between[1] - step[1] * between[0]) < _OUTLINE * unit * np.hypot(*step):
            kept.remove(begin)
    return line[sorted(kept)]
