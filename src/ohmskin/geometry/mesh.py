"""Triangle meshes, checked at the door."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ohmskin.errors import GeometryError
from ohmskin.geometry.domain import Floats

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Mesh:
    """A connected mesh of triangles. Clockwise triangles of a flat mesh are turned round and counted in `flipped`.

    Args:
        nodes: Node coordinates (n_nodes, 2), or (n_nodes, 3) for a curved surface, in metres.
        triangles: Node numbers (n_elem, 3).

    Raises:
        GeometryError: If shapes, numbers or coordinates are invalid, a triangle has no area, a node is unused, or the
            mesh falls into several parts.
    """

    nodes: Floats
    triangles: Ints
    flipped: int = 0

    def __post_init__(self) -> None:
        nodes, triangles = np.array(self.nodes, float), np.array(self.triangles)
        if nodes.ndim != 2 or nodes.shape[1] not in (2, 3):
            raise GeometryError(f"mesh nodes have shape {nodes.shape}; need (n, 2) or (n, 3)")
        if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0 or triangles.dtype.kind not in "iu":
            raise GeometryError(f"triangles have shape {triangles.shape} and type {triangles.dtype}; need integers (n, 3)")
        if not np.isfinite(nodes).all():
            raise GeometryError(f"mesh node {int(np.argmin(np.isfinite(nodes).all(1)))} is not finite")
        triangles = triangles.astype(np.int64)
        if triangles.min() < 0 or triangles.max() >= len(nodes):
            raise GeometryError(f"triangles name nodes {triangles.min()}..{triangles.max()}; there are {len(nodes)} nodes")
        if len(unused := np.setdiff1d(np.arange(len(nodes)), triangles)):
            raise GeometryError(f"{len(unused)} mesh nodes belong to no triangle (first: {unused[0]}); remove them")
        if nodes.shape[1] == 2:
            clockwise = _signed_areas(nodes, triangles) < 0
            triangles[clockwise] = triangles[clockwise][:, [0, 2, 1]]
            object.__setattr__(self, "flipped", int(clockwise.sum()))
        nodes.setflags(write=False)
        triangles.setflags(write=False)
        object.__setattr__(self, "nodes", nodes)
        object.__setattr__(self, "triangles", triangles)
        scale = np.ptp(nodes, axis=0).max() ** 2
        if len(bad := np.flatnonzero(self.areas <= 1e-12 * scale)):
            raise GeometryError(f"triangle {bad[0]} has no area (nodes {triangles[bad[0]].tolist()}); remove degenerate triangles")
        parts, _ = connected_components(self.adjacency, directed=False)
        if parts > 1:
            raise GeometryError(f"the mesh falls into {parts} parts that share no edge; join them or keep one")

    @property
    def n_nodes(self) -> int:
        return len(self.nodes)

    @property
    def n_elem(self) -> int:
        return len(self.triangles)

    @cached_property
    def gradients(self) -> Floats:
        """Gradients (n_elem, 3, dim) of the three linear shape functions in each triangle (1/m)."""
        p = self.nodes[self.triangles]
        e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
        a, b, c = (np.einsum("ij,ij->i", u, v) for u, v in ((e1, e1), (e1, e2), (e2, e2)))
        det = (a * c - b * b)[:, None]
        g1 = (c[:, None] * e1 - b[:, None] * e2) / det
        g2 = (a[:, None] * e2 - b[:, None] * e1) / det
        return np.stack([-g1 - g2, g1, g2], axis=1)

    @cached_property
    def areas(self) -> Floats:
        """Triangle areas (n_elem,) in m2."""
        p = self.nodes[self.triangles]
        e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
        a, b, c = (np.einsum("ij,ij->i", u, v) for u, v in ((e1, e1), (e1, e2), (e2, e2)))
        areas: Floats = 0.5 * np.sqrt(np.maximum(a * c - b * b, 0.0))
        return areas

    @cached_property
    def centroids(self) -> Floats:
        """Triangle centroids (n_elem, dim) in metres."""
        centroids: Floats = self.nodes[self.triangles].mean(axis=1)
        return centroids

    @cached_property
    def neighbours(self) -> Ints:
        """The triangle (n_elem, 3) beyond each edge (edge k joins corners k and k+1), -1 on the rim."""
        edges = np.sort(np.stack([self.triangles, np.roll(self.triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        _, edge, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
        if count.max() > 2:
            raise GeometryError("an edge belongs to more than two triangles; remove repeated or crossing triangles")
        order = np.argsort(edge.ravel(), kind="stable")
        first = np.cumsum(count) - count
        two = first[count == 2]
        neighbours = np.full(len(edges), -1, dtype=np.int64)
        neighbours[order[two]] = order[two + 1] // 3
        neighbours[order[two + 1]] = order[two] // 3
        return neighbours.reshape(-1, 3)

    @cached_property
    def adjacency(self) -> sp.csr_array:
        """Triangles that share an edge: a symmetric 0/1 matrix (n_elem, n_elem)."""
        row = np.repeat(np.arange(self.n_elem), 3)
        column = self.neighbours.ravel()
        inside = column >= 0
        ones = np.ones(int(inside.sum()))
        return sp.csr_array((ones, (row[inside], column[inside])), shape=(self.n_elem, self.n_elem))

    @cached_property
    def _node_tree(self) -> cKDTree:
        return cKDTree(self.nodes)

    @cached_property
    def _centroid_tree(self) -> cKDTree:
        return cKDTree(self.centroids)

    def nodes_at(self, points: ArrayLike, tolerance: float = 1e-7) -> Ints:
        """Numbers (n,) of the nodes at `points` (n, dim).

        Raises:
            GeometryError: If a point has no node within `tolerance` metres.
        """
        distance, node = self._node_tree.query(np.asarray(points, float))
        if len(far := np.flatnonzero(distance > tolerance)):
            raise GeometryError(
                f"point {far[0]} at {np.asarray(points)[far[0]]} is {distance[far[0]]:.3g} m away from the nearest mesh node; "
                "make the mesh with these points (mesh_domain(..., points=...))"
            )
        return np.asarray(node, np.int64)

    def closest_elements(self, points: ArrayLike, count: int = 3) -> Ints:
        """Numbers (n, count) of the triangles whose centroids are closest to `points` (n, dim)."""
        return np.asarray(self._centroid_tree.query(np.asarray(points, float), k=count)[1], np.int64)

    def locate(self, points: ArrayLike) -> tuple[Ints, Floats]:
        """The triangle (n,) that holds each of `points` (n, 2), -1 outside, and the barycentric coordinates (n, 3) there.

        Raises:
            GeometryError: If the mesh is a surface in space.
        """
        if self.nodes.shape[1] != 2:
            raise GeometryError("locate() needs a flat mesh; project the points of a curved one yourself")
        points = np.asarray(points, float)
        element, barycentric = np.full(len(points), -1), np.zeros((len(points), 3))
        reach = np.linalg.norm(self.nodes[self.triangles] - self.centroids[:, None], axis=2).max()
        left, count = np.arange(len(points)), min(16, self.n_elem)
        while len(left):
            distance, candidates = (a.reshape(len(left), -1) for a in self._centroid_tree.query(points[left], k=count))
            corner = self.nodes[self.triangles[candidates][:, :, 0]]
            inner = np.einsum("nkvd,nkd->nkv", self.gradients[candidates][:, :, 1:], points[left][:, None] - corner)
            weights = np.concatenate([1 - inner.sum(2, keepdims=True), inner], axis=2)
            row, best = np.arange(len(left)), weights.min(axis=2).argmax(axis=1)
            barycentric[left] = weights[row, best]
            found = barycentric[left].min(axis=1) >= -1e-9
            element[left[found]] = candidates[row, best][found]
            # where small triangles crowd round a large one, its centroid is not among the closest: look further
            left = left[~found & (distance[:, -1] <= reach) & (count < self.n_elem)]
            count = min(4 * count, self.n_elem)
        return element, barycentric


def _signed_areas(nodes: Floats, triangles: Ints) -> Floats:
    p = nodes[triangles]
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    areas: Floats = 0.5 * (e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0])
    return areas
