"""Meshes from and to files of other programs, by meshio (extra ``mesh``): Gmsh, STL, VTK, Abaqus, ..."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import GeometryError
from ohmskin.geometry.extra import optional
from ohmskin.geometry.mesh import Mesh


def read_mesh(path: str | Path, scale: float = 1.0) -> Mesh:
    """A mesh of the file's tetrahedra, else of its triangles. Nodes at one place are joined, unused ones removed.

    Args:
        path: Any format that meshio reads, by its ending.
        scale: Metres per unit of the file: 1e-3 for millimetres.

    Raises:
        GeometryError: If meshio is not installed, the file cannot be read, or it holds no mesh that can be used.
    """
    return read_groups(path, scale)[0]


def read_groups(path: str | Path, scale: float = 1.0) -> tuple[Mesh, dict[str, Ints]]:
    """A mesh as by `read_mesh`, and Gmsh's named physical groups of facets (n, dim), or of points (n,), by their nodes.

    Args:
        path: The file.
        scale: Metres for a unit of length in the file.

    Raises:
        GeometryError: As `read_mesh`.
    """
    data, nodes, elements, kind, joined, used = _read(path, scale)
    if kind == "triangle" and nodes.shape[1] == 3 and np.ptp(nodes[:, 2]) == 0:
        nodes = nodes[:, :2]
    number = np.full(len(joined), -1)
    number[used] = np.arange(len(used))
    groups: dict[str, Ints] = {}
    facet = {"tetra": "triangle", "triangle": "line"}[kind]
    for name, (tag, _) in getattr(data, "field_data", {}).items():
        for block, tags in zip(data.cells, data.cell_data.get("gmsh:physical", []), strict=False):
            chosen = number[joined[block.data[tags == tag]]]
            if len(chosen) and block.type in (facet, "vertex"):
                chosen = chosen.ravel() if block.type == "vertex" else chosen
                groups[name] = np.concatenate([groups[name], chosen]) if name in groups else chosen
    return Mesh(nodes, elements), groups


def _read(path: str | Path, scale: float) -> tuple[Any, Floats, Ints, str, Ints, Ints]:
    """What meshio reads; nodes and elements, tetrahedra if there are any; which nodes of the file they are."""
    if not (np.isfinite(scale) and scale > 0):
        raise GeometryError(f"scale is {scale!r} metres per unit; it must be positive")
    data = mesh_data(path)
    cells = data.cells_dict
    kind = next((kind for kind in ("tetra", "triangle") if kind in cells), None)
    if kind is None:
        raise GeometryError(f"mesh file {path} has {', '.join(cells) or 'no cells'}; need triangles or tetrahedra")
    nodes, elements, joined, used = joined_nodes(scale * np.asarray(data.points, float), np.asarray(cells[kind]))
    return data, nodes, elements, kind, joined, used


def mesh_data(path: str | Path) -> Any:
    """What meshio reads of a file.

    Raises:
        GeometryError: If meshio is not installed, or it cannot.
    """
    meshio = optional("meshio")
    if not os.path.isfile(path):  # false also of names that cannot be
        raise GeometryError(f"no mesh file {path}; check the path")
    try:
        with np.errstate(over="ignore"):  # its STL reader tells binary files by a product that may overflow
            return meshio.read(path)
    except (Exception, SystemExit) as error:  # its readers raise anything, and exit on unknown endings
        raise GeometryError(f"cannot read mesh file {path}: {error or 'unknown format'}; see meshio") from error


def joined_nodes(places: Floats, elements: Ints) -> tuple[Floats, Ints, Ints, Ints]:
    """Nodes at one place joined, unused ones dropped.

    Returns:
        Nodes (n, dim) (m), elements by their numbers, which node each of before is joined to, and which are used.
    """
    step = 1e-9 * max(float(np.ptp(places, axis=0).max()), 1e-300)
    cells = np.round((places - places.min(axis=0)) / step)
    _, first, same = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    joined = first[same.ravel()]
    used, own = np.unique(joined[elements], return_inverse=True)
    return places[used], own.reshape(elements.shape).astype(np.int64), joined, used


def write_mesh(path: str | Path, mesh: Mesh, fields: Mapping[str, ArrayLike] | None = None) -> None:
    """Write a mesh, with values by element or by node beside it, to any format that meshio writes; its ending names it.

    Args:
        path: The file, such as ``image.vtu`` for ParaView.
        mesh: The mesh; flat ones get z = 0.
        fields: Values (n_elem, ...) or (n_nodes, ...) by name.

    Raises:
        GeometryError: If meshio is not installed, a field fits neither elements nor nodes, or the format is unknown.
    """
    meshio = optional("meshio")
    kind = "triangle" if mesh.dim == 2 else "tetra"
    nodes = mesh.nodes if mesh.nodes.shape[1] == 3 else np.column_stack([mesh.nodes, np.zeros(mesh.n_nodes)])
    by_node, by_cell = {}, {}
    for name, given in (fields or {}).items():
        values = np.asarray(given, float)
        if values.ndim and len(values) == mesh.n_elem:
            by_cell[name] = [values]
        elif values.ndim and len(values) == mesh.n_nodes:
            by_node[name] = values
        else:
            allowed = f"({mesh.n_elem}, ...) or ({mesh.n_nodes}, ...)"
            raise GeometryError(f"field {name!r} has shape {values.shape}; need {allowed}")
    try:
        meshio.Mesh(nodes, [(kind, mesh.elements.astype(np.int32))], point_data=by_node, cell_data=by_cell).write(path)
    except (Exception, SystemExit) as error:  # its writers raise anything
        raise GeometryError(f"cannot write mesh file {path}: {error or 'unknown format'}; try .vtu or .stl") from error
