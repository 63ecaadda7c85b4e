"""Meshes of triangles or tetrahedra, checked when they are made."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import factorial

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ohmskin.arrays import Floats, Ints, ReadOnly, real
from ohmskin.errors import GeometryError
from ohmskin.geometry.periodic import folded, shortest, tree, unrolled

_NOUNS = {2: ("triangle", "triangles", "edge", "area"), 3: ("tetrahedron", "tetrahedra", "face", "volume")}

_FARTHEST = 1e100  # m
_TRIED = 4  # elements, before all that may hold a point are looked at
_THINNEST = 1e-7  # of an element's longest edge to the power of its dimension: its square must survive rounding


@dataclass(frozen=True, eq=False)
class Mesh(ReadOnly):
    """A connected mesh: triangles of a flat sheet or of a curved surface in space, or tetrahedra of a thick skin.

    Clockwise triangles of a flat mesh and inverted tetrahedra are reoriented and counted in `flipped`.

    Args:
        nodes: Node coordinates (n_nodes, 2), or (n_nodes, 3) in space, in metres.
        elements: Node numbers (n_elem, 3) of triangles or (n_elem, 4) of tetrahedra.
        period: Of a closed band: x = 0 and x = `period` are the same place (m). 0 for all other meshes.

    Raises:
        GeometryError: If shapes, numbers or coordinates are invalid, an element has no area or volume, a node is
            unused, the mesh consists of several parts, or two elements lie on the same side of what they share.
    """

    nodes: Floats
    elements: Ints
    flipped: int = 0
    period: float = 0.0

    def __post_init__(self) -> None:
        nodes, elements = real(self.nodes, "mesh nodes are", GeometryError).copy(), np.array(self.elements)
        if nodes.ndim != 2 or nodes.shape[1] not in (2, 3):
            raise GeometryError(f"mesh nodes have shape {nodes.shape}; need (n, 2) or (n, 3)")
        corners = elements.shape[1] if elements.ndim == 2 else 0
        if corners not in (3, 4) or len(elements) == 0 or elements.dtype.kind not in "iu":
            given = f"elements have shape {elements.shape} and type {elements.dtype}"
            raise GeometryError(f"{given}; need integers (n, 3) for triangles or (n, 4) for tetrahedra")
        if corners == 4 and nodes.shape[1] == 2:
            raise GeometryError("four nodes make tetrahedra and need nodes (n, 3); split quadrilaterals into triangles")
        noun, nouns, facet, measure = _NOUNS[corners - 1]
        if not (within := (np.abs(nodes) < _FARTHEST).all(axis=1)).all():  # false for nan
            raise GeometryError(f"mesh node {int(np.argmin(within))} is not finite, or beyond {_FARTHEST:g} m")
        if self.period and not (nodes.shape[1] == 2 and nodes[:, 0].min() >= 0 and nodes[:, 0].max() < self.period):
            raise GeometryError(f"a closed band of period {self.period!r} m needs flat nodes with x from 0 to below it")
        elements = elements.astype(np.int64)
        if elements.min() < 0 or elements.max() >= len(nodes):
            raise GeometryError(f"{nouns} name nodes {elements.min()}..{elements.max()}; there are {len(nodes)} nodes")
        if len(unused := np.flatnonzero(np.bincount(elements.ravel(), minlength=len(nodes)) == 0)):
            raise GeometryError(f"{len(unused)} mesh nodes belong to no {noun} (first: {unused[0]}); remove them")
        if nodes.shape[1] == corners - 1:
            inverted = _determinants(_edges(unrolled(nodes[elements], self.period))) < 0
            elements[inverted, -2:] = elements[inverted, -2:][:, ::-1]
            object.__setattr__(self, "flipped", int(inverted.sum()))
        nodes.setflags(write=False)
        elements.setflags(write=False)
        object.__setattr__(self, "nodes", nodes)
        object.__setattr__(self, "elements", elements)
        longest = np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=1), axis=2).max(axis=1)
        if len(bad := np.flatnonzero(self.measures <= _THINNEST * longest**self.dim)):
            where = f"{noun} {bad[0]} has no {measure} (nodes {elements[bad[0]].tolist()})"
            raise GeometryError(f"{where}; remove degenerate {nouns}")
        parts, _ = connected_components(self.adjacency, directed=False)
        if parts > 1:
            raise GeometryError(f"the mesh consists of {parts} parts that share no {facet}; join them or keep one")
        if nodes.shape[1] == corners - 1:
            self._check_folds()

    def _check_folds(self) -> None:
        element, side = np.nonzero(self.neighbours >= 0)
        other, facet = self.neighbours[element, side], self._facets[element, side]
        beyond = self.nodes[self.elements[other].sum(axis=1) - facet.sum(axis=1)] - self.nodes[facet[:, 0]]
        beyond = shortest(beyond, self.period)
        inwards = self.gradients[element, side - 1]  # of the corner across from the facet
        if len(folded := np.flatnonzero(np.einsum("nd,nd->n", inwards, beyond) >= 0)):
            _, nouns, facet_name, _ = _NOUNS[self.dim]
            both = f"{nouns} {element[folded[0]]} and {other[folded[0]]} lie on the same side of their {facet_name}"
            raise GeometryError(f"the mesh is folded: {both}; a flat mesh must not overlap itself")

    def __repr__(self) -> str:
        return f"Mesh({self.n_elem} {_NOUNS[self.dim][1]}, {self.n_nodes} nodes in {self.nodes.shape[1]} dimensions)"

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def n_elem(self) -> int:
        """Number of elements."""
        return len(self.elements)

    @property
    def dim(self) -> int:
        """2 for triangles, 3 for tetrahedra; `nodes.shape[1]` is the dimension of the space around."""
        return int(self.elements.shape[1]) - 1

    @property
    def noun(self) -> str:
        """What one element is called."""
        return _NOUNS[self.dim][0]

    @cached_property
    def corners(self) -> Floats:
        """Corners (n_elem, dim + 1, dim of space) of each element (m); of a closed band, all beside the first one."""
        return unrolled(self.nodes[self.elements], self.period)

    @cached_property
    def gradients(self) -> Floats:
        """Gradients (n_elem, dim + 1, dim of space) of each element's linear shape functions, tangential (1/m)."""
        edges = _edges(self.corners)
        gram = np.einsum("eid,ejd->eij", edges, edges)
        if self.dim == 3:
            inner = np.linalg.solve(gram, edges)
        else:  # written out: a general solver takes ten times as long for 2 x 2
            determinant = (gram[:, 0, 0] * gram[:, 1, 1] - gram[:, 0, 1] ** 2)[:, None]
            first = (gram[:, 1, 1, None] * edges[:, 0] - gram[:, 0, 1, None] * edges[:, 1]) / determinant
            second = (gram[:, 0, 0, None] * edges[:, 1] - gram[:, 0, 1, None] * edges[:, 0]) / determinant
            inner = np.stack([first, second], axis=1)
        return np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)

    @cached_property
    def measures(self) -> Floats:
        """Areas (n_elem,) of triangles in m2, volumes of tetrahedra in m3."""
        edges = _edges(self.corners)
        if edges.shape[1] == edges.shape[2]:
            return np.asarray(np.abs(_determinants(edges)) / factorial(self.dim))
        return np.asarray(np.linalg.norm(normals(self.nodes, self.elements), axis=1) / 2)

    @cached_property
    def centroids(self) -> Floats:
        """Centroids (n_elem, dim of space) in metres."""
        return folded(self.corners.mean(axis=1), self.period)

    @cached_property
    def _radii(self) -> Floats:
        """Farthest (n_elem,) that a corner is from the centroid of its element (m)."""
        offsets = self.corners - self.corners.mean(axis=1, keepdims=True)
        return np.asarray(np.linalg.norm(offsets, axis=2).max(axis=1))

    @property
    def reach(self) -> float:
        """Largest distance of a corner from the centroid of its element (m)."""
        return float(self._radii.max())

    @cached_property
    def _sizes(self) -> list[tuple[float, Ints, cKDTree]]:
        """Elements alike in size: how far one reaches (m), their numbers, what finds their centroids.

        Few of a size are near a point, however finely the mesh is graded elsewhere.
        """
        size = np.frexp(self._radii)[1]
        alike = [(float(2.0**k), np.flatnonzero(size == k)) for k in np.unique(size)]
        return [(radius, members, tree(self.centroids[members], self.period)) for radius, members in alike]

    @cached_property
    def _facets(self) -> Ints:
        """Nodes (n_elem, dim + 1, dim) of each element's facets: facet k joins corners k, k + 1, ..., all but k - 1."""
        corners = self.dim + 1
        return self.elements[:, (np.arange(corners)[:, None] + np.arange(self.dim)) % corners]

    @cached_property
    def neighbours(self) -> Ints:
        """The element (n_elem, dim + 1) beyond each facet, -1 on the rim; facet k is across from corner k - 1.

        Raises:
            GeometryError: If more than two elements share a facet.
        """
        facets = np.sort(self._facets.reshape(-1, self.dim), axis=1)
        facet = facets @ (self.n_nodes ** np.arange(self.dim, dtype=np.int64))  # one number for each: quick to sort
        order = np.argsort(facet, kind="stable")
        same = np.diff(facet[order]) == 0
        if (same[1:] & same[:-1]).any():
            _, nouns, facet_name, _ = _NOUNS[self.dim]
            name = ("an " if self.dim == 2 else "a ") + facet_name
            raise GeometryError(f"{name} belongs to more than two {nouns}; remove repeated or crossing {nouns}")
        one, other = order[:-1][same], order[1:][same]
        neighbours = np.full(len(facets), -1, dtype=np.int64)
        neighbours[one], neighbours[other] = other // (self.dim + 1), one // (self.dim + 1)
        return neighbours.reshape(-1, self.dim + 1)

    @cached_property
    def adjacency(self) -> sp.csr_array:
        """Elements that share a facet: a symmetric 0/1 matrix (n_elem, n_elem)."""
        row = np.repeat(np.arange(self.n_elem), self.dim + 1)
        column = self.neighbours.ravel()
        inside = column >= 0
        ones = np.ones(int(inside.sum()))
        return sp.csr_array((ones, (row[inside], column[inside])), shape=(self.n_elem, self.n_elem))

    @cached_property
    def stencil(self) -> tuple[Ints, Ints, NDArray[np.int32]]:
        """The pattern of a sparse matrix that ties the nodes of each element; made once for all conductivities.

        In compressed columns: where each begins (n_nodes + 1,), the row of each entry (n_entries,), rising within a
        column, and the entry (n_elem, dim + 1, dim + 1) of each row and column of an element's own matrix.
        """
        entries = self.elements[:, None, :] * self.n_nodes + self.elements[:, :, None]
        entries, slots = np.unique(entries, return_inverse=True)
        indptr = np.searchsorted(entries, np.arange(self.n_nodes + 1) * self.n_nodes)
        return indptr, entries % self.n_nodes, slots.astype(np.int32).reshape(*self.elements.shape, -1)

    @cached_property
    def boundary(self) -> Ints:
        """Nodes (n_facets, dim) of the facets of one element only: edges of a sheet's rim, faces of a thick skin."""
        return self._facets[self.neighbours < 0]

    @cached_property
    def _node_tree(self) -> cKDTree:
        return tree(self.nodes, self.period)

    @cached_property
    def _centroid_tree(self) -> cKDTree:
        return tree(self.centroids, self.period)

    def mapped(self, move: Callable[[Floats], ArrayLike]) -> "Mesh":
        """The same elements with nodes (n_nodes, dim) moved by `move` to (n_nodes, 2 or 3) (m): a sheet round a link.

        Raises:
            GeometryError: If they make no mesh there.
        """
        return Mesh(np.asarray(move(self.nodes), float), self.elements)

    def nodes_at(self, points: ArrayLike, tolerance: float = 1e-7) -> Ints:
        """Numbers (n,) of the nodes at `points` (n, dim).

        Raises:
            GeometryError: If a point has no node within `tolerance` metres.
        """
        points = self._points(points)
        distance, node = self._node_tree.query(folded(points, self.period))
        if len(far := np.flatnonzero(distance > tolerance)):
            where = f"point {far[0]} at {points[far[0]]} is {distance[far[0]]:.3g} m away from the nearest mesh node"
            raise GeometryError(f"{where}; make the mesh with these points (mesh_domain(..., points=...))")
        return np.asarray(node, np.int64)

    def closest_elements(self, points: ArrayLike, count: int = 3) -> Ints:
        """Numbers (n, count) of the elements whose centroids are closest to `points` (n, dim of space) (m); raises
        GeometryError if the points have another dimension."""
        return np.asarray(self._centroid_tree.query(folded(self._points(points), self.period), k=count)[1], np.int64)

    def locate(self, points: ArrayLike) -> tuple[Ints, Floats]:
        """The element (n,) of each of `points` (n, dim), -1 outside, and its barycentric coordinates (n, dim + 1).

        Raises:
            GeometryError: If the mesh is a surface in space.
        """
        if self.nodes.shape[1] != self.dim:
            raise GeometryError("locate() needs a flat mesh; project the points of a curved one yourself")
        points = folded(self._points(points), self.period)
        element, barycentric = np.full(len(points), -1), np.zeros((len(points), self.dim + 1))
        tried = self._centroid_tree.query(points, range(1, min(_TRIED, self.n_elem) + 1))[1]
        for candidate in tried.T:  # most points are well inside one of the elements with the closest centroids
            left = np.flatnonzero(element < 0)
            weights, least = self._barycentric(points[left], candidate[left])
            inside = least > 1e-9
            element[left[inside]], barycentric[left[inside]] = candidate[left[inside]], weights[inside]
        for radius, members, centroids in self._sizes:
            if not len(left := np.flatnonzero(element < 0)):
                break
            near = centroids.sparse_distance_matrix(tree(points[left], self.period), radius, output_type="ndarray")
            candidate, point = members[near["i"]], left[near["j"]]
            weights, least = self._barycentric(points[point], candidate)
            best = np.argsort(least)  # the last one said of a point stands
            best = best[least[best] >= -1e-9]
            element[point[best]], barycentric[point[best]] = candidate[best], weights[best]
        return element, barycentric

    def _barycentric(self, points: Floats, element: Ints) -> tuple[Floats, Floats]:
        """Barycentric coordinates (n, dim + 1) of points (n, dim), each in an element (n,), and the least of each."""
        offset = shortest(points - self.nodes[self.elements[element, 0]], self.period)
        inner = np.einsum("nkd,nd->nk", self.gradients[element, 1:], offset)
        weights = np.concatenate([1 - inner.sum(1, keepdims=True), inner], axis=1)
        return weights, weights.min(axis=1)

    def interpolation(self, points: ArrayLike) -> tuple[sp.csr_array, NDArray[np.bool_]]:
        """Rows (n_inside, n_nodes) from nodal values to those of `points` (n, dim) on the mesh, and which (n,) are.

        Raises:
            GeometryError: If the mesh is a surface in space.
        """
        element, barycentric = self.locate(points)
        inside = element >= 0
        return self.weighted(self.elements[element[inside]], barycentric[inside]), inside

    def weighted(self, nodes: Ints, weights: Floats) -> sp.csr_array:
        """Rows (n, n_nodes) that sum the values of nodes (n, k) with weights (n, k)."""
        row = np.repeat(np.arange(len(nodes)), nodes.shape[1])
        return sp.csr_array((weights.ravel(), (row, nodes.ravel())), shape=(len(nodes), self.n_nodes))

    def _points(self, points: ArrayLike) -> Floats:
        given = np.asarray(points, float)
        if given.ndim != 2 or given.shape[1] != self.nodes.shape[1]:
            raise GeometryError(f"points have shape {given.shape}; this mesh needs (n, {self.nodes.shape[1]})")
        return given


