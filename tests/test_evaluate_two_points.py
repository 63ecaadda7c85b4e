"""One contact or two: the fits of one and of two contacts, and the test between them."""

import numpy as np
import pytest
from scipy.stats import chi2

from ohmskin.contacts import ContactFitter
from ohmskin.drive import OptimalDrive
from ohmskin.evaluate import worlds
from ohmskin.evaluate.experiments.discrimination import Area, areas
from ohmskin.evaluate.policies.pairs import RADIUS as RADIUS_OF_PAIRS
from ohmskin.evaluate.policies.pairs import apart, pair_places
from ohmskin.evaluate.policies.schemes import scheme
from ohmskin.evaluate.resolution import limits, smallest
from ohmskin.evaluate.setup import setup
from ohmskin.evaluate.shapes import disc
from ohmskin.evaluate.two_points import best_pair, best_single, one_or_two, resolved
from ohmskin.forward import ContactTable, TransferModel
from ohmskin.forward.response import effective_change
from ohmskin.geometry import mesh_domain
from ohmskin.scan import Difference, DrivePattern, adjacent
from ohmskin.skin import Skin

SKIN = Skin.load("paper")
RADIUS = 8e-3
AREA = np.pi * RADIUS**2
SCAN = adjacent(SKIN.electrodes.rings)


@pytest.fixture(scope="module")
def table() -> ContactTable:
    mesh = mesh_domain(SKIN.domain, 6e-3, SKIN.electrodes.positions)
    return ContactTable(TransferModel(mesh, SKIN.electrodes, 1.83e-3), RADIUS)


def trusting(table: ContactTable, noise: float) -> ContactFitter:
    """A fitter whose model has no errors."""
    return ContactFitter(table, noise, model_error=0.0)


def data(table: ContactTable, discs, noise: float, seed: int = 0, pattern: DrivePattern = SCAN) -> Difference:
    """A linear scan of discs (x, y, strength), with noise."""
    response = sum(a * AREA * table(np.array([x, y]), RADIUS).values[0] for x, y, a in discs)
    volts = 1e-3 * pattern.combination(16) @ response
    volts += noise * np.random.default_rng(seed).standard_normal(len(volts))
    return Difference(pattern, np.full(pattern.n_meas, 1e-3), volts)


def test_one_and_two_discs_are_found_again(table: ContactTable) -> None:
    fitter = trusting(table, 1e-7)
    single = best_single(fitter, data(table, [(0.062, 0.131, 0.4)], 1e-7)).params
    assert single[0, :2] == pytest.approx([0.062, 0.131], abs=1e-4)
    assert single[0, 2] == pytest.approx(0.4 * AREA, rel=0.01)
    truth = [(0.062, 0.131, 0.4), (0.083, 0.118, 0.7)]
    scan = data(table, truth, 1e-7)
    pair = best_pair(fitter, best_single(fitter, scan), scan).params
    order = np.argsort(pair[:, 0])
    assert pair[order, :2] == pytest.approx(np.array(truth)[:, :2], abs=1e-3)
    assert pair[order, 2] == pytest.approx(AREA * np.array([0.4, 0.7]), rel=0.05)


def test_two_discs_at_opposite_ends_are_found_too(table: ContactTable) -> None:
    truth = [(0.03, 0.05, 0.9), (0.16, 0.15, 0.4)]
    gain, _, pair = one_or_two(trusting(table, 1e-7), data(table, truth, 1e-7))
    assert pair.params[np.argsort(pair.params[:, 0]), :2] == pytest.approx(np.array(truth)[:, :2], abs=1e-3)
    assert gain > chi2.isf(0.01, 3)
    assert resolved(pair.params[:, :2], np.array(truth)[:, :2])
    assert not resolved(pair.params[:1, :2], np.array(truth)[:, :2])


def test_chi_square_of_a_fit_has_its_degrees_of_freedom(table: ContactTable) -> None:
    noise, seen = 2e-6, []
    for seed in range(40):
        scan = data(table, [(0.1, 0.09, 0.5)], noise, seed)
        left = (scan.volts - scan.caused_by(best_single(trusting(table, noise), scan).caused)) / noise
        seen.append(left @ left)
    freedom = SCAN.n_meas - 4
    assert np.mean(seen) == pytest.approx(freedom, abs=4 * np.sqrt(2 * freedom / len(seen)))


