"""The messages of the wire protocol as values."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Self, get_args

import numpy as np

from ohmskin.arrays import Floats, quiet_nans
from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.device.layout import MessageKind
from ohmskin.device.press import PressCommand
from ohmskin.errors import ProtocolError
from ohmskin.scan import DrivePattern, Frame, FrameFlag


class ErrorCode(IntEnum):
    """Why a device refused a request."""

    WRONG_VERSION = 1  # the request is of another protocol version; the header of the reply tells the device's own
    UNKNOWN_KIND = 2  # no such request
    BAD_REQUEST = 3  # the payload is malformed or out of range
    BAD_PATTERN = 4  # an electrode or injection that is not there, source and sink the same, measurements out of order
    TOO_LARGE = 5  # more injections, measurements or slots than the device takes
    UNKNOWN_SLOT = 6  # no pattern in this slot: the device was reset
    DIGEST_MISMATCH = 7  # another pattern in this slot: the device was reset
    NOT_SUPPORTED = 8  # this device cannot do that
    BUSY = 9  # ask again in a moment
    FAILED = 10  # the instrument failed


@dataclass(frozen=True)
class Hello:
    """Begins a session: the device forgets the patterns and lifts the presses of the earlier one."""


@dataclass(frozen=True)
class SetPattern:
    """Puts a drive pattern into a slot of the device."""

    slot: int
    pattern: DrivePattern


@dataclass(frozen=True)
class Scan:
    """Drives the pattern in `slot`, if its digest is the one given."""

    slot: int
    digest: int


@dataclass(frozen=True)
class Ack:
    """Done. `value` is the digest of the pattern as the device computed it, 0 for a press."""

    value: int = 0


@dataclass(frozen=True)
class Refusal:
    """The device refused. `code` may be one that this host does not know."""

    code: int
    text: str


@dataclass(frozen=True, eq=False)
class FrameData:
    """A frame as it travels: the pattern driven is known by its digest only.

    Args:
        digest: CRC-32 of the pattern that was really driven.
        number: Number of the frame.
        time: Time of the last sample on the device's clock (us).
        flags: FrameFlag bits.
        currents: (n_inj,) amperes; float32 as received.
        voltages: (n_meas,) volts, float32 as received; NaN not measured, +-inf clipped. One value more is that of the
            auxiliary channel.
    """

    digest: int
    number: int
    time: int
    flags: int
    currents: Floats
    voltages: Floats

    @classmethod
    def of(cls, frame: Frame) -> Self:
        """What travels of a frame."""
        number, microseconds = frame.sequence & 2**32 - 1, max(0, round(frame.time * 1e6))
        values = frame.voltages if frame.auxiliary is None else np.append(frame.voltages, frame.auxiliary)
        return cls(frame.pattern.digest, number, microseconds, int(frame.flags), frame.currents, values)

    def frame(self, pattern: DrivePattern, auxiliary: bool = False) -> Frame:
        """The frame, given the pattern it was asked for, and whether the device has an auxiliary channel.

        Raises:
            ProtocolError: If the device drove another pattern.
        """
        told = (self.digest, len(self.currents), len(self.voltages) - auxiliary)
        asked = (pattern.digest, pattern.n_inj, pattern.n_meas)
        if told != asked:
            raise ProtocolError(
                f"the device drove a pattern with digest, injections, measurements = {told}; asked for {asked}. "
                "Its firmware must refuse such a scan; update it"
            )
        values = quiet_nans(np.concatenate([self.currents, self.voltages]))
        currents, voltages = values[: pattern.n_inj], values[pattern.n_inj : pattern.n_inj + pattern.n_meas]
        beside = float(values[-1]) if auxiliary else None
        return Frame(pattern, voltages, currents, self.time * 1e-6, self.number, FrameFlag(self.flags), None, beside)


Message = Hello | SetPattern | Scan | PressCommand | Capabilities | Ack | FrameData | Refusal

_TYPES: dict[MessageKind, Any] = dict(zip(MessageKind, get_args(Message), strict=True))  # in the same order
_KINDS = {known: kind for kind, known in _TYPES.items()}
_FIRMWARE = ("firmware_major", "firmware_minor", "firmware_patch")


def kind_of(message: Message) -> MessageKind:
    """The number of this kind of message."""
    return _KINDS[type(message)]


def to_fields(message: Message) -> dict[str, Any]:
    """The fields of `layout.LAYOUTS` that carry a message."""
    match message:
        case SetPattern(slot, pattern):
            return {"slot": slot, "injections": pattern.injections, "measurements": pattern.measurements}
        case Capabilities():
            return {**vars(message), **dict(zip(_FIRMWARE, message.firmware, strict=True))}
        case _:
            return vars(message)


def from_fields(kind: MessageKind, fields: dict[str, Any]) -> Message:
    """The message that the fields of `layout.LAYOUTS` carry.

    Raises:
        PatternError, ProtocolError, DeviceRefused: If they make no valid message.
    """
    match kind:
        case MessageKind.PATTERN:
            return SetPattern(fields["slot"], DrivePattern(fields["injections"], fields["measurements"]))
        case MessageKind.CAPABILITIES:
            firmware = tuple(fields.pop(name) for name in _FIRMWARE)
            return Capabilities(**{**fields, "features": Feature(fields["features"]), "firmware": firmware})
        case _:
            message: Message = _TYPES[kind](**fields)
            return message
