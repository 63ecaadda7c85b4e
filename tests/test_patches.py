"""Several skins on one robot: the body file, one stream in the robot's frames, one page."""

import http.client
import json
import math
import os
import re
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from itertools import takewhile
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import psutil
import pytest
from direct import DirectDevice
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from waiting import until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from ohmskin.body import Body
from ohmskin.body.body import PlacedSkin, axes
from ohmskin.body.patch import sense
from ohmskin.body.patches import Merger, Patches
from ohmskin.body.robot import Robot
from ohmskin.client import Board, Client, Patch, PatchState, PlacedContact
from ohmskin.client.contacts import LARGEST, merged, pack
from ohmskin.device import connect as connect_device
from ohmskin.errors import SkinError, ViewError
from ohmskin.skin import Calibration, Skin, VirtualSkin
from ohmskin.view.overview import BoardsPage, Overview

URDF = """
<robot name="r"><link name="base"/><link name="forearm"/>
<joint name="j"><parent link="base"/><child link="forearm"/></joint></robot>
"""
BODY = """
name = "torso"
urdf = "robot.urdf"

[[patch]]
name = "front"
link = "base"
position = [0.1, 0.2, 0.3]
rotation = [0.0, 1.5707963267948966, 0.0]

[[patch]]
name = "arm"
link = "forearm"
skin = "paper-rim16"
mode = "16B"
"""


@pytest.fixture(autouse=True)
def boards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of boards of one's own."""
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))


def write(folder: Path, body: str = BODY, urdf: str = URDF) -> Path:
    (folder / "robot.urdf").write_text(urdf, encoding="utf-8")
    (folder / "body.toml").write_text(body, encoding="utf-8")
    return folder / "body.toml"


# --- the body file ----------------------------------------------------------------------------------------------------


def test_a_body_is_what_its_file_says(tmp_path: Path) -> None:
    body = Body.load(write(tmp_path))
    front, arm = body.patches
    assert body.name == "torso"
    again = Body.load(write(tmp_path, BODY.replace('mode = "16B"', 'device = "replay:a.mcap?loop=0"')))
    assert (
        again.patches[1].device == f"replay:{tmp_path.resolve() / 'a.mcap'}?loop=0"
    )  # wherever the program is started
    assert (front.patch.name, front.patch.frame, front.device, front.skin.name) == (
        "front",
        "base",
        "virtual:",
        "paper",
    )
    assert (arm.patch.name, arm.patch.frame, arm.mode, arm.skin.name) == ("arm", "forearm", "16B", "paper-rim16")
    # turned a quarter about y: the sheet's x points down, its normal along the link's x
    np.testing.assert_allclose(front.patch.place(0.05, 0.12), (0.1, 0.32, 0.25), atol=1e-15)
    np.testing.assert_allclose(front.patch.normal, (1, 0, 0), atol=1e-15)


def test_the_body_of_the_guide_is_one(tmp_path: Path) -> None:
    guide = (Path(__file__).parents[1] / "docs" / "guide" / "several-skins.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```toml\n(.*?)```", guide, re.DOTALL)
    robot = URDF.replace("base", "torso_link").replace('"forearm"', '"forearm_link"').replace('"j"', '"elbow"')
    body = Body.load(write(tmp_path, example, robot))
    assert [(placed.patch.name, placed.mode) for placed in body.patches] == [("chest", ""), ("forearm", "12B")]


