"""A recording as a device: its frames come again, at any pace, from any place, round and round or once."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.device.driver import Device
from ohmskin.device.press import Press
from ohmskin.errors import DataError, DeviceError, DeviceRefused, PatternError, ProtocolError
from ohmskin.record import Recording, Role, Tape, read_recording
from ohmskin.scan import DrivePattern, Frame
from ohmskin.scan.frame import Floats
from ohmskin.scan.pairs import Ints

_MOST_BASES = 256
_LATE = 0.25  # s; a replay that is later than this goes on from where it is instead of catching up
_SHIFT = np.int64(1) << np.arange(45, -1, -15, dtype=np.int64)


class _Reel(Protocol):
    """Frames in order, with what is known of each."""

    @property
    def times(self) -> Floats: ...
    @property
    def roles(self) -> Ints: ...
    @property
    def mode_of(self) -> Ints: ...
    @property
    def modes(self) -> list[str]: ...
    @property
    def pattern_numbers(self) -> Ints: ...
    def frame(self, index: int) -> Frame: ...
    def pattern(self, index: int) -> DrivePattern: ...


class _Frames:
    """Frames of others, one after the other at a steady rate."""

    def __init__(self, frames: Sequence[Frame], rate: float) -> None:
        self._frames = frames
        self.times: Floats = np.arange(len(frames)) / rate
        self.roles = np.full(len(frames), Role.BASE, np.int64)
        self.mode_of = self.pattern_numbers = np.zeros(len(frames), np.int64)
        self.modes = ["recorded"]

    def frame(self, index: int) -> Frame:
        return self._frames[index]

    def pattern(self, index: int) -> DrivePattern:
        return self._frames[index].pattern


class ReplayDevice(Device):
    """Replays a recording through the same interface as a real device.

    A recording of ours holds the quiet frames of its calibrations in the order they were scanned. While the loop calibrates
    they come again, so that it learns the very same baseline and thresholds; then come the frames of each cycle. Scans that
    the loop does not ask for, such as the second ones of an adaptive mode when a fixed mode is replayed, are skipped. An adaptive
    loop that would choose other pairs than were driven gets the frame that was recorded; a frame carries its own pattern.

    Args:
        url: ``replay:`` and the file; the settings below may follow it, as in ``replay:touch.mcap?speed=2&loop=0``.
        rate: Frames per second of recordings that hold no times.
        speed: Seconds of the recording per second; infinity for no waiting at all.
        start: Where to begin (s from the first frame).
        loop: Whether to begin again at the end.

    Attributes:
        recording: What is replayed.
        loop: As above; may be changed at any time.
        calibrating: Asked whether the loop calibrates; until it is set, quiet frames come once, at the start.
        jumps: How often it was sent elsewhere; whoever follows contacts begins anew when this changes.

    Raises:
        DataError: If the file is not a recording.
        PatternError: If `rate` or `speed` is not positive.
        DeviceError: If the address has a setting that is none.
    """

    def __init__(self, url: str, rate: float = 30.0, speed: float = 1.0, start: float = 0.0, loop: bool = True) -> None:
        path, told = _address(url)
        rate, speed, start = (told.get(name, usual) for name, usual in (("rate", rate), ("speed", speed), ("start", start)))
        loop = bool(told.get("loop", loop))
        if not 0 < rate <= 1e5:
            raise PatternError(f"replay rate is {rate} frames/s; it must be above 0 and at most 100000")
        self.recording = read_recording(path)
        tape = self.recording.tape
        self._reel: _Reel = tape or _Frames(self.recording.frames, rate)
        try:
            super().__init__(url, _recorded_capabilities(tape) if tape else _plain_capabilities(self.recording))
            quiet = self._reel.roles == Role.QUIET
            if tape is None or tape.metadata.get("device", {}).get("reference", "0") != "0":
                self.reference = tuple(self.recording.quiet)
                self.default_skin = self.recording.skin
            self._segments = np.split(np.flatnonzero(quiet), _breaks(quiet))
            self._run = _whole_cycles(self._reel, np.flatnonzero(~quiet))
            if not len(self._run):
                raise DataError(f"{path} holds a calibration and nothing else; there is nothing to replay")
            self._tracking = _tracking_modes(self._reel, self._run)
            tracked = self._tracking[self._reel.mode_of[self._run]]
            begins = (self._reel.roles[self._run] != Role.CHOSEN) | tracked
            self._firsts = np.flatnonzero(begins)  # where cycles begin: not at second scans, but at every frame of tracking modes
            self._bases = self._base_patterns()
            self._steady = {int(number) for number in self._reel.pattern_numbers[self._run[begins & ~tracked]]}
            self._codes_by_pattern: dict[int, tuple[Ints, Ints]] = {}
            chosen = self._reel.roles == Role.CHOSEN
            self._adaptive = np.bincount(self._reel.mode_of[chosen], minlength=len(self._reel.modes)) > 0
            self._at, self._quiet_at, self._was_quiet = 0, 0, False
            self._sought, self.jumps = 0, 0
            self._served = 0
            self._quiet_left = 0 if self.reference else len(self._segments[0])
            self._ended = False
            self.loop = loop
            self.calibrating: Callable[[], bool] | None = None
            self.speed = speed
            self.seek(start)
        except BaseException:
            if tape:
                tape.close()
            raise

    @property
    def description(self) -> str:
        """The recorded skin's description (TOML); empty if the file has none."""
        return self.recording.tape.skin if self.recording.tape else ""

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
        """The drive mode of the next frame; empty if it is not told."""
        return str(self._reel.modes[int(self._reel.mode_of[self._next()])])

    @property
    def modes(self) -> tuple[str, ...]:
        """The drive modes that were recorded, as far as told."""
        used = np.unique(self._reel.mode_of[self._run])
        return tuple(name for k in used if (name := self._reel.modes[k]))

    @property
    def calibration(self) -> int:
        """Which of the recorded calibrations the next frame belongs to."""
        starts = [int(segment[0]) for segment in self._segments if len(segment)]
        return max(0, int(np.searchsorted(starts, self._next())) - 1)

    def playable(self, pattern: DrivePattern, adaptive: bool) -> bool:
        """Whether cycles that begin with this pattern were recorded; adaptive ones must have been so here."""
        return pattern in self._bases and (not adaptive or bool(self._adaptive[self._reel.mode_of[self._next()]]))

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
        if quiet and not self.reference and len(self._segments[0]):
            if not self._was_quiet:
                self._quiet_at = 0
            self._was_quiet = True
            self._quiet_left -= 1
            return replace(self._quiet(pattern), time=time.monotonic())
        self._was_quiet, self._quiet_left = False, 0
        index = self._find(pattern)
        if self._at > self._sought:
            self._sought = 0
            self._wait(float(self._reel.times[index]), timeout)
        frame = self._reel.frame(index)
        self._served += 1
        sequence = frame.sequence if self.recording.tape else self._served
        recorded = frame.time if self.recording.tape else float(self._reel.times[index])
        return replace(frame, time=time.monotonic(), sequence=sequence, recorded=recorded)

    def _find(self, pattern: DrivePattern) -> int:
        """The frame to give for a pattern; the next one is behind it."""
        if self._at >= len(self._run) and self.loop:
            self._at, self._sought, self._anchor = 0, 0, None
        if self._at < len(self._run):
            index = int(self._run[self._at])
            if self._reel.pattern(index) == pattern:
                self._at += 1
                return index
            number = self._bases.get(pattern)
            if self._tracking[self._reel.mode_of[index]] and number not in self._steady:
                self._at += 1  # of a loop that tracks; it chooses other pairs where contacts are tracked anew
                return index
            if number is not None:
                return self._skip_to(number)
            if self._reel.roles[index] == Role.CHOSEN:
                self._at += 1
                return index
            raise PatternError(
                f"a recording can only replay what was recorded; its modes are {', '.join(self.modes) or 'not told'}; "
                "use one of them, or the recording's own pattern (device.reference[0].pattern) if it has no modes"
            )
        self._ended = True
        raise DeviceError("the recording has ended; seek back or let it loop")

    def _skip_to(self, number: int) -> int:
        """The next frame with a base pattern."""
        wanted = (self._reel.pattern_numbers[self._run] == number) & (self._reel.roles[self._run] != Role.CHOSEN)
        there = np.flatnonzero(wanted)
        ahead = there[there >= self._at]
        if not len(ahead) and not self.loop:
            self._ended = True
            raise DeviceError("the recording has ended; seek back or let it loop")
        at = int(ahead[0] if len(ahead) else there[0])
        if at < self._at:
            self._sought, self._anchor = 0, None
        self._at = at + 1
        return int(self._run[at])

    def _quiet(self, pattern: DrivePattern) -> Frame:
        """The next quiet frame with a pattern, or one put together of several that hold its measurements."""
        segment = self._segments[self.calibration]
        count = len(segment)
        for k in range(count):
            at = (self._quiet_at + k) % count
            if self._reel.pattern(int(segment[at])) == pattern:
                self._quiet_at = (at + 1) % count
                return self._reel.frame(int(segment[at]))
        voltages, currents = np.full(pattern.n_meas, np.nan), np.full(pattern.n_inj, np.nan)
        missing = np.ones(pattern.n_meas, bool)
        wanted = _codes(pattern)
        for k in range(count):
            index = int(segment[(self._quiet_at + k) % count])
            codes = self._sorted_codes(index)
            place = np.minimum(np.searchsorted(codes[0], wanted), len(codes[0]) - 1)
            found = missing & (codes[0][place] == wanted)
            if found.any():
                frame = self._reel.frame(index)
                rows = codes[1][place[found]]
                voltages[found] = frame.voltages[rows]
                currents[pattern.measurements[found, 0]] = frame.currents[frame.pattern.measurements[rows, 0]]
                missing &= ~found
                if not missing.any():
                    self._quiet_at = (self._quiet_at + k + 1) % count
                    return Frame(pattern, voltages, currents, 0.0, frame.sequence, frame.flags)
        raise PatternError(
            f"the recording has no quiet reference for {int(missing.sum())} of {pattern.n_meas} measurements; "
            "replay it with the skin it was made with"
        )

    def _sorted_codes(self, index: int) -> tuple[Ints, Ints]:
        """The codes (n_meas,) of a quiet frame's measurements, rising, and the measurement of each."""
        number = int(self._reel.pattern_numbers[index])
        if number not in self._codes_by_pattern:
            codes = _codes(self._reel.pattern(index))
            order = np.argsort(codes)
            self._codes_by_pattern[number] = codes[order], order
        return self._codes_by_pattern[number]

    def _base_patterns(self) -> dict[DrivePattern, int]:
        begins = self._run[self._reel.roles[self._run] != Role.CHOSEN]
        numbers, first = np.unique(self._reel.pattern_numbers[begins], return_index=True)
        return {
            self._reel.pattern(int(begins[k])): int(number)
            for number, k in zip(numbers[:_MOST_BASES], first[:_MOST_BASES], strict=True)
        }

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

    def _press(self, press: Press) -> None:
        raise DeviceRefused("a recording cannot be pressed")

    def _close(self) -> None:
        if self.recording.tape:
            self.recording.tape.close()


