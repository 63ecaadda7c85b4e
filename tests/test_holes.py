"""Holes in sheets of any shape: meshes, electrodes, contacts, pages and cutting patterns keep out of them."""

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin.client.contacts import Patch
from ohmskin.contacts import in_frame
from ohmskin.contacts.kernels import all_onto
from ohmskin.device.demo import demo_finger
from ohmskin.drive import LayoutSearch
from ohmskin.engine import Engine
from ohmskin.errors import SkinError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Chart, Electrodes, MeshChart, mesh_domain
from ohmskin.geometry.holes import Holed, clipped
from ohmskin.geometry.periodic import shortest
from ohmskin.geometry.wrap import seam_of
from ohmskin.outlets.publisher import describe_domain
from ohmskin.plot.pattern import Pattern
from ohmskin.plot.picture import outline
from ohmskin.scan import skip
from ohmskin.skin import Skin, VirtualSkin
from ohmskin.skin.layout import ElectrodeLayout
from ohmskin.skin.sheet import Sheet

EVEN = ElectrodeLayout(layout="even")
TRIANGLE = ((0.03, 0.15), (0.06, 0.15), (0.045, 0.18))
SHEETS = {
    "rectangle": Sheet(holes=((0.1, 0.1, 0.02), TRIANGLE)),
    "disc": Sheet(shape="disc", holes=((0.02, 0.01, 0.015),)),
    "polygon": Sheet(
        shape="polygon", outline=((0, 0), (0.2, 0), (0.2, 0.1), (0.1, 0.1), (0, 0.2)), holes=((0.05, 0.05, 0.015),)
    ),
    "sleeve": Sheet(shape="cylinder", radius=0.045, height=0.142, holes=((0.0, 0.07, 0.02), (0.12, 0.05, 0.012))),
    "cone": Sheet(shape="cone", radius=0.06, top_radius=0.03, height=0.138, angle=3.0, holes=((0.05, 0.07, 0.015),)),
    "dome": Sheet(shape="sphere", radius=0.1, angle=1.2, holes=((0.03, 0.01, 0.015),)),
}


def in_hole(sheet: Sheet) -> np.ndarray:
    """The middle of its first hole."""
    return np.array([sheet.holes[0][:2]], float)


@pytest.mark.parametrize("name", SHEETS)
def test_the_meshes_of_a_sheet_have_its_holes(name: str) -> None:
    skin = Skin(name, SHEETS[name], EVEN)
    plain = Skin(name, Sheet(**{**vars(SHEETS[name]), "holes": ()}), EVEN)
    assert skin.domain.depth(in_hole(skin.sheet))[0] < -0.01
    for mesh in (skin.mesh(), skin.mesh_for(skin.discs, 4e-3)):
        assert mesh.locate(in_hole(skin.sheet))[0][0] == -1
        sagitta = 1e-3 if name in ("disc", "dome") else 1e-9
        assert mesh.measures.sum() == pytest.approx(skin.domain.area, rel=sagitta)
    removed = plain.domain.area - skin.domain.area
    scale = float(skin.chart.scale(in_hole(skin.sheet))[0])
    first = np.pi * (skin.sheet.holes[0][2] / scale) ** 2
    others = {"rectangle": 0.5 * 0.03 * 0.03, "sleeve": np.pi * 0.012**2}.get(name, 0.0)
    assert removed == pytest.approx(first + others, rel=1e-3)
    assert len(skin.electrodes) == 16
    assert skin.domain.depth(skin.electrodes.positions).min() > -1e-6
    again = Skin.parse(skin.dump())
    assert (again, again.digest) == (skin, skin.digest)
    assert skin.digest != plain.digest


def spots(chart: Chart) -> Electrodes:
    """Sixteen places by chance, apart from each other and from all rims."""
    x0, y0, x1, y1 = chart.domain.bounds
    places = np.random.default_rng(1).uniform([x0, y0], [x1, y1], (2000, 2))
    kept = list[np.ndarray]()
    for place in places[chart.domain.depth(places) > 0.014]:
        if all(np.linalg.norm(shortest(place - other, chart.domain.period)) > 0.025 for other in kept):
            kept.append(place)
    return Electrodes.at(np.array(kept[:16]))


