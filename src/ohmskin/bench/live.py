"""What the live loop takes for itself, with the virtual skin as its device over TCP."""

import gc
from collections import defaultdict
from collections.abc import Callable, Iterator
from math import cos, sin
from time import perf_counter
from typing import Any

import numpy as np

from ohmskin.bench.clock import Effort, duration
from ohmskin.bench.figure import Figure

_WARM = 200  # frames before the clock starts


def living(effort: Effort) -> Iterator[Figure]:
    """The live loop while a finger circles, the virtual skin over TCP: the paper's mode, the default one, tracking."""
    for mode, least in (("16O", 1000), ("16P", 1500), ("16T", 2000)):
        yield from _in_mode(mode, least, effort)


def _in_mode(mode: str, least: int, effort: Effort) -> Iterator[Figure]:
    from ohmskin.device import connect  # here, because the other groups need none of this
    from ohmskin.engine import Engine
    from ohmskin.skin import Skin

    skin = Skin.load("paper")
    with Engine(lambda: connect("virtual:", skin=skin, seed=1, realtime=False), skin, mode) as engine:
        engine.calibrate()
        spent: dict[str, float] = defaultdict(float)  # s in one frame

        def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
            def call(*arguments: Any, **named: Any) -> Any:
                start = perf_counter()
                try:
                    return function(*arguments, **named)
                finally:
                    spent[name] += perf_counter() - start

            return call

        device: Any = engine.device
        wire, sensor, step = device._transport, engine.sensor, timed("frame", engine.step)
        wire.read, device.scan = timed("wait", wire.read), timed("scan", device.scan)
        sensor.step = timed("step", sensor.step)  # type: ignore[union-attr, method-assign]
        count = 1000 if effort.quick else 5000
        rows, felt = [], 0
        for k in range(_WARM + count):
            if k == _WARM:
                gc.collect()
                gc.freeze()
            if k % 10 == 0:
                engine.press(0, (0.1 + 0.05 * cos(k / 200), 0.1 + 0.05 * sin(k / 200)), 8e-3, 20e3)
            spent.clear()
            touch = step()
            if k >= _WARM:
                rows.append([spent[name] for name in ("wait", "scan", "step", "frame")])
                felt += touch is not None and len(touch.contacts) == 1
        gc.unfreeze()
    parts = np.diff(rows, axis=1, prepend=0.0)  # each lies within the next one
    own = parts[:, 1:].sum(axis=1)
    names = ("waiting for the device", "link", "choice and contacts", "the rest")
    shares = ", ".join(f"{name} {duration(m)}" for name, m in zip(names, np.median(parts, axis=0), strict=True))
    name = f"live loop in {mode}, frames per second"
    note = f"wall clock; medians of a frame: {shares}; one contact in {felt / count:.1%} of the frames"
    yield Figure.median(f"{name}, waiting for the device left out", 1 / own, "1/s", least=least, note=note)
    note = "wall clock; the twin computes every frame anew, in another process"
    yield Figure(f"{name} in all", float(1 / np.mean(parts.sum(axis=1))), "1/s", note=note)
