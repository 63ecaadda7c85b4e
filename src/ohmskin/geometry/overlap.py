"""The exact area that discs have in common with the triangles of a mesh."""

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ohmskin.geometry.domain import Floats
from ohmskin.geometry.mesh import Mesh


def disc_overlap(mesh: Mesh, centres: ArrayLike, radius: float) -> sp.csr_array:
    """Area (n_discs, n_elem) of each triangle of a flat mesh inside each disc, exact (m2).

    Each edge, with the centre, spans a signed area of the disc: chords count as triangles, what lies beyond the disc as
    sectors. The sum over the three edges is the area in common.

    Args:
        mesh: The mesh.
        centres: (n_discs, 2) in metres.
        radius: Of all discs (m).
    """
    centres = np.asarray(centres, float).reshape(-1, 2)
    corners = mesh.nodes[mesh.elements]
    reach = np.linalg.norm(corners - mesh.centroids[:, None], axis=2).max()
    near = cKDTree(mesh.centroids).query_ball_point(centres, radius + reach)
    row = np.repeat(np.arange(len(centres)), [len(found) for found in near])
    element = np.concatenate([np.asarray(found, np.int64) for found in near])
    p = corners[element] - centres[row][:, None]
    area = sum(_edge(p[:, k], p[:, (k + 1) % 3], radius) for k in range(3))
    area = np.clip(area, 0.0, mesh.measures[element])
    return sp.csr_array((area, (row, element)), shape=(len(centres), mesh.n_elem))


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
