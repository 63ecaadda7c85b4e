"""The compiled steps of a filter on contacts (n, 6): x, y (m), effect (m2), squared radius (m2), velocity (m/s)."""

from typing import NamedTuple

import numpy as np
from numba import njit

from ohmskin.arrays import Bools, Floats, Ints, Singles
from ohmskin.contacts.kernels import SQUARE_STD, all_onto, refined
from ohmskin.contacts.misfit import COMMON, norms, subtract
from ohmskin.contacts.refit import flat_prior, marginalised, scores, shapes_of
from ohmskin.contacts.solution import inverse
from ohmskin.contacts.whitened import ErrorTerms, Quadratic, Reduced, Scan, add, copy, dot, likelihood
from ohmskin.forward.splines import Grid, Spline

_ROUNDS = 3  # of the iterated extended Kalman filter: between two frames little changes
_BALANCE = 1e-12  # share of a variance added to it, so that rounding cannot make a covariance indefinite
POSSIBLE = 3.0  # standard deviations from which on one more contact may be there
_RESTING = 0.5  # share of the model's error of contacts known that may change from one frame to the next, if they rest
_OTHERWISE = 2.0  # times the signal marginalised over all errors by which a contact's model errs at most


class Update(NamedTuple):
    """Information of a frame beside the contacts that it updated.

    Args:
        volts: (n_meas,) the frame's, without drift.
        likelihood: Their squared misfits, see `likelihood`.
        nominal, inflated: With nominal noise, and inflated by the model's error, marginalised over the common change.
        innovation: The frame less its prediction.
        marginal_innovation: The same marginalised over the common change and shapes of contacts.
        residual: What contacts and the common change leave.
        caused: (n_pairs + 1,) what these cause.
        predicted: (n_pairs + 1,) what was predicted.
        common: The common change after the frame, and its variance (1).
        energy: Of the contacts, see `energy_of`.
        signals: The signal beyond noise, and what contacts leave of it; squared sizes.
        score, power: (n_places,) of a contact more.
    """

    volts: Floats
    likelihood: tuple[Quadratic, Quadratic, Quadratic, int]
    nominal: Reduced
    inflated: Reduced
    innovation: Reduced
    marginal_innovation: Reduced
    residual: Reduced
    caused: Floats
    predicted: Floats
    common: tuple[float, float]
    energy: float
    signals: tuple[float, float]
    score: Singles
    power: Singles


@njit(cache=True, nogil=True)
def advanced(
    mean: Floats, covariance: Floats, pressing: Bools, elapsed: float, times: Floats, scales: Floats, sheet: Grid
) -> None:
    """Contacts (n, 6) some time later (s), and their covariance (6 n, 6 n), in place: they go on, ever more slowly.

    Args:
        mean: Contacts.
        covariance: Of all of them together.
        pressing: Whether each presses; those that are lifted rest.
        elapsed: The time.
        times: In which velocities and sizes are forgotten to 1/e (s).
        scales: Usual radius (m), standard deviation of velocities (m/s), relative change of effects in a second
            (1/sqrt(s)), and least effect that a random walk is relative to (m2).
        sheet: Where contacts may be.
    """
    kept, sized = np.exp(-elapsed / times[0]), np.exp(-elapsed / times[1])
    square, ahead = scales[0] ** 2, times[0] * (1 - kept)
    for k in range(len(mean)):
        for axis in range(2):
            at, rate = 6 * k + axis, 6 * k + 4 + axis
            for i in range(len(covariance)):
                covariance[at, i] += ahead * covariance[rate, i]
                covariance[rate, i] *= kept
            for i in range(len(covariance)):
                covariance[i, at] += ahead * covariance[i, rate]
                covariance[i, rate] *= kept
            if pressing[k]:
                added = scales[1] ** 2 * (1 - kept**2)
                covariance[at, at] += added * elapsed**2 / 3
                covariance[rate, rate] += added
            mean[k, axis] += ahead * mean[k, 4 + axis]
        at = 6 * k + 3
        for i in range(len(covariance)):
            covariance[at, i] *= sized
        for i in range(len(covariance)):
            covariance[i, at] *= sized
        covariance[at, at] += (1 - sized**2) * (SQUARE_STD * square) ** 2
        covariance[at - 1, at - 1] += scales[2] ** 2 * elapsed * (abs(mean[k, 2]) + scales[3]) ** 2
        mean[k, 3] = sized * mean[k, 3] + (1 - sized) * square
        for axis in range(2):
            mean[k, 4 + axis] *= kept
    all_onto(mean, sheet)