def _determinants(edges: Floats) -> Floats:
    """Determinants (n_elem,) of (n_elem, dim, dim); in the plane written out, which is several times as quick."""
    if edges.shape[1] == 2:
        return np.asarray(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    return np.asarray(np.linalg.det(edges))


def _edges(corners: Floats) -> Floats:
    """Vectors (n_elem, dim, dim of space) from the first corner to the others."""
    return np.asarray(corners[:, 1:] - corners[:, :1])


def used_nodes(nodes: Floats, elements: Ints) -> tuple[Floats, Ints]:
    """The nodes that elements (n, k) name, and the elements by their numbers among these."""
    used, own = np.unique(elements, return_inverse=True)
    return nodes[used], own.reshape(elements.shape).astype(np.int64)


def facet_measures(nodes: Floats, facets: Ints, period: float = 0.0) -> Floats:
    """Lengths (n,) of edges (n, 2) in metres, areas of triangles (n, 3) in m2, in any space of their nodes."""
    corners = nodes[facets]
    if facets.shape[1] == 2:
        return np.asarray(np.linalg.norm(shortest(corners[:, 1] - corners[:, 0], period), axis=1))
    return np.asarray(np.linalg.norm(normals(nodes, facets), axis=1) / 2)


def normals(nodes: Floats, triangles: Ints) -> Floats:
    """Normals (n, 3) of triangles in space by the right-hand rule, twice as long as their areas."""
    edges = _edges(nodes[triangles])
    return np.asarray(np.cross(edges[:, 0], edges[:, 1]))
