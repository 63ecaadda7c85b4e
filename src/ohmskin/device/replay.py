"""A recording as a device: its frames come again, at any pace, from any place, round and round or once."""

import os
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ohmskin.device import recorded as parts
from ohmskin.device.driver import Device
from ohmskin.device.recorded import RecordedFrames, RecordedQuietFrames, SteadyFrames
from ohmskin.drive import Drive
from ohmskin.errors import DataError, DeviceError, PatternError
from ohmskin.forward import TransferModel
from ohmskin.importers import read_recording, resolved
from ohmskin.mcap import Role
from ohmskin.scan import DrivePattern, Frame
from ohmskin.sensing import modes
from ohmskin.skin import Mode, Skin, shipped_skins

_MOST_BASES = 256
_LATE = 0.25  # s; a replay that is later than this goes on from where it is instead of catching up


class ReplayDevice(Device):
    """Replays a recording through the same interface as a real device.

    A recording of ours holds the quiet frames of its calibrations in the order they were scanned. While the loop
    calibrates they come again, so that it learns the very same baseline and thresholds; then come the frames of each
    cycle. Scans that the loop does not ask for, such as the second ones of an adaptive mode when a fixed mode is
    replayed, are skipped. An adaptive loop that would choose other pairs than were driven gets the frame that was
    recorded; a frame carries its own pattern.

    Args:
        url: ``replay:`` and the file; the settings below may follow it, as in ``replay:touch.mcap?speed=2&loop=0``.
        rate: Frames per second of recordings without times.
        speed: Seconds of the recording per second; infinity for no waiting at all.
        start: Where to begin (s from the first frame).
        loop: Whether to begin again at the end.

    Attributes:
        path: The file.
        recording: What is replayed.
        loop: As above; may be changed at any time.
        calibrating: Asked whether the loop calibrates; until it is set, quiet frames come once, at the start.
        jumps: How often it was sent elsewhere; whoever follows contacts begins anew when this changes.

    Raises:
        DataError: If the file is not a recording.
        PatternError: If `rate` or `speed` is not positive.
        DeviceError: If the address names no file, or has a setting that is none.
    """

    def __init__(self, url: str, rate: float = 30.0, speed: float = 1.0, start: float = 0.0, loop: bool = True) -> None:
        path, (rate, speed, start, told) = _address(url, rate=rate, speed=speed, start=start, loop=loop)
        if not path:
            raise DeviceError(f"{url} names no file; need replay:FILE such as replay:touch.mcap")
        if not 0 < rate <= 1e5:
            raise PatternError(f"replay rate is {rate} frames/s; it must be above 0 and at most 100000")
        self.path, self.recording = Path(path), read_recording(path)
        reader = self.recording.reader
        self._reel: RecordedFrames = reader or SteadyFrames(self.recording.frames, rate)
        try:
            super().__init__(url, parts.recorded_capabilities(self.recording))
            if reader is None or reader.metadata.get("device", {}).get("reference", "0") != "0":
                self.reference = tuple(self.recording.quiet)
                self.default_skin = self.recording.skin
            self._quiet = RecordedQuietFrames(self._reel)
            self._run = parts.whole_cycles(self._reel, np.flatnonzero(self._reel.roles != Role.QUIET))
            if not len(self._run):
                raise DataError(f"{path} holds a calibration only; it has no frames to replay")
            self._tracking = parts.tracking_modes(self._reel, reader)
            tracked = self._tracking[self._reel.mode_of[self._run]]
            begins = (self._reel.roles[self._run] != Role.CHOSEN) | tracked
            self._firsts = np.flatnonzero(begins)  # cycles: not at second scans, but at every frame of tracking modes
            bases = self._run[begins & ~tracked]
            numbers, first = np.unique(self._reel.pattern_numbers[bases], return_index=True)
            known = zip(numbers[:_MOST_BASES].tolist(), bases[first].tolist(), strict=False)
            self._bases = {self._reel.pattern(index): number for number, index in known}
            chosen = self._reel.roles == Role.CHOSEN
            self._adaptive = np.bincount(self._reel.mode_of[chosen], minlength=len(self._reel.modes)) > 0
            self._at = self._sought = self.jumps = self._served = 0
            self._was_quiet = self._ended = False
            self._quiet_left = 0 if self.reference else len(self._quiet.calibrations[0])
            self.loop = bool(told)
            self.calibrating: Callable[[], bool] | None = None
            self.speed = speed
            self.seek(start)
            self.default_mode = self.mode
        except BaseException:
            self._close()
            raise

    def resolve(self, model: TransferModel) -> None:
        """Take what others recorded as voltages, as `resolved` does with the `model` of the untouched skin."""
        found = resolved(self.recording, model)
        one = "one press a frame: contacts are told where several frames show them; `ohmskin image --frame N` shows one"
        self.recording = replace(found, notes=(*found.notes, one))
        self.reference = tuple(self.recording.quiet)
        assert isinstance(self._reel, SteadyFrames)
        self._reel.frames = self.recording.frames

    @property
    def description(self) -> str:
        """The recorded skin's description (TOML); empty if the file has none."""
        return self.recording.reader.skin if self.recording.reader else ""

    @property
    def speed(self) -> float:
        """Seconds of the recording per second."""
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        if not speed > 0:
            raise PatternError(f"replay speed is {speed}; it must be above 0 (inf: without waiting)")
        self._speed = speed
        self._anchor: tuple[float, float] | None = None  # the clock, and the time in the recording, from which to count

    @property
    def duration(self) -> float:
        """Length of the recording from its first frame behind the calibration to its last (s)."""
        return float(self._reel.times[self._run[-1]])

    @property
    def position(self) -> float:
        """Where the next frame is (s)."""
        return float(self._reel.times[self._next()])

    @property
    def ended(self) -> bool:
        """Whether all was played; never while it loops."""
        return not self.loop and (self._ended or self._at >= len(self._run))

    @property
    def exhausted(self) -> bool:
        """Whether no cycle begins from here on; it is over, or begins again if it loops."""
        return bool(len(self._firsts)) and self._at > int(self._firsts[-1])

    @property
    def leading(self) -> bool:
        """Whether the next frame is of the lead before the place that was sought."""
        return self._at < self._sought

    @property
    def mode(self) -> str:
        """The mode of the next frame; empty if it was not recorded."""
        return str(self._reel.modes[int(self._reel.mode_of[self._next()])])

    @property
    def calibration(self) -> int:
        """Which of the recorded calibrations the next frame belongs to."""
        starts = [int(segment[0]) for segment in self._quiet.calibrations if len(segment)]
        return max(0, int(np.searchsorted(starts, self._next())) - 1)

    def playable(self, drive: Drive) -> bool:
        """Whether frames of a drive were recorded here."""
        mode = self._reel.mode_of[self._next()]
        if drive.adjustable:
            return bool(self._tracking[mode])
        return drive.next((), 0) in self._bases and (drive.scans == 1 or bool(self._adaptive[mode]))

    def seek(self, position: float, lead: int = 0) -> None:
        """Go to a place (s from the first frame); the next cycle is the first one from there, or the last one of all.

        Args:
            position: The place.
            lead: So many cycles before it come first, without waiting, so that contacts are known when it is reached.

        Raises:
            DataError: If it is not within the recording.
        """
        if not 0 <= position <= self.duration:
            raise DataError(f"position {position:g} s; the recording has 0 to {self.duration:g} s")
        times = self._reel.times[self._run[self._firsts]]
        self._go(int(np.searchsorted(times, position - 1e-9)), lead)

    def step(self, cycles: int = 1, lead: int = 0) -> None:
        """Go so many cycles on, or back if negative; stops at the ends. For `lead` see `seek`."""
        self._go(int(np.searchsorted(self._firsts, max(self._at, self._sought))) + cycles, lead)

    def _go(self, cycle: int, lead: int) -> None:
        cycle = min(max(cycle, 0), len(self._firsts) - 1)
        with self._lock:
            self._sought = int(self._firsts[cycle]) if len(self._firsts) else 0
            self._at = int(self._firsts[max(cycle - lead, 0)]) if len(self._firsts) else 0
            self._ended, self._anchor = False, None
            self.jumps += 1

    def _next(self) -> int:
        return int(self._run[min(self._at, len(self._run) - 1)])

    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        quiet = self.calibrating() if self.calibrating else self._quiet_left > 0
        if quiet and not self.reference and len(self._quiet.calibrations[0]):
            if not self._was_quiet:
                self._quiet.at = 0
            self._was_quiet = True
            self._quiet_left -= 1
            return replace(self._quiet.next(pattern, self.calibration), time=time.monotonic())
        self._was_quiet, self._quiet_left = False, 0
        index = self._find(pattern)
        if self._at > self._sought:
            self._sought = 0
            self._wait(float(self._reel.times[index]), timeout)
        frame = self._reel.frame(index)
        self._served += 1
        sequence = frame.sequence if self.recording.reader else self._served
        recorded = frame.time if self.recording.reader else float(self._reel.times[index])
        return replace(frame, time=time.monotonic(), sequence=sequence, recorded=recorded)

    def _find(self, pattern: DrivePattern) -> int:
        """The frame to give for a pattern; the next one is behind it."""
        if self._at >= len(self._run) and self.loop:
            self._at, self._sought, self._anchor = 0, 0, None
        if self._at < len(self._run):
            index, number = int(self._run[self._at]), self._bases.get(pattern)
            # a loop that tracks chooses other pairs where contacts are tracked anew, and so does one that adapts
            chosen = self._tracking[self._reel.mode_of[index]] or self._reel.roles[index] == Role.CHOSEN
            if self._reel.pattern(index) == pattern or (chosen and number is None):
                self._at += 1
                return index
            if number is None:
                modes = [self._reel.modes[k] for k in np.unique(self._reel.mode_of[self._run])]
                told = ", ".join(filter(None, modes)) or "not recorded"
                raise PatternError(
                    f"a recording can only replay what was recorded; its modes are {told}; "
                    "use one of them, or the recording's own pattern (device.reference[0].pattern) if it has no modes"
                )
            wanted = (self._reel.pattern_numbers[self._run] == number) & (self._reel.roles[self._run] != Role.CHOSEN)
            there = np.flatnonzero(wanted)  # the next frame with this base pattern
            ahead = there[there >= self._at]
            if len(ahead) or self.loop:
                if not len(ahead):
                    self._sought, self._anchor = 0, None
                self._at = int(ahead[0] if len(ahead) else there[0]) + 1
                return int(self._run[self._at - 1])
        self._ended = True
        raise DeviceError("the recording has ended; seek back or let it loop")

    def _wait(self, at: float, timeout: float) -> None:
        now = time.monotonic()
        if self._anchor is None or at < self._anchor[1] or self._speed == np.inf:
            self._anchor = (now, at)
            return
        due = self._anchor[0] + (at - self._anchor[1]) / self._speed
        if due - now > timeout or now - due > _LATE:
            due = min(due, now + timeout)
            self._anchor = (max(due, now), at)
        time.sleep(max(0.0, due - now))

    def _close(self) -> None:
        if self.recording.reader:
            self.recording.reader.close()


