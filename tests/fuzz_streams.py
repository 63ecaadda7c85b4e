"""Streams that `fuzzing` changes: requests to a device, replies to a host, commands of the live page."""

import json
import math
import random
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
from direct import DirectDevice
from fuzz_files import COARSE, changed, near
from fuzzing import FLOATS, NUMBERS, Kind, spoilt
from test_protocol import intact
from test_view_session import Page

import ohmskin as ohm
from ohmskin.device import wire
from ohmskin.device.instrument import SharedInstrument
from ohmskin.device.layout import CHECKSUM, HEADER, LAYOUTS
from ohmskin.device.messages import FrameData, Hello, Message, Scan, SetPattern
from ohmskin.device.press import PressCommand
from ohmskin.device.protocol import PacketDecoder, encode
from ohmskin.device.session import Session
from ohmskin.device.virtual import VirtualInstrument
from ohmskin.device.wire import WireDevice
from ohmskin.engine import Engine
from ohmskin.errors import OhmskinError
from ohmskin.scan import DrivePattern
from ohmskin.view.session import PageSession
from ohmskin.view.wire import CommandError, read_command

SINGLES = [value for value in FLOATS if not 3.4e38 < abs(value) < math.inf]
RIM = ohm.adjacent([range(12)])
SMALL = DrivePattern(np.array([[0, 1], [2, 3]]), np.array([[0, 2, 3], [0, 3, 4], [1, 4, 0]]))


def damaged(packet: bytes, rng: random.Random) -> bytes:
    """A packet with a field changed and its checksum right, or with bytes changed and its checksum wrong."""
    if rng.random() < 0.25:
        return spoilt(packet, rng)
    from cobs import cobs

    body = cobs.decode(packet[:-1])[: -CHECKSUM.size]
    version, kind, sequence = HEADER.unpack_from(body)
    payload = bytearray(body[HEADER.size :])
    match rng.randrange(10):
        case 0:
            version = rng.randrange(256)
        case 1:
            kind = rng.choice((*LAYOUTS, rng.randrange(256)))
        case 2:
            sequence = rng.choice((sequence + 1, sequence - 1, rng.randrange(65536))) % 65536
        case 3:
            payload += rng.randbytes(rng.choice((1, 4, 400, 70000)))
        case 4:
            del payload[rng.randrange(len(payload) + 1) :]
        case 5:
            payload[:] = spoilt(bytes(payload), rng)
        case _ if payload:
            at, fields = 0, []
            for field in LAYOUTS[kind].scalars:
                fields.append((at, field.size, field.kind))
                at += field.size
            tail = [(k, 4, "f32") for k in range(at, len(payload) - 3, 4)]
            for _ in range(rng.choice((1, 1, 2, 30))):
                where, size, form = rng.choice(
                    tail if tail and rng.random() < 0.4 else fields or tail or [(0, 1, "u8")]
                )
                number = (rng.choice(NUMBERS) % 256**size).to_bytes(size, "little")
                single = struct.pack("<f", rng.choice(SINGLES))
                payload[where : where + size] = single if form == "f32" else number
    return intact(version, kind, bytes(payload), sequence)


def mixed(packets: list[bytes], rng: random.Random) -> bytes:
    """Packets, some of them damaged, doubled, exchanged or left out."""
    made = [damaged(packet, rng) if rng.random() < 0.4 else packet for packet in packets]
    match rng.randrange(8):
        case 0:
            rng.shuffle(made)
        case 1:
            made *= rng.choice((2, 3))
        case 2:
            made.insert(rng.randrange(len(made) + 1), rng.randbytes(rng.choice((1, 100, 70000))))
        case 3:
            del made[rng.randrange(len(made))]
    return b"".join(made)


class Requests:
    """What a host sends: the device answers everything with messages, and serves the next host."""

    allowed = (OhmskinError,)

    def __init__(self, _: Path) -> None:
        self._instrument = SharedInstrument(VirtualInstrument(COARSE, 0, realtime=False))

    def make(self, rng: random.Random) -> bytes:
        asked: list[Message] = [Hello()]
        for _ in range(rng.randrange(1, 6)):
            pattern, slot = rng.choice((RIM, SMALL)), rng.choice((0, 0, 1, 15))
            touch = PressCommand(rng.choice((0, 1, 65535)), 0.1, 0.1, 0.008, rng.choice((0.0, 2e4)))
            asked += rng.choice(([SetPattern(slot, pattern)], [Scan(slot, pattern.digest)], [touch]))
        return mixed([encode(message, number) for number, message in enumerate(asked)], rng)

    def use(self, content: bytes, rng: random.Random) -> None:
        session, decoder = Session(self._instrument), PacketDecoder()
        for at in range(0, len(content), 50_000):
            decoder.feed(session.feed(content[at : at + 50_000]))
        assert decoder.tally.damaged == decoder.tally.unknown == 0
        told = session.feed(b"\0" + encode(Hello()) + encode(SetPattern(0, SMALL)) + encode(Scan(0, SMALL.digest)))
        *_, frame = decoder.feed(told)  # what was left unfinished may have been answered, too
        assert isinstance(frame.message, FrameData)
        session.end()


