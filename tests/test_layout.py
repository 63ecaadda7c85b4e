"""Electrode layouts: the quick error of a layout, the search for better ones, skins with listed electrodes, `ohmskin
layout`."""

import json
import re
from functools import lru_cache
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest
from command_line import ohmskin

from ohmskin.cli.layout import layout
from ohmskin.drive import Candidates, ContactPrior, LayoutSearch, arranged, complete_pattern
from ohmskin.drive.bound import contact_columns, position_bound
from ohmskin.errors import GeometryError, OhmskinError, SkinError
from ohmskin.forward import ContactTable, TransferModel
from ohmskin.geometry import Disc, Electrodes, FlatChart, Polygon, Rectangle, mesh_domain
from ohmskin.geometry.periodic import shortest
from ohmskin.geometry.spread import spread
from ohmskin.sensing import modes
from ohmskin.skin import Skin
from ohmskin.skin.sheet import Sheet

SHEET = Rectangle(0.2, 0.2)
NOISE, RADIUS, INJECTIONS = 2.5e-4, 8e-3, 28


@lru_cache
def search() -> LayoutSearch:
    return LayoutSearch(SHEET, 1.83e-3, 6e-3, RADIUS, NOISE, INJECTIONS)


def run(*arguments: str, cwd: Path) -> "CompletedProcess[str]":
    return ohmskin("layout", *arguments, cwd=cwd)


def sites_of(positions: np.ndarray) -> np.ndarray:
    """The sites closest to positions, in the order in which electrodes are numbered."""
    sites = search().sites
    closest = np.linalg.norm(sites[:, None] - positions, axis=2).argmin(axis=0)
    numbered = arranged(SHEET, sites[closest]).positions
    return np.array([np.linalg.norm(sites - place, axis=1).argmin() for place in numbered])


# --- the search -------------------------------------------------------------------------------------------------------


def test_the_quick_error_of_a_layout_is_that_of_a_contact_table_on_a_mesh_of_its_own() -> None:
    """All injections of the complete pattern, each counted 28 / 120; two meshes differ by some per cent of the
    error."""
    electrodes = Electrodes.grid(SHEET)
    table = ContactTable(TransferModel(mesh_domain(SHEET, 5e-3, electrodes.positions), electrodes, 1.83e-3), RADIUS)
    rows = Candidates.at_currents(complete_pattern(16), 16, NOISE).rows(
        contact_columns(table, ContactPrior.usual(RADIUS).at(search().places))
    )
    information = np.einsum("unmd,unme->ude", rows, rows) * INJECTIONS / 120 + np.linalg.inv(
        ContactPrior.usual(RADIUS).covariance()
    )
    true = np.sqrt(np.trace(np.linalg.inv(information)[:, :2, :2], axis1=1, axis2=2))
    found = search().errors(sites_of(electrodes.positions))
    ratio = found / true
    assert np.median(np.abs(ratio - 1)) < 0.06
    assert ratio.mean() == pytest.approx(1.0, abs=0.05)


def test_mirrored_layouts_have_mirrored_errors_and_the_places_of_a_quarter_stand_for_all() -> None:
    """Electrodes in one corner: a contact there is located well, one in the opposite corner badly, and the other way
    round."""
    x, y = search().sites.T
    near = np.flatnonzero((x < 0.1) & (y < 0.1))[::4]
    far = np.array([np.argmin(np.hypot(x - (0.2 - x[k]), y - (0.2 - y[k]))) for k in near])
    here, there = search().errors(near).mean(), search().errors(far).mean()
    assert here < 0.3 * there
    orbit = search().orbits
    assert sorted(int(k) for one in orbit for k in one) == list(range(len(x)))
    for one in orbit:
        assert len({(round(abs(x[k] - 0.1), 9), round(abs(y[k] - 0.1), 9)) for k in one}) == 1


