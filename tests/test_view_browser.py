"""The live page as its readers have it: in a real browser, with a synthetic loop behind it."""

import io
import json
import threading
import time
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, expect

from ohmskin.view import LiveView

SHEET = {"kind": "rectangle", "width": 0.2, "height": 0.2}
DISC = {"kind": "disc", "radius": 0.1}
MODES = [
    {
        "name": "12B",
        "title": "Rim of 12",
        "summary": "Adjacent drive on the 12 electrodes of the rim.",
        "available": True,
    },
    {"name": "16B", "title": "Rim of 16", "available": True, "why_not": ""},
    {"name": "16I", "title": "Rim and inside", "available": False, "why_not": "needs 4 inner electrodes"},
    {
        "name": "16O",
        "title": "Adaptive",
        "summary": "A base scan, then pairs " + 9 * "most informative ",
        "available": True,
    },
    {"name": "16T", "title": "Tracking, fastest", "available": True, "why_not": "", "injections": [1, 16]},
    {"name": "mine", "title": "mine", "available": True},
]
CHOICES = {"estimator": ("gauss-newton", "kalman"), "prior": ("paper", "matern"), "rule": ("physical", "l-curve")}
AS_USUAL = {name: names[0] for name, names in CHOICES.items()}

COVARIANCE = [26e-6, 10e-6, 26e-6]  # m2: half axes of 14.7 mm along y = x and 9.8 mm across, at 95 %


def make_setup(domain: dict[str, Any] = SHEET, pixels: int = 64, virtual: bool = True) -> dict[str, Any]:
    if domain["kind"] == "disc":
        radius = domain["radius"]
        angle = 2 * np.pi * np.arange(16) / 16
        points = radius * np.column_stack([np.cos(angle), np.sin(angle)])
        left, size = -radius, 2 * radius
    else:
        k, side, left, size = np.arange(3) / 3, domain["width"], 0.0, domain["width"]
        rim = [(a * side, 0.0) for a in k] + [(side, a * side) for a in k]
        rim += [(side - a * side, side) for a in k] + [(0.0, side - a * side) for a in k]
        points = np.array(
            rim + [(side * a, side * b) for a, b in ((1 / 3, 1 / 3), (2 / 3, 1 / 3), (2 / 3, 2 / 3), (1 / 3, 2 / 3))]
        )
    pitch = size / pixels
    return {
        "version": "0.1.0",
        "skin": {
            "name": "tank" if domain["kind"] == "disc" else "paper sheet",
            "domain": domain,
            "electrodes": [{"x": x, "y": y} for x, y in points.tolist()],
        },
        "raster": {
            "x0": left + pitch / 2,
            "y0": (domain.get("radius", 0) and left) + pitch / 2,
            "pitch": pitch,
            "nx": pixels,
            "ny": pixels,
        },
        "modes": MODES,
        "choices": {name: [{"name": n, "title": n.title()} for n in names] for name, names in CHOICES.items()},
        "device": {"url": "virtual:" if virtual else "tcp://10.0.0.7:7155", "virtual": virtual},
        "unit": "mS",
        "press": {"radius": [0.003, 0.02, 0.008], "pressure": [1e3, 1e5, 2e4]} if virtual else None,
    }