def recorded_skin(device: ReplayDevice, skin: str = "") -> Skin:
    """The `skin` named, or that of the recording which a `device` replays, with the modes that were recorded.

    Press data are voltages from then on, see `ReplayDevice.resolve`.

    Raises:
        SkinError: If it is not a valid description.
        DataError: If none is named and the recording has none.
    """
    if not skin and not device.description and not device.default_skin:
        choices = f"a skin, a .toml file or {', '.join(shipped_skins())}"
        raise DataError(f"{device.url} does not name its skin; name {choices}")
    recorded = device.description and not skin
    named = f"the skin in {device.url}"
    found = Skin.parse(device.description, named) if recorded else Skin.load(skin or device.default_skin)
    told = device.recording.reader.recorded_modes if device.recording.reader else {}
    if device.recording.positions is not None:  # press data
        device.resolve(found.transfer_model())
    known, own = modes(found), {mode.name: mode for mode in found.modes}
    for name, entries in told.items():
        mode = Mode.of(name, {key: value for key, value in entries.items() if key != "adjustable"})
        if mode != known.get(name):
            own[name] = mode
    return replace(found, modes=tuple(own.values()))


def _address(url: str, **settings: float) -> tuple[str, Iterable[float]]:
    """The file an address names, and the settings, which may be given behind it, in their order."""
    path, mark, query = (rest := url.partition(":")[2]).rpartition("?")
    if not mark or os.path.exists(rest):
        return rest, settings.values()
    for part in query.split("&"):
        name, _, value = part.partition("=")
        if name not in settings:
            raise DeviceError(f"replay: has no setting {name!r}; it takes {', '.join(settings)}")
        try:
            settings[name] = float(value)
        except ValueError:
            raise DeviceError(f"{part!r} in {url}: settings are numbers, such as speed=2&start=10&loop=0") from None
    return path, settings.values()
