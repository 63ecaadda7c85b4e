"""A flat sheet wrapped on a body: how it is stretched, how that makes it conduct, and contacts on it."""

from dataclasses import replace

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin.arrays import Floats
from ohmskin.client.contacts import Patch
from ohmskin.contacts import in_frame
from ohmskin.engine import Engine
from ohmskin.geometry.wrap import Wrap
from ohmskin.skin import Skin, VirtualSkin
from ohmskin.skin.sheet import Sheet

DOME = Skin.load("dome")
RUBBER = replace(DOME, sheet=replace(DOME.sheet, wrapped=True, gauge_factor=5.0))


@pytest.mark.parametrize("angle", [0.3, 0.6])
def test_a_sheet_on_a_shallow_cap_is_stretched_as_the_theory_of_elasticity_says(angle: float) -> None:
    """Radial and hoop stress of a free disc on a ball: Y/16 (a^2 - r^2) and Y/16 (a^2 - 3 r^2)."""
    chart = Sheet(shape="sphere", radius=0.1, angle=angle).chart
    shares, turns = np.array([0.0, 0.3, 0.6, 0.9]), np.array([0.3, 2.0, 4.5])
    places = shares[:, None, None] * np.column_stack([np.cos(turns), np.sin(turns)]) * chart.domain.bounds[2]
    stretch = Wrap(chart).log_stretch(places.reshape(-1, 2)).reshape(4, 3, 2, 2)
    outwards = np.column_stack([np.cos(turns), np.sin(turns)])
    stress = (angle**2 / 16) * np.array([1 - shares**2, 1 - 3 * shares**2])
    for along, other, direction in ((0, 1, outwards), (1, 0, outwards @ [[0.0, 1.0], [-1.0, 0.0]])):
        found = np.einsum("ti,stij,tj->st", direction, stretch, direction)
        expected = stress[along] - 0.5 * stress[other]
        np.testing.assert_allclose(found, np.tile(expected[:, None], 3), atol=0.05 * angle**2 / 8)


def test_a_developable_surface_takes_no_stretch_and_wrapping_changes_nothing() -> None:
    cone = Sheet(shape="cone", radius=0.06, top_radius=0.03, height=0.138)
    places = np.array([[0.01, 0.02], [0.1, 0.07], [0.27, 0.13]])
    assert np.abs(Wrap(cone.chart).log_stretch(places)).max() < 5e-4
    np.testing.assert_allclose(replace(cone, wrapped=True).strained(places), 1.0, atol=1e-3)
    assert (replace(DOME.sheet, gauge_factor=5.0).strained(places) == 1).all()  # sprayed on


def test_stretch_makes_a_sheet_thinner_and_a_gauge_factor_makes_it_conduct_worse_along_it() -> None:
    """A strip whose length grows by a factor has a resistance that grows with the power of the gauge factor."""
    places = np.array([[0.0, 0.0], [0.09, 0.0], [0.0, 0.09], [0.05, 0.05]])
    stretch = Wrap(DOME.chart).log_stretch(places)
    for gauge in (2.0, 5.0):
        conductivity = replace(DOME.sheet, wrapped=True, gauge_factor=gauge).strained(places)
        if gauge == 2.0:  # geometry alone: alike in all directions
            assert conductivity.shape == (4,)
            conductivity = conductivity[:, None, None] * np.eye(2)
        values, directions = np.linalg.eigh(stretch)
        for axis in range(2):
            along, across = values[:, axis], values[:, 1 - axis]
            unit = directions[:, :, axis]
            found = np.einsum("ni,nij,nj->n", unit, conductivity, unit)
            np.testing.assert_allclose(np.exp(along - across) / found, np.exp(gauge * along), rtol=1e-9)


def press(engine: Engine, place: Floats) -> Floats:
    """Where (n, 3) contacts are felt during a press at a place."""
    engine.press(0, tuple(place.tolist()), 8e-3, 15e3)
    touches = [engine.step() for _ in range(8)]
    assert touches[-1] is not None
    felt = in_frame(touches[-1].contacts, engine.skin.chart, Patch())
    engine.press(0, tuple(place.tolist()), 8e-3, 0.0)
    for _ in range(8):
        engine.step()
    return np.array([contact.position for contact in felt])


def test_contacts_are_right_if_it_is_known_that_the_sheet_is_wrapped() -> None:
    """Rubber with carbon in it, a gauge factor of 5; taken for a sheet sprayed on, contacts are told elsewhere."""
    errors, felt = {True: list[float](), False: list[float]()}, {True: 0, False: 0}
    for known in (True, False):
        skin = RUBBER if known else DOME
        with Engine(lambda: DirectDevice(VirtualSkin(RUBBER, seed=1)), skin, "16P") as engine:
            engine.calibrate()
            for radius, turn in ((0.02, 0.5), (0.05, 2.0), (0.075, 4.0), (0.085, 5.3)):
                place = radius * np.array([np.cos(turn), np.sin(turn)])
                found = press(engine, place)
                off = np.linalg.norm(found - engine.skin.chart.points([place])[0], axis=1)
                errors[known].append(float(off.min()))
                felt[known] += len(found)
    assert felt[True] == 4
    assert max(errors[True]) < 3e-3
    assert np.mean(errors[False]) > 2 * np.mean(errors[True])


def test_a_skin_file_says_how_it_is_made() -> None:
    again = Skin.parse(RUBBER.dump())
    assert again == RUBBER
    assert again.digest != DOME.digest
