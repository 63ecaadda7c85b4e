"""Drive patterns as linear combinations of electrode pairs, and what is learned from an untouched skin."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ohmskin.errors import DataError, PatternError
from ohmskin.scan import (
    Baseline,
    Difference,
    DrivePattern,
    Frame,
    adjacent,
    all_pairs,
    measure_others,
    n_pairs,
    needed,
    opposite,
    pair_index,
    skip,
)

RIM, PAPER = [range(12)], [range(12), range(12, 16)]


def transfer_matrix(n: int, seed: int = 0) -> np.ndarray:
    """A random symmetric transfer resistance matrix (ohm), of about 100 ohm."""
    a = np.random.default_rng(seed).normal(size=(n, n))
    return 50 * (a + a.T)


def four_terminal(s: np.ndarray, pattern: DrivePattern) -> np.ndarray:
    a, b, c, d = pattern.quadruples.T
    return s[a, c] - s[a, d] - s[b, c] + s[b, d]


def frame_of(
    s: np.ndarray, pattern: DrivePattern, currents: float | np.ndarray = 2e-3, noise: float = 0.0, seed: int = 0
) -> Frame:
    currents = np.broadcast_to(np.asarray(currents, float), pattern.n_inj)
    volts = four_terminal(s, pattern) * currents[pattern.measurements[:, 0]]
    return Frame(pattern, volts + np.random.default_rng(seed).normal(0, 1, pattern.n_meas) * noise, currents, time=0.0)


injections = st.integers(4, 20).flatmap(
    lambda n: st.tuples(
        st.just(n),
        st.lists(st.lists(st.integers(0, n - 1), min_size=2, max_size=2, unique=True), min_size=1, max_size=30),
    )
)


# --- pairs ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [2, 3, 4, 7, 16, 64])
def test_pair_numbers_are_the_order_of_all_pairs_whatever_the_direction(n: int) -> None:
    pairs = all_pairs(n)
    assert pairs.tolist() == [list(pair) for pair in combinations(range(n), 2)]
    assert n_pairs(n) == len(pairs)
    np.testing.assert_array_equal(pair_index(*pairs.T, n), np.arange(len(pairs)))
    np.testing.assert_array_equal(pair_index(*pairs[:, ::-1].T, n), np.arange(len(pairs)))


# --- patterns ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rings", "n_inj", "n_meas"), [(RIM, 12, 108), ([range(16)], 16, 208), (PAPER, 16, 208), ([range(4)], 4, 4)]
)
def test_adjacent_drive_has_the_measurements_of_the_paper(rings: list[range], n_inj: int, n_meas: int) -> None:
    pattern = adjacent(rings)
    assert (pattern.n_inj, pattern.n_meas) == (n_inj, n_meas)


def test_adjacent_drive_of_a_rim_measures_the_classical_neighbours() -> None:
    expected = [(k, (k + 1) % 12, (k + 2 + m) % 12, (k + 3 + m) % 12) for k in range(12) for m in range(9)]
    assert [tuple(q) for q in adjacent(RIM).quadruples.tolist()] == expected


def test_opposite_drive_uses_each_diameter_once() -> None:
    pattern = opposite(range(12))
    assert pattern.injections.tolist() == [[k, k + 6] for k in range(6)]
    assert pattern.n_meas == 6 * 9


def test_skip_drive_goes_round_each_ring_with_its_step() -> None:
    rim, inner = [[k, (k + 3) % 12] for k in range(12)], [[12 + k, 12 + (k + 3) % 4] for k in range(4)]
    assert skip(PAPER, 3).injections.tolist() == rim + inner
    assert skip(PAPER, 1) == adjacent(PAPER)


def test_the_lone_electrode_in_the_middle_of_a_grid_is_measured_and_not_driven() -> None:
    pattern = adjacent([range(8), range(8, 9)])
    assert pattern.injections.max() == 7
    assert set(pattern.measurements[:, 1:].ravel().tolist()) == set(range(9))


@pytest.mark.parametrize(("rings", "step"), [(RIM, 0), (RIM, 12), (PAPER, 4), (RIM, -1), ([[0], [1], [2], [3]], 1)])
def test_a_step_that_does_not_fit_the_rings_is_refused(rings: list[range], step: int) -> None:
    with pytest.raises(PatternError, match=r"step .*; it must be 1\.\."):
        skip(rings, step)


def test_rings_name_each_electrode_once_and_half_way_round_needs_an_even_number() -> None:
    with pytest.raises(PatternError, match="electrode 0 is in the rings more than once"):
        adjacent([range(8), range(8)])
    with pytest.raises(PatternError, match="a ring of 17 electrodes has none half-way round"):
        opposite(range(17))


@given(injections)
def test_driven_electrodes_are_not_measured_and_all_others_are_spanned(case: tuple[int, list[list[int]]]) -> None:
    n, pairs = case
    pattern = measure_others(pairs, range(n))
    assert pattern.n_meas == len(pairs) * (n - 3)
    for k, pair in enumerate(pairs):
        voltages = pattern.measurements[pattern.measurements[:, 0] == k][:, 1:]
        assert not set(pair) & set(voltages.ravel().tolist())
        incidence = np.zeros((n - 3, n))
        incidence[np.arange(n - 3), voltages[:, 0]], incidence[np.arange(n - 3), voltages[:, 1]] = 1, -1
        assert np.linalg.matrix_rank(incidence) == n - 3


def test_electrodes_outside_the_walk_may_be_driven() -> None:
    pattern = measure_others([[12, 0], [12, 13]], range(12))
    assert [int((pattern.measurements[:, 0] == k).sum()) for k in range(2)] == [10, 11]
    assert pattern.measurements[:, 1:].max() == 11


@given(injections, st.data())
@settings(max_examples=60)
def test_combinations_of_pairs_polarise_the_transfer_matrix(
    case: tuple[int, list[list[int]]], data: st.DataObject
) -> None:
    n, pairs = case
    pair = st.lists(st.integers(0, n - 1), min_size=2, max_size=2, unique=True)
    measured = sorted(data.draw(st.lists(st.tuples(st.integers(0, len(pairs) - 1), pair), min_size=1, max_size=20)))
    pattern = DrivePattern(
        np.array(pairs), np.array([[k, *p] for k, p in measured])
    )  # driven electrodes may be measured
    s = transfer_matrix(n)
    i, j = all_pairs(n).T
    two_terminal = s[i, i] + s[j, j] - 2 * s[i, j]
    np.testing.assert_allclose(pattern.combination(n) @ two_terminal, four_terminal(s, pattern), atol=1e-10)


@given(injections, st.integers(1, 40))
def test_split_pieces_put_together_are_the_pattern(case: tuple[int, list[list[int]]], size: int) -> None:
    n, pairs = case
    pattern = measure_others(pairs, range(n))
    pieces = list(pattern.split(size))
    assert [p.n_inj for p in pieces[:-1]] == [size] * (len(pieces) - 1)
    assert 1 <= pieces[-1].n_inj <= size
    np.testing.assert_array_equal(np.vstack([p.injections for p in pieces]), pattern.injections)
    np.testing.assert_array_equal(np.vstack([p.quadruples for p in pieces]), pattern.quadruples)


def test_equal_patterns_are_one_key_and_different_ones_are_two() -> None:
    pattern = adjacent(RIM)
    copy = DrivePattern(np.array(pattern.injections, np.int16), pattern.measurements.tolist())
    turned = DrivePattern(pattern.injections[:, ::-1], pattern.measurements)
    assert copy == pattern
    assert copy.digest == pattern.digest
    assert len({pattern, copy, turned}) == 2
    assert pattern != "pattern"


def test_patterns_do_not_change() -> None:
    with pytest.raises(ValueError, match="read-only"):
        adjacent(RIM).injections[0] = 5


@pytest.mark.parametrize(
    ("injected", "measured", "message"),
    [
        ([[0, 1, 2]], [[0, 2, 3]], "injections have shape \\(1, 3\\)"),
        (np.empty((0, 2), int), [[0, 2, 3]], "injections have shape"),
        ([[0.0, 1.0]], [[0, 2, 3]], "type float64"),
        ([[0, 1]], [[2, 3]], "measurements have shape"),
        ([[0, 1]], np.empty((0, 3), int), "measurements have shape"),
        ([[0, -1]], [[0, 2, 3]], "electrode or injection -1"),
        ([[1, 1]], [[0, 2, 3]], "injections\\[0\\] uses electrode 1 twice"),
        ([[0, 1]], [[0, 2, 3], [0, 4, 4]], "measurements\\[1\\] uses electrode 4 twice"),
        ([[0, 1]], [[1, 2, 3]], "injections 0..0"),
        ([[0, 1], [1, 2]], [[1, 3, 4], [0, 3, 4]], "sorted by injection number"),
    ],
)
def test_malformed_patterns_are_refused(injected: object, measured: object, message: str) -> None:
    with pytest.raises(PatternError, match=message):
        DrivePattern(injected, measured)


def test_an_electrode_that_is_not_there_is_named() -> None:
    adjacent(RIM).check(12)
    with pytest.raises(PatternError, match=r"names electrode 11; there are 11 \(0\.\.10\)"):
        adjacent(RIM).check(11)
    with pytest.raises(PatternError, match="there are 11"):
        adjacent(RIM).combination(11)
    with pytest.raises(PatternError, match="3 electrodes"):
        measure_others([[0, 1]], [0, 1, 2])


# --- frames -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("volts", "currents", "named"), [(107, 12, "voltages"), (108, 11, "currents"), (108, 1, "currents")]
)
def test_a_frame_fits_its_pattern(volts: int, currents: int, named: str) -> None:
    with pytest.raises(DataError, match=f"frame {named} have shape"):
        Frame(adjacent(RIM), np.zeros(volts), np.ones(currents), time=0.0)


# --- baseline ---------------------------------------------------------------------------------------------------------


def test_the_reference_is_the_mean_resistance_weighted_as_least_squares_has_it() -> None:
    pattern, s = adjacent(RIM), transfer_matrix(12)
    currents = np.random.default_rng(1).uniform(1e-3, 3e-3, (5, 12))
    frames = [frame_of(s, pattern, i, 1e-3, seed) for seed, i in enumerate(currents)]
    which = pattern.measurements[:, 0]
    expected = [
        np.linalg.lstsq(currents[:, [k]], np.array([f.voltages[m] for f in frames]), rcond=None)[0][0]
        for m, k in enumerate(which)
    ]
    baseline = Baseline.learn(frames)
    np.testing.assert_allclose(baseline.reference(pattern), expected, rtol=1e-12)
    assert baseline.repeats == 5
    assert baseline.difference_noise == pytest.approx(baseline.noise * np.sqrt(1.2))
    difference = baseline.difference(frames[0])
    np.testing.assert_allclose(difference.volts, frames[0].voltages - currents[0][which] * expected, atol=1e-15)
    np.testing.assert_array_equal(difference.currents, currents[0][which])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_the_reference_serves_any_direction_and_order_of_its_measurements(seed: int) -> None:
    rng = np.random.default_rng(seed)
    s, pattern = transfer_matrix(16), adjacent(PAPER)
    baseline = Baseline.learn([frame_of(s, pattern)] * 2)
    order = rng.permutation(16)
    injected, measured = [], []
    for k, source in enumerate(order):
        rows = pattern.measurements[pattern.measurements[:, 0] == source][:, 1:]
        rows = rows[rng.permutation(len(rows))[: rng.integers(1, 14)]]
        rows = np.where(rng.random((len(rows), 1)) < 0.5, rows, rows[:, ::-1])
        injected.append(pattern.injections[source][:: rng.choice([-1, 1])])
        measured += [(k, *row) for row in rows]
    shuffled = DrivePattern(np.array(injected), np.array(measured))
    np.testing.assert_allclose(baseline.reference(shuffled), four_terminal(s, shuffled), atol=1e-11)


def test_each_polarity_of_a_current_has_a_reference_of_its_own() -> None:
    """A device may measure it with another gain."""
    s, pattern = transfer_matrix(16), adjacent(PAPER)
    turned = DrivePattern(pattern.injections[:, ::-1], pattern.measurements)
    one, other = frame_of(s, pattern), frame_of(s, turned)
    baseline = Baseline.learn([one, one, replace(other, currents=1.01 * other.currents)] * 2)
    np.testing.assert_allclose(baseline.reference(pattern), four_terminal(s, pattern), atol=1e-11)
    np.testing.assert_allclose(baseline.reference(turned), four_terminal(s, turned) / 1.01, atol=1e-11)


def test_a_measurement_never_seen_while_quiet_is_named() -> None:
    baseline = Baseline.learn([frame_of(transfer_matrix(16), adjacent(RIM))] * 2)
    unseen = DrivePattern([[0, 1], [3, 5]], [[0, 2, 3], [1, 7, 6]])
    with pytest.raises(PatternError, match=r"no quiet reference for .* = \[3, 5, 7, 6\]; calibrate"):
        baseline.reference(unseen)
    beyond = DrivePattern([[14, 15]], [[0, 12, 13]])  # sorts behind all known codes
    with pytest.raises(PatternError, match="no quiet reference"):
        baseline.reference(beyond)


def test_several_patterns_are_learned_together() -> None:
    s = transfer_matrix(16)
    patterns = [adjacent(RIM), opposite(range(16)), adjacent(PAPER)]
    baseline = Baseline.learn([frame_of(s, p, 1e-3 * (1 + k)) for k in range(2) for p in patterns])
    for pattern in patterns:
        np.testing.assert_allclose(baseline.reference(pattern), four_terminal(s, pattern), atol=1e-11)


@pytest.mark.parametrize("count", [2, 3, 20])
def test_the_noise_of_repeated_frames_is_estimated_without_bias(count: int) -> None:
    s, sigma = transfer_matrix(12), 3e-4
    pattern = adjacent(RIM)
    estimates = [
        Baseline.learn([frame_of(s, pattern, noise=sigma, seed=100 * trial + k) for k in range(count)]).noise
        for trial in range(40)
    ]
    freedom = 40 * 108 * (count - 1)
    assert np.sqrt(np.mean(np.square(estimates))) == pytest.approx(sigma, rel=4 / np.sqrt(2 * freedom))


def test_the_noise_of_a_single_frame_is_told_by_reciprocity() -> None:
    s, sigma, pattern = transfer_matrix(16), 3e-4, adjacent([range(16)])
    currents = np.linspace(1e-3, 1.01e-3, 16)
    estimates = [Baseline.learn([frame_of(s, pattern, currents, sigma, seed)]).noise for seed in range(60)]
    assert np.sqrt(np.mean(np.square(estimates))) == pytest.approx(sigma, rel=4 / np.sqrt(60 * 208))
    assert Baseline.learn([frame_of(s, pattern, currents)]).noise < 1e-14
    turned = DrivePattern(pattern.injections[:, ::-1], pattern.measurements)
    assert Baseline.learn([frame_of(s, turned, currents)]).noise < 1e-14


def test_without_repeats_or_reciprocal_measurements_the_noise_cannot_be_told() -> None:
    with pytest.raises(DataError, match="record at least two"):
        Baseline.learn([frame_of(transfer_matrix(16), opposite(range(12)))])
    with pytest.raises(DataError, match="no quiet frames"):
        Baseline.learn([])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_left_out(bad: float) -> None:
    s, pattern = transfer_matrix(12), adjacent(RIM)
    quiet = [frame_of(s, pattern, noise=1e-4, seed=k) for k in range(8)]
    lost = [np.arange(108) == 7 + k // 4 for k in range(8)]
    holes = [Frame(pattern, np.where(at, bad, f.voltages), f.currents, 0.0) for at, f in zip(lost, quiet, strict=True)]
    baseline = Baseline.learn(holes)
    np.testing.assert_allclose(baseline.reference(pattern), four_terminal(s, pattern), atol=0.25)
    assert baseline.noise == pytest.approx(1e-4, rel=0.15)
    difference = baseline.difference(holes[0])
    assert np.flatnonzero(np.isnan(difference.volts)).tolist() == [7]
    single = Baseline.learn([holes[0]])
    assert single.noise == pytest.approx(1e-4, rel=0.4)
    assert np.flatnonzero(np.isnan(single.reference(pattern))).tolist() == [7]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_frames_with_nothing_finite_are_refused(bad: float) -> None:
    pattern = adjacent(RIM)
    empty = Frame(pattern, np.full(108, bad), np.full(12, 1e-3), 0.0)
    for quiet in ([empty], [empty, empty]):
        with pytest.raises(DataError, match="cannot be estimated"):
            Baseline.learn(quiet)


@pytest.mark.parametrize("current", [0.0, np.inf])
def test_an_injection_without_a_known_current_is_left_out(current: float) -> None:
    s, pattern = transfer_matrix(12), adjacent(RIM)
    quiet = [frame_of(s, pattern, noise=1e-4, seed=k) for k in range(3)]
    odd = [Frame(pattern, f.voltages, np.where(np.arange(12) == 2, current, f.currents), 0.0) for f in quiet]
    for count in (1, 3):
        reference = Baseline.learn(odd[:count]).reference(pattern)
        np.testing.assert_array_equal(np.isnan(reference), pattern.measurements[:, 0] == 2)
    assert not np.isfinite(Baseline.learn(quiet).difference(odd[0]).volts[18:27]).any() or current == 0


def test_a_measurement_of_several_patterns_takes_the_mean_of_all() -> None:
    s = transfer_matrix(12)
    full, half = adjacent(RIM), next(adjacent(RIM).split(6))
    frames = [frame_of(s, full, np.ones(12), 1e-3, 1), frame_of(s, half, np.ones(6), 1e-3, 2)]
    expected = (frames[0].voltages[: half.n_meas] + frames[1].voltages) / 2
    np.testing.assert_allclose(Baseline.learn(frames).reference(half), expected, rtol=1e-12)
    unknown = Frame(full, np.full(full.n_meas, np.nan), np.ones(12), 0.0)
    again = frame_of(s, half, np.ones(6), 1e-3, 3)
    expected = (frames[1].voltages + again.voltages) / 2
    np.testing.assert_allclose(Baseline.learn([unknown, frames[1], again]).reference(half), expected, rtol=1e-12)


def test_a_pattern_with_driven_electrodes_measures_source_and_sink_beside_what_it_measured() -> None:
    pattern = adjacent([range(12), range(12, 16)])
    driven = pattern.with_driven
    assert not pattern.driven.any()
    assert driven.driven.sum() == 2 * pattern.n_inj
    assert set(map(tuple, pattern.quadruples.tolist())) < set(map(tuple, driven.quadruples.tolist()))
    for k, (source, sink) in enumerate(pattern.injections):
        own = driven.measurements[(driven.measurements[:, 0] == k) & driven.driven]
        assert own[0, 1] == source
        assert own[1, 2] == sink
    assert driven.with_driven == driven
    assert needed([pattern, driven, adjacent([range(12)])]) == [driven, adjacent([range(12)])]
    # all that can be measured of an injection: n - 1 voltages, independent of each other
    whole = measure_others([[0, 7]], range(16)).with_driven
    assert np.linalg.matrix_rank(whole.combination(16).toarray()) == 15


def test_what_undriven_electrodes_say_is_a_difference_of_its_own() -> None:
    pattern = adjacent([range(8)]).with_driven
    volts = np.arange(pattern.n_meas, dtype=float)
    difference = Difference(pattern, np.ones(pattern.n_meas), volts, None, 2 * volts)
    undriven = difference.undriven
    assert undriven.pattern == adjacent([range(8)])
    np.testing.assert_array_equal(undriven.volts, volts[~pattern.driven])
    np.testing.assert_array_equal(undriven.reference, 2 * volts[~pattern.driven])
    assert undriven.undriven is undriven
