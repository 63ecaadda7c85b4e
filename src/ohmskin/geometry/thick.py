"""Thick soft skins: tetrahedra between a sheet and its offset."""

from collections.abc import Sequence

import numpy as np

from ohmskin.errors import GeometryError
from ohmskin.geometry.mesh import Mesh, normals


def thicken(sheet: Mesh, thickness: float, layers: int | Sequence[float] = 4) -> Mesh:
    """A thick skin below a sheet: prisms, each cut into three tetrahedra that fit their neighbours'.

    A flat sheet becomes the top, z = 0, of a body down to z = -`thickness`. A surface in space grows against the
    normals of its triangles (right-hand rule), which must be ordered alike.

    Args:
        sheet: Triangles, flat or in space. Its nodes are the first of the body's, in their order.
        thickness: In metres.
        layers: Number of equal layers, or their shares (n,) of the thickness from the top, summing to one.

    Raises:
        GeometryError: If thickness or layers are out of range, triangles not ordered alike, or the body would fold.
    """
    if sheet.dim != 2:
        raise GeometryError("thicken() takes a sheet of triangles; this mesh is of tetrahedra already")
    if sheet.period:
        raise GeometryError("thicken() takes no closed band; bend it in space first, with Mesh.mapped()")
    if not (np.isfinite(thickness) and thickness > 0):
        raise GeometryError(f"thickness is {thickness!r} m; it must be positive")
    shares = np.full(layers, 1 / max(1, layers)) if isinstance(layers, int) else np.asarray(layers, float)
    if not (1 <= len(shares) <= 1000 and (shares > 0).all() and abs(shares.sum() - 1) < 1e-9):
        raise GeometryError(f"layers are {layers}; give a number from 1 to 1000, or positive shares that sum to one")
    flat = sheet.nodes.shape[1] == 2
    top = np.column_stack([sheet.nodes, np.zeros(sheet.n_nodes)]) if flat else sheet.nodes
    edges = np.concatenate([sheet.elements[:, [0, 1]], sheet.elements[:, [1, 2]], sheet.elements[:, [2, 0]]])
    if len(np.unique(edges, axis=0)) != len(edges):
        raise GeometryError("the triangles of this surface have mixed orientations; reverse some of them")
    up = np.zeros_like(top)
    np.add.at(up, sheet.elements, normals(top, sheet.elements)[:, None])
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    depths = np.concatenate([[0.0], np.cumsum(shares)]) * thickness
    nodes = (top - depths[:, None, None] * up).reshape(-1, 3)

    # each side of a prism is cut from its lower number on top: neighbours agree
    a, b, c = np.sort(sheet.elements, axis=1).T
    n = sheet.n_nodes
    corners = ([a, b, c, c + n], [a, b, b + n, c + n], [a, a + n, b + n, c + n])
    tetrahedra = np.concatenate([np.stack(four, axis=1) for four in corners])
    elements = np.concatenate([tetrahedra + k * n for k in range(len(shares))])
    # whichever way its three nodes are numbered, a tetrahedron lies below its triangle unless the prism folds
    turn = np.linalg.det(nodes[elements[:, 1:]] - nodes[elements[:, :1]])
    facing = np.sign(np.einsum("ed,ed->e", normals(top, np.column_stack([a, b, c])), up[a]))
    if (np.sign(turn) != np.tile(np.concatenate([-facing, facing, -facing]), len(shares))).any():
        raise GeometryError(f"a body {thickness:.3g} m thick folds where the surface bends tightly; make it thinner")
    elements[turn < 0, 2:] = elements[turn < 0, 2:][:, ::-1]
    return Mesh(nodes, elements)
