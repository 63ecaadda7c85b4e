"""Tasks that are measured in a process of their own."""

import json
import sys
from functools import partial
from time import process_time
from typing import Any

import numpy as np

from ohmskin.bench import sheets
from ohmskin.bench.clock import outcome, seconds_of
from ohmskin.bench.pyeit_alone import peak
from ohmskin.drive import DRIVES, DriveSettings, TwoScans
from ohmskin.forward import TransferModel
from ohmskin.geometry import Mesh
from ohmskin.inverse import GaussNewton, Pixels
from ohmskin.scan import Difference, adjacent
from ohmskin.sensing import CompiledCycle


def apart(task: str, **settings: Any) -> dict[str, Any]:
    """What a task measures, in a process of its own, so that its memory can be measured."""
    call = "task, settings = sys.argv[1:]; print(json.dumps(TASKS[task](**json.loads(settings))))"
    imports = f"import json, sys; from {__name__} import TASKS; "
    return outcome([sys.executable, "-c", imports + call, task, json.dumps(settings)])


def set_up(cells: int, along: int = 4) -> tuple[GaussNewton, dict[str, float]]:
    """From nodes and triangles to an estimator on pixels, and the CPU seconds of its stages."""
    nodes, triangles = sheets.grid(cells)
    layout = sheets.electrodes(along)
    laps = [process_time()]
    mesh = Mesh(nodes, triangles)
    laps.append(process_time())
    model = TransferModel(mesh, layout, sheets.CONDUCTIVITY)
    laps.append(process_time())
    pixels = Pixels.over(mesh)
    laps.append(process_time())
    estimator = GaussNewton(model, 1e-6, amplitude=0.1, pixels=pixels)
    laps.append(process_time())
    stages = dict(zip(("check mesh", "fields", "pixels", "modes"), np.diff(laps).tolist(), strict=True))
    return estimator, {**stages, "all": laps[-1] - laps[0]}


def compiled(estimator: GaussNewton, pairs: int, threshold: float = 0.005, fuse: bool = True) -> CompiledCycle:
    """The adaptive frame of eq. (7) with `pairs` chosen injections."""
    drive = DRIVES["eq7"](DriveSettings(estimator.model.electrodes, pairs=pairs), 0)
    assert isinstance(drive, TwoScans)
    return CompiledCycle(estimator, drive, (threshold, threshold), fuse=fuse)


def ours(cells: int) -> dict[str, Any]:
    """Set-up and first image of this package."""
    _first_image(24)  # compiled code is loaded
    before = peak()
    seconds, stages = _first_image(cells)
    rounds = [seconds] + [_first_image(cells)[0] for _ in range(4 if cells < 100 else 0)]
    return {"seconds": float(np.median(rounds)), "stages": stages, "before": before, "peak": peak()}


def _first_image(cells: int) -> tuple[float, dict[str, float]]:
    estimator, stages = set_up(cells)
    pattern = adjacent(estimator.model.electrodes.rings)
    difference = Difference(pattern, np.full(pattern.n_meas, 1e-3), np.full(pattern.n_meas, 1e-5))
    return stages["all"] + seconds_of(partial(estimator.reconstruct, difference)), stages


def many_electrodes(cells: int, along: int, frames: int) -> dict[str, Any]:
    """Set-up with many electrodes and an adaptive frame of about a thousand measurements."""
    estimator, stages = set_up(cells, along)
    start = process_time()
    cycle = compiled(estimator, 4, 0.01)
    stages["cycle"] = process_time() - start
    scan = sheets.touched(estimator.model, (0.06, 0.13))
    base = scan(cycle.drive.base)
    pattern = cycle.pattern(cycle.look(*base))
    second = scan(pattern)
    (contact,) = cycle.frame(base, lambda _: second)
    assert np.hypot(contact.position[0] - 0.06, contact.position[1] - 0.13) < 5e-3
    times = [seconds_of(lambda: cycle.frame(base, lambda _: second)) for _ in range(frames)]
    square = np.random.default_rng(0).normal(size=(1024, 1024))
    square @ square
    rate = 2 * 1024**3 / seconds_of(lambda: square @ square, 4)
    # a symmetric product and its Cholesky factor: what exact least squares with m data cannot do without
    n_modes = estimator.modes.n_modes
    limit = (pattern.n_meas**2 * n_modes + pattern.n_meas**3 / 3) / rate
    return {
        "stages": stages, "frame": float(np.median(times)), "limit": limit, "measurements": pattern.n_meas,
        "triangles": estimator.model.mesh.n_elem, "modes": n_modes, "peak": peak(),
    }  # fmt: skip


TASKS = {"ours": ours, "many_electrodes": many_electrodes}
