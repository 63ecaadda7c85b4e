"""pyEIT on the very same mesh, electrodes and pattern, used as its examples use it."""

import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.bench import pyeit_alone, sheets
from ohmskin.bench.clock import outcome
from ohmskin.forward import TransferModel
from ohmskin.scan import DrivePattern, adjacent


def has_pyeit() -> bool:
    """Whether pyEIT is installed."""
    return find_spec("pyeit") is not None


def pyeit_mesh(nodes: Floats, triangles: Ints, at: Ints) -> Any:
    """Its mesh, with point electrodes at nodes `at`."""
    return pyeit_alone.mesh(nodes, triangles, at, sheets.CONDUCTIVITY)


def pyeit_jacobian(mesh: Any, pattern: DrivePattern) -> Floats:
    """Its fields and Jacobian, fields included."""
    return pyeit_alone.jacobian(mesh, *_numbers(pattern))


def pyeit_image(mesh: Any, pattern: DrivePattern, touched: Floats, quiet: Floats) -> Floats:
    """Its one-step Gauss-Newton (JAC) for a pattern it has not seen before, to the image (n_elem,) of one frame."""
    return pyeit_alone.image(mesh, *_numbers(pattern), touched, quiet)


def pyeit_apart(cells: int) -> dict[str, Any]:
    """Its set-up to the first image, in a process that imports nothing of ours."""
    layout = sheets.electrodes()
    pattern = adjacent(layout.rings)
    model = TransferModel(sheets.mesh(cells), layout, sheets.CONDUCTIVITY)
    injections, measured = _numbers(pattern)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "sheet.npz"
        np.savez(
            path, nodes=model.mesh.nodes, triangles=model.mesh.elements, at=model.mesh.nodes_at(layout.positions),
            injections=injections, measured=measured, quiet=model.voltages(pattern),
        )  # fmt: skip
        return outcome([sys.executable, pyeit_alone.__file__, str(path)])


def _numbers(pattern: DrivePattern) -> tuple[Ints, Ints]:
    return np.array(pattern.injections), np.array(pattern.measurements[:, 1:]).reshape(pattern.n_inj, -1, 2)