def _address(url: str) -> tuple[str, dict[str, float]]:
    """The file an address names, and the settings behind it."""
    path, mark, query = url.partition(":")[2].rpartition("?")
    if not mark or Path(f"{path}?{query}").exists():
        return url.partition(":")[2], {}
    settings = {}
    for part in query.split("&"):
        name, _, value = part.partition("=")
        try:
            settings[name] = float(value)
        except ValueError:
            raise DeviceError(f"{part!r} in {url}: settings are numbers, such as speed=2&start=10&loop=0") from None
    if unknown := sorted(settings.keys() - {"rate", "speed", "start", "loop"}):
        raise DeviceError(f"replay: has no setting {unknown[0]!r}; it takes rate, speed, start, loop")
    return path, settings


def _codes(pattern: DrivePattern) -> Ints:
    """One number for each measurement."""
    codes: Ints = pattern.quadruples @ _SHIFT
    return codes


def _breaks(quiet: Ints) -> Ints:
    """Where the quiet frames of one calibration end and those of the next one begin, counted in quiet frames."""
    return np.flatnonzero(np.diff(np.flatnonzero(quiet)) > 1) + 1


def _whole_cycles(reel: _Reel, run: Ints) -> Ints:
    """Frames without the first scans that lost their second one, when the device or the recording ended between the two."""
    roles, modes = reel.roles[run], reel.mode_of[run]
    adaptive = np.isin(modes, np.unique(modes[roles == Role.CHOSEN]))
    followed = np.append(roles[1:] == Role.CHOSEN, False)
    whole: Ints = run[~((roles == Role.BASE) & adaptive & ~followed)]
    return whole


