"""Policies: what they must always do, and what they lose against weighing everything exactly."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ohmskin.arrays import Floats
from ohmskin.contacts import find_regions
from ohmskin.drive import (
    DRIVES,
    Candidates,
    ContactPrior,
    Drive,
    DriveSettings,
    Exploration,
    PositionDrive,
    Ranking,
    Target,
    TrackingDrive,
    base_pattern,
    complete_pattern,
    part_of,
)
from ohmskin.drive.bound import contact_columns
from ohmskin.drive.design import whitened
from ohmskin.errors import PatternError
from ohmskin.forward import ContactTable
from ohmskin.inverse import GaussNewton
from ohmskin.scan import Baseline, DrivePattern, Frame, measure_others, pair_index
from ohmskin.sensing import SkinModel, build, drive_of, mode_named
from ohmskin.skin import Skin, VirtualSkin

PAPER = Skin.load("paper")
GRID = PAPER.electrodes
NOISE = 3e-4


@lru_cache
def table() -> ContactTable:
    return ContactTable(PAPER.transfer_model(), 8e-3, 4e-3)


@lru_cache
def candidates() -> Candidates:
    return Candidates.at_currents(complete_pattern(GRID), 16, NOISE)


@lru_cache
def policy(kind: str) -> Drive:
    if kind == "exploration":
        return Exploration(GRID, 4)
    return TrackingDrive(GRID, lambda: (table(), candidates()), 4, explore=1, exact="exact" in kind)


KINDS = ["exploration", "position", "position exact"]


def target(x: float, y: float, spread: float = 3e-3) -> Target:
    return Target(np.array([x, y]), np.eye(2) * spread**2, 1e-4, 8e-3)


def numbers(pattern: DrivePattern) -> list[int]:
    return pair_index(pattern.injections[:, 0], pattern.injections[:, 1], 16).tolist()


def error_after(pattern: DrivePattern, *known: Target) -> float:
    """Root-mean-square position error of contacts after a scan, from all of its voltages at once (m)."""
    rows = whitened(pattern, 16, NOISE) @ np.hstack(contact_columns(table(), known))
    prior = ContactPrior.usual(8e-3, 0.6, 0.5).covariance(known)
    posterior = np.linalg.inv(np.linalg.inv(prior) + rows.T @ rows)
    return float(np.sqrt(np.diagonal(posterior).reshape(len(known), -1)[:, :2].sum(axis=1).mean()))


places = st.floats(0.005, 0.195)
beliefs = st.lists(st.builds(target, places, places, st.floats(2e-4, 2e-2)), max_size=4)


@pytest.mark.parametrize("kind", KINDS)
@given(targets=beliefs, turn=st.integers(0, 10_000))
@settings(max_examples=15)
def test_every_pattern_is_a_part_of_the_complete_one_and_explores(kind: str, targets: list[Target], turn: int) -> None:
    chosen = policy(kind)
    pattern = chosen.next(targets, turn)
    assert pattern.n_inj == chosen.injections == 4
    assert pattern == part_of(chosen.complete, np.array(numbers(pattern)))
    opposite = numbers(base_pattern(GRID))
    assert set(numbers(pattern)[: 1 if targets else 4]) <= set(opposite)
    assert chosen.next(targets, turn) == pattern  # no memory


@pytest.mark.parametrize("kind", KINDS)
def test_exploring_comes_round(kind: str) -> None:
    opposite = sorted(numbers(base_pattern(GRID)))
    for targets, frames in (([], 2), ([target(0.05, 0.1)], 6)):
        exploring = 1 if targets and kind != "exploration" else 4
        explored = {k for turn in range(7, 7 + frames) for k in numbers(policy(kind).next(targets, turn))[:exploring]}
        assert sorted(explored) == opposite


@pytest.mark.parametrize(("injections", "exploring"), [(1, 1), (2, 1), (3, 1), (4, 2), (9, 2)])
def test_two_explore_but_no_more_than_half(injections: int, exploring: int) -> None:
    chosen = TrackingDrive(GRID, lambda: (table(), candidates()), 4).with_injections(injections)
    explored = [k for turn in range(6) for k in numbers(chosen.next([target(0.05, 0.1)], turn))[:exploring]]
    round_trip = numbers(part_of(chosen.complete, chosen.drives))
    assert explored == [round_trip[k % 6] for k in range(6 * exploring)]


@pytest.mark.parametrize("kind", ["position", "position exact"])
def test_where_one_more_contact_may_be_every_other_frame_measures_there_alone(kind: str) -> None:
    known, there = target(0.05, 0.15), Target.possible(np.array([0.15, 0.06]), 8e-3)
    assumed = target(0.15, 0.06, 4.8e-3)
    before, alone, usual = (
        policy(kind).next(t, n) for t, n in (([known], 4), ([known, there], 4), ([known, there], 5))
    )
    assert error_after(alone, assumed) < 0.7 * error_after(before, assumed)
    assert error_after(alone, assumed) < error_after(usual, assumed)
    assert error_after(usual, known) < error_after(alone, known)
    assert numbers(usual)[:1] == numbers(policy(kind).next([known], 5))[:1]  # which goes on exploring


def test_all_loops_of_a_skin_share_one_ranking(monkeypatch: pytest.MonkeyPatch) -> None:
    made = list[str]()

    def counted(name: str, _: object, make: Callable[[], dict[str, Floats]]) -> dict[str, Floats]:
        made.append(name)
        return make()

    monkeypatch.setattr("ohmskin.drive.position.cached", counted)
    chosen, coarse = [target(0.05, 0.1)], Skin.parse("[imaging]\nmesh_size = 15e-3\n").transfer_model()
    design = ContactTable(coarse, 8e-3, 16e-3), candidates()
    base = base_pattern(GRID).injections
    tracked = [TrackingDrive(GRID, lambda: design, 4).next(chosen, 0) for _ in range(3)]
    second = [PositionDrive(GRID, lambda: design, 4, base).next(chosen) for _ in range(3)]
    assert all(pattern == patterns[0] for patterns in (tracked, second) for pattern in patterns)
    assert len(made) == 2


def test_a_set_of_ones_own_is_explored_in_its_order() -> None:
    drives = np.array([[12, 14], [15, 13], [0, 6]])
    explored = Exploration(GRID, 2, drives)
    found = [numbers(explored.next([], turn)) for turn in range(3)]
    own = pair_index(drives[:, 0], drives[:, 1], 16)
    assert found == [[own[0], own[1]], [own[2], own[0]], [own[1], own[2]]]


def test_consecutive_explorations_cross_each_other() -> None:
    drives = base_pattern(GRID).injections[np.arange(7) % 6]
    way = GRID.positions[drives[:, 1]] - GRID.positions[drives[:, 0]]
    assert sorted(map(tuple, np.sort(base_pattern(GRID).injections, axis=1).tolist())) == [(k, k + 6) for k in range(6)]
    assert np.linalg.norm(way, axis=1).min() > 0.19


@pytest.mark.parametrize("kind", ["position", "position exact"])
def test_choices_locate_a_contact_better_than_exploring_or_chance(kind: str) -> None:
    random = np.random.default_rng(3)
    known = [target(*random.uniform(0.015, 0.185, 2)) for _ in range(40)]
    chosen = np.array([error_after(policy(kind).next([each], turn), each) for turn, each in enumerate(known)])
    explored = np.array([error_after(policy("exploration").next([], turn), each) for turn, each in enumerate(known)])
    chance = np.array(
        [error_after(part_of(complete_pattern(GRID), random.integers(0, 120, 4)), each) for each in known]
    )
    assert chosen.mean() < 0.85 * explored.mean()
    assert chosen.mean() < 0.8 * chance.mean()


def test_tables_lose_less_than_a_tenth_against_weighing_everything() -> None:
    random = np.random.default_rng(4)
    known = [target(*random.uniform(0.015, 0.185, 2)) for _ in range(60)]
    exact, tables = (
        np.array([error_after(policy(kind).next([each], turn), each) for turn, each in enumerate(known)])
        for kind in ("position exact", "position")
    )
    assert exact.mean() <= tables.mean() < 1.1 * exact.mean()


def test_exact_choices_look_at_the_ellipse() -> None:
    """A contact known well in one direction is measured in the other."""
    place = np.array([0.1, 0.1])
    for k in (0, 1):
        spread = np.full(2, 5e-4)
        spread[k] = 8e-3
        narrow = Target(place, np.diag(spread**2), 1e-4, 8e-3)
        turned = Target(place, np.diag(spread[::-1] ** 2), 1e-4, 8e-3)
        right, wrong = (policy("position exact").next([each], 0) for each in (narrow, turned))
        assert error_after(right, narrow) < error_after(wrong, narrow)


def test_contacts_take_turns_and_one_cell_counts_once() -> None:
    first, second = target(0.05, 0.05), target(0.15, 0.13)
    chosen = policy("position")
    assert isinstance(chosen, TrackingDrive)
    ranking = Ranking(table(), candidates())
    served = np.concatenate([numbers(chosen.next([first, second], turn))[1:] for turn in range(8)])
    np.testing.assert_array_equal(served[0::2], ranking.order[ranking.cell_of(first.position)][:12])
    np.testing.assert_array_equal(served[1::2], ranking.order[ranking.cell_of(second.position)][:12])
    close = target(0.052, 0.052)
    assert chosen.next([first, close], 3) == chosen.next([first], 3)


def test_two_contacts_weighed_together_are_located_better_than_by_turns() -> None:
    random = np.random.default_rng(5)
    sums = {"position": 0.0, "position exact": 0.0}
    for turn in range(25):
        pair = [target(*random.uniform(0.02, 0.18, 2)) for _ in range(2)]
        for kind in sums:
            sums[kind] += error_after(policy(kind).next(pair, turn), *pair) ** 2
    assert sums["position exact"] < 0.95 * sums["position"]


@pytest.mark.parametrize("size", [0.0, 0.3])
def test_rankings_are_the_greedy_choice_for_their_cells(size: float) -> None:
    """Against choosing anew from all candidates, covariances computed in full."""
    ranking = Ranking(table(), candidates(), depth=5, cell=0.05, size=size)
    prior = ContactPrior.usual(8e-3, 0.6, 0.5)
    low, high = table().places.min(axis=0), table().places.max(axis=0)
    cell = (high - low) / ranking.order.shape[:2]
    for x, y in ((0, 0), (1, 2), (3, 1)):
        middle = low + (np.array([x, y]) + 0.5) * cell
        cases = middle + 0.25 * cell * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]])
        information = np.tile(np.linalg.inv(prior.covariance()), (4, 1, 1))
        seen = candidates().rows(contact_columns(table(), prior.at(cases)))
        each = seen.swapaxes(-1, -2) @ seen  # (4, n, 4, 4)
        for rank in range(5):
            variances = np.diagonal(np.linalg.inv(information[:, None] + each), axis1=2, axis2=3)
            counted = np.array([1.0, 1.0, 0.0, (size * table().radius) ** 2])  # places (m), and radii in part
            errors = (variances @ counted).mean(axis=0)
            assert errors[ranking.order[x, y, rank]] == pytest.approx(errors.min(), rel=1e-9)
            assert ranking.values[x, y, rank + 1] == pytest.approx(errors.min(), rel=1e-6)
            information = information + each[:, ranking.order[x, y, rank]]
        assert ranking.cell_of(middle) == (x, y)
    assert ranking.cell_of(np.array([-1.0, 9.0])) == (0, 3)
    assert (np.diff(ranking.values, axis=2) < 0).all()


def test_currents_that_a_pair_does_not_get_are_not_counted_on() -> None:
    """A pair with a hundredth of the current is not chosen although it was the best."""
    best = Ranking(table(), candidates(), depth=1, cell=0.2).order[0, 0, 0]
    currents = np.full(120, 1e-3)
    currents[best] = 1e-5
    starved = Candidates.at_currents(complete_pattern(GRID), 16, NOISE, currents)
    assert Ranking(table(), starved, depth=1, cell=0.2).order[0, 0, 0] != best


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"injections": 4, "explore": 0}, "give at least one"),
        ({"injections": 121, "explore": 121}, "1..120 pairs"),
        ({"drives": np.array([[0, 16]])}, r"numbers of the 16 electrodes"),
    ],
)
def test_settings_out_of_range_are_refused(settings: dict, message: str) -> None:
    with pytest.raises(PatternError, match=message):
        TrackingDrive(GRID, lambda: (table(), candidates()), **settings)


def test_candidates_must_be_the_complete_ones() -> None:
    some = Candidates.at_currents(base_pattern(GRID), 16, NOISE)
    touched = Target(np.array([0.1, 0.1]), np.eye(2) * 1e-6, 1e-4, 0.01)
    with pytest.raises(PatternError, match=r"all injections of candidate_pattern"):
        TrackingDrive(GRID, lambda: (table(), some)).next([touched], 0)
    for depth, cell in ((0, 0.02), (3, -1.0)):
        with pytest.raises(PatternError, match="must be positive"):
            Ranking(table(), candidates(), depth=depth, cell=cell)
    with pytest.raises(PatternError, match="0 injections in the second scan"):
        PositionDrive(GRID, PAPER.design, 0, base_pattern(GRID).injections)


# --- the mode 16P -----------------------------------------------------------------------------------------------------


def test_the_mode_is_an_opposite_base_scan_and_a_drive_made_when_it_is_needed() -> None:
    def unwanted() -> tuple[ContactTable, Candidates]:
        raise AssertionError("nothing was driven yet")

    drive = DRIVES["position"](DriveSettings(GRID, unwanted, pairs=10), 0)
    base = drive.next([], 0)
    assert (base.n_inj, base.n_meas, drive.scans, drive.injections) == (6, 6 * 13, 2, 16)
    assert base == measure_others([[0, 6], [5, 11], [4, 10], [3, 9], [2, 8], [1, 7]], range(16))
    mode = mode_named(PAPER, "16P")
    assert (mode.drive, mode.reader, mode.fuse) == ("position", "fit", True)
    with pytest.raises(PatternError, match="needs the responses of contacts"):
        DRIVES["position"](DriveSettings(GRID), 0).next([target(0.05, 0.1)], 1)


def test_the_second_scan_is_the_ranking_given_the_base_scan() -> None:
    known = [int(k) for k in numbers(base_pattern(GRID))]
    drive = PositionDrive(GRID, lambda: (table(), candidates()), 5, base_pattern(GRID).injections)
    anchors = np.array([[0.07, 0.031], [0.071, 0.03], [0.069, 0.029]])
    ranking = Ranking(table(), candidates(), depth=5, known=known, prior=ContactPrior.usual(8e-3, 2.5), size=0.3)
    pattern = drive.pattern([anchors])
    assert numbers(pattern) == ranking.order[ranking.cell_of(np.array([0.07, 0.03]))].tolist()
    alone = Ranking(table(), candidates(), depth=5, prior=ContactPrior.usual(8e-3, 2.5), size=0.3)
    assert (ranking.order != alone.order).any()  # what is known counts
    two = drive.pattern([anchors, anchors + 0.09])
    assert numbers(two)[0::2] == ranking.order[ranking.cell_of(np.array([0.07, 0.03]))][:3].tolist()


def test_a_press_is_found_in_the_mode() -> None:
    mode, sheet = mode_named(PAPER, "16P"), VirtualSkin(PAPER, seed=3)
    quiet = [sheet.scan(pattern) for pattern in drive_of(mode, PAPER).patterns for _ in range(12)]
    sensor = build(mode, SkinModel(PAPER, PAPER.transfer_model(), quiet))
    for x, y in ((0.055, 0.12), (0.14, 0.03)):
        sheet.press(0, x, y, 8e-3, 20e3)
        _, percept = sensor.step(sensor.start(), sheet.scan)
        sheet.press(0, x, y, 8e-3, 0.0)
        assert [frame.pattern.n_inj for frame in percept.frames] == [6, 16]
        assert len(percept.detections) == 1
        assert np.linalg.norm(np.array(percept.detections[0].position) - [x, y]) < 5e-3


# --- a voltage source whose current nobody measures -------------------------------------------------------------------


def test_a_current_that_is_not_measured_costs_little_if_that_is_allowed_for_and_much_if_not() -> None:
    sheet, pattern = VirtualSkin(PAPER, seed=1), part_of(complete_pattern(GRID), np.arange(0, 120, 5))
    model, real, source = PAPER.transfer_model(), PAPER.electrode_model(), PAPER.source
    assert source is not None

    def blind(frame: Frame) -> Frame:
        return Frame(pattern, frame.voltages, source.currents(real, pattern), frame.time)

    quiet = [sheet.scan(pattern) for _ in range(30)]
    measured, unmeasured = Baseline.learn(quiet), Baseline.learn([blind(frame) for frame in quiet])
    estimator = GaussNewton(model, measured.difference_noise, amplitude=0.1, model_error=0.02)
    errors: dict[str, list[float]] = {"measured": [], "allowed for": [], "ignored": []}
    for x in np.linspace(0.03, 0.17, 5):
        for y in np.linspace(0.03, 0.17, 5):
            sheet.press(0, x, y, 8e-3, 20e3)
            frame = sheet.scan(pattern)
            sheet.press(0, x, y, 8e-3, 0.0)
            seen = unmeasured.difference(blind(frame))
            for name, difference in (
                ("measured", measured.difference(frame)),
                ("allowed for", source.unmeasured(real, seen)),
                ("ignored", seen),
            ):
                image = estimator.reconstruct(difference).values
                place = find_regions(image, model.mesh, float(image.max()) / 2)[0].centroid
                errors[name].append(float(np.hypot(*(place - [x, y]))))
    mean = {name: np.mean(values) for name, values in errors.items()}
    assert mean["allowed for"] < 1.1 * mean["measured"]
    assert mean["ignored"] > 1.5 * mean["measured"]
