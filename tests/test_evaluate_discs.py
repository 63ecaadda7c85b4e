"""One contact or two: the disc model, its fits and the test between them."""

import numpy as np
import pytest
from scipy.stats import chi2

from ohmskin.drive import OptimalDrive
from ohmskin.evaluate.discs import DiscModel, DiscTest
from ohmskin.evaluate.experiments.discrimination import Area, areas
from ohmskin.evaluate.resolution import limits, smallest
from ohmskin.forward import TransferModel
from ohmskin.geometry import mesh_domain
from ohmskin.scan import Difference, adjacent
from ohmskin.skin import Skin

SKIN = Skin.load("paper")
RADIUS = 8e-3


@pytest.fixture(scope="module")
def model() -> DiscModel:
    mesh = mesh_domain(SKIN.domain, 6e-3, SKIN.electrodes.positions)
    return DiscModel(TransferModel(mesh, SKIN.electrodes, 1.83e-3), RADIUS)


def data(model: DiscModel, discs, noise: float, seed: int = 0) -> Difference:
    """A linear scan of discs (x, y, strength), with noise."""
    pattern = adjacent(SKIN.electrodes.rings)
    response = sum(a * model.response(np.array([x, y]))[0] for x, y, a in discs)
    volts = 1e-3 * pattern.combination(16) @ response
    volts += noise * np.random.default_rng(seed).standard_normal(len(volts))
    return Difference(pattern, np.full(pattern.n_meas, 1e-3), volts)


def test_splines_pass_through_the_responses_they_were_made_of(model: DiscModel) -> None:
    for place in (0, 17, 3210, len(model.places) - 1):
        value, _ = model.response(model.places[place])
        assert value == pytest.approx(model.responses[place], rel=1e-9, abs=1e-9 * np.abs(model.responses[place]).max())


def test_slope_of_a_response_is_its_finite_difference(model: DiscModel) -> None:
    at, step = np.array([0.0613, 0.1341]), 1e-6
    slope = model.response(at)[1]
    for axis in (0, 1):
        move = step * np.eye(2)[axis]
        difference = (model.response(at + move)[0] - model.response(at - move)[0]) / (2 * step)
        assert slope[axis] == pytest.approx(difference, rel=1e-5, abs=1e-6 * np.abs(slope).max())


def test_one_and_two_discs_are_found_again(model: DiscModel) -> None:
    single = DiscTest(model, 1e-7, (data(model, [(0.062, 0.131, 0.4)], 1e-7),)).one()
    assert single.positions[0] == pytest.approx([0.062, 0.131], abs=1e-4)
    assert single.strengths == pytest.approx(0.4, rel=0.01)
    truth = [(0.062, 0.131, 0.4), (0.083, 0.118, 0.7)]
    test = DiscTest(model, 1e-7, (data(model, truth, 1e-7),))
    pair = test.two(test.one())
    order = np.argsort(pair.positions[:, 0])
    assert pair.positions[order] == pytest.approx(np.array(truth)[:, :2], abs=1e-3)
    assert pair.strengths[order] == pytest.approx([0.4, 0.7], rel=0.05)


def test_two_discs_at_opposite_ends_are_found_too(model: DiscModel) -> None:
    truth = [(0.03, 0.05, 0.9), (0.16, 0.15, 0.4)]
    test = DiscTest(model, 1e-7, (data(model, truth, 1e-7),))
    pair = test.two(test.one())
    assert pair.positions[np.argsort(pair.positions[:, 0])] == pytest.approx(np.array(truth)[:, :2], abs=1e-3)


def test_chi_square_of_a_fit_has_its_degrees_of_freedom(model: DiscModel) -> None:
    noise = 2e-6
    seen = [DiscTest(model, noise, (data(model, [(0.1, 0.09, 0.5)], noise, seed),)).one().chi_square for seed in range(40)]
    freedom = adjacent(SKIN.electrodes.rings).n_meas - 3
    assert np.mean(seen) == pytest.approx(freedom, abs=4 * np.sqrt(2 * freedom / len(seen)))


def test_the_second_disc_explains_no_more_than_noise_of_a_single_one(model: DiscModel) -> None:
    noise, falls = 2e-6, []
    for seed in range(40):
        test = DiscTest(model, noise, (data(model, [(0.1, 0.09, 0.5)], noise, seed),))
        one = test.one()
        falls.append(one.chi_square - test.two(one).chi_square)
    assert np.mean(np.array(falls) > chi2.isf(0.01, 3)) < 0.15
    assert min(falls) > -1.0  # two discs fit at least as well as one


def test_a_second_scan_sharpens_the_fit(model: DiscModel) -> None:
    noise = 4e-6
    drive = OptimalDrive(SKIN.electrodes).pattern([[(0.1, 0.09)] * 3])
    response = 0.5 * model.response(np.array([0.1, 0.09]))[0]
    errors = []
    for seed in range(25):
        base = data(model, [(0.1, 0.09, 0.5)], noise, seed)
        volts = 1e-3 * drive.combination(16) @ response + noise * np.random.default_rng(99 + seed).standard_normal(drive.n_meas)
        more = Difference(drive, np.full(drive.n_meas, 1e-3), volts)
        fits = [DiscTest(model, noise, scans).one() for scans in ((base,), (base, more))]
        errors.append([np.linalg.norm(fit.positions[0] - [0.1, 0.09]) for fit in fits])
    alone, both = np.median(errors, axis=0)
    assert both < alone


def test_areas_leave_room_for_the_largest_distance_and_never_change() -> None:
    found = areas()
    assert found == areas()
    assert len(found) == 3
    for area in found:
        pair = np.array(area.pair(0.06))
        assert np.linalg.norm(pair[0] - pair[1]) == pytest.approx(0.06, rel=1e-12)
        assert pair.min() >= 0.015
        assert pair.max() <= 0.185
    assert np.array(Area((0.1, 0.1), 0.0).pair(0.02)) == pytest.approx(np.array([(0.09, 0.1), (0.11, 0.1)]), abs=1e-12)


def test_the_smallest_distance_stops_at_the_first_failure() -> None:
    assert smallest([0.06, 0.05, 0.04, 0.03], np.array([1.0, 0.5, 0.4, 0.9])) == 0.05
    assert smallest([0.06, 0.05], np.array([0.4, 1.0])) == np.inf
    assert smallest([0.01, 0.03, 0.02], np.array([0.2, 0.9, 0.6])) == 0.02


def test_a_threshold_that_single_contacts_exceed_is_raised() -> None:
    shape = (1, 2, 10)
    pairs = {"statistic": np.full(shape, 50.0), "near": np.ones(shape, bool), "dip": np.zeros(shape, bool)}
    quiet = {"single_statistic": np.full((1, 4, 10), 1.0), "single_dip": np.zeros((1, 4, 10), bool)}
    loud = {"single_statistic": np.full((1, 4, 10), 60.0), "single_dip": np.zeros((1, 4, 10), bool)}
    assert limits([0.02, 0.01], [pairs | quiet], "test").overall[0] == 0.01
    assert limits([0.02, 0.01], [pairs | loud], "test").overall[0] == np.inf
    assert limits([0.02, 0.01], [pairs | loud], "nominal").false[0] == 1.0
    assert limits([0.02, 0.01], [pairs | quiet], "dip").overall[0] == np.inf
