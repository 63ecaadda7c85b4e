"""A recording as a device: its frames come again, one by one and round and round."""

import time
from dataclasses import replace

from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.device.driver import Device
from ohmskin.device.press import Press
from ohmskin.errors import DeviceRefused, PatternError
from ohmskin.record import read_recording
from ohmskin.scan import DrivePattern, Frame


class ReplayDevice(Device):
    """Replays a recording through the same interface as a real device.

    Args:
        url: ``replay:`` and the file.
        rate: Frames per second.

    Raises:
        DataError: If the file is not a recording.
        PatternError: If `rate` is not positive.
    """

    def __init__(self, url: str, rate: float = 30.0) -> None:
        if not 0 < rate <= 1e5:
            raise PatternError(f"replay rate is {rate} frames/s; it must be above 0 and at most 100000")
        recording = read_recording(url.partition(":")[2])
        pattern = recording.frames[0].pattern
        n_elec = int(pattern.quadruples.max()) + 1
        features = Feature.CURRENT_MEASURED
        super().__init__(url, Capabilities("replay", n_elec, pattern.n_inj, pattern.n_meas, features=features))
        self.reference = recording.quiet
        self.default_skin = recording.skin
        self._frames, self._next, self._period = recording.frames, 0, 1 / rate
        self._due = time.monotonic()

    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        frame = self._frames[self._next % len(self._frames)]
        if pattern != frame.pattern:
            raise PatternError(
                "a recording can only replay the pattern that was recorded; use its own (device.reference[0].pattern)"
            )
        time.sleep(max(0.0, min(self._due - time.monotonic(), timeout)))
        now = time.monotonic()
        self._due = max(self._due + self._period, now)
        self._next += 1
        return replace(frame, time=now, sequence=self._next)

    def _press(self, press: Press) -> None:
        raise DeviceRefused("a recording cannot be pressed")

    def _close(self) -> None:
        pass