@pytest.mark.parametrize("x", [0.0, 0.06])
def test_a_ring_of_triangles_keeps_the_holes_in_its_wall(x: float) -> None:
    """One beside the seam and one across it; resistances are those of the sleeve that is known in closed form."""
    exact = Sheet(shape="cylinder", radius=0.045, height=0.142, holes=((x, 0.07, 0.02), (0.18, 0.05, 0.012))).chart
    chart = MeshChart(mesh_domain(exact.domain, 5e-3).mapped(exact.points))
    assert isinstance(chart.domain, Holed)
    assert chart.domain.period
    assert chart.domain.area == pytest.approx(exact.domain.area, rel=2e-3)
    there = spots(exact)
    here = there.mapped(lambda places: chart.project(exact.points(places))[0])
    pattern, volts = skip([range(16)], 5), []
    for domain, electrodes in ((exact.domain, there), (chart.domain, here)):
        volts.append(TransferModel(mesh_domain(domain, 5e-3, electrodes.positions), electrodes, 1e-3).voltages(pattern))
    np.testing.assert_allclose(volts[1], volts[0], atol=2e-3 * np.abs(volts[0]).max())
    whole = Sheet(shape="cylinder", radius=0.045, height=0.142).chart.domain
    shut = TransferModel(mesh_domain(whole, 5e-3, there.positions), there, 1e-3).voltages(pattern)
    assert np.abs(shut - volts[0]).max() > 0.02 * np.abs(volts[0]).max()


@pytest.mark.parametrize("name", ["sleeve", "dome"])
def test_a_press_beside_a_hole_is_felt_there_and_none_is_told_in_it(name: str) -> None:
    skin = Skin(name, SHEETS[name], EVEN)
    engine = Engine(lambda: DirectDevice(VirtualSkin(skin, seed=1)), skin, "16P")
    engine.calibrate()
    (x, y), radius = in_hole(skin.sheet)[0], skin.sheet.holes[0][2]
    with pytest.raises(SkinError, match="off the sheet"):
        VirtualSkin(skin, seed=1).press(0, x, y, 8e-3, 15e3)
    scale = float(skin.chart.scale([[x, y]])[0])
    for turn in (0.4, 2.5, 4.6):
        place = np.array([x, y]) + (radius + 0.012) / scale * np.array([np.cos(turn), np.sin(turn)])
        engine.press(0, tuple(place.tolist()), 8e-3, 15e3)
        touches = [engine.step() for _ in range(10)]
        assert touches[-1] is not None
        (felt,) = in_frame(touches[-1].contacts, skin.chart, Patch())
        assert np.linalg.norm(np.array(felt.position) - skin.chart.points(place)[0]) < 4e-3
        engine.press(0, tuple(place.tolist()), 8e-3, 0.0)
        for _ in range(12):
            engine.step()


def test_fits_move_what_is_deep_in_a_hole_onto_the_sheet_also_across_the_seam() -> None:
    skin = Skin("sleeve", SHEETS["sleeve"], EVEN)
    table = skin.contact_table(skin.transfer_model())
    around = skin.domain.period
    places = np.array([[0.001, 0.07], [around - 0.001, 0.071], [0.12, 0.05], [0.2, 0.1]])
    moved = places.copy()
    all_onto(moved, table.sheet)
    assert (skin.domain.depth(places[:3]) < -0.01).all()
    assert (skin.domain.depth(moved) > -table.radius).all()
    assert skin.domain.depth(moved[:2]).min() > -2e-3
    np.testing.assert_array_equal(moved[3], places[3])
    nowhere = np.array([[np.nan, 0.07], [0.12, np.nan]])
    all_onto(nowhere, table.sheet)
    assert np.isnan(nowhere).any(axis=1).all()
    assert skin.domain.depth(table.places).min() > -table.radius / 2


