"""The recorder: never in the way, bounded, and next to nothing is lost whatever happens."""

import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from recordings import SKIN, Bench, record_press, some_frames
from waiting import until

import ohmskin as ohm
from ohmskin.cli.loop import open_loop
from ohmskin.cli.options import AS_THE_MODE, Stop
from ohmskin.errors import DataError, OhmskinError, PatternError
from ohmskin.mcap import RecordingReader, Role, WriterPipe, recover
from ohmskin.mcap.container import Container
from ohmskin.mcap.messages import encode_frame, encode_pattern
from ohmskin.mcap.schemas import FRAME, HEALTH, IMAGE, LOG, MARKERS, PATTERN, TOPICS, TOUCH
from ohmskin.recording import Recorder
from ohmskin.recording.export import CONTACT_COLUMNS, FRAME_COLUMNS, write_npz
from ohmskin.scan import Frame, adjacent

ABLE = {
    "n_electrodes": "16",
    "max_injections": "256",
    "max_measurements": "4096",
    "features": "2",
    "serial": "0",
    "name": "x",
}
METADATA = {"ohmskin": {"format": "1"}, "device": ABLE | dict.fromkeys(("excitation", "full_scale"), "0.0")}

FLOOD = """
import os, signal, sys, time
import numpy as np
import psutil
sys.path[:0] = ["tests"]
from recordings import SKIN, Bench
from ohmskin.recording import Recorder
from ohmskin.scan import Frame, adjacent
device = Bench()
recorder = Recorder(sys.argv[1], SKIN, images=0)
recorder.tee(device)
pattern = adjacent(SKIN.electrodes.rings)
rng = np.random.default_rng(0)
(writer,) = psutil.Process().children()
print(writer.pid, flush=True)
k = 0
while True:
    k += 1
    recorder.frame(Frame(pattern, rng.normal(size=pattern.n_meas), np.ones(pattern.n_inj), 0.0, k))
    if k == int(sys.argv[2]):  # both at once, so that nothing is handed over to a writer that is dead already
        writer.kill()
        os.kill(os.getpid(), signal.SIGKILL)
    sys.stdout.write(f"{k}\\n")
    sys.stdout.flush()
    time.sleep(1 / 500)  # not less after a delay: frames that come at once are no rate
"""


def found_when_killed_at_500_frames_a_second(path: Path, count: int) -> int:
    """Frames in the file of a program that was killed together with its writer right after frame number `count`."""
    command = [sys.executable, "-c", FLOOD, str(path), str(count)]
    ended = subprocess.run(command, stdout=subprocess.DEVNULL, cwd=Path(__file__).parents[1], timeout=300)
    assert ended.returncode == -signal.SIGKILL
    done = recover(path)
    with RecordingReader(done.path) as reader:
        numbers = [reader.frames[k].sequence for k in range(len(reader.frames))]
        assert reader.skin == SKIN.dump()
    assert numbers == list(range(1, len(numbers) + 1))
    return len(numbers)


@pytest.mark.parametrize("count", [251, 302, 353, 404])
def test_at_most_50_ms_are_lost_when_everything_is_killed_at_500_frames_a_second(tmp_path: Path, count: int) -> None:
    assert 0 <= count - found_when_killed_at_500_frames_a_second(tmp_path / "a.mcap", count) <= 25


@pytest.mark.parametrize("count", range(37, 500, 29))
def test_killed_at_other_moments_it_loses_no_more(tmp_path: Path, count: int) -> None:
    """With the four above, twenty kills."""
    assert 0 <= count - found_when_killed_at_500_frames_a_second(tmp_path / "a.mcap", count) <= 25