@given(st.tuples(*[st.floats(-6, 6)] * 3))
def test_turns_are_those_of_urdf(angles: tuple[float, float, float]) -> None:
    x, y, z = (Rotation.from_rotvec(angle * axis) for angle, axis in zip(angles, np.eye(3), strict=True))
    np.testing.assert_allclose(np.array(axes(*angles)).T, (z * y * x).as_matrix(), atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('link = "base"', 'link = "bass"', "'bass' is not in the URDF file; it has base, forearm"),
        ('link = "base"', "", "link is missing"),
        ('name = "arm"', 'name = "front"', "two patches are called 'front'"),
        ('name = "arm"', 'name = "../arm"', "letters, digits"),
        ('name = "torso"', 'name = "a/b"', "letters, digits"),
        ('name = "torso"', "name = 5", "letters, digits"),
        ("[0.1, 0.2, 0.3]", "[0.1, 0.2]", "3 numbers"),
        ("[0.1, 0.2, 0.3]", "[0.1, 0.2, nan]", "3 numbers"),
        ("[0.1, 0.2, 0.3]", "[0.1, 0.2, 1e9]", "3 numbers"),
        ("[0.1, 0.2, 0.3]", '"here"', "3 numbers"),
        ("position", "positon", "unknown entry 'positon'; choose from name, link"),
        ('urdf = "robot.urdf"', 'urdf = "nosuch.urdf"', "cannot read URDF file"),
        ('urdf = "robot.urdf"', 'urdf = "../../robot.urdf"', "outside the folder"),
        ('urdf = "robot.urdf"', "urdf = 5", "name of a file"),
        ('"paper-rim16"', '"/etc/skin.toml"', "outside the folder"),
        ('"paper-rim16"', '"../skin.toml"', "outside the folder"),
        ('"paper-rim16"', '"/etc/hostname"', "no skin named '/etc/hostname'"),
        ('mode = "16B"', 'device = "replay:../a.mcap"', "outside the folder"),
        ('mode = "16B"', 'device = "virtual:tank"', "`skin` names its skin"),
        ('"paper-rim16"', '"nosuch"', "no skin named 'nosuch'"),
        ('name = "arm"', 'name = "joints"', "name is 'joints'; it must be none of joints, links, image"),
        ('name = "arm"', 'name = "answered"', "name is 'answered'; it must be none of"),
        ('mode = "16B"', 'device = "foo:bar"', "patch 'arm': no driver for 'foo:bar'; an address begins with one of"),
        ('mode = "16B"', 'device = "tcp://nohost"', "device is 'tcp://nohost'; it must be like tcp://HOST:PORT"),
        ('mode = "16B"', 'device = "tcp://h:70000"', "device is 'tcp://h:70000'; it must be like"),
        ('mode = "16B"', 'device = "tcp://h:1?baud=9"', "device is 'tcp://h:1?baud=9'; it must be like"),
        ('mode = "16B"', 'device = "serial://"', "device is 'serial://'; it must be like"),
        ('mode = "16B"', 'device = "serial:///dev/a?baud=x"', "device is 'serial:///dev/a?baud=x'; it must be like"),
        ('"16B"', '"99Z"', "mode '99Z' is not possible"),
        ('name = "torso"', "newtons = -5", "unknown entry"),
        ("[[patch]]", "[patch]", "not valid TOML"),
        ("name =", "name ==", "not valid TOML"),
        ('name = "torso"', f"x = {'[' * 5000}{']' * 5000}", "body.toml"),
    ],
)
def test_a_wrong_body_says_what_and_where(tmp_path: Path, old: str, new: str, says: str) -> None:
    with pytest.raises(SkinError, match=re.escape(says)) as told:
        Body.load(write(tmp_path, BODY.replace(old, new, 1)))
    assert "body.toml" in str(told.value)


@pytest.mark.parametrize("port", ["serial:///dev/ttyACM0", "serial://COM3"])
def test_each_patch_has_a_serial_port_of_its_own(tmp_path: Path, port: str) -> None:
    def both(front: str, arm: str) -> Body:
        text = BODY.replace('link = "base"', f'link = "base"\ndevice = "{front}"')
        return Body.load(write(tmp_path, text.replace("mode =", f'device = "{arm}"\nmode =')))

    devices = [f"{port}?baud=115200", "tcp://[::1]:7155"]  # need not be there now
    assert [placed.device for placed in both(*devices).patches] == devices
    both(port, f"{port}1")
    with pytest.raises(SkinError, match=f"two patches have the serial port '{port.removeprefix('serial://')}'"):
        both(port, f"{port}?baud=115200")


def test_a_body_without_patches_and_one_that_is_too_large_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SkinError, match="1 to 64 tables"):
        Body.load(write(tmp_path, 'name = "x"'))
    with pytest.raises(SkinError, match="1 to 64 tables"):
        Body.load(
            write(tmp_path, 'name = "x"\n' + "".join(f'[[patch]]\nname = "p{k}"\nlink = "l"\n' for k in range(65)))
        )
    with pytest.raises(SkinError, match="more than 1048576 bytes"):
        Body.load(write(tmp_path, "#" * 2**20 + BODY))


