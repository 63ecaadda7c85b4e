"""Things that go wrong while it runs, with real processes: the loop goes on without a restart, and says what
happened."""

import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

import pytest
from live_process import serving

from ohmskin.device import connect
from ohmskin.engine import Engine, State, Touch
from ohmskin.errors import DeviceLost, ProtocolError
from ohmskin.skin import Skin

PAPER = replace(
    Skin.load("paper"), imaging=replace(Skin.load("paper").imaging, mesh_size=9e-3)
)  # the host's: quick to set up


class Line:
    """A line between host and device that can be cut, plugged in again, stalled and spoilt."""

    def __init__(self, device: str) -> None:
        self._device = device.removeprefix("tcp://").split(":")
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0.05)
        self.url = f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"
        self.plugged, self.flowing = threading.Event(), threading.Event()
        self.plugged.set()
        self.flowing.set()
        self.spoil: Callable[[bytes], bytes] = bytes
        self._ends: list[socket.socket] = []
        self._stop = threading.Event()
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def unplug(self) -> None:
        self.plugged.clear()
        for end in self._ends:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._stop.set()
        self.unplug()
        self.flowing.set()
        for thread in self._threads:
            thread.join(60)
        for end in [*self._ends, self._listener]:
            end.close()

    def _accept(self) -> None:
        while not self._stop.is_set():
            try:
                host = self._listener.accept()[0]
            except TimeoutError:
                continue
            if not self.plugged.is_set():
                host.close()
                continue
            device = socket.create_connection((self._device[0], int(self._device[1])))
            self._ends += [host, device]
            for pair in ((host, device), (device, host)):
                self._threads.append(threading.Thread(target=self._pump, args=pair))
                self._threads[-1].start()

    def _pump(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                self.flowing.wait()
                target.sendall(self.spoil(data))
        for end in (source, target):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """The address and the process of a virtual skin that serves one test after the other."""
    with serving("--seed", "1") as device:
        yield device


@pytest.fixture
def line(served: tuple[str, "subprocess.Popen[str]"]) -> Iterator[Line]:
    line = Line(served[0])
    try:
        yield line
    finally:
        line.close()


@contextmanager
def running(url: str) -> Iterator[tuple[Engine, list[str]]]:
    """A calibrated loop in the mode 12B, and what it has said."""
    told: list[str] = []
    with Engine(lambda: connect(url), PAPER, "12B", told.append) as engine:
        engine.calibrate()
        assert cycles(engine, 5)
        yield engine, told


def cycles(engine: Engine, count: int, seconds: float = 120.0) -> list[Touch]:
    """The next `count` cycles, however long the loop has to seek its device."""
    end, seen = time.monotonic() + seconds, []
    while len(seen) < count:
        if (touch := engine.step()) is not None:
            seen.append(touch)
        assert time.monotonic() < end, (engine.state, engine.message)
    return seen


def until_lost(engine: Engine, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while engine.state is not State.LOST:
        engine.step()
        assert time.monotonic() < end


def feels(engine: Engine) -> bool:
    engine.press(1, (0.06, 0.13), 8e-3, 20e3)
    touch = cycles(engine, 12)[-1]
    engine.press(1, (0.06, 0.13), 8e-3, 0.0)
    cycles(engine, 12)
    return any(abs(c.position[0] - 0.06) < 15e-3 and abs(c.position[1] - 0.13) < 15e-3 for c in touch.contacts)


def test_a_cable_pulled_and_plugged_in_again(line: Line) -> None:
    with running(line.url) as (engine, told):
        before = cycles(engine, 1)[0].sequence
        line.unplug()
        until_lost(engine)
        assert told[-1].startswith("device lost: ")
        assert told[-1].endswith("; reconnecting")
        assert "connect again" not in told[-1]  # the loop does that itself
        assert "Errno" not in told[-1]
        line.plugged.set()
        assert cycles(engine, 3)[0].sequence == before + 1
        assert told[-1] == "device is back"
        assert feels(engine)


def test_a_serial_port_that_goes_and_comes_back(tmp_path: "object") -> None:
    link = f"{tmp_path}/skin"  # as udev would name it, whatever number the port gets

    def plug(stack: list) -> None:  # type: ignore[type-arg]
        serving_now = serving("--seed", "1", "--pty")
        address, process = serving_now.__enter__()
        stack.append((serving_now, process))
        with suppress(FileNotFoundError):
            os.unlink(link)
        os.symlink(address.removeprefix("serial://"), link)

    ports: list = []  # type: ignore[type-arg]
    plug(ports)
    try:
        with running(f"serial://{link}") as (engine, told):
            ports[0][0].__exit__(None, None, None)
            until_lost(engine)
            assert any("device lost" in text for text in told)
            plug(ports)
            assert cycles(engine, 3)
            assert "device is back" in told
            assert feels(engine)
    finally:
        ports[-1][0].__exit__(None, None, None)


def test_a_device_reset_in_mid_scan_is_asked_again() -> None:
    """The server process is killed while scans run, and started anew on the same port."""

    def serve(port: str) -> "subprocess.Popen[str]":
        command = [sys.executable, "-m", "ohmskin", "serve-skin", "--seed", "1", "--port", port]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    server = serve("0")
    try:
        assert server.stdout is not None
        found = re.search(r"tcp://\S+:(\d+)", server.stdout.readline())
        assert found
        with running(found[0]) as (engine, told):
            threading.Timer(0.02, server.kill).start()
            until_lost(engine)
            server.wait()
            server.stdout.close()
            server = serve(found[1])
            assert cycles(engine, 3)
            assert told[-1] == "device is back"
            assert feels(engine)
    finally:
        server.kill()
        server.wait()
        assert server.stdout is not None
        server.stdout.close()


def test_one_byte_in_a_hundred_spoilt_gives_no_wrong_touch(line: Line) -> None:
    with running(line.url) as (engine, _):
        dice = random.Random(4)
        line.spoil = lambda data: bytes(dice.randrange(256) if dice.random() < 0.01 else byte for byte in data)
        # a frame of 480 bytes comes through whole once in a hundred times; small ones do, so the loop may lose the
        # device
        spoilt = time.monotonic() + 3
        seen = []
        while time.monotonic() < spoilt:
            touch = engine.step()
            seen += [touch] if touch is not None else []
        line.spoil = bytes
        after = cycles(engine, 5)
        assert all(not touch.contacts for touch in seen + after)  # nothing spoilt was taken for a touch
        assert after[-1].health.dropped > 0  # and it is counted
        assert feels(engine)


def test_a_stalled_device_is_lost_and_found(served: tuple[str, "subprocess.Popen[str]"]) -> None:
    address, process = served
    with running(address) as (engine, told):
        os.kill(process.pid, signal.SIGSTOP)
        try:
            until_lost(engine)
            assert any("did not answer in" in text for text in told)
            start = time.monotonic()
            while time.monotonic() < start + 1:
                assert engine.step() is None  # no frame is made up meanwhile
        finally:
            os.kill(process.pid, signal.SIGCONT)
        assert cycles(engine, 3)
        assert told[-1] == "device is back"
        assert feels(engine)


def test_a_line_that_stalls_for_a_moment_loses_no_cycle(line: Line) -> None:
    with running(line.url) as (engine, told):
        before = cycles(engine, 1)[0].sequence
        line.flowing.clear()
        threading.Timer(0.4, line.flowing.set).start()
        assert cycles(engine, 3)[0].sequence == before + 1
        assert not any("lost" in text for text in told)
        assert cycles(engine, 1)[0].health.dropped > 0


def test_a_host_that_was_suspended_goes_on(served: tuple[str, "subprocess.Popen[str]"]) -> None:
    command = [sys.executable, "-m", "ohmskin", "live", "--json", "--mode", "12B", "--device", served[0]]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as host:
        assert host.stdout is not None
        try:
            first = None
            while first is None:  # while it calibrates
                first = json.loads(host.stdout.readline())["sequence"]
            os.kill(host.pid, signal.SIGSTOP)
            time.sleep(3)  # longer than any time limit of the driver
            os.kill(host.pid, signal.SIGCONT)
            lines = [json.loads(host.stdout.readline()) for _ in range(1000)]
        finally:
            os.kill(host.pid, signal.SIGCONT)
            host.terminate()
            rest = host.communicate(timeout=300)
        assert host.returncode == 0, rest[1]
    assert not [line["messages"] for line in lines if line["state"] != "running"]
    assert lines[-1]["sequence"] == first + 1000
    assert not any(frame["contacts"] for frame in lines)


@pytest.mark.parametrize("during", ["calibrating", "running"])
def test_json_says_that_the_device_is_lost_and_back(line: Line, during: str) -> None:
    command = [sys.executable, "-m", "ohmskin", "live", "--json", "--mode", "12B", "--device", line.url]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as host:
        assert host.stdout is not None
        try:
            told = [json.loads(host.stdout.readline())]
            while told[-1]["state"] != during:
                told.append(json.loads(host.stdout.readline()))
            line.unplug()
            while told[-1]["state"] != "lost":
                told.append(json.loads(host.stdout.readline()))
            assert (told[-1]["sequence"], told[-1]["contacts"]) == (None, [])
            assert "device lost" in " ".join(told[-1]["messages"])
            line.plugged.set()
            while told[-1]["state"] != "running":
                told.append(json.loads(host.stdout.readline()))
        finally:
            host.terminate()
            host.communicate(timeout=300)
    assert (told[0]["state"], told[0]["sequence"]) == ("calibrating", None)
    assert any("calibrating" in text for text in told[0]["messages"])
    assert "device is back" in [text for one in told for text in one["messages"]]
    assert told[-1]["sequence"] is not None


@pytest.mark.parametrize("version", [0, 2])
def test_another_protocol_version_ends_it_with_advice(version: int) -> None:
    import zlib

    from cobs import cobs

    from ohmskin.device.protocol import PacketDecoder

    def answer(listener: socket.socket) -> None:
        host = listener.accept()[0]
        decoder = PacketDecoder()
        with host, suppress(OSError):
            while data := host.recv(65536):
                for packet in decoder.feed(data):
                    body = bytes([version, 0xFF]) + packet.sequence.to_bytes(2, "little") + b"\x01\0no"
                    host.sendall(cobs.encode(body + zlib.crc32(body).to_bytes(4, "little")) + b"\0")

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=answer, args=(listener,))
        thread.start()
        url = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        with pytest.raises(ProtocolError, match=f"speaks protocol {version}, this host 1; update"):
            Engine(lambda: connect(url), PAPER)
        thread.join(60)
    with pytest.raises(DeviceLost):
        Engine(lambda: connect(url), PAPER)
