"""Electrodes are placed by clicking on a skin in space, and the skin file has them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_accessible import SCREENS, violations
from waiting import until

from ohmskin.errors import SkinError
from ohmskin.skin import Skin
from ohmskin.skin.layout import ElectrodeLayout
from ohmskin.skin.sheet import Sheet
from ohmskin.view.placing import ElectrodePlacement, PlacementPage

HOLED = Skin(
    "holed",
    Sheet(shape="cylinder", radius=0.05, height=0.15, angle=3.0, holes=((0.08, 0.075, 0.015),)),
    ElectrodeLayout(layout="even", count=8),
)


def placed(page: ElectrodePlacement, *words: str) -> dict[str, Any]:
    for one in words:
        page.command(one)
    return page.state()


def test_places_near_a_rim_go_onto_it_and_the_skin_file_is_written(tmp_path: Path) -> None:
    page = ElectrodePlacement(HOLED, tmp_path / "skin.toml")
    assert len(page.state()["electrodes"]) == 8
    told = placed(page, "clear")
    assert told["electrodes"] == []
    assert not told["savable"]
    assert "at least 4" in told["note"]
    width = HOLED.domain.bounds[2]
    told = placed(page, "place 0.001 0.001", f"place {width - 0.002} 0.07", "place 0.06 0.149", "place 0.03 0.03")
    assert "3 of 4 electrodes are on the rim; a base scan needs 4" in told["note"]
    x, y, z = HOLED.chart.points([(0.1, 0.148)])[0]
    told = placed(page, f"click {x} {y} {z}")
    assert told["savable"]
    assert not told["note"]
    np.testing.assert_allclose([told["electrodes"][0][axis] for axis in "xy"], 0, atol=1e-9)
    placed(page, "save")
    skin = Skin.load(tmp_path / "skin.toml")
    assert skin.sheet == HOLED.sheet
    assert skin.electrode.layout == "listed"
    expected = [[0, 0], [width, 0.07], [0.1, 0.15], [0.06, 0.15], [0.03, 0.03]]
    np.testing.assert_allclose(skin.electrodes.positions, expected, atol=1e-6)
    skin.mesh()
    assert len(placed(page, "remove 4")["electrodes"]) == 4


def test_a_place_that_cannot_be_is_refused_in_words(tmp_path: Path) -> None:
    page = ElectrodePlacement(HOLED, tmp_path / "skin.toml")
    assert "off the sheet or in a hole" in placed(page, "place 0.08 0.075")["note"]
    assert "off the sheet" in placed(page, "place 0.5 0.07")["note"]
    assert "y from 0.0 to 150.0 mm" in placed(page, "place 0.5 0.07")["note"]
    x, y = HOLED.electrodes.positions[0] + [0.0, 0.0045]
    assert "would overlap electrode 0" in placed(page, f"place {x} {y}")["note"]
    assert len(page.state()["electrodes"]) == 8
    page = ElectrodePlacement(HOLED, tmp_path)
    assert "cannot write" in placed(page, "save")["note"]
    for words in ("", "place 1", "place a b", "click 1 2", "remove 99", "place nan 0", "place 1e9 0", "bite"):
        with pytest.raises((ValueError, IndexError)):
            page.command(words)


def test_a_place_round_a_sleeve_is_within_a_turn_and_the_seam_is_crossed(tmp_path: Path) -> None:
    sleeve = replace(HOLED, sheet=Sheet(shape="cylinder", radius=0.05, height=0.15))
    page, turn = ElectrodePlacement(sleeve, tmp_path / "skin.toml"), sleeve.domain.period
    for x in (5.0, -999.0, 2.1 * turn):
        assert "x from 0.0 to 314.2 mm" in placed(page, f"place {x} 0.07")["note"]
        listed = ElectrodeLayout("listed", positions=((0.0, 0.0), (0.1, 0.0), (0.2, 0.0), (0.1, 0.15), (x, 0.07)))
        with pytest.raises(SkinError, match="off the sheet"):
            replace(sleeve, electrode=listed)
    found = placed(page, "clear", "place -0.01 0.07")["electrodes"]
    np.testing.assert_allclose([(one["x"], one["y"]) for one in found], [(turn - 0.01, 0.07)])


def test_a_skin_file_that_was_there_is_kept(tmp_path: Path) -> None:
    target = tmp_path / "skin.toml"
    target.write_text("# dear comments", encoding="utf-8")
    assert (
        "the one that was there is now skin-before-1.toml" in placed(ElectrodePlacement(HOLED, target), "save")["saved"]
    )
    assert (tmp_path / "skin-before-1.toml").read_text(encoding="utf-8") == "# dear comments"
    assert Skin.load(target).electrode.layout == "listed"


def test_clicks_on_the_page_place_electrodes_by_surface_coordinates(tmp_path: Path, chromium: Any) -> None:
    """The camera looks at the middle of the skin; on its rims and beside the hole it is clicked, and once dragged."""
    target = tmp_path / "clicked.toml"
    with PlacementPage(HOLED, target, port=0) as placing:
        page = chromium.new_page(viewport={"width": 1000, "height": 700})
        page.goto(placing.url)
        until(lambda: page.evaluate("ohmskin.state?.electrodes.length === 8 && ohmskin.body?._fitted > 0"))
        page.get_by_role("button", name="Remove all").click()
        until(lambda: page.evaluate("ohmskin.state.electrodes.length === 0"))
        assert page.get_by_role("button", name="Save").is_disabled()
        width, height = HOLED.domain.bounds[2:]
        wanted = [(0.06, 0.0), (0.12, 0.0), (width, 0.06), (0.1, height), (0.05, 0.1), (0.11, 0.06)]
        for count, place in enumerate(wanted, 1):
            inner = np.clip(place, 0.0015, [width - 0.0015, height - 0.0015])
            point = HOLED.chart.points([inner])[0].tolist()
            at = page.evaluate("(at) => ohmskin.body.place('skin', at)", point)
            box = page.locator("#space").bounding_box()
            page.mouse.click(box["x"] + at["x"], box["y"] + at["y"])
            until(lambda count=count: page.evaluate("ohmskin.state.electrodes.length") == count)
        where = "ohmskin.body.camera.position.toArray()"
        camera = page.evaluate(where)
        page.mouse.move(box["x"] + at["x"], box["y"] + at["y"] - 40)
        page.mouse.down()
        page.mouse.move(box["x"] + at["x"] + 60, box["y"] + at["y"], steps=5)
        page.mouse.up()
        until(lambda: np.abs(np.subtract(page.evaluate("ohmskin.body.camera.position.toArray()"), camera)).max() > 0.01)
        assert page.evaluate("ohmskin.state.electrodes.length") == len(wanted)  # a drag turns, and places nothing
        page.locator("#x").fill("60")
        page.locator("#y").fill("40")
        page.get_by_role("button", name="Place", exact=True).click()
        until(lambda: page.evaluate("ohmskin.state.electrodes.length") == len(wanted) + 1)
        page.get_by_role("button", name="Remove electrode 6").click()
        until(lambda: page.evaluate("ohmskin.state.electrodes.length") == len(wanted))
        page.get_by_role("button", name="Save").click()
        until(lambda: page.locator("#note").text_content().startswith("Saved"))
        page.close()
    skin = Skin.load(target)
    found = skin.electrodes.positions
    for place in wanted:
        assert np.linalg.norm(found - place, axis=1).min() < 2e-3
    on_rim = np.abs(skin.domain.depth(found)) < 1e-6
    assert on_rim.sum() == 4


@pytest.mark.parametrize("screen", SCREENS)
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_everyone_can_place_electrodes(chromium: Any, theme: str, screen: str, tmp_path: Path) -> None:
    with PlacementPage(HOLED, tmp_path / "skin.toml", port=0) as placing:
        context = chromium.new_context(color_scheme=theme, **SCREENS[screen])
        page, said = context.new_page(), list[str]()
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(placing.url)
        until(lambda: page.evaluate("ohmskin.state?.electrodes.length === 8"))
        page.get_by_role("button", name="Remove all").click()
        until(lambda: page.locator("#note").is_visible())
        page.get_by_role("button", name="Place", exact=True).scroll_into_view_if_needed()
        assert violations(page) == []
        assert said == []
        context.close()
