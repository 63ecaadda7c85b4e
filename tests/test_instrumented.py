"""Newtons from what something else measures: a load cell on a line, a force sensor of ROS 2, tables."""

import csv
import os
import pty
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_line import ohmskin
from direct import DirectDevice
from waiting import until

from ohmskin.calibrate import ForceSampler, LoadCell, read_table
from ohmskin.cli.options import say
from ohmskin.client.cdr import CdrEncoder
from ohmskin.device import connect
from ohmskin.engine import Engine
from ohmskin.errors import DataError, OhmskinError, PublishError
from ohmskin.outlets.load_cell import force_of, open_load_cell
from ohmskin.outlets.outlet import open_outlet
from ohmskin.outlets.topics import Topic
from ohmskin.recording import Recorder
from ohmskin.skin import Calibration, Press, Skin, VirtualSkin

PAPER = Skin.load("paper")
FOAM = PAPER.contact_layer.foam_spread
TABLE = ((60.0, 60.0, 1.5), (140.0, 130.0, 3.0), (60.0, 140.0, 6.0), (60.0, 140.0, 2.5), (100.0, 100.0, 9.0))
WRONG = replace(PAPER, contact_layer=replace(PAPER.contact_layer, conductance=1.5 * PAPER.contact_layer.conductance))


def of_force(x: float, y: float, force: float) -> Press:
    """A press of 8 mm, x and y in mm."""
    at = (1e-3 * x, 1e-3 * y)
    return Press(at, 8e-3, force / Press(at, 8e-3, 1.0).force(FOAM))


@pytest.fixture
def line() -> Iterator[tuple[int, str]]:
    """The load cell's end of a serial line, and the name of ours."""
    ours, theirs = pty.openpty()
    yield ours, os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def test_a_line_tells_the_force_at_the_end_of_each_line_and_grows_old(line: tuple[int, str]) -> None:
    cell = LoadCell()
    assert np.isnan(cell.force)
    end = open_load_cell(f"serial://{line[1]}?baud=9600", "", cell.update)
    os.write(line[0], b"rubbish\r\nST,GS, -  12.5\n+3.25 N\r\n")
    until(lambda: cell.force == 3.25)
    os.write(line[0], b"t=17 F=-4.5e0 N")  # not ended yet
    until(lambda: np.isnan(cell.force))
    os.write(line[0], b"\n")
    until(lambda: cell.force == 4.5)
    end()


@pytest.mark.parametrize(
    ("text", "force"),
    [
        *[("12.5", 12.5), ("-3.25 N", -3.25), ("+ .5N", 0.5), ("F=12.5", 12.5), ("force: 4  N", 4.0), ("ts 7;8.", 8.0)],
        *[("ST,GS,-  12.5", -12.5), ("17, 1e-1 N", 0.1), ("F,2", 2.0)],
        *[("2,70 N", None), ("1,234.5 N", None), ("1.234,5", None), ("12.5 N/m2", None), ("12.5 N ch1", None)],
        *[("1.2.3", None), ("0x1F", None), ("0x1", None), ("F=12.5N T=23.4C", None), ("+  12.34 kg", None)],
        *[("ERROR 5", None), ("Err: 12.5 N", None), ("overload 5", None), ("1e999", None), ("", None), ("N", None)],
        *[("3-5", None), ("1'234", None), ("٣", None), ("nan", None)],
    ],
)
def test_a_line_has_a_force_only_if_it_ends_in_plain_newtons(text: str, force: float | None) -> None:
    assert force_of(text) == force


def test_lines_without_a_force_are_told_once_and_give_none(
    line: tuple[int, str], caplog: pytest.LogCaptureFixture
) -> None:
    told = list[float]()
    end = open_load_cell(f"serial://{line[1]}", "", told.append)
    os.write(line[0], b"\r\n2,70 N\r\n\r\n2,80 N\n1.5\r2.5\r" + b"x" * 300 + b" 3.5\n")
    until(lambda: len(told) == 3)
    end()
    assert told == [1.5, 2.5, 3.5]
    (record,) = caplog.records
    assert f"no force in the line '2,70 N' of {line[1]}; lines must end with a number of newtons" in record.getMessage()


