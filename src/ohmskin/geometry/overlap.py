"""The area that discs have in common with the triangles of a mesh: exact on flat ones, from samples in space."""

from itertools import product

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ohmskin.arrays import Floats, Ints
from ohmskin.geometry.mesh import Mesh

_STEPS = 4  # subdivisions of a cell's edges, where it is sampled


def disc_overlap(mesh: Mesh, centres: ArrayLike, radius: float) -> sp.csr_array:
    """Area (n_discs, n_elem) of each triangle inside each disc (m2; volume in space, m3); in space discs are balls.

    On flat meshes it is exact. Each edge, with the centre, spans a signed area of the disc: chords count as triangles,
    what lies beyond the disc as sectors. The sum over the three edges is the area in common.

    Args:
        centres: (n_discs, 2), or 3 in space, in metres.
        radius: Of all discs (m).
    """
    centres = np.asarray(centres, float).reshape(-1, mesh.nodes.shape[1])
    if mesh.nodes.shape[1] != 2:
        return _sampled(mesh, centres, radius)
    corners = mesh.nodes[mesh.elements]
    reach = np.linalg.norm(corners - mesh.centroids[:, None], axis=2).max()
    row, element = _near(centres, mesh.centroids, radius + reach)
    p = corners[element] - centres[row][:, None]
    area = sum(_edge(p[:, k], p[:, (k + 1) % 3], radius) for k in range(3))
    area = np.clip(area, 0.0, mesh.measures[element])
    return sp.csr_array((area, (row, element)), shape=(len(centres), mesh.n_elem))


def _sampled(mesh: Mesh, centres: Floats, radius: float) -> sp.csr_array:
    """The same of surfaces in space and tetrahedra, from a centred lattice of points in each cell."""
    corners = mesh.elements.shape[1]
    lattice = np.array([c for c in product(range(_STEPS), repeat=corners) if sum(c) == _STEPS - 1])
    weights = (lattice + 1 / corners) / _STEPS
    points = np.einsum("qc,ecd->eqd", weights, mesh.nodes[mesh.elements]).reshape(-1, mesh.nodes.shape[1])
    row, point = _near(centres, points, radius)
    share = mesh.measures[point // len(weights)] / len(weights)
    return sp.csr_array((share, (row, point // len(weights))), shape=(len(centres), mesh.n_elem))


def _near(centres: Floats, points: Floats, radius: float) -> tuple[Ints, Ints]:
    """The centre and the point of each pair (n,) that is no further apart than `radius`."""
    pairs = cKDTree(centres).sparse_distance_matrix(cKDTree(points), radius, output_type="ndarray")
    return pairs["i"], pairs["j"]


def _edge(a: Floats, b: Floats, radius: float) -> Floats:
    """Signed area (n,) between the disc's centre at the origin and the part of segments a-b (n, 2) seen from it."""
    d = b - a
    along = np.einsum("ij,ij->i", d, d)
    middle = -np.einsum("ij,ij->i", a, d) / along
    offset = np.einsum("ij,ij->i", a, a) - along * middle**2  # squared distance of the line from the centre
    reach = np.sqrt(np.maximum(radius**2 - offset, 0.0) / along)
    enter, leave = np.clip(middle - reach, 0.0, 1.0), np.clip(middle + reach, 0.0, 1.0)
    p, q = a + enter[:, None] * d, a + leave[:, None] * d
    area: Floats = 0.5 * _cross(p, q) + 0.5 * radius**2 * (_angle(a, p) + _angle(q, b))
    return area


def _cross(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _angle(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.arctan2(_cross(a, b), np.einsum("ij,ij->i", a, b)))
