"""The area that discs have in common with the triangles of a mesh: exact on flat ones, from samples in space."""

from itertools import product

import numpy as np
import scipy.sparse as sp
from numba import njit
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints
from ohmskin.geometry.mesh import Mesh
from ohmskin.geometry.periodic import folded, tree

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
    centres = folded(centres, mesh.period)
    row, element = _near(centres, mesh.centroids, radius + mesh.reach, mesh.period)
    period = float(mesh.period)
    area = _areas(centres[row], np.ascontiguousarray(element), mesh.corners, mesh.measures, float(radius), period)
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


def _near(centres: Floats, points: Floats, radius: float, period: float = 0.0) -> tuple[Ints, Ints]:
    """The centre and the point of each pair (n,) that is no further apart than `radius`."""
    pairs = tree(centres, period).sparse_distance_matrix(tree(points, period), radius, output_type="ndarray")
    return pairs["i"], pairs["j"]


@njit(cache=True, nogil=True)
def _areas(centres: Floats, element: Ints, corners: Floats, measures: Floats, radius: float, period: float) -> Floats:
    """Area (n,) that the disc at each of the centres (n, 2) has in common with one of the triangles."""
    areas, seen = np.empty(len(element)), np.empty((3, 2))
    for n in range(len(element)):
        triangle = corners[element[n]]
        first = triangle[0] - centres[n]
        if period > 0.0:
            first[0] -= period * np.rint(first[0] / period)
        inside = 0
        for k in range(3):
            seen[k, 0] = first[0] + (triangle[k, 0] - triangle[0, 0])
            seen[k, 1] = first[1] + (triangle[k, 1] - triangle[0, 1])
            inside += seen[k, 0] ** 2 + seen[k, 1] ** 2 <= radius**2
        areas[n] = measures[element[n]]
        if inside < 3:
            area = 0.0
            for k in range(3):
                after = (k + 1) % 3
                area += _edge(seen[k, 0], seen[k, 1], seen[after, 0], seen[after, 1], radius)
            areas[n] = min(max(area, 0.0), areas[n])
    return areas


@njit(cache=True, nogil=True)
def _edge(ax: float, ay: float, bx: float, by: float, radius: float) -> float:
    """Signed area between the disc's centre at the origin and the part of the segment a-b seen from it."""
    dx, dy = bx - ax, by - ay
    along = dx * dx + dy * dy
    middle = -(ax * dx + ay * dy) / along
    offset = ax * ax + ay * ay - along * middle**2  # squared distance of the line from the centre
    reach = np.sqrt(max(radius**2 - offset, 0.0) / along)
    enter, leave = min(max(middle - reach, 0.0), 1.0), min(max(middle + reach, 0.0), 1.0)
    px, py, qx, qy = ax + enter * dx, ay + enter * dy, ax + leave * dx, ay + leave * dy
    sectors = 0.0
    if enter > 0.0:
        sectors += np.arctan2(ax * py - ay * px, ax * px + ay * py)
    if leave < 1.0:
        sectors += np.arctan2(qx * by - qy * bx, qx * bx + qy * by)
    return float(0.5 * (px * qy - py * qx) + 0.5 * radius**2 * sectors)
