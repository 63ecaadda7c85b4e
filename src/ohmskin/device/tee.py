"""A device whose frames are handed on to somebody else, too: a recorder."""

from collections.abc import Callable

from ohmskin.device.driver import Device
from ohmskin.device.press import Press
from ohmskin.scan import DrivePattern, Frame


class TeeDevice(Device):
    """Another device, with a listener on its line.

    Args:
        inner: The device; it is closed together with this one.
        hand: Called with every frame as soon as it is there, from the thread that scanned; it must not wait.
    """

    def __init__(self, inner: Device, hand: Callable[[Frame], None]) -> None:
        super().__init__(inner.url, inner.capabilities)
        self.inner = inner
        self.reference = inner.reference
        self.default_skin = inner.default_skin
        self._hand = hand

    @property
    def dropped(self) -> int:
        return self.inner.dropped

    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        frame = self.inner.scan(pattern, timeout)
        self._hand(frame)
        return frame

    def _press(self, press: Press) -> None:
        self.inner.press(press.number, (press.x, press.y), press.radius, press.pressure)

    def _close(self) -> None:
        self.inner.close()
