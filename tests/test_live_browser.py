"""The whole path as a newcomer has it: `ohmskin live`, a browser, a virtual skin pressed with the mouse."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from live_process import live

FIVE = [(0.05, 0.12), (0.1, 0.1), (0.16, 0.04), (0.04, 0.05), (0.13, 0.16)]


@pytest.fixture(scope="module")
def fresh(chromium: Any) -> Iterator[Any]:
    with live() as (url, *_):
        page = chromium.new_page(viewport={"width": 1300, "height": 900})
        page.set_default_timeout(30000)
        page.goto(url)
        until(page, "document.getElementById('state').dataset.state === 'running'")  # from when on it can be pressed
        yield page
        page.close()


@pytest.fixture
def page(fresh: Any) -> Iterator[Any]:
    yield fresh
    fresh.locator("#clear").click()
    contacts(fresh, 0)


def until(page: Any, condition: str, seconds: float = 120.0) -> None:
    """Wait for a condition on the page; its security policy forbids Playwright's own way of waiting."""
    end = time.monotonic() + seconds
    while not page.evaluate(f"Boolean({condition})"):
        assert time.monotonic() < end, (
            f"{condition} did not come true; the last frame was {page.evaluate('window.ohmskin.frame')}"
        )
        page.wait_for_timeout(20)


def screen(page: Any, x: float, y: float) -> tuple[float, float]:
    """Where on the screen a place on the sheet (m) is; the margins are those that docs/live-page.md promises."""
    box = page.locator("#map").bounding_box()
    scale = (box["width"] - 60) / 0.2
    return box["x"] + 30 + scale * x, box["y"] + box["height"] - 46 - scale * y


def contacts(page: Any, count: int) -> list[tuple[float, float]]:
    """The contacts once there are `count` of them, and still are twenty frames later: fingers come between scans."""
    for _ in range(100):
        until(page, f"window.ohmskin.frame.contacts.length === {count}")
        seen = page.evaluate("window.ohmskin.frame.sequence")  # a loop that others hold up shows an old one for long
        page.wait_for_timeout(300)
        until(page, f"window.ohmskin.frame.sequence >= {seen + 20}")
        found = [(c["x"], c["y"]) for c in page.evaluate("window.ohmskin.frame.contacts")]
        if len(found) == count:
            return found
    raise AssertionError(f"{count} contacts came and went a hundred times")


def test_a_finger_shows_itself_until_somebody_presses(fresh: Any) -> None:
    until(fresh, "window.ohmskin.frame.demo && window.ohmskin.frame.contacts.length === 1")
    demo = fresh.evaluate("window.ohmskin.frame.presses[0]")
    assert demo["demo"]
    assert "emonstration" in fresh.locator("#notice").inner_text()
    fresh.mouse.click(*screen(fresh, 0.1, 0.1))
    until(fresh, "!window.ohmskin.frame.demo")
    contacts(fresh, 0)


def test_a_press_at_five_places_is_felt_there(page: Any) -> None:
    for x, y in FIVE:
        page.mouse.move(*screen(page, x, y))
        page.mouse.down()
        (felt,) = contacts(page, 1)
        assert np.hypot(felt[0] - x, felt[1] - y) < 4e-3, f"pressed at ({x}, {y}), felt at {felt}"
        row = page.locator("#contacts tbody tr").first.inner_text().split()
        assert float(row[1].replace("\u2212", "-")) == pytest.approx(1e3 * x, abs=4)
        page.mouse.up()
        contacts(page, 0)


def test_two_presses_at_once_are_felt_as_two(page: Any) -> None:
    for x, y in ((0.05, 0.05), (0.15, 0.14)):
        page.keyboard.down("Shift")
        page.mouse.click(*screen(page, x, y))
        page.keyboard.up("Shift")
    felt = sorted(contacts(page, 2))
    assert np.hypot(felt[0][0] - 0.05, felt[0][1] - 0.05) < 4e-3
    assert np.hypot(felt[1][0] - 0.15, felt[1][1] - 0.14) < 4e-3


def test_the_mode_switch_changes_what_is_driven(page: Any) -> None:
    page.mouse.move(*screen(page, 0.08, 0.12))
    page.mouse.down()
    for mode, base, optimal in (("12B", 12, 0), ("16I", 16, 0), ("16O", 12, 16)):
        page.locator(f'[data-mode="{mode}"]').focus()
        page.keyboard.press("Enter")
        until(page, f"window.ohmskin.frame.mode === '{mode}' && window.ohmskin.frame.injections.length === {optimal}")
        assert len(page.evaluate("window.ohmskin.frame.base_injections")) == base
        (felt,) = contacts(page, 1)
        assert np.hypot(felt[0] - 0.08, felt[1] - 0.12) < 12e-3
    page.mouse.up()
    assert page.locator('[data-mode="16B"]').get_attribute("aria-disabled") == "true"


def test_a_mode_is_chosen_by_its_plain_name_and_an_estimator_and_a_prior_by_theirs(page: Any) -> None:
    page.get_by_role("button", name="Adaptive, as in the paper").click()
    until(page, "window.ohmskin.frame.mode === '16O'")
    assert page.get_by_text("A base scan of the rim, then the pairs closest to the contacts").is_visible()
    page.get_by_text("Expert").click()
    page.get_by_label("Estimator").select_option("kalman")
    until(page, "window.ohmskin.frame.estimator === 'kalman'")
    page.get_by_label("Prior").select_option("matern")
    until(page, "window.ohmskin.frame.prior === 'matern' && window.ohmskin.frame.estimator === 'kalman'")
    page.mouse.move(*screen(page, 0.08, 0.12))
    page.mouse.down()
    (felt,) = contacts(page, 1)
    assert np.hypot(felt[0] - 0.08, felt[1] - 0.12) < 12e-3
    page.mouse.up()
    page.get_by_label("Estimator").select_option("gauss-newton")
    page.get_by_label("Prior").select_option("paper")
    until(page, "window.ohmskin.frame.prior === 'paper' && window.ohmskin.frame.estimator === 'gauss-newton'")


def test_calibrate_and_pause(page: Any) -> None:
    page.locator("#pause").click()
    until(page, "window.ohmskin.frame.state === 'paused'")
    page.locator("#pause").click()
    until(page, "window.ohmskin.frame.state === 'running'")
    page.locator("#calibrate").click()
    until(page, "window.ohmskin.frame.state === 'calibrating'")
    until(page, "window.ohmskin.frame.state === 'running'")