class SyntheticLoop:
    """Stands in for the engine: one bump and one contact per press, commands obeyed and kept."""

    def __init__(
        self, setup: dict[str, Any], height: float = 1.6, always: tuple[tuple[float, float], ...] = ()
    ) -> None:
        self.setup = setup
        self.sequence = 0
        self.height = height
        self.always = always
        self.heard: list[dict[str, Any]] = []
        self.header: dict[str, Any] = {"state": "running", "message": "", "demo": False, "mode": "16O", **AS_USUAL}
        self.presses: dict[str, dict[str, Any]] = {}
        self.view = LiveView(setup, port=0)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.view.close()

    def _run(self) -> None:
        radius = self.setup["skin"]["domain"].get("radius", np.inf)
        noise = np.random.default_rng(1)
        start = time.monotonic()
        while not self._stop.wait(0.05):
            raster = self.setup["raster"]
            x, y = np.meshgrid(*(raster[f"{a}0"] + raster["pitch"] * np.arange(raster[f"n{a}"]) for a in "xy"))
            self.sequence += 1
            for command in self.view.commands():
                self.heard.append(command)
                self._obey(command)
            if self.view.wants_frame():
                points = [*self.always, *((p["x"], p["y"]) for p in self.presses.values())]
                image = noise.normal(0, 0.02, x.shape)
                base = noise.normal(0, 0.02, x.shape)
                for k, (px, py) in enumerate(points):
                    sign = -1 if self.height < 0 and k % 2 == 0 else 1
                    squared = (x - px) ** 2 + (y - py) ** 2
                    image += sign * abs(self.height) * (1 - 0.2 * k) * np.exp(-squared / (2 * 0.012**2))
                    base += sign * abs(self.height) * (0.5 - 0.1 * k) * np.exp(-squared / (2 * 0.024**2))
                image[np.hypot(x, y) > radius] = np.nan
                base[np.hypot(x, y) > radius] = np.nan
                self.view.publish(self._header(self.sequence, time.monotonic() - start, points), base, image)

    def _obey(self, command: dict[str, Any]) -> None:
        match command["type"]:
            case "press" | "push":
                self.presses[command["id"]] = {"pressure": 2e4} | command
            case "lift":
                self.presses.pop(command["id"], None)
            case "lift_all":
                self.presses.clear()
            case "mode":
                self.header["mode"] = command["mode"]
            case "estimator":
                self.header |= {name: command[name] for name in CHOICES}
            case "injections":
                self.header["n_injections"] = command["count"]
            case "pause":
                self.header["state"] = "paused" if command["paused"] else "running"
            case "demo":
                self.header["demo"] = command["on"]
            case "seek":
                self.header["recording"] |= {"position": command["position"]}
            case "step":
                self.header["state"] = "paused"
                self.header["recording"] |= {"position": self.header["recording"]["position"] + command["cycles"] / 50}
            case "speed":
                self.header["recording"] |= {"speed": command["speed"]}
            case "loop":
                self.header["recording"] |= {"loop": command["on"]}

    def _header(self, sequence: int, now: float, points: list[tuple[float, float]]) -> dict[str, Any]:
        contacts = [
            {
                "id": k + 1,
                "x": x,
                "y": y,
                "extent": 9e-4 * weight,
                "strength": 1.8e-4 * weight,
                "confidence": 0.94 * weight,
                "peak": 1.5,
                "covariance": COVARIANCE if self.header["mode"] == "16T" else None,
            }
            for k, (x, y) in enumerate(points)
            for weight in (1 - 0.2 * k,)
        ]
        presses = [
            {k: p[k] for k in ("id", "x", "y", "radius", "pressure")} | {"demo": False} for p in self.presses.values()
        ]
        health = {"rate": 118 + 6 * np.sin(now / 3), "latency_p50": 3.4e-3, "latency_p99": 7.9e-3}
        health |= {"dropped": 0, "noise": 14.2e-6, "waiting": 0.62}
        rim = 12 if self.setup["skin"]["domain"]["kind"] == "rectangle" else 16
        pairs = [[0, 7], [3, 9], [12, 5], [14, 1], [13, 10], [2, 8], [6, 15], [4, 11]]
        return {
            "sequence": sequence,
            "time": now,
            "contacts": contacts,
            "base_injections": [[k, (k + 1) % rim] for k in range(rim)],
            "injections": pairs if self.header["mode"] == "16O" else [],
            "presses": presses,
            "threshold": 0.25,
            "health": health,
            **self.header,
        }


@cache
def _context(chromium: Browser, options: str) -> BrowserContext:
    """One for all pages with these options, as JSON: a page in a new one takes a second longer."""
    return chromium.new_context(**json.loads(options))