@pytest.mark.parametrize(
    ("urdf", "says"),
    [
        ("<robot", "not valid XML"),
        ("<robot/>", "is not a URDF file"),
        ('<model><link name="a"/></model>', "is not a URDF file"),
        ('<!DOCTYPE r [<!ENTITY a "aaaa">]><robot><link name="&a;"/></robot>', "XML entities"),
        ('<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot><link name="x"/></robot>', "XML entities"),
    ],
)
def test_a_wrong_urdf_file_is_told(tmp_path: Path, urdf: str, says: str) -> None:
    (tmp_path / "r.urdf").write_text(urdf, encoding="utf-8")
    with pytest.raises(SkinError, match=re.escape(says)):
        Robot.load(tmp_path / "r.urdf")


# --- one stream of several --------------------------------------------------------------------------------------------

LEFT, RIGHT = Patch("left", "l_link", (0.0, 1.0, 0.0)), Patch("right", "r_link", (0.0, -1.0, 0.0))


def speak(board: Board, patch: Patch, sequence: int, count: int, ago: float = 0.0) -> None:
    seen = PatchState(
        patch.name, patch.frame, sequence, time.monotonic() - ago, time.time_ns() - round(1e9 * ago), "16O"
    )
    contacts = [
        PlacedContact(k + 1, patch.name, patch.frame, patch.place(0.05, 0.1), patch.normal, 1e-4, 2e-4, 0.9, 0.3)
        for k in range(count)
    ]
    board.write(pack(merged(sequence, [seen], contacts), [patch]))


def test_patches_are_felt_together_and_as_old_as_the_oldest() -> None:
    left = Board("torso.left", {"patches": [asdict(LEFT)]}, LARGEST)
    right = Board("torso.right", {"patches": [asdict(RIGHT)]}, LARGEST)
    merger = Merger("torso", [LEFT, RIGHT], ["torso.left", "torso.right"])
    with Client("shm:torso") as client:
        assert merger.step() is None
        speak(left, LEFT, 5, 1)
        assert until(merger.step).age == math.inf  # the other patch has not been heard of
        speak(right, RIGHT, 8, 2, ago=0.5)
        both = until(merger.step)
        assert merger.step() is None
        assert 0.5 <= both.age < 5.0
        assert [(seen.patch, seen.sequence) for seen in both.patches] == [("left", 5), ("right", 8)]
        assert [(c.patch, c.frame, c.id, c.position) for c in both.contacts] == [
            ("left", "l_link", 1, (0.05, 1.1, 0.0)),
            ("right", "r_link", 1, (0.05, -0.9, 0.0)),
            ("right", "r_link", 2, (0.05, -0.9, 0.0)),
        ]
        speak(left, LEFT, 6, 0)
        again = until(merger.step)
        assert again.sequence == both.sequence + 1
        assert {c.patch for c in again.contacts} == {"right"}
        assert again.time == both.time  # the right one has not spoken anew
        heard = until(client.newest)
        assert heard.contacts[0].position == (0.05, -0.9, 0.0)
        assert (heard.sequence, heard.age >= 0.5) == (again.sequence, True)
        right.close()
        right = Board("torso.right", {"patches": [asdict(RIGHT)]}, LARGEST)  # the patch's process was started anew
        speak(right, RIGHT, 1, 0)
        assert until(merger.step).contacts == ()
    for thing in (merger, left, right):
        thing.close()


def test_a_board_of_something_else_under_the_name_of_a_patch_is_passed_over() -> None:
    merger = Merger("torso", [LEFT], ["torso.left"])
    elsewhere = Patch("left", "other_link")
    for patch, heard in ((elsewhere, False), (LEFT, True)):
        with Board("torso.left", {"patches": [asdict(patch)]}, LARGEST) as board:
            speak(board, patch, 1, 1)
            time.sleep(0.1)  # a reader looks that often whether there is a new board
            assert (merger.step() is not None) == heard
    merger.close()


