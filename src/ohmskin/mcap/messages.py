"""The messages of a recording: how frames, patterns, contacts, images and health are packed and read back.

Their definitions, with units, are in `ohmskin.mcap.schemas` and in every recording itself.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from ohmskin.arrays import Floats
from ohmskin.client.cdr import Decoder, Encoder
from ohmskin.client.fields import attributes, components, numbers
from ohmskin.contacts import Contact
from ohmskin.errors import DataError, PatternError
from ohmskin.scan import DrivePattern, Frame, FrameFlag

FRAME_ID = "skin"
"""The coordinate frame of contacts and images: metres on the sheet."""

_FRAME_START = struct.Struct("<4x iI dd Q II B 3x I")  # the fields of a frame up to the number of its voltages
_COUNT = struct.Struct("<I4x")
_LENGTH = struct.Struct("<I")
_LARGEST_INDEX = 0xFFFF
_CONTACT = "i" + "d" * (len(components(2)) - 1)
_DELETE_ALL, _ADD, _CYLINDER = 3, 0, 3  # of visualization_msgs/Marker
_FLAGS = FrameFlag(0)


class Role(IntEnum):
    """What a frame was scanned for."""

    UNTOLD = 0
    BASE = 1  # the first scan of a cycle
    CHOSEN = 2  # a later one, whose pattern depends on what the first one showed
    QUIET = 3  # the untouched skin, to calibrate


@dataclass(frozen=True)
class FrameRecord:
    """A recorded frame and what is told about it.

    Args:
        voltages, currents, time, sequence, flags: As in `Frame`.
        arrived: When it arrived, on the host's monotonic clock (s).
        stamp: When it arrived, by the calendar (ns since 1970).
        pattern: Digest of its pattern.
        role: What it was scanned for.
        mode: Name of the drive mode; empty if not told.
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

    def frame(self, pattern: DrivePattern) -> Frame:
        """The frame, given its pattern.

        Raises:
            DataError: If it was measured with another pattern.
        """
        return Frame(pattern, self.voltages, self.currents, self.time, self.sequence, self.flags)


@dataclass(frozen=True)
class FrameHead:
    """What an index needs of a recorded frame: `FrameRecord` without its data."""

    pattern: int
    role: int
    n_meas: int
    n_inj: int
    arrived: float
    mode: str


