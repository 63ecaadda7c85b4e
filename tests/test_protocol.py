"""The wire protocol: what is sent arrives, what is damaged does not, and docs/protocol.md tells the truth."""

import re
import tracemalloc
import zlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ohmskin.device import protocol
from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.device.instrument import SharedInstrument
from ohmskin.device.layout import LAYOUTS, MAX_PACKET, MessageKind
from ohmskin.device.messages import Ack, ErrorCode, FrameData, Hello, Message, Refusal, Scan, SetPattern
from ohmskin.device.press import PressCommand
from ohmskin.device.protocol import Packet, PacketDecoder, Unreadable, encode
from ohmskin.device.session import Session
from ohmskin.errors import DeviceRefused, ProtocolError
from ohmskin.scan import DrivePattern, Frame, adjacent

DOC = (Path(__file__).parents[1] / "docs" / "protocol.md").read_text()

u8, u16, u32, u64 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32, 64))
size = st.floats(0, 1e6, width=32)


def f32(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(float(np.float32(low)), high, width=32)


@st.composite
def patterns(draw: st.DrawFn) -> DrivePattern:
    pair = st.lists(u16, min_size=2, max_size=2, unique=True)
    injections = draw(st.lists(pair, min_size=1, max_size=8))
    which = sorted(draw(st.lists(st.integers(0, len(injections) - 1), min_size=1, max_size=40)))
    return DrivePattern(np.array(injections), np.array([[k, *draw(pair)] for k in which]))


@st.composite
def frames(draw: st.DrawFn) -> FrameData:
    floats = st.lists(st.floats(width=32), max_size=300).map(lambda values: np.array(values, np.float32))
    return FrameData(draw(u32), draw(u32), draw(u64), draw(u32), draw(floats), draw(floats))


capabilities = st.builds(
    Capabilities,
    name=st.text(max_size=8),
    n_electrodes=st.integers(2, 65535),
    max_injections=st.integers(1, 4000),
    max_measurements=st.integers(1, 8000),
    pattern_slots=st.integers(1, 255),
    features=u32.map(Feature),
    excitation=size,
    full_scale=size,
    settle_time=size,
    conversion_time=size,
    serial=u32,
    firmware=st.tuples(u8, u8, u8),
    boot=u32,
)
presses = st.builds(PressCommand, u16, f32(-100, 100), f32(-100, 100), st.floats(2.0**-20, 10, width=32), f32(0, 1e9))
messages = st.one_of(
    st.just(Hello()),
    st.builds(SetPattern, u16, patterns()),
    st.builds(Scan, u16, u32),
    presses,
    capabilities,
    st.builds(Ack, u32),
    frames(),
    st.builds(Refusal, u16, st.text(max_size=30)),
)
packets = st.builds(Packet, u16, messages)


def sent(items: list[Packet]) -> list[bytes]:
    return [encode(item.message, item.sequence) for item in items]


def again(item: Packet) -> bytes:
    """The bytes of a decoded packet: equal bytes, equal message."""
    assert not isinstance(item.message, Unreadable)
    return encode(item.message, item.sequence)


@given(packets)
def test_every_message_arrives_as_it_was_sent(packet: Packet) -> None:
    (got,) = PacketDecoder().feed(encode(packet.message, packet.sequence))
    assert got.sequence == packet.sequence
    if isinstance(packet.message, FrameData):
        assert isinstance(got.message, FrameData)
        for name, value in vars(packet.message).items():
            np.testing.assert_array_equal(getattr(got.message, name), value)
    else:
        assert got.message == packet.message


@given(st.lists(packets, max_size=5), st.data())
def test_pieces_of_any_size_make_the_same_messages(items: list[Packet], data: st.DataObject) -> None:
    stream, decoder, got = b"".join(sent(items)), PacketDecoder(), []
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    for start, stop in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        got += decoder.feed(stream[start:stop])
    assert [again(item) for item in got] == sent(items)
    assert decoder.tally.good == len(items)
    assert decoder.tally.damaged == 0


@given(st.binary(max_size=2000))
def test_random_bytes_make_no_message_and_no_error(noise: bytes) -> None:
    decoder = PacketDecoder()
    assert decoder.feed(noise) == []
    (packet,) = decoder.feed(b"\0" + encode(Hello(), 3))  # and the line recovers at the next delimiter
    assert packet == Packet(3, Hello())


@settings(max_examples=200)
@given(st.lists(packets, min_size=1, max_size=4), st.data())
def test_damaged_streams_give_only_messages_that_were_sent(items: list[Packet], data: st.DataObject) -> None:
    parts = sent(items)
    mangled = [bytearray(part) for part in data.draw(st.permutations(parts + parts))]
    for part in mangled:
        for _ in range(data.draw(st.integers(0, 3))):
            where = data.draw(st.integers(0, max(len(part) - 1, 0)))
            match data.draw(st.sampled_from(["flip", "cut", "insert", "drop"])):
                case "flip" if part:
                    part[where] ^= 1 << data.draw(st.integers(0, 7))
                case "cut":
                    del part[where:]
                case "insert":
                    part.insert(where, data.draw(u8))
                case "drop" if part:
                    del part[where]
    got = PacketDecoder().feed(b"".join(mangled))
    assert {again(item) for item in got} <= set(parts)


def flips(packet: bytes) -> list[bytes]:
    return [
        packet[:i] + bytes([packet[i] ^ 1 << bit]) + packet[i + 1 :] + b"\0"
        for i in range(len(packet) - 1)
        for bit in range(8)
    ]


def test_a_flipped_bit_drops_the_packet_because_of_the_checksum(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = FrameData(1, 2, 3, 0, np.full(4, 0.01, np.float32), np.full(20, 0.5, np.float32))
    damaged = flips(encode(frame, 9))
    assert not any(PacketDecoder().feed(one) for one in damaged)

    class NoChecksum:
        """The decoder without its check: it must be the one that catches the flips."""

        @staticmethod
        def crc32(body: bytes) -> "NoChecksum":
            return NoChecksum()

        def __ne__(self, other: object) -> bool:
            return False

    monkeypatch.setattr(protocol, "zlib", NoChecksum)
    assert sum(bool(PacketDecoder().feed(one)) for one in damaged) > len(damaged) // 2


def test_a_signalling_nan_is_a_nan_like_others() -> None:
    """Converted to doubles it would warn; a device may well send one."""
    signalling = np.array([0x7FA00000] * 5, np.uint32).view(np.float32)
    sent = FrameData(PATTERN.digest, 1, 1, 0, signalling[:2], signalling[:3])
    (got,) = PacketDecoder().feed(encode(sent))
    assert isinstance(got.message, FrameData)
    frame = got.message.frame(PATTERN)
    assert np.isnan(frame.voltages * 2).all()
    assert np.isnan(frame.currents + 1).all()


def test_counters_tell_the_kinds_of_damage() -> None:
    decoder = PacketDecoder()
    good = encode(Ack(5), 1)
    decoder.feed(good + b"\0\0" + b"\x05\x01\0" + good.replace(b"\x82", b"\x83"))
    decoder.feed(b"\x01" * (MAX_PACKET + 1))
    decoder.feed(b"\x01" * 70000 + b"\0" + intact(1, 0x42, b"") + good)
    tally = decoder.tally
    assert (tally.good, tally.bad_cobs, tally.bad_crc, tally.overlong, tally.unknown) == (2, 1, 1, 1, 1)
    assert tally.damaged == 3


def test_an_endless_packet_takes_no_memory() -> None:
    decoder = PacketDecoder()
    tracemalloc.start()
    for _ in range(100):
        assert decoder.feed(b"\x55" * 60000) == []
    assert tracemalloc.get_traced_memory()[1] < 8 * MAX_PACKET  # of 6 MB
    tracemalloc.stop()
    assert decoder.feed(b"\0" + encode(Hello())) == [Packet(0, Hello())]


def intact(version: int, kind: int, payload: bytes, sequence: int = 7) -> bytes:
    """A packet with valid framing and checksum around anything."""
    return protocol.sealed(version, kind, sequence, payload)


def test_another_protocol_version_is_reported_as_such() -> None:
    (packet,) = PacketDecoder().feed(intact(2, MessageKind.ERROR, b"\x01\x00new"))
    assert packet.sequence == 7
    assert isinstance(packet.message, Unreadable)
    assert packet.message.version == 2


@given(st.sampled_from(list(MessageKind)), st.binary(max_size=100))
def test_any_payload_is_read_or_reported(kind: MessageKind, payload: bytes) -> None:
    (packet,) = PacketDecoder().feed(intact(1, kind, payload))
    assert packet.sequence == 7


@pytest.mark.parametrize("kind", list(MessageKind))
def test_a_payload_of_the_wrong_length_is_reported(kind: MessageKind) -> None:
    payload = b"" if kind is MessageKind.HELLO else b"\0" * 5
    extra = payload + (b"\0" * 400 if LAYOUTS[kind].tail or kind is MessageKind.HELLO else b"\0" * 100)
    for wrong in (extra, payload[:1]) if kind is not MessageKind.HELLO else (extra,):
        (packet,) = PacketDecoder().feed(intact(1, kind, wrong))
        assert isinstance(packet.message, Unreadable)


def test_what_does_not_fit_the_wire_is_refused() -> None:
    with pytest.raises(ProtocolError, match="slot"):
        encode(Scan(70000, 0))
    with pytest.raises(ProtocolError, match="injections reach"):
        encode(SetPattern(0, DrivePattern(np.array([[0, 70000]]), np.array([[0, 1, 2]]))))
    with pytest.raises(ProtocolError, match="split"):
        encode(FrameData(0, 0, 0, 0, np.zeros(1, np.float32), np.full(20000, 1.5, np.float32)))
    with pytest.raises(ProtocolError, match="at most 32"):
        Capabilities("x" * 33, 16, 1, 1)
    with pytest.raises(ProtocolError, match="one packet"):
        Capabilities("x", 16, 100, 60000)
    with pytest.raises(DeviceRefused, match="radius"):
        PressCommand(0, 0.1, 0.1, float("nan"), 1.0)


def test_long_texts_are_cut_between_characters() -> None:
    (packet,) = PacketDecoder().feed(encode(Refusal(1, "ü" * 100)))
    assert packet.message == Refusal(1, "ü" * 60)


def test_the_largest_pattern_of_the_largest_device_fits_a_packet() -> None:
    device = Capabilities("x", 65535, 256, (MAX_PACKET - 512 - 4 * 256) // 6)
    rng = np.random.default_rng(0)
    injections = np.column_stack([np.arange(256), np.arange(256) + 300])
    which = np.sort(rng.integers(0, 256, device.max_measurements))
    pattern = DrivePattern(injections, np.column_stack([which, np.full_like(which, 65533), np.full_like(which, 65534)]))
    device.check(pattern)
    encode(SetPattern(0, pattern))


class Instrument:
    """Does as little as an instrument can."""

    capabilities = Capabilities("tiny", 16, 64, 1024)

    def scan(self, pattern: DrivePattern) -> Frame:
        return Frame(pattern, np.zeros(pattern.n_meas), np.ones(pattern.n_inj), 0.0)

    def press(self, number: int, x: float, y: float, radius: float, pressure: float) -> None:
        raise AssertionError("a skin that is not virtual was pressed")


def answer(session: Session, data: bytes) -> Message | Unreadable:
    (packet,) = PacketDecoder().feed(session.feed(data))
    return packet.message


@given(st.lists(st.one_of(st.binary(max_size=300), packets.map(lambda p: encode(p.message, p.sequence))), max_size=6))
def test_a_session_survives_anything_and_answers_with_messages(stream: list[bytes]) -> None:
    session, decoder = Session(SharedInstrument(Instrument())), PacketDecoder()
    for data in stream:
        decoder.feed(session.feed(data))
    assert decoder.tally.damaged == decoder.tally.unknown == 0
    assert isinstance(answer(session, b"\0" + encode(Hello())), Capabilities)


def test_a_session_says_why_it_refuses() -> None:
    session = Session(SharedInstrument(Instrument()))
    rim = adjacent([range(16)])
    beyond = DrivePattern(np.array([[0, 1]]), np.array([[0, 2, 16]]))
    big = DrivePattern(np.tile(rim.injections, (5, 1)), rim.measurements)
    twice = np.array([1, 1, 2, 2, 0, 1, 2], "<u2").tobytes()
    cases = {
        encode(Scan(0, rim.digest)): ErrorCode.UNKNOWN_SLOT,
        encode(Scan(65535, rim.digest)): ErrorCode.UNKNOWN_SLOT,
        encode(SetPattern(4, rim)): ErrorCode.TOO_LARGE,
        encode(SetPattern(0, big)): ErrorCode.TOO_LARGE,
        encode(SetPattern(0, beyond)): ErrorCode.BAD_PATTERN,
        intact(1, MessageKind.PATTERN, b"\0\0" + twice): ErrorCode.BAD_PATTERN,
        intact(1, MessageKind.SCAN, b""): ErrorCode.BAD_REQUEST,
        intact(1, MessageKind.SCAN, bytes(7)): ErrorCode.BAD_REQUEST,
        intact(1, MessageKind.HELLO, b"\0"): ErrorCode.BAD_REQUEST,
        intact(1, 0x42, b""): ErrorCode.UNKNOWN_KIND,
        intact(2, MessageKind.SCAN, b""): ErrorCode.WRONG_VERSION,
        encode(Ack()): ErrorCode.UNKNOWN_KIND,
        encode(PressCommand(0, 0.1, 0.1, 0.01, 1.0)): ErrorCode.NOT_SUPPORTED,
    }
    for request, code in cases.items():
        reply = answer(session, request)
        assert isinstance(reply, Refusal)
        assert reply.code == code
        assert reply.text
    assert answer(session, encode(SetPattern(0, rim))) == Ack(rim.digest)
    reply = answer(session, encode(Scan(0, rim.digest ^ 1)))
    assert isinstance(reply, Refusal)
    assert reply.code == ErrorCode.DIGEST_MISMATCH


def test_a_touch_that_takes_long_is_followed_by_a_rest_in_which_others_are_served(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock, taken = [0.0], []

    class Slow(Instrument):
        capabilities = replace(VECTORS["CAPABILITIES"], features=Feature.VIRTUAL)  # type: ignore[type-var]

        def press(self, number: int, x: float, y: float, radius: float, pressure: float) -> None:
            taken.append(pressure)
            clock[0] += 0.01 * pressure

    monkeypatch.setattr("ohmskin.device.instrument.time", SimpleNamespace(monotonic=lambda: clock[0]))
    session = Session(SharedInstrument(Slow()))

    def pressed(pressure: float) -> object:
        reply = answer(session, encode(PressCommand(0, 0.1, 0.1, 0.01, pressure)))
        return reply.code if isinstance(reply, Refusal) else reply

    assert [pressed(20.0), pressed(200.0), pressed(20.0)] == [Ack(), Ack(), ErrorCode.BUSY]
    assert answer(session, encode(SetPattern(0, PATTERN))) == Ack(PATTERN.digest)
    assert isinstance(answer(session, encode(Scan(0, PATTERN.digest))), FrameData)
    assert pressed(0.0) == Ack()  # lifting is free
    clock[0] += 2.0
    assert pressed(20.0) == Ack()
    assert taken == [20.0, 200.0, 0.0, 20.0]


def rows(heading: str) -> list[list[str]]:
    """The cells of the first table under a heading of docs/protocol.md."""
    section = re.search(rf"^#+ {heading}\n(.*?)(?=^#|\Z)", DOC, re.M | re.S)
    assert section, heading
    lines = [line for line in section[1].splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


@pytest.mark.parametrize("kind", list(MessageKind))
def test_the_documented_layout_is_the_one_in_use(kind: MessageKind) -> None:
    offset, expected = 0, []
    for field in LAYOUTS[kind].scalars:
        assert offset % field.size == 0, f"{field.name} is not aligned"
        expected.append([str(offset), str(field), field.name])
        offset += field.size
    for number, field in enumerate(LAYOUTS[kind].tail):
        expected.append(["next" if number else str(offset), str(field), field.name])
    assert [row[:3] for row in rows(f"0x{kind:02X} {kind.name}")] == expected


def test_the_documented_error_codes_are_the_ones_in_use() -> None:
    assert [row[:2] for row in rows("Error codes")] == [[str(int(code)), code.name] for code in ErrorCode]


PATTERN = DrivePattern(np.array([[0, 1], [2, 3]]), np.array([[0, 2, 3], [0, 3, 4], [1, 4, 0]]))
VECTORS: dict[str, Message] = {
    "HELLO": Hello(),
    "CAPABILITIES": Capabilities(
        "demo skin",
        16,
        64,
        1024,
        4,
        Feature.VIRTUAL | Feature.CURRENT_MEASURED,
        *(float(np.float32(value)) for value in (2e-3, 2.5, 1e-4, 2e-5)),
        serial=0x12345678,
        firmware=(1, 2, 3),
        boot=0x9ABCDEF0,
    ),
    "PATTERN": SetPattern(0, PATTERN),
    "ACK": Ack(PATTERN.digest),
    "SCAN": Scan(0, PATTERN.digest),
    "FRAME": FrameData(
        PATTERN.digest,
        7,
        1_500_000,
        1,
        np.array([2e-3, 2e-3], np.float32),
        np.array([0.25, np.nan, np.inf], np.float32),
    ),
    "PRESS": PressCommand(0, 0.0625, 0.125, 0.0078125, 20000.0),
    "ERROR": Refusal(6, "no pattern in slot 0"),
}


def test_the_documented_vectors_are_what_travels() -> None:
    found = re.findall(r"^\| ([A-Z]+) \| (\d+) \| `([0-9a-f]+)` \|$", DOC, re.M)
    documented = {name: (int(sequence), bytes.fromhex(packet)) for name, sequence, packet in found}
    assert documented.keys() == VECTORS.keys() == MessageKind.__members__.keys()
    for name, (sequence, packet) in documented.items():
        assert encode(VECTORS[name], sequence) == packet
        (got,) = PacketDecoder().feed(packet)
        assert again(got) == packet
    assert f"0x{PATTERN.digest:08X}" in DOC
    assert zlib.crc32(b"123456789") == 0xCBF43926


def test_documented_text_that_is_not_utf8_is_shown_as_far_as_it_can_be() -> None:
    found = re.search(r"is not UTF-8, as an error of code 10: `([0-9a-f]+)`", DOC)
    assert found
    assert PacketDecoder().feed(bytes.fromhex(found[1])) == [Packet(3, Refusal(10, "??skin"))]
    (packet,) = PacketDecoder().feed(
        intact(1, MessageKind.CAPABILITIES, LAYOUTS[MessageKind.CAPABILITIES].pack(NAMELESS) + b"\xff" * 32)
    )
    assert isinstance(packet.message, Capabilities)
    assert packet.message.name == "?" * 32


NAMELESS = protocol.to_fields(replace(VECTORS["CAPABILITIES"], name=""))  # type: ignore[type-var]


def test_the_documented_blocks_without_a_zero_are_what_travels() -> None:
    from cobs import cobs

    stuffed = re.findall(r"^\| \d+ bytes `(\w\w) \.\. (\w\w)` \| `(.*)` \|$", DOC, re.M)
    assert len(stuffed) == 4
    for first, last, expected in stuffed:
        data = bytes(range(int(first, 16), int(last, 16) + 1))
        runs = re.sub(
            r"(\w\w) \.\. (\w\w)", lambda run: bytes(range(int(run[1], 16), int(run[2], 16) + 1)).hex(), expected
        )
        assert cobs.encode(data) == bytes.fromhex(runs)
    full = b"\xff" + bytes(range(1, 255))
    assert cobs.decode(full + b"\x01") == cobs.decode(full) == full[1:]


def test_frames_are_numbered_modulo_two_to_the_32() -> None:
    frame = Frame(PATTERN, np.zeros(3), np.ones(2), 0.0, 2**32 + 5)
    assert FrameData.of(frame).number == 5
