"""The firmware's core on this computer: its C tests, its fuzzer, and comparison with the Python device, request by
request."""

import fcntl
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from test_protocol import intact, patterns
from tiers import needs

from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.device.instrument import SharedInstrument
from ohmskin.device.layout import LAYOUTS, MessageKind
from ohmskin.device.messages import Ack, ErrorCode, FrameData, Hello, Message, Refusal, Scan, SetPattern, to_fields
from ohmskin.device.protocol import PacketDecoder, Unreadable, encode
from ohmskin.device.session import Session
from ohmskin.scan import DrivePattern, Frame, measure_others

FIRMWARE = Path(__file__).parents[1] / "firmware"
SIZES = Capabilities(
    "demo skin", 16, 8, 64, 3, Feature.VIRTUAL | Feature.CURRENT_MEASURED
)  # of firmware/tests/config.h


def build(target: str) -> Path:
    """What `make` makes of a target of the firmware's Makefile."""
    needs("make", package="make")
    with (FIRMWARE / "Makefile").open() as one_at_a_time:
        fcntl.flock(one_at_a_time, fcntl.LOCK_EX)
        command = ["make", "-C", FIRMWARE, target, f"PYTHON={sys.executable}"]
        made = subprocess.run(command, capture_output=True, text=True)
    assert made.returncode == 0, made.stdout + made.stderr
    return FIRMWARE / target


def test_the_generated_headers_are_fresh() -> None:
    command = [sys.executable, FIRMWARE / "generate.py", "--check"]
    checked = subprocess.run(command, capture_output=True, text=True)
    assert checked.returncode == 0, checked.stderr