@pytest.mark.parametrize("place", ["zenoh", "dds"])
def test_a_force_sensor_of_ros_is_heard(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "79")
    topic = Topic("/ft/wrench", "geometry_msgs/msg/WrenchStamped", True, 10)
    cell, where = (
        LoadCell(),
        ("zenoh:listen/tcp/127.0.0.1:7459", "zenoh:tcp/127.0.0.1:7459") if place == "zenoh" else ("dds",) * 2,
    )
    sender = open_outlet(where[0], [topic], "sensor", None)
    end = open_load_cell(where[1], "ft/wrench", cell.update)
    wrench = CdrEncoder().stamp(time.time_ns()).text("tool").put("dddddd", 0.0, 3.0, -4.0, 9.0, 9.0, 9.0).done()
    try:

        def heard() -> bool:
            sender.send(topic, time.time_ns(), wrench)
            if place == "zenoh":  # DDS sends nothing that is no message of its type
                sender.send(topic, time.time_ns(), wrench[:20])  # cut short
            return cell.force == 5.0

        until(heard)
    finally:
        end()
        sender.close()


def test_a_sensor_of_ros_may_leave_without_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "78")
    left, errors = list[Any](), list[Any]()
    monkeypatch.setattr("cyclonedds.sub.InvalidSample", lambda *told: left.append(told))
    monkeypatch.setattr("sys.unraisablehook", errors.append)  # which takes what a thread of the library's raises
    topic, cell = Topic("/ft/wrench", "geometry_msgs/msg/WrenchStamped", True, 10), LoadCell()
    wrench = CdrEncoder().stamp(time.time_ns()).text("tool").put("dddddd", 0.0, 3.0, -4.0, 9.0, 9.0, 9.0).done()
    end = open_load_cell("dds", "ft/wrench", cell.update)
    sender = open_outlet("dds", [topic], "sensor", None)
    try:

        def heard() -> bool:
            sender.send(topic, time.time_ns(), wrench)
            return cell.force == 5.0

        until(heard)
    finally:
        sender.close()
    until(lambda: left or errors)
    end()
    assert not errors


@pytest.mark.parametrize("source", ["file.txt", "serial://", "shm", "serial://a?rate=3"])
def test_a_source_that_is_none_is_refused(source: str) -> None:
    with pytest.raises(PublishError, match="serial://PORT"):
        open_load_cell(source, "", print)


def contact(number: int, x: float, strength: float = 1e-4) -> Any:
    return SimpleNamespace(id=number, position=(x, 0.1), strength=strength)


def test_samples_are_of_steady_presses_and_know_whether_they_rise() -> None:
    sampler = ForceSampler(3, settle=2, cycles=3)
    for force in (1.0, 2.0, 3.0, 4.0, 5.0, *[6.0] * 20):  # held longer than a sample needs
        sampler.add([contact(1, 0.05)], [], force)
    for force in (5.0, 4.0, *[3.0] * 6):
        sampler.add([contact(1, 0.05)], [], force)
    for _ in range(6):
        assert not sampler.add([contact(2, 0.05), contact(3, 0.15)], [], 3.0)  # whose force is it?
        assert not sampler.add([contact(2, 0.05)], [], float("nan"))
    for _ in range(6):
        assert not sampler.add([contact(5, 0.05)], [], float("inf"))
    for _ in range(6):
        sampler.add([contact(4, 0.15)], [], 3.0)
    assert sampler.done
    assert [(one.force, one.loading, peak) for one, peak in zip(sampler.samples, sampler.peaks, strict=True)] == [
        (6.0, True, 0.0),
        (3.0, False, 6.0),
        (3.0, True, 0.0),
    ]


