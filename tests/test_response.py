"""Responses of contacts from a table, held against the integrals that they stand for."""

from functools import lru_cache

import numpy as np
import pytest

from ohmskin.contacts.kernels import all_onto
from ohmskin.errors import ModelError
from ohmskin.forward import ContactTable, TransferModel
from ohmskin.geometry import Disc, Electrodes, Mesh, Rectangle, mesh_domain
from ohmskin.geometry.overlap import disc_overlap
from ohmskin.scan import two_terminal

RADIUS = 8e-3
SHEET = Rectangle(0.2, 0.141)  # so that the table has another pitch along each axis


@lru_cache
def model() -> TransferModel:
    electrodes = Electrodes.grid(SHEET)
    return TransferModel(mesh_domain(SHEET, 5e-3, electrodes.positions), electrodes, 2e-3)


@lru_cache
def table() -> ContactTable:
    return ContactTable(model(), RADIUS)


def integral(position: np.ndarray, radius: float, sheet: TransferModel) -> np.ndarray:
    """Change of the pairs' resistances for one unit of relative change over a disc, per area of it that is on the
    sheet."""
    cover = disc_overlap(sheet.mesh, position[None], radius).toarray()[0]
    return sheet.pair_sensitivity @ (sheet.conductivity * cover / sheet.mesh.measures) / cover.sum()


def inner_places(count: int) -> np.ndarray:
    return np.random.default_rng(1).uniform([0.02, 0.02], [0.18, 0.12], (count, 2))


def error(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def test_a_table_of_a_scaled_model_is_the_scaled_table() -> None:
    scaled, anew, at = table().scaled(2.5), ContactTable(model().scaled(2.5), RADIUS), inner_places(20)
    np.testing.assert_allclose(scaled(at).values, anew(at).values, rtol=1e-6)
    np.testing.assert_allclose(scaled(at).slopes, anew(at).slopes, rtol=1e-5, atol=1e-6 * np.abs(anew(at).slopes).max())


def test_at_its_places_the_table_is_the_integral_itself() -> None:
    shown = table()
    for k in np.random.default_rng(0).integers(0, len(shown.places), 12):
        assert error(shown(shown.places[k]).values[0], integral(shown.places[k], RADIUS, model())) < 1e-6


@pytest.mark.parametrize(("way", "number"), [(((1, 0), (0, -1)), 0), (((0, 1), (1, 0)), 1)])
def test_what_conducts_more_one_way_is_the_derivative_by_the_tensor(way: tuple, number: int) -> None:
    sheet, radius, step = model(), 4e-3, 1e-3
    for place in inner_places(4):
        cover = disc_overlap(sheet.mesh, place[None], radius).toarray()[0]
        changed = np.array(way) * (cover / sheet.mesh.measures)[:, None, None]
        up, down = (
            two_terminal(
                TransferModel(
                    sheet.mesh, sheet.electrodes, 2e-3 * (np.eye(2) + sign * step * changed)
                ).transfer_resistance
            )
            for sign in (1, -1)
        )
        true = (up - down) / (2 * step * cover.sum())
        assert error(table().lopsided(place)[number], true) < 0.12


@pytest.mark.parametrize("share", [0.5, 0.6, 0.9, 1.1, 1.4, 1.5, 1.75, 2.25, 3.0])
def test_between_places_and_radii_it_is_the_integral_but_at_the_elements_of_an_electrode(share: float) -> None:
    """Where the rim of a disc crosses the elements at a point electrode, which hold a singularity, the integral is not
    smooth."""
    errors = [
        error(table()(place, share * RADIUS).values[0], integral(place, share * RADIUS, model()))
        for place in inner_places(80)
    ]
    assert np.median(errors) < (6e-3 if share <= 1.5 else 0.03)  # large discs reach more electrodes
    assert np.quantile(errors, 0.9) < (0.03 if share <= 1.5 else 0.15)
    assert max(errors) < (0.1 if share <= 1.5 else 0.25)


def test_slopes_and_widening_are_the_derivatives_of_the_values() -> None:
    step, radius = 1e-7, 1.1 * RADIUS
    for place in inner_places(10):
        response = table()(place, radius)
        for axis in range(2):
            shift = step * np.eye(2)[axis]
            difference = (table()(place + shift, radius).values - table()(place - shift, radius).values) / (2 * step)
            assert error(response.slopes[:, axis], difference) < 1e-5
        wider, narrower = (table()(place, np.sqrt(radius**2 + change)).values for change in (1e-9, -1e-9))
        assert error(response.widening, (wider - narrower) / 2e-9) < 1e-5


def test_many_contacts_at_once_are_each_by_themselves() -> None:
    places, radii = inner_places(5), np.linspace(0.5, 1.5, 5) * RADIUS
    together = table()(places, radii)
    for k in range(5):
        alone = table()(places[k], radii[k])
        np.testing.assert_allclose(together.values[k], alone.values[0], rtol=1e-12)
        np.testing.assert_allclose(together.slopes[k], alone.slopes[0], rtol=1e-9, atol=1e-9)


def test_places_off_the_sheet_count_as_the_closest_on_it() -> None:
    np.testing.assert_allclose(
        table()([[-0.01, 0.07], [0.25, 0.3]]).values, table()([[0.0, 0.07], [0.2, 0.141]]).values, rtol=1e-12
    )
    np.testing.assert_allclose(
        table()([[0.1, 0.07]], 5.0).values, table()([[0.1, 0.07]], 3 * RADIUS).values, rtol=1e-12
    )


def test_a_place_that_is_no_number_has_no_response_and_stays_where_it_is() -> None:
    places = np.array([[np.nan, 0.07], [0.1, np.nan], [0.1, 0.07]])
    assert np.isnan(table()(places).values).all(axis=1).tolist() == [True, True, False]
    moved = places.copy()
    all_onto(moved, table().sheet)
    np.testing.assert_array_equal(moved, places)


def test_whole_contacts_are_a_radius_from_the_rim_and_all_places_are_on_the_sheet() -> None:
    round_sheet = Disc(0.1)
    electrodes = Electrodes.rim(round_sheet, 8)
    shown = ContactTable(
        TransferModel(mesh_domain(round_sheet, 7e-3, electrodes.positions), electrodes, 1e-3), RADIUS, 5e-3
    )
    for domain, kept, slack in ((SHEET, table(), 1e-6), (round_sheet, shown, 2e-3)):
        depth = domain.depth(kept.places)
        assert depth.min() > -slack
        assert (depth[kept.whole] > RADIUS - slack).all()
        assert (depth[~kept.whole] < RADIUS + slack).all()


@pytest.mark.parametrize(
    ("radius", "pitch"), [(0.0, 2e-3), (-1e-3, 2e-3), (0.08, 2e-3), (8e-3, 0.0), (8e-3, 0.05), (np.nan, 2e-3)]
)
def test_sizes_out_of_range_are_refused(radius: float, pitch: float) -> None:
    with pytest.raises(ModelError, match=r"radius must be below half .* pitch below a quarter"):
        ContactTable(model(), radius, pitch)


def test_a_surface_in_space_is_refused() -> None:
    flat = model().mesh
    bent = Mesh(np.column_stack([flat.nodes, 0.1 * flat.nodes[:, 0] ** 2]), flat.elements)
    electrodes = Electrodes.at(bent.nodes[:8])
    with pytest.raises(ModelError, match="flat sheet"):
        ContactTable(TransferModel(bent, electrodes, 1e-3))
