"""The plug-in of LeRobot: found by its name, contacts as a state vector, images as a camera. LeRobot itself need not be
there: with it, one test more is found here (pip install lerobot integrations/lerobot)."""

import importlib
import importlib.util
import runpy
import subprocess
import sys
import time
import tomllib
import zipfile
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_client import PATCHES, touched, until

from ohmskin.client import Board
from ohmskin.client.contacts import LARGEST, pack
from ohmskin.client.points import point_names
from ohmskin.errors import PublishError
from ohmskin.geometry import Raster
from ohmskin.outlets.picture import Picture
from ohmskin.skin import Skin

PACKAGE = Path(__file__).parents[1] / "integrations" / "lerobot"
NAME = "lerobot_robot_ohmskin"


@pytest.fixture(autouse=True)
def boards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of boards of one's own."""
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))


@pytest.fixture(scope="module")
def observe() -> Any:
    """The part that needs nothing of LeRobot."""
    described = importlib.util.spec_from_file_location("observe", PACKAGE / NAME / "observe.py")
    assert described is not None
    assert described.loader is not None
    module = importlib.util.module_from_spec(described)
    described.loader.exec_module(module)
    return module


@pytest.fixture
def board() -> Iterator[Board]:
    with Board("skin", {"patches": [asdict(PATCHES[0])]}, LARGEST) as board:
        yield board


@pytest.fixture
def pictures() -> Iterator[Board]:
    raster = Raster(Skin.load("paper").mesh(), 64)
    with Board("skin.image", Picture.setup(raster), Picture.size(raster)) as board:
        yield board


def test_lerobot_finds_the_package_by_its_name(tmp_path: Path) -> None:
    """LeRobot imports distributions by name: it must begin so, and be that of the module, underscores and all."""
    pytest.importorskip("hatchling")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=PACKAGE, check=True, capture_output=True, timeout=300)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (name for name in names if name.endswith("METADATA"))
        told = archive.read(metadata).decode()
    assert f"\nName: {NAME}\n" in told
    assert f"{NAME}/__init__.py" in names
    told_here = tomllib.loads((PACKAGE / "pyproject.toml").read_text(encoding="utf-8"))
    assert told_here["project"]["name"] == NAME


def test_contacts_are_named_numbers_and_silence_is_no_observation(observe: Any, board: Board) -> None:
    contacts = observe.Contacts("skin", 2, 0.5)
    with pytest.raises(TimeoutError, match="has not been heard of; is `ohmskin live"):
        contacts.read()
    felt = touched(1)
    board.write(pack(replace(felt, contacts=(replace(felt.contacts[0], force=3.5),)), PATCHES[:1]))
    told = until(lambda: _quietly(contacts.read))
    assert list(told) == point_names(2)
    assert [*told.values()] == [1.0, 0.1, 0.2, 0.05, 2e-4, 3.5] + [0.0] * 6
    board.write(pack(touched(2, 0), PATCHES[:1]))
    assert set(contacts.read().values()) == {0.0}  # not touched
    board.write(pack(touched(3, 1, ago=2.0), PATCHES[:1]))
    with pytest.raises(TimeoutError, match="has been silent for 2"):
        contacts.read()
    contacts.close()


def _quietly(read: Any) -> Any:
    try:
        return read()
    except TimeoutError:
        return None


def test_an_image_is_red_where_it_is_pressed(observe: Any, pictures: Board) -> None:
    pixels = np.full((64, 64), np.nan)
    pixels[3, 10], pixels[60, 20], pixels[5, 5] = 0.15, -0.6, 0.0  # rows from the bottom
    pictures.write(Picture.pack(pixels, 7, time.time_ns()))
    camera = observe.Pictures("skin", (64, 64), 0.3)
    image = camera.wait(5.0)
    assert image.dtype == np.uint8
    assert image[60, 10].tolist() == [127, 0, 0]
    assert image[3, 20].tolist() == [0, 0, 255]
    assert image.sum() == 127 + 255
    assert camera.latest(5.0) is image
    with pytest.raises(TimeoutError, match="no image of skin 'skin' within"):
        camera.wait(0.02)
    time.sleep(0.02)
    with pytest.raises(TimeoutError, match="is older than"):
        camera.latest(0.01)
    other = observe.Pictures("skin", (32, 32), 0.3)
    with pytest.raises(ValueError, match="64 x 64 pixels; set width and height so"):
        other.wait(5.0)
    for one in (camera, other):
        one.close()


class Part:
    """A robot or a camera of LeRobot's.

    Args:
        fails: Whether it cannot be connected.
    """

    def __init__(self, fails: bool = False) -> None:
        self.is_connected, self._fails = False, fails

    def connect(self, *_: Any) -> None:
        self.is_connected = True
        if self._fails:
            raise TimeoutError("silent")

    def disconnect(self) -> None:
        self.is_connected = False


