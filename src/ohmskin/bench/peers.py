"""pyEIT on the very same mesh, electrodes and pattern, used as its examples use it."""

import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ohmskin.arrays import Ints
from ohmskin.bench import pyeit_alone, sheets
from ohmskin.bench.clock import outcome
from ohmskin.forward import TransferModel
from ohmskin.geometry import Electrodes, Mesh
from ohmskin.scan import DrivePattern, adjacent

MISSING = "pyEIT is not installed: pip install 'ohmskin[bench]'"


def has_pyeit() -> bool:
    """Whether pyEIT is installed."""
    return find_spec("pyeit") is not None


def pyeit_mesh(mesh: Mesh, layout: Electrodes) -> Any:
    """Its mesh, with point electrodes."""
    return pyeit_alone.mesh(mesh.nodes, mesh.elements, mesh.nodes_at(layout.positions), sheets.CONDUCTIVITY)


def pyeit_apart(cells: int) -> dict[str, Any]:
    """Its set-up to the first image, in a process that imports nothing of ours."""
    if not has_pyeit():
        return {"error": MISSING}
    layout = sheets.electrodes()
    pattern = adjacent(layout.rings)
    model = TransferModel(sheets.mesh(cells), layout, sheets.CONDUCTIVITY)
    injections, measured = numbers(pattern)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "sheet.npz"
        np.savez(
            path, nodes=model.mesh.nodes, triangles=model.mesh.elements, at=model.mesh.nodes_at(layout.positions),
            injections=injections, measured=measured, quiet=model.voltages(pattern),
        )  # fmt: skip
        return outcome([sys.executable, pyeit_alone.__file__, str(path)])


def numbers(pattern: DrivePattern) -> tuple[Ints, Ints]:
    """A drive pattern as `pyeit_alone` takes it: injections (n, 2), measured pairs (n, m, 2)."""
    return np.array(pattern.injections), np.array(pattern.measurements[:, 1:]).reshape(pattern.n_inj, -1, 2)