def test_a_load_cell_calibrates_the_layer(
    line: tuple[int, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The layer is described with half as much conductance again; the cell tells what presses the true one."""

    class Finger(DirectDevice):
        """Presses one after the other, each for 48 scans, and lifts for 12; the line tells each force."""

        pressing, scans = False, 0

        def _scan(self, pattern: Any, timeout: float) -> Any:
            if self.pressing:
                turn, moment = divmod(self.scans, 60)
                press = of_force(*TABLE[turn % len(TABLE)])
                self.virtual.press(0, *press.position, press.radius, press.pressure if moment < 48 else 0.0)
                os.write(line[0], b"%.4f\n" % (press.force(FOAM) if moment < 48 else 0.0))
                self.scans += 1
            return super()._scan(pattern, timeout)

    device = Finger(VirtualSkin(PAPER, 3))
    monkeypatch.setattr("ohmskin.cli.calibrate.open_skin", lambda *_: (device, WRONG))
    quiet = Calibration(conductivity=PAPER.sheet.conductivity)
    monkeypatch.setattr("ohmskin.cli.calibrate.calibrate_quiet", lambda *_, **__: quiet)  # which takes long

    def told(text: str) -> None:
        device.pressing |= text.startswith("press anywhere with the load cell")
        say(text)

    monkeypatch.setattr("ohmskin.cli.calibrate.say", told)
    words = ["calibrate", "--force-from", f"serial://{line[1]}", "--samples", "5", "--output", "mine.toml"]
    done = ohmskin(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = Skin.load(tmp_path / "mine.toml").calibration
    assert found.layer_conductance == pytest.approx(PAPER.contact_layer.conductance, rel=0.25)
    assert found.forces[-1] == pytest.approx(9.0, rel=0.01)
    assert done.stdout.count(" of 5] ") == 5


@pytest.mark.parametrize(
    ("before", "fault", "says", "kept"),
    [
        (3, "unplugged", r"the load cell at serial://\S+ was lost: .+; check its plug", 3),
        (3, b"nan\n", r"gave no force for 1 s of pressing: there is no force in the line 'nan'; lines must end", 3),
        (0, b"hello\n", r"gave no force for 1 s of pressing: there is no force in the line 'hello'", 0),
        (3, b"5.00\n", r"told 5 N, unchanged, for 4 presses and between them; check its wire", 3),
    ],
)
def test_a_load_cell_that_fails_is_told_at_once_and_what_was_gathered_is_kept(
    before: int, fault: Any, says: str, kept: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = pty.openpty()
    port = os.ttyname(theirs)

    class Finger(DirectDevice):
        """Presses one after the other until the cell fails after some, and goes on."""

        scans, failed = -1, False

        def _scan(self, pattern: Any, timeout: float) -> Any:
            if self.scans >= 0:
                turn, moment = divmod(self.scans, 60)
                press = of_force(*TABLE[turn % len(TABLE)])
                self.virtual.press(0, *press.position, press.radius, press.pressure if moment < 48 else 0.0)
                if turn < before:
                    os.write(ours, b"%.4f\n" % (press.force(FOAM) if moment < 48 else 0.0))
                elif fault != "unplugged":
                    os.write(ours, fault)
                elif not self.failed:
                    self.failed = True
                    os.close(ours)
                time.sleep(0.01)  # at the pace of a skin
                self.scans += 1
            return super()._scan(pattern, timeout)

    device = Finger(VirtualSkin(PAPER, 3))
    monkeypatch.setattr("ohmskin.cli.calibrate._SILENT", 1.0)
    monkeypatch.setattr("ohmskin.cli.calibrate.open_skin", lambda *_: (device, PAPER))
    quiet = Calibration(conductivity=1.1 * PAPER.sheet.conductivity)
    monkeypatch.setattr("ohmskin.cli.calibrate.calibrate_quiet", lambda *_, **__: quiet)  # which takes long

    def say_and_press(text: str) -> None:
        device.scans = 0 if text.startswith("press anywhere with the load cell") else device.scans
        say(text)

    monkeypatch.setattr("ohmskin.cli.calibrate.say", say_and_press)
    done = ohmskin("calibrate", "--force-from", f"serial://{port}", "--output", "mine.toml", cwd=tmp_path)
    if not device.failed:
        os.close(ours)
    os.close(theirs)
    assert done.returncode == 2
    told = " ".join(done.stderr.split())
    assert re.search(says, told)
    found = Skin.load(tmp_path / "mine.toml").calibration
    assert found.conductivity == quiet.conductivity
    assert bool(found.forces) == bool(kept)
    presses = re.search(r"has newtons by the (\d+) presses so far", told)
    assert 2 <= int(presses[1]) <= kept if presses else "has the quiet skin alone" in told  # a late reading is too old


@pytest.mark.parametrize("source", ["serial:///dev/none", "zenoh:nowhere", "forces.csv"])
def test_a_load_cell_that_cannot_be_read_is_told_before_the_skin_is_measured(tmp_path: Path, source: str) -> None:
    done = ohmskin("calibrate", "--force-from", source, cwd=tmp_path)
    assert done.returncode == 2
    assert "measuring" not in done.stdout
    assert source.partition("//")[2] in done.stderr
    assert done.stderr.count("\n") == 1


def test_known_presses_of_a_table_are_made_and_forces_beside_a_recording_are_used(tmp_path: Path) -> None:
    (tmp_path / "presses.csv").write_text("note,x_mm,y_mm,force_N\n" + "".join(f"a,{x},{y},{f}\n" for x, y, f in TABLE))
    (tmp_path / "wrong.toml").write_text(WRONG.dump(), encoding="utf-8")
    words = ["calibrate", "--skin", "wrong.toml", "--presses", "presses.csv", "--mode", "16I", "--output", "a.toml"]
    done = ohmskin(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("in total (2.50 N)") == 1
    assert "leave 255 g in total (2.50 N) at x 60 mm, y 140 mm" in done.stdout
    assert Skin.load(tmp_path / "a.toml").calibration.forces[0] == pytest.approx(1.5)

    rows: list[tuple[float, float]] = []
    with (
        Recorder(tmp_path / "b.mcap", WRONG) as recorder,
        Engine(lambda: recorder.tee(connect("virtual:", skin=PAPER, seed=2)), WRONG, "16I") as engine,
    ):
        recorder.watch(engine)
        engine.calibrate()
        began = None
        for x, y, force in TABLE:
            press = of_force(x, y, force)
            for pressure in (press.pressure, 0.0):
                engine.press(0, press.position, press.radius, pressure)
                for _ in range(24 if pressure else 6):
                    touch = engine.step()
                    assert touch is not None
                    recorder.publish(touch)
                    began = began or touch.time
                    rows.append((touch.time - began, force if pressure else 0.0))
    with (tmp_path / "forces.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("time_s", "force_N"), *rows])
    words = [
        "calibrate",
        "--device",
        "replay:b.mcap",
        "--force-from",
        "forces.csv",
        "--output",
        "b.toml",
    ]
    done = ohmskin(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = Skin.load(tmp_path / "b.toml").calibration
    assert found.layer_conductance == pytest.approx(PAPER.contact_layer.conductance, rel=0.25)
    assert (found.mode, found.made_for, bool(found.date)) == ("16I", WRONG.digest, True)  # so that no other skin has it
    for lines, says in (
        (["1,2", "0.5,2", "2,2"], "row 2 is at 0.5 s, not after the row before; sort the rows"),
        (["5000,2", "6000,2"], "has forces from 5000 to 6000 s"),
        (["0,2", "0.1,2", "0.2,2", "0.3,2", "5000,2"], "within gaps of forces.csv, which are up to 5e+03 s long"),
    ):
        (tmp_path / "forces.csv").write_text("\n".join(["time_s,force_N", *lines]))
        done = ohmskin(*words, cwd=tmp_path)
        assert done.returncode == 2
        assert says in done.stdout + done.stderr
    done = ohmskin(*words, "--samples", "5", cwd=tmp_path)
    assert "--samples has no effect where" in done.stderr


@pytest.mark.parametrize(
    "text",
    ["", "x_mm,force_N\n1,2\n", "x_mm,y_mm,force_N\n", "x_mm,y_mm,force_N\n1,2\n", "x_mm,y_mm,force_N\n1,2,nan\n"],
)
def test_a_table_that_makes_no_sense_is_told(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(DataError, match=r"a\.csv"):
        read_table(tmp_path / "a.csv", ("x_mm", "y_mm", "force_N"))
    with pytest.raises(OhmskinError):
        read_table(tmp_path / "none.csv", ("x_mm",))


def test_a_table_of_a_spreadsheet_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes("\ufefftime_s, force_N ,note\r\n0, 1.5,ü\r\n1,2,\r\n".encode())
    assert read_table(tmp_path / "a.csv", ("time_s", "force_N")).tolist() == [[0.0, 1.5], [1.0, 2.0]]


def test_a_table_that_lacks_a_column_is_told_once(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x_mm,force_N\n1,2\n")
    with pytest.raises(DataError) as told:
        read_table(tmp_path / "a.csv", ("x_mm", "y_mm"))
    assert str(told.value) == f"{tmp_path / 'a.csv'} has no column y_mm; it needs x_mm, y_mm"
