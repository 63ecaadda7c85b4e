"""Optimal design, held against dense recomputation, exhaustive search and the posterior of the image itself."""

from functools import lru_cache
from itertools import combinations

import numpy as np
import pytest

from ohmskin.drive import (
    DRIVES,
    Candidates,
    ContactPrior,
    DriveSettings,
    Search,
    Target,
    base_pattern,
    best_fixed,
    complete_pattern,
    exchange,
    greedy,
    part_of,
    position_bound,
)
from ohmskin.drive.bound import contact_columns, position_goals, spread_places
from ohmskin.errors import ModelError, PatternError
from ohmskin.forward import ContactTable, TransferModel, VoltageSource
from ohmskin.geometry import Electrodes, Rectangle, mesh_domain
from ohmskin.inverse import GaussNewton
from ohmskin.scan import Cost, Difference, DrivePattern, adjacent, all_pairs, measure_others

SHEET = Rectangle(0.2, 0.2)
GRID = Electrodes.grid(SHEET)
NOISE = 2.5e-4


@lru_cache
def model() -> TransferModel:
    return TransferModel(mesh_domain(SHEET, 5.5e-3, GRID.positions), GRID, 1.83e-3)


@lru_cache
def table() -> ContactTable:
    return ContactTable(model(), 10e-3)


@lru_cache
def everything() -> Candidates:
    return Candidates.at_currents(complete_pattern(GRID), 16, NOISE)


