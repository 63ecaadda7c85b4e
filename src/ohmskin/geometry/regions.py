"""Triangles of a file in space, and the parts of them that the file names: groups, objects, materials, solids, sets."""

import re
from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import GeometryError
from ohmskin.geometry.files import mesh_data

_NAMES = ("o", "g", "usemtl")  # what OBJ calls objects, groups and materials
_LISTED = 20


def read_triangles(path: str | Path, region: str = "") -> tuple[Floats, Ints]:
    """Nodes (n, 3) of a file, in its units, and its triangles (m, 3); only those of a region, if one is given.

    A region is an object, group or material of an OBJ file, a solid of an STL file that is text, a physical surface of
    Gmsh, or a set of elements of formats that have such.

    Raises:
        GeometryError: If the file cannot be read, has no triangles, or has no such region; the error lists those that
            it has.
    """
    nodes, triangles, named = _obj(Path(path)) if str(path).lower().endswith(".obj") else _others(path)
    if region:
        if region not in named:
            there = ", ".join(sorted(named)[:_LISTED]) or "none: choose by cut or seed"
            raise GeometryError(f"mesh file {path} has no region {region!r}; its regions are {there}")
        triangles = triangles[np.unique(named[region])]
    if not len(triangles):
        raise GeometryError(f"mesh file {path} has no triangles" + (f" in region {region!r}" if region else ""))
    return nodes, triangles


def _obj(path: Path) -> tuple[Floats, Ints, dict[str, Ints]]:
    """An OBJ file; faces of more corners are divided into triangles from their first corner."""
    places, triangles, named = list[list[float]](), list[tuple[int, int, int]](), defaultdict[str, list[int]](list)
    now: dict[str, tuple[str, ...]] = {}
    try:
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            word, *rest = line.split() or [""]
            if word == "v":
                places.append([float(value) for value in rest[:3]])
            elif word in _NAMES:  # a face may be in several groups
                now[word] = tuple(rest) if word == "g" else (" ".join(rest),)
            elif word == "f":
                given = [int(corner.split("/")[0]) for corner in rest]
                corners = [number - 1 if number > 0 else len(places) + number for number in given]
                for name in {name for names in now.values() for name in names}:
                    named[name] += range(len(triangles), len(triangles) + len(corners) - 2)
                triangles += [(corners[0], *pair) for pair in pairwise(corners[1:])]
        nodes, elements = np.array(places, float).reshape(-1, 3), np.array(triangles, np.int64).reshape(-1, 3)
        if elements.size and not 0 <= elements.min() <= elements.max() < len(nodes):
            raise ValueError("a face names a vertex that is not there")
    except (OSError, ValueError, OverflowError) as error:
        raise GeometryError(f"cannot read mesh file {path}: {error}") from error
    return nodes, elements, {name: np.array(numbers, np.int64) for name, numbers in named.items()}


def _others(path: str | Path) -> tuple[Floats, Ints, dict[str, Ints]]:
    """What meshio reads."""
    data, named, first = mesh_data(path), defaultdict[str, list[Ints]](list), 0
    if str(path).lower().endswith(".stl"):
        named.update(_solids(Path(path)))
    tags = {name: int(tag) for name, (tag, dim) in getattr(data, "field_data", {}).items() if dim == 2}
    found = [np.empty((0, 3), np.int64)]
    for number, block in enumerate(data.cells):
        if block.type != "triangle":
            continue
        found.append(np.asarray(block.data, np.int64))
        for name, tag in tags.items():
            own = data.cell_data.get("gmsh:physical", [[]] * len(data.cells))[number]
            named[name].append(first + np.flatnonzero(np.asarray(own) == tag))
        for name, parts in getattr(data, "cell_sets", {}).items():
            if parts[number] is not None:
                named[name].append(first + np.asarray(parts[number], np.int64))
        first += len(block.data)
    points = np.atleast_2d(np.asarray(data.points, float))
    nodes = np.column_stack([points, np.zeros((len(points), 3 - points.shape[1]))])
    return nodes, np.vstack(found), {name: np.concatenate(parts) for name, parts in named.items() if parts}


def _solids(path: Path) -> dict[str, list[Ints]]:
    """Triangles of the solids of an STL file that is text."""
    with path.open("rb") as file:
        if b"\0" in (text := file.read()):
            return {}
    solids, first = dict[str, list[Ints]](), 0
    for name, body in re.findall(rb"^\s*solid[ \t]*([^\r\n]*)(.*?)^\s*endsolid", text, re.DOTALL | re.MULTILINE):
        count = len(re.findall(rb"\bendfacet\b", body))
        solids.setdefault(name.decode(errors="replace").strip(), []).append(np.arange(first, first + count))
        first += count
    return solids
