"""From the success rates of Fig. 8 to a distance: how close two contacts may be and still be told apart."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from ohmskin.evaluate.result import Result
from ohmskin.geometry.domain import Floats

ALPHA = 0.01  # nominal rate of false twos of the chi-square test
_FREEDOM = 3  # parameters that a second disc adds
HALF = 0.5  # success rate that counts as told apart


@dataclass(frozen=True)
class Limits:
    """Smallest distances at which, and at all larger ones, at least half of the seeds succeed; infinite if none.

    Args:
        rate: (n_methods, n_distances) success rates over all areas and seeds.
        overall: (n_methods,) distances in metres for that rate.
        by_area: (n_methods, n_areas) the same for each area.
        false: (n_methods,) share of single contacts taken for two.
    """

    rate: Floats
    overall: Floats
    by_area: Floats
    false: Floats


def threshold(areas: Sequence[Result]) -> Floats:
    """What the fall of chi-square must exceed for two contacts (n_methods, 1, 1).

    The quantile of chi-square, or the 1 - `ALPHA` quantile of that fall over the single contacts where it is larger: a
    linear model leaves more than noise, which a second disc would explain.
    """
    singles = np.concatenate([area["single_statistic"] for area in areas], axis=1)
    seen = np.quantile(singles.reshape(len(singles), -1), 1 - ALPHA, axis=1)
    cut: Floats = np.maximum(seen, chi2.isf(ALPHA, _FREEDOM))
    return cut[:, None, None]


def successes(areas: Sequence[Result], how: str) -> tuple[Floats, Floats]:
    """Success of pairs (n_areas, n_methods, n_distances, n_seeds) and false twos of singles (n_areas, n_methods, n, n_seeds).

    Args:
        areas: Results of `Discrimination`, one per area, of the same methods and distances.
        how: ``dip``; ``test`` with the `threshold` above; ``nominal``, the test with chi-square's quantile alone.
    """
    if how == "dip":
        return np.stack([a["dip"] for a in areas]).astype(float), np.stack([a["single_dip"] for a in areas]).astype(float)
    cut = threshold(areas) if how == "test" else np.full((1, 1, 1), chi2.isf(ALPHA, _FREEDOM))
    right = np.stack([(a["statistic"] > cut) & a["near"].astype(bool) for a in areas]).astype(float)
    return right, np.stack([a["single_statistic"] > cut for a in areas]).astype(float)


def limits(distances: Sequence[float], areas: Sequence[Result], how: str) -> Limits:
    """Success rates and the distances they come down to; for the arguments see `successes`."""
    right, wrong = successes(areas, how)
    by_area = right.mean(axis=3)
    rate = by_area.mean(axis=0)
    return Limits(
        rate,
        np.array([smallest(distances, row) for row in rate]),
        np.array([[smallest(distances, row) for row in area] for area in by_area]).T,
        wrong.mean(axis=(0, 2, 3)),
    )


def smallest(distances: Sequence[float], rate: Floats) -> float:
    """The smallest distance at which and beyond which the success rate is at least `HALF`; infinite if there is none."""
    reached = np.inf
    for distance, share in sorted(zip(distances, rate, strict=True), reverse=True):
        if share < HALF:
            break
        reached = distance
    return float(reached)
