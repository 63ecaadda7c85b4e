"""Medians, intervals and verdicts."""

import numpy as np
import pytest

from ohmskin.contacts import Contact
from ohmskin.evaluate.experiments.localisation import errors, places
from ohmskin.evaluate.experiments.touches import intersection_over_union, matched_error, peak_and_width
from ohmskin.evaluate.shapes import disc
from ohmskin.evaluate.statistics import fewer, median, ratio_of_means
from ohmskin.evaluate.verdict import NO, OPEN, YES, above, ladder, ordered


def test_median_and_interval() -> None:
    found = median(np.arange(101.0))
    assert found.value == 50
    assert 30 < found.low < 45
    assert 55 < found.high < 70
    assert median([1.0, np.inf, np.nan, 2.0, 3.0]).value == 3.0  # what is missing is worse than everything
    assert np.isnan(median([np.nan]).value)


def test_the_interval_of_a_median_holds_the_truth_about_as_often_as_it_says() -> None:
    random = np.random.default_rng(5)
    inside = [m.low <= 0 <= m.high for m in (median(random.normal(size=25)) for _ in range(200))]
    assert 0.88 < np.mean(inside) < 0.995


def test_ratio_of_means() -> None:
    random = np.random.default_rng(0)
    a, b = random.normal(13, 1, 20), random.normal(10, 1, 20)
    found = ratio_of_means(a, b)
    assert found.value == pytest.approx(a.mean() / b.mean(), rel=1e-12)
    assert found.low < 1.3 < found.high
    assert ratio_of_means(a, a).low == ratio_of_means(a, a).high == 1.0  # seeds are drawn in pairs


def test_verdicts_need_the_order_and_the_certainty() -> None:
    random = np.random.default_rng(0)
    high, low = random.normal(10, 1, 20), random.normal(5, 1, 20)
    assert ladder([high, low])[0] == YES
    assert ladder([low, high])[0] == NO
    assert ladder([high, low], lower_is_better=False)[0] == NO
    assert ladder([low, high], lower_is_better=False)[0] == YES
    near = [random.normal(5.0, 1, 20) for _ in range(2)]
    near.sort(key=lambda v: -np.median(v))
    assert ladder(near)[0] == OPEN
    assert ladder([high, near[0], near[1]])[0] == OPEN  # one unsure step is enough
    assert ladder([np.full(20, np.inf), low])[0] == YES
    assert ladder([low, np.full(20, np.nan)])[0] == NO
    assert not ordered([low, low])
    assert fewer(low, high) == 1.0
    assert fewer(low, low) == fewer(high, low) == 0.0


def test_a_limit_must_be_reached_by_the_whole_interval() -> None:
    found = ratio_of_means(np.full(20, 13.0) + np.arange(20) / 10, np.full(20, 10.0))
    assert above(found, found.low) == YES
    assert above(found, (found.low + found.value) / 2) == OPEN
    assert above(found, found.value * 1.01) == NO
    assert above(median([np.nan]), 1.0) == NO


def test_peak_and_width_of_a_triangle_are_exact() -> None:
    x = np.linspace(0, 1, 101)
    peak, at, width = peak_and_width(x, np.maximum(0, 1 - np.abs(x - 0.4) / 0.3))
    assert (peak, at, width) == pytest.approx((1.0, 0.4, 0.3), abs=1e-12)
    assert peak_and_width(x, np.where(x < 0.2, 1.0, 0.0))[2] == pytest.approx(0.195, abs=1e-12)


def test_81_places_and_their_errors() -> None:
    truth = places(9)
    assert len(truth) == 81
    assert (truth.min(), truth.max()) == pytest.approx((0.02, 0.18))
    estimate = np.stack([truth + np.array([0.003, 0.004])] * 2)[None]
    estimate[0, 1, 40] = np.nan  # an image without a touch: the centre, where this one was
    error = errors({"truth": truth, "estimate": estimate})
    assert error.shape == (1, 2, 81)
    assert np.delete(error[0, 1], 40) == pytest.approx(0.005)
    assert error[0, 1, 40] == pytest.approx(0, abs=1e-12)


def test_contacts_are_matched_one_to_one() -> None:
    found = [Contact((x, 0.1), 1e-4, 1e-4, 1.0, 0.5) for x in (0.16, 0.05, 0.1)]
    truth = (disc(0.05, 0.1, 0.01, 1.0), disc(0.15, 0.1, 0.01, 1.0))
    assert matched_error(found, truth) == pytest.approx(0.005)
    assert np.isnan(matched_error(found[:1], truth))


def test_intersection_over_union() -> None:
    a, b = np.zeros((4, 4), bool), np.zeros((4, 4), bool)
    a[:2], b[1:3] = True, True
    assert intersection_over_union(a, b) == pytest.approx(1 / 3)


def test_a_ratio_whose_resamples_may_draw_nothing_has_no_upper_end() -> None:
    ratio = ratio_of_means([1.0, 0.5], [0.5, 0.0])
    assert ratio.value == 3.0
    assert ratio.low == 2.0
    assert ratio.high == np.inf
