"""Meshing of flat domains in even triangles, with chosen points exactly at nodes."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import Delaunay, cKDTree

from ohmskin.arrays import Floats, Ints
from ohmskin.cache import cached
from ohmskin.errors import GeometryError
from ohmskin.geometry.band import Band
from ohmskin.geometry.domain import Disc, Domain
from ohmskin.geometry.electrodes import ElectrodeKind, Electrodes
from ohmskin.geometry.holes import Holed, without_holes
from ohmskin.geometry.mesh import Mesh
from ohmskin.geometry.periodic import folded, shortest, tree, unrolled
from ohmskin.geometry.polygon import Polygon

_RINGS = (  # radii of a disc electrode, and nodes there
    *((1.0, 24), (0.5, 8), (0.8, 16), (0.92, 24), (1.08, 24), (1.2, 20)),
    *((1.5, 20), (1.9, 20), (2.4, 20), (3.1, 20), (4.0, 20)),
)

_ALONG = 100  # places along a rim that tell it from others, beside its corners

_ROUND = 1e-9  # share of a triangle's size within which four corners are on one circle


def mesh_domain(
    domain: Domain, size: float, points: ArrayLike | Electrodes | None = None, smoothing: int = 12, closest: float = 0.1
) -> Mesh:
    """A quality triangle mesh of a domain: a hexagonal lattice joined to rim and holes by Delaunay and smoothed.

    All edges are about equally long. For a mesh that is finer at the electrodes see `mesh_graded`.

    Args:
        domain: What to mesh.
        size: Edge length aimed at (m).
        points: Points (n, 2) in metres that become nodes exactly, on the rim or inside; or electrodes, whose centres
            become nodes, of rim segments the ends.
        smoothing: Rounds of moving free nodes to the mean of their neighbours.
        closest: Share of `size` that points must be apart from each other and from the rim.

    Raises:
        GeometryError: If `size` is not positive, too fine or too coarse for the shape, or a point lies outside the
            domain or too close to another or to the rim.
    """
    if isinstance(points, Electrodes):
        points = key_points(domain, points)
    if not (np.isfinite(size) and 0 < size <= domain.perimeter / 8):
        raise GeometryError(f"mesh size {size!r} m; it must be positive and at most {domain.perimeter / 8:.3g} m")
    if domain.area / size**2 > 4e6:
        raise GeometryError(f"mesh size {size!r} m makes over four million nodes; choose a coarser one")
    fixed = np.empty((0, 2)) if points is None else np.asarray(points, float).reshape(-1, 2)
    fixed = folded(fixed, domain.period)
    depth = domain.depth(fixed)
    tolerance = 1e-9 * domain.perimeter
    if len(outside := np.flatnonzero(~(depth >= -tolerance))):
        raise GeometryError(f"point {outside[0]} at {fixed[outside[0]]} lies outside {domain}; move it inside")
    on_rim = depth < tolerance

    def evenly(_: Domain, start: float, end: float) -> Floats:
        count = max(1, round((end - start) / size))
        return start + (end - start) * np.arange(count) / count

    rim = np.vstack(rim_loops(domain, fixed, tolerance, evenly))
    inner = fixed[~on_rim]
    kept = np.vstack([rim, inner])
    around = domain.period
    kept = folded(kept, around)
    gap = tree(kept, around).query(kept, k=2)[0][:, 1]
    if (to_rim := depth[~on_rim].min(initial=np.inf)) < closest * size:
        near = inner[depth[~on_rim].argmin()]
        raise GeometryError(f"point {near} is {to_rim:.2g} m away from the rim, too close for size {size:.2g}; refine")
    if gap.min() < closest * size:
        near = kept[gap.argmin()]
        raise GeometryError(f"points at {near} are {gap.min():.2g} m apart, too close for size {size:.2g} m; refine it")

    lattice = _hexagonal(domain.bounds, size, around)
    lattice = lattice[domain.depth(lattice) > 0.5 * size]
    if len(inner):
        lattice = lattice[tree(folded(inner, around), around).query(lattice)[0] > 0.6 * size]
    nodes = np.vstack([kept, lattice])
    triangles, flaps = _triangulate(nodes, size, domain)
    for _ in range(smoothing):
        start, end = triangles[:, [0, 1, 2, 1, 2, 0]].T.ravel(), triangles[:, [1, 2, 0, 0, 1, 2]].T.ravel()
        away = shortest(nodes[end] - nodes[start], around)
        sums = [np.bincount(start, weights, len(nodes)) for weights in (away[:, 0], away[:, 1], None)]
        nodes[len(kept) :] += np.stack(sums[:2], axis=1)[len(kept) :] / sums[2][len(kept) :, None]
        nodes = folded(nodes, around)
        if not _is_delaunay(nodes, flaps, around):
            triangles, flaps = _triangulate(nodes, size, domain)
    if isinstance(domain, Polygon | Band | Holed):
        return checked_mesh(nodes, triangles, domain, size)
    return Mesh(nodes, triangles)


def kept_mesh(domain: Domain, size: float, points: Floats, closest: float) -> Mesh:
    """The mesh that `mesh_domain` makes, or made on this machine before, see `cached`; arguments and errors likewise.

    Args:
        domain: What to mesh.
        size: Edge length aimed at (m).
        points: Points (n, 2) in metres that become nodes exactly.
        closest: Share of `size` that points must be apart.
    """
    loops = [(loop.perimeter, loop.rim(loop.corners), loop) for loop in (domain, *domain.holes)]
    rims = [np.vstack([corners, loop.rim(np.arange(_ALONG) * (around / _ALONG))]) for around, corners, loop in loops]

    def make() -> dict[str, Floats | Ints]:
        mesh = mesh_domain(domain, size, points, closest=closest)
        return {"nodes": mesh.nodes, "elements": mesh.elements}

    found = cached("mesh", (domain.period, size, closest, points, *rims), make)
    return Mesh(found["nodes"], found["elements"], period=domain.period)


def key_points(domain: Domain, electrodes: Electrodes) -> Floats:
    """Points (n, 2) that a mesh should have as nodes: centres of point and disc electrodes, ends of rim segments (m).

    Raises:
        GeometryError: If the electrodes are not in the plane or of another mesh, or the centre of a rim segment is not
            on the rim.
    """
    if electrodes.positions.shape[1] != 2:
        raise GeometryError("electrodes in space do not fit a flat domain; mesh it flat and move both with mapped()")
    if ElectrodeKind.FACETS in electrodes.kinds:
        raise GeometryError("electrodes of facets belong to the mesh that they were made of; use discs or rim segments")
    found: list[Floats] = []
    for k, (kind, centre) in enumerate(zip(electrodes.kinds, electrodes.positions, strict=True)):
        if kind != ElectrodeKind.RIM:
            found.append(centre[None])
            continue
        off, arc, loop = _nearest_rim(domain, centre)
        if off > 1e-6 * domain.perimeter:
            there = f"rim electrode {k} at {centre} is {off:.2g} m away from the rim"
            raise GeometryError(f"{there}; move it or use with_discs()")
        half = float(electrodes.extents[k]) / 2
        found.append(loop.rim([arc - half, arc + half]))
    # neighbours that touch share an end
    points = np.vstack(found)
    first = cKDTree(points).query(points, k=min(2, len(points)), distance_upper_bound=1e-9 * domain.perimeter)[1]
    first = first.reshape(len(points), -1)
    keep = [i for i in range(len(points)) if not any(j < i for j in first[i] if j < len(points))]
    return np.asarray(points[keep])


def _nearest_rim(domain: Domain, place: Floats) -> tuple[float, float, Domain]:
    """How far off the closest rim a place (2,) is, where along it (m), and whose it is: the domain's or a hole's."""
    arcs = [(float(loop.arc(place[None])[0]), loop) for loop in (domain, *domain.holes)]
    found = ((float(np.linalg.norm(loop.rim([arc])[0] - place)), arc, loop) for arc, loop in arcs)
    return min(found, key=lambda one: one[0])


def electrode_points(domain: Domain, electrodes: Electrodes, closest: float) -> Floats:
    """Points (n, 2) for nodes of a mesh where disc electrodes are: their centres, and rings about them (m).

    Current enters at a disc's edge. With these nodes even a mesh with edges twice as long as the radius gives
    four-terminal resistances to 0.05 %, and the effect of a contact impedance on them to 5 %; without them only the
    resistances, to 2 %.

    Args:
        domain: The sheet.
        electrodes: Discs on it.
        closest: Distance below which two such points are one (m).
    """
    centres = folded(electrodes.positions, domain.period)
    corners = np.vstack([loop.rim(loop.corners) for loop in (domain, *domain.holes)])  # a mesh has nodes there anyhow
    rings = [centres, corners]
    nearest = tree(centres, domain.period)
    for number, (centre, radius) in enumerate(zip(centres, electrodes.extents, strict=True)):
        off, arc, loop = _nearest_rim(domain, centre)
        for share, count in _RINGS:
            angle, r = 2 * np.pi * np.arange(count) / count, share * radius
            ring = centre + r * np.column_stack([np.cos(angle), np.sin(angle)])
            ring = ring[domain.depth(ring) > max(0.35 * 2 * np.pi * r / count, closest)]
            if off < 1e-6 * domain.perimeter:
                ring = np.vstack([ring, loop.rim([arc - r, arc + r])])
            ring = folded(ring, domain.period)
            rings.append(ring[nearest.query(ring)[1] == number])
    points = np.vstack(rings)
    kept = np.ones(len(points), bool)
    pairs = np.sort(tree(points, domain.period).query_pairs(closest, output_type="ndarray"), axis=1)
    for first, other in pairs[np.argsort(pairs[:, 1], kind="stable")]:  # first come, first served
        kept[other] &= not kept[first]
    kept[len(centres) : len(centres) + len(corners)] = False
    return points[kept]


def checked_mesh(nodes: Floats, triangles: Ints, domain: Domain, size: float) -> Mesh:
    """The mesh, if its area and rim are the domain's: Delaunay keeps a rim edge only if no node is close."""
    try:
        mesh = Mesh(nodes, triangles, period=domain.period)
        start, end = nodes[mesh.boundary].swapaxes(0, 1)
        off_rim = np.abs(domain.depth(start + shortest(end - start, domain.period) / 2)).max()
        sagitta = size**2 / (4 * disc.radius) if isinstance(disc := without_holes(domain), Disc) else 0.0
        off_area = abs(mesh.measures.sum() - domain.area) - sagitta * domain.perimeter
        if off_area <= 1e-9 * domain.area and off_rim - sagitta < 1e-9 * domain.perimeter:
            return mesh
    except GeometryError:
        pass
    unlike = f"a mesh of size {size:.2g} m does not follow the outline of {domain}"
    raise GeometryError(f"{unlike}; choose a finer one, or mesh_graded() (gmsh)")