def test_the_layout_found_is_better_than_the_papers_and_no_single_exchange_improves_it() -> None:
    best = search().best(16)
    assert len(best) == 16
    np.testing.assert_array_equal(best.positions, search().best(16).positions)
    errors = search().errors(sites_of(best.positions))
    for usual in (Electrodes.grid(SHEET), Electrodes.rim(SHEET, 16)):
        assert errors.max() < 0.6 * search().errors(sites_of(usual.positions)).max()
        assert errors.mean() < search().errors(sites_of(usual.positions)).mean()
    chosen = {int(k) for k in sites_of(best.positions)}
    kept = [one for one in search().orbits if set(one.tolist()) <= chosen]
    assert sum(len(one) for one in kept) == 16  # mirror images are all there

    def score(orbits: list[np.ndarray]) -> float:
        sites = sites_of(search().sites[np.concatenate(orbits)])
        return float(np.mean(search().errors(sites) ** 16)) if search().on_rim[sites].sum() >= 4 else np.inf

    now = score(kept)
    for out in range(len(kept)):
        for other in search().orbits:
            if len(other) == len(kept[out]) and not set(other.tolist()) & chosen:
                assert score([*kept[:out], other, *kept[out + 1 :]]) >= now * (1 - 1e-9)


CURVED = {
    "sleeve": Sheet(shape="cylinder", radius=0.045, height=0.142),
    "cone": Sheet(shape="cone", radius=0.06, top_radius=0.03, height=0.138),
    "triangle": Polygon([[0, 0], [0.2, 0], [0.1, 0.2]], [[[0.09, 0.08], [0.11, 0.08], [0.1, 0.1]]]),
}


@pytest.mark.parametrize("name", CURVED)
def test_layouts_of_curved_and_odd_skins_are_better_than_even_ones(name: str) -> None:
    """Judged by contact tables on other meshes, with all that a complete scan says, in metres on the skin."""
    shape = CURVED[name]
    chart = FlatChart(shape) if isinstance(shape, Polygon) else shape.chart
    found = LayoutSearch(chart.domain, 1e-3, 9e-3, RADIUS, NOISE, INJECTIONS, scale=chart.scale)
    best = found.best(12)
    worst = []
    for electrodes in (best, arranged(chart.domain, spread(chart.domain, 12, chart.scale))):
        mesh = mesh_domain(chart.domain, 5e-3, electrodes.positions)
        table = ContactTable(TransferModel(mesh, electrodes, 1e-3), RADIUS)
        places = (found.places, complete_pattern(electrodes), NOISE)
        worst.append(position_bound(table, *places, scale=chart.scale(found.places)).max())
    assert worst[0] < 0.97 * worst[1]
    if name == "sleeve":  # alike on both sides of the seam, and of the middle
        mirrored = np.array([chart.domain.period, 0.142]) - best.positions
        away = shortest(mirrored[:, None] - best.positions, chart.domain.period)
        assert np.linalg.norm(away, axis=2).min(axis=1).max() < 1e-6


def test_a_bound_is_in_metres_on_the_skin() -> None:
    """A map half as large, of the same skin, has the same one."""
    bounds = []
    for half in (1.0, 0.5):
        sheet = Rectangle(0.2 * half, 0.2 * half)
        electrodes = Electrodes.grid(sheet)
        model = TransferModel(mesh_domain(sheet, 6e-3 * half, electrodes.positions), electrodes, 1e-3)
        table = ContactTable(model, RADIUS * half, 2.5e-3 * half)
        places = half * np.array([[0.05, 0.05], [0.11, 0.07]])
        prior, scale = ContactPrior.usual(RADIUS), 1 / half
        bounds.append(position_bound(table, places, complete_pattern(16), NOISE, prior=prior, scale=scale))
    np.testing.assert_allclose(bounds[1], bounds[0], rtol=1e-3)


@pytest.mark.parametrize("count", [4, 7, 13])
def test_any_number_of_electrodes_can_be_placed_and_more_are_better(count: int) -> None:
    best, more = search().best(count), search().best(count + 4)
    assert (len(best), len(more)) == (count, count + 4)
    assert len(best.rings[0]) >= 4
    assert search().errors(sites_of(more.positions)).max() < search().errors(sites_of(best.positions)).max()


