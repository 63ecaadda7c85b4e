"""Commands to a running loop: done between two cycles, refused in words, and never by a loop that came later."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from ohmskin.client import Board, Commands
from ohmskin.device import connect
from ohmskin.engine import Engine
from ohmskin.errors import DataError, PublishError
from ohmskin.outlets.commands import CommandServer
from ohmskin.skin import Skin


@pytest.fixture(autouse=True)
def boards(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path_factory.mktemp("boards") / "own"))


@contextmanager
def looking(server: CommandServer, lost: str = "") -> Iterator[None]:
    """A loop that looks once a millisecond."""
    over = threading.Event()

    def look() -> None:
        while not over.wait(0.001):
            server.poll(lost)

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def refuse() -> None:
    raise DataError("the skin is not quiet")


def test_what_is_asked_is_done_once_and_refused_in_words() -> None:
    modes: list[str] = []
    with (
        CommandServer("arm", {"tare": refuse, "set_mode": modes.append}) as server,
        Commands("arm") as commands,
        looking(server),
    ):
        for name in ("16T", "16P"):
            commands.set_mode(name)
        with Commands("arm") as others:
            others.set_mode("12B")
        with pytest.raises(PublishError, match="not quiet"):
            commands.tare()
    assert modes == ["16T", "16P", "12B"]


def test_while_a_device_is_lost_commands_are_refused_at_once_with_the_reason() -> None:
    done: list[str] = []
    with (
        CommandServer("arm", {"set_mode": done.append}) as server,
        Commands("arm") as commands,
        looking(server, "device lost: cable"),
        pytest.raises(PublishError, match="device lost: cable"),
    ):
        commands.set_mode("16T")
    assert not done


def test_a_skin_that_is_not_there_is_told_and_obeys_nothing_later() -> None:
    done: list[str] = []
    with pytest.raises(PublishError, match="'an arm' cannot name"):
        Commands("an arm")
    with Commands("arm", timeout=0.05) as commands, pytest.raises(PublishError, match="did not answer"):
        commands.set_mode("16T")
    with CommandServer("arm", {"set_mode": done.append}) as server, Board("arm.asked", {}, 512) as board:
        board.write(b'{"until": %r, "command": ["set_mode", "16T"]}' % (time.monotonic() - 1))
        server.poll()
    assert not done


@pytest.mark.parametrize("record", [b"", b"[]", b'{"until": 1e9}', b'{"until": 1e99, "command": ["halt"]}', b"\xff"])
def test_what_is_no_command_does_not_end_the_loop(record: bytes) -> None:
    with CommandServer("arm", {"tare": refuse}) as server, Board("arm.asked", {}, 512) as board:
        board.write(record)
        server.poll()


def test_a_press_that_stays_counts_for_nothing_after_a_tare() -> None:
    skin = Skin.load("paper")
    with Engine(lambda: connect("virtual:", skin=skin, seed=1), skin, "12B") as engine:
        engine.calibrate()
        engine.press(1, (0.06, 0.12), 8e-3, 20e3)
        touches = engine.touches()
        assert any(next(touches).contacts for _ in range(10))
        with CommandServer("skin", {"tare": engine.calibrate}) as server:
            asker = threading.Thread(target=Commands("skin").tare)
            asker.start()
            while asker.is_alive():
                server.poll()
        assert not any(next(touches).contacts for _ in range(10))