class Quiet:
    """A patch without a process, that speaks when it is told to."""

    given: ClassVar[list[tuple[Any, ...]]] = []

    def __init__(
        self, placed: PlacedSkin, name: str, demo: bool, images: float, news: threading.Event, report: object
    ) -> None:
        self.given.append((name, images, news))

    def poll(self) -> None:
        pass

    stop = poll

    def close(self, timeout: float) -> None:
        pass


def test_new_contacts_end_the_wait_for_them_and_images_come_as_often_as_somebody_looks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ohmskin.body.patches.PatchProcess", Quiet)
    monkeypatch.setattr("ohmskin.body.patches._WAIT", 3600.0)  # who is not told waits until the test is given up
    body = Body.load(write(tmp_path))
    front = body.patches[0].patch
    for shown, images in ((False, 10.0), (True, 30.0)):
        Quiet.given.clear()
        with Patches(body, shown=shown) as patches:
            with Board("torso.front", {"patches": [asdict(front)]}, LARGEST) as board:
                assert {every for _, every, _ in Quiet.given} == {images}

                def speak_soon(board: Board = board, news: threading.Event = Quiet.given[0][2]) -> None:
                    time.sleep(0.1)
                    speak(board, front, 1, 1)
                    news.set()

                threading.Thread(target=speak_soon).start()
                heard = until(patches.step)
            assert [contact.patch for contact in heard.contacts] == ["front"]


# --- the page ---------------------------------------------------------------------------------------------------------

RASTER = {"x0": 0.05, "y0": 0.05, "pitch": 0.1, "nx": 2, "ny": 2}


@pytest.fixture
def shown() -> Iterator[Any]:
    """Boards of two patches; the left one is touched and has an image."""
    setup = {"patches": [asdict(LEFT)], "domain": {"kind": "rectangle", "width": 0.2, "height": 0.2}, "raster": RASTER}
    setup["points"] = [number for y in (0.05, 0.15) for x in (0.05, 0.15) for number in LEFT.place(x, y)]
    left, picture = Board("torso.left", setup, LARGEST), Board("torso.left.image", setup, 100)
    merger = Merger("torso", [LEFT, RIGHT], ["torso.left", "torso.right"])
    speak(left, LEFT, 5, 1)
    merger.step()
    picture.write(struct.pack("<Qq4f", 5, 0, 0.0, math.nan, -0.2, 0.4))
    yield merger
    for thing in (merger, left, picture):
        thing.close()


def read(frame: bytes) -> tuple[dict[str, Any], np.ndarray]:
    (length,) = struct.unpack_from("<I", frame)
    return json.loads(frame[4 : 4 + length]), np.frombuffer(frame[4 + length :], np.int8)


def test_the_gallery_shows_images_and_contacts_on_their_sheets(shown: Any) -> None:
    header, pixels = read(BoardsPage("torso", ["torso.left", "torso.right"]).frame())
    left, right = header["patches"]
    assert (header["name"], left["name"], left["link"], left["mode"]) == ("torso", "left", "l_link", "16O")
    (contact,) = left["contacts"]
    assert (contact["x"], contact["y"]) == pytest.approx((0.05, 0.1))  # on the sheet
    assert contact["confidence"] == 0.9
    assert contact["in"] == [0.05, 1.1, 0.0]  # on the robot
    assert pixels.tolist() == [0, 0, -64, 127]
    assert left["peak"] == pytest.approx(0.4)
    assert left["age"] >= 0
    assert (right["name"], right["age"], right["contacts"]) == ("right", None, [])


def test_the_gallery_opens_one_patch_and_shows_a_silent_one_as_unknown(shown: Any, chromium: Any) -> None:
    with Overview("torso", ["torso.left", "torso.right"], port=0) as overview:
        page = chromium.new_page(viewport={"width": 320, "height": 700})
        page.goto(overview.url)
        cards = page.locator(".patch")
        until(lambda: "unknown: silent for" in cards.nth(0).inner_text() if cards.count() else False)
        assert "#1" not in cards.nth(0).inner_text()
        assert cards.nth(0).locator("canvas").evaluate("(canvas) => getComputedStyle(canvas).filter") == "grayscale(1)"
        assert "no data yet" in cards.nth(1).inner_text()
        assert page.locator(".skin").evaluate("(name) => name.scrollWidth <= name.clientWidth")  # all of it is shown
        boxes = [card.bounding_box() for card in cards.all()]
        assert boxes[0]["width"] == boxes[1]["width"]
        assert boxes[1]["y"] >= boxes[0]["y"] + boxes[0]["height"]  # one column on a phone
        assert page.get_by_role("img", name="Colour scale").is_visible()
        for link, visible in (("left", 1), ("All patches", 2), ("right", 1)):
            page.get_by_role("link", name=link).click()
            until(lambda visible=visible: sum(card.is_visible() for card in cards.all()) == visible)
        page.reload()  # the address names the patch
        until(lambda: [card.is_visible() for card in cards.all()] == [False, True])
        page.close()


