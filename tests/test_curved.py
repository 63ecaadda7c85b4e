"""Skins on curved surfaces: their maps, the physics on them against finite elements in space, and contacts in space."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from direct import DirectDevice
from scipy.spatial import cKDTree

import ohmskin as ohm
from ohmskin.arrays import Floats
from ohmskin.calibrate import fit_sheet
from ohmskin.client.contacts import Patch
from ohmskin.contacts import Contact, in_frame
from ohmskin.drive import complete_pattern, pair_weights
from ohmskin.engine import Engine
from ohmskin.errors import GeometryError, ModelError, PatternError, SkinError
from ohmskin.forward import TransferModel
from ohmskin.forward.conductivity import cosines
from ohmskin.geometry import (
    Band,
    Chart,
    Disc,
    Electrodes,
    Mesh,
    Raster,
    Rectangle,
    RevolutionChart,
    electrode_points,
    mesh_domain,
)
from ohmskin.geometry.periodic import folded, shortest
from ohmskin.inverse import Image
from ohmskin.outlets.picture import Picture
from ohmskin.scan import Difference, skip
from ohmskin.skin import Skin, VirtualSkin
from ohmskin.skin.description import ContactLayer
from ohmskin.skin.sheet import Sheet

SHEETS = {
    "half-cylinder": Sheet(shape="cylinder", radius=0.05, height=0.25, angle=np.pi),
    "sleeve": Sheet(shape="cylinder", radius=0.045, height=0.142),
    "cone": Sheet(shape="cone", radius=0.06, top_radius=0.03, height=0.138),
    "cap": Sheet(shape="sphere", radius=0.1, angle=1.2),
    "ellipsoid": Sheet(shape="ellipsoid", radius=0.08, height=0.05, angle=1.3),
    "capsule": Sheet(shape="capsule", radius=0.05, height=0.03),
    "vase": Sheet(shape="revolution", profile=((0.04, 0.0), (0.06, 0.05), (0.05, 0.1), (0.07, 0.15)), angle=2.5),
}
AREAS = {
    "half-cylinder": np.pi * 0.05 * 0.25,
    "sleeve": 2 * np.pi * 0.045 * 0.142,
    "cone": np.pi * 0.09 * np.hypot(0.03, 0.138),
    "cap": 2 * np.pi * 0.1**2 * (1 - np.cos(1.2)),
    "capsule": 2 * np.pi * 0.05 * (0.05 + 0.03),
}


def places_on(chart: Chart, count: int, inset: float = 1e-3) -> Floats:
    x0, y0, x1, y1 = chart.domain.bounds
    places = np.random.default_rng(1).uniform([x0, y0], [x1, y1], (4 * count, 2))
    return places[chart.domain.depth(places) > inset][:count]


# --- maps -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SHEETS)
def test_a_map_is_true_to_angles_and_to_its_scale(name: str) -> None:
    chart, step = SHEETS[name].chart, 1e-6
    places = places_on(chart, 300)
    frames, scale = chart.frames(places), chart.scale(places)
    for axis in range(2):
        ahead = step * np.eye(2)[axis]
        along = (chart.points(places + ahead) - chart.points(places - ahead)) / (2 * step)
        np.testing.assert_allclose(along, scale[:, None] * frames[:, axis], atol=1e-5)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (len(places), 1, 1)), atol=1e-9)
    assert (np.linalg.det(frames) > 0).all()
    outwards = chart.points(places) * [1, 1, name == "cap"]  # away from the axis, of the ball from its middle
    assert (np.sum(frames[:, 2] * outwards, axis=1) > 0).all()


@pytest.mark.parametrize("name", SHEETS)
def test_points_in_space_are_found_on_the_map_again(name: str) -> None:
    chart = SHEETS[name].chart
    places = places_on(chart, 300)
    above = chart.points(places) + 5e-3 * chart.frames(places)[:, 2]
    found, away = chart.project(above)
    np.testing.assert_allclose(found, places, atol=2e-5)
    np.testing.assert_allclose(away, 5e-3, rtol=1e-4)


@pytest.mark.parametrize("name", AREAS)
def test_a_map_has_the_area_of_the_skin(name: str) -> None:
    assert SHEETS[name].chart.domain.area == pytest.approx(AREAS[name], rel=1e-6)


def test_a_developable_skin_is_its_own_map() -> None:
    chart = SHEETS["half-cylinder"].chart
    assert chart.flat
    assert isinstance(chart.domain, Rectangle)
    assert (chart.domain.width, chart.domain.height) == pytest.approx((np.pi * 0.05, 0.25))


@pytest.mark.parametrize(
    ("sheet", "told"),
    [
        (Sheet(shape="revolution"), "profile"),
        (Sheet(shape="revolution", profile=((0.0, 0.0), (0.1, 0.1)), angle=1.0), "of a cap 2 pi"),
        (Sheet(shape="revolution", profile=((0.1, 0.0), (0.0, 0.1))), "on the axis"),
        (Sheet(shape="cone", radius=0.1, top_radius=0.01, height=0.2), "cut it into two"),
        (Sheet(shape="sphere", angle=3.0), "it may reach 2.8 rad"),
    ],
)
def test_a_sheet_that_cannot_be_is_refused(sheet: Sheet, told: str) -> None:
    with pytest.raises(SkinError, match=told):
        Skin(sheet=sheet)


def test_patches_that_overlap_are_refused() -> None:
    with pytest.raises(SkinError, match="overlap"):
        VirtualSkin(replace(Skin.load("sleeve"), contact_layer=ContactLayer(columns=24, rows=24)))


@pytest.mark.parametrize("name", ["half-cylinder", "sleeve", "cone", "vase"])
def test_patches_are_of_one_size_on_the_skin_whatever_the_scale_of_its_map(name: str) -> None:
    layer, chart = ContactLayer(), SHEETS[name].chart
    patches = layer.patches(chart)
    middles, sides = patches.middles, patches.sides
    assert sides * chart.scale(middles)[:, None] == pytest.approx(layer.patch, rel=0.03)  # whole numbers of them fit
    assert sides.prod(axis=1).sum() == pytest.approx(0.81 * chart.domain.area, rel=0.02)
    apart = np.abs(shortest(middles[:, None] - middles, chart.domain.period))
    gaps = (apart - (sides[:, None] + sides) / 2).max(axis=2)
    assert gaps[~np.eye(len(sides), dtype=bool)].min() > 0.05 * layer.patch


@pytest.mark.parametrize("name", ["cap", "ellipsoid", "capsule"])
def test_patches_of_a_cap_are_rings_about_its_pole_of_one_size_on_the_skin(name: str) -> None:
    layer, chart = ContactLayer(), SHEETS[name].chart
    patches = layer.patches(chart)
    sides = patches.sides * chart.scale(patches.middles)[:, None]
    assert sides == pytest.approx(layer.patch, rel=0.08)  # whole numbers of rings, and of patches in each, fit
    assert sides.prod(axis=1) == pytest.approx(layer.patch**2, rel=0.12)
    assert np.median(sides.prod(axis=1)) == pytest.approx(layer.patch**2, rel=0.02)
    assert (chart.domain.depth(patches.middles) > 0).all()
    assert len(sides) == pytest.approx(0.81 * chart.domain.area / layer.patch**2, rel=0.01)


def test_parts_of_patches_in_rings_cover_them_and_leave_the_gaps() -> None:
    chart = SHEETS["cap"].chart
    patches = ContactLayer().patches(chart)
    places, sides = patches.divided(np.linspace(-0.5, 0.5, 9))
    assert places.shape == (len(patches.middles), 64, 2)
    assert np.linalg.det(sides).sum(axis=1) == pytest.approx(patches.sides.prod(axis=1), rel=1e-9)
    assert np.sum(sides[..., 0, :] * sides[..., 1, :], axis=-1) == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.det(sides).sum() == pytest.approx(0.81 * chart.domain.area, rel=1e-3)
    whole = cKDTree(places.reshape(-1, 2))
    close = whole.query(places.reshape(-1, 2), 2)[1][:, 1] // 64 == np.repeat(np.arange(len(places)), 64)
    assert close.mean() > 0.99  # of its own patch, but at the tips at the pole


def test_patches_are_equal_on_a_map_whose_scale_follows_no_row_or_ring() -> None:
    chart = SHEETS["cap"].chart
    patches = ContactLayer(columns=20, rows=20).patches(chart)
    assert patches.centre is None
    assert (patches.sides == ContactLayer().patch).all()


# --- closed bands -----------------------------------------------------------------------------------------------------


def test_the_mesh_of_a_band_has_no_seam() -> None:
    band = Band(0.28, 0.14)
    mesh = mesh_domain(band, 8e-3, [[0.0, 0.0], [0.1, 0.07], [0.2799, 0.05], [0.03, 0.14]])
    assert mesh.period == 0.28
    assert mesh.measures.sum() == pytest.approx(band.area)
    assert set(np.round(mesh.nodes[mesh.boundary][..., 1].ravel(), 12)) == {0.0, 0.14}
    across = mesh.interpolation([[1e-4, 0.07], [0.28 + 1e-4, 0.07]])[0]
    assert abs(across[[0]] - across[[1]]).max() < 1e-9
    with pytest.raises(GeometryError, match="closed band"):
        Mesh(mesh.nodes, mesh.elements, period=0.2)


@pytest.mark.parametrize("x", [0.001, 0.0045, 0.0087, 0.2514, 0.2545, 0.2602])
def test_a_disc_beside_the_seam_of_a_band_is_meshed_alike_on_both_sides(x: float) -> None:
    """The rings of nodes about it are circles, on which Delaunay's triangles are a matter of rounding."""
    band = Band(0.263, 0.1615)
    discs = Electrodes.at([[x, 0.0], [x, 0.08], [0.1, 0.0], [0.15, 0.1]]).with_discs(3.5e-3, 1e-4)
    mesh = mesh_domain(band, 3.6e-3, electrode_points(band, discs, 8e-5), closest=0.02)
    assert mesh.measures.sum() == pytest.approx(band.area)


