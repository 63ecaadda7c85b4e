"""What the live loop takes for itself, with the virtual skin as its device over TCP."""

import gc
from collections.abc import Callable, Iterator
from math import cos, sin
from time import perf_counter
from typing import Any

import numpy as np

from ohmskin.bench.clock import Effort, duration
from ohmskin.bench.figure import Figure

_WARM = 200  # frames before the clock starts


class _Lap:
    """Seconds spent in a function, added up."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            start = perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                self.seconds += perf_counter() - start

        return call


def living(effort: Effort) -> Iterator[Figure]:
    """The live loop while a finger circles, the virtual skin over TCP: adaptive mode (16O) and tracking (16T)."""
    for mode in ("16O", "16T"):
        yield from _in_mode(mode, effort)


def _in_mode(mode: str, effort: Effort) -> Iterator[Figure]:
    from ohmskin.device import connect  # here, because the other groups need none of this
    from ohmskin.engine import Engine
    from ohmskin.skin import Skin

    skin = Skin.load("paper")
    with Engine(lambda: connect("virtual:", skin=skin, seed=1, realtime=False), skin, mode) as engine:
        engine.calibrate()
        waiting, scanning, seeing = _Lap(), _Lap(), _Lap()
        device: Any = engine.device
        wire = device._inner._transport
        wire.read = waiting.timed(wire.read)
        device.scan = scanning.timed(device.scan)
        sensor: Any = engine.sensor
        sensor.step = seeing.timed(sensor.step)
        count = 1000 if effort.quick else 5000
        rows, felt = [], 0
        for k in range(_WARM + count):
            if k == _WARM:
                gc.collect()
                gc.freeze()
            if k % 10 == 0:
                engine.press(0, (0.1 + 0.05 * cos(k / 200), 0.1 + 0.05 * sin(k / 200)), 8e-3, 20e3)
            before = waiting.seconds, scanning.seconds, seeing.seconds
            start = perf_counter()
            touch = engine.step()
            whole = perf_counter() - start
            wait, scan, see = (lap.seconds - b for lap, b in zip((waiting, scanning, seeing), before, strict=True))
            if k >= _WARM:
                rows.append((wait, scan - wait, see - scan, whole - see))
                felt += touch is not None and len(touch.contacts) == 1
        gc.unfreeze()
    parts = np.array(rows)
    own = parts[:, 1:].sum(axis=1)
    names = ("waiting for the device", "link", "choice and contacts", "the rest")
    shares = ", ".join(f"{name} {duration(m)}" for name, m in zip(names, np.median(parts, axis=0), strict=True))
    low, value, high = 1 / np.percentile(own, [75, 50, 25])
    name = f"live loop in {mode}, frames per second"
    note = f"wall clock; medians of a frame: {shares}; one contact in {felt / count:.1%} of the frames"
    alone = f"{name}, waiting for the device left out"
    yield Figure(alone, float(value), "1/s", least=1000, low=float(low), high=float(high), note=note)
    note = "wall clock; the twin computes every frame anew, in another process"
    yield Figure(f"{name} in all", float(1 / np.mean(parts.sum(axis=1))), "1/s", note=note)
