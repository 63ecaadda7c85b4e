"""Recordings as devices: the same loop sees the same, whatever the pace, and others see what they can."""

import csv
import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import command_line
import numpy as np
import pytest
from recordings import SKIN, record_press

import ohmskin as ohm
from ohmskin.device import connect
from ohmskin.device.replay import ReplayDevice
from ohmskin.engine import State
from ohmskin.errors import DataError, DeviceError, DeviceRefused, OhmskinError, PatternError
from ohmskin.geometry import Raster
from ohmskin.mcap import RecordingReader, Role
from ohmskin.recording import Player, Recorder, recorded_skin, reimage
from ohmskin.recording.export import (
    CONTACT_COLUMNS,
    FRAME_COLUMNS,
    contact_rows,
    cycle_at,
    frame_rows,
    save_comparison,
    strongest,
    write_csv,
    write_npz,
    write_parquet,
    write_video,
)

CYCLES = 30


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[ohm.Touch]]:
    path = tmp_path_factory.mktemp("replay") / "press.mcap"
    return path, record_press(path, cycles=CYCLES)


@pytest.fixture(scope="module")
def changing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with a second calibration and a change of mode, cut in the middle of its last cycle."""
    from recordings import Bench

    path = tmp_path_factory.mktemp("changing") / "changing.mcap"
    device = Bench()
    with Recorder(path, SKIN, images=0) as recorder, ohm.Engine(lambda: recorder.tee(device), SKIN, "16I") as engine:
        recorder.watch(engine)
        engine.calibrate()
        for mode, cycles in (("16I", 5), ("16O", 6), ("", 0), ("16O", 4), ("12B", 3), ("16O", 2)):
            if not mode:
                engine.calibrate()
                continue
            engine.set_mode(mode)
            for _ in range(cycles):
                touch = engine.step()
                assert touch is not None
                recorder.publish(touch)
        engine.device.scan(engine.drive(engine.mode).next((), 0))  # the device goes before the second scan
    return path


def digest(path: Path) -> str:
    """What every image and contact of a replay comes to."""
    sums = hashlib.sha256()
    for cycle in reimage(path):
        sums.update(cycle.touch.percept.image.values.tobytes())
        sums.update(repr(cycle.touch.contacts).encode())
    return sums.hexdigest()


def test_a_replay_sees_what_the_live_loop_saw(recorded: tuple[Path, list[ohm.Touch]]) -> None:
    path, touches = recorded
    seen = list(reimage(path))
    assert [cycle.touch.sequence for cycle in seen] == [touch.sequence for touch in touches]
    raster = Raster(seen[0].known.model.mesh, 64)
    with RecordingReader(path) as reader:
        for cycle, touch, image, stored in zip(seen, touches, reader.images, reader.touches, strict=True):
            again = raster(cycle.touch.percept.image.values)
            np.testing.assert_allclose(again, image, rtol=1e-6, atol=1e-7)  # stored as float32
            np.testing.assert_allclose(
                cycle.touch.percept.image.values, touch.percept.image.values, rtol=1e-9, atol=1e-12
            )
            assert [c.id for c in cycle.touch.contacts] == [c.id for c in stored.contacts]
            for one, other in zip(cycle.touch.contacts, stored.contacts, strict=True):
                np.testing.assert_allclose(one.position, other.position, atol=1e-9)
                assert one.confidence == pytest.approx(other.confidence, abs=1e-9)
    assert any(cycle.touch.contacts for cycle in seen)


def test_tracking_replays_the_live_loop_and_the_same_bytes_however_quick_the_machine(tmp_path: Path) -> None:
    live = record_press(tmp_path / "a.mcap", "16T", cycles=CYCLES, images=0)
    first = digest(tmp_path / "a.mcap")
    for cycle, touch in zip(reimage(tmp_path / "a.mcap"), live, strict=True):
        assert [contact.id for contact in cycle.touch.contacts] == [contact.id for contact in touch.contacts]
        for one, other in zip(cycle.touch.contacts, touch.contacts, strict=True):
            np.testing.assert_allclose(one.position, other.position, rtol=0, atol=1e-9)
    assert any(touch.contacts for touch in live)
    with pytest.MonkeyPatch.context() as patch:
        slow = ReplayDevice.scan
        patch.setattr(ReplayDevice, "scan", lambda *arguments: (time.sleep(2e-3), slow(*arguments))[1])
        assert digest(tmp_path / "a.mcap") == first


def test_another_process_replays_the_same_bytes(recorded: tuple[Path, list[ohm.Touch]]) -> None:
    path, _ = recorded
    code = "import sys; sys.path[:0] = ['tests']; from test_replay import digest, Path; "
    command = [sys.executable, "-c", code + f"print(digest(Path({str(path)!r})))"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[1], check=True)
    assert done.stdout.strip() == digest(path)


def test_other_modes_and_estimators_see_what_was_recorded(recorded: tuple[Path, list[ohm.Touch]]) -> None:
    path, _ = recorded
    base = list(reimage(path, mode="12B"))
    assert len(base) == CYCLES
    assert {cycle.touch.mode.name for cycle in base} == {"12B"}
    assert all(len(cycle.touch.percept.frames) == 1 for cycle in base)
    with pytest.raises(PatternError, match="'16I' was not recorded; choose from 12B, 16O"):
        next(reimage(path, mode="16I"))
    own, other = (list(reimage(path, prior=prior)) for prior in ("", "matern"))
    assert len(own) == len(other) == CYCLES
    pressed = [k for k in range(CYCLES) if own[k].touch.contacts]
    assert len(pressed) > 10
    truth = [(0.06 + 1e-3 * k, 0.12) for k in range(CYCLES)]
    for seen in (own, other):
        middle = [k for k in pressed if CYCLES // 5 + 1 <= k < CYCLES - CYCLES // 5 - 1]
        errors = [np.linalg.norm(np.subtract(seen[k].touch.contacts[0].position, truth[k])) for k in middle]
        assert max(errors) < 0.012
    a, b = (seen[CYCLES // 2].touch.percept.image.values for seen in (own, other))
    assert np.corrcoef(a, b)[0, 1] < 0.999  # they are not the same estimator
    assert other[0].thresholds != own[0].thresholds


def test_calibrations_and_modes_change_where_they_did(changing: Path) -> None:
    seen = [cycle.touch.mode.name for cycle in reimage(changing)]
    assert seen == ["16I"] * 5 + ["16O"] * 10 + ["12B"] * 3 + ["16O"] * 2
    device = ReplayDevice(f"replay:{changing}", speed=np.inf, loop=False)
    calibrated = []
    with ohm.Engine(lambda: device, SKIN) as engine:
        player = Player(engine)
        engine.calibrate()
        learned = engine.known
        while (touch := player.step()) is not None:
            if engine.known is not learned:
                calibrated.append(touch.sequence)
                learned = engine.known
        assert calibrated == [12]
        device.seek(0.0)
        assert player.step() is not None
        assert engine.known is not learned  # back before the second calibration: the first one holds again
        assert engine.mode.name == "16I"


def test_baselines_are_learned_from_the_very_same_frames(recorded: tuple[Path, list[ohm.Touch]]) -> None:
    path, touches = recorded
    with ReplayDevice(f"replay:{path}", speed=np.inf) as device, ohm.Engine(lambda: device, SKIN) as engine:
        engine.calibrate()  # nobody told the device that the loop calibrates
        assert engine.known is not None
        assert engine.known.baseline.noise == touches[0].health.noise
        assert device.position == 0.0
        touch = engine.step()
        assert touch is not None
        assert touch.percept.frames[0].sequence == touches[0].percept.frames[0].sequence


def test_a_place_can_be_sought_and_stepped_to(recorded: tuple[Path, list[ohm.Touch]]) -> None:
    path, touches = recorded
    with ReplayDevice(f"replay:{path}", speed=np.inf, loop=False) as device, ohm.Engine(lambda: device, SKIN) as engine:
        player = Player(engine)
        engine.calibrate()

        def shown() -> int:
            touch = player.step()
            assert touch is not None
            return next(
                k for k, t in enumerate(touches) if t.percept.frames[0].sequence == touch.percept.frames[0].sequence
            )

        with RecordingReader(path) as reader:
            times = reader.times[reader.roles == Role.BASE]
        assert device.duration == pytest.approx(times[-1], abs=1.0)
        device.seek(float(times[17]))
        assert device.position == times[17]
        assert [shown(), shown()] == [17, 18]
        device.step(-5)
        assert shown() == 14
        device.step(3)
        assert shown() == 18
        device.step(-1000)
        assert shown() == 0
        device.step(1000)
        assert shown() == CYCLES - 1
        assert device.ended
        assert player.step() is None
        with pytest.raises(DeviceError, match="recording has ended"):
            device.scan(engine.drive(engine.mode).next((), 0))
        device.seek(0.0)
        assert not device.ended
        device.loop = True
        assert [shown() for _ in range(CYCLES + 2)] == [*range(CYCLES), 0, 1]
        with pytest.raises(DataError, match="the recording has 0 to"):
            device.seek(1e9)
        with pytest.raises(DataError, match="the recording has 0 to"):
            device.seek(float("nan"))


def test_pace_follows_the_speed(tmp_path: Path) -> None:
    from test_mcap import some_frames, write_frames

    write_frames(tmp_path / "a.mcap", some_frames(41)[::2])  # 21 frames, one every 10 ms
    with ReplayDevice(f"replay:{tmp_path / 'a.mcap'}", loop=False) as device:
        pattern = ohm.adjacent([range(12)])

        def seconds(speed: float) -> float:
            device.speed = speed
            device.seek(0.0)
            before = time.monotonic()
            for _ in range(21):
                device.scan(pattern)
            return time.monotonic() - before

        slow, quick, at_once = seconds(0.5), seconds(2.0), seconds(np.inf)
        assert slow >= 0.39  # 0.2 s of recording; sleep never ends early
        assert quick >= 0.09
        assert at_once < quick < slow
        with pytest.raises(PatternError, match="speed is 0"):
            device.speed = 0


def test_a_recording_is_a_device_that_cannot_be_pressed(recorded: tuple[Path, list[ohm.Touch]]) -> None:
    path, _ = recorded
    with connect(f"replay:{path}?speed=4&loop=0") as device:
        assert isinstance(device, ReplayDevice)
        assert (device.speed, device.loop) == (4.0, False)
        assert not device.capabilities.virtual
        assert recorded_skin(device) == SKIN
        with pytest.raises(DeviceRefused):
            device.press(1, (0.1, 0.1), 8e-3, 20e3)
        device.calibrating = lambda: False
        with pytest.raises(PatternError, match="its modes are 16O"):
            device.scan(ohm.opposite(range(16)))
    with pytest.raises(DeviceError, match="no setting 'pace'"):
        connect(f"replay:{path}?pace=4")
    with pytest.raises(DeviceError, match="settings are numbers"):
        connect(f"replay:{path}?speed=fast")


def test_a_replay_that_is_recorded_replays_the_same(recorded: tuple[Path, list[ohm.Touch]], tmp_path: Path) -> None:
    path, _ = recorded
    device = ReplayDevice(f"replay:{path}", speed=np.inf, loop=False)
    with Recorder(tmp_path / "b.mcap", SKIN) as recorder, ohm.Engine(lambda: recorder.tee(device), SKIN) as engine:
        recorder.watch(engine)
        player = Player(engine)
        engine.calibrate()
        while (touch := player.step()) is not None:
            recorder.publish(touch)
    assert digest(tmp_path / "b.mcap") == digest(path)


def test_a_cut_recording_replays_to_the_cut(recorded: tuple[Path, list[ohm.Touch]], tmp_path: Path) -> None:
    path, touches = recorded
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: int(0.8 * path.stat().st_size)])
    seen = list(reimage(cut))
    assert 0 < len(seen) < len(touches)
    for cycle, touch in zip(seen, touches, strict=False):
        np.testing.assert_allclose(cycle.touch.percept.image.values, touch.percept.image.values, rtol=1e-9, atol=1e-12)


def test_formats_of_others_still_replay(tank_folder: Path) -> None:
    file = sorted(tank_folder.glob("*/*.csv"))[0]
    (cycle,) = reimage(file)
    assert cycle.touch.percept.detections
    with connect(f"replay:{file}", rate=1000) as device:
        frames = [device.scan(device.reference[0].pattern) for _ in range(3)]  # round and round
    assert [frame.sequence for frame in frames] == [1, 2, 3]


def test_tables_hold_what_was_felt_and_measured(recorded: tuple[Path, list[ohm.Touch]], tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    path, touches = recorded
    with RecordingReader(path) as reader:
        count = write_csv(tmp_path / "contacts.csv", CONTACT_COLUMNS, contact_rows(reader))
        with (tmp_path / "contacts.csv").open() as file:
            rows = list(csv.DictReader(file))
        felt = [(touch, contact) for touch in touches for contact in touch.contacts]
        assert count == len(rows) == len(felt) > 10
        for row, (touch, contact) in zip(rows, felt, strict=True):
            assert (int(row["cycle"]), row["mode"], int(row["id"])) == (touch.sequence, "16O", contact.id)
            assert (float(row["x_m"]), float(row["y_m"])) == contact.position
            assert float(row["extent_m2"]) == contact.extent
            assert math.isnan(float(row["radius_m"])) == (contact.radius is None)
        assert sorted(float(row["time_s"]) for row in rows) == [float(row["time_s"]) for row in rows]
        some = list(frame_rows(reader, 0.0))
        assert len(some) == sum(frame.pattern.n_meas for touch in touches for frame in touch.percept.frames)
        count = write_parquet(tmp_path / "frames.parquet", FRAME_COLUMNS, frame_rows(reader, 0.0))
        table = pq.read_table(tmp_path / "frames.parquet").to_pydict()
        assert count == len(some)
        assert [tuple(table[name][k] for name in FRAME_COLUMNS) for k in (0, 500, len(some) - 1)] == [
            some[k] for k in (0, 500, len(some) - 1)
        ]
        write_npz(tmp_path / "all.npz", reader)
        with np.load(tmp_path / "all.npz", allow_pickle=False) as arrays:
            first = int(np.argmax(arrays["frame_role"] == Role.BASE))
            frame = touches[0].percept.frames[1]
            k = first + 1
            a, b = arrays["voltages_start"][k : k + 2]
            np.testing.assert_array_equal(arrays["voltages"][a:b], frame.voltages)
            p = arrays["frame_pattern"][k]
            a, b = arrays["pattern_measurements_start"][p : p + 2]
            np.testing.assert_array_equal(arrays["pattern_measurements"][a:b], frame.pattern.measurements)
            a, b = arrays["pattern_injections_start"][p : p + 2]
            np.testing.assert_array_equal(arrays["pattern_injections"][a:b], frame.pattern.injections)
            assert arrays["images"].shape == (CYCLES, 64, 64)
            assert arrays["frame_time_s"][0] < 0 == arrays["frame_time_s"][first]
        with pytest.raises(DataError, match="never overwritten"):
            write_npz(tmp_path / "all.npz", reader)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["all.npz", "contacts.csv", "frames.parquet"]


def test_a_recording_without_images_is_exported_without_images(tmp_path: Path) -> None:
    record_press(tmp_path / "a.mcap", "16O", 3, images=0)
    with RecordingReader(tmp_path / "a.mcap") as reader:
        shapes = write_npz(tmp_path / "a.npz", reader)
    assert shapes["images"] == (0, 0, 0)
    assert shapes["image_time_s"] == (0,)
    assert "image_x_m" not in shapes


def test_a_picture_shows_a_contact_that_other_cycles_confirm(recorded: tuple[Path, list[ohm.Touch]]) -> None:
    path, _ = recorded
    *_, touched, _, _ = (cycle for cycle in reimage(path) if cycle.touch.contacts and cycle.touch.percept.detections)
    quiet = next(iter(reimage(path)))
    assert not quiet.touch.percept.detections
    assert not quiet.touch.contacts
    alone = replace(touched, touch=replace(touched.touch, contacts=()))  # as noise makes of one cycle in thousands
    assert strongest([alone, touched, quiet]) is touched
    assert strongest([alone, quiet]) is quiet
    assert strongest([alone]) is alone


def test_pictures_and_films(
    recorded: tuple[Path, list[ohm.Touch]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, _ = recorded
    cycle = strongest(reimage(path))
    assert cycle.touch.percept.detections
    assert cycle_at(path, cycle.time).touch.percept.frames[0].sequence == cycle.touch.percept.frames[0].sequence
    save_comparison(tmp_path / "a.png", {"one": cycle, "two": cycle})
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with monkeypatch.context() as nothing:
        nothing.setenv("PATH", str(tmp_path))
        with pytest.raises(DataError, match="a video needs ffmpeg; install it"):
            write_video(tmp_path / "a.mp4", iter([cycle]))
    if shutil.which("ffmpeg") is None:
        pytest.skip("needs ffmpeg: apt-get install ffmpeg")
    count = write_video(tmp_path / "a.mp4", reimage(path), rate=20)
    probe = [
        "ffprobe",
        "-v",
        "error",
        "-count_frames",
        "-show_entries",
        "stream=nb_read_frames,codec_name,width",
        "-of",
        "json",
    ]
    told = json.loads(
        subprocess.run([*probe, str(tmp_path / "a.mp4")], capture_output=True, text=True, check=True).stdout
    )
    (stream,) = told["streams"]
    assert (int(stream["nb_read_frames"]), stream["width"]) == (count, 640)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["replay", "nosuch.mcap"], "there is no file nosuch.mcap"),
        (["replay", "press.mcap", "--speed", "0"], "--speed is 0"),
        (["replay", "press.mcap", "--start", "1e6"], "the recording has 0 to"),
        (["replay", "press.mcap", "--mode", "16I", "--headless"], "mode '16I' was not recorded; choose from 12B, 16O"),
        (
            ["replay", "press.mcap", "--compare", "paper,magic"],
            "no estimator or prior 'magic'; choose from gauss-newton",
        ),
        (["recover", "nosuch.mcap"], "cannot read recording nosuch.mcap"),
        (["recover", "text.mcap"], "does not begin as an MCAP file does"),
        (["recover", "press.mcap", "press.mcap"], "press.mcap exists and is never overwritten"),
        (["export", "press.mcap", "--to", "csv", "--output", "text.mcap"], "text.mcap exists and is never overwritten"),
        (["export", "text.mcap", "--to", "npz"], "text.mcap is not a recording of ohmskin"),
        (["export", "press.mcap", "--to", "npz", "--start", "1e6"], "--start 1e+06: the recording has 0 to"),
        (
            ["export", "press.mcap", "--to", "csv", "--mode", "12B"],
            "--mode is for --to png or mp4; leave it out",
        ),
        (["export", "press.mcap", "--to", "png", "--rate", "5"], "--rate is for --to mp4; leave it out for png"),
        (["image", "press.mcap", "--frame", "-1"], "--frame -1; it must be 0, the first cycle, or more"),
        (["record", "press.mcap"], "press.mcap exists, and a recording is never overwritten"),
        (["record", "nowhere/a.mcap"], "there is no folder"),
        (["record", "a.mcap", "--seconds", "0"], "--seconds is 0"),
        (["serve-skin", "--seed", "-1"], "--seed is -1; it must be 0 to"),
    ],
)
def test_a_mistake_gets_one_clear_line(
    recorded: tuple[Path, list[ohm.Touch]],
    tmp_path: Path,
    arguments: list[str],
    says: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from ohmskin.cli import app  # `main` makes one line of these errors, see test_cli

    shutil.copy(recorded[0], tmp_path / "press.mcap")
    (tmp_path / "text.mcap").write_text("not a recording")
    before = (tmp_path / "press.mcap").read_bytes()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OhmskinError, match=re.escape(says)) as caught:
        app(arguments)
    assert "\n" not in str(caught.value)
    assert (tmp_path / "press.mcap").read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["press.mcap", "text.mcap"]


def test_the_commands_do_what_they_say(recorded: tuple[Path, list[ohm.Touch]], tmp_path: Path) -> None:
    path, touches = recorded

    def run(*arguments: str) -> str:
        done = command_line.ohmskin(*arguments, cwd=tmp_path)
        assert (done.returncode, re.sub("[.]+\n|(compiling, once|.*; calibrating: ).*\n", "", done.stderr)) == (0, "")
        return done.stdout

    lines = [json.loads(line) for line in run("replay", str(path), "--json", "--speed", "inf").splitlines()]
    assert [line["sequence"] for line in lines] == [touch.sequence for touch in touches]
    for line, touch in zip(lines, touches, strict=True):
        places = [c.position for c in touch.contacts]
        np.testing.assert_allclose([c["position"] for c in line["contacts"]], places, atol=1e-9)
    assert "matern" in run("replay", str(path), "--compare", "paper,matern")
    assert (tmp_path / "press.compare.png").read_bytes().startswith(b"\x89PNG")
    assert "picture" in run("image", str(path), "--frame", str(CYCLES // 2))


def test_the_end_pauses_the_page_and_going_on_begins_anew(recorded: tuple[Path, list[ohm.Touch]]) -> None:
    path, _ = recorded
    device, said = ReplayDevice(f"replay:{path}", speed=np.inf, loop=False), []
    with ohm.Engine(lambda: device, SKIN) as engine:
        player = Player(engine, notify=said.append)
        engine.calibrate()
        step = player.lead(engine.step)
        assert sum(step() is not None for _ in range(CYCLES + 3)) == CYCLES
        assert (engine.state, said) == (State.PAUSED, ["the recording has ended"])
        engine.pause(False)
        assert sum(step() is not None for _ in range(CYCLES + 3)) == CYCLES
        assert engine.state is State.PAUSED


def test_contacts_and_images_have_the_times_of_their_frames_whatever_the_calendar_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import types

    stamps = iter(range(10**18, 0, -(10**12)))  # the calendar goes back at every look
    clock = types.SimpleNamespace(**vars(time) | {"time_ns": lambda: next(stamps)})
    monkeypatch.setattr("ohmskin.recording.recorder.time", clock)
    touches = record_press(tmp_path / "a.mcap")
    with RecordingReader(tmp_path / "a.mcap") as reader:
        last = {touch.percept.frames[-1].sequence: touch.sequence for touch in touches}
        times = {last[s]: t for k, t in enumerate(reader.times) if (s := reader.frames[k].sequence) in last}
        rows = list(contact_rows(reader))
        assert rows
        assert [row[0] for row in rows] == [times[row[1]] for row in rows]
        np.testing.assert_array_equal(reader.times_of(reader.images), list(times.values()))


def test_exports_obey_the_umask_and_need_no_hard_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")  # as on a USB stick

    monkeypatch.setattr("os.link", refused)
    before = os.umask(0o077)
    try:
        write_csv(tmp_path / "a.csv", ["x"], [(1,)])
    finally:
        os.umask(before)
    assert (tmp_path / "a.csv").stat().st_mode & 0o777 == 0o600
    with pytest.raises(DataError, match="never overwritten"):
        write_csv(tmp_path / "a.csv", ["x"], [(2,)])
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_parquet_takes_every_sequence_number(tmp_path: Path) -> None:
    assert write_parquet(tmp_path / "a.parquet", ["sequence", "id"], [(2**64 - 1, -1)]) == 1


def test_a_replay_uses_the_modes_that_were_recorded(tmp_path: Path) -> None:
    """Even where the skin file that is there by then says otherwise: nothing is guessed from the frames."""
    from recordings import Bench

    mine = (ohm.Mode("mine", "rotating", "fit", prior="matern", injections=3, title="Round"),)
    skin = replace(SKIN, modes=mine)
    recorder = Recorder(tmp_path / "a.mcap", skin)
    with recorder, ohm.Engine(lambda: recorder.tee(Bench(skin)), skin, "mine") as engine:
        recorder.watch(engine)
        engine.calibrate()
        engine.press(1, (0.05, 0.12), 8e-3, 20e3)
        touches = [engine.step() for _ in range(12)]
        for touch in touches:
            assert touch is not None
            recorder.publish(touch)
    seen = list(reimage(tmp_path / "a.mcap"))
    assert [cycle.touch.mode for cycle in seen] == [mine[0]] * 12
    assert [cycle.touch.contacts for cycle in seen] == [touch.contacts for touch in touches if touch]
    assert [len(cycle.touch.percept.frames) for cycle in seen] == [1] * 12


def test_a_recording_can_be_recorded_and_ends_where_it_ends(
    recorded: tuple[Path, list[ohm.Touch]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from ohmskin.cli.loop import record

    monkeypatch.setattr("signal.signal", lambda *_: None)
    record(tmp_path / "b.mcap", device=f"replay:{recorded[0]}?speed=inf&loop=0")
    with RecordingReader(tmp_path / "b.mcap") as reader:
        assert len(reader.touches) == CYCLES


def test_every_contact_that_comes_is_told_once_though_ids_begin_anew(capsys: pytest.CaptureFixture[str]) -> None:
    from types import SimpleNamespace
    from typing import Any

    from ohmskin.cli.live import _Arrivals
    from ohmskin.contacts import Contact

    arrivals: Any = _Arrivals()
    # two at once, the younger one stronger; one goes for a moment; then a calibration, after which ids count from 1
    for at, ids in ((0.0, [2, 1]), (0.1, [2, 1]), (0.2, [2]), (0.3, [2, 1]), (5.0, [1])):
        arrivals(
            SimpleNamespace(time=at, contacts=[Contact((0.0, 0.0), 1e-4, 1e-4, 1.0, 1.0, number) for number in ids])
        )
    assert re.findall(r"contact (\d)", capsys.readouterr().out) == ["2", "1", "1"]
