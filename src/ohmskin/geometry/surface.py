"""Triangles in space: the points of theirs that are closest to others, and the walks along their rims."""

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import GeometryError
from ohmskin.geometry.mesh import normals, used_nodes

_OFF = 0.1  # of a surface's extent, that a place on it may be off
_ONE_SIDED = 0.3  # sum of the normals over that of their sizes: 0 of a pipe, 1 of a flat sheet, half of half a ball
_SNAP = 0.05  # of the shortest edge at a node: closer to a plane, it is on it


class Triangles:
    """Triangles in space, to look for the point of theirs that is closest to another.

    Args:
        nodes: (n_nodes, 3) in metres.
        triangles: (n, 3) node numbers.

    Attributes:
        centroids: What finds the centroids that are closest to a point.
        reach: Farthest that a corner is from the centroid of its triangle (m).
    """

    def __init__(self, nodes: Floats, triangles: Ints) -> None:
        self.nodes, self.triangles = nodes, triangles
        corners = nodes[triangles]
        middles = corners.mean(axis=1)
        self.reach = float(np.linalg.norm(corners - middles[:, None], axis=2).max())
        self.centroids = cKDTree(middles)

    def project(self, points: Floats, among: Ints | None = None) -> tuple[Ints, Floats, Floats]:
        """The closest surface point of each point (n, 3): nodes (n, 3), barycentric coordinates (n, 3), distance (n,).

        Looks at the triangles `among` (m,), or at the 24 with the closest centroids, which serves without slivers.
        """
        chosen, weights, distance = np.empty(len(points), np.int64), np.empty((len(points), 3)), np.empty(len(points))
        size = 4096 if among is None else 64
        for start in range(0, len(points), size):  # in blocks, to save memory
            block = slice(start, start + size)
            count = min(24, len(self.triangles))
            near = among if among is not None else self.centroids.query(points[block], k=range(1, count + 1))[1]
            away, barycentric = closest_on_triangles(points[block], self.nodes[self.triangles[near]])
            row, best = np.arange(len(away)), away.argmin(axis=1)
            chosen[block] = np.broadcast_to(near, away.shape)[row, best]
            weights[block], distance[block] = barycentric[row, best], away[row, best]
        return self.triangles[chosen], weights, distance


def closest_on_triangles(points: Floats, corners: Floats) -> tuple[Floats, Floats]:
    """Distances (n, m) of points (n, 3) from triangles, and barycentric coordinates (n, m, 3) of the closest points.

    The corners are (m, 3, 3) of the same triangles for all, or (n, m, 3, 3).
    """
    corners = corners if corners.ndim == 4 else corners[None]
    edges = corners[:, :, 1:] - corners[:, :, :1]
    inner = np.linalg.solve(np.einsum("nmid,nmjd->nmij", edges, edges), edges)
    offset = points[:, None] - corners[:, :, 0]
    local = np.matmul(inner, offset[..., None])[..., 0]
    best = np.concatenate([1 - local.sum(axis=2, keepdims=True), local], axis=2)
    plane = np.linalg.norm(offset - np.matmul(local[..., None, :], edges)[..., 0, :], axis=2)
    distance = np.where((best >= 0).all(axis=2), plane, np.inf)
    for k in range(3):
        start, step = corners[:, :, k], corners[:, :, (k + 1) % 3] - corners[:, :, k]
        along = np.sum((points[:, None] - start) * step, axis=2) / np.sum(step**2, axis=2)
        share = np.clip(along, 0.0, 1.0)
        length = np.linalg.norm(points[:, None] - start - share[..., None] * step, axis=2)
        on_edge = np.zeros_like(best)
        on_edge[:, :, k], on_edge[:, :, (k + 1) % 3] = 1 - share, share
        best = np.where((length < distance)[..., None], on_edge, best)
        distance = np.minimum(distance, length)
    return distance, best


