"""Where data come from: shapes, exact overlaps, noise, and the drives that are compared."""

import numpy as np
import pytest

from ohmskin.drive import LocalDrive
from ohmskin.errors import OhmskinError
from ohmskin.evaluate import worlds
from ohmskin.evaluate.assumptions import assumption
from ohmskin.evaluate.methods import METHODS, all_methods, bench, method
from ohmskin.evaluate.setup import Setup
from ohmskin.evaluate.shapes import SHAPES, Shape, disc
from ohmskin.geometry import Rectangle, mesh_domain
from ohmskin.geometry.overlap import disc_overlap
from ohmskin.scan import DrivePattern, Frame, adjacent
from ohmskin.skin import Press, PressedSheet, Skin


@pytest.mark.parametrize("radius", [0.2e-3, 3e-3, 20e-3, 0.09])
def test_overlap_of_a_disc_inside_the_sheet_is_its_area(radius: float) -> None:
    mesh = mesh_domain(Rectangle(0.2, 0.2), 7e-3)
    area = disc_overlap(mesh, [(0.1, 0.1), (0.0913, 0.1051)], radius)
    assert area.sum(axis=1) == pytest.approx(np.pi * radius**2, rel=1e-12)


def test_overlap_at_the_rim_and_in_a_corner_is_half_and_quarter() -> None:
    mesh = mesh_domain(Rectangle(0.2, 0.1), 7e-3)
    area = disc_overlap(mesh, [(0.08, 0.0), (0.2, 0.1), (0.3, 0.3)], 0.015).sum(axis=1)
    assert area == pytest.approx(np.pi * 0.015**2 * np.array([0.5, 0.25, 0]), rel=1e-12)


def test_overlap_of_each_triangle_against_counted_points() -> None:
    mesh, centre, radius = mesh_domain(Rectangle(0.1, 0.1), 12e-3), np.array([0.043, 0.058]), 0.02
    random = np.random.default_rng(1)
    weights = random.dirichlet((1, 1, 1), size=4000)
    points = np.einsum("pk,ekd->epd", weights, mesh.nodes[mesh.elements])
    share = (np.linalg.norm(points - centre, axis=2) < radius).mean(axis=1)
    assert disc_overlap(mesh, centre, radius).toarray()[0] / mesh.measures == pytest.approx(share, abs=0.03)


@pytest.mark.parametrize("kind", SHAPES)
def test_area_and_distance_of_a_shape_agree(kind: str) -> None:
    shape = Shape(kind, (0.1, 0.08), 0.03, 1.0)
    fine = (np.arange(800) + 0.5) * 0.2 / 800
    points = np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)
    away = shape.distance(points)
    assert (away <= 0).sum() * (0.2 / 800) ** 2 == pytest.approx(shape.area, rel=0.01)
    outside = points[away > 0][::997]
    inside = points[away <= 0]
    nearest = [np.linalg.norm(inside - point, axis=1).min() for point in outside]
    assert away[away > 0][::997] == pytest.approx(nearest, abs=0.3e-3)


def test_unknown_shapes_worlds_and_methods_are_refused_with_the_choices() -> None:
    with pytest.raises(OhmskinError, match="disc, square"):
        Shape("star", (0.1, 0.1), 0.01, 1.0)
    with pytest.raises(OhmskinError, match="out of range"):
        disc(0.1, np.nan, 0.01, 1.0)
    with pytest.raises(OhmskinError, match="discs, pressed"):
        worlds.sheet("real", "grid")
    with pytest.raises(OhmskinError, match="12B"):
        method("11B")
    with pytest.raises(OhmskinError, match="no square"):
        worlds.touched("discs", "grid", (Shape("square", (0.1, 0.1), 0.01, 1.0),))
    with pytest.raises(OhmskinError, match="0 to 200 dB"):
        worlds.noise_volts("discs", -3)


