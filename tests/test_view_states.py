"""What the live page tells and does not tell: lost, doubtful and quiet skins, marks explained, no collisions."""

import io
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect
from test_view_browser import AS_USUAL, Reader, SyntheticLoop, make_setup
from waiting import until

from ohmskin.view import LiveView

ELECTRODE_4, RIM = (0.2, 0.0667), (0.03, 0.2)  # m
UNKNOWN = {
    "lost": ("the device is lost", "Device lost: is “ohmskin serve-skin” running? Reconnecting."),
    "calibrating": ("the skin is being calibrated", "Calibrating: keep the skin untouched."),
}


@pytest.fixture(scope="module")
def touched() -> Iterator[SyntheticLoop]:
    loop = SyntheticLoop(make_setup(), always=((0.05, 0.15),))
    yield loop
    loop.close()


@pytest.fixture
def reader(chromium: Browser, touched: SyntheticLoop) -> Iterator[Reader]:
    touched.heard.clear()
    touched.header = {"state": "running", "message": "", "demo": False, "mode": "16O", **AS_USUAL}
    reader = Reader(chromium, touched)
    yield reader
    reader.close()


def pixels(page: Page, **clip: float) -> np.ndarray:
    """(height, width, 3) of a part of the page."""
    shot = page.screenshot(clip=clip)  # type: ignore[arg-type]
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)


def colourful(image: np.ndarray) -> int:
    """How far the most colourful pixel is from grey."""
    return int((image.max(axis=2) - image.min(axis=2)).max())


def around(reader: Reader, x: float, y: float, size: int = 24) -> np.ndarray:
    left, top = reader.place(x, y)
    return pixels(reader.page, x=left - size / 2, y=top - size / 2, width=size, height=size)


@pytest.mark.parametrize("state", UNKNOWN)
def test_where_nobody_knows_what_touches_the_page_says_unknown_and_refuses_presses(reader: Reader, state: str) -> None:
    page, (why, notice) = reader.page, UNKNOWN[state]
    rows = page.locator("#contacts tbody tr")
    expect(rows).to_have_count(1)
    assert colourful(around(reader, 0.05, 0.15)) > 100
    expect(page.locator("#unknown")).to_be_hidden()
    page.mouse.move(*reader.place(0.05, 0.15))
    expect(page.locator("#map-readout")).to_contain_text("mm: ")
    lost = "device lost: is `ohmskin serve-skin` running? Reconnecting"
    reader.loop.header.update(state=state, message=lost if state == "lost" else "")
    expect(page.locator("#notice")).to_have_text(notice)
    expect(rows).to_have_count(0)
    expect(page.get_by_text("No contact", exact=True)).to_have_count(0)
    expect(page.locator("#no-contacts")).to_have_text("Unknown")
    expect(page.locator("#rate")).to_have_text("\N{EN DASH}")
    expect(page.locator("#unknown-why")).to_have_text(f"Unknown: {why}.")
    expect(page.locator("#unknown-todo")).not_to_be_empty()
    expect(page.locator("#map-readout")).to_be_empty()
    expect(page.locator("#summary")).to_have_text(f"contacts unknown: {why}")  # read aloud
    page.wait_for_timeout(500)  # it fades
    assert colourful(around(reader, 0.05, 0.15)) < 10
    page.mouse.click(*reader.place(0.15, 0.05))
    expect(page.locator("#notice")).to_contain_text(f"Not pressed: {why}")
    page.locator("#map").focus()
    page.keyboard.press("Space")
    page.wait_for_timeout(200)
    assert not reader.heard("press")
    reader.loop.header.update(state="running", message="")
    expect(page.locator("#unknown")).to_be_hidden()
    expect(rows).to_have_count(1)
    page.mouse.click(*reader.place(0.15, 0.05))
    reader.until(lambda: reader.heard("press"))


def test_a_loop_that_is_silent_is_unknown_too(reader: Reader, monkeypatch: pytest.MonkeyPatch) -> None:
    page = reader.page
    monkeypatch.setattr(reader.loop.view, "wants_frame", lambda: False)
    expect(page.locator("#unknown-why")).to_contain_text("Unknown: no new frame for", timeout=20000)
    expect(page.locator("#no-contacts")).to_have_text("Unknown")
    monkeypatch.undo()
    expect(page.locator("#contacts tbody tr")).to_have_count(1)


