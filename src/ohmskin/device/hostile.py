"""A device that misbehaves in every way there is, for authors of hosts: the counterpart of `conformance`.

It serves an instrument without faults until a host has had some frames, then injects one fault, then serves without
faults again. A host passes if it then requests frames again, by itself, over the same connection or a new one.
"""

import random
import select
import socket
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ohmskin.closing import Closing
from ohmskin.device.capabilities import Capabilities
from ohmskin.device.conformance import Check
from ohmskin.device.instrument import Instrument, SharedInstrument
from ohmskin.device.layout import LAYOUTS, MAX_PACKET, VERSION, MessageKind
from ohmskin.device.messages import Ack, ErrorCode, FrameData, Message, Refusal, kind_of, to_fields
from ohmskin.device.protocol import DELIMITER, PacketDecoder, Unreadable, encode, sealed
from ohmskin.device.server import listen
from ohmskin.device.session import Session
from ohmskin.device.transport import SocketTransport
from ohmskin.errors import DeviceLost

_AFTER, _LONGEST = 3, 4.0  # frames that a host must request after a fault; for how long it is injected at most (s)
_POLL = 0.02  # s
_NO_REQUEST = (ErrorCode.WRONG_VERSION, ErrorCode.UNKNOWN_KIND, ErrorCode.BAD_REQUEST, ErrorCode.BAD_PATTERN)
_STEERING = "\x1b[2J\x1b]0;gone\x07\r\x9b31m\u202e\n"  # what a terminal would obey


class _HangUp(Exception):
    """The connection is closed; with `reset` as if the device had crashed."""

    def __init__(self, reset: bool = False) -> None:
        self.reset = reset


@dataclass(frozen=True)
class Reply:
    """What a device without faults would reply.

    Args:
        message: The reply.
        sequence: Number of the request.
        count: How often the fault was injected before.
        rng: Random numbers.
    """

    message: Message
    sequence: int
    count: int
    rng: random.Random

    @property
    def packet(self) -> bytes:
        """The packet of it."""
        return encode(self.message, self.sequence)

    def payload(self, **changes: Any) -> bytes:
        """Its payload with other values in some fields, whatever they are."""
        return LAYOUTS[kind_of(self.message)].pack({**to_fields(self.message), **changes})

    def sealed(self, payload: bytes, kind: int | None = None, version: int = VERSION, sequence: int = -1) -> bytes:
        """An intact packet with any payload."""
        number = self.sequence if sequence < 0 else sequence
        return sealed(version, kind_of(self.message) if kind is None else kind, number, payload)


Inject = Callable[[Reply], Iterator[bytes]]
ProtocolFault = tuple[type, Inject]


def _fields(change: Callable[[Any, int], dict[str, Any]]) -> Inject:
    """A reply with other values in some fields, which `change` makes of the message and the count."""

    return _bytes(lambda reply: reply.sealed(reply.payload(**change(reply.message, reply.count))))


def _error(code: int, text: bytes) -> Inject:
    return _bytes(lambda reply: reply.sealed(struct.pack("<H", code) + text, MessageKind.ERROR))


def _bytes(make: Callable[[Reply], bytes]) -> Inject:
    def inject(reply: Reply) -> Iterator[bytes]:
        yield make(reply)

    return inject


def _closing(make: Callable[[Reply], bytes], reset: bool = False) -> Inject:
    def inject(reply: Reply) -> Iterator[bytes]:
        yield make(reply)
        raise _HangUp(reset)

    return inject


def _slowly(pause: float) -> Inject:
    def inject(reply: Reply) -> Iterator[bytes]:
        for byte in reply.packet:
            yield bytes([byte])
            time.sleep(pause)

    return inject


def _flood(reply: Reply) -> Iterator[bytes]:
    for number in range(4000):
        yield reply.sealed(reply.payload(), sequence=(reply.sequence + 2 + number) & 0xFFFF)
    yield reply.packet


def _endless(reply: Reply) -> Iterator[bytes]:
    yield from (b"\x55" * MAX_PACKET for _ in range(512))