class Replies:
    """What a device sends: the host takes it or gives up in words; the clock runs as fast as it is waited for."""

    allowed = (OhmskinError,)

    def __init__(self, _: Path) -> None:
        self._instrument = SharedInstrument(VirtualInstrument(COARSE, 0, realtime=False))

    def make(self, rng: random.Random) -> bytes:
        return rng.randbytes(8)

    def use(self, content: bytes, rng: random.Random) -> None:
        clock, session, replies = [0.0], Session(self._instrument), list[bytes]()
        spare = rng.choice((0, 1, 2, 5))  # replies that are left as they are

        def write(data: bytes) -> None:
            nonlocal spare
            told = session.feed(data)
            packets = [part + b"\0" for part in told.split(b"\0") if part]
            spare -= bool(packets)
            replies.append(mixed(packets, rng) if packets and spare < 0 and rng.random() < 0.7 else told)

        def read(timeout: float) -> bytes:
            if replies:
                told = replies.pop(0)
                cut = rng.randrange(len(told) + 1) if rng.random() < 0.3 else len(told)
                if cut < len(told):
                    replies.insert(0, told[cut:])
                return told[:cut]
            clock[0] += max(timeout, 1e-4)
            return b""

        line = SimpleNamespace(byte_time=0.0, read=read, write=write, close=lambda: None)
        time = SimpleNamespace(monotonic=lambda: clock[0])
        with (
            patch.object(wire, "open_transport", lambda _: line),
            patch.object(wire, "time", time),
            WireDevice("tcp://x:1") as device,
        ):
            assert len(device.capabilities.name) <= 32
            for pattern in (SMALL, RIM, SMALL):
                with suppress(OhmskinError):
                    frame = device.capabilities.limited(device.scan(pattern))
                    assert frame.pattern == pattern


class Commands:
    """What a browser sends: each is refused by name or obeyed, and the loop goes on."""

    allowed = (CommandError, OhmskinError)

    def __init__(self, _: Path) -> None:
        device = DirectDevice(ohm.VirtualSkin(COARSE, seed=3))
        self._engine = Engine(lambda: device, COARSE, "16O")
        self._session = PageSession(self._engine, "virtual:", Page(), False)
        self._session.calibrate()
        for name in self._engine.modes:  # what is compiled is compiled now
            self._engine.set_mode(name)
            self._engine.press(1, (0.1, 0.1), 8e-3, 2e4)
            for _ in range(8):
                self._session.step()
        page: Any = self._session.view
        self._page: Page = page
        setup = self._page.setup
        self._valid: list[dict[str, Any]] = [
            {"type": "press", "id": "a", "x": 0.1, "y": 0.1, "radius": 8e-3, "pressure": 2e4},
            {"type": "lift", "id": "a"},
            {"type": "lift_all"},
            *({"type": "mode", "mode": mode["name"]} for mode in setup["modes"]),
            {"type": "estimator", "estimator": "gauss-newton", "prior": "paper", "rule": "physical"},
            {"type": "injections", "count": 5},
            {"type": "pause", "paused": False},
            {"type": "demo", "on": False},
            {"type": "seek", "position": 1.0},
            {"type": "step", "cycles": 1},
            {"type": "speed", "speed": 2.0},
            {"type": "loop", "on": True},
            {"type": "ack", "sequence": 3},
        ]

    def make(self, rng: random.Random) -> bytes:
        sent = []
        for _ in range(rng.choice((1, 1, 3))):
            command = dict(rng.choice(self._valid))
            for _ in range(rng.choice((0, 1, 1, 2))):
                command = changed(command, rng, near)
            try:
                text = json.dumps(command).encode()
            except ValueError:  # a number of thousands of digits
                text = b'{"type": "press", "id": "a", "x": ' + b"1" * 5000 + b"}"
            sent.append(spoilt(text, rng) if rng.random() < 0.3 else text)
        return b"\n".join(sent)

    def use(self, content: bytes, rng: random.Random) -> None:
        refused: CommandError | None = None
        for line in content.split(b"\n"):
            try:
                self._page.sent.append(read_command(line.decode(errors="replace"), self._page.setup))
            except CommandError as error:
                refused = error
        for _ in range(2):
            self._session.step()
        del self._page.told[:]
        self._page.sent.append({"type": "pause", "paused": False})
        if refused:
            raise refused


STREAMS: dict[str, Callable[[Path], Kind]] = {"requests": Requests, "replies": Replies, "commands": Commands}