def test_a_program_that_ended_is_unknown_too(chromium: Browser) -> None:
    loop = SyntheticLoop(make_setup(), always=((0.05, 0.15),))
    reader = Reader(chromium, loop)
    loop.close()
    expect(reader.page.locator("#notice")).to_contain_text("Connection to ohmskin lost. Is it still running?")
    expect(reader.page.locator("#no-contacts")).to_have_text("Unknown")
    reader.page.close()


def test_the_page_is_there_before_the_loop_and_says_how_far_it_is(chromium: Browser) -> None:
    setup = make_setup()
    with LiveView(port=0) as view:
        view.starting("compiling, once on this machine", 0.4)
        page = chromium.new_page()
        page.goto(view.url)
        expect(page.locator("#unknown-todo")).to_have_text("Compiling, once on this machine.")
        expect(page.locator("#unknown-why")).to_have_text("Starting")
        expect(page.locator("#state")).to_have_text("starting")
        expect(page.get_by_role("progressbar", name="Progress")).to_have_js_property("value", 0.4)
        view.starting("starting the virtual skin")
        expect(page.locator("#unknown-todo")).to_have_text("Starting the virtual skin.")
        expect(page.get_by_role("progressbar", name="Progress")).not_to_have_attribute("value", "0.4")
        view.show(setup)
        until(view.wants_frame)
        image = np.zeros((setup["raster"]["ny"], setup["raster"]["nx"]))
        view.publish(
            {"sequence": 1, "state": "calibrating", "message": "", "mode": "16O", "progress": 0.7}, image, image
        )
        expect(page.locator("#skin-name")).to_have_text(setup["skin"]["name"])
        expect(page.locator("#unknown-why")).to_have_text("Unknown: the skin is being calibrated.")
        expect(page.get_by_role("progressbar", name="Progress")).to_have_js_property("value", 0.7)
        page.close()


def test_help_explains_every_mark_by_mouse_and_by_keyboard(reader: Reader) -> None:
    page = reader.page
    dialog = page.get_by_role("dialog", name="What this page shows")
    for begin, end in (
        (lambda: page.get_by_role("button", name="Help").click(), lambda: page.keyboard.press("Escape")),
        (lambda: page.keyboard.press("?"), lambda: dialog.get_by_role("button", name="Close").click()),
    ):
        begin()
        expect(dialog).to_be_visible()
        for term in (
            "Contact.",
            "Position.",
            "Press",
            "Driven now:",
            "Crosshair:",
            "Electrode left out:",
            "γ₀",
            "strength",
        ):
            expect(dialog.get_by_text(term, exact=True)).to_be_visible()
        end()
        expect(dialog).to_be_hidden()
    page.get_by_label("Radius").focus()
    page.keyboard.press("?")  # is text there
    expect(dialog).to_be_hidden()


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_a_quiet_skin_has_no_colour(chromium: Browser, theme: str) -> None:
    loop = SyntheticLoop(make_setup(), height=1e-6)
    loop.header["mode"] = "12B"  # no lines of driven pairs on the map
    reader = Reader(chromium, loop, color_scheme=theme)
    try:
        reader.page.wait_for_timeout(300)
        corner, other = reader.place(0.145, 0.145), reader.place(0.19, 0.19)
        image = pixels(reader.page, x=corner[0], y=other[1], width=other[0] - corner[0], height=corner[1] - other[1])
        assert colourful(image) < 16  # the paper's own tint
        loop.always = ((0.15, 0.15),)
        loop.height = 0.6
        reader.page.wait_for_timeout(500)
        assert colourful(around(reader, 0.157, 0.157, 6)) > 60
    finally:
        reader.close()
        loop.close()


def run(page: Page, script: str) -> Any:
    """What a script gives that uses the page's own modules."""
    return page.evaluate(f"async () => {{ {script} }}")


