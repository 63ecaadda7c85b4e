"""The client: the newest contacts in another process, whatever happens on the other side."""

import errno
import math
import mmap
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import until

from ohmskin.client import Board, BoardReader, Client, Contacts, Patch, PatchState, PlacedContact
from ohmskin.client.board import board_path
from ohmskin.client.contacts import LARGEST, MOST_CONTACTS, merged, pack, patches_from, unpack
from ohmskin.client.remote import open_session
from ohmskin.errors import PublishError
from ohmskin.outlets.messages import encode_contacts
from ohmskin.outlets.topics import contacts_topic

PATCHES = (
    Patch("arm", "forearm_link", (0.1, 0.0, 0.05), ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))),
    Patch("hand", "palm_link"),
)


@pytest.fixture(autouse=True)
def boards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of boards of one's own."""
    folder = tmp_path / "boards"
    monkeypatch.setenv("OHMSKIN_BOARDS", str(folder))
    return folder


def touched(sequence: int = 1, count: int = 1, ago: float = 0.0) -> Contacts:
    at = time.monotonic() - ago
    seen = PatchState("arm", "forearm_link", sequence, at, time.time_ns() - round(ago * 1e9), "16O")
    contacts = [
        PlacedContact(
            k + 1, "arm", "forearm_link", (0.1, 0.2, 0.05), (0.0, 0.0, 1.0), 1e-4, 2e-4, 0.9, 0.3, 8e-3, (0.0, 0.1, 0.0)
        )
        for k in range(count)
    ]
    return merged(sequence, [seen], contacts)


@contextmanager
def half_written(message: bytes, offset: int) -> Iterator[None]:
    """Another byte so far behind the beginning of the slot, on the board `skin`, that this message stands in."""
    with board_path("skin").open("r+b") as file, mmap.mmap(file.fileno(), 0) as memory:
        at = memory.find(message) - 16 + offset  # behind number, length and checksum
        memory[at] ^= 1
        yield
        memory[at] ^= 1


def board(name: str = "skin") -> Board:
    return Board(
        name,
        {"patches": [{"name": p.name, "frame": p.frame, "position": p.position, "axes": p.axes} for p in PATCHES[:1]]},
        LARGEST,
    )


def show(writer: Board, what: Contacts) -> None:
    writer.write(pack(what, PATCHES[:1]))


# --- boards -----------------------------------------------------------------------------------------------------------

FLOOD = """
import sys, time
from ohmskin.client import Board
with Board("flood", {}, 6000) as board:
    print("ready", flush=True)
    number, end = 0, time.monotonic() + 1.5
    while time.monotonic() < end:
        number += 1
        board.write(number.to_bytes(8, "little") + bytes([number % 251]) * (number * 7 % 5900))
print(number)
"""


