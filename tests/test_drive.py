"""The paper's adaptive drive: eq. (7) to the letter, a sensible ranking, fair turns."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ohmskin.drive import DRIVES, DriveSettings, Fixed, OptimalDrive, TwoScans, pair_weights, round_robin
from ohmskin.errors import PatternError
from ohmskin.geometry import Electrodes, Rectangle
from ohmskin.scan import adjacent, all_pairs, measure_others
from ohmskin.sensing import drive_of, mode_named, modes
from ohmskin.skin import Skin

SHEET = Rectangle(0.2, 0.2)
GRID = Electrodes.grid(SHEET)
anchors = st.lists(st.tuples(st.floats(0, 0.2), st.floats(0, 0.2)), min_size=3, max_size=3)


def anchors_about(x: float, y: float, size: float = 0.003) -> np.ndarray:
    angle = np.array([0.3, 2.4, 4.5])
    return np.array([x, y]) + size * np.column_stack([np.cos(angle), np.sin(angle)])


def heron(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    u, v, w = (float(np.linalg.norm(p - q)) for p, q in ((a, b), (b, c), (c, a)))
    s = (u + v + w) / 2
    return max(s * (s - u) * (s - v) * (s - w), 0.0) ** 0.5


# --- eq. (7) ----------------------------------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_pair_weights_are_eq_7_by_its_three_loops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions, points = rng.uniform(0, 0.2, (7, 2)), rng.uniform(0, 0.2, (3, 2))
    areas = []
    for i, j in combinations(range(7), 2):
        total = 0.0
        for k in range(3):
            total += heron(positions[i], positions[j], points[k])
        areas.append(total)
    assert pair_weights(positions, points) == pytest.approx([sum(areas) / area for area in areas], rel=1e-6)


@given(anchors)
def test_weights_are_finite_positive_and_their_inverses_sum_to_one(points: list[tuple[float, float]]) -> None:
    weights = pair_weights(GRID.positions, points)
    assert weights.shape == (120,)
    assert np.isfinite(weights).all()
    assert (weights >= 1).all()
    assert np.sum(1 / weights) == pytest.approx(1, rel=1e-9)


def test_weights_do_not_depend_on_the_unit_of_length() -> None:
    points = anchors_about(0.05, 0.11)
    assert pair_weights(1e3 * GRID.positions, 1e3 * points) == pytest.approx(
        pair_weights(GRID.positions, points), rel=1e-9
    )


def test_a_pair_on_one_line_with_all_anchors_is_clamped() -> None:
    line = np.array([[0.02, 0.0], [0.05, 0.0], [0.15, 0.0]])
    weights = pair_weights(GRID.positions, line)
    i, j = all_pairs(16).T
    on_line = (GRID.positions[i, 1] == 0) & (GRID.positions[j, 1] == 0)
    assert on_line.sum() == 6
    assert np.isfinite(weights).all()
    assert weights[on_line].min() > 1e6 * weights[~on_line].max()


def test_the_pairs_whose_line_passes_through_the_contact_come_first() -> None:
    i, j = all_pairs(16).T
    for x, y, axis in ((0.09, 0.2 / 3, 1), (0.4 / 3, 0.05, 0)):
        ranked = np.argsort(-pair_weights(GRID.positions, anchors_about(x, y, 1e-3)))[
            :6
        ]  # four electrodes on a line: six pairs
        for ends in (i, j):
            np.testing.assert_allclose(GRID.positions[ends[ranked], axis], (x, y)[axis])


@given(x=st.floats(0.02, 0.18), y=st.floats(0.02, 0.18))
def test_of_pairs_equally_long_the_one_closer_to_the_contact_weighs_more(x: float, y: float) -> None:
    points = anchors_about(x, y)
    weights = pair_weights(GRID.positions, points)
    i, j = all_pairs(16).T
    start, along = GRID.positions[i], GRID.positions[j] - GRID.positions[i]
    length = np.linalg.norm(along, axis=1)
    offset = points[None] - start[:, None]
    distance = np.abs(along[:, None, 0] * offset[..., 1] - along[:, None, 1] * offset[..., 0]).sum(1) / length
    for size in np.unique(length.round(9)):
        group = np.flatnonzero(np.abs(length - size) < 1e-8)
        ordered = group[np.argsort(distance[group])]
        assert (np.diff(weights[ordered]) <= 1e-9 * weights[ordered][:-1]).all()


# --- turns ------------------------------------------------------------------------------------------------------------


@given(st.integers(1, 5), st.integers(1, 60), st.integers(0, 2**32 - 1), st.booleans())
def test_regions_choose_in_turn_the_best_pair_still_free(regions: int, n: int, seed: int, ties: bool) -> None:
    rng = np.random.default_rng(seed)
    weights = rng.integers(0, 4, (regions, n)).astype(float) if ties else rng.random((regions, n))
    for count in (1, min(regions, n), n // 2 + 1, n, n + 5):
        chosen = round_robin(weights, count)
        assert len(chosen) == min(count, n)
        assert len(set(chosen.tolist())) == len(chosen)
        np.testing.assert_array_equal(chosen, round_robin(weights, n)[:count])
    best = [int(w.argmax()) for w in weights]
    assert list(dict.fromkeys(best)) == round_robin(weights, n)[: len(set(best))].tolist()


def test_two_distant_regions_share_the_pairs_evenly() -> None:
    weights = np.array([[9, 8, 7, 0.4, 0.3, 0.2], [0.1, 0.2, 0.3, 7, 8, 9]])
    assert round_robin(weights, 6).tolist() == [0, 5, 1, 4, 2, 3]
    assert round_robin(weights[0], 3).tolist() == [0, 1, 2]


# --- patterns ---------------------------------------------------------------------------------------------------------


@given(st.lists(anchors, min_size=1, max_size=4), st.integers(1, 120))
@settings(max_examples=40)
def test_the_optimal_pattern_drives_the_chosen_pairs_and_measures_at_all_others(regions: list, count: int) -> None:
    pattern = OptimalDrive(GRID, count).pattern(regions)
    weights = np.array([pair_weights(GRID.positions, points) for points in regions])
    chosen = all_pairs(16)[round_robin(weights, count)]
    assert pattern == measure_others(chosen, range(16))
    assert pattern.n_meas == 13 * count


@pytest.mark.parametrize("pairs", [0, -1, 121])
def test_the_number_of_pairs_is_limited_by_the_electrodes(pairs: int) -> None:
    with pytest.raises(PatternError, match=r"there are 1\.\.120 pairs"):
        OptimalDrive(GRID, pairs)


# --- modes ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("layout", "names"),
    [
        ('layout = "grid"\ncolumns = 4\nrows = 4', ["12B", "16I", "16O"]),
        ('layout = "rim"\ncount = 12', ["12B", "12O"]),
        ('layout = "rim"\ncount = 16', ["16B", "16O"]),
        ('layout = "grid"\ncolumns = 3\nrows = 3', ["8B", "9I", "9O"]),
        ('layout = "grid"\ncolumns = 5\nrows = 5', ["16B", "25I", "25O"]),
        ('layout = "grid"\ncolumns = 5\nrows = 3', ["12B", "15I", "15O"]),
    ],
)
def test_modes_have_the_labels_of_the_paper(layout: str, names: list[str]) -> None:
    skin = Skin.parse(f"[electrode]\n{layout}\n")
    found = {name: mode for name, mode in modes(skin).items() if name[-1] in "BIO"}
    assert list(found) == names
    assert [found[name].name for name in names] == names
    drives = [drive_of(mode, skin) for mode in found.values()]
    rim = skin.electrodes.rings[0]
    assert drives[0].next([], 0) == drives[-1].next([], 0) == adjacent([rim])
    assert isinstance(drives[0], Fixed)
    assert isinstance(drives[-1], TwoScans)
    assert isinstance(drives[-1].second, OptimalDrive)
    for drive in drives:
        drive.next([], 0).check(len(skin.electrodes))


def test_adaptive_mode_takes_the_number_of_pairs_and_whether_to_fuse() -> None:
    adaptive = DRIVES["eq7"](DriveSettings(GRID, pairs=5), 0)
    assert adaptive.scans == 2
    assert adaptive.second.pattern([anchors_about(0.1, 0.1)]).n_inj == 5
    assert adaptive.injections == 17
    assert DRIVES["eq7"](DriveSettings(GRID), 17).second.pairs == 5  # of both scans
    assert DRIVES["rings"](DriveSettings(GRID), 0).next([], 0) == adjacent(GRID.rings)
    for fuse in (True, False):
        skin = Skin.parse(f"[imaging]\nfuse = {str(fuse).lower()}\npairs = 5\n")
        assert mode_named(skin, "16O").fuse is fuse
        assert drive_of(mode_named(skin, "16O"), skin).injections == 17


def test_an_unknown_mode_lists_the_possible_ones() -> None:
    with pytest.raises(PatternError, match=r"mode '16B' is not possible .* choose from 12B, 16I, 16O"):
        mode_named(Skin.load("paper"), "16B")