def test_the_scale_reaches_down_to_negative_lobes_and_holds_still_above_noise(reader: Reader) -> None:
    follow = """
        const { Range } = await import("/static/colour.js");
        const range = new Range(), seen = [];
        for (const [low, high, seconds] of %s)
            for (let t = 0; t < 1000 * seconds; t += 20) range.follow(low, high, 0.1, (range.t = (range.t ?? 0) + 20));
        return [range.low, range.limit];
    """
    assert run(reader.page, follow % "[[-0.05, 1.9, 1]]") == [-0.4, 2]
    assert run(reader.page, follow % "[[-0.05, 1.9, 1], [-0.7, 1.9, 0.3]]") == [-0.4, 2]  # a moment changes nothing
    assert run(reader.page, follow % "[[-0.05, 1.9, 1], [-0.7, 1.9, 1]]") == [-1, 2]
    assert run(reader.page, follow % "[[-1.9, 0.5, 1]]") == [-2, 2]
    noise = pytest.approx([-0.1, 0.2])  # none of what may be noise is cut off
    assert run(reader.page, follow % "[[-0.7, 1.9, 2], [-0.01, 0.02, 20]]") == noise
    assert run(reader.page, follow % "[[-0.03, 0.05, 5], [-0.02, 0.09, 5]]") == noise


def test_places_off_an_outline_or_in_its_hole_move_to_the_closest_rim(reader: Reader) -> None:
    script = """
        const { bounds, clampTo, contains } = await import("/static/frame.js");
        const hole = [[0.08, 0.04], [0.12, 0.04], [0.12, 0.06], [0.08, 0.06]];
        const outline = [[0, 0], [0.2, 0], [0.2, 0.1], [0.1, 0.1], [0.1, 0.2], [0, 0.2]];
        const ell = { kind: "polygon", outline, holes: [hole] };
        const places = [[0.05, 0.1], [0.1, 0.055], [0.15, 0.12], [-0.1, 0.3]];
        const band = { kind: "band", width: 0.2, height: 0.1, holes: [hole] };
        const turns = [0.1, 0.3, -0.1].map((x) => [...clampTo(band, x, 0.055), contains(band, x, 0.055)]);
        return [turns, bounds(ell), ...places.map(([x, y]) => [...clampTo(ell, x, y), contains(ell, x, y)])];
    """
    turns, box, *found = run(reader.page, script)
    assert turns == [pytest.approx([0.1, 0.06, False])] * 3  # round a closed band any number of turns is the same
    assert box == [0, 0, 0.2, 0.2]
    expected = [[0.05, 0.1, True], [0.1, 0.06, False], [0.15, 0.1, False], [0, 0.2, False]]
    for one, other in zip(found, expected, strict=True):
        assert one == pytest.approx(other)


CANVAS = """
        const { drawContacts } = await import("/static/contacts.js");
        const { Frame } = await import("/static/frame.js");
        const { INK } = await import("/static/ink.js");
        const c = document.createElement("canvas").getContext("2d");
        const frame = new Frame({ kind: "rectangle", width: 0.2, height: 0.2 }, 460, 476);
"""  # on which contacts are drawn


def test_labels_avoid_electrodes_contacts_and_each_other(reader: Reader) -> None:
    script = """
        const electrodes = [0.067, 0.133].flatMap(
            (x) => [0.067, 0.133].map((y) => [frame.x(x) - 9, frame.y(y) - 9, 18, 18]),
        );
        const contacts = %s.map(([x, y], id) => ({ id, x, y, extent: 3e-4, strength: 2e-4, confidence: 1 }));
        const taken = [...electrodes];
        drawContacts(c, frame, 460, 460, { contacts }, taken, INK.dark);
        return taken;
    """
    for places in (
        [[0.06, 0.13]],
        [[0.05, 0.13], [0.08, 0.13]],
        [[0.1, 0.1], [0.1, 0.125], [0.075, 0.1]],
        [[0.19, 0.19]],
    ):
        boxes = np.array(run(reader.page, CANVAS + script % places))
        assert len(boxes) == 4 + 2 * len(places)  # electrodes, contacts, labels
        labels = boxes[-len(places) :]
        for k, (x, y, w, h) in enumerate(labels):
            others = np.delete(boxes, len(boxes) - len(places) + k, axis=0)
            across = np.minimum(x + w, others[:, 0] + others[:, 2]) - np.maximum(x, others[:, 0])
            along = np.minimum(y + h, others[:, 1] + others[:, 3]) - np.maximum(y, others[:, 1])
            assert not ((across > 1) & (along > 1)).any(), f"{places}: label {k}"
            assert x >= 0
            assert x + w <= 460