class Reader:
    """Someone at the page: opens it, and fails the test on any error in its console."""

    def __init__(self, chromium: Browser, loop: SyntheticLoop, **options: Any) -> None:
        self.loop = loop
        self.errors: list[str] = []
        self.context = _context(chromium, json.dumps({"viewport": {"width": 1440, "height": 900}} | options))
        self.page: Page = self.context.new_page()
        self.page.on(
            "console",
            lambda message: self.errors.append(message.text) if message.type in ("error", "warning") else None,
        )
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(loop.view.url)
        self.until(lambda: self.page.evaluate("Boolean(window.ohmskin?.ready)"))

    def until(self, condition: Callable[[], Any], seconds: float = 120.0) -> Any:
        end = time.monotonic() + seconds
        while not (value := condition()):
            assert time.monotonic() < end, f"this did not happen in time; heard {self.loop.heard}, errors {self.errors}"
            self.page.wait_for_timeout(10)
        return value

    def place(self, x: float, y: float, canvas: str = "map") -> tuple[float, float]:
        """Where on the screen a point of the skin (m) is, worked out from the layout that docs/live-page.md
        promises."""
        box = self.page.locator(f"#{canvas}").bounding_box()
        assert box is not None
        domain = self.loop.setup["skin"]["domain"]
        if domain["kind"] == "disc":
            size, x, y = 2 * domain["radius"], x + domain["radius"], y + domain["radius"]
        else:
            size = domain["width"]
        scale = (box["width"] - 60) / size
        return box["x"] + 30 + scale * x, box["y"] + box["height"] - 46 - scale * y

    def heard(self, kind: str) -> list[dict[str, Any]]:
        return [command for command in self.loop.heard if command["type"] == kind]

    def presses(self) -> list[tuple[float, float]]:
        return sorted((p["x"], p["y"]) for p in self.loop.presses.values())

    def close(self) -> None:
        self.page.evaluate("localStorage.clear()")
        self.page.close()
        assert self.errors == []


@pytest.fixture(scope="module")
def sheet() -> Iterator[SyntheticLoop]:
    loop = SyntheticLoop(make_setup())
    yield loop
    loop.close()


@pytest.fixture
def reader(chromium: Browser, sheet: SyntheticLoop) -> Iterator[Reader]:
    sheet.heard.clear()
    sheet.header.update(state="running", message="", demo=False, mode="16O", preparing="", **AS_USUAL)
    reader = Reader(chromium, sheet)
    yield reader
    reader.close()
    reader_gone = time.monotonic() + 60
    while sheet.presses and time.monotonic() < reader_gone:
        time.sleep(0.01)
    assert not sheet.presses, "the presses of a page that is closed are lifted"


@pytest.mark.parametrize("canvas", ["map", "base"])
def test_mouse_presses_drags_and_lifts_where_it_points(reader: Reader, canvas: str) -> None:
    mouse = reader.page.mouse
    mouse.move(*reader.place(0.05, 0.12, canvas))
    mouse.down()
    reader.until(reader.presses)
    assert reader.presses()[0] == pytest.approx((0.05, 0.12), abs=1e-3)
    press = reader.heard("press")[0]
    assert (press["radius"], press["pressure"]) == (0.008, 2e4)
    assert not reader.page.evaluate(f"document.getElementById('{canvas}').matches(':focus-visible')"), (
        "no keyboard cursor for a mouse"
    )
    mouse.move(*reader.place(0.15, 0.03, canvas), steps=5)
    reader.until(lambda: reader.presses() == [pytest.approx((0.15, 0.03), abs=1e-3)])
    cells = reader.page.locator("#contacts tbody td")
    reader.until(lambda: [float(cell) for cell in cells.all_inner_texts()[1:3]] == pytest.approx([150, 30], abs=1))
    mouse.up()
    reader.until(lambda: not reader.presses())
    assert len({command["id"] for command in reader.heard("press")}) == 1


def test_press_off_the_skin_is_no_press_and_a_drag_stops_at_the_rim(reader: Reader) -> None:
    mouse = reader.page.mouse
    mouse.move(*reader.place(-0.008, 0.1))
    mouse.down()
    mouse.up()
    mouse.move(*reader.place(0.1, 0.1))
    mouse.down()
    mouse.move(*reader.place(0.3, 0.1))
    reader.until(lambda: reader.presses() == [pytest.approx((0.2, 0.1), abs=1e-3)])
    mouse.up()
    reader.until(lambda: not reader.presses())
    assert len({command["id"] for command in reader.heard("press")}) == 1


