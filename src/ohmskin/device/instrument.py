"""What a server serves, and how several hosts share it."""

import threading
import time
from typing import Protocol

from ohmskin.device.capabilities import Capabilities
from ohmskin.device.press import PressCommand
from ohmskin.errors import DeviceRefused
from ohmskin.scan import DrivePattern, Frame

MOST_PRESSES = 64
_COSTLY = 0.5  # s that a touch may take without a rest after it


class Instrument(Protocol):
    """Something that scans a skin. It is called by one thread at a time."""

    @property
    def capabilities(self) -> Capabilities:
        """What it is and its limits per scan."""

    def scan(self, pattern: DrivePattern) -> Frame:
        """Drive `pattern` once; may block for the time of the acquisition.

        Raises:
            DeviceRefused: If it cannot; the host gets the reason.
        """

    def press(self, number: int, x: float, y: float, radius: float, pressure: float) -> None:
        """Press the skin, move a press, or lift it. Virtual instruments only.

        Args:
            number: Which touch, from 0.
            x, y: Its centre on the sheet (m).
            radius: Its radius (m).
            pressure: Its pressure (Pa); 0 lifts it.

        Raises:
            DeviceRefused: If the press is not possible there.
        """


class SharedInstrument:
    """An instrument that several hosts use, one at a time. Each of them numbers its presses for itself."""

    def __init__(self, instrument: Instrument) -> None:
        self.capabilities = instrument.capabilities
        self._instrument = instrument
        self._lock = threading.Lock()
        self._numbers: dict[tuple[object, int], int] = {}  # (host, its number) -> the instrument's number
        self._rested = 0.0

    def scan(self, pattern: DrivePattern) -> Frame:
        """Drive `pattern` once, when no other host does."""
        with self._lock:
            return self._instrument.scan(pattern)

    @property
    def rest(self) -> float:
        """For how long no touch is taken (s): after one that took long, as long again, which others get."""
        return max(self._rested - time.monotonic(), 0.0)

    def press(self, host: object, press: PressCommand) -> None:
        """Put, move or lift a touch of a host.

        Raises:
            DeviceRefused: If too many touches are down, or the instrument refuses.
        """
        with self._lock:
            key = (host, press.number)
            number = self._numbers.get(key)
            if number is None:
                if press.pressure == 0:
                    return
                if len(self._numbers) >= MOST_PRESSES:
                    raise DeviceRefused(f"{MOST_PRESSES} presses are down, which is the most; lift one first")
                number = min(set(range(MOST_PRESSES)).difference(self._numbers.values()))
            started = time.monotonic()
            # may refuse: then nothing has changed
            self._instrument.press(number, press.x, press.y, press.radius, press.pressure)
            if (took := time.monotonic() - started) > _COSTLY:
                self._rested = started + 2 * took
            if press.pressure == 0:
                del self._numbers[key]
            else:
                self._numbers[key] = number

    def lift(self, host: object) -> None:
        """Lift every touch of a host."""
        with self._lock:
            for key in [key for key in self._numbers if key[0] is host]:
                self._instrument.press(self._numbers.pop(key), 0.0, 0.0, 1e-3, 0.0)