def test_a_label_has_the_unit_of_what_it_tells(reader: Reader) -> None:
    script = """
        const told = [];
        c.fillText = (text) => told.push(text);
        const contacts = [{ id: 1, x: 0.1, y: 0.1, extent: 3e-4, strength: 2e-4, confidence: 1%s }];
        drawContacts(c, frame, 460, 460, { contacts }, [], INK.dark);
        return told;
    """
    sigma = "\N{GREEK SMALL LETTER SIGMA}"
    assert f"strength 2.00 Δ{sigma}/{sigma}·cm²" in run(reader.page, CANVAS + script % "")
    assert "5.0 ±0.4 N" in run(reader.page, CANVAS + script % ", force: 5, force_std: 0.4")


def test_labels_stay_off_the_colour_of_contacts_and_where_they_are(reader: Reader) -> None:
    script = """
        const { drawContacts } = await import("/static/contacts.js");
        const { Field } = await import("/static/field.js");
        const { Frame } = await import("/static/frame.js");
        const { INK } = await import("/static/ink.js");
        const c = document.createElement("canvas").getContext("2d");
        const frame = new Frame({ kind: "rectangle", width: 0.2, height: 0.2 }, 460, 476);
        const field = new Field({ x0: 0.0025, y0: 0.0025, pitch: 0.005, nx: 40, ny: 40 });
        const drawn = (id, x, y, reach) => {
            const values = Array.from({ length: 1600 }, (_, i) => {
                const [u, v] = [0.0025 + 0.005 * (i % 40), 0.0025 + 0.005 * Math.floor(i / 40)];
                return 2 * Math.exp(-Math.log(4) * ((u - x) ** 2 + (v - y) ** 2) / reach ** 2); // 0.5 at its reach
            });
            field.set(Float32Array.from(values));
            const contacts = [{ id, x, y, extent: 2e-4, strength: 2e-4, confidence: 1 }];
            const taken = [];
            drawContacts(c, frame, 460, 460, { contacts, field, threshold: 0.5 }, taken, INK.dark);
            const [[cx, cy, size], [px, py, w, h]] = taken;
            const near = [Math.max(px, Math.min(px + w, cx + size / 2)), Math.max(py, Math.min(py + h, cy + size / 2))];
            return Math.hypot(near[0] - cx - size / 2, near[1] - cy - size / 2) / frame.scale;
        };
        return [drawn(1, 0.06, 0.1, 0.02), drawn(1, 0.061, 0.1, 0.018), drawn(2, 0.061, 0.1, 0.008)];
    """
    wide, slightly_less, narrow = run(reader.page, script)
    assert wide > 0.019  # where the colour ends, 20 mm from the contact
    assert slightly_less == pytest.approx(wide)
    assert narrow < 0.013


def test_the_scale_takes_what_is_a_scale(reader: Reader) -> None:
    page, entry = reader.page, reader.page.locator("#range")
    page.get_by_label("auto").uncheck()
    entry.fill("3")
    for nonsense in ("-3", "0", "", "1e9"):
        entry.fill(nonsense)
        expect(entry).to_have_attribute("aria-invalid", "true")
        entry.blur()
        expect(entry).to_have_value("3")
        expect(entry).to_have_attribute("aria-invalid", "false")
        expect(page.locator("#notice")).to_have_text("Not done: the scale must be from 0.001 to 10000 mS.")