def _tracking_modes(reel: _Reel, run: Ints) -> NDArray[np.bool_]:
    """Which modes track (one scan a cycle): those whose choices follow each other (n_modes,)."""
    modes, chosen = reel.mode_of[run], reel.roles[run] == Role.CHOSEN
    again = np.append(False, chosen[1:] & chosen[:-1] & (modes[1:] == modes[:-1]))
    count = len(reel.modes)
    # a frame that the recorder lost leaves two choices together too, but seldom
    tracking: NDArray[np.bool_] = np.bincount(modes[again], minlength=count) > 0.1 * np.bincount(modes[chosen], minlength=count)
    return tracking


def _plain_capabilities(recording: Recording) -> Capabilities:
    pattern = recording.frames[0].pattern
    n_elec = int(pattern.quadruples.max()) + 1
    return Capabilities("replay", n_elec, pattern.n_inj, pattern.n_meas, features=Feature.CURRENT_MEASURED)


def _recorded_capabilities(tape: Tape) -> Capabilities:
    """Those of the recorded device, so that patterns are split as they were; presses excepted."""
    told = tape.metadata.get("device", {})
    with suppress(KeyError, ValueError, ProtocolError, OverflowError):
        return Capabilities(
            told["name"],
            int(told["n_electrodes"]),
            int(told["max_injections"]),
            int(told["max_measurements"]),
            features=Feature(int(told["features"]) & 7) & ~Feature.VIRTUAL,
            excitation=float(told["excitation"]),
            full_scale=float(told["full_scale"]),
            settle_time=float(told["settle_time"]),
            conversion_time=float(told["conversion_time"]),
            serial=int(told["serial"]),
        )
    raise DataError(f"{tape.path} does not say what the device could do (metadata record 'device'); it was not made by ohmskin")
