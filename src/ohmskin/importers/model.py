"""Forward models of EIDORS (``fmdl`` or ``img`` in a .mat file), and of Gmsh with electrodes as physical groups."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.errors import DataError, GeometryError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Electrodes, Mesh, read_groups
from ohmskin.importers import eidors
from ohmskin.importers.matfile import entries, is_mat, load_variables, numbers
from ohmskin.importers.pattern import ImportedPattern
from ohmskin.importers.recording import content_of


@dataclass(frozen=True, eq=False)
class ImportedModel:
    """A forward model read from a file.

    Args:
        mesh: Triangles or tetrahedra.
        electrodes: Points, and groups of the mesh's facets.
        drive: The drive pattern, if the file has one.
        conductivity: (n_elem,), if the file has it.
        notes: What was left out or assumed on reading, in plain words.
    """

    mesh: Mesh
    electrodes: Electrodes
    drive: ImportedPattern | None = None
    conductivity: Floats | None = None
    notes: tuple[str, ...] = ()

    def transfer_model(self, conductivity: float = 1.0) -> TransferModel:
        """The model, of the file's conductivity if it has one.

        Args:
            conductivity: Where the file has none, as for `TransferModel`.

        Raises:
            ModelError: If it is not positive, or has the wrong shape.
        """
        return TransferModel(
            self.mesh, self.electrodes, conductivity if self.conductivity is None else self.conductivity
        )


def read_model(path: str | Path, scale: float = 1.0, contact_impedance: float | None = None) -> ImportedModel:
    """Read a forward model.

    - MATLAB files made with EIDORS: the first struct with ``nodes``, ``elems`` and ``electrode``, such as ``fmdl`` or
      ``img.fwd_model``; ``elem_data`` of an ``img`` is the conductivity. An electrode of several ``nodes`` is made of
      those facets of the boundary of which it has every node, one of ``faces`` of these, one of one node is a point.
    - What meshio reads (extra ``mesh``), such as Gmsh's .msh: each physical group of facets, or of one point, whose
      name begins with ``electrode`` is one, in the order of the numbers in their names, or of their tags.

    Args:
        path: The file.
        scale: Metres per unit of length of the file, in which EIDORS' conductivities and contact impedances are, too:
            resistances do not change with it.
        contact_impedance: Of all electrodes that are no points (faces: ohm m2, edges: ohm m); the file's unless given.

    Raises:
        DataError: If the file cannot be read, or lacks a part of it.
        GeometryError: If mesh or electrodes cannot be used.
    """
    path = Path(path)
    if not (np.isfinite(scale) and scale > 0):
        raise GeometryError(f"scale is {scale!r} metres per unit; it must be positive")
    if path.suffix == ".mat" or (os.path.isfile(path) and is_mat(content_of(path)[:8])):
        return _eidors(path, scale, contact_impedance)
    mesh, groups = read_groups(path, scale)
    named = {name: nodes for name, nodes in groups.items() if name.lower().startswith("electrode")}
    if len(named) < 4:
        raise DataError(
            f"{path} has {len(named)} physical groups named electrode...; need 4 or more. There are: "
            f"{', '.join(groups) or 'none'}"
        )
    if contact_impedance is None and any(np.ndim(nodes) > 1 for nodes in named.values()):
        raise DataError(f"{path} has no contact impedances of its electrodes; give contact_impedance")
    electrodes = Electrodes.on_mesh(
        mesh, [named[name] for name in sorted(named, key=_in_order)], contact_impedance or 0.0
    )
    return ImportedModel(mesh, electrodes)


def _in_order(name: str) -> tuple[int, str]:
    digits = "".join(char for char in name if char.isdigit())
    return int(digits or 0), name


def _eidors(path: Path, scale: float, contact_impedance: float | None) -> ImportedModel:
    variables, notes = load_variables(content_of(path), str(path))
    models = ((key, entries(value)[0], array[0]) for key, value in variables.items() for array in eidors.structs(value))
    found = next((each for each in models if {"nodes", "elems", "electrode"} <= each[2].keys()), None)
    if found is None:
        there = ", ".join(sorted(variables)[:12]) or "none"
        raise DataError(f"{path}: no struct with nodes, elems and electrode; there are {there}")
    key, outer, model = found
    try:
        nodes, elements = numbers(model["nodes"], "nodes") * scale, numbers(model["elems"], "elems")
        mesh = Mesh(nodes, _counted(elements, "elems"))
        groups, impedances = [], []
        for number, electrode in enumerate(entries(model["electrode"]), 1):
            where = f"electrode {number}"
            faces = electrode.get("faces")
            faces = None if faces is None or not np.size(numbers(faces, where)) else numbers(faces, f"{where}: faces")
            own = numbers(electrode.get("nodes"), f"{where}: nodes").ravel() if faces is None else faces
            groups.append(_counted(own, where))
            given = electrode.get("z_contact")
            impedances.append(0.0 if given is None else _single(numbers(given, f"{where}: z_contact"), where))
        z = np.array(impedances) * scale ** (mesh.dim - 1) if contact_impedance is None else contact_impedance
        electrodes = Electrodes.on_mesh(mesh, groups, z)
        drive = None
        if model.get("stimulation") is not None:
            drive, _ = eidors.pattern_of({key: [model]}, driven=True)
            notes = (*drive.notes, *notes)
        data = outer.get("elem_data")
        conductivity = None if data is None else numbers(data, "elem_data").ravel() / scale ** (mesh.dim - 2)
        if conductivity is not None and conductivity.shape != (mesh.n_elem,):
            raise DataError(f"elem_data has {conductivity.size} values; the mesh has {mesh.n_elem} elements")
    except (DataError, GeometryError) as error:
        raise type(error)(f"{path}: {error}") from error
    return ImportedModel(mesh, electrodes, drive, conductivity, tuple(notes))


def _single(given: Floats, where: str) -> float:
    """The value of an array of one."""
    if given.size != 1:
        raise DataError(f"{where}: z_contact has {given.size} values; need one")
    return float(given.ravel()[0])


def _counted(given: Floats, what: str) -> Any:
    """Numbers from 1 as numbers from 0."""
    if not ((given >= 1) & (given < 2**31) & (given == np.rint(given))).all():  # false for nan
        raise DataError(f"{what} holds other numbers than 1, 2, 3, ...")
    return given.astype(np.int64) - 1