def test_several_held_presses_with_one_mouse(reader: Reader) -> None:
    page = reader.page
    page.keyboard.down("Shift")
    for point in ((0.05, 0.05), (0.15, 0.15), (0.05, 0.15)):
        page.mouse.click(*reader.place(*point))
    page.keyboard.up("Shift")
    reader.until(lambda: len(reader.presses()) == 3)
    page.wait_for_timeout(400)
    page.mouse.move(*reader.place(0.15, 0.15))
    page.mouse.down()
    page.mouse.move(*reader.place(0.15, 0.10), steps=3)
    page.mouse.up()
    reader.until(lambda: pytest.approx((0.15, 0.10), abs=1e-3) in reader.presses())
    assert len(reader.presses()) == 3
    page.wait_for_timeout(400)
    page.mouse.dblclick(*reader.place(0.05, 0.05))
    reader.until(lambda: len(reader.presses()) == 2)
    page.click("#clear")
    reader.until(lambda: not reader.presses())
    assert reader.heard("lift_all")


def test_hold_button_does_what_shift_does(reader: Reader) -> None:
    reader.page.click("#hold")
    reader.page.mouse.click(*reader.place(0.05, 0.05))
    reader.page.mouse.click(*reader.place(0.15, 0.15))
    reader.until(lambda: len(reader.presses()) == 2)
    assert not reader.heard("lift")


def test_sliders_set_the_press(reader: Reader) -> None:
    page = reader.page
    page.click("#hold")
    page.mouse.click(*reader.place(0.1, 0.1))
    page.locator("#pressure").fill("1000")
    page.locator("#radius").fill("0")
    reader.until(lambda: [(p["radius"], p["pressure"]) for p in reader.loop.presses.values()] == [(0.003, 1e5)])
    expect(page.locator("#pressure-value")).to_have_text("100 kPa")


def test_injections_are_chosen_where_the_mode_has_a_choice(reader: Reader) -> None:
    page, slider = reader.page, reader.page.locator("#injections")
    expect(slider).to_be_disabled()
    expect(page.locator("#injections-value")).to_have_text("fixed")
    reader.loop.header.update(mode="16T", n_injections=4)
    expect(page.locator("#injections-value")).to_have_text("4 / frame")
    slider.fill("9")
    reader.until(lambda: reader.heard("injections") == [{"type": "injections", "count": 9}])
    page.wait_for_timeout(700)
    expect(page.locator("#injections-value")).to_have_text("9 / frame")
    assert slider.get_attribute("max") == "16"


def test_uncertainty_is_drawn_along_its_long_axis(chromium: Browser) -> None:
    loop = SyntheticLoop(make_setup(), height=1e-6, always=((0.1, 0.1),))
    loop.header["mode"] = "16T"
    reader = Reader(chromium, loop, color_scheme="light")

    def bluest(x: float, y: float) -> int:
        left, top = (round(v) for v in reader.place(x, y))
        shot = reader.page.screenshot(clip={"x": left - 3, "y": top - 3, "width": 7, "height": 7})
        pixels = np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)
        return int((pixels[..., 2] - pixels[..., 0]).max())

    reader.page.wait_for_timeout(300)
    try:
        along, across = 14.7e-3 / 2**0.5, 9.8e-3 / 2**0.5
        assert bluest(0.1 + along, 0.1 + along) > 100
        assert bluest(0.1 - across, 0.1 + across) > 100
        assert bluest(0.1 - along, 0.1 + along) < 60  # so that the axes are not swapped
    finally:
        reader.close()
        loop.close()


def test_keyboard_presses_moves_and_lifts(reader: Reader) -> None:
    page = reader.page
    page.locator("#map").focus()
    page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("ArrowUp")
    page.keyboard.press("Space")
    reader.until(lambda: reader.presses() == [pytest.approx((0.11, 0.102), abs=1e-6)])
    page.keyboard.press("ArrowDown")
    reader.until(lambda: reader.presses() == [pytest.approx((0.11, 0.1), abs=1e-6)])
    page.keyboard.press("Space")
    reader.until(lambda: not reader.presses())
    page.keyboard.press("Space")
    reader.until(reader.presses)
    page.keyboard.press("Escape")
    reader.until(lambda: not reader.presses())


