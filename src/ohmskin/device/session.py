"""The device's side of one conversation: request bytes in, reply bytes out."""

import logging

from ohmskin.device.instrument import SharedInstrument
from ohmskin.device.layout import VERSION, MessageKind
from ohmskin.device.messages import Ack, ErrorCode, FrameData, Hello, Message, Refusal, Scan, SetPattern, kind_of
from ohmskin.device.press import PressCommand
from ohmskin.device.protocol import Packet, PacketDecoder, Unreadable, encode
from ohmskin.errors import DeviceRefused, PatternError
from ohmskin.scan import DrivePattern

_LOG = logging.getLogger(__name__)
_REQUESTS = tuple(kind for kind in MessageKind if kind < 0x80)


class Session:
    """One host's conversation. Nothing that it receives makes it raise."""

    def __init__(self, instrument: SharedInstrument) -> None:
        self._instrument = instrument
        self._decoder = PacketDecoder()
        self._patterns: dict[int, DrivePattern] = {}

    def feed(self, data: bytes) -> bytes:
        """The replies to the requests that `data` completes."""
        return b"".join(self._reply(packet) for packet in self._decoder.feed(data))

    def end(self) -> None:
        """Lift what this host has pressed and forget its patterns."""
        self._patterns.clear()
        try:
            self._instrument.lift(self)
        except Exception:  # noqa: BLE001  an instrument of someone else's must not take the server down
            _LOG.exception("the instrument failed while lifting presses")

    def _reply(self, packet: Packet) -> bytes:
        try:
            return encode(self._answer(packet.message), packet.sequence)
        except PatternError as error:
            refusal = Refusal(ErrorCode.BAD_PATTERN, str(error))
        except DeviceRefused as error:
            refusal = Refusal(ErrorCode.BAD_REQUEST, str(error))
        except Exception as error:  # noqa: BLE001  as above
            _LOG.exception("the instrument failed at %s", type(packet.message).__name__)
            refusal = Refusal(ErrorCode.FAILED, f"{type(error).__name__}: {error}")
        return encode(refusal, packet.sequence)

    def _answer(self, request: Message | Unreadable) -> Message:
        match request:
            case Unreadable():
                return _no(request)
            case Hello():
                self.end()
                return self._instrument.capabilities
            case SetPattern(slot, pattern):
                return self._remember(slot, pattern)
            case Scan(slot, digest):
                return self._scan(slot, digest)
            case PressCommand():
                if not self._instrument.capabilities.virtual:
                    return Refusal(ErrorCode.NOT_SUPPORTED, "this skin is real; press it with a finger")
                if request.pressure > 0 and (rest := self._instrument.rest):
                    return Refusal(ErrorCode.BUSY, f"modelling presses took long; try again in {rest:.2g} s")
                self._instrument.press(self, request)
                return Ack()
            case _:
                return Refusal(ErrorCode.UNKNOWN_KIND, f"{kind_of(request).name} is a reply, not a request")

    def _remember(self, slot: int, pattern: DrivePattern) -> Message:
        limits = self._instrument.capabilities
        if slot >= limits.pattern_slots:
            return Refusal(ErrorCode.TOO_LARGE, f"slot {slot}; there are {limits.pattern_slots}")
        if pattern.n_inj > limits.max_injections or pattern.n_meas > limits.max_measurements:
            most = f"{limits.max_injections} and {limits.max_measurements}"
            size = f"{pattern.n_inj} injections, {pattern.n_meas} measurements"
            return Refusal(ErrorCode.TOO_LARGE, f"{size}; at most {most}")
        pattern.check(limits.n_electrodes)
        self._patterns[slot] = pattern
        return Ack(pattern.digest)

    def _scan(self, slot: int, digest: int) -> Message:
        pattern = self._patterns.get(slot)
        if pattern is None:
            return Refusal(ErrorCode.UNKNOWN_SLOT, f"no pattern in slot {slot}; send it again")
        if pattern.digest != digest:
            other = f"slot {slot} has {pattern.digest:#010x}, not {digest:#010x}; send it again"
            return Refusal(ErrorCode.DIGEST_MISMATCH, other)
        return FrameData.of(self._instrument.scan(pattern))


def _no(request: Unreadable) -> Refusal:
    if request.version != VERSION:
        return Refusal(ErrorCode.WRONG_VERSION, f"this device speaks protocol {VERSION}, not {request.version}")
    if request.kind not in _REQUESTS:
        known = ", ".join(f"0x{kind:02x}" for kind in _REQUESTS)
        return Refusal(ErrorCode.UNKNOWN_KIND, f"0x{request.kind:02x} is not a request; requests are {known}")
    return Refusal(
        ErrorCode.BAD_PATTERN if request.kind == MessageKind.PATTERN else ErrorCode.BAD_REQUEST, request.reason
    )
