"""The driver against a device made of software: over TCP and a pseudo-terminal, on good lines and bad ones."""

import os
import random
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from direct import DirectDevice
from waiting import until

from ohmskin.device import Capabilities, Device, DeviceServer, Feature, PressCommand, connect, drivers, registry
from ohmskin.device.instrument import SharedInstrument
from ohmskin.device.layout import MessageKind
from ohmskin.device.messages import Ack, ErrorCode, FrameData, Hello, Message, Refusal, Scan, SetPattern
from ohmskin.device.protocol import PacketDecoder, encode
from ohmskin.device.session import Session
from ohmskin.device.transport import SerialTransport, SocketTransport, open_transport
from ohmskin.device.virtual import VirtualInstrument
from ohmskin.device.wire import WireDevice
from ohmskin.errors import DeviceError, DeviceLost, DeviceRefused, PatternError, ProtocolError
from ohmskin.scan import DrivePattern, Frame, FrameFlag, adjacent, measure_others
from ohmskin.skin import Skin, VirtualSkin

CAPABILITIES = Capabilities("fake skin", 16, 64, 1024, 4, Feature.VIRTUAL, full_scale=2.5, serial=7, boot=1)
RIM = adjacent([range(16)])
SMALL = DrivePattern(np.array([[0, 1]]), np.array([[0, 2, 3], [0, 3, 4]]))


class FakeSkin:
    """A linear instrument: every voltage tells which electrodes it was measured with."""

    def __init__(self, capabilities: Capabilities = CAPABILITIES, delay: float = 0.0) -> None:
        self.capabilities = capabilities
        self.delay = delay
        self.scans = 0
        self.down: dict[int, tuple[float, float, float, float]] = {}

    def scan(self, pattern: DrivePattern) -> Frame:
        time.sleep(self.delay)
        self.scans += 1
        if pattern.n_meas == 7:
            raise RuntimeError("relay stuck")
        return Frame(
            pattern, voltages(pattern), np.full(pattern.n_inj, 0.5), self.scans * 0.25, self.scans, FrameFlag.FIRST
        )

    def press(self, number: int, x: float, y: float, radius: float, pressure: float) -> None:
        if pressure:
            self.down[number] = (x, y, radius, pressure)
        else:
            del self.down[number]


def voltages(pattern: DrivePattern) -> np.ndarray:
    values = pattern.quadruples @ [1.0, 17.0, 289.0, 4913.0]
    values[:2] = np.nan, np.inf
    return values


def some_pattern(seed: int, injections: int = 6) -> DrivePattern:
    rng = np.random.default_rng(seed)
    return measure_others([rng.choice(16, 2, replace=False) for _ in range(injections)], range(16))


def waited(told: "pytest.ExceptionInfo[DeviceLost]") -> float:
    """How long a device was waited for (s), as the error says."""
    found = re.search(r"did not answer in ([\d.]+) s", str(told.value))
    assert found
    return float(found[1])


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A driver that gives a busy machine time, so that whatever it sends again has another cause."""
    monkeypatch.setattr("ohmskin.device.wire._GRACE", 60.0)


@pytest.fixture
def skin() -> FakeSkin:
    return FakeSkin()


@pytest.fixture
def server(skin: FakeSkin) -> Iterator[DeviceServer]:
    with DeviceServer(skin, port=0) as server:
        yield server


@pytest.fixture(params=["tcp", "pty"])
def url(request: pytest.FixtureRequest, skin: FakeSkin) -> Iterator[str]:
    with DeviceServer(skin, port=0, pty=request.param == "pty") as server:
        yield server.url if request.param == "tcp" else f"serial://{server.pty_path}"


@contextmanager
def line(server_url: str, spoil: Callable[[bytes, bool], bytes]) -> Iterator[str]:
    """A line that passes bytes on as `spoil(data, towards_host)` leaves them."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def pump(source: socket.socket, target: socket.socket, towards_host: bool) -> None:
            try:
                while data := source.recv(65536):
                    target.sendall(spoil(data, towards_host))
            except OSError:
                pass
            finally:
                for end in (source, target):
                    with suppress(OSError):
                        end.shutdown(socket.SHUT_RDWR)

        def accept() -> None:
            host, _ = listener.accept()
            address, _, port = server_url.removeprefix("tcp://").partition(":")
            with host, socket.create_connection((address, int(port))) as device:
                back = threading.Thread(target=pump, args=(device, host, True))
                back.start()
                pump(host, device, False)
                back.join()

        thread = threading.Thread(target=accept)
        thread.start()
        yield f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        thread.join(120)
        assert not thread.is_alive()


