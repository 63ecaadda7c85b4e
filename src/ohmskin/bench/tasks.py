"""Tasks that are measured in a process of their own."""

import json
import sys
from functools import partial
from time import process_time
from typing import Any

import numpy as np

from ohmskin.bench import sheets
from ohmskin.bench.bigger import big_skin
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


def set_up(cells: int) -> tuple[GaussNewton, dict[str, float]]:
    """From nodes and triangles to an estimator on pixels, and the CPU seconds of its stages."""
    nodes, triangles = sheets.grid(cells)
    layout = sheets.electrodes()
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


def compiled(estimator: GaussNewton, pairs: int, fuse: bool = True) -> CompiledCycle:
    """The adaptive frame of eq. (7) with `pairs` chosen injections."""
    drive = DRIVES["eq7"](DriveSettings(estimator.model.electrodes, pairs=pairs), 0)
    assert isinstance(drive, TwoScans)
    return CompiledCycle(estimator, drive, (0.005, 0.005), fuse=fuse)


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


TASKS = {"ours": ours, "big_skin": big_skin}
