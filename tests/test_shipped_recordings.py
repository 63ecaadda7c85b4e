"""The recordings that ship, and those that a newcomer makes, show a touch at once."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import ohmskin
from matplotlib import image as pictures

from ohmskin.device.demo import demo_finger
from ohmskin.skin import Skin

FINGER = 1e3 * np.array(demo_finger(Skin.load("paper").domain, 0.0)[0])  # mm, in the first frame


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("newcomer")
    done = ohmskin("examples", cwd=path)
    assert done.returncode == 0, done.stderr
    assert "recordings/touch.mcap; try: ohmskin replay recordings/touch.mcap" in done.stdout
    return path


def places(text: str) -> np.ndarray:
    return np.array([[float(x), float(y)] for x, y in re.findall(r"\( *([\d.]+), *([\d.]+)\) mm", text)])


def colourfulness(path: Path) -> float:
    """The largest difference between the channels of a pixel of the map."""
    pixels = pictures.imread(path)[80:400, 100:480, :3]
    return float(np.ptp(pixels, axis=2).max())


def test_a_picture_of_the_table_shows_the_finger(folder: Path) -> None:
    done = ohmskin("image", "recordings/touch.csv", "--output", "table.png", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert np.linalg.norm(places(done.stdout) - FINGER, axis=1).tolist() == pytest.approx([0.0], abs=3.0)
    assert colourfulness(folder / "table.png") > 0.5


def test_pictures_of_the_session_show_the_finger(folder: Path) -> None:
    first = ohmskin("image", "recordings/touch.mcap", "--frame", "0", "--output", "first.png", cwd=folder)
    assert np.linalg.norm(places(first.stdout) - FINGER, axis=1).tolist() == pytest.approx([0.0], abs=3.0)
    strongest = ohmskin("image", "recordings/touch.mcap", "--output", "strongest.png", cwd=folder)
    assert len(places(strongest.stdout)) == 1


def test_the_session_is_felt_all_along(folder: Path) -> None:
    done = ohmskin("replay", "recordings/touch.mcap", "--json", "--speed", "inf", cwd=folder)
    frames = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(frames) == 40
    assert [len(frame["contacts"]) for frame in frames[2:]] == [1] * 38  # reported once confirmed


def test_what_is_there_stays(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "touch.csv").write_text("mine")
    assert ohmskin("examples", cwd=tmp_path).returncode == 0
    assert (tmp_path / "recordings" / "touch.csv").read_text() == "mine"
    assert (tmp_path / "recordings" / "touch.mcap").read_bytes() == (folder / "recordings/touch.mcap").read_bytes()


def test_a_quiet_picture_says_so_and_stays_pale(folder: Path) -> None:
    text = (folder / "recordings" / "touch.csv").read_text()
    (folder / "quiet.csv").write_text(re.sub("quiet 10", "last", text))  # a frame that nothing touched
    done = ohmskin("image", "quiet.csv", "--output", "quiet.png", cwd=folder)
    assert re.search(r"^no contact; noise \+-[\d.]+ %$", done.stdout, re.MULTILINE)
    assert colourfulness(folder / "quiet.png") < 0.3


@pytest.mark.parametrize("demo", [True, False])
def test_a_newcomers_recording_has_a_touch(demo: bool, tmp_path: Path) -> None:
    options = ["--mode", "12B", "--seconds", "2", *([] if demo else ["--no-demo"])]
    done = ohmskin("record", "mine.mcap", *options, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert ("demonstration finger" in done.stdout) == demo
    seen = ohmskin("image", "mine.mcap", "--output", "mine.png", cwd=tmp_path).stdout
    assert bool(len(places(seen))) == demo
    assert ("no contact; noise" in seen) != demo