def test_what_is_read_while_it_is_written_is_whole_and_never_older_than_before() -> None:
    writer = subprocess.Popen([sys.executable, "-c", FLOOD], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    with writer, BoardReader("flood") as reader:
        assert writer.stdout.readline() == "ready\n"
        last, seen = 0, 0
        while writer.poll() is None:
            if (message := reader.newest()) is not None:
                number = int.from_bytes(message[:8], "little")
                assert number > last
                assert message[8:] == bytes([number % 251]) * (number * 7 % 5900)
                last, seen = number, seen + 1
        assert seen > 20
        assert int(writer.stdout.read()) >= last


@pytest.mark.parametrize(
    "offset", [0, 8, 12, 16, 40]
)  # number, length, checksum and two bytes of the message in the slot
def test_a_slot_that_is_seen_half_written_is_not_taken(offset: int) -> None:
    with board() as writer, BoardReader("skin") as reader:
        writer.write(bytes(range(100)))
        assert reader.newest() == bytes(range(100))
        writer.write(bytes(range(100, 200)))
        with half_written(bytes(range(100, 200)), offset):
            assert reader.newest() is None
        assert reader.newest() == bytes(range(100, 200))


def test_each_message_is_given_once_and_only_the_newest() -> None:
    with board() as writer, BoardReader("skin") as reader:
        assert reader.newest() is None
        for number in range(20):
            writer.write(bytes([number]))
        assert reader.newest() == bytes([19])
        assert reader.newest() is None


def test_a_reader_may_come_first_and_outlives_writers() -> None:
    with BoardReader("skin") as reader:
        assert reader.newest() is None
        assert reader.closed
        boots = set()
        for number in range(3):
            with board() as writer:
                writer.write(bytes([number]))
                assert until(reader.newest) == bytes([number])
                boots.add(reader.boot)
                assert not reader.closed
            assert reader.closed
        assert len(boots) == 3


def test_a_writer_that_was_killed_is_followed_by_another() -> None:
    code = (
        "import time\nfrom ohmskin.client import Board\nboard = Board('skin', {}, 10)\n"
        "board.write(b'first')\nprint(flush=True)\ntime.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as first, BoardReader("skin") as reader:
        assert first.stdout is not None
        first.stdout.readline()
        assert until(reader.newest) == b"first"
        first.kill()
        first.wait()
        with board() as second:
            second.write(b"second")
            assert until(reader.newest) == b"second"


def test_two_writers_of_one_name_are_told() -> None:
    with board(), pytest.raises(PublishError, match=r"another program writes 'skin' here; .*--name"):
        board()
    board().close()


@pytest.mark.parametrize("name", ["skin.asked", "torso.joints"])
def test_two_that_command_a_skin_or_send_its_joints_are_not_told_to_rename_it(name: str) -> None:
    with Board(name, {}, 100), pytest.raises(PublishError, match=f"another program writes '{name}' here") as told:
        Board(name, {}, 100)
    assert "wait until it has ended" in str(told.value)
    assert "--name" not in str(told.value)


@pytest.mark.parametrize(
    "name", ["", "../x", "a/b", "/etc/passwd", ".x", "a..b", "a.b.c.d", "x" * 33, "a\n", "a\0b", "ä", "1a"]
)
def test_no_name_leads_out_of_the_folder(name: str) -> None:
    for use in (BoardReader, board, board_path):
        with pytest.raises(PublishError, match="cannot name"):
            use(name)


def test_a_board_without_room_is_told_before_anybody_writes_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A page of shared memory that is not to be had at the first write kills the program with SIGBUS."""

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as short:
        short.setattr("os.posix_fallocate", full)
        with pytest.raises(PublishError, match="No space left on device; make room"):
            board()
    board().close()  # the name is free, and nothing is left behind
    assert [path.name for path in board_path("skin").parent.iterdir()] == [".skin.lock"]


def test_a_folder_that_cannot_be_made_gives_one_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OHMSKIN_BOARDS", "/proc/nowhere/boards")
    with pytest.raises(PublishError, match="cannot make the folder /proc/nowhere/boards"):
        Client()


def test_a_folder_that_others_may_use_is_refused(boards: Path) -> None:
    boards.mkdir(mode=0o755)
    with pytest.raises(PublishError, match="chmod 700"):
        board()
    boards.chmod(0o700)
    board().close()
    boards.rename(boards.with_name("elsewhere"))
    boards.symlink_to(boards.with_name("elsewhere"))
    with pytest.raises(PublishError, match="only you"):
        BoardReader("skin")


@given(st.data())
def test_a_damaged_board_gives_one_error_or_nothing(data: st.DataObject) -> None:
    path = board_path("damaged")
    with Board("damaged", {"patches": []}, 100) as writer:
        writer.write(b"x" * 50)
        content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.integers(0, 95))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.sampled_from([len(content), 10, 64, 200]))])
    with closing(BoardReader("damaged")) as reader:
        message, why = None, str(path)
        try:
            message = reader.newest()
        except PublishError as error:
            why = str(error)
        assert message in (None, b"x" * 50)
        assert str(path) in why


def test_a_message_that_is_too_large_is_refused() -> None:
    with Board("skin", {}, 100) as writer, pytest.raises(PublishError, match="5000 bytes"):
        writer.write(bytes(5000))
    with pytest.raises(PublishError, match="is the most"):
        Board("skin", {}, 2**30)


# --- records ----------------------------------------------------------------------------------------------------------

FLOATS = st.floats(allow_nan=False, allow_infinity=False)
TRIPLE = st.tuples(FLOATS, FLOATS, FLOATS)
COVARIANCE = st.tuples(*[FLOATS] * 6).map(lambda v: ((v[0], v[1], v[2]), (v[1], v[3], v[4]), (v[2], v[4], v[5])))
CONTACT = st.builds(
    PlacedContact,
    st.integers(-1, 2**31 - 1),
    st.just("hand"),
    st.just("palm_link"),
    TRIPLE,
    TRIPLE,
    *[FLOATS] * 4,
    st.none() | FLOATS,
    st.none() | TRIPLE,
    st.none() | COVARIANCE,
)
SIGHTINGS = st.tuples(
    *(
        st.builds(
            PatchState,
            st.just(p.name),
            st.just(p.frame),
            st.integers(0, 2**64 - 1),
            FLOATS,
            st.integers(0, 2**62),
            st.sampled_from(["16O", ""]),
            st.none() | FLOATS,
        )
        for p in PATCHES
    )
)


@given(
    st.builds(
        Contacts,
        st.integers(0, 2**64 - 1),
        FLOATS,
        st.integers(0, 2**62),
        SIGHTINGS,
        st.lists(CONTACT, max_size=5).map(tuple),
    )
)
def test_a_record_says_what_was_felt(what: Contacts) -> None:
    assert unpack(pack(what, PATCHES), PATCHES) == what


@given(st.binary(max_size=600))
def test_bytes_that_are_no_record_give_one_error(record: bytes) -> None:
    with suppress(PublishError):
        unpack(record, PATCHES)


def test_the_strongest_contacts_are_kept_when_there_are_too_many() -> None:
    contacts = tuple(
        PlacedContact(k, "arm", "x", (0, 0, 0), (0, 0, 1), 1, 1, 1, peak=-float(k)) for k in range(MOST_CONTACTS + 10)
    )
    what = Contacts(1, 0.0, 0, (PatchState("arm", "x"), PatchState("hand", "y")), contacts)
    kept = unpack(pack(what, PATCHES), PATCHES).contacts
    assert {c.id for c in kept} == set(range(10, MOST_CONTACTS + 10))
    assert len(pack(what, PATCHES)) <= LARGEST


@given(st.floats(-1, 1), st.floats(-1, 1))
def test_a_place_on_a_patch_is_as_far_from_its_origin_as_on_the_sheet(x: float, y: float) -> None:
    for patch in PATCHES:
        offset = [p - q for p, q in zip(patch.place(x, y), patch.position, strict=True)]
        along = [sum(o * a for o, a in zip(offset, axis, strict=True)) for axis in patch.axes]
        assert along == pytest.approx([x, y, 0.0], abs=1e-12)
    assert PATCHES[0].place(0.02, 0.01) == pytest.approx((0.09, 0.02, 0.05))


def test_what_was_felt_is_as_old_as_its_oldest_patch() -> None:
    now = time.monotonic()
    fresh, old, never = PatchState("a", "x", 5, now, 9), PatchState("b", "x", 5, now - 2.0, 7), PatchState("c", "x")
    assert merged(1, [fresh, old], []).stamp == 7
    assert 2.0 <= merged(1, [fresh, old], []).age < 3.0
    assert merged(1, [fresh, old, never], []).age == math.inf


@pytest.mark.parametrize(
    "setup",
    [{}, {"patches": [{}]}, {"patches": 5}, {"patches": [{"name": "a", "frame": "b", "position": 1, "axes": []}]}],
)
def test_a_setup_without_patches_is_told(setup: dict[str, Any]) -> None:
    with pytest.raises(PublishError, match="another version"):
        patches_from(setup)


# --- the client -------------------------------------------------------------------------------------------------------


def test_the_newest_is_there_at_once_again_and_with_its_age() -> None:
    with Client() as client:
        assert client.newest() is None
        assert client.wait(0.01) is None
        with board() as writer:
            show(writer, touched(3, ago=0.2))
            first = until(client.newest)
            assert (first.sequence, first.boot, len(first.contacts)) == (3, writer.boot, 1)
            assert 0.2 <= first.age < 5.0
            before = first.age
            time.sleep(0.02)
            assert first.age - before >= 0.02
            assert client.newest() is first  # nothing new: the same, older
            assert client.wait(0.01) is None
            threading.Timer(0.05, lambda: show(writer, touched(4))).start()
            assert client.wait(5.0).sequence == 4
        assert client.newest().sequence == 4  # the skin has ended: what it said last, ever older
        with board() as writer:
            show(writer, touched(1, 0))
            again = until(lambda: f if (f := client.newest()).boot != first.boot else None)
            assert (again.sequence, again.contacts) == (1, ())


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="no such signal on this system")
def test_a_stopped_skin_does_not_stop_its_reader() -> None:
    code = FLOOD.replace("1.5", "30").replace('"flood"', '"skin"')
    writer = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    with writer, BoardReader("skin") as reader:
        writer.stdout.readline()
        until(reader.newest)
        writer.send_signal(signal.SIGSTOP)  # wherever it is, be it in the middle of a slot
        for _ in range(2000):
            reader.newest()
        writer.kill()


def test_the_client_imports_nothing_heavy() -> None:
    heavy = ("numpy", "scipy", "numba", "zenoh", "asyncio")
    code = f"import sys, ohmskin.client; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


@pytest.mark.parametrize(
    "address", ["", "skin", "tcp:skin", "shm:skin@tcp/127.0.0.1:1", "shm:../skin", "shm:a b", "zenoh:a..b"]
)
def test_an_address_that_is_none_is_refused(address: str) -> None:
    with pytest.raises(PublishError, match=r"shm:NAME|cannot name"):
        Client(address)


@pytest.mark.parametrize("where", ["tcp/host", "host:7447", "udp/host:7447", "tcp/host:99999", "tcp/host:0", "tcp/:7"])
def test_a_place_where_nobody_can_be_found_over_zenoh_is_refused(where: str) -> None:
    """Nothing would ever come."""
    with pytest.raises(PublishError, match=f"zenoh cannot join '{where}'; use zenoh:NAME@tcp/HOST:PORT"):
        Client(f"zenoh:skin@{where}").close()


def test_a_place_that_is_taken_is_told_without_the_lines_of_zenohs_code() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(PublishError, match="in use") as told:
        open_session(f"tcp/127.0.0.1:{taken.getsockname()[1]}", True, None)
    assert ".rs" not in str(told.value)


def test_a_missing_extra_names_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    monkeypatch.delitem(sys.modules, "ohmskin.client.remote", raising=False)
    with pytest.raises(PublishError, match=r"pip install 'ohmskin\[zenoh\]'"):
        Client("zenoh:skin")


# --- over zenoh -------------------------------------------------------------------------------------------------------


@pytest.fixture
def place() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def subscribe(outlet: Any, client: Client, sequence: int) -> Contacts:
    """What a client hears of an outlet that keeps saying the same."""

    def say() -> Contacts | None:
        what = touched(sequence)
        outlet.send(contacts_topic("skin"), what.stamp, encode_contacts(what))
        heard = client.wait(0.02)  # on a busy machine perhaps still what was sent before
        return heard if heard is not None and heard.sequence == sequence else None

    return until(say)


def test_a_client_far_away_hears_the_same_and_again_after_a_restart(place: str) -> None:
    from ohmskin.outlets.zenoh import ZenohOutlet

    with Client(f"zenoh:skin@{place}") as client:
        assert client.newest() is None
        for sequence in (5, 6):
            with closing(ZenohOutlet(f"listen/{place}", [contacts_topic("skin")], "test", None)) as outlet:
                heard = subscribe(outlet, client, sequence)
                assert heard.sequence == sequence
                assert heard.contacts == touched().contacts
                assert heard.patches[0].mode == "16O"
                assert 0 <= heard.age < 5.0


def test_only_who_has_the_token_hears(place: str) -> None:
    from ohmskin.outlets.zenoh import ZenohOutlet

    topic = contacts_topic("skin")
    with (
        closing(ZenohOutlet(f"listen/{place}", [topic], "test", "open-sesame")) as outlet,
        Client(f"zenoh:skin@{place}", "open-sesame") as friend,
        Client(f"zenoh:skin@{place}", "open-sesamE") as stranger,
        Client(f"zenoh:skin@{place}") as nobody,
    ):
        assert subscribe(outlet, friend, 1).sequence == 1
        assert subscribe(outlet, friend, 2).sequence == 2
        assert stranger.wait(0.3) is None
        assert nobody.wait(0.3) is None


# --- the example ------------------------------------------------------------------------------------------------------


@pytest.fixture
def arm() -> Iterator["subprocess.Popen[str]"]:
    script = Path(__file__).parents[1] / "examples" / "stop_on_touch.py"
    process = subprocess.Popen(
        [sys.executable, "-W", "error", str(script)], stdout=subprocess.PIPE, text=True, env=dict(os.environ)
    )
    yield process
    process.kill()
    process.wait()
    assert process.stdout is not None
    process.stdout.close()


def test_the_arm_stops_when_touched_and_when_the_skin_falls_silent(arm: "subprocess.Popen[str]") -> None:
    assert arm.stdout is not None
    count = [0]
    what = [0]  # contacts; None: silence
    with board() as writer:

        def sense() -> None:
            while what[0] != -2:
                if what[0] >= 0:
                    count[0] += 1
                    show(writer, touched(count[0], what[0]))
                time.sleep(0.005)

        thread = threading.Thread(target=sense)
        thread.start()
        try:
            assert arm.stdout.readline() == "moving\n"
            what[0] = 1
            assert "touched at (0.1, 0.2, 0.05)" in arm.stdout.readline()
            what[0] = 0
            assert arm.stdout.readline() == "moving\n"
            what[0] = -1
            assert "the skin is silent" in arm.stdout.readline()
            what[0] = 0
            assert arm.stdout.readline() == "moving\n"
        finally:
            what[0] = -2
            thread.join()


def test_the_loop_of_the_guide_runs(capsys: pytest.CaptureFixture[str]) -> None:
    guide = (Path(__file__).parents[1] / "docs" / "guide" / "publishing.md").read_text(encoding="utf-8")
    snippet, *_ = re.findall(r"```python\n(.*?)```", guide, re.DOTALL)
    assert len(snippet.splitlines()) <= 10
    once = snippet.replace("while True:", "for _ in range(2):")
    exec(once)
    assert capsys.readouterr().out.splitlines() == ["the skin is silent: stop"] * 2
    with board() as writer:
        show(writer, touched(1, 1))
        exec(once)
    assert (
        capsys.readouterr().out.splitlines() == ["forearm_link (0.1, 0.2, 0.05) (0.0, 0.0, 1.0) None"] * 2
    )  # not calibrated