def test_two_fingers_are_two_presses(chromium: Browser, sheet: SyntheticLoop) -> None:
    sheet.heard.clear()
    reader = Reader(chromium, sheet, viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    session = reader.context.new_cdp_session(reader.page)
    points = [
        dict(zip("xy", reader.place(*point), strict=True), id=k) for k, point in enumerate([(0.05, 0.05), (0.15, 0.15)])
    ]
    session.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": points})
    reader.until(lambda: len(reader.presses()) == 2)
    assert reader.presses() == [pytest.approx((0.05, 0.05), abs=1e-3), pytest.approx((0.15, 0.15), abs=1e-3)]
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    reader.until(lambda: not reader.presses())
    reader.close()


def test_buttons_command_and_show_the_state(reader: Reader) -> None:
    page = reader.page
    page.click('[data-mode="12B"]')
    expect(page.locator('[data-mode="12B"]')).to_have_attribute("aria-pressed", "true")
    expect(page.locator('[data-mode="16O"]')).to_have_attribute("aria-pressed", "false")
    barred = page.locator('[data-mode="16I"]')
    expect(barred).to_be_disabled()
    expect(barred).to_have_accessible_description("needs 4 inner electrodes")
    barred.click(force=True)
    expect(page.locator("#notice")).to_have_text("Not done: Rim and inside (16I) needs 4 inner electrodes.")
    page.click("#calibrate")
    page.click("#pause")
    expect(page.locator("#state")).to_have_text("paused")
    expect(page.locator("#pause")).to_have_text("Resume")
    page.click("#pause")
    expect(page.locator("#state")).to_have_text("running")
    page.click("#demo")
    expect(page.locator("#notice")).to_contain_text("press anywhere to take over")
    kinds = [{k: v for k, v in command.items() if k != "type"} for command in reader.loop.heard]
    assert kinds == [{"mode": "12B"}, {}, {"paused": True}, {"paused": False}, {"on": True}]


@pytest.mark.parametrize("width", [320, 390, 1440])
def test_modes_have_plain_names_and_a_sentence_each_and_nothing_moves(
    chromium: Browser, sheet: SyntheticLoop, width: int
) -> None:
    sheet.header.update(state="running", message="", demo=False, mode="12B", **AS_USUAL)
    reader = Reader(chromium, sheet, viewport={"width": width, "height": 900})
    page, summary = reader.page, reader.page.locator("#mode-summary")
    expect(summary.get_by_text("Adjacent drive on the 12 electrodes of the rim.")).to_be_visible()
    before = page.locator("#map").bounding_box()
    buttons = page.get_by_role("group", name="Mode").get_by_role("button")
    assert [name.split() for name in buttons.all_inner_texts()][:3] == [
        ["Rim", "of", "12", "12B"],
        ["Rim", "of", "16", "16B"],
        ["Rim", "and", "inside", "16I"],
    ]
    expect(buttons.last).to_have_text("mine ")
    for title, name in (("Adaptive 16O", "16O"), ("Tracking, fastest", "16T"), ("mine", "mine")):
        page.get_by_role("button", name=title).click()
        expect(page.locator(f'[data-mode="{name}"]')).to_have_attribute("aria-pressed", "true")
        assert reader.heard("mode")[-1] == {"type": "mode", "mode": name}
        assert page.locator("#map").bounding_box() == before
        expect(page.locator("#mode-summary > [data-shown]")).to_have_count(1)
    expect(summary.get_by_text("Adjacent drive")).to_be_hidden()
    reader.close()


def test_experts_choose_estimator_prior_and_rule(reader: Reader) -> None:
    page, header = reader.page, reader.loop.header
    expect(page.get_by_label("Estimator")).to_be_hidden()
    page.locator("#expert > summary").focus()
    page.keyboard.press("Enter")
    page.get_by_label("Estimator").select_option("kalman")
    reader.until(lambda: header["estimator"] == "kalman")
    header.update(preparing="Adaptive: estimator kalman, prior matern, rule physical", estimator="gauss-newton")
    expect(page.locator("#notice")).to_have_text("Preparing Adaptive: estimator kalman, prior matern, rule physical")
    page.wait_for_timeout(700)
    expect(page.get_by_label("Estimator")).to_have_value("kalman")  # what was asked for, until it is known what came
    header.update(preparing="", message="estimator 'kalman' does not go with this skin", demo=True)
    expect(page.locator("#notice")).to_have_text("Estimator 'kalman' does not go with this skin.")
    expect(page.get_by_label("Estimator")).to_have_value("gauss-newton")
    page.get_by_label("Prior").select_option("matern")
    page.get_by_label("Rule").select_option("l-curve")
    reader.until(lambda: (header["prior"], header["rule"]) == ("matern", "l-curve"))
    assert reader.heard("estimator")[-1] == {"type": "estimator", **AS_USUAL, "prior": "matern", "rule": "l-curve"}


def test_state_and_message_are_shown(reader: Reader) -> None:
    page, header = reader.page, reader.loop.header
    header.update(state="calibrating")
    expect(page.locator("#notice")).to_contain_text("keep the skin untouched")
    header.update(state="lost", message="device lost: cable; reconnecting")
    expect(page.locator("#notice")).to_have_text("Device lost: cable; reconnecting.")
    expect(page.locator("#state")).to_have_text("lost")
    header.update(state="running", message="")
    expect(page.locator("#notice")).to_have_attribute("data-kind", "hint")
    box = page.locator("#map").bounding_box()
    header.update(demo=True)
    expect(page.locator("#notice")).to_have_attribute("data-kind", "demo")
    assert page.locator("#map").bounding_box() == box, "a banner does not move the page"


def test_map_is_drawn_right_way_up(chromium: Browser) -> None:
    loop = SyntheticLoop(make_setup(), always=((0.05, 0.15),))
    reader = Reader(chromium, loop)

    def brightness(x: float, y: float) -> int:
        left, top = (round(v) for v in reader.place(x, y))
        shot = reader.page.screenshot(clip={"x": left - 2, "y": top - 2, "width": 4, "height": 4})
        return int(np.asarray(Image.open(io.BytesIO(shot)).convert("L")).mean())

    reader.page.wait_for_timeout(300)
    try:
        here = brightness(0.052, 0.147)
        for x, y in ((0.052, 0.047), (0.147, 0.147), (0.147, 0.047)):
            assert brightness(x, y) > here + 60  # on a light page zero is light
    finally:
        reader.close()
        loop.close()


def test_theme_follows_the_system_and_a_choice_is_remembered(chromium: Browser, sheet: SyntheticLoop) -> None:
    for system, other in (("dark", "light"), ("light", "dark")):
        reader = Reader(chromium, sheet, color_scheme=system)
        root = reader.page.locator("html")
        expect(root).to_have_attribute("data-theme", system)
        reader.page.click("#theme")
        expect(root).to_have_attribute("data-theme", other)
        reader.page.reload()
        expect(root).to_have_attribute("data-theme", other)
        reader.close()


def test_no_sideways_scrolling(chromium: Browser, sheet: SyntheticLoop) -> None:
    reader = Reader(chromium, sheet, viewport={"width": 320, "height": 800})
    for width in (320, 390, 800, 1100, 1280):
        reader.page.set_viewport_size({"width": width, "height": 800})
        assert reader.page.evaluate("document.documentElement.scrollWidth") <= width
    reader.close()


@pytest.mark.parametrize("virtual", [True, False])
def test_a_disc_is_pressed_if_it_is_virtual(chromium: Browser, virtual: bool) -> None:
    loop = SyntheticLoop(make_setup(DISC, virtual=virtual), height=-1.2, always=((-0.03, 0.04),))
    reader = Reader(chromium, loop)
    try:
        expect(reader.page.locator("#pressure")).to_be_visible(visible=virtual)
        expect(reader.page.locator("#transport")).to_be_hidden()  # there is no recording to lead
        expect(reader.page.locator("#pause")).to_be_visible()
        reader.page.mouse.move(*reader.place(0.05, -0.04))
        reader.page.mouse.down()
        if virtual:
            reader.until(reader.presses)
            assert reader.presses()[0] == pytest.approx((0.05, -0.04), abs=1e-3)
        else:
            reader.page.wait_for_timeout(100)
        reader.page.mouse.up()
        reader.until(lambda: not reader.presses())
        assert bool(reader.heard("press")) == virtual
    finally:
        reader.close()
        loop.close()


def test_a_recording_is_led_from_the_page_and_all_browsers_agree(chromium: Browser) -> None:
    loop = SyntheticLoop(make_setup(virtual=False) | {"recording": {"length": 40.0}})
    loop.header["recording"] = {"position": 8.0, "length": 40.0, "speed": 3.0, "loop": False}
    reader = Reader(chromium, loop)
    other = Reader(chromium, loop, viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page, seek = reader.page, reader.page.locator("#seek")

    def place() -> float:
        return float(loop.header["recording"]["position"])

    try:
        expect(page.locator("#position")).to_have_text("8.00 / 40.00 s")
        expect(page.get_by_label("Speed")).to_have_value("3")  # as the command line set it
        expect(page.locator("#pause")).to_be_hidden()
        page.click("#play")
        expect(page.locator("#play")).to_have_text("Play")
        box = seek.bounding_box()
        assert box is not None
        middle = box["y"] + box["height"] / 2
        page.mouse.click(box["x"] + box["width"] / 2, middle)
        reader.until(lambda: place() == pytest.approx(20, abs=0.5))
        page.mouse.down()
        page.mouse.move(box["x"] + 0.8 * box["width"], middle, steps=4)
        reader.until(lambda: place() == pytest.approx(32, abs=1))
        loop.header["recording"] |= {"position": 1.0}  # it plays on; the bar stays under the finger
        page.wait_for_timeout(700)
        assert float(seek.input_value()) == pytest.approx(32, abs=1)
        page.mouse.up()
        expect(page.locator("#position")).to_have_text("1.00 / 40.00 s")
        page.keyboard.press("ArrowRight")  # the bar has the focus
        reader.until(lambda: place() == pytest.approx(2))
        page.keyboard.press("Shift+ArrowLeft")  # a twentieth of the length at most
        reader.until(lambda: place() == pytest.approx(0))
        expect(page.get_by_label("Position in the recording")).to_have_attribute(
            "aria-valuetext", "0.00 of 40.00 seconds"
        )
        page.keyboard.press("End")
        reader.until(lambda: place() == 40)
        page.get_by_label("One frame back").click()
        reader.until(lambda: place() == pytest.approx(39.98))
        page.get_by_label("One frame forward").click()
        for told in ("0.25", "1", "4", "null"):
            page.get_by_label("Speed").select_option(told)
        page.click("#loop")
        reader.until(lambda: reader.heard("loop"))
        assert [command["speed"] for command in reader.heard("speed")] == [0.25, 1, 4, None]
        assert reader.heard("pause") == [{"type": "pause", "paused": True}]
        for shown in (page, other.page):
            expect(shown.locator("#loop")).to_have_attribute("aria-pressed", "true")
            expect(shown.get_by_label("Speed")).to_have_value("null")
            expect(shown.locator("#position")).to_have_text("40.00 / 40.00 s")
        assert other.page.evaluate("document.documentElement.scrollWidth") == 390
        for control in other.page.locator(".transport > :not(output)").all():
            box = control.bounding_box()
            assert box is not None
            assert min(box["width"], box["height"]) >= 38
    finally:
        reader.close()
        other.close()
        loop.close()


def test_saved_picture_is_a_picture(reader: Reader) -> None:
    with reader.page.expect_download() as download:
        reader.page.click("#save")
    assert download.value.suggested_filename.startswith("ohmskin-16O-")
    with Image.open(download.value.path()) as picture:
        assert picture.format == "PNG"
        assert picture.size[0] > 2000
        assert len(picture.convert("RGB").resize((200, 120)).getcolors(100000) or []) > 50


def test_page_reconnects_to_a_program_that_comes_back(chromium: Browser) -> None:
    setup = make_setup()
    loop = SyntheticLoop(setup)
    port = loop.view.port
    reader = Reader(chromium, loop)
    loop.close()
    expect(reader.page.locator("#state")).to_have_text("disconnected")
    with LiveView(setup, port=port) as view:
        assert not view.port_was_taken
        reader.until(view.wants_frame)
        expect(reader.page.locator("#state")).not_to_have_text("disconnected")
        reader.errors = [
            error for error in reader.errors if "WebSocket connection" not in error
        ]  # the attempts in between
        reader.close()  # before the program goes again


def test_test_hook_is_read_only(reader: Reader) -> None:
    page = reader.page
    assert page.evaluate("window.ohmskin.frame.sequence") > 0
    assert page.evaluate("window.ohmskin.setup.skin.name") == "paper sheet"
    page.evaluate("() => { try { window.ohmskin.ready = 1; window.ohmskin = 2 } catch {} }")
    assert page.evaluate("window.ohmskin.ready") is True
