"""Meshing of convex flat domains, with chosen points exactly at nodes."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import Delaunay, cKDTree

from ohmskin.errors import GeometryError
from ohmskin.geometry.domain import Domain, Floats
from ohmskin.geometry.mesh import Ints, Mesh


def mesh_domain(domain: Domain, size: float, points: ArrayLike | None = None, smoothing: int = 12) -> Mesh:
    """A quality triangle mesh of a convex domain: a hexagonal lattice joined to the rim by Delaunay and smoothed.

    Args:
        domain: What to mesh.
        size: Edge length aimed at (m).
        points: Points (n, 2) in metres that become nodes exactly, on the rim or inside (electrodes).
        smoothing: Rounds of moving free nodes to the mean of their neighbours.

    Raises:
        GeometryError: If `size` is not positive or too fine, or a point lies outside the domain or closer than a tenth of
            `size` to another or to the rim.
    """
    if not (np.isfinite(size) and 0 < size <= domain.perimeter / 8):
        raise GeometryError(f"mesh size {size!r} m; it must be positive and at most {domain.perimeter / 8:.3g} m")
    if domain.area / size**2 > 4e6:
        raise GeometryError(f"mesh size {size!r} m makes over four million nodes; choose a coarser one")
    fixed = np.empty((0, 2)) if points is None else np.asarray(points, float).reshape(-1, 2)
    depth = domain.depth(fixed)
    tolerance = 1e-9 * domain.perimeter
    if len(outside := np.flatnonzero(~(depth >= -tolerance))):
        raise GeometryError(f"point {outside[0]} at {fixed[outside[0]]} lies outside the domain {domain}; move it inside")
    on_rim = depth < tolerance
    rim = _rim_points(domain, size, fixed[on_rim])
    inner = fixed[~on_rim]
    kept = np.vstack([rim, inner])
    gap = cKDTree(kept).query(kept, k=2)[0][:, 1]
    if (to_rim := depth[~on_rim].min(initial=np.inf)) < 0.1 * size:
        near = inner[depth[~on_rim].argmin()]
        raise GeometryError(f"point {near} is {to_rim:.2g} m away from the rim, too close for mesh size {size:.2g} m; refine it")
    if gap.min() < 0.1 * size:
        near = kept[gap.argmin()]
        raise GeometryError(f"points about {near} are {gap.min():.2g} m apart, too close for mesh size {size:.2g} m; refine it")

    lattice = _hexagonal(domain.bounds, size)
    lattice = lattice[domain.depth(lattice) > 0.5 * size]
    if len(inner):
        lattice = lattice[cKDTree(inner).query(lattice)[0] > 0.6 * size]
    nodes = np.vstack([kept, lattice])
    triangles = _triangulate(nodes, size)
    for _ in range(smoothing):
        edges = np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        ends = np.concatenate([edges, edges[:, ::-1]])
        degree = np.bincount(ends[:, 0], minlength=len(nodes))
        mean = np.stack([np.bincount(ends[:, 0], nodes[ends[:, 1], k], len(nodes)) for k in range(2)], axis=1) / degree[:, None]
        nodes[len(kept) :] = mean[len(kept) :]
        triangles = _triangulate(nodes, size)
    return Mesh(nodes, triangles)


def _rim_points(domain: Domain, size: float, fixed: Floats) -> Floats:
    """Points along the rim: the fixed ones exactly, equal steps of about `size` between them."""
    arcs = np.concatenate([domain.corners, domain.arc(fixed) if len(fixed) else [], [0.0] if not len(fixed) else []])
    arcs = np.unique(np.round(arcs / domain.perimeter, 12) % 1.0) * domain.perimeter  # a full turn is the start
    steps = []
    for start, end in zip(arcs, np.append(arcs[1:], arcs[0] + domain.perimeter), strict=True):
        count = max(1, round((end - start) / size))
        steps.append(start + (end - start) * np.arange(count) / count)
    rim = domain.rim(np.concatenate(steps))
    if len(fixed):  # the arc length of a fixed point is rounded; the point itself must not be
        distance, nearest = cKDTree(rim).query(fixed)
        assert distance.max() < 1e-8 * domain.perimeter
        rim[nearest] = fixed
    return rim


def _hexagonal(bounds: tuple[float, float, float, float], size: float) -> Floats:
    x0, y0, x1, y1 = bounds
    rows = np.arange(y0, y1 + size, size * np.sqrt(3) / 2)
    columns = np.arange(x0 - size, x1 + size, size)
    x, y = np.meshgrid(columns, rows)
    x[1::2] += size / 2
    return np.column_stack([x.ravel(), y.ravel()])


def _triangulate(nodes: Floats, size: float) -> Ints:
    triangles: Ints = Delaunay(nodes).simplices.astype(np.int64)
    p = nodes[triangles]
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    areas = 0.5 * np.abs(e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0])
    return np.asarray(triangles[areas > 1e-4 * size**2])  # collinear rim nodes leave empty triangles behind
