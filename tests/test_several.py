"""How many contacts there are: two are told from one, also beside electrodes and where the model of a contact errs."""

from collections.abc import Sequence

import numpy as np
import pytest

from ohmskin.evaluate.policies.schemes import scheme
from ohmskin.evaluate.setup import Setup, setup
from ohmskin.evaluate.worlds import contact
from ohmskin.sensing import Percept

Places = Sequence[tuple[float, float]]
BESIDE = [  # pairs 40 mm apart (m), one of each 12 to 15 mm from an electrode, which was taken for what is pressed
    [(0.121, 0.125), (0.130, 0.164)],
    [(0.069, 0.121), (0.041, 0.149)],
]


def pairs(count: int, apart: float) -> list[Places]:
    """Random pairs so far apart (m), 15 mm and more from the rim, wherever electrodes are."""
    random, found = np.random.default_rng(3), list[Places]()
    while len(found) < count:
        middle, angle = random.uniform(0.03, 0.17, 2), random.uniform(0, np.pi)
        half = apart / 2 * np.array([np.cos(angle), np.sin(angle)])
        ends = np.array([middle - half, middle + half])
        if ((ends > 15e-3) & (ends < 185e-3)).all():
            found.append([(float(x), float(y)) for x, y in ends])
    return found


@pytest.fixture(scope="module")
def twin() -> Setup:
    return setup("pressed", 50.0)


def placed(found: Places, places: Places, within: float = 10e-3) -> bool:
    """Whether these are the contacts, and no others."""
    away = np.linalg.norm(np.array(found)[:, None] - np.array(places), axis=2) if found else np.full((1, 1), np.inf)
    return len(found) == len(places) and bool((away.min(axis=0) < within).all())


def positions(percept: Percept) -> Places:
    return [found.position for found in percept.detections]


def told_apart(twin: Setup, mode: str, reading: str, places: Places) -> bool:
    """Whether two presses are told apart when they have come at once."""
    contacts = tuple(contact("pressed", *place) for place in places)
    if reading.startswith("fit"):
        return placed(positions(twin.simulate(scheme(mode, reading), contacts, 1).percept), places)
    *_, last = twin.follow(scheme(mode, reading), [()] * 8 + [contacts] * 20, 1)
    return placed([found.position for found in last.contacts], places)


@pytest.mark.parametrize(("mode", "reading"), [("16P", "fit, driven"), ("16T/4", "tracked, driven")])
@pytest.mark.parametrize(("apart", "least"), [(40e-3, 11), (30e-3, 11), (25e-3, 9)])
def test_two_presses_are_two(twin: Setup, mode: str, reading: str, apart: float, least: int) -> None:
    assert sum(told_apart(twin, mode, reading, places) for places in pairs(12, apart)) >= least


@pytest.mark.parametrize("places", BESIDE)
def test_two_presses_beside_an_electrode_are_not_taken_for_one_on_it(twin: Setup, places: Places) -> None:
    assert told_apart(twin, "16P", "fit, driven", places)


def test_a_light_press_is_found_beside_two_strong_ones(twin: Setup) -> None:
    places = [(0.081, 0.015), (0.105, 0.048), (0.106, 0.148)]
    contacts = tuple(
        contact("pressed", *place, strength=kpa * 1e3) for place, kpa in zip(places, (30, 30, 4), strict=True)
    )
    for seed in range(3):
        assert placed(positions(twin.simulate(scheme("16P", "fit, driven"), contacts, seed).percept), places)


def test_one_press_of_any_size_is_one(twin: Setup) -> None:
    random = np.random.default_rng(3)
    for radius in (5e-3, 8e-3, 12e-3, 18e-3):
        for seed in range(6):
            place = random.uniform(0.02, 0.18, 2)
            seen = twin.simulate(scheme("16P", "fit, driven"), (contact("pressed", *place, radius=radius),), seed)
            assert len(positions(seen.percept)) == 1, (radius, place)


@pytest.mark.parametrize("place", [(0.0667, 0.0667), (0.1333, 0.1333), (0.070, 0.133), (0.0, 0.0667)])
@pytest.mark.parametrize(("mode", "reading"), [("16P", "fit, driven"), ("16T/4", "tracked, driven")])
def test_a_press_on_an_electrode_is_felt_there(
    twin: Setup, mode: str, reading: str, place: tuple[float, float]
) -> None:
    assert told_apart(twin, mode, reading, [place])
