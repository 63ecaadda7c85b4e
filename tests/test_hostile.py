"""The device that misbehaves: our own host passes all its faults, and a host that does not fails by name."""

import json
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import ohmskin

from ohmskin.device import connect
from ohmskin.device.conformance import Check
from ohmskin.device.hostile import PROTOCOL_FAULTS, HostileDevice, ProtocolFault
from ohmskin.device.virtual import VirtualInstrument
from ohmskin.engine import Engine, State
from ohmskin.errors import OhmskinError
from ohmskin.scan import adjacent
from ohmskin.skin import Skin

PAPER = Skin.load("paper")
PAPER = replace(PAPER, imaging=replace(PAPER.imaging, mesh_size=9e-3))  # quick to set up
EVERY_DAY = (
    "frames of another pattern",
    "frames of nothing",
    "currents of NaN",
    "a clock at its end",
    "unsolicited replies",
    "a packet without an end",
    "payloads cut short",
    "hanging up in mid-packet",
    "an error that is not text",
    "patterns forgotten for ever",
    "another digest in the slot",
    "a name of 64 KB",
)
MOST = 2**20  # KiB that a host may take


@contextmanager
def hostile(
    faults: Mapping[str, ProtocolFault], quiet_frames: int = 200, times: int = 3, timeout: float = 60.0
) -> Iterator[tuple[str, list[Check], threading.Thread]]:
    """The address of a hostile device, the checks it has made, and the thread it works in."""
    stop, checks = threading.Event(), list[Check]()
    with HostileDevice(VirtualInstrument(PAPER, 1), port=0, quiet_frames=quiet_frames, times=times) as device:
        work = threading.Thread(target=device.check_host, args=(faults, timeout, checks.append, stop.is_set))
        work.start()
        try:
            yield device.url, checks, work
        finally:
            stop.set()
            work.join(60)


def chosen(names: tuple[str, ...]) -> dict[str, ProtocolFault]:
    return {name: PROTOCOL_FAULTS[name] for name in names}


def test_the_loop_stands_what_a_device_does_to_it() -> None:
    told: list[str] = []
    with (
        hostile(chosen(EVERY_DAY)) as (url, checks, work),
        Engine(lambda: connect(url), PAPER, "12B", told.append) as engine,
    ):
        engine.calibrate()
        while work.is_alive():
            engine.step()
        assert [(check.name, check.outcome, check.words) for check in checks] == [(n, "passed", "") for n in EVERY_DAY]
    for words in (
        "the device drove a pattern",
        "refused: ??? ? (code 10)",
        "text has",
    ):
        assert any(words in sentence for sentence in told), words
    assert max(map(len, told)) < 1000
    assert engine.state in (State.RUNNING, State.LOST)


@pytest.mark.parametrize("name", PROTOCOL_FAULTS)
def test_a_device_that_misbehaves_from_the_start_is_used_or_refused_in_one_line(name: str) -> None:
    with (
        hostile(chosen((name,)), quiet_frames=0, times=10**9) as (url, *_),
        suppress(OhmskinError),  # any other error fails
        connect(url, timeout=0.5) as device,
    ):
        device.scan(adjacent([range(12)]), timeout=0.5)


def test_live_stands_everything_in_bounded_memory(tmp_path: Path) -> None:
    """`ohmskin live --json`, as a user runs it; it reports a press when all is over."""
    skin = tmp_path / "coarse.toml"
    skin.write_text(PAPER.dump())
    command = [sys.executable, "-m", "ohmskin", "live", "--json", "--mode", "12B", "--skin", str(skin), "--device"]
    with hostile(PROTOCOL_FAULTS) as (url, checks, work):
        host = subprocess.Popen([*command, url], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            assert host.stdout is not None
            states, messages = set[str](), list[str]()
            for line in host.stdout:
                told = json.loads(line)
                states.add(told["state"])
                messages += told["messages"]
                if not work.is_alive():
                    break
            status = Path(f"/proc/{host.pid}/status").read_text()
            peak = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
        finally:
            host.terminate()
            complaints = host.communicate(timeout=300)[1]
        assert {check.name: check.words for check in checks if check.outcome != "passed"} == {}
        assert len(checks) == len(PROTOCOL_FAULTS)
    assert host.returncode == 0
    assert "Traceback" not in complaints
    assert {"running", "lost"} <= states
    assert peak < MOST
    assert "device is back" in messages
    assert not any(ord(char) < 32 and char != "\n" for message in messages for char in message)


def host_that(gives_up: Callable[[BaseException], bool], url: str, stop: threading.Event) -> None:
    """Scans, connects again after every error but those it gives up at."""
    while not stop.is_set():
        try:
            with connect(url, timeout=1.0) as device:
                while not stop.is_set():
                    device.scan(adjacent([range(12)]), timeout=1.0)
        except OhmskinError as error:
            if gives_up(error):
                stop.wait()


def test_a_host_that_gives_up_fails_by_name() -> None:
    stop, names = threading.Event(), ("frames of NaN", "a crash", "frames of another pattern")
    with hostile(chosen(names), quiet_frames=3, timeout=2.0) as (url, checks, work):
        host = threading.Thread(target=host_that, args=(lambda error: "drove a pattern" in str(error), url, stop))
        host.start()
        while len(checks) < 3:
            work.join(0.05)
        stop.set()
        host.join(60)
    assert [check.outcome for check in checks] == ["passed", "passed", "failed"]
    assert str(checks[2]) == "failed: frames of another pattern: no frame was requested within 2 s after it"


def test_an_unknown_fault_is_refused_with_the_choices() -> None:
    done = ohmskin("check-host", "--only", "dancing")
    assert done.returncode == 2
    assert "no fault 'dancing'; choose from frames of another pattern, " in done.stderr


def test_the_command_tells_what_a_host_made_of_it() -> None:
    command = [
        sys.executable,
        "-m",
        "ohmskin",
        "check-host",
        "--port",
        "0",
        "--quiet-frames",
        "3",
        "--only",
        "noise",
        "a crash",
    ]
    stop = threading.Event()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as device:
        try:
            assert device.stderr is not None
            address = next(found[0] for line in device.stderr if (found := re.search(r"tcp://[\d.]+:\d+", line)))
            host = threading.Thread(target=host_that, args=(lambda _: False, address, stop))
            host.start()
            said = device.communicate(timeout=300)[0]
        finally:
            stop.set()
            device.kill()
    assert device.returncode == 0
    host.join(60)
    assert said.splitlines() == ["passed: noise", "passed: a crash", "2 checks, 0 failed"]
