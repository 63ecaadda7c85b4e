"""Everyone can use the page: axe-core finds no violation in any state, and the browser's console stays empty."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image as Bitmap
from playwright.sync_api import Browser, Page, expect
from test_view_browser import AS_USUAL, Reader, SyntheticLoop, make_setup

from ohmskin.arrays import Floats
from ohmskin.plot.report import Folded, ReportImage, ReportPicture, Section, Table, write_report
from ohmskin.view import LiveView

AXE = Axe()
SCREENS = {
    "desktop": {"viewport": {"width": 1440, "height": 900}},
    "phone": {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True},
}


@pytest.fixture(scope="module", params=["live", "replay"])
def loop(request: pytest.FixtureRequest) -> Iterator[SyntheticLoop]:
    setup = make_setup(virtual=request.param == "live")
    if request.param == "replay":
        setup |= {"recording": {"length": 12.0}}
    loop = SyntheticLoop(setup, always=((0.05, 0.15),))
    if request.param == "replay":
        loop.header["recording"] = HALFWAY
    yield loop
    loop.close()


def violations(page: Page) -> list[str]:
    found = AXE.run(page).response["violations"]
    return [f"{one['id']}: {node['html'][:200]}" for one in found for node in one["nodes"]]


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_in_any_state(
    chromium: Browser, loop: SyntheticLoop, theme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With every theme, every screen, and every page of a loop or of a recording: each pair of these once."""
    screen = "desktop" if (theme == "light") == bool(loop.setup["press"]) else "phone"
    loop.header.update(state="running", message="", mode="16O", findings=[], gesture=None, **AS_USUAL)
    reader = Reader(chromium, loop, color_scheme=theme, **SCREENS[screen])
    page, said = reader.page, list[str]()
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    assert violations(page) == []
    page.click("#help")
    expect(page.get_by_role("dialog")).to_be_visible()
    assert violations(page) == []
    page.keyboard.press("Escape")
    page.click("#expert summary")
    loop.header["findings"] = [{"words": "electrode 4: noisy; lower weight", "electrodes": [4]}]
    expect(page.locator("#findings")).to_be_visible()
    if loop.setup["press"]:
        page.click("#guided")
        expect(page.locator("#guide")).to_be_visible()
    assert violations(page) == []
    weighed(loop, monkeypatch)
    expect(page.locator("#contacts tbody tr[data-doubtful=true]")).to_have_count(1)
    expect(page.get_by_role("cell", name="1.2 ±0.2").first).to_be_visible()
    assert violations(page) == []
    for shown, change in AFTER["replay" if "recording" in loop.header else "live"].items():
        loop.header.update(change)
        expect(page.locator("#state")).to_have_attribute("data-state", shown)
        page.wait_for_timeout(500)  # the map fades, and axe judges contrast
        assert (shown, violations(page)) == (shown, [])
    assert said == []
    reader.close()


LOST = {"state": "lost", "message": "device lost: cable; reconnecting"}
HALFWAY = {"position": 2.4, "length": 12.0, "speed": 1.0, "loop": False, "ended": False}
AFTER: dict[str, dict[str, dict[str, Any]]] = {  # what the page shows after changes of the header
    "live": {"paused": {"state": "paused"}, "calibrating": {"state": "calibrating"}, "lost": LOST},
    "replay": {
        "end": {"state": "paused", "recording": HALFWAY | {"position": 12.0, "ended": True}},
        "paused": {"recording": HALFWAY},
        "lost": LOST,
    },
}


def weighed(loop: SyntheticLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two contacts in newtons, one of them doubtful, and a gesture."""
    publish = loop.view.publish

    def calibrated(header: dict[str, Any], base: Floats, image: Floats) -> None:
        contacts = [contact | {"force": 1.234, "force_std": 0.21} for contact in header["contacts"]]
        publish(header | {"contacts": contacts, "gesture": {"name": "push", "confidence": 0.95}}, base, image)

    monkeypatch.setattr(loop.view, "publish", calibrated)
    monkeypatch.setattr(loop, "always", ((0.05, 0.15), (0.15, 0.05)))


@pytest.mark.parametrize("screen", SCREENS)
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_before_the_loop_and_after_it(chromium: Browser, theme: str, screen: str) -> None:
    context = chromium.new_context(color_scheme=theme, **SCREENS[screen])  # type: ignore[arg-type]
    page = context.new_page()
    with LiveView(port=0) as view:
        view.starting("compiling, once on this machine", 0.4)
        page.goto(view.url)
        expect(page.locator("#unknown-why")).to_have_text("Starting")
        assert violations(page) == []
    expect(page.locator("#notice")).to_contain_text("Connection to ohmskin lost")
    assert violations(page) == []
    context.close()


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_in_a_report(chromium: Browser, theme: str, tmp_path: Path) -> None:
    Bitmap.new("RGB", (400, 300), "white").save(tmp_path / "map.png")
    head = ("", *(f"quantity {k} / mm" for k in range(12)))
    table = Table(head, [("it's", *("1.25 (1.1 to 1.4)",) * 10, verdict, "met") for verdict in ("missed", "undecided")])
    picture = ReportImage("Figure 1", ReportPicture("map", tmp_path / "map.png", "Where it is."))
    first = Section("A report", ["Some *words*, and `code`."], "#")
    report = write_report(
        [first, Section("Errors", [table, picture, Folded("more", [table])], "1", "errors")], tmp_path / "a.html"
    )
    context = chromium.new_context(color_scheme=theme)  # type: ignore[arg-type]
    page = context.new_page()
    for width in (320, 1440):
        page.set_viewport_size({"width": width, "height": 800})
        page.goto(report.as_uri())
        page.click("summary")
        assert violations(page) == []
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    context.close()