def test_the_numbers_of_a_band_do_not_depend_on_where_its_seam_is() -> None:
    band = Band(0.28, 0.14)
    places = np.array([[0.01 + 0.07 * k, y] for y in (0.0, 0.14) for k in range(4)])
    resistances = []
    for shift in (0.0, 0.1):
        electrodes = Electrodes.at((places + np.array([shift, 0.0])) % [0.28, 1.0])
        mesh = mesh_domain(band, 4e-3, electrodes.positions)
        volts = TransferModel(mesh, electrodes, 1e-3).voltages(skip([range(8)], 2))
        resistances.append(volts)
    np.testing.assert_allclose(*resistances, rtol=2e-3, atol=2e-3 * np.abs(resistances[0]).max())


# --- physics against finite elements in space -------------------------------------------------------------------------


@pytest.mark.parametrize("name", SHEETS)
def test_resistances_on_the_map_are_those_in_space(name: str) -> None:
    """Finite elements on the triangles of the surface know nothing of the map."""
    skin = Skin(sheet=SHEETS[name], electrode=Skin.load("dome").electrode)
    chart, electrodes = skin.chart, skin.electrodes
    mesh, pattern = mesh_domain(skin.domain, 3e-3, electrodes.positions), skip([range(16)], 5)
    flat = TransferModel(mesh, electrodes, 1e-3).voltages(pattern)
    bent = TransferModel(mesh.mapped(chart.points), electrodes.mapped(chart.points), 1e-3).voltages(pattern)
    np.testing.assert_allclose(bent, flat, atol=1e-3 * np.abs(flat).max())