def _strays(reply: Reply) -> Iterator[bytes]:
    """A stale reply and one of the future, of every kind, before the right one."""
    for off in (-1, 1, 0x8000):
        stray = (reply.sequence + off) & 0xFFFF
        for message in (Ack(1), reply.message, Refusal(ErrorCode.FAILED, "for somebody else")):
            yield encode(message, stray)
    yield reply.packet


_ROOM, _TIMES_TOLD = ("max_injections", "max_measurements"), ("settle_time", "conversion_time")


def _whole(array: Any, value: float) -> Any:
    return np.full(len(array), value, np.float32)


PROTOCOL_FAULTS: dict[str, ProtocolFault] = {
    "frames of another pattern": (FrameData, _fields(lambda f, _: {"digest": f.digest ^ 1})),
    "frames with a voltage missing": (FrameData, _fields(lambda f, _: {"voltages": f.voltages[:-1]})),
    "frames of nothing": (FrameData, _fields(lambda f, _: {"voltages": f.voltages[:0], "currents": f.currents[:0]})),
    "frames of NaN": (FrameData, _fields(lambda f, _: {"voltages": _whole(f.voltages, np.nan)})),
    "frames of infinities": (FrameData, _fields(lambda f, _: {"voltages": _whole(f.voltages, -np.inf)})),
    "voltages of 3e38 V": (FrameData, _fields(lambda f, _: {"voltages": _whole(f.voltages, 3e38)})),
    "currents of 0 A": (FrameData, _fields(lambda f, _: {"currents": _whole(f.currents, 0)})),
    "currents of NaN": (FrameData, _fields(lambda f, _: {"currents": _whole(f.currents, np.nan)})),
    "currents of 3e38 A": (FrameData, _fields(lambda f, _: {"currents": _whole(f.currents, 3e38)})),
    "currents the other way": (FrameData, _fields(lambda f, _: {"currents": -np.asarray(f.currents)})),
    "frame numbers that wrap": (FrameData, _fields(lambda _, count: {"number": (2**32 - 1 + count) % 2**32})),
    "frame numbers that stand still": (FrameData, _fields(lambda *_: {"number": 7})),
    "a clock that goes back": (FrameData, _fields(lambda f, count: {"time": max(0, f.time - 10**9 * count)})),
    "a clock at its end": (FrameData, _fields(lambda *_: {"time": 2**64 - 1})),
    "unknown flags": (FrameData, _fields(lambda *_: {"flags": 2**32 - 1})),
    "replies of another number": (FrameData, _bytes(lambda r: encode(r.message, (r.sequence + 1) & 0xFFFF))),
    "unsolicited replies": (FrameData, _strays),
    "a reply a thousand times": (FrameData, _bytes(lambda r: 1000 * r.packet)),
    "a flood of frames": (FrameData, _flood),
    "a packet without an end": (FrameData, _endless),
    "noise": (FrameData, _bytes(lambda r: r.rng.randbytes(100_000))),
    "wrong checksums": (FrameData, _bytes(lambda r: r.packet[:-2] + bytes([r.packet[-2] % 255 + 1]) + DELIMITER)),
    "payloads cut short": (FrameData, _bytes(lambda r: r.sealed(r.payload()[: 3 + r.count]))),
    "payloads with more behind": (FrameData, _bytes(lambda r: r.sealed(r.payload() + b"more"))),
    "counts beyond the packet": (FrameData, _bytes(lambda r: r.sealed(r.payload()[:20] + 4 * b"\xff"))),
    "an acknowledgement for a frame": (FrameData, _bytes(lambda r: encode(Ack(0), r.sequence))),
    "a request for a reply": (FrameData, _bytes(lambda r: r.sealed(b"", MessageKind.HELLO))),
    "an unknown kind": (FrameData, _bytes(lambda r: r.sealed(b"", 0xEE))),
    "another protocol version": (FrameData, _bytes(lambda r: r.sealed(b"", MessageKind.ERROR, VERSION + 1))),
    "no answer": (FrameData, _bytes(lambda _: b"")),
    "one byte at a time": (FrameData, _slowly(1e-4)),
    "one byte a second": (FrameData, _slowly(1.0)),
    "hanging up in mid-packet": (FrameData, _closing(lambda r: r.packet[: len(r.packet) // 2])),
    "hanging up after a reply": (FrameData, _closing(lambda r: r.packet)),
    "a crash": (FrameData, _closing(lambda r: r.packet[:10], reset=True)),
    "an error": (FrameData, _error(ErrorCode.FAILED, b"on fire")),
    "an error that is not text": (FrameData, _error(ErrorCode.FAILED, b"\xff\xfe\x80 \xc3")),
    "an error that steers a terminal": (FrameData, _error(ErrorCode.FAILED, _STEERING.encode())),
    "an error of 64 KB": (FrameData, _error(ErrorCode.FAILED, 60_000 * b"x")),
    "an unknown error code": (FrameData, _error(0xFFFF, b"")),
    "busy for ever": (FrameData, _error(ErrorCode.BUSY, b"later")),
    "patterns forgotten for ever": (FrameData, _error(ErrorCode.UNKNOWN_SLOT, b"which one?")),
    "another digest in the slot": (Ack, _fields(lambda ack, _: {"value": ack.value ^ 1})),
    "a pattern refused": (Ack, _error(ErrorCode.BAD_PATTERN, b"no")),
    "no greeting": (Capabilities, _bytes(lambda _: b"")),
    "hanging up at the greeting": (Capabilities, _closing(lambda _: b"")),
    "a greeting of another kind": (Capabilities, _bytes(lambda r: encode(Ack(0), r.sequence))),
    "a name that is not text": (Capabilities, _bytes(lambda r: r.sealed(r.payload(name="") + b"\xff\xfe skin"))),
    "a name of 64 KB": (Capabilities, _bytes(lambda r: r.sealed(r.payload(name="") + 60_000 * b"\x1b"))),
    "a name that steers a terminal": (Capabilities, _fields(lambda *_: {"name": _STEERING})),
    "no electrodes": (Capabilities, _fields(lambda *_: {"n_electrodes": 0})),
    "65535 electrodes": (Capabilities, _fields(lambda *_: {"n_electrodes": 65535})),
    "no room for a pattern": (Capabilities, _fields(lambda *_: {"max_injections": 0, "pattern_slots": 0})),
    "room for one voltage": (Capabilities, _fields(lambda *_: {"max_injections": 1, "max_measurements": 1})),
    "patterns beyond a packet": (Capabilities, _fields(lambda *_: dict.fromkeys(_ROOM, 65535))),
    "times that are NaN": (Capabilities, _fields(lambda *_: dict.fromkeys(_TIMES_TOLD, np.nan))),
    "times of years": (Capabilities, _fields(lambda *_: dict.fromkeys(_TIMES_TOLD, 3e7))),
    "scans of minutes": (Capabilities, _fields(lambda *_: dict.fromkeys(_TIMES_TOLD, 60.0))),
    "a full scale of 0 V": (Capabilities, _fields(lambda *_: {"full_scale": 1e-30})),
    "another device": (Capabilities, _fields(lambda c, count: {"serial": c.serial ^ 1, "boot": count})),
}  # fmt: skip
"""What it does, by name: the kind of reply that it happens to, and what is sent instead."""


class HostileDevice(Closing):
    """Serves an instrument to one host at a time, and injects faults.

    Args:
        instrument: What is scanned.
        host: Address to listen on.
        port: TCP port; 0 chooses a free one.
        seed: Of the random numbers.
        quiet_frames: Frames that a host gets before the first fault, such as those for its calibration.
        times: How often a fault is injected.

    Attributes:
        url: Its address.

    Raises:
        DeviceError: If the port is in use, or the address is not this machine's.
    """

    def __init__(
        self,
        instrument: Instrument,
        host: str = "127.0.0.1",
        port: int = 7155,
        seed: int = 0,
        quiet_frames: int = 200,
        times: int = 3,
    ) -> None:
        self._instrument, self._rng = SharedInstrument(instrument), random.Random(seed)
        self._listener = listen(host, port)
        self.url = f"tcp://{host}:{self._listener.getsockname()[1]}"
        self._quiet_frames, self._times = quiet_frames, times
        self._socket: socket.socket | None = None
        self._line: SocketTransport
        self._session: Session
        self._rest = b""
        self._fault: ProtocolFault | None = None
        self._injected = self._frames = self._unsound = 0
        self._end = float("inf")
        self._over: Callable[[], bool] = lambda: False

    def check_host(
        self,
        faults: Mapping[str, ProtocolFault] = PROTOCOL_FAULTS,
        timeout: float = 10.0,
        report: Callable[[Check], None] = lambda _: None,
        over: Callable[[], bool] = lambda: False,
    ) -> list[Check]:
        """Inject all faults while a host is connected, however long it takes to connect; whether it recovers from each.

        Args:
            faults: Those to inject, in this order.
            timeout: Time after a fault within which the host must request frames again (s).
            report: Called with each outcome as soon as it is there.
            over: Asked whether to end now.
        """
        self._over = over
        checks: list[Check] = []
        self._serve(float("inf"), lambda: self._frames >= self._quiet_frames)
        for name, fault in faults.items():
            if self._over():
                break
            if not issubclass(fault[0], FrameData):
                self._hang_up()  # patterns and greetings come with a connection
            self._fault, self._injected, self._frames, unsound = fault, 0, 0, self._unsound
            self._serve(_LONGEST, lambda: self._injected >= self._times or self._frames > 10 * _AFTER)
            self._fault, self._frames = None, 0
            self._serve(timeout, lambda: self._frames >= _AFTER)
            words = "" if self._frames >= _AFTER else f"no frame was requested within {timeout:g} s after it"
            if self._unsound > unsound:
                words = words or "the host sent packets that are damaged, or are not requests"
            if self._over():
                break
            checks.append(Check(name, "failed" if words else "passed", words))
            report(checks[-1])
            self._serve(float("inf"), lambda: self._frames >= _AFTER)  # a host that failed may be started again
        return checks

    def close(self) -> None:
        """Hang up and free the port. Safe to call twice."""
        self._hang_up()
        self._listener.close()

    def _serve(self, seconds: float, over: Callable[[], bool]) -> None:
        """Answer for so many seconds or until it is over; a new connection takes the place of the old."""
        self._end = time.monotonic() + seconds
        while not (self._over() or over()) and time.monotonic() < self._end:
            ends = [self._listener, *([self._socket] if self._socket else [])]
            for ready in select.select(ends, [], [], _POLL)[0]:
                if ready is self._listener:
                    self._hang_up()
                    self._socket = self._listener.accept()[0]
                    self._line = SocketTransport(self._socket, "the host")
                    self._session, self._rest = Session(self._instrument), b""
                elif ready is self._socket:
                    self._receive()

    def _receive(self) -> None:
        try:
            *packets, self._rest = (self._rest + self._line.read(_POLL)).split(DELIMITER)
            for stuffed in filter(None, packets):
                self._answer(stuffed + DELIMITER)
        except DeviceLost:
            self._hang_up()
        except _HangUp as how:
            self._hang_up(how.reset)

    def _answer(self, packet: bytes) -> None:
        honest = self._session.feed(packet)
        if not (replies := PacketDecoder().feed(honest)):
            self._unsound += 1
            return
        (reply,) = replies
        assert not isinstance(reply.message, Unreadable)
        if self._fault and isinstance(reply.message, self._fault[0]):
            inject, count = self._fault[1], self._injected
            self._injected += 1
            for piece in inject(Reply(reply.message, reply.sequence, count, self._rng)):
                if time.monotonic() > self._end:
                    raise _HangUp
                self._line.write(piece)
            return
        self._frames += isinstance(reply.message, FrameData)
        refused = isinstance(reply.message, Refusal) and reply.message.code in _NO_REQUEST
        self._unsound += refused
        self._line.write(honest)

    def _hang_up(self, reset: bool = False) -> None:
        if self._socket is None:
            return
        if reset:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self._socket.close()
        else:
            self._line.close()
        self._socket = None
        self._session.end()