def test_discs_and_oblong_sheets_can_be_searched() -> None:
    for domain in (Disc(0.1), Rectangle(0.3, 0.15)):
        found = LayoutSearch(domain, 1e-3, 9e-3, 8e-3, NOISE, 16)
        electrodes = found.best(8)
        assert domain.depth(electrodes.positions).min() > -1e-9
        assert (domain.depth(found.places) > 8e-3 - 1e-9).all()
    for count in (3, 100):
        with pytest.raises(GeometryError, match=f"{count} electrodes to place; between 4 and 84"):
            search().best(count)


def test_electrodes_are_numbered_round_the_rim_and_then_inside() -> None:
    grid = Electrodes.grid(SHEET)
    mixed = grid.positions[np.random.default_rng(0).permutation(16)]
    found = arranged(SHEET, mixed)
    np.testing.assert_allclose(found.positions, grid.positions, atol=1e-9)
    assert found.rings == grid.rings
    nudged = arranged(SHEET, mixed + 5e-7 * (np.abs(mixed - 0.1) > 0.09))
    np.testing.assert_allclose(SHEET.depth(nudged.positions[:12]), 0, atol=1e-12)
    with pytest.raises(GeometryError, match="3 of 5 electrodes are on the rim"):
        arranged(SHEET, np.array([[0, 0], [0.2, 0], [0.1, 0.2], [0.1, 0.1], [0.05, 0.1]]))


# --- skins with listed electrodes -------------------------------------------------------------------------------------

LISTED = """
imaging.pairs = 10
[electrode]
layout = "listed"
positions = [[0.0, 0.0], [0.2, 0.0], [0.2, 0.2], [0.0, 0.2], [0.1, 0.05], [0.1, 0.15]]
"""


def test_a_skin_can_list_its_electrodes() -> None:
    skin = Skin.parse(LISTED)
    assert skin.electrodes.rings == ((0, 1, 2, 3), (4, 5))
    assert Skin.parse(skin.dump()) == skin
    assert hash(skin) == hash(Skin.parse(LISTED))
    assert list(modes(skin)) == ["4B", "6I", "6O", "6P", "6T"]
    assert len(skin.pair_currents()) == 15


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[electrode]\nlayout = "listed"', "lists 0 electrodes; need at least 4"),
        (LISTED.replace("[0.1, 0.05]", "[0.1, 0.25]"), r"positions\[4\] is \[0.1, 0.25\], 0.05 m off the sheet"),
        (LISTED.replace("[0.1, 0.05]", "[0.1, 0.15]"), "at the same place"),
        (LISTED.replace("[0.0, 0.0]", "[0.1, 0.1]"), "3 of 6 electrodes are on the rim"),
        (LISTED.replace("[0.1, 0.05]", "[0.1]"), r"must be a list of \[x, y\] in metres"),
        (LISTED.replace("[0.1, 0.05]", "[0.1, nan]"), r"must be a list of \[x, y\] in metres"),
        (LISTED.replace("[0.1, 0.05]", '"here"'), r"must be a list of \[x, y\] in metres"),
        ('[electrode]\nlayout = "listed"\npositions = 4', r"must be a list of \[x, y\] in metres"),
        (LISTED.replace("listed", "rim"), 'the layout is "rim"; use layout = "listed"'),
    ],
)
def test_a_list_that_is_none_is_refused(text: str, message: str) -> None:
    with pytest.raises(SkinError, match=message):
        Skin.parse(text)


# --- the command ------------------------------------------------------------------------------------------------------


