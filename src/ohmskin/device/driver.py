"""The interface of all devices, whatever the transport."""

import threading
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import final

from ohmskin.closing import Closing
from ohmskin.device.capabilities import Capabilities
from ohmskin.device.press import PressCommand
from ohmskin.errors import DeviceError, DeviceRefused, shown
from ohmskin.registry import Plugin, naming
from ohmskin.scan import DrivePattern, Frame

_LONGEST = 10.0  # s that a device may be late, by what it says it needs


class Device(Closing):
    """A skin that can be scanned. Safe to use from several threads; a context manager.

    A driver implements `_scan`, `_close` and, if it is virtual, `_press`; this class handles limits, timeout and
    locking.

    Args:
        url: The address with which it was opened.
        capabilities: What it is and its limits per scan.
    """

    reference: Sequence[Frame] = ()  # quiet frames that come with it, so that nobody need wait for new ones
    default_skin: str = "paper"  # the skin it most probably has
    default_mode: str = ""  # the mode that a recording begins in
    plugin: Plugin | None = None  # the driver, if another package made it

    def __init__(self, url: str, capabilities: Capabilities) -> None:
        self.url = url
        self.capabilities = capabilities
        self._lock = threading.Lock()
        self._closed = False
        self._listeners: list[Callable[[Frame], None]] = []

    @property
    def dropped(self) -> int:
        """Frames lost in transit and requested again."""
        return 0

    @final
    def scan(self, pattern: DrivePattern, timeout: float | None = None) -> Frame:
        """Drive `pattern` once and measure.

        Args:
            pattern: Within the device's capabilities; larger ones are refused, see `DrivePattern.split`.
            timeout: Longest time to wait (s); by default 2 s plus four times the time that the device states, but no
                more than that time plus 10 s.

        Raises:
            PatternError: If the pattern names an electrode that is not there or is too large.
            DeviceLost: If no frame comes in time.
            DeviceRefused: If the device refuses.
            DeviceError: If it was closed, or the timeout is not positive.
        """
        needs = self.capabilities.scan_time(pattern)
        limit = needs + min(2.0 + 3 * needs, _LONGEST) if timeout is None else timeout
        if not limit > 0:
            raise DeviceError(f"timeout is {timeout} s; it must be positive, or None")
        with self._lock:
            self._check_open()
            self.capabilities.check(pattern)
            with naming(self.plugin):
                frame = self._scan(pattern, limit)
            if not isinstance(frame, Frame):
                raise DeviceError(f"{self.plugin or self.url} gave {shown(frame)} for a scan; it must be a Frame")
            for listener in self._listeners:
                listener(frame)
            return frame

    @final
    def listen(self, listener: Callable[[Frame], None]) -> None:
        """Call `listener` with every frame as soon as it arrives, in the thread that scanned; it must not block."""
        self._listeners.append(listener)

    @final
    def press(self, number: int, at: tuple[float, float], radius: float, pressure: float) -> None:
        """Touch a virtual skin, move a touch, or lift it.

        Args:
            number: Which touch, 0..65535, among those of this connection.
            at: Place (x, y) on the sheet (m).
            radius: Radius (m).
            pressure: Pressure (Pa); 0 lifts it.

        Raises:
            DeviceRefused: If a value is out of range or the skin is a real one.
            DeviceLost: If the device does not answer.
            DeviceError: If it was closed.
        """
        press = PressCommand(number, *at, radius, pressure)
        if not self.capabilities.virtual:
            raise DeviceRefused(f"device {self.capabilities.name!r} is not virtual; press it with a finger")
        with self._lock, naming(self.plugin):
            self._check_open()
            self._press(press)

    @final
    def close(self) -> None:
        """Close the device. Safe to call twice."""
        with self._lock, naming(self.plugin):
            if not self._closed:
                self._closed = True
                self._close()

    def _check_open(self) -> None:
        if self._closed:
            raise DeviceError(f"device {self.url} is closed; connect again")

    @abstractmethod
    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        """One frame of a pattern that the device can take."""

    @abstractmethod
    def _close(self) -> None:
        """Close; called once."""

    def _press(self, press: PressCommand) -> None:
        """Put, move or lift a touch."""
        raise DeviceRefused(f"device {self.capabilities.name!r} takes no presses")