def rim_loops(
    domain: Domain, fixed: Floats, tolerance: float, divide: Callable[[Domain, float, float], Floats]
) -> list[Floats]:
    """Points along the rim and along each hole: corners and the fixed ones that lie there exactly, others between.

    Args:
        domain: The sheet.
        fixed: (n, 2) in metres.
        tolerance: How far off a rim a point may be that lies on it (m).
        divide: Gives arc lengths (n,) of points of a loop between two, the first included, the second not (m).
    """
    loops = []
    for loop in (domain, *domain.holes):
        own = fixed[np.linalg.norm(loop.rim(loop.arc(fixed)) - fixed, axis=1) < tolerance]
        arcs = np.append(loop.corners, loop.arc(own) if len(own) else 0.0)
        arcs = np.unique(np.round(arcs / loop.perimeter, 12) % 1.0) * loop.perimeter  # a full turn is the start
        ends = np.append(arcs[1:], arcs[0] + loop.perimeter)
        rim = loop.rim(np.concatenate([divide(loop, start, end) for start, end in zip(arcs, ends, strict=True)]))
        if len(own):  # the arc length of a fixed point is rounded; the point itself must not be
            distance, nearest = cKDTree(rim).query(own)
            assert distance.max() < 1e-8 * loop.perimeter
            rim[nearest] = own
        loops.append(rim)
    return loops