def test_potentials_on_a_cap_converge_to_the_analytic_solution_with_second_order() -> None:
    """The stereographic projection makes a disc of a cap: phi = I / (pi s) ln(r_sink / r_source) on its rim."""
    s, chart = 1e-3, SHEETS["cap"].chart
    electrodes = Electrodes.rim(chart.domain, 16)
    x, y, z = chart.points(electrodes.positions).T
    stereographic = np.column_stack([x, y]) / (0.1 + z)[:, None]
    apart = np.linalg.norm(stereographic[:, None] - stereographic, axis=2)
    pattern = skip([range(16)], 5)
    a, b, c, d = pattern.quadruples.T
    exact = np.log(apart[c, b] / apart[c, a] * apart[d, a] / apart[d, b]) / (np.pi * s)
    sizes, errors = np.array([0.016, 0.008, 0.004]), []
    for size in sizes:
        mesh = mesh_domain(chart.domain, size, electrodes.positions).mapped(chart.points)
        found = TransferModel(mesh, electrodes.mapped(chart.points), s).voltages(pattern)
        errors.append(np.linalg.norm(found - exact) / np.linalg.norm(exact))
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] > 1.8


@pytest.mark.parametrize("name", ["half-cylinder", "sleeve"])
def test_contacts_of_a_bent_skin_are_those_of_a_flat_one(name: str) -> None:
    """Data of finite elements in space, and of the same mesh on the map, read by the same fit."""
    skin = replace(Skin.load("paper"), sheet=SHEETS[name], contact_layer=ContactLayer())
    chart, electrodes = skin.chart, skin.electrodes
    mesh = mesh_domain(skin.domain, 3e-3, electrodes.positions)
    pattern, table = complete_pattern(electrodes), skin.contact_table(skin.transfer_model())
    fitter = ohm.ContactFitter(table, 1e-4)
    for place in places_on(chart, 5, 0.02):
        found = []
        for bent in (False, True):
            used = mesh.mapped(chart.points) if bent else mesh
            at = electrodes.mapped(chart.points) if bent else electrodes
            touched = 1e-3 * np.ones(mesh.n_elem)
            away = mesh.centroids - place
            away[:, 0] -= skin.domain.period * np.rint(away[:, 0] / (skin.domain.period or np.inf))
            touched[np.linalg.norm(away, axis=1) < 8e-3] *= 2
            changes = [TransferModel(used, at, sigma).voltages(pattern) for sigma in (touched, 1e-3)]
            difference = Difference(pattern, np.full(pattern.n_meas, 1e-3), 1e-3 * (changes[0] - changes[1]))
            told = replace(difference, volts=difference.volts * 1e-3 / skin.sheet.conductivity)
            (contact,) = fitter.contacts(fitter.fit(told))
            found.append(np.array(contact.position))
        assert np.linalg.norm(found[0] - found[1]) < 0.2e-3