@dataclass(frozen=True)
class TouchRecord:
    """What a recorded cycle felt.

    Args:
        sequence: Number of the cycle.
        time: Of its last sample, on the host's monotonic clock (s).
        stamp: When it was recorded, by the calendar (ns since 1970).
        mode: Name of the drive mode.
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
    return Encoder().put("I", pattern.digest).array(injections).array(measurements).done()


def decode_pattern(data: bytes) -> DrivePattern:
    """The pattern of a message.

    Raises:
        DataError: If it is not one.
    """
    decoder = Decoder(data)
    decoder.take("I")
    injections, measurements = _array(decoder, "u2"), _array(decoder, "u4")
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
    text = mode.encode() + b"\0"
    # behind 8-byte floats a string's length is aligned already
    return b"".join([b"\0\1\0\0", start[4:], volts, _COUNT.pack(n_inj), amperes, _LENGTH.pack(len(text)), text])


def decode_frame(data: bytes) -> FrameRecord:
    """The frame of a message.

    Raises:
        DataError: If it is not one.
    """
    decoder = Decoder(data)
    stamp = decoder.stamp()
    at, arrived, sequence, pattern, flags, role = decoder.take("ddQIIB")
    voltages, currents, mode = _array(decoder, "f8"), _array(decoder, "f8"), decoder.text()
    known = Role(int(role)) if role in Role._value2member_map_ else Role.UNTOLD
    told = FrameFlag(int(flags)) if flags else _FLAGS
    about = float(at), int(sequence), told, float(arrived), stamp, int(pattern), known, mode
    return FrameRecord(voltages, currents, *about)


def frame_head(data: bytes) -> FrameHead:
    """What an index needs of a frame's message, all its lengths checked.

    Raises:
        DataError: If it is not a frame, or its time is no time.
    """
    try:
        _, _, _, arrived, _, pattern, _, role, n_meas = _FRAME_START.unpack_from(data)
        at = _FRAME_START.size + 8 * n_meas
        (n_inj,) = _LENGTH.unpack_from(data, at)
        at += _COUNT.size + 8 * n_inj
        (length,) = _LENGTH.unpack_from(data, at)
        text = data[at + 4 : at + 4 + length]
    except struct.error as error:
        raise DataError(f"a recorded frame ends early: {error}") from error
    if data[:2] != b"\0\1" or len(text) != length or not abs(arrived) < 1e15:
        raise DataError("a recorded frame is malformed")
    return FrameHead(pattern, min(role, 4) % 4, n_meas, n_inj, arrived, text.rstrip(b"\0").decode(errors="replace"))


def encode_touch(
    sequence: int, at: float, stamp: int, mode: str, frames: Sequence[int], contacts: Sequence[Contact]
) -> bytes:
    """`ohmskin_msgs/msg/Touch`."""
    encoder = Encoder().stamp(stamp).put("Qd", sequence, at).text(mode)
    encoder.array(np.array(frames, "u8")).put("I", len(contacts))
    for c in contacts:
        encoder.put(_CONTACT, *numbers(c, 2))
    return encoder.done()


def decode_touch(data: bytes, names: Sequence[str] = components(2)) -> TouchRecord:
    """The cycle of a message.

    Args:
        data: The message.
        names: The numbers of its contacts in order, the id (int32) first: an older recording has fewer.

    Raises:
        DataError: If it is not one.
    """
    decoder = Decoder(data)
    stamp = decoder.stamp()
    sequence, at = decoder.take("Qd")
    mode, frames = decoder.text(), _array(decoder, "u8")
    kinds = "i" + "d" * (len(names) - 1)
    found = [dict(zip(names, decoder.take(kinds), strict=True)) for _ in range(decoder.count(8 * len(names) - 4))]
    contacts = tuple(Contact(**attributes(own, 2)) for own in found)
    return TouchRecord(int(sequence), float(at), stamp, mode, tuple(frames.tolist()), contacts)


def encode_image(pixels: Floats, stamp: int, frame_id: str = FRAME_ID) -> bytes:
    """`sensor_msgs/msg/Image`, 32FC1, of pixels (ny, nx) with row 0 at the bottom, as `Raster` gives them."""
    height, width = pixels.shape
    flipped = np.ascontiguousarray(pixels[::-1], "<f4")
    encoder = Encoder().stamp(stamp).text(frame_id).put("II", height, width).text("32FC1")
    return encoder.put("BI", 0, 4 * width).array(flipped.view("u1").ravel()).done()


def decode_image(data: bytes) -> Floats:
    """The pixels (ny, nx) of a message, row 0 at the bottom.

    Raises:
        DataError: If it is not a 32FC1 image.
    """
    decoder = Decoder(data)
    decoder.stamp()
    decoder.text()
    height, width = (int(n) for n in decoder.take("II"))
    encoding = decoder.text()
    _, step = decoder.take("BI")
    content = _array(decoder, "u1")
    if encoding != "32FC1" or step != 4 * width or content.size != 4 * width * height:
        raise DataError(f"an image of {height} x {width} pixels, {encoding!r}, {content.size} bytes; need 32FC1")
    return content.view("<f4").reshape(height, width)[::-1].astype(float)


@dataclass(frozen=True)
class Cylinder:
    """A contact drawn in space: a flat cylinder of its extent, red where conductivity rises, blue where it falls.

    Args:
        frame: The frame of its place.
        group: What it belongs to; `number` tells it from others there.
        number: Id of the contact.
        place: x, y, z (m).
        turn: Quaternion x, y, z, w that turns z to its axis.
        extent: Its area (m2).
        strength: Of the contact (m2); its sign chooses the colour.
    """

    frame: str
    group: str
    number: int
    place: tuple[float, float, float]
    turn: tuple[float, float, float, float]
    extent: float
    strength: float


def encode_cylinders(cylinders: Sequence[Cylinder], stamp: int, frame_id: str = FRAME_ID) -> bytes:
    """`visualization_msgs/msg/MarkerArray`: the markers of before go, which is said in `frame_id`, and these come."""
    encoder = Encoder().put("I", 1 + len(cylinders))
    nothing = Cylinder(frame_id, "", 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 0.0, 0.0)
    for action, c in [(_DELETE_ALL, nothing), *((_ADD, cylinder) for cylinder in cylinders)]:
        width = 2 * float(np.sqrt(c.extent / np.pi))
        colour = (0.84, 0.19, 0.15, 0.7) if c.strength >= 0 else (0.19, 0.36, 0.76, 0.7)
        encoder.stamp(stamp).text(c.frame).text(c.group).put("iii", c.number, _CYLINDER, action)
        encoder.put("ddddddd", *c.place, *c.turn).put("dddffff", width, width, 1e-3, *colour)
        encoder.put("iI?", 0, 0, False)  # shown until replaced; not locked to a moving frame
        encoder.put("II", 0, 0).text("")  # points, colours, texture's name
        encoder.put("iI", 0, 0).text("").text("").put("I", 0)  # texture: header, format, data
        encoder.put("I", 0).text("").text("").text("").put("I", 0).put("?", False)  # texture's places, text, mesh
    return encoder.done()


def encode_markers(contacts: Sequence[Contact], stamp: int) -> bytes:
    """`visualization_msgs/msg/MarkerArray` of contacts on the sheet; see `encode_cylinders`."""
    flat, own = (0.0, 0.0, 0.0, 1.0), (FRAME_ID, "contacts")
    drawn = [Cylinder(*own, c.id, (*c.position, 0.0), flat, c.extent, c.strength) for c in contacts]
    return encode_cylinders(drawn, stamp)


def encode_health(values: Mapping[str, float], message: str, device: str, stamp: int) -> bytes:
    """`diagnostic_msgs/msg/DiagnosticArray` with one status; a message makes it a warning."""
    encoder = Encoder().stamp(stamp).text(FRAME_ID).put("I", 1)
    encoder.put("B", 1 if message else 0).text("ohmskin").text(message or "running").text(device).put("I", len(values))
    for name, value in values.items():
        encoder.text(name).text(f"{value:.6g}")
    return encoder.done()


def encode_log(message: str, stamp: int) -> bytes:
    """`rcl_interfaces/msg/Log` at the level INFO."""
    return Encoder().stamp(stamp).put("B", 20).text("ohmskin").text(message).text("").text("").put("I", 0).done()


def decode_log(data: bytes) -> str:
    """The sentence of a log message.

    Raises:
        DataError: If it is not one.
    """
    decoder = Decoder(data)
    decoder.stamp()
    decoder.take("B")
    decoder.text()
    return decoder.text()


def _array(decoder: Decoder, kind: str) -> NDArray:
    """A sequence of numbers of a NumPy type such as ``f8``, as an array of its own."""
    dtype = np.dtype("<" + kind)
    return np.frombuffer(decoder.block(dtype.itemsize), dtype).copy()
