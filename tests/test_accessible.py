"""Everyone can use the page: axe-core finds no violation in any state, and the browser's console stays empty."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image as Bitmap
from playwright.sync_api import Browser, Page, expect
from test_view_browser import AS_USUAL, Reader, SyntheticLoop, make_setup

from ohmskin.plot.report import Folded, Image, Picture, Section, Table, write_report
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
        loop.header["recording"] = {"position": 2.4, "length": 12.0, "speed": 1.0, "loop": False, "ended": False}
    yield loop
    loop.close()


def violations(page: Page) -> list[str]:
    found = AXE.run(page).response["violations"]
    return [f"{one['id']}: {node['html'][:200]}" for one in found for node in one["nodes"]]


@pytest.mark.parametrize("screen", SCREENS)
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_in_any_state(chromium: Browser, loop: SyntheticLoop, theme: str, screen: str) -> None:
    loop.header.update(state="running", message="", mode="16O", findings=[], **AS_USUAL)
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
    loop.header.update(state="lost", message="device lost: cable; reconnecting")
    expect(page.locator("#unknown")).to_be_visible()
    page.wait_for_timeout(500)  # it fades, and axe judges contrast
    assert violations(page) == []
    assert said == []
    reader.close()


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_while_the_loop_starts(chromium: Browser, theme: str) -> None:
    with LiveView(port=0) as view:
        view.starting("compiling, once on this machine", 0.4)
        context = chromium.new_context(color_scheme=theme)  # type: ignore[arg-type]
        page = context.new_page()
        page.goto(view.url)
        expect(page.locator("#unknown-why")).to_have_text("Starting")
        assert violations(page) == []
        context.close()


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_in_a_report(chromium: Browser, theme: str, tmp_path: Path) -> None:
    Bitmap.new("RGB", (400, 300), "white").save(tmp_path / "map.png")
    head = ("", *(f"quantity {k} / mm" for k in range(12)))
    table = Table(head, [("it's", *("1.25 (1.1 to 1.4)",) * 10, verdict, "met") for verdict in ("missed", "undecided")])
    picture = Image("Figure 1", Picture("map", tmp_path / "map.png", "Where it is."))
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
