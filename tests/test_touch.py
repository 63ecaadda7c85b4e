"""From images to contacts: eq. (6) against an independent labelling, persistence, moments of known blobs, tracking."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components
from scipy.special import erf

from ohmskin.contacts import Contact, ContactFinder, find_regions, label_peaks, learn_threshold
from ohmskin.geometry import Mesh, Rectangle, mesh_domain
from ohmskin.inverse import Image
from ohmskin.tracking import Tracker, Tracks

SHEET = Rectangle(0.2, 0.2)


@cache
def mesh() -> Mesh:
    return mesh_domain(SHEET, 0.006)


def blob(x: float, y: float, width: float = 0.015, height: float = 1.0) -> np.ndarray:
    return height * np.exp(-np.sum((mesh().centroids - [x, y]) ** 2, axis=1) / (2 * width**2))


def image(values: np.ndarray, std: float = 0.01) -> Image:
    return Image(values, lambda elements: np.full(np.atleast_1d(elements).shape, std))


def chain(*values: float) -> tuple[np.ndarray, np.ndarray]:
    """An image in one dimension: each element has its left and right neighbour."""
    n = len(values)
    left, right = np.arange(n) - 1, np.where(np.arange(n) + 1 < n, np.arange(n) + 1, -1)
    return np.array(values, float), np.column_stack([left, right, np.full(n, -1)])


# --- regions ----------------------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), threshold=st.floats(0, 2), levels=st.sampled_from([0, 3]))
@settings(max_examples=60)
def test_regions_that_never_split_are_the_connected_components(seed: int, threshold: float, levels: int) -> None:
    values = np.random.default_rng(seed).normal(size=mesh().n_elem)
    if levels:
        values = np.round(values * levels) / levels  # ties
    labels = label_peaks(values, mesh().neighbours, threshold, 1.0)
    above = np.flatnonzero(values > threshold)
    np.testing.assert_array_equal(np.flatnonzero(labels >= 0), above)
    count, components = connected_components(mesh().adjacency[above][:, above], directed=False)
    assert labels.max(initial=-1) + 1 == count
    assert len({*zip(labels[above].tolist(), components.tolist(), strict=True)}) == count
    peaks = [values[labels == number].max() for number in range(count)]
    assert peaks == sorted(peaks, reverse=True)


@given(seed=st.integers(0, 2**32 - 1), dips=st.tuples(st.floats(0, 1), st.floats(0, 1)))
@settings(max_examples=40)
def test_a_deeper_dip_splits_less_and_nothing_is_lost(seed: int, dips: tuple[float, float]) -> None:
    values = np.random.default_rng(seed).uniform(size=mesh().n_elem)
    coarse, fine = (label_peaks(values, mesh().neighbours, 0.3, dip) for dip in sorted(dips, reverse=True))
    np.testing.assert_array_equal(coarse >= 0, fine >= 0)
    assert coarse.max() <= fine.max()


@pytest.mark.parametrize(
    ("dip", "expected"),
    [(0.24, [0, 0, 1, 1]), (0.26, [0, 0, 0, 0]), (1.0, [0, 0, 0, 0])],
)
def test_two_peaks_are_two_where_the_saddle_lies_below_the_lower_by_the_dip(dip: float, expected: list[int]) -> None:
    """Peaks 2 and 1, saddle 0.75: a quarter below the lower one. The saddle belongs to the higher peak."""
    labels = label_peaks(*chain(2.0, 0.75, 1.0, 0.9), 0.1, dip)
    assert labels.tolist() == expected


def test_the_dip_is_a_share_of_the_lower_peak_whatever_the_scale() -> None:
    for scale in (1e-9, 1.0, 1e9):
        values, neighbours = chain(5.0, 0.79, 1.0, 0.81, 3.0, 0.05, 0.5)
        assert label_peaks(scale * values, neighbours, 0.1 * scale, 0.2).tolist() == [0, 0, 1, 1, 1, -1, 2]


def test_a_region_of_three_peaks_splits_only_at_its_deep_saddle() -> None:
    labels = label_peaks(*chain(1.0, 0.95, 0.98, 0.3, 0.9, 0.85, 0.88), 0.1, 0.2)
    assert labels.tolist() == [0, 0, 0, 0, 1, 1, 1]


def test_nothing_above_the_threshold_is_no_region() -> None:
    assert find_regions(np.full(mesh().n_elem, 0.5), mesh(), 0.5) == []
    assert find_regions(np.full(mesh().n_elem, np.nan), mesh(), 0.5) == []


def test_a_region_has_its_centroid_anchors_and_peak() -> None:
    values = blob(0.07, 0.12)
    (region,) = find_regions(values, mesh(), 0.2)
    inside = values > 0.2
    mass = (values * mesh().measures)[inside]
    np.testing.assert_array_equal(region.elements, np.flatnonzero(inside))
    np.testing.assert_allclose(region.centroid, mass @ mesh().centroids[inside] / mass.sum(), rtol=1e-12)
    assert np.linalg.norm(region.centroid - [0.07, 0.12]) < 5e-4
    distance = np.linalg.norm(mesh().centroids - region.centroid, axis=1)
    expected = mesh().centroids[np.argsort(distance)[:3]]
    np.testing.assert_allclose(np.sort(region.anchors, axis=0), np.sort(expected, axis=0))
    assert region.peak == values.max() == values[region.peak_element]


def test_regions_come_strongest_first() -> None:
    regions = find_regions(blob(0.05, 0.05, height=0.6) + blob(0.15, 0.15) + blob(0.05, 0.15, height=0.8), mesh(), 0.3)
    assert [round(region.peak, 1) for region in regions] == [1.0, 0.8, 0.6]


# --- contacts ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("height", "width"), [(0.3, 0.012), (1.0, 0.02)])
def test_a_gaussian_blob_has_the_place_extent_and_strength_of_its_upper_half(height: float, width: float) -> None:
    """Above half its peak lies a disc of area 2 pi w^2 ln 2 that holds half of the integral 2 pi w^2 h."""
    (contact,) = ContactFinder(threshold=0.05).find(image(blob(0.11, 0.08, width, height)), mesh())
    assert np.linalg.norm(np.subtract(contact.position, (0.11, 0.08))) < 5e-4
    assert contact.extent == pytest.approx(2 * np.pi * width**2 * np.log(2), rel=0.06)
    assert contact.strength == pytest.approx(np.pi * width**2 * height, rel=0.06)
    assert contact.peak == pytest.approx(height, rel=0.02)
    assert contact.id == -1


def test_a_flat_disc_has_its_own_area_and_integral() -> None:
    inside = np.linalg.norm(mesh().centroids - [0.06, 0.06], axis=1) < 0.03
    (contact,) = ContactFinder(threshold=0.1).find(image(0.4 * inside), mesh())
    area = mesh().measures[inside].sum()
    assert (contact.extent, contact.strength) == pytest.approx((area, 0.4 * area), rel=1e-12)


def test_confidence_is_the_probability_that_the_peak_exceeds_the_threshold() -> None:
    finder = ContactFinder(threshold=0.5)
    for std in (0.01, 0.3, 1.0):
        values = blob(0.1, 0.1, height=0.8)
        (contact,) = finder.find(image(values, std), mesh())
        z = (values.max() - 0.5) / std
        assert contact.confidence == pytest.approx(0.5 * (1 + erf(z / np.sqrt(2))), rel=1e-12)
    (certain,) = finder.find(image(values, 0.0), mesh())
    assert certain.confidence == 1


def test_confidence_of_a_side_contact_is_against_the_threshold_and_not_the_share_of_the_strongest() -> None:
    values = blob(0.05, 0.1) + blob(0.15, 0.1, height=0.35)
    _, side = ContactFinder(threshold=0.2, fraction=0.3).find(image(values, 0.1), mesh())
    assert side.confidence == pytest.approx(0.5 * (1 + erf((side.peak - 0.2) / (0.1 * np.sqrt(2)))), rel=1e-12)


def test_side_lobes_below_a_share_of_the_strongest_are_no_contacts() -> None:
    values = blob(0.05, 0.1) + blob(0.15, 0.1, height=0.35)
    for fraction, count in ((0.3, 2), (0.4, 1)):
        assert len(ContactFinder(threshold=0.01, fraction=fraction).find(image(values), mesh())) == count
    assert len(ContactFinder(threshold=0.4, fraction=0.0).find(image(values), mesh())) == 1
    assert ContactFinder(threshold=1.1).find(image(values), mesh()) == []


def test_falls_count_only_when_asked_for_and_are_negative() -> None:
    values = blob(0.05, 0.1, height=0.5) - blob(0.15, 0.1)
    (rise,) = ContactFinder(threshold=0.1).find(image(values), mesh())
    assert rise.position[0] == pytest.approx(0.05, abs=1e-3)
    fall, other = ContactFinder(threshold=0.1, bipolar=True).find(image(values), mesh())
    assert np.linalg.norm(np.subtract(fall.position, (0.15, 0.1))) < 1e-3
    assert fall.peak == pytest.approx(-1, rel=0.02)
    assert fall.strength < 0 < other.strength
    assert fall.extent > 0
    assert other.peak == rise.peak


def test_two_contacts_are_told_apart_by_the_dip_between_them() -> None:
    values = blob(0.08, 0.1) + blob(0.125, 0.1)  # 3 widths apart: the saddle lies 35 % below the peaks
    assert len(ContactFinder(threshold=0.1, dip=0.25).find(image(values), mesh())) == 2
    assert len(ContactFinder(threshold=0.1, dip=0.45).find(image(values), mesh())) == 1


def test_the_learned_threshold_is_the_mean_and_a_number_of_standard_deviations() -> None:
    assert learn_threshold([1.0, 3.0]) == pytest.approx(2 + 6)
    assert learn_threshold([1.0, 3.0, 5.0, 7.0], margin=2) == pytest.approx(4 + 2 * np.sqrt(5))
    quiet = np.random.default_rng(0).normal(0.02, 0.003, 200)
    assert 0.02 + 5 * 0.003 < learn_threshold(quiet) < 0.02 + 7 * 0.003


# --- tracking ---------------------------------------------------------------------------------------------------------


def contact(x: float, y: float = 0.1) -> Contact:
    return Contact((x, y), 1e-4, 1e-5, 1.0, 0.5)


def follow(tracker: Tracker, frames: list[list[Contact]]) -> tuple[Tracks, list[tuple[Contact, ...]]]:
    state, reported = Tracks(), []
    for found in frames:
        state, contacts = tracker.update(state, found)
        reported.append(contacts)
    return state, reported


def ids(reported: list[tuple[Contact, ...]]) -> list[list[int]]:
    return [[c.id for c in contacts] for contacts in reported]


def test_a_moving_contact_keeps_its_id() -> None:
    _, reported = follow(Tracker(reach=0.02, confirm=1), [[contact(0.02 + 0.019 * k)] for k in range(9)])
    assert ids(reported) == [[1]] * 9
    assert [c.position[0] for (c,) in reported] == pytest.approx(0.02 + 0.019 * np.arange(9))


def test_a_leap_beyond_reach_is_a_new_contact() -> None:
    _, reported = follow(Tracker(reach=0.02, confirm=1), [[contact(0.05)], [contact(0.0701)], [contact(0.0702)]])
    assert ids(reported) == [[1], [2], [2]]


@pytest.mark.parametrize("confirm", [1, 2, 3, 5])
def test_a_contact_is_reported_once_it_was_seen_often_enough_in_a_row(confirm: int) -> None:
    _, reported = follow(Tracker(confirm=confirm), [[contact(0.1)]] * 6)
    assert ids(reported) == [[]] * (confirm - 1) + [[1]] * (7 - confirm)


def test_noise_that_comes_and_goes_is_never_reported() -> None:
    state, reported = follow(Tracker(confirm=2), [[contact(0.1)], []] * 10)
    assert ids(reported) == [[]] * 20
    assert state == Tracks()


@pytest.mark.parametrize("patience", [0, 1, 3])
def test_an_id_survives_as_many_missed_frames_as_patience_has(patience: int) -> None:
    for missed, expected in ((patience, 1), (patience + 1, 2)):
        _, reported = follow(Tracker(confirm=1, patience=patience), [[contact(0.1)], *[[]] * missed, [contact(0.1)]])
        assert ids(reported) == [[1], *[[]] * missed, [expected]]


def test_patience_starts_anew_with_every_sighting() -> None:
    _, reported = follow(Tracker(confirm=1, patience=1), [[contact(0.1)], []] * 8)
    assert ids(reported) == [[1], []] * 8


def test_contacts_that_pass_each_other_keep_their_ids() -> None:
    steps = np.linspace(0.04, 0.16, 25)
    frames = [[contact(x, 0.1), contact(0.2 - x, 0.112)] for x in steps]
    _, reported = follow(
        Tracker(reach=0.025, confirm=1), [frame if k % 2 else frame[::-1] for k, frame in enumerate(frames)]
    )
    for pair in reported:
        by_height = sorted(pair, key=lambda c: c.position[1])
        assert [c.id for c in by_height] == [2, 1]


def test_the_nearest_assignment_is_the_best_for_all_together() -> None:
    """A greedy match would give contact 0.11 to track 0.12 and leave track 0.10 without."""
    tracker = Tracker(reach=0.02, confirm=1)
    state, _ = tracker.update(Tracks(), [contact(0.10), contact(0.12)])
    _, reported = tracker.update(state, [contact(0.1125), contact(0.135)])
    assert [c.id for c in reported] == [1, 2]


def test_a_far_contact_does_not_steal_the_match_of_a_near_one() -> None:
    tracker = Tracker(reach=0.02, confirm=1)
    state, _ = tracker.update(Tracks(), [contact(0.05), contact(0.15)])
    _, reported = tracker.update(state, [contact(0.065), contact(0.19)])
    assert [c.id for c in reported] == [1, 3]


def test_how_far_a_new_contact_is_does_not_matter_to_the_old_ones() -> None:
    """Sums of unlimited distances would give 0.068 to the track at 0.05, to spare the far one a longer way."""
    tracker = Tracker(reach=0.02, confirm=1)
    state, _ = tracker.update(Tracks(), [contact(0.05), contact(0.07)])
    _, reported = tracker.update(state, [contact(0.068), contact(0.2)])
    assert [c.id for c in reported] == [2, 3]


@given(st.lists(st.lists(st.tuples(st.floats(0, 0.2), st.floats(0, 0.2)), max_size=4), max_size=25), st.integers(1, 3))
@settings(max_examples=60)
def test_ids_are_unique_in_a_frame_never_reused_and_the_state_is_left_alone(frames: list, confirm: int) -> None:
    tracker = Tracker(confirm=confirm, patience=2)
    state, last_seen = Tracks(), {}
    for number, found in enumerate(frames):
        before = repr(state)
        following, reported = tracker.update(state, [contact(x, y) for x, y in found])
        assert repr(state) == before
        state = following
        now = [c.id for c in reported]
        assert len(set(now)) == len(now)
        assert all(1 <= i < state.next_id for i in now)
        for i in now:
            if i in last_seen:
                assert number - last_seen[i] <= tracker.patience + 1
            last_seen[i] = number
        assert {c.position for c in reported} <= set(found)
    assert sorted(last_seen) == list(range(1, state.next_id))