def test_the_core_passes_its_own_tests() -> None:
    ran = subprocess.run([build("build/test_core")], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "0 failures" in ran.stdout


def test_ten_seconds_of_fuzzing_find_nothing(tmp_path: Path) -> None:
    fuzzer = build("build/fuzz_session")
    subprocess.run([sys.executable, FIRMWARE / "fuzz" / "corpus.py", tmp_path], check=True)
    command = [fuzzer, tmp_path, "-max_total_time=10", "-max_len=4096", "-timeout=20", f"-artifact_prefix={tmp_path}/"]
    # a child of the shell's: what is started from here counts this process's own memory as its peak
    ran = subprocess.run(["sh", "-c", '"$0" "$@"; exit $?', *command], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "Done" in ran.stdout + ran.stderr


class Bridge:
    """The C core as a process of its own: the bytes of a request in, its reply out."""

    def __init__(self) -> None:
        self._process = subprocess.Popen([build("build/bridge")], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._decoder = PacketDecoder()

    def ask(self, request: bytes) -> Message | Unreadable:
        """The one reply to one packet."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(request)
        self._process.stdin.flush()
        while True:
            data = self._process.stdout.read1()  # type: ignore[attr-defined]
            assert data, f"the bridge ended with status {self._process.wait()}"
            if packets := self._decoder.feed(data):
                (packet,) = packets
                return packet.message

    def close(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        assert self._process.wait(120) == 0
        self._process.stdout.close()


@contextmanager
def bridge() -> Iterator[Bridge]:
    opened = Bridge()
    try:
        yield opened
    finally:
        opened.close()


class CodedInstrument:
    """Measures what firmware/tests/fake_board.c measures."""

    capabilities = SIZES

    def scan(self, pattern: DrivePattern) -> Frame:
        codes = 1 + pattern.quadruples @ [7, 31, 127, 509] % 4094
        return Frame(pattern, (codes - 2048) / 1024, np.full(pattern.n_inj, 512 / 262144), 0.0)

    def press(self, number: int, x: float, y: float, radius: float, pressure: float) -> None:
        pass


def same(ours: Message | Unreadable, theirs: Message | Unreadable) -> bool:
    """Whether two devices said the same, texts and counters aside."""
    if isinstance(ours, FrameData) and isinstance(theirs, FrameData):
        values = np.array_equal(ours.voltages, theirs.voltages) and np.array_equal(ours.currents, theirs.currents)
        return values and ours.digest == theirs.digest
    if isinstance(ours, Refusal) and isinstance(theirs, Refusal):
        return ours.code == theirs.code and bool(ours.text)
    if isinstance(ours, Capabilities) and isinstance(theirs, Capabilities):
        able = ("name", "n_electrodes", "max_injections", "max_measurements", "pattern_slots", "features")
        return all(getattr(ours, name) == getattr(theirs, name) for name in able)
    return ours == theirs


few = st.integers(0, 17)


@st.composite
def driveable(draw: st.DrawFn) -> DrivePattern:
    """Patterns that the small device takes, mostly."""
    pair = (
        st.lists(few, min_size=2, max_size=2, unique=True)
        if draw(st.booleans())
        else st.sampled_from([[0, 1], [15, 3]])
    )
    injections = draw(st.lists(pair, min_size=1, max_size=9))
    which = sorted(draw(st.lists(st.integers(0, len(injections) - 1), min_size=1, max_size=70)))
    return DrivePattern(np.array(injections), np.array([[k, *draw(pair)] for k in which]))


@st.composite
def requests(draw: st.DrawFn) -> bytes:
    """Requests as a host sends them, and others with something wrong in the payload."""
    slot = draw(st.integers(0, 4))
    match draw(st.integers(0, 5)):
        case 0:
            return encode(Hello())
        case 1 | 2:
            return encode(SetPattern(slot, draw(st.one_of(driveable(), patterns()))))
        case 3:
            return encode(Scan(slot, draw(st.integers(0, 2**32 - 1))))
        case 4:
            kind = draw(st.sampled_from([MessageKind.HELLO, MessageKind.SCAN, MessageKind.PRESS]))
            return intact(1, kind, draw(st.binary(max_size=24)))
        case _:
            return intact(draw(st.integers(0, 3)), draw(st.integers(0, 255)), b"")


@pytest.fixture(scope="module")
def core() -> Iterator[Bridge]:
    with bridge() as opened:
        yield opened


@settings(max_examples=200)
@given(asked=st.lists(requests(), min_size=1, max_size=12))
@example(asked=[intact(1, MessageKind.ERROR, b"")])  # a reply sent as a request, and cut
def test_the_core_answers_as_the_python_device_does(core: Bridge, asked: list[bytes]) -> None:
    session, decoder = Session(SharedInstrument(CodedInstrument())), PacketDecoder()
    core.ask(encode(Hello()))  # both begin without patterns
    for request in asked:
        (packet,) = decoder.feed(session.feed(request))
        told = core.ask(request)
        known = isinstance(packet.message, Refusal) and packet.message.code == ErrorCode.BAD_PATTERN
        if known and isinstance(told, Refusal) and told.code in (ErrorCode.BAD_REQUEST, ErrorCode.TOO_LARGE):
            continue  # both are true of it, and docs/protocol.md gives no order
        assert same(packet.message, told), f"{request.hex()}: {packet.message} but {told}"


def test_both_devices_give_the_documented_answer_where_a_request_does_not_fit(core: Bridge) -> None:
    rim = DrivePattern(np.array([[0, 1]]), np.array([[0, 2, 3]]))
    session, decoder = Session(SharedInstrument(CodedInstrument())), PacketDecoder()
    for request, codes in (
        (encode(Scan(65535, 1)), {ErrorCode.UNKNOWN_SLOT}),
        (encode(SetPattern(SIZES.pattern_slots, rim)), {ErrorCode.TOO_LARGE}),
        (intact(1, MessageKind.HELLO, b"\0"), {ErrorCode.BAD_REQUEST}),
        (intact(1, MessageKind.SCAN, bytes(7)), {ErrorCode.BAD_REQUEST}),
        (intact(1, MessageKind.PRESS, bytes(19)), {ErrorCode.BAD_REQUEST}),
        (intact(1, MessageKind.PATTERN, bytes(6)), {ErrorCode.BAD_REQUEST, ErrorCode.BAD_PATTERN}),
        (intact(1, MessageKind.PATTERN, encode_payload(rim) + b"\0\0"), {ErrorCode.BAD_REQUEST, ErrorCode.BAD_PATTERN}),
    ):
        (packet,) = decoder.feed(session.feed(request))
        for told in (packet.message, core.ask(request)):
            assert isinstance(told, Refusal)
            assert told.code in codes


def encode_payload(pattern: DrivePattern) -> bytes:
    return LAYOUTS[MessageKind.PATTERN].pack(to_fields(SetPattern(0, pattern)))


@settings(max_examples=40)
@given(
    st.lists(st.lists(st.integers(0, 15), min_size=2, max_size=2, unique=True), min_size=1, max_size=4),
    st.integers(0, 2),
)
def test_the_core_measures_what_it_was_given(core: Bridge, injections: list[list[int]], slot: int) -> None:
    pattern = measure_others(np.array(injections), range(16))
    assert core.ask(encode(SetPattern(slot, pattern))) == Ack(pattern.digest)
    frame = core.ask(encode(Scan(slot, pattern.digest)))
    assert isinstance(frame, FrameData)
    assert same(FrameData.of(CodedInstrument().scan(pattern)), frame)


def test_the_layouts_cover_every_message() -> None:
    header = (FIRMWARE / "core" / "protocol_layout.h").read_text()
    for kind, layout in LAYOUTS.items():
        assert f"KIND_{kind.name} = 0x{kind:02X}" in header
        assert f"#define {kind.name}_BYTES {sum(field.size for field in layout.scalars)}\n" in header