@contextmanager
def stub(behave: Callable[[socket.socket], None]) -> Iterator[str]:
    """A device of one connection that does as `behave` says."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def accept() -> None:
            host, _ = listener.accept()
            with host, suppress(ConnectionError):  # the driver hangs up as soon as it knows enough
                behave(host)

        thread = threading.Thread(target=accept)
        thread.start()
        yield f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        thread.join(120)
        assert not thread.is_alive()


def test_capabilities_arrive(url: str) -> None:
    with connect(url) as device:
        assert device.capabilities == CAPABILITIES
        assert device.url == url


def test_scans_equal_what_the_instrument_measured(url: str) -> None:
    with connect(url) as device:
        for count in (1, 2, 3):
            frame = device.scan(RIM)
            np.testing.assert_array_equal(frame.voltages, voltages(RIM))
            np.testing.assert_array_equal(frame.currents, np.full(16, 0.5))
            assert (frame.pattern, frame.time, frame.sequence, frame.flags) == (
                RIM,
                count * 0.25,
                count,
                FrameFlag.FIRST,
            )


def test_a_new_pattern_every_frame_takes_one_round_trip(url: str, skin: FakeSkin, patient: None) -> None:
    patterns = [some_pattern(seed) for seed in range(30)]  # more than the device has slots
    with connect(url) as device:
        assert isinstance(device, WireDevice)
        for pattern in patterns + patterns[::-1]:
            np.testing.assert_array_equal(device.scan(pattern).voltages, voltages(pattern))
        link = device.link
    assert (link.retries, link.dropped, link.damaged, link.resets) == (0, 0, 0, 0)
    assert skin.scans == 60
    assert link.requests == 1 + 60 + (60 - 4)  # greeting, scans, uploads; the last four patterns were still there


def test_known_patterns_are_uploaded_once(server: DeviceServer, patient: None) -> None:
    patterns = [some_pattern(seed) for seed in range(4)]
    with connect(server.url) as device:
        for pattern in patterns * 10:
            device.scan(pattern)
        assert device.link.requests == 1 + 40 + 4
        device.scan(RIM)  # takes the slot of the first, which was not used for longest
        for pattern in patterns[1:]:
            device.scan(pattern)
        assert device.link.requests == 1 + 44 + 5


def test_the_slot_of_the_pattern_not_used_for_longest_is_given_away(server: DeviceServer) -> None:
    first, second, *rest = (some_pattern(seed) for seed in range(4))
    with connect(server.url) as device:
        for pattern in (first, second, *rest, first, RIM):  # the rim takes the slot of the second
            device.scan(pattern)
        before = device.link.requests
        device.scan(first)
        assert device.link.requests == before + 1
        device.scan(second)
        assert device.link.requests == before + 3


def test_a_bad_line_costs_retries_but_never_gives_wrong_data(server: DeviceServer) -> None:
    dice = random.Random(1)

    def spoil(data: bytes, towards_host: bool) -> bytes:
        return bytes(dice.randrange(256) if dice.random() < 0.01 else byte for byte in data)

    with line(server.url, spoil) as url, connect(url, timeout=20) as device:
        for _ in range(60):
            frame = device.scan(SMALL, timeout=20)
            np.testing.assert_array_equal(frame.voltages, voltages(SMALL))
        assert device.link.retries > 0
        assert device.link.damaged > 0
        assert device.dropped == device.link.retries


def test_lost_bytes_and_whole_lost_replies_are_made_good(server: DeviceServer) -> None:
    dice = random.Random(2)

    def spoil(data: bytes, towards_host: bool) -> bytes:
        if dice.random() < 0.2:
            return b"" if towards_host else data[: dice.randrange(len(data))]
        return data

    with line(server.url, spoil) as url, connect(url, timeout=20) as device:
        for seed in range(20):
            pattern = some_pattern(seed)
            np.testing.assert_array_equal(device.scan(pattern, timeout=20).voltages, voltages(pattern))
        assert device.link.retries > 0


def test_duplicates_are_dropped(server: DeviceServer, patient: None) -> None:
    with line(server.url, lambda data, _: data * 2) as url, connect(url) as device:
        for seed in range(10):
            pattern = some_pattern(seed)
            np.testing.assert_array_equal(device.scan(pattern).voltages, voltages(pattern))
        assert device.link.dropped >= 10
        assert device.link.retries == 0


def test_a_late_reply_is_not_taken_for_the_next_one() -> None:
    skin = FakeSkin(delay=0.3)
    with DeviceServer(skin, port=0) as server, connect(server.url) as device:
        with pytest.raises(DeviceLost, match="did not answer in") as told:
            device.scan(RIM, timeout=0.1)
        assert waited(told) >= 0.1
        skin.delay = 0.0
        other = some_pattern(1)
        np.testing.assert_array_equal(device.scan(other).voltages, voltages(other))
        assert device.link.dropped >= 2  # the acknowledgement and the frame that came too late


def test_a_device_slower_than_it_says_still_gets_through() -> None:
    skin = FakeSkin(delay=0.12)
    with DeviceServer(skin, port=0) as server, connect(server.url) as device:
        device.scan(SMALL)
        assert device.link.retries > 0


@pytest.mark.parametrize("greet", [False, True])
def test_a_silent_device_is_lost_in_bounded_time(greet: bool) -> None:
    def behave(host: socket.socket) -> None:
        decoder = PacketDecoder()
        while data := host.recv(65536):
            for packet in decoder.feed(data):
                if greet and isinstance(packet.message, Hello):
                    host.sendall(encode(CAPABILITIES, packet.sequence))

    start = time.monotonic()
    with (
        stub(behave) as url,
        pytest.raises(DeviceLost, match=r"s and \d attempts; (no byte|it answered)") as told,
        connect(url, timeout=0.5) as device,
    ):
        device.scan(RIM, timeout=0.5)
    took = time.monotonic() - start
    assert 0.5 <= waited(told) <= took + 0.005  # told to the nearest hundredth of a second


def test_something_else_than_a_device_is_told_apart() -> None:
    def behave(host: socket.socket) -> None:
        while host.recv(65536):
            host.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")

    with stub(behave) as url, pytest.raises(DeviceLost, match="but no valid message: check the baud rate"):
        connect(url, timeout=0.3)


def test_a_device_that_hangs_up_is_lost_at_once() -> None:
    skin = FakeSkin()
    server = DeviceServer(skin, port=0)
    server.start()
    with connect(server.url) as device:
        server.close()
        start = time.monotonic()
        with pytest.raises(DeviceLost, match=r"closed the connection|connection to .* lost"):
            device.scan(RIM, timeout=60)
        assert time.monotonic() - start < 30  # it does not wait for its time to be over
    with pytest.raises(DeviceLost, match="is `ohmskin serve-skin` running there"):
        connect(server.url)
    port = int(server.url.rpartition(":")[2])
    with DeviceServer(skin, port=port) as back, connect(back.url) as device:
        device.scan(RIM)


def test_a_pseudo_terminal_that_goes_is_lost(skin: FakeSkin) -> None:
    server = DeviceServer(skin, port=0, pty=True)
    server.start()
    with connect(f"serial://{server.pty_path}") as device:
        device.scan(RIM)
        server.close()
        with pytest.raises(DeviceLost, match=r"is disconnected: .*; plug it in again|cannot send"):
            device.scan(RIM)


def test_a_pseudo_terminal_survives_hosts_that_come_and_go(skin: FakeSkin) -> None:
    with DeviceServer(skin, port=0, pty=True) as server:
        assert server.pty_path
        for _ in range(3):
            with connect(f"serial://{server.pty_path}") as device:
                device.press(1, (0.1, 0.1), 0.01, 1e4)
                device.scan(RIM)
                assert len(skin.down) == 1
            until(lambda: not skin.down)


def test_stale_bytes_of_an_earlier_host_do_no_harm(skin: FakeSkin) -> None:
    with DeviceServer(skin, port=0, pty=True) as server:
        assert server.pty_path
        rude = SerialTransport(server.pty_path)
        rude.write(encode(Hello(), 5) * 3 + encode(Hello(), 6)[:5])  # leaves replies unread and a request unfinished
        rude.close()
        with connect(f"serial://{server.pty_path}") as device:
            np.testing.assert_array_equal(device.scan(RIM).voltages, voltages(RIM))


def test_a_port_is_not_shared(skin: FakeSkin) -> None:
    told = pytest.raises(DeviceLost, match="another program uses it")
    with DeviceServer(skin, port=0, pty=True) as server, connect(f"serial://{server.pty_path}"), told:
        connect(f"serial://{server.pty_path}")


class Forgetful:
    """A line in front of a server that is exchanged for a fresh one, as if the device had been reset."""

    def __init__(self, capabilities: Capabilities) -> None:
        self.capabilities = capabilities

    def __call__(self, host: socket.socket) -> None:
        session = Session(SharedInstrument(FakeSkin()))
        scans = 0
        while data := host.recv(65536):
            reply = session.feed(data)
            host.sendall(reply)
            scans += any(isinstance(packet.message, FrameData) for packet in PacketDecoder().feed(reply))
            if scans == 1:
                session, scans = Session(SharedInstrument(FakeSkin(self.capabilities))), 2


def test_a_reset_device_gets_its_patterns_again() -> None:
    with stub(Forgetful(replace(CAPABILITIES, boot=2))) as url, connect(url) as device:
        for _ in range(3):
            np.testing.assert_array_equal(device.scan(RIM).voltages, voltages(RIM))
        assert device.link.resets == 1
        assert device.capabilities.boot == 2


def test_another_device_at_the_same_address_is_noticed() -> None:
    with stub(Forgetful(replace(CAPABILITIES, name="other", serial=8))) as url, connect(url) as device:
        device.scan(RIM)
        with pytest.raises(DeviceLost, match=r"another device answers .* 'other' instead of 'fake skin'"):
            device.scan(RIM)


@pytest.mark.parametrize(
    ("version", "advice"), [(2, "update ohmskin on this host"), (0, "update the device's firmware")]
)
def test_another_protocol_version_is_told(version: int, advice: str) -> None:
    import zlib

    from cobs import cobs

    def behave(host: socket.socket) -> None:
        decoder = PacketDecoder()
        while data := host.recv(65536):
            for packet in decoder.feed(data):
                body = bytes([version, MessageKind.ERROR]) + packet.sequence.to_bytes(2, "little") + b"\x01\0what?"
                host.sendall(cobs.encode(body + zlib.crc32(body).to_bytes(4, "little")) + b"\0")

    with stub(behave) as url, pytest.raises(ProtocolError, match=f"speaks protocol {version}, this host 1; {advice}"):
        connect(url)


def test_a_frame_of_another_pattern_is_refused() -> None:
    def behave(host: socket.socket) -> None:
        decoder = PacketDecoder()
        other = some_pattern(5)
        while data := host.recv(65536):
            for packet in decoder.feed(data):
                reply = CAPABILITIES if isinstance(packet.message, Hello) else FrameData.of(FakeSkin().scan(other))
                host.sendall(encode(reply, packet.sequence))

    with stub(behave) as url, connect(url) as device, pytest.raises(ProtocolError, match="drove a pattern with digest"):
        device.scan(RIM)


def test_a_pattern_with_another_digest_in_the_device_is_refused() -> None:
    def behave(host: socket.socket) -> None:
        decoder = PacketDecoder()
        while data := host.recv(65536):
            for packet in decoder.feed(data):
                match packet.message:
                    case Hello():
                        reply: Message = CAPABILITIES
                    case SetPattern(_, pattern):
                        reply = Ack(pattern.digest ^ 1)
                    case _:
                        reply = FrameData.of(FakeSkin().scan(RIM))
                host.sendall(encode(reply, packet.sequence))

    with (
        stub(behave) as url,
        connect(url) as device,
        pytest.raises(ProtocolError, match="gives the pattern the digest"),
    ):
        device.scan(RIM)


@pytest.mark.parametrize("patient", [True, False])
def test_a_busy_device_is_asked_again(patient: bool) -> None:
    def behave(host: socket.socket) -> None:
        session, decoder, refusals = Session(SharedInstrument(FakeSkin())), PacketDecoder(), 0
        while data := host.recv(65536):
            packets = decoder.feed(data)
            if packets and isinstance(packets[-1].message, Scan) and (refusals < 2 or not patient):
                refusals += 1
                host.sendall(encode(Refusal(ErrorCode.BUSY, "relays moving"), packets[-1].sequence))
            else:
                host.sendall(session.feed(data))

    with stub(behave) as url, connect(url) as device:
        if patient:
            np.testing.assert_array_equal(device.scan(RIM).voltages, voltages(RIM))
        else:
            with pytest.raises(DeviceLost, match="its last error was 'relays moving'"):
                device.scan(RIM, timeout=0.3)


def test_patterns_beyond_the_device_are_refused_with_advice(server: DeviceServer) -> None:
    with connect(server.url) as device:
        with pytest.raises(PatternError, match=r"electrode 19; there are 16 .* on device 'fake skin'"):
            device.scan(adjacent([range(20)]))
        big = DrivePattern(np.tile([[0, 1]], (65, 1)), np.array([[0, 2, 3]]))
        with pytest.raises(PatternError, match=r"takes 64 and 1024 at a time; scan the pieces of pattern.split\(64\)"):
            device.scan(big)
        wide = DrivePattern(
            np.tile([[0, 1]], (4, 1)), np.column_stack([np.repeat(np.arange(4), 300), np.tile([2, 3], (1200, 1))])
        )
        with pytest.raises(PatternError, match=r"pattern.split\(3\)"):
            device.scan(wide)
        for piece in wide.split(3):
            device.scan(piece)


def test_a_failing_instrument_is_a_refusal_and_nothing_more(server: DeviceServer) -> None:
    seven = DrivePattern(np.array([[0, 1]]), np.array([[0, 2, 3]] * 7))
    with connect(server.url) as device:
        with pytest.raises(DeviceRefused, match="relay stuck"):
            device.scan(seven)
        device.scan(RIM)


def test_two_hosts_do_not_clash(server: DeviceServer, skin: FakeSkin) -> None:
    with connect(server.url) as one, connect(server.url) as two:
        one.press(0, (0.25, 0.5), 0.0078125, 1e4)
        two.press(0, (0.5, 0.5), 0.0078125, 2e4)
        assert sorted(skin.down.values()) == [(0.25, 0.5, 0.0078125, 1e4), (0.5, 0.5, 0.0078125, 2e4)]
        two.press(0, (0.5, 0.75), 0.0078125, 2e4)  # moves its own
        assert sorted(skin.down.values())[1] == (0.5, 0.75, 0.0078125, 2e4)
        for seed in range(10):  # slots are each host's own
            for device, pattern in ((one, some_pattern(seed)), (two, some_pattern(seed + 100))):
                np.testing.assert_array_equal(device.scan(pattern).voltages, voltages(pattern))
        one.press(0, (0.25, 0.5), 0.0078125, 0.0)
        assert len(skin.down) == 1
        one.press(0, (0.25, 0.5), 0.0078125, 0.0)  # lifting twice is no error
    until(lambda: not skin.down)


def test_a_connection_is_a_session_also_without_a_greeting(server: DeviceServer, skin: FakeSkin) -> None:
    """Slots are those of the connection, and go with it, as presses do."""
    greeting, asked = [Hello(), SetPattern(0, RIM), PressCommand(0, 0.1, 0.1, 0.01, 1e4)], Scan(0, RIM.digest)
    for requests, kind in (
        ([*greeting, asked], FrameData),
        ([asked], Refusal),
        ([SetPattern(0, RIM), asked], FrameData),
    ):
        with socket.create_connection(("127.0.0.1", int(server.url.rpartition(":")[2]))) as line:
            line.settimeout(60)
            line.sendall(b"".join(encode(request, k) for k, request in enumerate(requests)))
            decoder, packets = PacketDecoder(), []
            while len(packets) < len(requests):
                packets += decoder.feed(line.recv(65536))
        assert isinstance(packets[-1].message, kind)
        assert kind is FrameData or packets[-1].message.code == ErrorCode.UNKNOWN_SLOT
        until(lambda: not skin.down)


def test_the_virtual_device_flags_the_first_frame_since_its_start_and_no_other() -> None:
    instrument = VirtualInstrument(Skin.load("paper"), 1, realtime=False)
    with DeviceServer(instrument, port=0) as server:
        flags = []
        for _ in range(2):  # a new session is no new start
            with connect(server.url) as device:
                frames = [device.scan(SMALL) for _ in range(2)]
                flags += [(frame.sequence, FrameFlag.FIRST in frame.flags) for frame in frames]
    assert flags == [(1, True), (2, False), (3, False), (4, False)]


def test_presses_pass_between_the_scans_of_another_host() -> None:
    skin = FakeSkin(delay=0.003)
    with (
        DeviceServer(skin, port=0) as server,
        connect(server.url) as scanner,
        connect(server.url) as presser,
    ):
        stop = threading.Event()

        def scan() -> None:
            while not stop.is_set():
                scanner.scan(RIM)

        thread = threading.Thread(target=scan)
        thread.start()
        waited_for = []
        for _ in range(30):
            before = skin.scans
            presser.press(0, (0.1, 0.1), 0.01, 1e4)
            waited_for.append(skin.scans - before)
        stop.set()
        thread.join()
    assert np.median(waited_for) <= 3


def test_a_press_waits_for_the_scan_of_another_thread() -> None:
    scanning, go_on, order = threading.Event(), threading.Event(), []

    class Slow(DirectDevice):
        def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
            scanning.set()
            assert go_on.wait(120)
            order.append("scan")
            return FakeSkin().scan(pattern)

        def _press(self, press: PressCommand) -> None:
            order.append("press")

    device = Slow(VirtualSkin(Skin.load("paper")))
    scan = threading.Thread(target=device.scan, args=(SMALL, 60))
    press = threading.Thread(target=device.press, args=(1, (0.1, 0.1), 0.01, 1e4))
    scan.start()
    assert scanning.wait(120)
    press.start()
    press.join(0.2)
    assert press.is_alive()  # it waits
    go_on.set()
    scan.join(120)
    press.join(120)
    assert order == ["scan", "press"]


def test_one_device_serves_several_threads(server: DeviceServer) -> None:
    failures: list[Exception] = []

    def work(device: Device, seed: int) -> None:
        try:
            for k in range(10):
                pattern = some_pattern(seed * 100 + k)
                np.testing.assert_array_equal(device.scan(pattern).voltages, voltages(pattern))
        except Exception as error:  # noqa: BLE001  threads cannot raise into the test
            failures.append(error)

    with connect(server.url) as device:
        threads = [threading.Thread(target=work, args=(device, seed)) for seed in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert not failures


@pytest.mark.parametrize(
    ("at", "radius", "pressure", "match"),
    [
        ((np.nan, 0.1), 0.01, 1.0, "press x is nan"),
        ((0.1, 0.1), 0.0, 1.0, "radius is 0.0 m; it must be"),
        ((0.1, 0.1), 0.01, -1.0, "pressure is -1.0 Pa"),
        ((0.1, np.inf), 0.01, 1.0, "press y is inf"),
    ],
)
def test_impossible_presses_are_refused(
    server: DeviceServer, at: tuple[float, float], radius: float, pressure: float, match: str
) -> None:
    with connect(server.url) as device, pytest.raises(DeviceRefused, match=match):
        device.press(0, at, radius, pressure)


def test_a_real_skin_cannot_be_pressed() -> None:
    real = FakeSkin(replace(CAPABILITIES, features=Feature.CURRENT_MEASURED))
    with (
        DeviceServer(real, port=0) as server,
        connect(server.url) as device,
        pytest.raises(DeviceRefused, match="not virtual"),
    ):
        device.press(0, (0.1, 0.1), 0.01, 1.0)


def test_too_many_presses_are_refused(server: DeviceServer) -> None:
    with connect(server.url) as device:
        for number in range(64):
            device.press(number, (0.1, 0.1), 0.01, 1.0)
        with pytest.raises(DeviceRefused, match="64 presses are down"):
            device.press(64, (0.1, 0.1), 0.01, 1.0)


def test_a_refused_press_takes_no_number_and_a_refused_lift_leaves_it_down() -> None:
    class Choosy(FakeSkin):
        def press(self, number: int, x: float, y: float, radius: float, pressure: float) -> None:
            if radius > 1:
                raise DeviceRefused("too large")
            super().press(number, x, y, radius, pressure)

    skin = Choosy()
    with DeviceServer(skin, port=0) as server, connect(server.url) as device:
        for number in range(65):
            with pytest.raises(DeviceRefused, match="too large"):
                device.press(number, (0.1, 0.1), 2.0, 1.0)
        device.press(65, (0.1, 0.1), 0.01, 1.0)
        with pytest.raises(DeviceRefused, match="too large"):
            device.press(65, (0.1, 0.1), 2.0, 0.0)
        assert len(skin.down) == 1
        device.press(65, (0.1, 0.1), 0.01, 0.0)
        assert not skin.down


def test_close_is_safe_twice_and_final(server: DeviceServer) -> None:
    device = connect(server.url)
    device.close()
    device.close()
    with pytest.raises(DeviceError, match="closed; connect again"):
        device.scan(RIM)
    server.close()
    server.close()


def test_a_host_that_was_suspended_takes_the_reply_that_came_meanwhile(
    url: str, skin: FakeSkin, monkeypatch: pytest.MonkeyPatch
) -> None:
    with connect(url) as device:
        device.scan(RIM)
        read, times = SocketTransport.read, iter([1.0])

        def suspended(self: SocketTransport, timeout: float) -> bytes:
            if threading.current_thread() is not threading.main_thread():  # the server's
                return read(self, timeout)
            time.sleep(pause := next(times, 0.0))
            return b"" if pause else read(self, timeout)

        monkeypatch.setattr(SocketTransport, "read", suspended)
        np.testing.assert_array_equal(device.scan(RIM, timeout=0.5).voltages, voltages(RIM))
    assert skin.scans == 2


@pytest.mark.parametrize("settle", [0.0, 1e-3, 0.1, 1.0, 60.0])
def test_a_device_that_falls_silent_is_waited_for_ten_seconds_more_than_it_says_it_needs(
    settle: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, replies = [0.0], list[bytes]()

    def write(data: bytes) -> None:
        """Answers greetings alone."""
        asked = [packet for packet in PacketDecoder().feed(data) if isinstance(packet.message, Hello)]
        replies.extend(encode(replace(CAPABILITIES, settle_time=settle), packet.sequence) for packet in asked)

    def read(timeout: float) -> bytes:
        clock[0] += 0.0 if replies else max(timeout, 1e-4)
        return replies.pop() if replies else b""

    line = SimpleNamespace(byte_time=0.0, read=read, write=write, close=lambda: None)
    monkeypatch.setattr("ohmskin.device.wire.open_transport", lambda _: line)
    monkeypatch.setattr("ohmskin.device.wire.time", SimpleNamespace(monotonic=lambda: clock[0]))
    with WireDevice("tcp://x:1") as device:
        with pytest.raises(DeviceLost, match="did not answer"):
            device.scan(RIM)
        assert 2.0 <= clock[0] - 16 * settle <= 10.1


def test_a_timeout_must_be_positive(server: DeviceServer) -> None:
    with connect(server.url) as device, pytest.raises(DeviceError, match="must be positive"):
        device.scan(RIM, timeout=0)


def test_a_skin_is_served_at_an_ipv6_address(skin: FakeSkin) -> None:
    try:
        with socket.create_server(("::1", 0), family=socket.AF_INET6):
            pass
    except OSError:
        pytest.skip("this machine has no IPv6")
    with DeviceServer(skin, host="::1", port=0) as server, connect(server.url) as device:
        assert server.url.startswith("tcp://[::1]:")
        device.scan(RIM)


def test_a_port_in_use_is_told(server: DeviceServer, skin: FakeSkin) -> None:
    with pytest.raises(DeviceError, match=r"port \d+ on 127.0.0.1 is in use; stop the other server"):
        DeviceServer(skin, port=int(server.url.rpartition(":")[2]))
    with pytest.raises(DeviceError, match="port 99999; it must be"):
        DeviceServer(skin, port=99999)
    with pytest.raises(DeviceError, match="cannot listen on 192"):
        DeviceServer(skin, host="192.0.2.1", port=0)


def test_rubbish_does_not_take_the_server_down(server: DeviceServer) -> None:
    for seed in range(5):
        with socket.create_connection(("127.0.0.1", int(server.url.rpartition(":")[2]))) as rude:
            rude.sendall(random.Random(seed).randbytes(20000))
    with connect(server.url) as device:
        device.scan(RIM)


@pytest.mark.parametrize(
    ("url", "match"),
    [
        ("tcp://127.0.0.1", "has no host and port; need tcp://HOST:PORT with a port of 1 to 65535"),
        ("tcp://127.0.0.1:99999", "has no host and port; need tcp://HOST:PORT with a port of 1 to 65535"),
        ("tcp://::1", r"has no host and port; .* or tcp://\[::1\]:7155 for an IPv6 address"),
        ("tcp://::1:7155", r"has no host and port; .* or tcp://\[::1\]:7155 for an IPv6 address"),
        ("tcp://[::1]:1", r"\[::1\]:1"),
        ("tcp://127.0.0.1:1?fast=1", "option 'fast'; tcp takes none"),
        ("serial:///dev/ttyS0?speed=1", "option 'speed'; serial takes baud"),
        ("serial:///dev/ttyS0?baud=fast", "baud is 'fast'"),
        ("serial:///dev/ttyS0?baud=99999999999", "baud is '99999999999'; need a number of 1 to 100000000"),
        ("serial:///dev/ttyS0?baud=" + 5000 * "9", "need a number"),
        ("tcp://127.0.0.1:1/live", "has 'live' beside host and port"),
        ("tcp://me@127.0.0.1:1", "has 'me' beside host and port"),
        ("tcp://127.0.0.1:1#two", "has 'two' beside host and port"),
        ("tcp://[::1", "Invalid IPv6 URL; need such as tcp"),
        ("tcp://a..b:7155", "cannot reach a..b:7155"),
        ("serial://", "names no port"),
        ("udp://127.0.0.1:1", "no transport 'udp'"),
    ],
)
def test_bad_addresses_are_told(url: str, match: str) -> None:
    with pytest.raises(DeviceError, match=match):
        open_transport(url)


@pytest.mark.parametrize("url", ["replay:", "replay:?speed=2"])
def test_an_address_of_a_recording_without_a_file_is_told(url: str) -> None:
    with pytest.raises(DeviceError, match="names no file; need replay:FILE"):
        connect(url)


def test_missing_ports_are_told(tmp_path: Path) -> None:
    with pytest.raises(DeviceLost, match=r"there is no such port; (ports here|this computer has no serial port)"):
        connect(f"serial://{tmp_path}/ttyNONE")
    with pytest.raises(DeviceLost, match="cannot reach"):
        connect("tcp://no-such-host.invalid:7155")


def test_the_registry_lists_its_choices(monkeypatch: pytest.MonkeyPatch, server: DeviceServer) -> None:
    for wrong in ("ftp://x", "nonsense"):
        with pytest.raises(DeviceError, match=r"begins with one of .*serial:, tcp:"):
            connect(wrong)
    with pytest.raises(DeviceError, match="tcp: has no option 'speed'; it takes timeout"):
        connect(server.url, speed=3)
    assert {"tcp", "serial"} <= drivers().keys()
    monkeypatch.setitem(registry.DRIVERS._own, "mine", "ohmskin.device.wire:WireDevice")
    with pytest.raises(DeviceError, match="no transport 'mine'"):
        connect("mine:x")


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="Unix only")
def test_a_host_that_does_not_read_does_not_hang_the_server(skin: FakeSkin) -> None:
    with DeviceServer(skin, port=0, pty=True) as server:
        assert server.pty_path
        host = os.open(server.pty_path, os.O_RDWR | os.O_NOCTTY)
        try:
            os.write(host, b"\0" + encode(Hello()) * 200)
            time.sleep(0.1)
        finally:
            os.close(host)
        with connect(f"serial://{server.pty_path}") as device:
            device.scan(RIM)