def test_layouts_are_searched_around_holes() -> None:
    domain = SHEETS["sleeve"].chart.domain
    found = LayoutSearch(domain, 1.83e-3, 12e-3, 8e-3, 2e-4, 28).best(4)
    assert domain.depth(found.positions).min() > -1e-6
    assert len(found.rings[0]) >= 4
    places = [demo_finger(domain, 0.25 * k)[0] for k in range(800)]
    assert domain.depth(places).min() >= 0


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("holes = [[0.1, 0.19, 0.02]]", "hole 0 is not inside the sheet"),
        ("holes = [[0.1, 0.1, 0.02], [0.11, 0.1, 0.02]]", "holes 0 and 1 overlap"),
        ("holes = [[0.1, 0.1, 0.03], [0.1, 0.1, 0.01]]", "holes 0 and 1 overlap"),
        ("holes = [[0.1, 0.1, 0.0]]", "radius of 0 m; it must be positive"),
        ("holes = [[0.1, 0.1]]", r"list of holes, each \[x, y, radius\]"),
        ("holes = [0.1]", r"list of holes, each \[x, y, radius\]"),
        ("holes = [[[0.1, 0.1], [0.12, 0.12], [0.12, 0.1], [0.1, 0.12]]]", "hole 0: .*cross"),
        ('shape = "polygon"', 'outline and shape = "polygon" go together'),
        ("outline = [[0, 0], [1, 0], [0, 1]]", 'outline and shape = "polygon" go together'),
        ("holes = [[0.0667, 0.0667, 0.01]]", "electrode .* of the grid is at .* m inside a hole; move it or the hole"),
    ],
)
def test_a_hole_that_cannot_be_is_refused_in_words(text: str, told: str) -> None:
    with pytest.raises(SkinError, match=told):
        Skin.parse(f"[sheet]\n{text}")


def test_a_listed_electrode_in_a_hole_is_refused_in_words() -> None:
    places = [[0.0, 0.0], [0.2, 0.0], [0.2, 0.2], [0.0, 0.2], [0.1, 0.105]]
    text = f"[sheet]\nholes = [[0.1, 0.1, 0.02]]\n[electrode]\nlayout = 'listed'\npositions = {places}"
    with pytest.raises(SkinError, match=r"electrode.positions\[4\] is \[0.1, 0.105\], 0.01.. m inside a hole"):
        Skin.parse(text)
    assert len(Skin.parse(text.replace("0.105", "0.15")).electrodes) == 5


def test_pages_and_pictures_are_told_of_holes() -> None:
    """One that lies across the seam of a sleeve is told in two parts."""
    told = describe_domain(Skin("sleeve", SHEETS["sleeve"], EVEN))
    assert told["kind"] == "band"
    ends = sorted((min(x for x, _ in hole), max(x for x, _ in hole)) for hole in told["holes"])
    around = told["width"]
    np.testing.assert_allclose(ends, [(0, 0.02), (0.108, 0.132), (around - 0.02, around)], atol=2e-4)
    assert describe_domain(Skin.load("sleeve"))["holes"] == []
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    np.testing.assert_allclose(np.ptp(clipped(square, 0.25, 0.75), axis=0), [0.5, 1.0])
    assert len(clipped(square, 2.0, 3.0)) == 0
    line = outline(SHEETS["dome"].chart.domain)
    assert np.isnan(line).any()
    assert np.nanmin(np.hypot(*(line / 1e3 - in_hole(SHEETS["dome"])).T)) < 0.016


def test_cutting_patterns_have_holes_and_no_seam_through_one() -> None:
    pattern = Pattern.of(Skin("sleeve", SHEETS["sleeve"], EVEN))
    assert pattern.developable
    assert pattern.mesh.measures.sum() == pytest.approx(SHEETS["sleeve"].chart.domain.area, rel=1e-6)
    for edge in pattern.seam:
        assert np.ptp(edge[:, 1]) == pytest.approx(0.142)
    aside = Sheet(shape="cylinder", radius=0.045, height=0.142, holes=((0.12, 0.05, 0.012),)).chart.domain
    assert seam_of(aside) == 0.0
    seam = seam_of(SHEETS["sleeve"].chart.domain)
    assert 0.15 < seam < 0.25  # between both holes, the long way
    dome = Pattern.of(Skin("dome", SHEETS["dome"], EVEN))
    assert not dome.developable
    assert dome.mesh.n_nodes - (3 * dome.mesh.n_elem + len(dome.mesh.boundary)) / 2 + dome.mesh.n_elem == 0  # one hole


def test_a_wrapped_sheet_with_a_hole_is_strained_as_one_without() -> None:
    wrapped = Sheet(**{**vars(SHEETS["dome"]), "wrapped": True})
    shut = Sheet(**{**vars(wrapped), "holes": ()})
    places = np.array([[0.0, -0.03], [0.06, 0.05]])
    np.testing.assert_allclose(wrapped.strained(places), shut.strained(places), rtol=1e-9)
    assert wrapped.strained(places).std() > 0.01