def test_when_only_the_loop_is_killed_the_file_is_finished(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    command = [sys.executable, "-c", FLOOD, str(path), "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[1])
    assert process.stdout is not None
    with process.stdout as lines:
        writer = int(lines.readline())
        sent = max(int(lines.readline()) for _ in range(100))
        process.kill()
        process.wait()
        rest = [int(line) for line in lines if line.endswith("\n")]
    until(lambda: not _alive(writer))
    with RecordingReader(path) as reader:
        assert reader.notes == ()
        assert len(reader.frames) >= max([sent, *rest])


def test_no_recording_is_ever_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(DataError, match="exists, and a recording is never overwritten"):
        Recorder(path, SKIN)
    with pytest.raises(DataError, match="never overwritten"):
        WriterPipe(path, METADATA, {})
    assert path.read_bytes() == b"precious"
    with pytest.raises(DataError, match=r"cannot record to .*No such file or directory; choose another"):
        WriterPipe(tmp_path / "nowhere" / "a.mcap", METADATA, {})
    with pytest.raises(DataError, match="images is -1"):
        Recorder(tmp_path / "b.mcap", SKIN, images=-1)


def test_the_loop_never_waits_for_a_writer_that_hangs_and_images_go_first(tmp_path: Path) -> None:
    pipe = WriterPipe(tmp_path / "a.mcap", METADATA, {})
    os.kill(pipe.pid, signal.SIGSTOP)
    frame = some_frames(2)[1]
    pattern, data = encode_pattern(frame.pattern), encode_frame(frame, 0, 0.0, Role.BASE, "")
    image, others = bytes(16384), {TOUCH: 0, HEALTH: 0, MARKERS: 0, LOG: 0}
    assert pipe.send(PATTERN, 0, 0, pattern)
    lost: dict[int, int] = {}
    frames = 0
    slowest = 0.0
    while lost.get(FRAME, 0) < 5:
        for topic in (IMAGE, *others, FRAME):
            before = time.monotonic()
            kept = pipe.send(topic, 0, 0, data if topic == FRAME else image)
            slowest = max(slowest, time.monotonic() - before)
            frames += kept and topic == FRAME
            if not kept:
                lost[topic] = lost.get(topic, 0) + 1
        assert pipe.waiting <= 2**24
        assert lost.get(FRAME, 0) == 0 or len(lost) == 6  # all else went before the first frame did
    counts = [lost[topic] for topic in (IMAGE, MARKERS, HEALTH, TOUCH, FRAME)]
    assert counts == sorted(counts, reverse=True)
    dropped = pipe.progress.dropped
    assert dropped["/ohmskin/frame"] == 5
    assert dropped["/ohmskin/image"] == lost[IMAGE]
    os.kill(pipe.pid, signal.SIGCONT)
    progress = pipe.close()
    assert progress.frames == frames
    with RecordingReader(tmp_path / "a.mcap") as reader:
        assert (len(reader.frames), reader.notes) == (frames, ())
    assert slowest < 1.0  # a wait would be for ever


def test_a_full_disk_stops_the_recording_and_not_the_loop(tmp_path: Path) -> None:
    """The file may not grow beyond a limit, which the system reports as it reports a full disk."""
    path = tmp_path / "a.mcap"
    pipe = WriterPipe(path, METADATA, {"skin.toml": SKIN.dump()})
    resource.prlimit(pipe.pid, resource.RLIMIT_FSIZE, (300_000, resource.RLIM_INFINITY))
    patterns, frames = set(), some_frames(1000)
    for number, frame in enumerate(frames):
        _send(pipe, patterns, frame, number)
    until(lambda: pipe.progress.trouble)
    assert "large" in pipe.progress.trouble.lower()  # EFBIG; ENOSPC takes the same way
    size = path.stat().st_size
    assert 0 < size <= 300_000
    with RecordingReader(path) as reader:
        seen = len(reader.frames)
        assert seen > 20
        assert "truncated" in reader.notes[0]
        assert "damaged" not in "".join(reader.notes)  # what is there is whole
    resource.prlimit(pipe.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    until(lambda: not pipe.progress.trouble)  # room was made: it goes on, with what was kept meanwhile
    pipe.close()
    with RecordingReader(path) as reader:
        assert reader.notes == ()
        assert [reader.frames[k].sequence for k in range(len(reader.frames))] == [frame.sequence for frame in frames]


def test_a_command_whose_recording_ends_on_a_full_disk_fails(tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"

    def record() -> None:
        with open_loop("virtual:", "", "12B", AS_THE_MODE, print, file) as loop:
            loop.engine.calibrate()
            writer = next(child for child in psutil.Process().children() if "ohmskin.mcap" in str(child.cmdline()))
            resource.prlimit(writer.pid, resource.RLIMIT_FSIZE, (50_000, resource.RLIM_INFINITY))
            loop.run(Stop(), 3.0)

    with pytest.raises(OhmskinError, match=rf"{re.escape(str(file))}: \d+ frames, .*recover.*repairs it"):
        record()
    with RecordingReader(file) as reader:
        assert len(reader.frames) > 0


def test_room_that_comes_back_is_used_bit_by_bit_and_the_frames_told_are_those_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    pipe = WriterPipe(path, METADATA, {})
    patterns: set = set()
    for number, frame in enumerate(some_frames(1000)):
        if number == 10:
            resource.prlimit(pipe.pid, resource.RLIMIT_FSIZE, (200_000, resource.RLIM_INFINITY))
        _send(pipe, patterns, frame, number)
    sizes = [0]
    for room in (200_000, 300_000, 400_000):  # never enough for all
        resource.prlimit(pipe.pid, resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
        until(lambda most=room: pipe.progress.trouble and pipe.progress.written > most - 50_000)
        sizes.append(path.stat().st_size)
        with RecordingReader(path) as reader:
            assert "damaged" not in "".join(reader.notes)
    assert sizes == sorted(set(sizes))
    progress = pipe.close()
    with RecordingReader(path) as reader:
        assert 20 < len(reader.frames) == progress.frames < 1000
    assert progress.trouble
    assert 1000 <= progress.frames + progress.dropped["all topics, by the writer"] <= 1000 + len(patterns)


def test_what_is_lost_on_a_full_disk_is_counted_and_later_frames_know_their_patterns(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    pipe = WriterPipe(path, METADATA, {})
    resource.prlimit(pipe.pid, resource.RLIMIT_FSIZE, (50_000, resource.RLIM_INFINITY))
    patterns: set = set()
    first, second = some_frames(2)
    sent = 0
    while not pipe.progress.dropped:  # until more than the writer keeps is waiting
        for _ in range(200):
            sent += 1
            _send(pipe, patterns, Frame(first.pattern, first.voltages, first.currents, 0.0, sent), sent)
        assert sent < 100_000
    sent += 1
    _send(
        pipe, patterns, Frame(second.pattern, second.voltages, second.currents, 0.0, sent), sent
    )  # its pattern comes now
    until(lambda: pipe.progress and not pipe.waiting)
    resource.prlimit(pipe.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    until(lambda: not pipe.progress.trouble)
    sent += 1
    _send(pipe, patterns, Frame(second.pattern, second.voltages, second.currents, 0.0, sent), sent)
    progress = pipe.close()
    with RecordingReader(path) as reader:
        assert reader.notes == ()
        assert len(reader.frames) == sent - progress.dropped["all topics, by the writer"]
        last = len(reader.frames) - 1
        assert reader.frames[last].sequence == sent
        assert reader.pattern(last) == second.pattern


def test_the_writer_goes_on_though_nobody_asks_how_it_goes(tmp_path: Path) -> None:
    """What it says is read while messages are sent: unread, it would fill its pipe after some minutes and hold up the
    writer."""
    pipe = WriterPipe(tmp_path / "a.mcap", METADATA, {})

    def heard() -> bool:
        pipe.send(LOG, 0, 0, b"\0\1\0\0")
        return "written" in pipe._said

    until(heard)
    pipe.close()


def test_messages_that_die_with_the_writer_are_counted_by_topic(tmp_path: Path) -> None:
    pipe = WriterPipe(tmp_path / "a.mcap", METADATA, {})
    os.kill(pipe.pid, signal.SIGKILL)
    until(lambda: pipe.progress.trouble)
    for topic in (FRAME, TOUCH, TOUCH):
        pipe.send(topic, 0, 0, b"x")
    assert pipe.close().dropped == {"/ohmskin/frame": 1, "/ohmskin/touch": 2}


def test_a_recording_of_nothing_leaves_no_file(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", SKIN) as recorder, pytest.raises(PatternError):
        ohm.Engine(lambda: recorder.tee(Bench()), SKIN, "99Z")
    assert list(tmp_path.iterdir()) == []


def test_without_images_there_are_no_markers(tmp_path: Path) -> None:
    record_press(tmp_path / "a.mcap", "12B", cycles=2, images=0)
    with RecordingReader(tmp_path / "a.mcap") as reader:
        assert write_npz(tmp_path / "a.npz", reader)["images"] == (0, 0, 0)
    with Container(tmp_path / "a.mcap") as container:
        topics = {topic for topic, *_ in container.messages()}
    assert "/ohmskin/touch" in topics
    assert not topics & {"/ohmskin/image", "/ohmskin/markers"}


def test_a_writer_that_dies_is_told_and_the_loop_goes_on(tmp_path: Path) -> None:
    device, before = Bench(), set(psutil.Process().children())  # such as a browser that serves all tests
    with Recorder(tmp_path / "a.mcap", SKIN) as recorder:
        tee = recorder.tee(device)
        pattern = adjacent([SKIN.electrodes.rings[0]])
        tee.scan(pattern)
        (writer,) = set(psutil.Process().children()) - before
        writer.kill()
        until(lambda: recorder.progress.trouble)
        for _ in range(5):
            assert tee.scan(pattern).voltages.shape == (108,)
        assert "process has ended (exit status -9)" in recorder.progress.trouble
    assert recorder.progress.dropped["/ohmskin/frame"] >= 5


def test_a_listener_hears_every_frame_of_a_device() -> None:
    heard = []
    device = Bench()
    with device:
        device.listen(heard.append)
        device.press(1, (0.05, 0.05), 8e-3, 20e3)
        frame = device.scan(adjacent([SKIN.electrodes.rings[0]]))
        assert heard == [frame]
    with pytest.raises(ohm.OhmskinError, match="closed"):
        device.scan(adjacent([SKIN.electrodes.rings[0]]))


def test_record_says_what_it_does_and_ends_cleanly(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ohmskin", "record", "a.mcap"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    assert process.stdout is not None
    for line in process.stdout:
        if "MB/s" in line:
            break
    process.send_signal(signal.SIGINT)
    rest, complaints = process.communicate(timeout=300)
    progress = r"([.]+|compiling, once.*|loading|starting the virtual skin|calibrating)\n"
    assert (process.returncode, re.sub(progress, "", complaints)) == (0, "")
    assert "a.mcap:" in rest.splitlines()[-1]
    with RecordingReader(tmp_path / "a.mcap") as reader:
        assert reader.notes == ()
        assert set(reader.modes) == {"16P"}
        assert f"a.mcap: {len(reader.frames)} frames" in rest


def test_live_records_too(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ohmskin", "live", "--json", "--seconds", "0.5", "--record", "a.mcap"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=240)  # it may compile first
    assert done.returncode == 0, done.stderr
    cycles = [json.loads(line)["sequence"] for line in done.stdout.splitlines()]
    cycles = [sequence for sequence in cycles if sequence is not None]  # but for the calibration
    with RecordingReader(tmp_path / "a.mcap") as reader:
        assert [touch.sequence for touch in reader.touches] == cycles
        assert np.count_nonzero(reader.roles == Role.BASE) == len(cycles)
    again = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert (again.returncode, again.stdout) == (2, "")
    words = "ohmskin: a.mcap exists, and a recording is never overwritten; choose another name\n"
    assert re.sub("^[.]+\n", "", again.stderr) == words


def _send(pipe: WriterPipe, patterns: set, frame: Frame, stamp: int) -> None:
    if frame.pattern not in patterns:
        patterns.add(frame.pattern)
        pipe.send(PATTERN, 0, stamp, encode_pattern(frame.pattern))
    while not pipe.send(FRAME, 0, stamp, encode_frame(frame, stamp, 0.0, Role.BASE, "")):
        time.sleep(0.01)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


GUIDE = Path(__file__).parents[1] / "docs" / "guide"


def test_the_guides_example_runs_and_its_page_shows_it(tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error", str(GUIDE / "recording.py"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "(ohmskin_msgs/msg/Frame): 1800 voltages" in done.stdout  # the first frame of calibration
    assert (tmp_path / "recording.png").read_bytes().startswith(b"\x89PNG")
    page = (GUIDE / "recording.md").read_text()
    assert f"```python\n{(GUIDE / 'recording.py').read_text()}```" in page
    for link in re.findall(r"\]\(([^)#:]+)\)", page):
        assert (GUIDE / link).exists(), link
    for topic in TOPICS:
        assert f"| `{topic}` | `{TOPICS[topic][0]}` |" in page
    for columns in (CONTACT_COLUMNS, FRAME_COLUMNS):
        assert ", ".join(f"`{name}`" for name in columns) in page
