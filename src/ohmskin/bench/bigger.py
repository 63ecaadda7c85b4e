"""Bigger skins, live: what set-up, calibration and frames cost with 36 to 256 electrodes, and how right they are.

Sheets grow with their electrodes, which stay as far apart; everything else is the paper's skin and the documented
defaults. Each skin and mode is measured in a process of its own, so that its memory can be measured.
"""

from dataclasses import replace
from math import dist
from time import process_time
from typing import Any

import numpy as np

from ohmskin.bench.pyeit_alone import peak
from ohmskin.device import connect
from ohmskin.engine import Engine
from ohmskin.scan import DrivePattern, Frame
from ohmskin.sensing import CompiledCycle, Sensor
from ohmskin.skin import Skin

SIZES = {36: (6, 6), 64: (8, 8), 128: (16, 8), 256: (16, 16)}
_SPACING, _INSET = 0.027, 0.004  # m
PLACES = ((0.41, 0.37), (0.78, 0.7), (0.12, 0.16), (0.55, 0.91), (0.93, 0.08))  # shares of the sheet's sides
_SETTLING, _RADIUS, _PRESSURE = 40, 8e-3, 20e3  # frames after a change; m, Pa


def skin_of(electrodes: int) -> Skin:
    """The paper's skin with so many electrodes, one of `SIZES`, in a grid 27 mm wide."""
    columns, rows = SIZES[electrodes]
    paper = Skin.load("paper")
    width, height = (round(_SPACING * (n - 1) + 2 * _INSET, 4) for n in (columns, rows))
    return replace(
        paper,
        name=f"{electrodes} electrodes",
        sheet=replace(paper.sheet, width=width, height=height),
        electrode=replace(paper.electrode, columns=columns, rows=rows, inset=_INSET),
    )


def big_skin(electrodes: int, kind: str, frames: int) -> dict[str, Any]:
    """One skin in one mode: CPU seconds (median and 99th percentile) of frames with none, one and two contacts."""
    skin, begun = skin_of(electrodes), process_time()
    with Engine(lambda: connect("virtual:", skin=skin, seed=1, realtime=False), skin, f"{electrodes}{kind}") as engine:
        started = process_time()
        engine.calibrate()
        calibrated = process_time()
        assert engine.sensor is not None
        sides = skin.sheet.width, skin.sheet.height
        places = [(x * sides[0], y * sides[1]) for x, y in PLACES]
        told, errors, scan = [], [], _waits(engine)
        for count in range(3):
            _press(engine, places[:count])
            spent = []
            for _ in range(_SETTLING + frames):
                before, waited = process_time(), scan[0]
                touch = engine.step()
                if touch is not None and kind == "O":
                    touch.percept.image.values  # noqa: B018  made when it is asked for
                spent.append(process_time() - before - (scan[0] - waited))
            told.append([float(q) for q in np.percentile(spent[_SETTLING:], [50, 99])])
        image = process_time()
        if touch is not None:
            touch.percept.image.values  # noqa: B018
        image = process_time() - image
        for place in places:
            _press(engine, [place])
            for _ in range(_SETTLING):
                touch = engine.step()
            places_felt = [contact.position for contact in touch.contacts] if touch else []
            errors.append(min((dist(felt, place) for felt in places_felt), default=np.nan))
        pattern = engine.drive(engine.mode)
        return {
            "start": started - begun, "calibration": calibrated - started, "frames": told, "image": image,
            "injections": pattern.injections, "measurements": scan[1], "peak": peak(),
            "error_m": float(np.nanmean(errors)), "worst": float(np.nanmax(errors)),
            "felt": int(np.isfinite(errors).sum()), "accuracy": _accuracy(engine.sensor),
        }  # fmt: skip


def _press(engine: Engine, places: list[tuple[float, float]]) -> None:
    for number in range(2):
        if number < len(places):
            engine.press(number, places[number], _RADIUS, _PRESSURE)
        else:
            engine.press(number, (_INSET, _INSET), _RADIUS, 0.0)


def _waits(engine: Engine) -> list[float]:
    """CPU seconds that the driver has taken so far, and the voltages of the last frame, kept up to date."""
    device: Any = engine.device
    told, inner, counts = [0.0, 0], device.scan, dict[int, int]()

    def scan(pattern: DrivePattern) -> Frame:
        before = process_time()
        frame: Frame = inner(pattern)
        counts[engine.scans_made] = pattern.n_meas
        told[0], told[1] = told[0] + process_time() - before, sum(counts.values())
        return frame

    device.scan = scan
    return told


def _accuracy(sensor: Sensor) -> float | None:
    """Largest error of the compiled images of a simulated touch, over their largest value; None if not compiled."""
    cycle = getattr(sensor.implementation, "_cycle", None)
    if not isinstance(cycle, CompiledCycle):
        return None
    scan = sensor.known.pressed(sensor.known.model.mesh.centroids.mean(axis=0)[None])
    frames = [scan(cycle.drive.base)]
    chosen = cycle.base_step(frames[0].voltages, frames[0].currents)
    frames.append(scan(cycle.pattern(chosen)))
    cycle.second_step(frames[1].voltages, frames[1].currents)
    exact = cycle.estimator.reconstruct(*map(sensor.known.difference, frames)).values
    return float(np.abs(cycle.image - exact).max() / np.abs(exact).max())
