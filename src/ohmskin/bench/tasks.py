"""Tasks that are measured in a process of their own, see `ohmskin.bench.clock.apart`."""

from time import process_time
from typing import Any

import numpy as np

from ohmskin.bench import sheets
from ohmskin.bench.pyeit_alone import peak
from ohmskin.forward import TransferModel
from ohmskin.geometry import Mesh
from ohmskin.inverse import GaussNewton, Pixels
from ohmskin.scan import Difference, adjacent


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
    start = process_time()
    estimator.reconstruct(Difference(pattern, np.full(pattern.n_meas, 1e-3), np.full(pattern.n_meas, 1e-5)))
    return stages["all"] + process_time() - start, stages


def many_electrodes(cells: int, along: int, frames: int) -> dict[str, Any]:
    """Set-up with many electrodes and an adaptive frame of about a thousand measurements."""
    from ohmskin.drive import DRIVES, DriveSettings  # here, because the other task is measured by its memory
    from ohmskin.sensing import CompiledCycle

    estimator, stages = set_up(cells, along)
    start = process_time()
    layout = estimator.model.electrodes
    drive: Any = DRIVES["eq7"](DriveSettings(layout, pairs=4), 0)
    cycle = CompiledCycle(estimator, drive, (0.01, 0.01))
    stages = {**stages, "cycle": process_time() - start}
    touched = estimator.model.conductivity.copy()
    touched[np.linalg.norm(estimator.model.mesh.centroids - [0.06, 0.13], axis=1) < 0.01] *= 1.5
    pressed = estimator.model.with_conductivity(touched)
    change = pressed.voltages(drive.base, 1e-3) - estimator.model.voltages(drive.base, 1e-3)
    base = (change, np.full(drive.base.n_inj, 1e-3))
    chosen = cycle.look(*base)
    pattern = cycle.pattern(chosen)
    second = (pressed.voltages(pattern, 1e-3) - estimator.model.voltages(pattern, 1e-3), np.full(pattern.n_inj, 1e-3))
    times = []
    for _ in range(frames):
        start = process_time()
        contacts = cycle.frame(base, lambda _: second)
        times.append(process_time() - start)
    assert len(contacts) == 1
    assert np.hypot(contacts[0].position[0] - 0.06, contacts[0].position[1] - 0.13) < 5e-3
    n_modes = estimator.modes.n_modes
    square = np.random.default_rng(0).normal(size=(1024, 1024))
    square @ square
    start = process_time()
    for _ in range(4):
        square @ square
    rate = 4 * 2 * 1024**3 / (process_time() - start)
    # a symmetric product and its Cholesky factor: what exact least squares with m data cannot do without
    limit = (pattern.n_meas**2 * n_modes + pattern.n_meas**3 / 3) / rate
    return {
        "stages": stages, "frame": float(np.median(times)), "limit": limit, "measurements": pattern.n_meas,
        "triangles": estimator.model.mesh.n_elem, "modes": n_modes, "peak": peak(),
    }  # fmt: skip


TASKS = {"ours": ours, "many_electrodes": many_electrodes}