@njit(cache=True, nogil=True)
def updated(
    scan: Scan, errors: ErrorTerms, covered: Floats, unsure: Floats, drift: Floats, common: tuple[float, float],
    mean: Floats, covariance: Floats, pressing: bool, possible: int, settings: Floats, sheet: Grid, spline: Spline,
    candidates: Singles,
) -> Update:  # fmt: skip
    """Contacts `mean` (n, 6) and their `covariance` (6 n, 6 n) after one frame, in place, and scores for others.

    What small ones may change more one way than across is an error: as discs they would move and grow to explain it.
    Where one more contact is possible beside some that all press, these are corrected by what the frame says beside it,
    whatever its effect: otherwise the closest one would move and grow to explain it. A lifted one is free to move: it
    may be what has come elsewhere, which its model's error would hide from a search for new contacts.

    Args:
        scan: The frame.
        errors: How it errs.
        covered: (k, n_pairs) changes of which nothing is taken to be known.
        unsure: (k, n_pairs) what the drift may be off by, each for one standard deviation (ohm).
        drift: (n_pairs,) of two-terminal resistances (ohm), known.
        common: Common relative change of all resistances, as far as it is known, and its variance (1).
        mean: Contacts as predicted.
        covariance: Of all of them together.
        pressing: Whether none of them is lifted.
        possible: Place of one contact more that the last frames make possible; -1: none.
        settings: Usual radius (m), least effect (m2), smallest and largest squared radius (m2), the model's error (1).
        sheet: Where contacts may be.
        spline: What they do.
        candidates: (n_pairs + 1, n_places) what those do that are looked for.
    """
    radius, error = settings[0], settings[4]
    volts, nominal, inflated, white, count = likelihood(scan, errors, drift, common[0])
    if len(covered) or len(unsure):
        unknown = np.concatenate((flat_prior(white, covered), unsure))
        nominal, inflated, white = (
            marginalised(nominal, unknown),
            marginalised(inflated, unknown),
            marginalised(white, unknown),
        )
    n, pairs = len(mean), len(nominal[2]) - 1
    direction = np.zeros((1, pairs + 1))
    direction[0, pairs] = np.sqrt(common[1])
    own, wide = marginalised(nominal, direction), marginalised(inflated, direction)
    caused, predicted, innovation, left = np.zeros(pairs + 1), np.zeros(pairs + 1), nominal, white[3]
    before, start, spread, params = _parameters(covariance), mean.copy(), covariance.copy(), mean[:, :4].copy()
    beside = marginalised(wide, shapes_of(params, radius, error, spline)) if n else wide
    evidence, first = beside, 0
    if n and pressing and possible >= 0:
        first, evidence = 1, _marginalised_over(beside, white, candidates, possible)
    for again in range(first, 2):
        if n:
            for i in range(n):
                copy(start[i], mean[i])
            for i in range(len(covariance)):
                copy(spread[i], covariance[i])
            params, added, foreseen, slopes = _corrected(mean, covariance, before, evidence, settings, sheet, spline)
            copy(added, caused[:pairs])
            copy(foreseen, predicted[:pairs])
            vector, constant = subtract(nominal[0], nominal[1], nominal[2], nominal[3], predicted)
            innovation = marginalised((nominal[0], nominal[1], vector, constant), _spread(before, slopes))
            left = subtract(white[0], white[1], white[2], white[3], predicted)[1]
        shapes = shapes_of(params, radius, error, spline)
        marginal_innovation = marginalised(marginalised(innovation, direction), shapes)
        score, power = scores(marginal_innovation, candidates)
        energy = energy_of(nominal, white, caused[:pairs])
        if again or not (n and pressing):
            break
        _, place, height = most_significant(
            score.reshape((1, -1)), power.reshape((1, -1)), np.array([energy]), np.ones(1, np.int64), 0.0,
            _RESTING * error, settings[7] > 0.0,
        )  # fmt: skip
        if height < POSSIBLE:
            break
        evidence = _marginalised_over(beside, white, candidates, place)
    signals = 0.0, 0.0
    if n:
        direction[0, pairs] = COMMON
        alone = marginalised(nominal, direction)
        signals = alone[3] - count, subtract(alone[0], alone[1], alone[2], alone[3], caused[:pairs])[1] - count
    common, caused[pairs] = updated_common(innovation, common, 1 / (1 + error**2 * max(left, 0.0) / max(count, 1)))
    vector, constant = subtract(nominal[0], nominal[1], nominal[2], nominal[3], caused)
    return Update(
        volts, (nominal, inflated, white, count), _reduced(own), _reduced(wide), _reduced(innovation),
        _reduced(marginal_innovation),
        (nominal[1], vector, constant), caused, predicted, common, energy, signals, score, power,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _marginalised_over(evidence: Quadratic, white: Quadratic, candidates: Singles, place: int) -> Quadratic:
    """The evidence beside a contact at that place, whatever its effect."""
    more = candidates[:-1, place].astype(np.float64).reshape((1, -1))
    return marginalised(evidence, flat_prior(white, more))


@njit(cache=True, nogil=True)
def _corrected(
    mean: Floats, covariance: Floats, before: Floats, evidence: Quadratic, settings: Floats, sheet: Grid, spline: Spline
) -> tuple[Floats, Floats, Floats, Floats]:
    """Contacts and their covariance, in place, once a frame is known; see `updated`.

    Args:
        mean, covariance: Of the contacts, as they were predicted.
        before: The covariance (4 n, 4 n) of what a frame depends on.
        evidence: The frame's likelihood.
        settings, sheet, spline: See `updated`.

    Returns:
        What they are (n, 4) and cause (n_pairs,), what they were predicted to cause, and their slopes (4 n, n_pairs).
    """
    radius, least, smallest, largest = settings[:4]
    params = mean[:, :4].copy()
    known, start = inverse(before), params.copy().ravel()
    _, normal, caused, slopes = refined(
        params, evidence[0], evidence[1], evidence[2], evidence[3], start, known, np.int64(_ROUNDS), radius, least,
        smallest, largest, sheet, spline, np.inf,
    )  # fmt: skip
    change, predicted = params.ravel() - start, caused.copy()
    _condition(mean, covariance, before, known, normal, params, change)
    for i in range(len(change)):
        add(-change[i], slopes[i], predicted)
    return params, caused, predicted, slopes


@njit(cache=True, nogil=True)
def _reduced(part: Quadratic) -> Reduced:
    """Without the rows, which all parts have in common: each array that is returned takes time."""
    return part[1], part[2], part[3]


@njit(cache=True, nogil=True)
def updated_common(
    innovation: Quadratic, common: tuple[float, float], share: float
) -> tuple[tuple[float, float], float]:
    """The common change of all resistances and its variance, once a `share` of an innovation is known; and its rise."""
    change = np.zeros((1, len(innovation[2])))
    change[0, -1] = 1.0
    curvature = norms(innovation[0], innovation[1], change)[0] ** 2
    variance = 1 / (1 / common[1] + share * curvature)
    rise = variance * share * innovation[2][-1] if curvature > 0.0 else 0.0
    return (common[0] + rise, variance), rise


@njit(cache=True, nogil=True)
def energy_of(nominal: Quadratic, white: Quadratic, caused: Floats) -> float:
    """What contacts cause (n_pairs,) of a frame, where their model may err: squared size over the noise's variance.

    What errors of currents and contact impedances leave of it bounds it: near an electrode nearly all is in that
    electrode's own resistance, with a flat prior.
    """
    one = caused.reshape((1, len(caused)))
    whole, left = norms(white[0], white[1], one)[0], norms(nominal[0], nominal[1], one)[0]
    return float(min(whole**2, _OTHERWISE * left**2))


@njit(cache=True, nogil=True)
def most_significant(
    scores: Singles, powers: Singles, energies: Floats, windows: Ints, common: float, error: float, bipolar: bool
) -> tuple[int, int, float]:
    """The number of the window and the place where a contact more stands out most, and by how many deviations.

    Args:
        scores, powers: (n, n_places) of the last frames, newest first.
        energies: (n,) of what contacts known cause of each, where their model may err.
        windows: (k,) how many of the newest frames are taken together.
        common: Share of the noise's variance that is the same in all frames.
        error: How far the model of a contact errs (1).
        bipolar: Whether contacts may lower the conductivity, too.
    """
    score, power = np.zeros(scores.shape[1]), np.zeros(scores.shape[1])
    energy, taken, best = 0.0, 0, (0, 0, -np.inf)
    for k in range(len(windows)):
        for frame in range(taken, windows[k]):
            energy += energies[frame]
            for p in range(len(score)):
                score[p] += scores[frame, p]
                power[p] += powers[frame, p]
        taken = windows[k]
        share, most, place = 1 + (taken - 1) * common, -np.inf, 0
        for p in range(len(score)):
            height = (abs(score[p]) if bipolar else score[p]) / np.sqrt(power[p] * share)
            if height > most:
                most, place = height, p
        most -= error * np.sqrt(energy)
        if most > best[2]:
            best = k, place, most
    return best


@njit(cache=True, nogil=True)
def _parameters(covariance: Floats) -> Floats:
    """The covariance (4 n, 4 n) of what a frame depends on, of that of contacts and their velocities (6 n, 6 n)."""
    n = len(covariance) // 6
    out = np.empty((4 * n, 4 * n))
    for i in range(4 * n):
        for k in range(4 * n):
            out[i, k] = covariance[i // 4 * 6 + i % 4, k // 4 * 6 + k % 4]
    return out


@njit(cache=True, nogil=True)
def _condition(
    mean: Floats, covariance: Floats, before: Floats, known: Floats, normal: Floats, params: Floats, change: Floats
) -> None:
    """Contacts (n, 6) and their covariance, in place, once `params` (n, 4) are known with information `normal`.

    Before, theirs was `known`, the inverse of `before`; they have made a `change` (4 n,).
    """
    states, n = len(covariance), len(before)
    gain, reduction, taken = np.zeros((states, n)), before - inverse(normal), np.zeros((states, n))
    for i in range(states):
        for k in range(n):
            for j in range(n):
                gain[i, k] += covariance[i, j // 4 * 6 + j % 4] * known[j, k]
    for i in range(states):
        for k in range(n):
            for j in range(n):
                taken[i, k] += gain[i, j] * reduction[j, k]
    for i in range(states):
        mean[i // 6, i % 6] += dot(gain[i], change)
        for k in range(i + 1):
            value = (covariance[i, k] + covariance[k, i]) / 2 - dot(taken[i], gain[k])
            covariance[i, k] = covariance[k, i] = value
    for k in range(len(params)):
        for i in range(4):
            mean[k, i] = params[k, i]


@njit(cache=True, nogil=True)
def _spread(covariance: Floats, slopes: Floats) -> Floats:
    """What the data change (n, n_pairs), in directions each of one standard deviation, as parameters of this covariance
    (n, n) do, given their slopes (n, n_pairs)."""
    n, out = len(covariance), np.zeros_like(slopes)
    lower = np.zeros((n, n))
    for i in range(n):
        for k in range(i + 1):
            total = covariance[i, k] * (1 + _BALANCE * (i == k))
            for j in range(k):
                total -= lower[i, j] * lower[k, j]
            lower[i, k] = np.sqrt(max(total, 0.0)) if i == k else total / max(lower[k, k], 1e-300)
    for k in range(n):
        for i in range(k, n):
            add(lower[i, k], slopes[i], out[k])
    return out