def test_round_contacts_on_the_twin_are_presses() -> None:
    twin = PressedSheet(Skin.load("paper"))
    contacts = (worlds.contact("pressed", 0.06, 0.13), worlds.contact("pressed", 0.12, 0.1, 0.012, 5e3))
    expected = twin.transfer_resistance([Press((0.06, 0.13), 8e-3, 20e3), Press((0.12, 0.1), 0.012, 5e3)])
    assert worlds.touched("pressed", "grid", contacts) == pytest.approx(expected, rel=1e-12)
    assert not np.allclose(worlds.touched("pressed", "grid", contacts), twin.untouched, rtol=1e-6)


def test_a_disc_changes_resistances_as_the_estimators_linear_model_says() -> None:
    model = bench("discs", 60, 0.1).setup("grid").model
    weak = worlds.contact("discs", 0.07, 0.12, strength=1e-3)
    change = worlds.touched("discs", "grid", (weak,)) - worlds.sheet("discs", "grid").untouched
    pattern = adjacent(Skin.load("paper").electrodes.rings)
    share = disc_overlap(model.mesh, weak.position, weak.radius).toarray()[0] / model.mesh.measures
    linear = worlds.CURRENT * model.sensitivity(pattern) @ (1e-3 * model.conductivity * share)
    measured = worlds.voltages(change, pattern)
    assert np.linalg.norm(measured - linear) < 0.05 * np.linalg.norm(linear)
    assert model.mesh.n_elem < worlds.sheet("discs", "grid").mesh.n_elem / 3  # the data's mesh is finer


def test_noise_is_one_absolute_level_for_all_methods() -> None:
    table = bench("discs", 40, 0.1)
    noise = table.setup("grid").noise
    rim = Skin.load("paper").electrodes.rings[0]
    largest = np.abs(worlds.voltages(worlds.sheet("discs", "grid").untouched, adjacent([rim]))).max()
    assert noise == pytest.approx(0.01 * largest, rel=1e-12)
    contacts = (worlds.contact("discs", 0.05, 0.15),)
    for key in METHODS:
        differences = table.simulate(key, contacts, 3).differences
        exact = [_exact(key, contacts, d.pattern) for d in differences]
        left = np.concatenate([d.volts - e for d, e in zip(differences, exact, strict=True)])
        assert np.std(left) == pytest.approx(noise, rel=4 / np.sqrt(2 * len(left)))


def _exact(key, contacts, pattern):
    layout = all_methods()[key].layout
    change = worlds.touched("discs", layout, contacts) - worlds.sheet("discs", layout).untouched
    return worlds.voltages(change, pattern)


def test_seeds_repeat_and_methods_share_the_noise_of_a_shared_scan() -> None:
    table, contacts = bench("discs", 40, 0.1), (worlds.contact("discs", 0.05, 0.15),)
    first = table.simulate("12B", contacts, 0).differences[0].volts
    assert np.array_equal(table.simulate("12B", contacts, 0).differences[0].volts, first)
    assert np.array_equal(table.simulate("16O fused", contacts, 0).differences[0].volts, first)
    assert not np.array_equal(table.simulate("12B", contacts, 1).differences[0].volts, first)


def test_literal_and_fused_adaptive_images_use_one_and_two_scans() -> None:
    table, contacts = bench("discs", 50, 0.1), (worlds.contact("discs", 0.05, 0.15),)
    literal, fused = (table.simulate(key, contacts, 0).differences for key in ("16O", "16O fused"))
    assert (len(literal), len(fused)) == (1, 2)
    assert literal[0].pattern == fused[1].pattern
    assert [all_methods()[key].injections for key in METHODS] == [12, 16, 16, 28, 28, 28]


def test_local_drive_takes_short_pairs_near_the_contact() -> None:
    electrodes = Skin.load("paper").electrodes
    at = np.array([0.04, 0.16])
    pattern = LocalDrive(electrodes, 16).pattern([[at] * 3])
    ends = electrodes.positions[pattern.injections]
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).max() < 0.2 / 3 * np.sqrt(2) + 1e-9
    distance = np.linalg.norm(ends.mean(axis=1) - at, axis=1)
    assert (np.diff(distance) >= -1e-12).all()
    assert distance[-1] < 0.1
    with pytest.raises(OhmskinError, match="121 injections"):
        LocalDrive(electrodes, 121)


