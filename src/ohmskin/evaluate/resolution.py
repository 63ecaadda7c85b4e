"""From the success rates of Fig. 8 to a distance: how close two contacts may be and still be distinguished."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from ohmskin.arrays import Floats
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.statistics import RESAMPLES

ALPHA = 0.01  # nominal rate of false twos of the chi-square test
_FREEDOM = 3  # parameters that a second contact adds: its place and effect, its radius being about known
HALF = 0.5  # success rate that counts as told apart


@dataclass(frozen=True)
class Limits:
    """Smallest distances at which, and at all larger ones, at least half of the seeds succeed; infinite if none.

    Args:
        rate: (n_methods, n_distances) success rates over all areas and seeds.
        overall: (n_methods,) distances in metres for that rate.
        resampled: (n_methods, n_resamples) the same for seeds drawn at random from those that are there.
        by_area: (n_methods, n_areas) distances for each area.
        false: (n_methods,) share of single contacts taken for two.
    """

    rate: Floats
    overall: Floats
    resampled: Floats
    by_area: Floats
    false: Floats


def threshold(areas: Sequence[Result]) -> Floats:
    """What the gain of a second contact must exceed for two (n_methods, 1, 1).

    The quantile of chi-square, or the 1 - `ALPHA` quantile of the gain over the single
    contacts where that is larger: the fitter's model leaves more than noise, which a second contact would explain.
    """
    singles = np.concatenate([area["single_statistic"] for area in areas], axis=1)
    seen = np.quantile(singles.reshape(len(singles), -1), 1 - ALPHA, axis=1)
    cut: Floats = np.maximum(seen, chi2.isf(ALPHA, _FREEDOM))
    return cut[:, None, None]


def successes(areas: Sequence[Result], how: str) -> tuple[Floats, Floats]:
    """Success of pairs (n_areas, n_methods, n_distances, n_seeds) and false twos of singles (n_areas, n_methods, n,
    n_seeds).

    Args:
        areas: Results of `Discrimination`, one per area, of the same methods and distances.
        how: ``dip``; ``test`` with the `threshold` above; ``nominal``, the test with chi-square's quantile alone.
    """
    cut = threshold(areas) if how == "test" else np.full((1, 1, 1), chi2.isf(ALPHA, _FREEDOM))
    right = [a["dip"] if how == "dip" else (a["statistic"] > cut) & a["near"].astype(bool) for a in areas]
    wrong = [a["single_dip"] if how == "dip" else a["single_statistic"] > cut for a in areas]
    return np.stack(right).astype(float), np.stack(wrong).astype(float)


def limits(distances: Sequence[float], areas: Sequence[Result], how: str) -> Limits:
    """Success rates and the distances they come down to; for the arguments see `successes`."""
    right, wrong = successes(areas, how)
    by_seed = right.mean(axis=0)  # (n_methods, n_distances, n_seeds)
    drawn = np.random.default_rng(0).integers(0, by_seed.shape[2], (RESAMPLES, by_seed.shape[2]))
    rates = np.stack([by_seed[:, :, seeds].mean(axis=2) for seeds in drawn], axis=1)
    rate = by_seed.mean(axis=2)
    overall, resampled, by_area = (smallest(distances, each) for each in (rate, rates, right.mean(axis=3)))
    return Limits(rate, overall, resampled, by_area.T, wrong.mean(axis=(0, 2, 3)))


def smallest(distances: Sequence[float], rate: Floats) -> Floats:
    """The smallest distance from which on the success rate (..., n_distances) is at least `HALF`; infinite if none."""
    falling = np.argsort(distances)[::-1]
    held = np.logical_and.accumulate(rate[..., falling] >= HALF, axis=-1).sum(axis=-1)
    reached: Floats = np.append(np.inf, np.asarray(distances)[falling])[held]
    return reached