@pytest.mark.parametrize("name", ["sleeve", "dome"])
def test_electrodes_are_found_again_by_self_calibration(name: str) -> None:
    """On the upper rim and at the seam of a sleeve, too; how far all are turned alike cannot be told."""
    skin = Skin.load(name)
    domain, electrodes, pattern = skin.domain, skin.electrodes, complete_pattern(skin.electrodes)
    random = np.random.default_rng(4)

    def build(placed: Electrodes, log_conductivity: Floats) -> TransferModel:
        mesh = skin.mesh_for(placed)
        return TransferModel(mesh, placed, 1e-3 * np.exp(cosines(mesh.centroids, domain, log_conductivity)))

    inner = domain.depth(electrodes.positions) > 1e-6
    moves = 2e-3 * random.standard_normal((16, 2)) * inner[:, None]
    if domain.period:  # along its rims, too
        moves[~inner, 0] = 2e-3 * random.standard_normal((~inner).sum())
    true = electrodes.mapped(lambda p: folded(p + moves, domain.period))
    uneven = np.zeros(36)
    uneven[[6, 13]] = 0.03, 0.02
    measured = build(true, uneven).voltages(pattern)
    fit = fit_sheet(domain, electrodes, build, pattern, measured, 1e-4 * np.abs(measured).max())
    off = shortest(fit.model.electrodes.positions - true.positions, domain.period)
    if domain.period:
        off[:, 0] -= off[:, 0].mean()
    assert fit.after < 0.1 * fit.before
    assert np.linalg.norm(off[inner], axis=1).mean() < 0.3 * np.linalg.norm(moves[inner], axis=1).mean()
    assert (np.abs(domain.depth(fit.model.electrodes.positions[~inner])) < 1e-9).all()


