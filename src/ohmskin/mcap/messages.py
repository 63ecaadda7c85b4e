"""The messages of a recording: how frames, patterns and contacts are packed and read back.

Their definitions, with units, are in `ohmskin.mcap.schemas` and in every recording itself. What reads a message raises
`DataError` for bytes that are not one.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from ohmskin.arrays import Floats, quiet_nans
from ohmskin.client.cdr import CdrDecoder, CdrEncoder
from ohmskin.client.fields import as_number, attributes, components, numbers
from ohmskin.contacts import Contact
from ohmskin.errors import DataError, PatternError
from ohmskin.mcap.standard import read_array
from ohmskin.scan import DrivePattern, Frame, FrameFlag

_FRAME_START = struct.Struct("<4x iI dd Q II B 3x I")  # the fields of a frame up to the number of its voltages
_COUNT = struct.Struct("<I4x")
_LENGTH = struct.Struct("<I")
_BESIDE = struct.Struct("<d?")  # the auxiliary channel, and whether there is one; not in recordings before 0.2
_LARGEST_INDEX = 0xFFFF
_CONTACT = "i" + "d" * (len(components(2)) - 1)


class Role(IntEnum):
    """Purpose of a frame."""

    UNKNOWN = 0  #: not known
    BASE = 1  #: the first scan of a cycle
    CHOSEN = 2  #: a later one, whose pattern depends on what the first one showed
    QUIET = 3  #: the untouched skin, to calibrate


@dataclass(frozen=True)
class FrameRecord:
    """A recorded frame and what is known of it.

    Args:
        voltages, currents, time, sequence, flags, auxiliary: As in `Frame`.
        arrived: When it arrived, on the host's monotonic clock (s).
        stamp: When it arrived, by the calendar (ns since 1970).
        pattern: Digest of its pattern.
        role: Purpose of the scan.
        mode: Name of the mode; empty if not recorded.
    """

    voltages: Floats
    currents: Floats
    time: float
    sequence: int
    flags: FrameFlag
    arrived: float
    stamp: int
    pattern: int
    role: Role
    mode: str
    auxiliary: float | None = None

    def frame(self, pattern: DrivePattern) -> Frame:
        """The frame, given its pattern.

        Raises:
            DataError: If it was measured with another pattern.
        """
        told = self.time, self.sequence, self.flags
        return Frame(pattern, self.voltages, self.currents, *told, auxiliary=self.auxiliary)


@dataclass(frozen=True)
class TouchRecord:
    """Contacts and frames of a recorded cycle.

    Args:
        sequence: Number of the cycle.
        time: Of its last sample, on the host's monotonic clock (s).
        stamp: When it was recorded, by the calendar (ns since 1970).
        mode: Name of the mode.
        frames: Sequence numbers of its frames.
        contacts: Tracked contacts.
    """

    sequence: int
    time: float
    stamp: int
    mode: str
    frames: tuple[int, ...]
    contacts: tuple[Contact, ...]


def encode_pattern(pattern: DrivePattern) -> bytes:
    """`ohmskin_msgs/msg/Pattern`."""
    if max(int(pattern.injections.max()), int(pattern.measurements[:, 1:].max())) > _LARGEST_INDEX:
        raise DataError(f"a recording numbers electrodes up to {_LARGEST_INDEX}; the pattern names a higher one")
    injections, measurements = pattern.injections.astype("<u2").ravel(), pattern.measurements.astype("<u4").ravel()
    return CdrEncoder().put("I", pattern.digest).array(injections).array(measurements).done()


def decode_pattern(data: bytes) -> DrivePattern:
    """The pattern of a message.

    Raises:
        DataError: If it is none.
    """
    decoder = CdrDecoder(data)
    decoder.take("I")
    injections, measurements = read_array(decoder, "u2"), read_array(decoder, "u4")
    if injections.size % 2 or measurements.size % 3:
        raise DataError(f"a pattern of {injections.size} and {measurements.size} numbers; need pairs and triples")
    try:
        return DrivePattern(injections.reshape(-1, 2), measurements.reshape(-1, 3))
    except PatternError as error:
        raise DataError(f"a recorded pattern cannot be used: {error}") from error


def encode_frame(frame: Frame, stamp: int, arrived: float, role: Role, mode: str) -> bytes:
    """`ohmskin_msgs/msg/Frame`. Packed in one go, because the loop waits for it."""
    sequence, flags = frame.sequence & 0xFFFFFFFFFFFFFFFF, int(frame.flags) & 0xFFFFFFFF
    n_meas, n_inj = len(frame.voltages), len(frame.currents)
    times = *divmod(stamp, 10**9), frame.time, arrived
    start = _FRAME_START.pack(*times, sequence, frame.pattern.digest, flags, role, n_meas)
    volts, amperes = (values.astype("<f8", copy=False).tobytes() for values in (frame.voltages, frame.currents))
    text, there = mode.encode() + b"\0", frame.auxiliary is not None
    # behind 8-byte floats a string's length is aligned already
    beside = b"\0" * (-(_LENGTH.size + len(text)) % 8) + _BESIDE.pack(as_number(frame.auxiliary), there)
    parts = [b"\0\1\0\0", start[4:], volts, _COUNT.pack(n_inj), amperes, _LENGTH.pack(len(text)), text, beside]
    return b"".join(parts)


def decode_frame(data: bytes) -> FrameRecord:
    """The frame of a message, whose time is one. Read in one go, because an index reads them all.

    Raises:
        DataError: If it is none.
    """
    try:
        seconds, nanoseconds, at, arrived, *numbers, role, n_meas = _FRAME_START.unpack_from(data)
        voltages = quiet_nans(np.frombuffer(data, "<f8", n_meas, _FRAME_START.size))
        start = _FRAME_START.size + voltages.nbytes
        (n_inj,) = _LENGTH.unpack_from(data, start)
        currents = quiet_nans(np.frombuffer(data, "<f8", n_inj, start + _COUNT.size))
        start += _COUNT.size + currents.nbytes
        (length,) = _LENGTH.unpack_from(data, start)
    except (struct.error, ValueError) as error:
        raise DataError(f"a recorded frame ends early: {error}") from error
    sequence, pattern, flags = numbers
    text = data[start + _LENGTH.size : start + _LENGTH.size + length]
    if data[:2] != b"\0\1" or len(text) != length or not abs(arrived) < 1e15:
        raise DataError("a recorded frame is malformed")
    known = Role(role) if role in Role._value2member_map_ else Role.UNKNOWN
    stamp, mode = seconds * 10**9 + nanoseconds, text.rstrip(b"\0").decode(errors="replace")
    told = at, sequence, FrameFlag(flags), arrived, stamp, pattern, known, mode
    start += _LENGTH.size + length
    start += -(start - 4) % 8
    value, there = _BESIDE.unpack_from(data, start) if len(data) >= start + _BESIDE.size else (0.0, 0)
    return FrameRecord(voltages, currents, *told, auxiliary=float(value) if there else None)


def encode_touch(
    sequence: int, at: float, stamp: int, mode: str, frames: Sequence[int], contacts: Sequence[Contact]
) -> bytes:
    """`ohmskin_msgs/msg/Touch`."""
    encoder = CdrEncoder().stamp(stamp).put("Qd", sequence, at).text(mode)
    encoder.array(np.array(frames, "u8")).put("I", len(contacts))
    for c in contacts:
        encoder.put(_CONTACT, *numbers(c, 2))
    return encoder.done()


def decode_touch(data: bytes, names: Sequence[str] = components(2)) -> TouchRecord:
    """The cycle of a message.

    Args:
        data: The message.
        names: The numbers of its contacts in order, the id (int32) first: an older recording has fewer.
    """
    decoder = CdrDecoder(data)
    stamp = decoder.stamp()
    sequence, at = decoder.take("Qd")
    mode, frames = decoder.text(), read_array(decoder, "u8")
    kinds = "i" + "d" * (len(names) - 1)
    found = [dict(zip(names, decoder.take(kinds), strict=True)) for _ in range(decoder.count(8 * len(names) - 4))]
    contacts = tuple(Contact(**attributes(own, 2)) for own in found)
    return TouchRecord(int(sequence), float(at), stamp, mode, tuple(frames.tolist()), contacts)