def test_the_second_disc_explains_no_more_than_noise_of_a_single_one(table: ContactTable) -> None:
    noise = 2e-6
    gains = np.array(
        [one_or_two(trusting(table, noise), data(table, [(0.1, 0.09, 0.5)], noise, seed))[0] for seed in range(40)]
    )
    assert np.mean(gains > chi2.isf(0.01, 3)) < 0.15
    assert gains.min() > -1.0  # two discs fit at least as well as one


def test_a_second_scan_sharpens_the_fit(table: ContactTable) -> None:
    noise, discs = 4e-6, [(0.1, 0.09, 0.5)]
    drive = OptimalDrive(SKIN.electrodes).pattern([[(0.1, 0.09)] * 3])
    errors = []
    for seed in range(25):
        scans = data(table, discs, noise, seed), data(table, discs, noise, 99 + seed, drive)
        fits = [best_single(trusting(table, noise), *some) for some in (scans[:1], scans)]
        errors.append([np.linalg.norm(fit.params[0, :2] - [0.1, 0.09]) for fit in fits])
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


def test_limits_tell_how_sure_they_are() -> None:
    dip = np.zeros((1, 2, 10), bool)
    dip[0, 0], dip[0, 1, :6] = True, True  # 60 % of the seeds at the smaller distance
    area = {"dip": dip, "single_dip": np.zeros((1, 4, 10), bool)}
    found = limits([0.02, 0.01], [area], "dip")
    assert found.overall[0] == 0.01
    assert set(found.resampled[0]) == {0.02, 0.01}
    assert 0.7 < np.mean(found.resampled[0] == 0.01) < 0.95  # binomial: P(5 or more of 10 at 0.6) = 0.83


@pytest.mark.parametrize("strength", [0.5, 1.4])
@pytest.mark.parametrize("distance", [12e-3, 20e-3])
def test_two_discs_disturb_each_other_as_finite_elements_say(strength: float, distance: float) -> None:
    """What two discs change together less what each changes alone, on a mesh of its own and at any strength."""
    where = setup("discs", 60)
    effect = float(effective_change(np.log1p(strength))[0]) * np.pi * RADIUS_OF_PAIRS**2
    left = []
    for spot in pair_places(6, 25e-3, where.electrodes.positions):
        truth = apart(spot, distance)
        discs = tuple(disc(x, y, RADIUS_OF_PAIRS, strength) for x, y in truth)
        both, *each = (across(worlds.touched("discs", "grid", some)) for some in (discs, discs[:1], discs[1:]))
        mutual = both - sum(each) + across(worlds.sheet("discs", "grid").untouched)
        contacts = np.array([[*at, effect, RADIUS_OF_PAIRS**2] for at in truth])
        fitter = where.known.fitter
        caused, alone = fitter.responses(contacts)[0], (fitter.responses(contacts[[k]])[0] for k in range(2))
        left.append(np.linalg.norm(caused - sum(alone) - mutual) / np.linalg.norm(mutual))
    assert np.max(left) < 0.3
    assert np.mean(left) < 0.2


def test_a_strong_pair_is_two_although_one_disc_that_looks_like_it_is_far_wider() -> None:
    """All pairs of docs/policies.md; that at one place had been taken for a wide contact and one at the rim."""
    where = setup("discs", 60)
    for spot in pair_places(12, 12e-3, where.electrodes.positions):
        truth = apart(spot, 12e-3)
        pair = tuple(disc(x, y, RADIUS_OF_PAIRS, 1.4) for x, y in truth)
        seen = where.simulate(scheme("16P", "fit, driven"), pair, 1).contacts
        assert len(seen) == 2
        assert resolved([one.position for one in seen], truth)


def across(resistance: np.ndarray) -> np.ndarray:
    """Two-terminal resistances (n_pairs,)."""
    i, j = np.triu_indices(len(resistance), 1)
    return resistance[i, i] + resistance[j, j] - 2 * resistance[i, j]


@pytest.mark.parametrize("radius", [10e-3, 15e-3, 20e-3])
def test_a_large_contact_is_one_and_as_large_as_it_is(radius: float) -> None:
    where, random = setup("discs", 50), np.random.default_rng(4)
    counts, sizes, misses = [], [], []
    for seed, at in enumerate(random.uniform(0.03, 0.17, (20, 2))):
        contacts = where.simulate(scheme("16P", "fit, driven"), (disc(*at, radius, 0.5),), seed).contacts
        counts.append(len(contacts))
        sizes.append(contacts[0].radius / radius)
        misses.append(np.hypot(*np.subtract(contacts[0].position, at)))
    assert counts.count(1) >= 18, counts
    assert np.median(sizes) == pytest.approx(1.0, abs=0.15)
    assert np.median(misses) < 2e-3