def closed_walks(edges: Ints) -> list[Ints]:
    """Closed walks along edges (n, 2), each as node numbers with the first repeated at its end.

    They begin in the direction of their first edge, which is counterclockwise round a flat sheet.
    """
    beside: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    if pinched := [node for node, others in beside.items() if len(others) != 2]:
        raise GeometryError(f"the rim touches itself at node {pinched[0]}; split the mesh there")
    walks = []
    while beside:
        walk = [next(iter(beside))]
        while walk[-1] in beside:
            ahead = [node for node in beside.pop(walk[-1]) if node in beside]
            walk.append(ahead[0] if ahead else walk[0])
        walks.append(np.array(walk, np.int64))
    return walks


def check_outside(nodes: Floats, triangles: Ints) -> None:
    """Raise GeometryError if triangles are clockwise seen from outside, of a closed surface or of one like a tube.

    What faces one side more than the other, as a bowl does, may be a skin on its inside, and so may what has one rim.
    """
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    alone = edges[~np.isin(edges @ [len(nodes), 1], edges @ [1, len(nodes)])]
    try:
        rims = closed_walks(alone)
    except GeometryError:
        return
    outwards = normals(nodes, triangles)
    one_sided = np.linalg.norm(outwards.sum(axis=0)) > _ONE_SIDED * np.linalg.norm(outwards, axis=1).sum()
    if len(rims) == 1 or one_sided:
        return
    first, second, third = nodes[triangles].swapaxes(0, 1)
    volume = float(np.sum(first * np.cross(second, third)))
    for walk in rims:  # a lid on each, of triangles about its middle
        start, end = nodes[alone[np.isin(alone[:, 0], walk)]].swapaxes(0, 1)
        volume += float(np.cross(end, start).sum(axis=0) @ nodes[walk[:-1]].mean(axis=0))
    if volume < 0:
        raise GeometryError("its triangles are clockwise seen from outside; reverse them: normals must point outwards")


def split_edges(
    nodes: Floats, elements: Ints, marks: NDArray[np.bool_], size: float
) -> tuple[Floats, Ints, NDArray[np.bool_]]:
    """Triangles whose edges are at most `size` long (m): the longest edges are halved, and all of a node with them.

    Args:
        nodes: (n_nodes, 3 or more), places first (m), then whatever is to be halved, too.
        elements: (n, 3) node numbers.
        marks: (n,) of triangles; parts of one have its mark.
        size: Longest edge (m).
    """
    while True:
        edges = np.sort(elements[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2), axis=1)
        numbers, own, counts = np.unique(edges @ [len(nodes), 1], return_inverse=True, return_counts=True)
        ends = np.stack(np.divmod(numbers, len(nodes)))
        lengths = np.linalg.norm(nodes[ends[0], :3] - nodes[ends[1], :3], axis=1)
        rank = np.empty(len(numbers), np.int64)
        rank[np.argsort(lengths, kind="stable")] = np.arange(len(numbers))
        own = own.reshape(-1, 3)
        corner = rank[own].argmax(axis=1)  # across from the longest edge
        longest = own[np.arange(len(own)), corner]
        halved = (np.bincount(longest, minlength=len(numbers)) == counts) & (lengths > size)  # longest on both sides
        if not halved.any():
            return nodes, elements, marks
        middle = len(nodes) + np.cumsum(halved) - 1
        nodes = np.vstack([nodes, nodes[ends[:, halved]].mean(axis=0)])
        cut = halved[longest]
        a, b, c = (elements[np.flatnonzero(cut), (corner[cut] + k) % 3] for k in range(3))
        m = middle[longest[cut]]
        elements = np.vstack([elements[~cut], np.column_stack([a, b, m]), np.column_stack([a, m, c])])
        marks = np.concatenate([marks[~cut], marks[cut], marks[cut]])