def test_a_quiet_touch_is_seen_where_it_is() -> None:
    for world in worlds.WORLDS:
        view = bench(world, 70, 0.1).simulate("16O fused", (worlds.contact(world, 0.07, 0.12),), 0)
        assert np.linalg.norm(view.place - [0.07, 0.12]) < 3e-3
        assert len(view.contacts) == 1


# --- what the paper leaves open ---------------------------------------------------------------------------------------

TOUCH = (worlds.contact("pressed", 0.06, 0.13),)


def scanned(name: str, pattern: DrivePattern) -> tuple[Frame, Frame]:
    """A pattern on the twin under an assumption, untouched and touched, almost without noise."""
    given = Setup("pressed", 200.0, 0.1, assumption=assumption(name))
    return given.scan((), 1)(pattern), given.scan(TOUCH, 1)(pattern)


def test_a_voltage_source_drives_more_current_through_a_touch_and_only_one_that_measures_reports_it() -> None:
    pattern = adjacent(Skin.load("paper").electrodes.rings[:1])
    for name, follows in (("stated", False), ("measured", True), ("source", False)):
        quiet, touched = scanned(name, pattern)
        assert (touched.currents > quiet.currents).any() == follows
    flowing, measured = scanned("measured", pattern)
    assert flowing.currents.mean() == pytest.approx(worlds.CURRENT, rel=0.05)
    _, unmeasured = scanned("source", pattern)
    np.testing.assert_allclose(
        unmeasured.voltages, measured.voltages, rtol=1e-6
    )  # the same device, less is known of it


def test_noise_may_follow_each_scan_or_each_voltage() -> None:
    pattern = adjacent(Skin.load("paper").electrodes.rings[:1])
    exact = worlds.voltages(worlds.sheet("discs", "grid").untouched, pattern)
    spread = {}
    for name in ("stated", "scan", "voltage"):
        given = Setup("discs", 45.0, 0.1, assumption=assumption(name))
        found = np.array([given.scan((), seed)(pattern).voltages for seed in range(300)])
        spread[name] = found.std(axis=0)
    usual = worlds.noise_volts("discs", 45.0)
    assert spread["stated"] == pytest.approx(usual, rel=0.2)
    assert spread["scan"] == pytest.approx(usual, rel=0.2)  # 12B has the voltage that noise refers to
    assert spread["voltage"] == pytest.approx(usual * np.abs(exact) / np.abs(exact).max(), rel=0.2)


def test_contacts_and_modes_are_as_an_assumption_says() -> None:
    given = bench("discs", 45.0, 0.1, assumption="small")
    assert given.usual_contact(0.1, 0.1).radius == worlds.CONTACT_RADIUS["discs"] / 2
    assert method("16O").assuming("pairs").injections == 12 + 32
    assert method("16I").assuming("pairs").injections == 16
    assert method("16I").assuming("noser").prior == "noser"
    with pytest.raises(OhmskinError, match="no assumption 'other'; choose from stated, driven"):
        method("16I").assuming("other")


def test_driven_electrodes_add_what_they_measured_to_the_image() -> None:
    found = {
        name: bench("pressed", 45.0, 0.1, assumption=name).simulate("16I", TOUCH, 0).differences[0].pattern.n_meas
        for name in ("stated", "driven")
    }
    assert found["driven"] > found["stated"]


def test_a_shape_turned_is_the_shape_at_points_turned_back() -> None:
    points = np.random.default_rng(1).uniform(0, 0.2, (200, 2))
    angle, middle = 0.7, np.array([0.1, 0.08])
    back = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    plain, turned = Shape("L", (0.1, 0.08), 0.03, 1.0), Shape("L", (0.1, 0.08), 0.03, 1.0, angle)
    assert turned.distance(points) == pytest.approx(plain.distance((points - middle) @ back.T + middle))
    assert not np.allclose(turned.distance(points), plain.distance(points))
