"""What pyEIT does, by itself: a script that imports nothing of ours, so that its memory is its own."""

import json
import resource
import sys
from importlib import import_module
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

Array = np.ndarray


def mesh(nodes: Array, triangles: Array, at: Array, conductivity: float) -> Any:
    """Its mesh, with point electrodes at nodes `at`."""
    from pyeit.mesh.wrapper import PyEITMesh

    flat = np.column_stack([nodes, np.zeros(len(nodes))])
    perm = np.full(len(triangles), conductivity)
    return PyEITMesh(node=flat, element=np.array(triangles), perm=perm, el_pos=at, ref_node=0)


def protocol(injections: Array, measured: Array) -> Any:
    """Its name for a drive pattern: injections (n, 2), measured pairs (n, m, 2)."""
    from pyeit.eit.protocol import PyEITProtocol

    keep = np.ones(measured.shape[0] * measured.shape[1], bool)
    return PyEITProtocol(ex_mat=injections, meas_mat=measured, keep_ba=keep)


def jacobian(sheet: Any, injections: Array, measured: Array) -> Array:
    """Fields and Jacobian."""
    from pyeit.eit.fem import EITForward

    return np.asarray(EITForward(sheet, protocol(injections, measured)).compute_jac()[0])


def image(sheet: Any, injections: Array, measured: Array, touched: Array, quiet: Array) -> Array:
    """One-step Gauss-Newton: set-up and the image of one frame."""
    from pyeit.eit.jac import JAC

    solver = JAC(sheet, protocol(injections, measured))
    solver.setup(p=0.5, lamb=0.01, method="kotre")
    return np.asarray(solver.solve(touched, quiet))


def peak() -> float:
    """Largest memory that this process has held so far (MiB)."""
    status = Path("/proc/self/status")
    if status.is_file():  # rusage counts what the process that started this one held, too
        lines = status.read_text().splitlines()
        return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 2**10
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