# --- felt end to end --------------------------------------------------------------------------------------------------


@cache
def sensed(name: str, mode: str) -> Engine:
    skin = Skin.load(name)
    engine = Engine(lambda: DirectDevice(VirtualSkin(skin, seed=1)), skin, mode)
    engine.calibrate()
    return engine


def pressed(engine: Engine, place: Floats, frames: int = 10) -> tuple[Contact, ...]:
    engine.press(0, tuple(place.tolist()), 8e-3, 15e3)
    touches = [engine.step() for _ in range(frames)]
    assert touches[-1] is not None
    return touches[-1].contacts


@pytest.mark.parametrize("mode", ["16O", "16P", "16T"])
@pytest.mark.parametrize("name", ["sleeve", "dome"])
def test_a_press_on_a_curved_skin_is_felt_where_it_is(name: str, mode: str) -> None:
    engine = sensed(name, mode)
    chart, most = engine.skin.chart, 5e-3 if mode != "16O" else 20e-3
    for place in places_on(chart, 4, 0.015):
        contacts = pressed(engine, place)
        (felt,) = in_frame(contacts, chart, Patch())
        (point,), (frame,) = chart.points(place), chart.frames(place)
        assert np.linalg.norm(np.array(felt.position) - point) < most
        assert np.degrees(np.arccos(np.dot(felt.normal, frame[2]))) < 5 if mode != "16O" else True
        engine.press(0, tuple(place.tolist()), 8e-3, 0.0)
        for _ in range(12):
            engine.step()


@pytest.mark.parametrize("mode", ["16P", "16T"])
def test_a_finger_that_slides_round_a_sleeve_stays_one_contact(mode: str) -> None:
    engine = sensed("sleeve", mode)
    width = engine.skin.domain.period
    names, worst = set(), 0.0
    for k, x in enumerate(np.linspace(-0.02, 0.02, 41)):
        contacts = pressed(engine, np.array([x % width, 0.06]), 1)
        if k > 12:
            (contact,) = contacts
            names.add(contact.id)
            assert 0 <= contact.position[0] < width
            off = (contact.position[0] - x + width / 2) % width - width / 2
            worst = max(worst, float(np.hypot(off, contact.position[1] - 0.06)))
    engine.press(0, (0.02, 0.06), 8e-3, 0.0)
    for _ in range(20):
        engine.step()
    assert len(names) == 1
    assert worst < 6e-3


def test_two_fingers_on_both_sides_of_the_seam_are_two() -> None:
    engine = sensed("sleeve", "16P")
    width = engine.skin.domain.period
    engine.press(1, (0.02, 0.07), 8e-3, 15e3)
    contacts = pressed(engine, np.array([width - 0.02, 0.07]))
    for number in (0, 1):
        engine.press(number, (0.02, 0.07), 8e-3, 0.0)
    assert sorted(np.round(c.position[0], 2) for c in contacts) == [0.02, round(width - 0.02, 2)]


# --- told in space ----------------------------------------------------------------------------------------------------


def test_sizes_and_ellipses_are_told_as_they_are_on_the_skin() -> None:
    chart = SHEETS["cone"].chart
    place = (0.1, 0.18)
    (scale,), (frame,) = chart.scale([place]), chart.frames([place])
    contact = Contact(place, 1e-4, 1e-4, 1.0, 1.0, 1, ((1e-6, 0.0), (0.0, 4e-6)), (0.1, 0.0))
    (felt,) = in_frame([contact], chart, Patch())
    assert felt.covariance is not None
    assert felt.velocity is not None
    np.testing.assert_allclose(felt.velocity, 0.1 * scale * frame[0], atol=1e-9)
    values = np.linalg.eigvalsh(np.array(felt.covariance))
    np.testing.assert_allclose(values, [0, scale**2 * 1e-6, scale**2 * 4e-6], atol=1e-12)
    np.testing.assert_allclose(np.array(felt.covariance) @ frame[2], 0, atol=1e-12)