def test_the_base_map_is_shown_where_it_says_something_else_and_nothing_moves(
    reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = reader.page

    def boxes() -> list[Any]:
        return [
            page.locator(one).bounding_box() for one in ("#map", ".base", ".finger", ".sections", "#pressure", "#clear")
        ]

    expect(page.locator("#base")).to_be_visible()
    before = boxes()
    publish = reader.loop.view.publish
    monkeypatch.setattr(reader.loop.view, "publish", lambda header, base, image: publish(header, image, image))
    reader.loop.header["mode"] = "16T"
    expect(page.locator("#base")).to_be_hidden()
    expect(page.get_by_text("This mode has one scan per frame")).to_be_visible()
    with page.expect_download() as download:
        page.click("#save")
    with Image.open(download.value.path()) as picture:
        assert picture.size[0] < 1600  # of the large map alone
    assert boxes() == before


def test_doubts_are_shown_where_they_are_and_in_words(reader: Reader) -> None:
    page, header = reader.page, reader.loop.header

    def amber(x: float, y: float) -> int:
        seen = around(reader, x, y)
        return int(((seen[..., 0] - seen[..., 2]) > 100).sum())

    assert amber(*ELECTRODE_4) == amber(*RIM) == 0
    expect(page.get_by_role("heading", name="Doubts")).to_be_hidden()
    header["findings"] = [
        {"words": "electrode 4: noisy; lower weight", "electrodes": [4]},
        {"words": "hum of the mains on all voltages; subtracted", "electrodes": []},
    ]
    expect(page.locator("#findings li")).to_have_text([finding["words"].capitalize() for finding in header["findings"]])
    page.wait_for_timeout(200)
    assert amber(*ELECTRODE_4) > 20
    assert amber(*RIM) > 0
    header["findings"] = []
    expect(page.locator("#findings")).to_be_hidden()


def test_a_doubtful_contact_looks_doubtful(reader: Reader) -> None:
    page = reader.page
    row = page.locator("#contacts tbody tr")
    expect(row).to_have_attribute("data-doubtful", "false")
    mouse = page.mouse
    mouse.move(*reader.place(0.15, 0.05))
    mouse.down()  # the second contact of the synthetic loop is 75 % sure
    expect(row.nth(1)).to_have_attribute("data-doubtful", "true")
    expect(row.nth(1)).to_contain_text("75 %")
    mouse.up()


def test_force_is_shown_with_its_deviation_where_it_is_known_and_strength_is_no_area(
    reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, publish = reader.page, reader.loop.view.publish
    force, strength = page.get_by_role("columnheader", name="force"), page.get_by_role("columnheader", name="strength")
    expect(force).to_have_count(0)
    assert (
        " ".join(strength.inner_text().split())
        == "strength Δ\N{GREEK SMALL LETTER SIGMA}/\N{GREEK SMALL LETTER SIGMA} · cm²"
    )

    def calibrated(header: dict[str, Any], base: np.ndarray, image: np.ndarray) -> None:
        contacts = [contact | {"force": 1.234, "force_std": 0.21} for contact in header["contacts"]]
        publish(header | {"contacts": contacts}, base, image)

    monkeypatch.setattr(reader.loop.view, "publish", calibrated)
    expect(force).to_be_visible()
    expect(page.get_by_role("cell", name="1.2 ±0.2")).to_be_visible()


@pytest.mark.parametrize("width", [320, 1440])
def test_newtons_and_gestures_of_a_doubtful_contact_look_doubtful_and_are_unknown_when_lost(
    chromium: Browser, touched: SyntheticLoop, monkeypatch: pytest.MonkeyPatch, width: int
) -> None:
    touched.header = {"state": "running", "message": "", "demo": False, "mode": "16T", **AS_USUAL}
    touched.header["gesture"] = {"name": "push", "confidence": 0.97}
    publish, sure = touched.view.publish, {"confidence": 1.0}

    def calibrated(header: dict[str, Any], base: np.ndarray, image: np.ndarray) -> None:
        contacts = [contact | {"force": 1.234, "force_std": 0.21} | sure for contact in header["contacts"]]
        publish(header | {"contacts": contacts}, base, image)

    monkeypatch.setattr(touched.view, "publish", calibrated)
    reader = Reader(chromium, touched, viewport={"width": width, "height": 800})
    page = reader.page
    force, count = page.get_by_role("cell", name="1.2 ±0.2"), page.locator("#contact-count")
    expect(force).to_be_visible()
    expect(count).to_have_text("1 · push 97 %")
    touched.header["total_force"] = 3.46
    expect(count).to_have_text("1 · push 97 % · 3.5 N in all")
    colours = "([one, other]) => [one, other].map((id) => getComputedStyle(document.querySelector(id)).color)"
    places = ["#contacts tbody td.force", "#contact-count"]
    usual = page.evaluate(colours, places)
    sure["confidence"] = 0.6
    expect(count).to_have_attribute("data-doubtful", "true")
    assert not {*page.evaluate(colours, places)} & {*usual}
    assert len({*page.evaluate(colours, places)}) == 1  # both in the colour of doubt
    touched.header.update(state="lost", message="device lost: cable; reconnecting")
    expect(page.locator("#no-contacts")).to_have_text("Unknown")
    expect(force).to_have_count(0)
    expect(count).to_have_text("")
    page.wait_for_timeout(500)  # it fades
    for part in ("#spark", "#section-x", "#section-y"):  # the map has a sentence over it
        shown = np.asarray(Image.open(io.BytesIO(page.locator(part).screenshot())).convert("RGB")).astype(int)
        assert colourful(shown) < 10
    reader.close()


@pytest.mark.parametrize("width", [320, 390, 1024])
@pytest.mark.parametrize("force", [False, True])
def test_columns_do_not_collide(
    chromium: Browser, touched: SyntheticLoop, monkeypatch: pytest.MonkeyPatch, width: int, force: bool
) -> None:
    touched.header = {"state": "running", "message": "", "demo": False, "mode": "16T", **AS_USUAL}
    publish = touched.view.publish

    def felt(header: dict[str, Any], base: np.ndarray, image: np.ndarray) -> None:
        known = {"x": 0.1198, "y": 0.1198, "confidence": 1.0} | ({"force": 16.04, "force_std": 12.9} if force else {})
        publish(header | {"contacts": [contact | known for contact in header["contacts"]]}, base, image)

    monkeypatch.setattr(touched.view, "publish", felt)
    reader = Reader(chromium, touched, viewport={"width": width, "height": 800})
    page = reader.page
    expect(page.get_by_role("cell", name="119.8")).to_have_count(2)
    expect(page.get_by_role("cell", name="16.0 ±12.9")).to_have_count(int(force))
    found = page.evaluate(
        """() => [...document.querySelectorAll("#contacts tr")].flatMap((row) => {
            const boxes = [...row.cells].filter((cell) => cell.offsetWidth).map((cell) => {
                const range = document.createRange();
                range.selectNodeContents(cell);
                return [cell.textContent, range.getBoundingClientRect()];
            });
            const end = document.getElementById("contacts").parentElement.getBoundingClientRect().right + 1;
            return boxes.filter(([, box], k) => box.right > (boxes[k + 1]?.[1].left - 3 || end)).map(([text]) => text);
        })"""
    )
    assert found == []
    reader.close()


def test_a_recording_is_known_by_its_file_and_has_an_end(chromium: Browser) -> None:
    setup = make_setup(virtual=False) | {"recording": {"length": 12.0}}
    setup["device"]["url"] = "touch.mcap"
    loop = SyntheticLoop(setup)
    loop.header["recording"] = {"position": 2.44, "length": 12.0, "speed": 1.0, "loop": False, "ended": False}
    reader = Reader(chromium, loop)
    page = reader.page
    expect(page.locator("#device")).to_have_text("touch.mcap")
    expect(page.locator("#calibrate")).to_be_hidden()
    loop.header["state"] = "paused"
    expect(page.locator("#notice")).to_have_text("Paused. Showing 2.44 s of 12.00 s.")
    loop.header["recording"] |= {"position": 12.0, "ended": True}
    expect(page.locator("#state")).to_have_text("end")
    expect(page.locator("#notice")).to_have_text("End of the recording. “Play” starts it again.")
    loop.header["state"] = "calibrating"
    expect(page.locator("#notice")).to_have_text("Reading the calibration of the recording.")
    expect(page.get_by_text("untouched")).to_have_count(0)
    reader.close()
    loop.close()


def test_rows_and_cross_sections_stay_while_contacts_are_nearly_as_strong(
    reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, publish = reader.page, reader.loop.view.publish
    shares = {1: 1.0, 2: 0.9}

    def felt(header: dict[str, Any], base: np.ndarray, image: np.ndarray) -> None:
        (contact,) = header["contacts"]
        contacts = [contact | {"id": k, "strength": share * contact["strength"]} for k, share in shares.items()]
        contacts.sort(key=lambda one: -one["strength"])  # as the loop sends them
        publish(header | {"contacts": contacts}, base, image)

    monkeypatch.setattr(reader.loop.view, "publish", felt)
    through, ids = page.locator("#section-of"), page.locator("#contacts td:first-child")
    expect(ids).to_have_text(["1", "2"])
    expect(through).to_have_text("through contact 1")
    shares[2] = 1.1
    expect(page.locator("#contacts tr", has_text="1.98")).to_have_count(1)
    expect(ids).to_have_text(["1", "2"])
    expect(through).to_have_text("through contact 1")
    shares[2] = 1.3
    expect(through).to_have_text("through contact 2")
    expect(ids).to_have_text(["1", "2"])


def test_a_gesture_stands_beside_the_number_of_contacts_unless_it_is_unknown(reader: Reader) -> None:
    count, header = reader.page.locator("#contact-count"), reader.loop.header
    expect(count).to_have_text("1")
    header["gesture"] = {"name": "stroke", "confidence": 0.97}
    expect(count).to_have_text("1 · stroke 97 %")
    header["gesture"] = {"name": "unknown", "confidence": 0.6}
    expect(count).to_have_text("1")


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (1920, 1080)])
def test_the_whole_page_fits_the_window(chromium: Browser, touched: SyntheticLoop, width: int, height: int) -> None:
    touched.header = {"state": "running", "message": "", "demo": False, "mode": "16O", **AS_USUAL}
    reader = Reader(chromium, touched, viewport={"width": width, "height": height})
    expect(reader.page.locator("#clear")).to_be_visible()
    assert reader.page.evaluate("document.documentElement.scrollHeight") == height
    reader.close()


@pytest.mark.parametrize(("width", "times", "lines"), [(320, 1, 3), (1440, 1, 1), (320, 2, 5), (1000, 3, 3)])
def test_a_notice_is_whole_and_stands_in_the_middle_of_its_line(
    chromium: Browser, touched: SyntheticLoop, width: int, times: int, lines: int
) -> None:
    touched.header = {"state": "running", "demo": False, "mode": "16T", **AS_USUAL}
    told = "electrode 6: open: almost no current flows when it is driven; check its wire; left out"
    touched.header["message"] = message = "; ".join([told] * times)
    reader = Reader(chromium, touched, viewport={"width": width, "height": 800})
    expect(reader.page.locator("#notice")).to_have_text(f"E{message[1:]}.")  # not that of a frame before
    expect(reader.page.locator("#notice")).to_have_attribute("data-kind", "warn")
    above, below, rows = reader.page.evaluate(
        """() => {
            const notice = document.getElementById("notice"), range = document.createRange();
            range.selectNodeContents(notice);
            const [text, box] = [range.getBoundingClientRect(), notice.getBoundingClientRect()];
            const tops = new Set([...range.getClientRects()].map((rect) => Math.round(rect.top)));
            return [text.top - box.top, box.bottom - text.bottom, tops.size];
        }"""
    )
    assert above == pytest.approx(below, abs=1.5)
    assert above > 2
    assert rows == lines
    reader.close()


def test_the_last_minute_is_kept_with_its_doubts(reader: Reader) -> None:
    past = """
        const { Past } = await import("/static/past.js");
        const past = new Past(), sure = { id: 4, confidence: 1 }, unsure = { id: 7, confidence: 0.5 };
        for (let t = 0; t < 40; t += 0.1) past.add(t, t < 20 ? [sure] : [sure, unsure], false, t < 5);
        for (let t = 40; t < 70; t += 0.1) past.add(t, [sure], true, false);
        return [past.contacts, past.bars.map((bar) => [bar.kind, bar.lane, Math.round(bar.from), Math.round(bar.to)])];
    """
    count, bars = run(reader.page, past)
    assert count == 2
    assert sorted(bars, key=str) == [["contact", 0, 0, 40], ["unknown", None, 40, 70], ["unsure", 1, 20, 40]]
    expect(reader.page.locator("#past")).to_have_attribute("aria-label", "The last minute: 1 contact")
    box = reader.page.locator("#past").bounding_box()
    assert box is not None
    assert colourful(pixels(reader.page, x=box["x"] + box["width"] - 30, y=box["y"], width=28, height=12)) > 80