def test_the_page_is_guarded_as_the_live_page_is(shown: Any) -> None:
    with Overview("torso", ["torso.left", "torso.right"], port=0, token="open-sesame") as page:
        port = int(re.search(r":(\d+)/", page.url)[1])  # type: ignore[index]
        channel = http.client.HTTPConnection("127.0.0.1", port, timeout=10)

        def get(path: str, **headers: str) -> http.client.HTTPResponse:
            channel.request("GET", path, headers=headers)
            response = channel.getresponse()
            response.read()
            return response

        assert get("/").status == 403
        assert get("/?token=open-sesame", Host="evil.example").status == 403
        index = get("/?token=open-sesame")
        assert index.status == 200
        assert "default-src 'none'" in index.headers["content-security-policy"]
        assert get("/static/..%2f..%2foverview.py").status == 404
        channel.close()
        where = f"ws://127.0.0.1:{port}/socket"
        for address, options in ((where, {}), (f"{where}?token=open-sesame", {"origin": "http://evil.example"})):
            with pytest.raises(InvalidStatus):
                connect(address, **options).close()
        with connect(f"{where}?token=open-sesame") as browser:
            for _ in range(3):
                assert read(browser.recv(60))[0]["name"] == "torso"  # type: ignore[arg-type]
                browser.send("drawn")
            browser.send("x" * 97)  # more than a browser has to say
            with pytest.raises(ConnectionClosed):
                list(browser)


def test_a_page_for_others_needs_a_token() -> None:
    with pytest.raises(ViewError, match="token"):
        Overview("torso", [], host="0.0.0.0")


# --- the whole --------------------------------------------------------------------------------------------------------


@pytest.fixture
def torso(tmp_path: Path) -> Iterator["subprocess.Popen[str]"]:
    body = BODY.replace('skin = "paper-rim16"\nmode = "16B"', 'mode = "12B"')
    body = body.replace('link = "base"', 'link = "base"\nmode = "12B"')
    command = [
        sys.executable,
        "-m",
        "ohmskin",
        "patches",
        str(write(tmp_path, body)),
        "--no-demo",
        "--no-browser",
        "--port",
        "0",
    ]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=dict(os.environ)
    )
    assert process.stdout is not None
    try:
        yield process
        family = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGTERM)
        rest = process.communicate(timeout=300)[0]
        assert process.returncode == 0, rest
        assert "Traceback" not in rest
        until(lambda: not any(child.is_running() and child.status() != psutil.STATUS_ZOMBIE for child in family), 10)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_robot_feels_where_it_is_touched_and_a_patch_that_dies_comes_back(
    torso: "subprocess.Popen[str]", chromium: Any
) -> None:
    assert torso.stdout is not None
    said = iter(torso.stdout.readline, "")
    assert any("shm:torso" in line for line in said)
    # what a patch tells of its own start may come before
    url = next(found for line in said if (found := re.search(r"http://\S+", line)))
    with Client("shm:torso") as robot:
        until(lambda: (newest := robot.newest()) and newest.age < 1.0)
        processes = patch_processes(torso.pid)
        assert len(processes) == 2
        front = next(process for process in processes if '"front"' in settings_of(process, robot))
        with pressed(front, 50, 120):
            there = until(lambda: (newest := robot.newest()) and newest.contacts)
            assert {(contact.patch, contact.frame) for contact in there} == {("front", "base")}
            np.testing.assert_allclose(there[0].position, (0.1, 0.32, 0.25), atol=12e-3)  # as the body file places it
            page = chromium.new_page(viewport={"width": 900, "height": 700})
            page.goto(url[0])
            until(lambda: page.evaluate("Boolean(window.ohmskin?.frame?.patches.some((p) => p.contacts.length > 0))"))
            assert page.locator(".patch").count() == 2
            page.close()
            lines = list(takewhile(lambda line: "contact" not in line, said))  # no terminal: no table, but changes
            assert {f"patch front: {state}\n" for state in ("starting", "calibrating", "running")} < {*lines}
            assert len(lines) < 12, lines
        front.kill()
        until(lambda: robot.newest().age > 1.0)  # type: ignore[union-attr]
        arm = next(seen for seen in robot.newest().patches if seen.patch == "arm")  # type: ignore[union-attr]
        assert arm.age < 1.0  # the other one goes on meanwhile
        until(lambda: robot.newest().age < 0.5)  # type: ignore[union-attr]


