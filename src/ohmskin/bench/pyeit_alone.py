"""What pyEIT does, by itself: run as a script with a sheet (.npz), it imports nothing of ours, so that its memory is its own."""

import json
import resource
import sys
from importlib import import_module
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np


def mesh(nodes: np.ndarray, triangles: np.ndarray, at: np.ndarray, conductivity: float) -> Any:
    """Its mesh, with point electrodes at nodes `at`."""
    from pyeit.mesh.wrapper import PyEITMesh

    flat = np.column_stack([nodes, np.zeros(len(nodes))])
    return PyEITMesh(node=flat, element=np.array(triangles), perm=np.full(len(triangles), conductivity), el_pos=at, ref_node=0)


def protocol(injections: np.ndarray, measured: np.ndarray) -> Any:
    """Its name for a drive pattern: injections (n, 2), measured pairs (n, m, 2)."""
    from pyeit.eit.protocol import PyEITProtocol

    return PyEITProtocol(ex_mat=injections, meas_mat=measured, keep_ba=np.ones(measured.shape[0] * measured.shape[1], bool))


def jacobian(sheet: Any, injections: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Fields and Jacobian."""
    from pyeit.eit.fem import EITForward

    found: np.ndarray = EITForward(sheet, protocol(injections, measured)).compute_jac()[0]
    return found


def image(sheet: Any, injections: np.ndarray, measured: np.ndarray, touched: np.ndarray, quiet: np.ndarray) -> np.ndarray:
    """One-step Gauss-Newton: set-up and the image of one frame."""
    from pyeit.eit.jac import JAC

    solver = JAC(sheet, protocol(injections, measured))
    solver.setup(p=0.5, lamb=0.01, method="kotre")
    found: np.ndarray = solver.solve(touched, quiet)
    return found


def peak() -> float:
    """Largest memory that this process has held so far (MiB)."""
    status = Path("/proc/self/status")
    if status.is_file():  # rusage counts what the process that started this one held, too
        return next(float(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM")) / 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)


def main(path: str) -> None:
    """Time set-up and first image; prints JSON."""
    data = np.load(path)
    import_module("pyeit.eit.jac")  # before the clock starts
    import_module("pyeit.mesh.wrapper")

    before, start = peak(), process_time()
    sheet = mesh(data["nodes"], data["triangles"], data["at"], 1.83e-3)
    image(sheet, data["injections"], data["measured"], 1.01 * data["quiet"], data["quiet"])
    print(json.dumps({"seconds": process_time() - start, "before": before, "peak": peak()}))


if __name__ == "__main__":
    main(sys.argv[1])
