"""One contact or two? What `ContactFitter` finds when it is asked for one, or two, and how far they differ."""

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.contacts import ContactFitter, Solution
from ohmskin.scan import Difference


def best_single(fitter: ContactFitter, *differences: Difference) -> Solution:
    """The one contact that explains scans best, whether it is significant or not."""
    nominal, _ = fitter.information(*differences)
    return fitter.added(nominal.scaled(fitter.allowance(nominal)), *fitter.scores(nominal))


def best_pair(fitter: ContactFitter, one: Solution, *differences: Difference) -> Solution:
    """The two contacts that explain scans best, given the best single one: that one split, or another one beside it, as
    the fitter finds them, whether the second is significant or not."""
    nominal, _ = fitter.information(*differences)
    added = fitter.added(
        nominal.scaled(fitter.allowance(nominal)), *fitter.scores(nominal.minus(one.caused)), one.params
    )
    split = fitter.split(nominal, nominal, one, 0, bar=-np.inf)
    return added if split is None or added.cost < split.cost else split


def one_or_two(fitter: ContactFitter, *differences: Difference) -> tuple[float, Solution, Solution]:
    """How much better two contacts explain scans than one, as the fitter counts it (in units of the noise's variance,
    see `ContactFitter.gained`), and both explanations."""
    one = best_single(fitter, *differences)
    two = best_pair(fitter, one, *differences)
    return fitter.gain_of(fitter.information(*differences)[0], one, two), one, two


def resolved(found: ArrayLike, truth: ArrayLike) -> bool:
    """Whether each of two true places (2, 2) has one of those found (n, 2) closer than half their distance."""
    found, truth = np.asarray(found, float).reshape(-1, 2), np.asarray(truth, float)
    half = np.linalg.norm(truth[0] - truth[1]) / 2
    return bool((np.linalg.norm(found[:, None] - truth, axis=2) < half).any(axis=0).all())
