"""Medians, means and shares over noise seeds, with intervals."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import beta

from ohmskin.arrays import Floats

RESAMPLES = 2000
LEVEL = 0.95


@dataclass(frozen=True)
class Estimate:
    """A value, usually a median, with the limits of its 95 % interval (percentile bootstrap over seeds)."""

    value: float
    low: float
    high: float

    def text(self, scale: float = 1.0, digits: int = 3) -> str:
        """The three numbers times `scale`, such as ``1.23 (1.1-1.4)``."""
        numbers = [f"{value * scale:.{digits}g}" for value in (self.value, self.low, self.high)]
        return f"{numbers[0]} ({numbers[1]} to {numbers[2]})"


def median(values: ArrayLike) -> Estimate:
    """The median of values (n_seeds,) and its interval; infinite and missing values count as the largest."""
    values = np.where(np.isfinite(v := np.asarray(values, float)), v, np.inf)
    if not len(values) or not np.isfinite(values).any():
        return Estimate(np.nan, np.nan, np.nan)
    middles = _medians(values)
    low, high = np.quantile(middles, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], method="nearest")
    return Estimate(float(np.quantile(values, 0.5, method="averaged_inverted_cdf")), float(low), float(high))


def _medians(values: Floats) -> Floats:
    drawn = np.random.default_rng(0).integers(0, len(values), (RESAMPLES, len(values)))
    middles: Floats = np.quantile(values[drawn], 0.5, axis=1, method="nearest")
    return middles


def fewer(a: ArrayLike, b: ArrayLike) -> float:
    """How sure it is that the median of a (n_seeds,) is below that of b, paired by seed: share of bootstrap
    resamples."""
    a, b = (np.where(np.isfinite(v := np.asarray(values, float)), v, 1e300) for values in (a, b))
    drawn = np.random.default_rng(0).integers(0, len(a), (RESAMPLES, len(a)))
    return float(np.mean(np.median(a[drawn], axis=1) < np.median(b[drawn], axis=1)))


def ratio_of_means(a: ArrayLike, b: ArrayLike) -> Estimate:
    """The mean of a over the mean of b, and its interval; shapes as for `mean`, seeds and places drawn in pairs."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    low, high = np.quantile(_means(a) / _means(b), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Estimate(float(a.mean() / b.mean()), float(low), float(high))


def mean(values: ArrayLike) -> Estimate:
    """The mean of values and its interval, over seeds (n_seeds,), or over seeds and places (n_seeds, n_places)."""
    values = np.asarray(values, float)
    low, high = np.quantile(_means(values), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Estimate(float(values.mean()), float(low), float(high))


def _means(values: Floats) -> Floats:
    """Means (n_resamples,) of values whose seeds, and places if there are any, are drawn anew."""
    random = np.random.default_rng(0)
    drawn = values[random.integers(0, len(values), (RESAMPLES, len(values)))].mean(axis=1)
    if values.ndim > 1:
        places = random.integers(0, values.shape[1], (RESAMPLES, values.shape[1]))
        drawn = np.take_along_axis(drawn, places, axis=1).mean(axis=1)
    return np.asarray(drawn)


def share(count: int, total: int) -> Estimate:
    """The share of `count` in `total` independent trials, and its exact interval (Clopper and Pearson)."""
    tail = (1 - LEVEL) / 2
    low = float(beta.ppf(tail, count, total - count + 1)) if count else 0.0
    high = float(beta.isf(tail, count + 1, total - count)) if count < total else 1.0
    return Estimate(count / total, low, high)