def pieces(nodes: Floats, triangles: Ints, crease: float = np.pi) -> Ints:
    """Which piece (n,) each triangle is of: two are of one that share an edge where their normals differ less.

    Args:
        nodes: (n_nodes, 3) in metres.
        triangles: (n, 3) node numbers.
        crease: Angle between normals (rad) from which on an edge parts pieces.
    """
    units = normals(nodes, triangles)
    units /= np.maximum(np.linalg.norm(units, axis=1, keepdims=True), 1e-300)
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1) @ [len(nodes), 1]
    order = np.argsort(edges, kind="stable")
    same = np.flatnonzero(edges[order[1:]] == edges[order[:-1]])
    one, other = order[same] // 3, order[same + 1] // 3
    smooth = np.sum(units[one] * units[other], axis=1) >= np.cos(crease)
    graph = sp.csr_array((smooth[smooth], (one[smooth], other[smooth])), shape=(len(triangles),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def grown(nodes: Floats, triangles: Ints, seed: ArrayLike, crease: float) -> tuple[Floats, Ints]:
    """The piece of triangles that is closest to a place, up to its creases, see `pieces`.

    Raises:
        GeometryError: If the place `seed` (3,) (m) is far off the surface.
    """
    (corners,), _, (away,) = Triangles(nodes, triangles).project(np.asarray(seed, float)[None])
    extent = float(np.ptp(nodes[triangles].reshape(-1, 3), axis=0).max())
    if away > _OFF * extent:
        far = f"seed {np.asarray(seed).tolist()} is {away:.3g} m off a surface of {extent:.3g} m"
        raise GeometryError(f"{far}; put it on the part that is the skin, in metres")
    piece = pieces(nodes, triangles, crease)
    at = int(np.flatnonzero((triangles == corners).all(axis=1))[0])
    return used_nodes(nodes, triangles[piece == piece[at]])


def cut_off(nodes: Floats, triangles: Ints, plane: ArrayLike) -> tuple[Floats, Ints]:
    """The part of triangles on the side of a plane where n . p >= d; those that it crosses are divided exactly.

    Nodes that are close to the plane, beside the edges around them, are moved onto it.

    Args:
        nodes: (n_nodes, 3) in metres.
        triangles: (n, 3) node numbers.
        plane: n and d (4,): the normal, of any length but 0, and d (m) times that length.
    """
    given = np.asarray(plane, float)
    if not np.linalg.norm(given[:3]) > 0:
        raise GeometryError(f"a plane [nx, ny, nz, d] is {given.tolist()}; its normal must not be 0")
    given = given / np.linalg.norm(given[:3])
    normal = given[:3]
    above = nodes @ normal - given[3]
    shortest = np.full(len(nodes), np.inf)
    for one, other in ((0, 1), (1, 2), (2, 0)):
        length = np.linalg.norm(nodes[triangles[:, one]] - nodes[triangles[:, other]], axis=1)
        for end in (one, other):
            np.minimum.at(shortest, triangles[:, end], length)
    on = np.abs(above) < _SNAP * shortest
    nodes = nodes - np.where(on, above, 0.0)[:, None] * normal
    above = np.where(on, 0.0, above)
    sides = above[triangles]
    kept = triangles[(sides.min(axis=1) >= 0) & (sides.max(axis=1) > 0)].tolist()
    made: dict[tuple[int, int], int] = {}
    places: list[Floats] = []
    for triangle in triangles[(sides.min(axis=1) < 0) & (sides.max(axis=1) > 0)].tolist():
        corners = []
        for one, other in zip(triangle, triangle[1:] + triangle[:1], strict=True):
            if above[one] >= 0:
                corners.append(one)
            if above[one] * above[other] < 0:
                edge = (min(one, other), max(one, other))
                if edge not in made:
                    made[edge] = len(nodes) + len(places)
                    share = above[edge[0]] / (above[edge[0]] - above[edge[1]])
                    places.append(nodes[edge[0]] + share * (nodes[edge[1]] - nodes[edge[0]]))
                corners.append(made[edge])
        kept += [[corners[0], corners[k], corners[k + 1]] for k in range(1, len(corners) - 1)]
    if not kept:
        raise GeometryError(f"nothing is left on the side of the plane {np.asarray(plane).tolist()}; turn its normal")
    return used_nodes(np.vstack([nodes, *places]), np.array(kept))
