"""The page of a body: skins coloured in space, arrows, and a finger that presses where the pointer is."""

import json
import re
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_accessible import SCREENS, violations
from waiting import until

from ohmskin.body import Body
from ohmskin.body.body import PlacedSkin
from ohmskin.body.patches import Merger
from ohmskin.body.robot import Robot
from ohmskin.client import Board, Client, PatchState, PlacedContact
from ohmskin.client.contacts import LARGEST, merged, pack
from ohmskin.device.server import DeviceServer
from ohmskin.device.virtual import twin_capabilities
from ohmskin.geometry import Raster
from ohmskin.outlets.picture import Picture
from ohmskin.outlets.publisher import describe_domain
from ohmskin.view.overview import BoardsPage, Overview

EXAMPLE = Path(__file__).parents[1] / "examples" / "body" / "body.toml"


@pytest.fixture(autouse=True)
def boards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of boards of one's own."""
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))


# --- what the page is told --------------------------------------------------------------------------------------------


class Published:
    """One patch that is not really there: its boards, which a test writes, and a virtual skin that notes presses."""

    def __init__(self, placed: PlacedSkin, board: str, stack: ExitStack) -> None:
        skin, self.patch = placed.skin, placed.patch
        self.chart, self.raster = skin.chart, Raster(skin.mesh(), 64)
        self.capabilities = twin_capabilities(skin, "noted", 0.0)
        self.presses: list[tuple[float, ...]] = []
        told = {"patches": [asdict(self.patch)], "domain": describe_domain(skin)}
        about = told | Picture.setup(self.raster) | Picture.in_space(self.raster, self.chart, self.patch)
        self._felt = stack.enter_context(Board(board, told, LARGEST))
        self._image = stack.enter_context(Board(f"{board}.image", about, Picture.size(self.raster)))
        served = stack.enter_context(DeviceServer(self, port=0))
        stack.enter_context(address := Board(f"{board}.device", {}, 256))
        address.write(served.url.encode())
        self._sequence = 0

    def scan(self, pattern: Any) -> Any:
        raise NotImplementedError

    def press(self, number: int, x: float, y: float, radius: float, pressure: float) -> None:
        self.presses.append((x, y, radius, pressure))

    def at(self, place: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        """A place on the map in the patch's frame, and the normal there."""
        axes = np.array(self.patch.axes)
        point = np.array(self.patch.position) + self.chart.points([place])[0] @ axes
        return point, self.chart.frames([place])[0, 2] @ axes

    def speak(self, *places: tuple[float, float], ago: float = 0.0, confidence: float = 0.9, **known: Any) -> None:
        """Tell of contacts at places of the map, of which this is known, with an image that has a bump at each."""
        self._sequence += 1
        seen = PatchState(
            self.patch.name, self.patch.frame, self._sequence, time.monotonic() - ago, time.time_ns(), "16P"
        )
        contacts = [
            PlacedContact(
                *(k + 1, self.patch.name, self.patch.frame),
                *(tuple(part.tolist()) for part in self.at(place)),
                *(1e-4, 2e-4, confidence, 0.3),
                **known,
            )
            for k, place in enumerate(places)
        ]
        centres = np.stack(np.meshgrid(self.raster.x, self.raster.y), axis=-1)
        image = sum((0.8 * np.exp(-(((centres - place) / 0.012) ** 2).sum(axis=-1)) for place in places), 0.0)
        image = np.where(self.raster.inside, image, np.nan)
        self._felt.write(pack(merged(self._sequence, [seen], contacts), [self.patch]))
        self._image.write(Picture.pack(image, self._sequence, 0))


@pytest.fixture
def half() -> Iterator[tuple[Body, dict[str, Published], Merger]]:
    """The example: two sleeves and a dome, of which tests say what they feel."""
    body = Body.load(EXAMPLE)
    with ExitStack() as stack:
        names = [f"half.{placed.patch.name}" for placed in body.patches]
        patches = {
            placed.patch.name: Published(placed, name, stack) for placed, name in zip(body.patches, names, strict=True)
        }
        merger = stack.enter_context(Merger("half", [placed.patch for placed in body.patches], names))
        yield body, patches, merger


def page_of(body: Body) -> BoardsPage:
    assert body.robot is not None
    return BoardsPage(body.name, [f"half.{placed.patch.name}" for placed in body.patches], body.robot.as_json())


def header(frame: bytes) -> dict[str, Any]:
    (length,) = struct.unpack_from("<I", frame)
    found: dict[str, Any] = json.loads(frame[4 : 4 + length])
    return found


def test_shapes_are_told_once_and_what_is_off_the_skin_is_cut_out(half: Any) -> None:
    body, patches, merger = half
    for patch in patches.values():
        patch.speak()
    page, told = page_of(body), {}
    assert not any("points" in patch for patch in header(page.frame({}))["patches"])  # nor is it known on which link
    merger.step()
    first = header(page.frame(told))
    assert set(first["robot"]["links"]) == {"torso", "head", "upper_arm", "forearm"}
    assert [patch["virtual"] for patch in first["patches"]] == [True] * 3
    sleeve, _, dome = (patch["points"] for patch in first["patches"])
    assert all(np.hypot(x, y) == pytest.approx(0.045, abs=1e-4) for x, y, _ in sleeve)
    assert [point is not None for point in dome] == patches["head"].raster.inside.ravel().tolist()
    assert all(np.linalg.norm(point) == pytest.approx(0.1, abs=1e-4) for point in dome if point)
    again = header(page.frame(told))
    assert "robot" not in again
    assert not any("points" in patch for patch in again["patches"])
    assert "robot" in header(page.frame({}))  # another browser


@pytest.mark.parametrize("place", [(0.1, 0.07), (0.282, 0.02), (0.001, 0.13)])
def test_a_pressed_point_is_found_on_the_map(half: Any, place: tuple[float, float]) -> None:
    body, patches, merger = half
    patches["forearm"].speak()
    merger.step()
    page = page_of(body)
    page.frame({})
    x, y, z = patches["forearm"].at(place)[0]
    address, found = page.pressed(f"1 {x:.5f} {y:.5f} {z:.5f}")
    assert address.startswith("tcp://127.0.0.1:")
    assert np.abs(np.subtract(found, place)).max() < 0.5e-3
    assert page.pressed("drawn") is None
    assert page.pressed("0 0 0 0") is None  # a patch that has shown nothing yet


@pytest.mark.parametrize("answer", ["", "x", "9 0 0 0", "-1 0 0 0", "0 0 0", "0 0 0 nan", "0 0 0 1e99", "0 0 0 0 0"])
def test_a_browser_that_talks_nonsense_is_refused(half: Any, answer: str) -> None:
    page = page_of(half[0])
    with pytest.raises(ValueError, match=r".*"):
        page.pressed(answer)


# --- in a browser -----------------------------------------------------------------------------------------------------


def pixel(page: Any, robot: Robot, felt: Published, inner: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """The place on a patch's map that faces the camera most, and where that is on the page (px)."""
    camera = np.array(page.evaluate("ohmskin.body.camera.position.toArray()"))
    x0, y0, x1, y1 = felt.chart.domain.bounds
    places = [(x0 + share * (x1 - x0), y0 + inner * (y1 - y0)) for share in np.linspace(0.02, 0.98, 97)]
    pose = robot.links[felt.patch.frame]

    def faces(place: tuple[float, float]) -> float:
        point, normal = felt.at(place)
        out, away = pose[:3, :3] @ normal, camera - (pose[:3, :3] @ point + pose[:3, 3])
        return float(out @ away / np.linalg.norm(away))

    place = max(places, key=faces)
    at = page.evaluate("([link, at]) => ohmskin.body.place(link, at)", [felt.patch.frame, felt.at(place)[0].tolist()])
    box = page.locator("#space").bounding_box()
    return place, (box["x"] + at["x"], box["y"] + at["y"])


def test_a_finger_on_the_page_presses_where_it_points_and_contacts_are_arrows(half: Any, chromium: Any) -> None:
    body, patches, merger = half
    forearm, head, boards = patches["forearm"], patches["head"], [f"half.{p.patch.name}" for p in body.patches]
    with Overview("half", boards, port=0, robot=body.robot.as_json()) as overview:
        page = chromium.new_page(viewport={"width": 900, "height": 600})
        page.goto(overview.url)
        felt: dict[str, Any] = {}

        def there(true: str) -> Any:
            """Whether something is so, while all speak but the head."""
            patches["upper_arm"].speak()
            forearm.speak(*felt.get("places", ()), **felt.get("known", {}))
            merger.step()
            return page.evaluate(true)

        head.speak((0.0, 0.0))
        until(lambda: there("Boolean(window.ohmskin?.body) && ohmskin.body.skins.filter(Boolean).length === 3"))
        labels = "[...document.querySelectorAll('#labels button:not([hidden])')].map((line) => line.textContent)"
        until(lambda: there(f"{labels}.some((text) => text.startsWith('head\\nsilent for'))"))
        drawn = "(({clientWidth: w, clientHeight: h}) => Math.abs(ohmskin.body.camera.aspect - w / h) < 1e-6)(space)"
        until(lambda: there(drawn))  # as large as its place on the page
        colours = "new Set(ohmskin.body.skins[{}].words).size"
        assert there(colours.format(2)) == 1  # one grey: what it felt is not known any more
        assert there(f"{labels}.filter((text) => text.startsWith('#')).length") == 0

        place, at = pixel(page, body.robot, forearm, 0.3)
        page.mouse.move(*at)
        page.mouse.down()
        until(lambda: there("true") and forearm.presses)
        assert np.linalg.norm(np.subtract(forearm.presses[-1][:2], place)) < 2e-3
        assert forearm.presses[-1][3] == 20e3
        other, at = pixel(page, body.robot, forearm, 0.6)
        page.mouse.move(*at)
        until(lambda: there("true") and np.linalg.norm(np.subtract(forearm.presses[-1][:2], other)) < 2e-3)
        page.mouse.up()
        until(lambda: there("true") and forearm.presses[-1][3] == 0.0)  # it has hung up
        assert not patches["upper_arm"].presses
        assert not head.presses

        shape = (
            "import('./static/body.js').then((own) => own.triangles([1, 1, 1, 1, null, 1, 1, 1, 1], 3, 3, {}).length)"
        )
        assert [page.evaluate(shape.format(closed)) for closed in ("false", "true")] == [4, 8]  # a hole in the middle

        camera, count = page.evaluate("ohmskin.body.camera.position.toArray()"), len(forearm.presses)
        box = page.locator("#space").bounding_box()
        page.mouse.move(box["x"] + 30, box["y"] + 30)
        page.mouse.down()
        page.mouse.move(box["x"] + 90, box["y"] + 60, steps=4)
        page.mouse.up()
        turned = "ohmskin.body.camera.position.toArray()"
        until(lambda: np.abs(np.subtract(there(turned), camera)).max() > 0.05)
        assert len(forearm.presses) == count

        felt["places"] = [place]
        until(lambda: there(f"{labels}.includes('#1 · uncalibrated')"))
        until(lambda: there(f"{colours.format(1)} > 20"))
        until(lambda: there("!document.getElementById('fixed').hidden && document.getElementById('newtons').hidden"))
        felt["known"] = {"force": 7.34, "force_std": 0.2}
        until(lambda: there(f"{labels}.includes('#1 · 7.3 ±0.2 N')"))
        felt["known"]["confidence"] = 0.6
        until(lambda: there(f"{labels}.includes('#1 · 7.3 ±0.2 N · 60 % sure')"))
        until(lambda: "mm · 7.3 ±0.2 N · 60 % sure" in there("document.querySelectorAll('.told')[1].textContent"))
        del felt["known"]["confidence"]
        (arrow,) = [a for a in there("ohmskin.body.arrows.map((a) => [a.position.toArray(), a.shaft.scale.z])") if a]
        np.testing.assert_allclose(arrow[0], forearm.at(place)[0], atol=1e-4)
        assert arrow[1] == pytest.approx(7.34 * 0.02 - 0.022)

        moved = body.robot.posed({"shoulder": 0.3, "elbow": -0.4})
        with Board("half.links", {"links": list(moved.links)}, 4096) as links:
            links.write(np.stack(list(moved.links.values())).tobytes())
            felt["known"] |= {"self_touch": True}
            until(lambda: there(f"{labels}.includes('#1 · 7.3 ±0.2 N · self-touch')"))
            pose = "ohmskin.body.links.get('forearm').matrixWorld.elements"
            until(lambda: np.allclose(np.reshape(there(pose), (4, 4)).T, moved.links["forearm"]))

        page.get_by_role("button", name="upper_arm").click()
        until(lambda: there("location.hash === '#upper_arm'"))
        cards = page.locator(".patch")
        until(lambda: there("true") and [card.is_visible() for card in cards.all()] == [True, False, False])
        page.close()


def test_maps_and_their_scale_stay_when_the_window_changes_and_no_frame_follows(half: Any, chromium: Any) -> None:
    body, patches, merger = half
    with Overview("half", [f"half.{placed.patch.name}" for placed in body.patches], port=0) as overview:
        page = chromium.new_page(viewport={"width": 1800, "height": 900})
        page.goto(overview.url)

        def there(true: str) -> Any:
            for patch in patches.values():
                patch.speak((0.0, 0.0))
            merger.step()
            return page.evaluate(true)

        until(lambda: there("ohmskin?.frame?.patches.every((patch) => patch.contacts?.length)"))
        right = "(name) => document.querySelector(name).getBoundingClientRect().right"
        last = "[...document.querySelectorAll('.patch')].at(-1).getBoundingClientRect().right"
        scale = page.evaluate("document.getElementById('scale').getBoundingClientRect().left")
        assert 0 < scale - page.evaluate(last) < 40  # beside the last map, not at the window's far side
        assert page.evaluate(right, "#scale") <= 1800
    until(lambda: page.locator("#state").text_content() == "no connection")  # it is closed
    page.set_viewport_size({"width": 700, "height": 900})
    painted = """() => [...document.querySelectorAll("canvas:not(#space)")].map((canvas) => {
        const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        return data.some((value) => value > 0);
    })"""
    until(lambda: page.evaluate(painted) == [True] * 4)
    page.close()


@pytest.mark.parametrize("screen", SCREENS)
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_everyone_can_use_the_page_of_a_body(half: Any, chromium: Any, theme: str, screen: str) -> None:
    """axe-core finds no violation: before anything is heard, with contacts of all kinds, of one patch alone."""
    body, patches, merger = half
    boards = [f"half.{placed.patch.name}" for placed in body.patches]
    with Overview("half", boards, port=0, robot=body.robot.as_json()) as overview:
        context = chromium.new_context(color_scheme=theme, **SCREENS[screen])
        page, said = context.new_page(), list[str]()
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(overview.url)
        until(lambda: page.evaluate("ohmskin?.frame?.patches?.length === 3"))
        assert violations(page) == []

        def there(true: str) -> Any:
            patches["upper_arm"].speak((0.1, 0.07), force=6.0, force_std=0.4)
            patches["forearm"].speak((0.1, 0.05), self_touch=True)
            merger.step()
            return page.evaluate(true)

        patches["head"].speak((0.0, 0.0), ago=3.0)  # which is silent
        labels = "[...document.querySelectorAll('#labels button:not([hidden])')].map((line) => line.textContent)"
        until(
            lambda: there(f"{labels}.some((text) => text.includes('N')) && {labels}.some((t) => t.includes('silent'))")
        )
        assert violations(page) == []
        page.evaluate("location.hash = '#forearm'")
        until(lambda: there("!document.getElementById('all').hidden"))
        assert violations(page) == []
        assert said == []
        overview.close()
        until(lambda: page.evaluate("document.getElementById('state').dataset.state === 'lost'"))
        assert violations(page) == []
        context.close()


def test_clicking_the_skin_of_a_robot_is_felt_there(tmp_path: Path, chromium: Any) -> None:
    """The whole: the command, twins, loops, boards, the page and back."""
    text = EXAMPLE.read_text(encoding="utf-8").split("[[patch]]")
    (tmp_path / "body.toml").write_text("[[patch]]".join([*text[:2], text[3]]), encoding="utf-8")
    (tmp_path / "robot.urdf").write_text(EXAMPLE.with_name("robot.urdf").read_text(encoding="utf-8"), encoding="utf-8")
    body = Body.load(tmp_path / "body.toml")
    sleeve = body.patches[0]
    arguments = ["patches", str(tmp_path / "body.toml"), "--no-demo", "--no-browser", "--port", "0"]
    command = subprocess.Popen(
        [sys.executable, "-m", "ohmskin", *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        assert command.stdout is not None
        url = next(found[0] for line in command.stdout if (found := re.search(r"http://\S+", line)))
        page = chromium.new_page(viewport={"width": 900, "height": 600})
        page.goto(url)
        with Client("shm:half") as robot, ExitStack() as stack:
            until(lambda: page.evaluate("ohmskin.frame?.patches.every((p) => p.virtual && p.age < 0.5)"), 300)
            told = Published(PlacedSkin(sleeve.patch, sleeve.skin, "", ""), "beside", stack)  # where its places are
            place, at = pixel(page, body.robot, told, 0.5)
            page.mouse.move(*at)
            page.mouse.down()
            contact = until(lambda: (newest := robot.newest()) and newest.contacts)[0]
            assert contact.patch == "upper_arm"
            np.testing.assert_allclose(contact.position, told.at(place)[0], atol=8e-3)
            assert np.dot(contact.normal, told.at(place)[1]) > np.cos(np.radians(10))
            page.mouse.up()
            until(lambda: (newest := robot.newest()) and not newest.contacts)
        page.close()
    finally:
        command.terminate()
        command.communicate(timeout=300)


def test_the_benchmark_counts_updates_at_a_browser() -> None:
    """It asks the page's scripts by names that they may change: then it waited for ever."""
    command = [sys.executable, "-m", "benchmarks.updates", "--seconds", "1"]
    done = subprocess.run(command, cwd=EXAMPLE.parents[2], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    rate = re.match(r"([\d.]+) updates of 8 patches a second", done.stdout)
    assert rate is not None, done.stdout
    assert float(rate[1]) > 0