def problem(seed: int, n: int = 8, m: int = 3, d: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, a covariance and a goal, at random."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(d, d))
    return random.normal(size=(n, m, d)), root @ root.T + 0.1 * np.eye(d), random.normal(size=(2, d))


def after(rows: np.ndarray, covariance: np.ndarray, chosen: tuple[int, ...]) -> np.ndarray:
    """The covariance, computed anew from all that was measured."""
    return np.linalg.inv(np.linalg.inv(covariance) + sum(rows[k].T @ rows[k] for k in chosen))


def variance(covariance: np.ndarray, goal: np.ndarray) -> float:
    return float(np.trace(goal @ covariance @ goal.T))


# --- the search -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_updates_are_the_covariance_computed_anew(seed: int) -> None:
    rows, covariance, goal = problem(seed)
    search = Search(rows, covariance, goal, repeats=True)
    kept = []
    for number in np.random.default_rng(seed).integers(0, 8, 25):
        search.take(int(number))
        kept.append(int(number))
        if len(kept) % 4 == 0:
            search.drop(kept.pop(0))
        fresh = after(rows, covariance, tuple(kept))
        np.testing.assert_allclose(search.covariance[0], fresh, rtol=1e-9, atol=1e-9 * np.abs(fresh).max())
        assert search.sums[0, 0] == pytest.approx(variance(fresh, goal), rel=1e-9)
    assert search.chosen == kept


@pytest.mark.parametrize("seed", range(5))
def test_gains_are_what_each_candidate_would_change(seed: int) -> None:
    rows, covariance, goal = problem(seed)
    for goals in (goal, None):
        search = Search(rows, covariance, goals)
        search.take(3)
        now, gains = after(rows, covariance, (3,)), search.gains()
        for k in range(8):
            then = after(rows, covariance, (3, k))
            less = variance(now, goal) - variance(then, goal)
            information = 0.5 * np.log(np.linalg.det(now) / np.linalg.det(then))
            assert gains[k, 0, 0] == pytest.approx(information if goals is None else less, rel=1e-9)
            assert gains[k, 0, 0] > 0  # knowing more never hurts


def test_rows_of_some_numbers_of_the_state_are_those_with_zeros_for_the_others() -> None:
    rows, covariance, goal = problem(1)
    columns = np.random.default_rng(1).permuted(np.tile(np.arange(rows.shape[-1]), (len(rows), 1)), axis=1)[:, :2]
    whole = np.zeros_like(rows)
    np.put_along_axis(whole, np.broadcast_to(columns[:, None], rows[..., :2].shape), rows[..., :2], axis=-1)
    part, dense = Search(rows[..., :2], covariance, goal, columns), Search(whole, covariance, goal)
    np.testing.assert_allclose(part.choose(4), dense.choose(4), rtol=1e-12)
    assert part.chosen == dense.chosen
    some = np.array([1, 4, 6])
    np.testing.assert_allclose(part.among(some).gains(), dense.gains()[some], rtol=1e-9)


def test_several_cases_and_goals_are_averaged() -> None:
    cases = [problem(seed) for seed in range(1, 5)]
    rows, covariance = np.stack([c[0] for c in cases]), np.stack([c[1] for c in cases])
    goals = np.stack([cases[0][2], cases[1][2]])
    sums = np.array([[[variance(after(r, p, (k,)), g) for g in goals] for r, p, _ in cases] for k in range(8)])
    assert Search(rows, covariance, goals).best() == np.argmin(sums.mean(axis=(1, 2)))


@pytest.mark.parametrize("seed", range(8))
def test_greedy_information_is_at_least_63_per_cent_of_the_best_set(seed: int) -> None:
    """Information is submodular: Nemhauser, Wolsey and Fisher 1978."""
    rows, covariance, _ = problem(seed)
    best = max(-0.5 * np.log(np.linalg.det(after(rows, covariance, chosen))) for chosen in combinations(range(8), 3))
    best += 0.5 * np.log(np.linalg.det(covariance))
    found = greedy(rows, covariance, 3)
    assert (1 - 1 / np.e) * best <= found.values[-1] <= best * (1 + 1e-12)
    assert found.values[0] == 0


@pytest.mark.parametrize("seed", range(8))
def test_exchange_finds_the_best_set_or_nearly(seed: int) -> None:
    rows, covariance, goal = problem(seed, n=9)
    every = {chosen: variance(after(rows, covariance, chosen), goal) for chosen in combinations(range(9), 4)}
    found = exchange(rows, covariance, 4, goal)
    chosen = tuple(sorted(int(k) for k in found))
    assert len(set(chosen)) == 4
    neighbours = [tuple(sorted({*chosen} - {k} | {j})) for k in chosen for j in range(9) if j not in chosen]
    assert all(every[chosen] <= every[other] * (1 + 1e-9) for other in neighbours)
    assert every[chosen] <= greedy(rows, covariance, 4, goal).values[-1] * (1 + 1e-9)
    assert every[chosen] <= 1.05 * min(every.values())


def test_values_fall_and_repeats_can_only_help() -> None:
    rows, covariance, goal = problem(2)
    once, again = greedy(rows, covariance, 8, goal), greedy(rows, covariance, 8, goal, repeats=True)
    for choice in (once, again):
        assert (np.diff(choice.values) < 0).all()
    assert sorted(once.chosen) == list(range(8))
    assert again.values[-1] < once.values[-1]
    with pytest.raises(PatternError, match="all 8 injections are chosen"):
        greedy(rows, covariance, 9, goal)


def test_the_variance_of_a_region_is_that_of_the_image_with_all_its_elements() -> None:
    """Designed in image modes; recomputed from the prior covariance of a small mesh, element by element."""
    electrodes = Electrodes.grid(SHEET, 3, 3)
    small = TransferModel(mesh_domain(SHEET, 16e-3, electrodes.positions), electrodes, 1e-3)
    modes_of = GaussNewton(small, 1e-4, amplitude=0.1).modes
    complete = complete_pattern(electrodes)
    candidates = Candidates.at_currents(complete, 9, 1e-4)
    near = np.linalg.norm(small.mesh.centroids - [0.06, 0.14], axis=1) < 0.035
    rows, goal = candidates.rows(0.1 * modes_of.mixing), 0.1 * modes_of.modes[:, near].T
    choice = greedy(rows, np.eye(rows.shape[-1]), 4, goal)
    # what the modes say of the elements' covariance is enough: what no pair sees, no pattern changes
    covariance = 0.01 * modes_of.modes.T @ modes_of.modes
    for count in range(5):
        if count:
            jacobian = small.sensitivity(part_of(complete, choice.chosen[:count]), 1e-3) * small.conductivity
            seen = jacobian @ covariance
            posterior = covariance - seen.T @ np.linalg.solve(seen @ jacobian.T + 1e-8 * np.eye(len(seen)), seen)
        else:
            posterior = covariance
        assert choice.values[count] == pytest.approx(np.trace(posterior[np.ix_(near, near)]), rel=1e-6)


# --- candidates -------------------------------------------------------------------------------------------------------


def test_rows_are_the_patterns_own_and_reduced_rows_say_the_same() -> None:
    currents = np.linspace(1e-3, 2e-3, 120)
    candidates = Candidates.at_currents(complete_pattern(GRID), 16, NOISE, currents)
    columns = contact_columns(table(), ContactPrior.usual(10e-3).at([[0.05, 0.08], [0.15, 0.03]]))
    found = candidates.rows(columns)
    assert found.shape == (2, 120, 4, 4)
    for k in (0, 17, 119):
        pattern = part_of(candidates.pattern, np.array([k]))
        rows = pattern.combination(16).toarray() * currents[k] / NOISE  # pairs are driven in the order of their numbers
        for case in range(2):
            seen = rows @ columns[case]
            np.testing.assert_allclose(
                found[case, k].T @ found[case, k], seen.T @ seen, rtol=1e-9, atol=1e-9 * np.abs(seen).max() ** 2
            )


@pytest.mark.parametrize("noise", [0.0, -1e-3, np.nan, np.inf])
def test_a_noise_that_is_none_is_refused(noise: float) -> None:
    with pytest.raises(ModelError, match=r"noise is .* finite and positive"):
        Candidates.at_currents(complete_pattern(GRID), 16, noise)


@pytest.mark.parametrize("currents", [0.0, np.ones(119), np.append(np.ones(119), -1.0), np.full(120, np.nan)])
def test_currents_that_do_not_fit_are_refused(currents: float | np.ndarray) -> None:
    with pytest.raises(ModelError, match="120 electrode pairs"):
        Candidates.at_currents(complete_pattern(GRID), 16, NOISE, currents)


# --- contacts ---------------------------------------------------------------------------------------------------------


def test_contact_columns_are_the_derivatives_of_the_response() -> None:
    target = Target(np.array([0.07, 0.06]), np.eye(2), 3e-4, 9e-3)
    columns = contact_columns(table(), [target])[0]

    def response(x: float, y: float, share: float, log_radius: float) -> np.ndarray:
        return 3e-4 * share * table()([[x, y]], np.exp(log_radius)).values[0]

    at, steps = np.array([0.07, 0.06, 1.0, np.log(9e-3)]), (1e-7, 1e-7, 1e-4, 1e-5)
    for k, step in enumerate(steps):
        shift = step * np.eye(4)[k]
        difference = (response(*(at + shift)) - response(*(at - shift))) / (2 * step)
        assert np.linalg.norm(columns[:, k] - difference) < 1e-4 * np.linalg.norm(difference)


def test_the_bound_is_the_error_of_the_best_estimate_of_many_draws() -> None:
    """The best linear estimate of contacts drawn from the prior, small enough to be linear, has the error of the
    bound."""
    place, pattern = np.array([0.06, 0.09]), base_pattern(GRID)
    prior = ContactPrior(1e-4, 10e-3, 2e-3, 0.5, 0.2)
    noise = 4e-4
    claimed = position_bound(table(), place, pattern, noise, 1e-3, prior)[0]
    columns = contact_columns(table(), prior.at(place))[0]
    rows = pattern.combination(16).toarray() * 1e-3 @ columns
    random = np.random.default_rng(0)
    truth = random.multivariate_normal(np.zeros(4), prior.covariance(), 20_000)
    data = truth @ rows.T + noise * random.normal(size=(20_000, len(rows)))
    gain = (
        prior.covariance() @ rows.T @ np.linalg.inv(rows @ prior.covariance() @ rows.T + noise**2 * np.eye(len(rows)))
    )
    missed = (truth - data @ gain.T)[:, :2]
    assert np.sqrt((missed**2).sum(axis=1).mean()) == pytest.approx(
        claimed, rel=0.015
    )  # 0.5 % is the luck of the draws
    assert claimed < 0.8 * np.sqrt(2) * 2e-3  # the data count, and
    assert claimed > 1.2 * position_bound(table(), place, pattern, noise / 2, 1e-3, prior)[0]  # so does the noise


def test_better_schemes_have_smaller_bounds_in_the_order_that_was_found() -> None:
    """The order of findings: 12B, 16I, 6 opposite, the paper's 12B and 16, 6 opposite and 22 by information."""
    places = spread_places(table(), 40)
    candidates = everything()
    base = base_pattern(GRID)
    known = [int(k) for k in np.flatnonzero((all_pairs(16)[:, None] == base.injections).all(axis=2).any(axis=1))]

    def adaptive(place: np.ndarray, count: int) -> list[DrivePattern]:
        prior = ContactPrior.usual(10e-3)
        search = Search(
            candidates.rows(contact_columns(table(), prior.at(place)))[0], prior.covariance(), position_goals(1)
        )
        for number in known:
            search.take(number)
        for _ in range(count):
            search.take(search.best())
        return [part_of(candidates.pattern, np.array(search.chosen))]

    schemes = {
        "12B": adjacent([GRID.rings[0]]),
        "16I": adjacent(GRID.rings),
        "6 opposite": base,
        "12B and eq. (7)": DRIVES["eq7"](DriveSettings(GRID), 0),
        "6 and 10": lambda place: adaptive(place, 10),
        "6 and 22": lambda place: adaptive(place, 22),
    }
    found = [
        float(np.sqrt(np.mean(position_bound(table(), places, scheme, NOISE) ** 2))) for scheme in schemes.values()
    ]
    assert (np.diff(found) < 0).all(), dict(zip(schemes, found, strict=True))
    assert found[5] < 0.75 * found[3]  # equal numbers of injections


def test_modes_that_do_not_fuse_have_the_bound_of_their_second_scan() -> None:
    places = np.array([[0.05, 0.05], [0.11, 0.16]])
    drive, prior = DRIVES["eq7"](DriveSettings(GRID), 0), ContactPrior.usual(10e-3)
    schemes = drive, lambda place: [drive.next(prior.at(place), 1)]
    fused, literal = (position_bound(table(), places, scheme, NOISE, prior=prior) for scheme in schemes)
    assert (fused < literal).all()


def test_the_best_fixed_set_is_better_than_any_that_is_usual() -> None:
    places = spread_places(table(), 50)

    def error(pattern: DrivePattern) -> float:
        return float(np.mean(position_bound(table(), places, pattern, NOISE) ** 2))

    chosen = best_fixed(table(), everything(), 16, places)
    np.testing.assert_array_equal(chosen, best_fixed(table(), everything(), 16, places))
    assert len(set(chosen.tolist())) == 16
    best = error(part_of(everything().pattern, chosen))
    assert best < 0.5 * error(adjacent(GRID.rings))
    random = np.random.default_rng(0)
    assert best < min(error(part_of(everything().pattern, random.permutation(120)[:16])) for _ in range(10))
    one_less = [np.delete(chosen, k) for k in range(16)]
    assert best < min(error(part_of(everything().pattern, rest)) for rest in one_less)


def test_the_opposite_base_scan_is_within_two_per_cent_of_the_best_six() -> None:
    places = spread_places(table(), 80)
    best = part_of(everything().pattern, best_fixed(table(), everything(), 6, places))
    errors = [
        np.sqrt(np.mean(position_bound(table(), places, pattern, NOISE) ** 2)) for pattern in (best, base_pattern(GRID))
    ]
    assert errors[0] <= errors[1] < 1.02 * errors[0]


def test_spread_places_cover_the_sheet_evenly() -> None:
    places = spread_places(table(), 100)
    assert 80 <= len(places) <= 140
    np.testing.assert_allclose([places.min(axis=0), places.max(axis=0)], [[0.01, 0.01], [0.19, 0.19]], atol=2.6e-3)
    everywhere = np.random.default_rng(0).uniform(0.01, 0.19, (200, 2))
    assert np.linalg.norm(everywhere[:, None] - places, axis=2).min(axis=1).max() < 0.017


# --- costs ------------------------------------------------------------------------------------------------------------


def test_a_scan_costs_what_its_injections_settle_and_convert() -> None:
    pattern = measure_others(all_pairs(16)[:10], range(16))  # 13 voltages each
    assert Cost(1e-4, 2e-5).time(pattern) == pytest.approx(10 * 1.2e-4)
    assert Cost(1e-4, 2e-5, channels=1).time(pattern) == pytest.approx(10 * (1e-4 + 13 * 2e-5))
    assert Cost(1e-4, 2e-5, channels=4, overhead=3e-3).time(pattern) == pytest.approx(3e-3 + 10 * (1e-4 + 4 * 2e-5))


@pytest.mark.parametrize("cost", [Cost(1e-4, 2e-5), Cost(1e-4, 2e-5, 1), Cost(1e-4, 2e-5, 4, 1e-3), Cost(0, 1e-5, 3)])
def test_as_many_injections_fit_as_the_time_of_a_scan_says(cost: Cost) -> None:
    complete = complete_pattern(GRID)
    for count in (1, 5, 120):
        seconds = cost.time(part_of(complete, np.arange(count)))
        assert cost.injections(complete, seconds) == count
        if count > 1:
            assert cost.injections(complete, 0.999 * seconds) == count - 1
    assert cost.injections(complete, 1e3) == 120
    for seconds in (cost.overhead, -1.0, np.nan):
        with pytest.raises(PatternError, match="one injection takes"):
            cost.injections(complete, seconds)


def test_costs_cannot_be_negative() -> None:
    with pytest.raises(PatternError, match="conversion is -1e-05"):
        Cost(0.0, -1e-5)


# --- voltage sources --------------------------------------------------------------------------------------------------


@lru_cache
def with_discs() -> TransferModel:
    electrodes = GRID.with_discs(3e-3, 1e-4)
    return TransferModel(mesh_domain(SHEET, 5.5e-3), electrodes, 1.83e-3)


SOURCE = VoltageSource(5.0, 350.0)


def test_without_its_current_a_difference_has_the_rows_of_a_source_that_sags() -> None:
    sheet, pattern = with_discs(), part_of(complete_pattern(GRID), np.arange(0, 120, 7))
    change = np.where(np.linalg.norm(sheet.mesh.centroids - [0.07, 0.11], axis=1) < 12e-3, 1e-3, 0.0)
    touched = sheet.with_conductivity(sheet.conductivity * (1 + change))
    volts = SOURCE.voltages(touched, pattern) - SOURCE.voltages(sheet, pattern)
    nothing = np.full(pattern.n_meas, np.nan)  # the currents of such a device are not known
    difference = SOURCE.unmeasured(sheet, Difference(pattern, nothing, volts))
    pairs = sheet.pair_sensitivity @ (sheet.conductivity * change)
    foretold = (difference.combination(16) @ pairs) * difference.currents
    assert np.linalg.norm(foretold - volts) < 5e-3 * np.linalg.norm(volts)
    ignored = (pattern.combination(16) @ pairs) * difference.currents
    assert np.linalg.norm(ignored - volts) > 0.2 * np.linalg.norm(volts)
    np.testing.assert_allclose(SOURCE.by_pairs(sheet, pattern) @ pairs, foretold, rtol=1e-9, atol=1e-12)


def test_estimators_use_the_rows_of_a_source_that_sags() -> None:
    sheet, pattern = with_discs(), part_of(complete_pattern(GRID), np.arange(0, 120, 5))
    inside = np.linalg.norm(sheet.mesh.centroids - [0.05, 0.15], axis=1) < 10e-3
    touched = sheet.with_conductivity(sheet.conductivity * np.where(inside, 1.1, 1.0))
    volts = SOURCE.voltages(touched, pattern) - SOURCE.voltages(sheet, pattern)
    blind = Difference(pattern, SOURCE.currents(sheet, pattern)[pattern.measurements[:, 0]], volts)
    estimator = GaussNewton(sheet, 2e-4, amplitude=0.1)

    def missed(difference: Difference) -> float:
        image = estimator.reconstruct(difference).values
        fit = (
            difference.combination(16) @ (sheet.pair_sensitivity @ (sheet.conductivity * image))
        ) * difference.currents
        return float(np.linalg.norm(fit - volts) / np.linalg.norm(volts))

    assert missed(SOURCE.unmeasured(sheet, blind)) < 0.03
    assert missed(blind) > 3 * missed(SOURCE.unmeasured(sheet, blind))