def _hexagonal(bounds: tuple[float, float, float, float], size: float, period: float) -> Floats:
    x0, y0, x1, y1 = bounds
    rows = np.arange(y0, y1 + size, size * np.sqrt(3) / 2)
    columns = np.arange(x0 - size, x1 + size, size)
    if period:
        columns = period * np.arange(round(period / size)) / round(period / size)
    x, y = np.meshgrid(columns, rows)
    x[1::2] += size / 2
    return folded(np.column_stack([x.ravel(), y.ravel()]), period)


def _flaps(triangles: Ints) -> Ints:
    """Both ends of each edge between two triangles (n_elem, 3), and the third corner of either: (n, 4)."""
    ends = np.sort(triangles[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
    order = np.lexsort(ends.T)
    both = np.flatnonzero((ends[order[1:]] == ends[order[:-1]]).all(axis=1))
    one, other = order[both], order[both + 1]
    return np.column_stack([ends[one], triangles.ravel()[one], triangles.ravel()[other]])


def _is_delaunay(nodes: Floats, flaps: Ints, period: float) -> bool:
    """Whether the triangles of all nodes are Delaunay still: no circle about one has its neighbour's corner in it."""
    a, b, c, d = nodes[flaps.T]
    a, b, c = (shortest(corner - d, period) for corner in (a, b, c))
    squares = [(corner**2).sum(axis=1) for corner in (a, b, c)]
    crossed = [p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((b, c), (c, a), (a, b))]
    area = sum(crossed)  # twice that of a, b and c; its other neighbour is beyond ab
    inside = area * sum(square * cross for square, cross in zip(squares, crossed, strict=True))
    return bool((area * crossed[2] < 0).all() and (inside <= _ROUND * np.abs(area) ** 3).all())


def _triangulate(nodes: Floats, size: float, domain: Domain) -> tuple[Ints, Ints]:
    """The Delaunay triangles (n_elem, 3) of nodes that lie on a domain; the flaps of all, beside it, too."""
    period, given = domain.period, len(nodes)
    triangles: Ints
    if period:  # copies of what is near the seam on its other side
        low, high = nodes[:, 0] < 4 * size, nodes[:, 0] > period - 4 * size
        nodes = np.vstack([nodes, nodes[low] + [period, 0], nodes[high] - [period, 0]])
        original = np.concatenate([np.arange(given), np.flatnonzero(low), np.flatnonzero(high)])
        # four nodes on a circle, as round an electrode, must be divided alike on both sides: no circle is exact
        uneven = 1e-7 * size * np.random.default_rng(0).uniform(-1, 1, given)[original]
        triangles = Delaunay(nodes + np.outer(uneven, [1, 0])).simplices.astype(np.int64)
    else:
        triangles = Delaunay(nodes).simplices.astype(np.int64)
    p = nodes[triangles]
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    areas = 0.5 * np.abs(e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0])
    triangles = triangles[areas > 1e-4 * size**2]  # collinear rim nodes leave empty triangles behind
    if period:
        middle = nodes[triangles, 0].mean(axis=1)
        triangles = triangles[(middle > -0.01 * size) & (middle < period + 0.01 * size)]
        triangles = np.unique(np.sort(original[triangles], axis=1), axis=0)
    flaps = _flaps(triangles)
    if isinstance(domain, Polygon | Holed):  # may be hollow; the others are convex
        middle = unrolled(nodes[triangles], period).mean(axis=1)
        triangles = triangles[domain.depth(folded(middle, period)) > 0]
    return triangles, flaps
