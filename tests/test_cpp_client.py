"""The client of control loops in C++, `ohmskin.hpp`: it reads what Python wrote, by the same rules."""

import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from test_client import FLOOD, PATCHES, half_written, until

from ohmskin.client import Board, Contacts, Patch, PatchState, PlacedContact
from ohmskin.client.board import board_path
from ohmskin.client.contacts import LARGEST, merged, pack
from ohmskin.client.fields import as_number, numbers

ROOT = Path(__file__).parents[1]
TURNED = ((1.0, 0.1, 0.2), (0.1, 2.0, 0.3), (0.2, 0.3, 3.0))
LIGHT = PlacedContact(7, "arm", "forearm_link", (0.1, -0.2, 0.05), (0.0, 0.6, 0.8), 1e-4, 2e-4, 0.9, -0.3)
FULL = PlacedContact(
    *(-1, "hand", "palm \"left\" \\ ü/漢", (1 / 3, 1e-300, -5e15), (0.0, 0.0, 1.0), 1e-4, 2e-4, 0.5, 0.25, 8e-3),
    *((0.01, -0.02, 0.03), TURNED, 5.5, 0.4, 2e4, 2.5e-4, True),
)  # fmt: skip
SKIN = (replace(PATCHES[0], newtons=True), Patch("hand", FULL.frame))


@pytest.fixture(autouse=True)
def boards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of boards of one's own."""
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))
    return tmp_path / "boards"


def compiled(source: Path, program: Path) -> Path:
    """A program, as the guide says to compile one; any warning is an error."""
    told = subprocess.run([sys.executable, "-m", "ohmskin.client"], capture_output=True, text=True, check=True)
    warnings = ["-Wall", "-Wextra", "-Wshadow", "-Wsign-conversion", "-Werror", "-pedantic"]
    command = ["g++", "-std=c++17", "-O2", *warnings, f"-I{told.stdout.strip()}", str(source), "-o", str(program)]
    subprocess.run(command, check=True, timeout=240)
    return program


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(Path(__file__).with_name("shm_reader.cpp"), tmp_path_factory.mktemp("cpp") / "reader")