def test_the_command_draws_the_map_and_says_mean_and_worst(tmp_path: Path) -> None:
    result = run("--mode", "12B", "--noise", "50dB", "--output", "map.png", "--json-file", "map.json", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    told = json.loads((tmp_path / "map.json").read_text())
    (paper,) = told["layouts"]
    assert (paper["mode"], paper["injections"], len(paper["electrodes"])) == ("12B", 12, 16)
    errors = np.array(paper["errors"])
    assert len(paper["places"]) == len(errors) > 500
    assert paper["worst"] == errors.max() > paper["mean"] == pytest.approx(errors.mean())
    assert f"bound on the position error (Cramer-Rao): mean {1e3 * paper['mean']:.3g} mm" in result.stdout
    assert "12 injections (1.44 ms)" in result.stdout
    assert "no contact is found (reader: centroid)" in result.stdout or "error mean" in result.stdout
    assert len(paper["reached"]) == len(paper["reached_places"]) == 40
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


def test_a_better_layout_is_found_compared_and_saved_as_a_skin_that_loads(tmp_path: Path) -> None:
    arguments = (
        "--optimise",
        "12",
        "--mode",
        "16I",
        "--noise",
        "0.25mV",
        "--save",
        "better.toml",
        "--json-file",
        "both.json",
    )
    result = run(*arguments, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    told = json.loads((tmp_path / "both.json").read_text())
    paper, better = told["layouts"]
    assert told["noise"] == 0.25e-3
    skin = Skin.load(tmp_path / "better.toml")
    np.testing.assert_allclose(skin.electrodes.positions, better["electrodes"], atol=1e-9)
    assert (len(skin.electrodes), skin.name, better["mode"], paper["mode"]) == (12, "paper-12", "12I", "16I")
    assert skin.sheet == Skin.load("paper").sheet
    assert len(result.stdout.strip().splitlines()) == 8


def test_a_file_to_save_needs_a_search(tmp_path: Path) -> None:
    result = run("--contacts", "0", "--save", "x.toml", cwd=tmp_path)
    assert result.returncode == 2
    assert "--save has no effect without --optimise" in result.stderr


def test_beside_the_bound_is_what_the_reader_reaches(tmp_path: Path) -> None:
    """A fit errs about as much as the bound at the same places, and more with more noise."""
    shares, means = [], []
    for noise in ("0.1mV", "1mV"):
        arguments = ("--noise", noise, "--contacts", "30", "--json-file", "map.json")
        result = run(*arguments, cwd=tmp_path)
        assert result.returncode == 0, result.stderr
        assert "at 30 of these places, simulated with the same model: error mean" in result.stdout
        assert "(reader: fit" in result.stdout
        (paper,) = json.loads((tmp_path / "map.json").read_text())["layouts"]
        at = [paper["places"].index(place) for place in paper["reached_places"]]
        bound, reached = np.array(paper["errors"])[at], np.array(paper["reached"], float)
        shares.append(np.nanmedian(reached / bound))
        means.append(np.nanmean(reached))
    assert 0.5 < shares[0] < 2.5
    assert 0.5 < shares[1] < 2.5
    assert means[1] > 2 * means[0]
    assert run("--contacts", "-1", cwd=tmp_path).returncode == 2


def test_a_mistake_gets_one_line_and_no_traceback(tmp_path: Path) -> None:
    result = run("--noise", "loud", cwd=tmp_path)
    assert result.returncode == 2
    assert "--noise 'loud'; give volts such as 0.2mV" in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"mode": "99Z"}, "choose from 12B, 16I, 16O, 16P, 16T, best"),
        ({"mode": "16I", "injections": 20}, "has no choice of injections; it has 16"),
        ({"injections": 6}, "the base scan alone has 6, so give more"),
        ({"injections": -2}, "--injections -2"),
        ({"noise": "-3mV"}, "--noise '-3mV'"),
        ({"noise": "0"}, "--noise '0'"),
        ({"noise": "nandB"}, "--noise 'nandB'"),
        ({"radius": 60.0}, "--radius 60 mm"),
        ({"skin": "nosuch"}, "no skin named 'nosuch'"),
        ({"output": Path("nosuch/map.png")}, "cannot write nosuch/map.png"),
        ({"json_file": Path("nosuch/map.json")}, "cannot write nosuch/map.json"),
        ({"optimise": 500}, "500 electrodes to place"),
        ({"optimise": -5}, "-5 electrodes to place"),
    ],
)
def test_a_mistake_is_named(
    arguments: dict[str, Any], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OhmskinError, match=re.escape(says)):
        layout(**arguments)