@pytest.fixture
def made(observe: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Makes the robot of the plug-in from a robot and cameras, with stand-ins for what it uses of LeRobot."""
    parts: dict[str, dict[str, Any]] = {
        "draccus": {"decode": lambda _, value: value},
        "lerobot.cameras.utils": {"make_cameras_from_configs": lambda cameras: cameras},
        "lerobot.robots.config": {"RobotConfig": object},
        "lerobot.robots.robot": {"Robot": type("Robot", (), {"__init__": lambda *_: None})},
        "lerobot.robots.utils": {"make_robot_from_config": lambda robot: robot},
        f"{NAME}.config": {"OhmskinRobotConfig": object},
        f"{NAME}.observe": vars(observe),
    }
    for name, members in parts.items():
        module = ModuleType(name)
        vars(module).update(members)
        for parent in (name.rsplit(".", depth)[0] for depth in range(1, name.count(".") + 1)):
            monkeypatch.setitem(sys.modules, parent, ModuleType(parent))
        monkeypatch.setitem(sys.modules, name, module)
    robot = runpy.run_path(str(PACKAGE / NAME / "robot.py"))["OhmskinRobot"]
    return lambda **settings: robot(SimpleNamespace(skin="skin", contacts=2, max_age=0.5, **settings))


@pytest.mark.parametrize("broken", ["robot", "camera", "contacts"])
def test_a_robot_that_cannot_be_connected_is_left_disconnected(made: Any, broken: str) -> None:
    arm, cameras = Part(broken == "robot"), {"a": Part(), "b": Part(broken == "camera")}
    robot = made(robot=arm, cameras=cameras)
    if broken == "contacts":
        robot.config.skin = "no name"
    with pytest.raises(PublishError if broken == "contacts" else TimeoutError):
        robot.connect()
    assert not any(part.is_connected for part in (robot, arm, *cameras.values()))


def test_a_robot_whose_skin_is_silent_is_not_connected(made: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = made(robot=Part(), cameras={})
    monkeypatch.setitem(robot.connect.__globals__, "FIRST", 0.1)
    with pytest.raises(TimeoutError, match="'skin' has not been heard of; is `ohmskin live --publish shm --name skin`"):
        robot.connect()
    assert not robot.is_connected
    assert not robot.robot.is_connected


@pytest.mark.parametrize(("missing", "told"), [("lerobot", "'lerobot>=0.4.4'"), ("torch", "torch")])
def test_what_is_not_installed_is_named_with_the_line_that_installs_it(
    missing: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Finder:
        def find_spec(self, name: str, *_: Any) -> None:
            if name.startswith("lerobot."):
                raise ModuleNotFoundError(f"No module named {missing!r}", name=missing)

    monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])
    monkeypatch.syspath_prepend(PACKAGE)
    for name in [name for name in sys.modules if name.partition(".")[0] in ("lerobot", NAME)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "lerobot", ModuleType("lerobot"))
    vars(sys.modules["lerobot"])["__path__"] = []
    with pytest.raises(ModuleNotFoundError, match=f"needs the package '{missing}': pip install {told}$"):
        importlib.import_module(NAME)


def test_a_robot_that_is_connected_stays_so_when_it_is_connected_again(made: Any, board: Board) -> None:
    robot = made(robot=Part(), cameras={})
    board.write(pack(touched(1), PATCHES[:1]))
    robot.connect()
    with pytest.raises(ConnectionError, match=r"call disconnect\(\) first"):
        robot.connect()
    assert robot.is_connected
    robot.disconnect()
    assert not robot.robot.is_connected


if importlib.util.find_spec("lerobot") is not None:

    def test_lerobot_takes_robot_and_camera(board: Board, pictures: Board) -> None:
        from lerobot.cameras.configs import CameraConfig
        from lerobot.robots.config import RobotConfig
        from lerobot.robots.utils import make_robot_from_config
        from lerobot.utils.import_utils import register_third_party_plugins

        register_third_party_plugins()
        camera = CameraConfig.get_choice_class("ohmskin")()
        robot = make_robot_from_config(RobotConfig.get_choice_class("ohmskin")(contacts=2, cameras={"skin": camera}))
        board.write(pack(touched(1), PATCHES[:1]))
        pictures.write(Picture.pack(np.zeros((64, 64)), 1, time.time_ns()))
        with robot:
            observed = robot.get_observation()
            assert set(observed) == set(robot.observation_features)
            assert observed["skin"].shape == robot.observation_features["skin"] == (64, 64, 3)
            assert observed["contact_0.x"] == 0.1
        assert not robot.is_connected