class Reader:
    """What a client in C++ says when it is asked."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process

    def __call__(self, command: str = "newest") -> dict[str, list[list[str]]]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()
        rows: dict[str, list[list[str]]] = {"felt": [], "patch": [], "seen": [], "contact": [], "error": []}
        while (line := self._process.stdout.readline().rstrip("\n")) != ".":
            if line:
                kind, *values = line.split("\t")
                rows[kind].append(values)
        return rows

    def age(self) -> float:
        """Of the newest, as it says (s)."""
        return float.fromhex(self()["felt"][0][5])


@contextmanager
def listening(program: Path, name: str = "skin") -> Iterator[Reader]:
    with subprocess.Popen(
        [str(program), "client", name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield Reader(process)
        finally:
            process.kill()


def board(patches: tuple[Patch, ...] = SKIN) -> Board:
    return Board(
        "skin", {"skin": "x", "domain": {"a": [[], None, -1.5e-3]}, "patches": [*map(asdict, patches)]}, LARGEST
    )


def touch(sequence: int, *contacts: PlacedContact, ago: float = 0.0) -> Contacts:
    now, stamp = time.monotonic() - ago, time.time_ns()
    seen = [
        PatchState(p.name, p.frame, sequence, now, stamp, *told)
        for p, told in zip(SKIN, (("16O", 7.5), ("a" * 16, None)), strict=True)
    ]
    return merged(sequence, seen, contacts)


def test_every_value_that_python_wrote_is_read(reader: Path) -> None:
    with listening(reader) as ask:
        assert not any(ask().values())
        with board() as writer:
            for sequence, contacts in enumerate(((), (LIGHT,), (FULL, LIGHT), (replace(FULL, self_touch=False),)), 1):
                what = touch(sequence, *contacts)
                writer.write(pack(what, SKIN))
                told = until(lambda: t if (t := ask("wait 0.1"))["felt"] else None)
                number, boot, stamp, allocations, at, age = told["felt"][0]
                assert (int(number), int(boot), int(stamp)) == (sequence, writer.boot, what.stamp)
                assert float.fromhex(at) == what.time
                assert 0 <= float.fromhex(age) < 10
                assert (int(allocations) == 0) == (sequence > 1)  # none but at the first look at a board
                for patch, row in zip(SKIN, told["patch"], strict=True):
                    assert row[:2] == [patch.name, patch.frame]
                    values = [patch.newtons, *patch.position, *(v for axis in patch.axes for v in axis)]
                    assert [float.fromhex(v) for v in row[2:]] == values
                for seen, row in zip(what.patches, told["seen"], strict=True):
                    assert row[:3] == [seen.patch, seen.frame, seen.mode]
                    assert (float.fromhex(row[3]), *map(int, row[4:6])) == (seen.time, seen.sequence, seen.stamp)
                    assert float.fromhex(row[6]) == pytest.approx(as_number(seen.total_force), rel=0, nan_ok=True)
                assert len(told["contact"]) == len(contacts)
                for contact, row in zip(contacts, told["contact"], strict=True):
                    assert row[:2] == [contact.patch, contact.frame]
                    told_numbers = [float.fromhex(value) for value in row[2:]]
                    assert told_numbers == pytest.approx(numbers(contact, 3), rel=0, abs=0, nan_ok=True)


@pytest.mark.parametrize(
    ("escaped", "meant"),
    [
        (json.dumps('\n\t\x01\r\b\f"\\/\x7fü漢😀', ensure_ascii=False), r"\x0a\x09\x01\x0d\x08\x0c" + '"\\/\x7fü漢😀'),
        (json.dumps("ä漢😀\x00"), r"ä漢😀\x00"),
        (r'"\/\u00E9"', "/é"),
        (r'"\u12g4"', None),
        (r'"\ud83d"', None),
        (r'"\x41"', None),
    ],
)
def test_names_are_decoded_from_json(reader: Path, escaped: str, meant: str | None) -> None:
    letters = b'"' + b"x" * (len(escaped.encode()) - 2) + b'"'
    patches = (replace(SKIN[0], frame=letters[1:-1].decode()),)
    with board(patches) as writer, listening(reader) as ask:
        with board_path("skin").open("r+b") as file:
            at = file.read().index(letters)
            file.seek(at)
            file.write(escaped.encode())
        writer.write(pack(replace(touch(1), patches=touch(1).patches[:1]), patches))
        told = ask("wait 10")
        assert (told["patch"][0][1] if meant else told["error"][0][0][:9]) == (meant or "the setup")


def test_what_is_read_while_it_is_written_is_whole_and_never_older_than_before(reader: Path) -> None:
    writer = subprocess.Popen([sys.executable, "-c", FLOOD], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    with writer:
        assert writer.stdout.readline() == "ready\n"
        listener = subprocess.run([str(reader), "flood", "flood"], stdout=subprocess.PIPE, text=True, timeout=300)
        assert listener.returncode == 0, "1: older than before or of another length; 2: torn"
        last, seen = map(int, listener.stdout.split())
        assert seen > 20
        assert int(writer.stdout.read()) >= last


@pytest.mark.parametrize("offset", [0, 8, 12, 16, 40])  # number, length, checksum and two bytes of the message
def test_a_slot_that_is_seen_half_written_is_not_taken(reader: Path, offset: int) -> None:
    with board() as writer, listening(reader) as ask:
        writer.write(pack(touch(1), SKIN))
        assert ask()["felt"][0][0] == "1"
        writer.write(second := pack(touch(2, LIGHT), SKIN))
        with half_written(second, offset):
            assert ask()["felt"][0][0] == "1"  # the one before, ever older
        assert ask()["felt"][0][0] == "2"


def test_a_silent_skin_grows_old_and_one_that_starts_anew_is_followed(reader: Path) -> None:
    code = (
        "import sys, time\nfrom ohmskin.client import Board\nfrom test_cpp_client import *\n"
        "writer = board()\nwriter.write(pack(touch(9, LIGHT, ago=2.0), SKIN))\nprint(flush=True)\ntime.sleep(60)"
    )
    with (
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, cwd=Path(__file__).parent) as first,
        listening(reader) as ask,
    ):
        assert first.stdout is not None
        first.stdout.readline()
        assert until(lambda: ask()["felt"])[0][0] == "9"
        first.kill()  # in whatever it did
        first.wait()
        assert ask.age() >= 2.0
        assert ask("wait 0.01")["felt"] == []  # nothing new
        before = ask.age()
        time.sleep(0.02)
        assert ask.age() - before >= 0.02
        assert ask()["contact"][0][:2] == ["arm", "forearm_link"]
        with board(PATCHES[1:]) as second:
            what = touch(1, replace(FULL, frame="palm_link"))
            second.write(pack(replace(what, patches=what.patches[1:]), PATCHES[1:]))
            told = ask("wait 10")
            assert told["felt"][0][:2] == ["1", str(second.boot)]
            assert told["contact"][0][:2] == ["hand", "palm_link"]
            assert [row[0] for row in told["patch"]] == ["hand"]


def test_a_board_of_another_version_is_told_once_and_clearly(reader: Path) -> None:
    with board() as writer, listening(reader) as ask:
        writer.write(pack(replace(touch(1), patches=touch(1).patches[:1]), SKIN))  # of one patch, where two were told
        assert "is its writer of another version?" in until(lambda: ask()["error"])[0][0]
    path = board_path("skin")
    for offset, value in ((7, b"3"), (16, b"\x09"), (24, b"\xff\xff\xff\xff\xff\xff\xff\xff"), (56, b"\xff\xff")):
        with board() as writer:
            content = bytearray(path.read_bytes())
        content[offset : offset + len(value)] = value
        path.write_bytes(content)
        with listening(reader) as ask:
            told = ask()
            assert told["felt"] == []
            assert str(path) in told["error"][0][0]
            assert "python -m ohmskin.client" in told["error"][0][0]
        path.unlink()
    for setup in ({}, {"patches": [{"name": "a", "frame": "b", "position": [1, 2], "axes": 5}]}):
        with Board("skin", setup, LARGEST) as writer, listening(reader) as ask:
            writer.write(pack(touch(1), SKIN))
            assert "of another version" in ask()["error"][0][0]


@pytest.mark.parametrize("name", ["", "../x", "/etc/passwd", ".x", "a\n", "1a", "_a", "x" * 99])
def test_no_name_leads_out_of_the_folder(reader: Path, name: str) -> None:
    done = subprocess.run([str(reader), "client", name], capture_output=True, text=True, timeout=300, input="newest\n")
    assert done.returncode == 3
    assert "cannot name what a skin publishes" in done.stdout


def test_a_folder_that_others_may_use_is_refused(reader: Path, boards: Path) -> None:
    boards.mkdir(mode=0o755)
    with listening(reader) as ask:
        assert "chmod 700" in ask()["error"][0][0]


def test_the_loop_of_the_guide_compiles_and_runs(tmp_path: Path) -> None:
    guide = (ROOT / "docs" / "guide" / "publishing.md").read_text(encoding="utf-8")
    (snippet,) = re.findall(r"```cpp\n(.*?)```", guide, re.DOTALL)
    assert len(snippet.splitlines()) <= 20
    (tmp_path / "loop.cpp").write_text(snippet.replace("while (true)", "for (int i = 0; i < 2; ++i)"))
    program = compiled(tmp_path / "loop.cpp", tmp_path / "loop")

    def lines() -> list[Any]:
        return subprocess.run(
            [str(program)], capture_output=True, text=True, timeout=300, check=True
        ).stdout.splitlines()

    assert lines() == ["the skin is silent: stop"] * 2
    with board() as writer:
        writer.write(pack(touch(1, LIGHT, replace(LIGHT, force=2.5)), SKIN))
        assert lines() == ["forearm_link 0.1 nan", "forearm_link 0.1 2.5"] * 2
        writer.write(pack(touch(2, LIGHT, ago=1.0), SKIN))
        assert lines() == ["the skin is silent: stop"] * 2
