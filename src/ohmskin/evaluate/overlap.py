"""The exact area that a disc has in common with each triangle of a mesh."""

import numpy as np
from numpy.typing import NDArray

from ohmskin.geometry import Mesh
from ohmskin.geometry.domain import Floats


def disc_overlap(mesh: Mesh, centre: tuple[float, float], radius: float) -> Floats:
    """Area (n_elem,) of each triangle of a flat mesh inside a disc, exact (m2).

    Each edge, with the centre, spans a signed area of the disc: chords count as triangles, what lies beyond the disc as
    sectors. The sum over the three edges is the area in common.
    """
    corners = mesh.nodes[mesh.triangles] - np.asarray(centre, float)
    middle = corners.mean(axis=1)
    reach = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    near = np.flatnonzero(np.linalg.norm(middle, axis=1) < radius + reach)
    area = np.zeros(mesh.n_elem)
    p = corners[near]
    area[near] = sum(_edge(p[:, k], p[:, (k + 1) % 3], radius) for k in range(3))
    return np.clip(area, 0.0, mesh.areas)


def _edge(a: Floats, b: Floats, radius: float) -> Floats:
    """Signed area (n,) between the disc's centre at the origin and the part of segments a-b (n, 2) seen from it."""
    d = b - a
    along = np.einsum("ij,ij->i", d, d)
    mid = -np.einsum("ij,ij->i", a, d) / along
    offset = np.einsum("ij,ij->i", a, a) - along * mid**2  # squared distance of the line from the centre
    reach = np.sqrt(np.maximum(radius**2 - offset, 0.0) / along)
    enter, leave = np.clip(mid - reach, 0.0, 1.0), np.clip(mid + reach, 0.0, 1.0)
    p, q = a + enter[:, None] * d, a + leave[:, None] * d
    area: Floats = 0.5 * _cross(p, q) + 0.5 * radius**2 * (_angle(a, p) + _angle(q, b))
    return area


def _cross(a: Floats, b: Floats) -> NDArray[np.float64]:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _angle(a: Floats, b: Floats) -> NDArray[np.float64]:
    return np.asarray(np.arctan2(_cross(a, b), np.einsum("ij,ij->i", a, b)))
