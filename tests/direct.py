"""A device without a wire, for tests of what lies above it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ohmskin.device import Capabilities, Device, Feature, PressCommand
from ohmskin.errors import DeviceLost
from ohmskin.scan import DrivePattern, Frame
from ohmskin.skin import VirtualSkin


class DirectDevice(Device):
    """A `VirtualSkin` in this process. Set `gone` to pull its plug, `blind` to clip an electrode, `spoil` to change
    frames."""

    def __init__(self, virtual: VirtualSkin, serial: int = 1) -> None:
        count = len(virtual.skin.electrodes)
        super().__init__(
            "direct:",
            Capabilities("direct", count, 24, 512, features=Feature.VIRTUAL | Feature.DRIVEN_MEASURED, serial=serial),
        )
        self.virtual, self.gone, self.blind = virtual, False, False
        self.spoil: Callable[[Frame], Frame] | None = None

    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        if self.gone:
            raise DeviceLost("the plug was pulled")
        frame = self.virtual.scan(pattern)
        if self.spoil is not None:
            frame = self.spoil(frame)
        if not self.blind:
            return frame
        unseen = (pattern.measurements[:, 1:] == 5).any(axis=1)  # electrode 5 clips
        return replace(frame, voltages=np.where(unseen, np.inf, frame.voltages))

    def _press(self, press: PressCommand) -> None:
        self.virtual.press(press.number, press.x, press.y, press.radius, press.pressure)

    def _close(self) -> None:
        pass
