"""Recordings for tests: short, of a virtual skin without a process of its own."""

from pathlib import Path

import numpy as np

import ohmskin as ohm
from ohmskin.device import Capabilities, Device, Feature, PressCommand
from ohmskin.recording import Recorder
from ohmskin.scan import DrivePattern, Frame
from ohmskin.skin import Skin, VirtualSkin

SKIN = Skin.parse("[imaging]\nmesh_size = 9e-3\n")  # coarse, because the tests see a recording many times


class Bench(Device):
    """A virtual skin in this process, scanned without waiting."""

    def __init__(self, skin: Skin = SKIN, seed: int = 3) -> None:
        able = Capabilities(
            "bench", len(skin.electrodes), 256, 4096, features=Feature.VIRTUAL | Feature.CURRENT_MEASURED
        )
        super().__init__("bench:", able)
        self._skin = VirtualSkin(skin, seed)

    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        return self._skin.scan(pattern)

    def _press(self, press: PressCommand) -> None:
        self._skin.press(press.number, press.x, press.y, press.radius, press.pressure)

    def _close(self) -> None:
        pass


def record_press(
    path: Path, mode: str = "16O", cycles: int = 30, images: float = np.inf, skin: Skin = SKIN
) -> list[ohm.Touch]:
    """Record a press that comes, moves and goes; what the loop felt meanwhile."""
    device, touches = Bench(skin), []
    with (
        Recorder(path, skin, images) as recorder,
        ohm.Engine(lambda: recorder.tee(device), skin, mode, recorder.note) as engine,
    ):
        recorder.watch(engine)
        engine.calibrate()
        for k in range(cycles):
            if cycles // 5 <= k < cycles - cycles // 5:
                engine.press(1, (0.06 + 1e-3 * k, 0.12), 8e-3, 20e3)
            else:
                engine.press(1, (0.06, 0.12), 8e-3, 0.0)
            touch = engine.step()
            assert touch is not None
            recorder.publish(touch)
            touches.append(touch)
    return touches


def some_frames(count: int, seed: int = 0) -> list[Frame]:
    """Frames of two patterns with noise for data, NaN and infinities among them."""
    rng = np.random.default_rng(seed)
    patterns = [ohm.adjacent([range(12)]), ohm.adjacent([range(16)])]
    frames = []
    for k in range(count):
        pattern = patterns[k % 2]
        voltages = rng.normal(size=pattern.n_meas)
        voltages[:2] = [np.nan, np.inf] if k % 3 == 0 else voltages[:2]
        frames.append(Frame(pattern, voltages, rng.normal(size=pattern.n_inj), time=0.1 * k, sequence=k + 1))
    return frames