def test_pixels_of_a_curved_skin_lie_on_it_and_tell_the_place_of_a_point() -> None:
    skin = Skin.load("dome")
    raster = Raster(skin.mesh(), 40)
    patch = Patch("head", "head_link", (0.1, 0.2, 0.3), ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    setup = Picture.setup(raster) | Picture.in_space(raster, skin.chart, patch)
    picture = Picture.unpack(Picture.pack(raster(np.ones(skin.mesh().n_elem)), 1, 2), setup)
    inside = np.isfinite(picture.pixels)
    away = np.linalg.norm(picture.points - [0.1, 0.2, 0.3], axis=2)
    np.testing.assert_allclose(away[inside], 0.1, atol=1e-5)
    for place in places_on(skin.chart, 20, 0.01):
        point = patch.place(*skin.chart.points(place)[0])
        assert picture.place(point, setup["raster"]) == pytest.approx(tuple(place), abs=1e-3)


def test_electrodes_spread_evenly_are_far_apart_on_the_skin_and_some_on_its_rim() -> None:
    for name in ("cap", "cone"):
        skin = Skin(sheet=SHEETS[name], electrode=Skin.load("dome").electrode)
        points = skin.chart.points(skin.electrodes.positions)
        gaps = np.linalg.norm(points[:, None] - points, axis=2) + np.eye(16)
        assert gaps.min() > 0.9 * np.sqrt(skin.domain.area / 16)
        assert (np.abs(skin.domain.depth(skin.electrodes.positions)) < 1e-6).sum() >= 6


def test_a_disc_electrode_is_as_large_on_the_map_as_the_scale_says() -> None:
    skin = Skin.load("dome")
    scale = skin.chart.scale(skin.electrodes.positions)
    np.testing.assert_allclose(skin.discs.extents * scale, skin.electrode.radius)
    resistances = skin.discs.contact_impedances / (np.pi * skin.discs.extents**2)
    np.testing.assert_allclose(resistances, skin.electrode.contact_impedance)


def test_a_chart_of_a_disc_is_the_disc() -> None:
    chart = RevolutionChart([[0.0, 0.0], [0.1, 0.0]])
    assert isinstance(chart.domain, Disc)
    assert chart.domain.radius == pytest.approx(0.1)
    np.testing.assert_allclose(chart.points([[0.03, 0.04]]), [[0.03, 0.04, 0.0]], atol=1e-9)


def test_a_contact_in_an_image_on_a_surface_in_space_has_three_coordinates() -> None:
    chart = SHEETS["sleeve"].chart
    mesh = mesh_domain(chart.domain, 8e-3).mapped(chart.points)
    place = chart.points([[0.1, 0.07]])[0]
    values = np.exp(-np.sum((mesh.centroids - place) ** 2, axis=1) / 2e-4)
    image = Image(values, lambda elements: np.zeros(np.size(elements)))
    (contact,) = ohm.ContactFinder(0.3).find(image, mesh)
    assert contact.position == pytest.approx(tuple(place), abs=2e-3)


def test_eq_7_is_refused_in_space() -> None:
    with pytest.raises(PatternError, match="flat map"):
        pair_weights(np.zeros((4, 3)), np.zeros((1, 3)))


def test_an_image_of_another_size_than_its_cells_is_refused() -> None:
    """As a package's estimator may give it: compiled code would read behind its end."""
    mesh = mesh_domain(SHEETS["sleeve"].chart.domain, 8e-3)
    image = Image(np.ones(7), lambda elements: np.zeros(np.size(elements)))
    with pytest.raises(ModelError, match=f"an image has 7 values; its estimator must give {mesh.n_elem}, one per cell"):
        ohm.ContactFinder(0.3).find(image, mesh)
    nothing = Image(np.full(mesh.n_elem, np.nan), lambda elements: np.zeros(np.size(elements)))
    with pytest.raises(ModelError, match=f"{mesh.n_elem} of {mesh.n_elem} values of an image are not finite"):
        ohm.ContactFinder(0.3).find(nothing, mesh)  # it had no contact, and nothing was said