def test_how_far_the_calibration_of_a_patch_is_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    skin = Skin.parse("[imaging]\nmesh_size = 9e-3\n")
    monkeypatch.setattr("ohmskin.body.patch.connect", lambda *_, **__: DirectDevice(VirtualSkin(skin)))
    monkeypatch.setattr("ohmskin.engine.quiet._REPORT_EVERY", 0.0)
    told, stop = list[str](), threading.Event()

    def answer(state: str = "", message: str = "", **_: float) -> None:
        told.append(message)
        if state == "running":
            stop.set()

    patch = asdict(Patch("front", "base"))
    settings = {"device": "virtual:", "skin": skin.dump(), "mode": "12B", "patch": patch, "name": "torso.front"}
    sense({**settings, "demo": False, "images": 10.0}, answer, stop)
    assert any(re.fullmatch(r"calibrating: 50% measured, about \d+ s left", message) for message in told)


def test_a_patch_is_fitted_where_it_is_unlike_its_description(monkeypatch: pytest.MonkeyPatch) -> None:
    skin = Skin.parse("[imaging]\nmesh_size = 9e-3\n")
    places = skin.electrodes.positions + 4e-3 * (np.arange(16) >= 12)[:, None]
    crooked = replace(skin, calibration=Calibration(positions=tuple(map(tuple, places.tolist()))))
    monkeypatch.setattr("ohmskin.body.patch.connect", lambda *_, **__: DirectDevice(VirtualSkin(crooked)))
    told, stop = list[str](), threading.Event()

    def answer(state: str = "", message: str = "", **_: float) -> None:
        told.append(message)
        if not state and not message:  # a frame and its image are published
            stop.set()

    patch = asdict(Patch("front", "base"))
    settings = {"device": "tcp://front", "skin": skin.dump(), "mode": "12B", "patch": patch, "name": "torso.front"}
    sense({**settings, "demo": False, "images": 10.0}, answer, stop)
    assert any("estimating electrodes and sheet" in message for message in told)
    assert any("% of the quiet voltages unexplained before" in message for message in told)


def patch_processes(pid: int) -> list[psutil.Process]:
    return [child for child in psutil.Process(pid).children() if "ohmskin.body.patch" in child.cmdline()]


def settings_of(process: psutil.Process, robot: Client) -> str:
    """Which patch a process is: the one that falls silent while it is stopped."""
    process.suspend()
    until(lambda: robot.newest().age > 0.5)  # type: ignore[union-attr]
    silent = max(robot.newest().patches, key=lambda seen: seen.age).patch  # type: ignore[union-attr]
    process.resume()
    until(lambda: robot.newest().age < 0.5)  # type: ignore[union-attr]
    return json.dumps(silent)


@contextmanager
def pressed(process: psutil.Process, x: int, y: int) -> Iterator[None]:
    """A finger on the virtual skin of a patch (mm)."""
    (served,) = [child for child in process.children() if "serve-skin" in child.cmdline()]
    (port,) = {c.laddr.port for c in served.net_connections("inet") if c.status == psutil.CONN_LISTEN}
    with connect_device(f"tcp://127.0.0.1:{port}") as skin:
        skin.press(9, (x * 1e-3, y * 1e-3), 8e-3, 20e3)
        yield
