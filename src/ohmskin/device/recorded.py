"""Frames of a recording in order, what the recorded device could do, and the quiet frames of its calibrations."""

from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ohmskin.arrays import Floats, Ints
from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.errors import DataError, PatternError, ProtocolError
from ohmskin.importers import Recording
from ohmskin.mcap import RecordingReader, Role
from ohmskin.scan import DrivePattern, Frame


class SteadyFrames:
    """Frames of others, one after the other at a steady rate."""

    def __init__(self, frames: Sequence[Frame], rate: float) -> None:
        self.frames = frames
        self.times: Floats = np.arange(len(frames)) / rate
        self.roles = np.full(len(frames), Role.BASE, np.int64)
        self.mode_of = self.pattern_numbers = np.zeros(len(frames), np.int64)
        self.modes = ["recorded"]

    def frame(self, index: int) -> Frame:
        return self.frames[index]

    def pattern(self, index: int) -> DrivePattern:
        return self.frames[index].pattern


RecordedFrames = RecordingReader | SteadyFrames  # frames in order, with what is known of each


class RecordedQuietFrames:
    """The quiet frames of a recording's calibrations, given round and round in the order they were scanned.

    Args:
        frames: All frames of the recording.

    Attributes:
        at: Which frame of the calibration comes next.
    """

    def __init__(self, frames: RecordedFrames) -> None:
        self._frames = frames
        quiet = np.flatnonzero(frames.roles == Role.QUIET)
        self.calibrations = np.split(quiet, np.flatnonzero(np.diff(quiet) > 1) + 1)
        self.at = 0

    def next(self, pattern: DrivePattern, calibration: int) -> Frame:
        """The next quiet frame of a calibration with a pattern, or one made of several that hold its measurements.

        Raises:
            PatternError: If they do not hold all of them.
        """
        segment = self.calibrations[calibration]
        order = np.roll(segment, -self.at)
        for k, index in enumerate(order.tolist()):
            if self._frames.pattern(index) == pattern:
                self.at = (self.at + k + 1) % len(segment)
                return self._frames.frame(index)
        voltages, currents = np.full(pattern.n_meas, np.nan), np.full(pattern.n_inj, np.nan)
        missing = dict(enumerate(map(tuple, pattern.quadruples.tolist())))
        for k, index in enumerate(order.tolist()):
            rows = _rows(self._frames.pattern(index))
            if not (found := {m: rows[quadruple] for m, quadruple in missing.items() if quadruple in rows}):
                continue
            frame, there = self._frames.frame(index), list(found.values())
            voltages[list(found)] = frame.voltages[there]
            currents[pattern.measurements[list(found), 0]] = frame.measurement_currents[there]
            missing = {m: quadruple for m, quadruple in missing.items() if m not in found}
            if not missing:
                self.at = (self.at + k + 1) % len(segment)
                return Frame(pattern, voltages, currents, 0.0, frame.sequence, frame.flags, auxiliary=frame.auxiliary)
        raise PatternError(
            f"the recording has no quiet reference for {len(missing)} of {pattern.n_meas} measurements; "
            "replay it with the skin it was made with"
        )


@lru_cache(64)
def _rows(pattern: DrivePattern) -> dict[tuple[int, ...], int]:
    """Where each source, sink, plus and minus was measured."""
    return {tuple(quadruple): row for row, quadruple in enumerate(pattern.quadruples.tolist())}


def whole_cycles(frames: RecordedFrames, run: Ints) -> Ints:
    """Frames without first scans that lost their second one, as device or recording ended between the two."""
    roles, modes = frames.roles[run], frames.mode_of[run]
    adaptive = np.isin(modes, np.unique(modes[roles == Role.CHOSEN]))
    followed = np.append(roles[1:] == Role.CHOSEN, False)
    whole: Ints = run[~((roles == Role.BASE) & adaptive & ~followed)]
    return whole


def tracking_modes(frames: RecordedFrames, reader: RecordingReader | None) -> NDArray[np.bool_]:
    """Which modes have frames of one scan that depends on what is touched (n_modes,)."""
    told = reader.recorded_modes if reader else {}
    # recordings made before they kept their modes have one such mode, and its name ends with a T
    return np.array([told.get(name, {}).get("adjustable", name.endswith("T")) for name in frames.modes], bool)


def recorded_capabilities(recording: Recording) -> Capabilities:
    """Those of the recorded device, so that patterns are split as they were; presses excepted.

    Raises:
        DataError: If a recording of ours does not have them.
    """
    if (reader := recording.reader) is None:
        pattern = recording.frames[0].pattern
        n_elec = int(pattern.quadruples.max()) + 1
        return Capabilities("replay", n_elec, pattern.n_inj, pattern.n_meas, features=Feature.CURRENT_MEASURED)
    with suppress(KeyError, ValueError, ProtocolError, OverflowError):
        return Capabilities.from_texts(reader.metadata.get("device", {}))
    missing = "the device's capabilities (metadata record 'device')"
    raise DataError(f"{reader.path} lacks {missing}; it was not made by ohmskin")
