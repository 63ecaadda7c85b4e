"""The guided calibration of the page: quiet, ten presses, and what they say."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect
from test_view_browser import Reader, SyntheticLoop, make_setup

HURRY = """() => {  // eight seconds of the page go by in one
    const [ask, now] = [window.requestAnimationFrame.bind(window), performance.now.bind(performance)];
    window.requestAnimationFrame = (draw) => ask((time) => draw(8 * time));
    performance.now = () => 8 * now();
}"""


@pytest.fixture
def reader(chromium: Browser) -> Iterator[Reader]:
    loop = SyntheticLoop(make_setup())
    reader = Reader(chromium, loop)
    yield reader
    reader.close()
    loop.close()


@pytest.fixture(scope="module")
def scripts(chromium: Browser) -> Iterator[Page]:
    """A page that only calls the page's own functions."""
    loop = SyntheticLoop(make_setup())
    reader = Reader(chromium, loop)
    yield reader.page
    reader.close()
    loop.close()


def judged(page: Page, change: str) -> dict[str, str]:
    """What the page says of presses that were felt where a change of the true place (m) says."""
    script = """async () => {
        const { judge, placesOn } = await import("/static/guide.js");
        const domain = { kind: "rectangle", width: 0.2, height: 0.2 };
        return judge(placesOn(domain).map(([x, y]) => [[x, y], %s]), domain);
    }"""
    told: dict[str, str] = page.evaluate(script % change)
    return told


def test_a_newcomer_is_led_through_quiet_and_ten_presses(reader: Reader) -> None:
    page = reader.page
    guide, on = page.get_by_role("region", name="Guided calibration"), page.locator("#guide-on")
    page.get_by_role("button", name="Guide").click()
    expect(guide.get_by_text("Take everything off the skin.")).to_be_visible()
    expect(on).to_be_focused()
    page.keyboard.press("Enter")
    reader.until(lambda: reader.heard("calibrate"))
    reader.loop.header.update(state="calibrating")
    expect(guide.get_by_text("Measuring. Do not touch the skin.")).to_be_visible()
    reader.loop.header.update(state="running")
    expect(guide.get_by_text("2. Press 1 of 10")).to_be_visible()
    on.click()  # not felt
    page.get_by_role("button", name="Press for me").click()
    page.evaluate(HURRY)
    expect(guide.get_by_text("Good")).to_be_visible(timeout=60_000)
    expect(guide.get_by_text("9 of 10 presses detected, 0.0 mm off on average")).to_be_visible()
    assert len(reader.heard("lift")) == 9
    assert not reader.heard("save")
    expect(guide.locator("#guide-text")).to_contain_text("Nothing is saved.")
    page.keyboard.press("Escape")
    expect(guide).to_be_hidden()


def test_known_weights_calibrate_newtons_and_say_what_is_saved(reader: Reader) -> None:
    page = reader.page
    guide, on = page.get_by_role("region", name="Guided calibration"), page.locator("#guide-on")
    page.get_by_role("button", name="Guide").click()
    page.get_by_label("Weights / g").fill("500")
    on.click()
    assert not reader.heard("calibrate")  # one weight is no curve
    page.get_by_label("Weights / g").fill("200 500")
    on.click()
    reader.until(lambda: reader.heard("calibrate"))
    reader.loop.header.update(state="calibrating")
    expect(guide.get_by_text("Measuring. Do not touch the skin.")).to_be_visible()
    reader.loop.header.update(state="running")
    expect(guide.get_by_text("Put 200 g at")).to_be_visible()
    page.get_by_role("button", name="Press for me").click()
    expect(guide.get_by_text("Put 500 g at")).to_be_visible(timeout=30_000)
    page.evaluate(HURRY)
    reader.until(lambda: reader.heard("save"))
    forces = [command["force"] for command in reader.heard("weigh")]
    assert forces[:4] == pytest.approx([1.961, 0, 4.903, 0], abs=1e-3)
    expect(guide.locator("#guide-text")).to_contain_text("Fitting forces.")
    reader.loop.header.update(guided="Force calibration saved in paper-calibrated.toml")
    expect(guide.get_by_text("Force calibration saved in paper-calibrated.toml")).to_be_visible()


def test_places_are_spread_inside_any_outline(scripts: Page) -> None:
    script = """async () => {
        const { placesOn } = await import("/static/guide.js");
        return [placesOn({ kind: "disc", radius: 0.1 }), placesOn({ kind: "rectangle", width: 0.2, height: 0.1 })];
    }"""
    disc, sheet = (np.array(places) for places in scripts.evaluate(script))
    assert disc.shape == sheet.shape == (10, 2)
    assert np.hypot(*disc.T).max() <= 0.1 - 0.12 * 0.2 + 1e-9
    assert sheet.min() >= 0.012 - 1e-9
    for places in (disc, sheet):
        apart = np.linalg.norm(places[:, None] - places, axis=2) + np.eye(10)
        assert apart.min() > 0.01


@pytest.mark.parametrize(
    ("change", "verdict", "says"),
    [
        ("[x + 0.002, y]", "Good", "10 of 10 presses detected, 2.0 mm off on average, 2.0 mm at most."),
        ("[x + 0.006, y]", "Fair", "6.0 mm off"),
        ("[x + 0.02, y]", "Poor", "20.0 mm off"),
        ("x < 0.05 ? null : [x, y]", "Good", "presses detected, 0.0 mm"),
        ("null", "Poor", "0 of 10 presses were detected"),
        ("[0.2 - x, y]", "Check the wiring", "fits better mirrored left to right"),
        ("[y, 0.2 - x]", "Check the wiring", "fits better rotated by 90°"),
        ("[y, x]", "Check the wiring", "fits better mirrored across a diagonal"),
    ],
)
def test_the_verdict_names_what_is_wrong(scripts: Page, change: str, verdict: str, says: Any) -> None:
    told = judged(scripts, change)
    assert told["verdict"] == verdict
    assert says in told["text"]
