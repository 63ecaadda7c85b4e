"""The compiled steps of a fit of contacts (n, 4): x, y (m), effect (m2) and squared radius (m2) of each."""

from typing import SupportsIndex

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints, Singles
from ohmskin.contacts.misfit import products
from ohmskin.contacts.whitened import Rows, copy, dot
from ohmskin.forward.splines import Grid, Spline, respond, scatter

SQUARE_STD = 0.75  # prior standard deviation of the squared radius, as a share of the usual one
STRONG = 1.5  # effect over area of a contact that is taken to be larger than usual if it is stronger; at most it is 2
_SMALL, _HOPE = 1e-2, 10.0  # damping at which a step promises about all that can be gained, and times it may err
_ENOUGH = 0.02  # gain in squared misfit below which a fit stops: a seventh of a standard deviation


@njit(cache=True, nogil=True)
def onto(
    position: Floats, low: Floats, high: Floats, pitch: Floats, closest: Floats, reach: float, period: float
) -> None:
    """Moves a position (2 or more,) onto the sheet, in place; round a closed band any x is on it, but for holes. One
    that is no number stays."""
    if np.isnan(position[0] + position[1]):
        return
    for axis in range(1 if period > 0.0 else 0, 2):
        position[axis] = min(max(position[axis], low[axis]), high[axis])
    if reach == np.inf:  # all of the table's rectangle is sheet
        return
    column, row = int(np.rint((position[0] - low[0]) / pitch[0])), int(np.rint((position[1] - low[1]) / pitch[1]))
    there = closest[column % len(closest) if period > 0.0 else column, row]
    across = position[0] - there[0]
    if period > 0.0:
        across -= period * np.rint(across / period)
    if np.hypot(across, position[1] - there[1]) > reach:
        position[0], position[1] = there[0], there[1]


@njit(cache=True, nogil=True)
def all_onto(positions: Floats, sheet: Grid) -> None:
    """Moves positions (n, 2 or more) onto the sheet, in place; of a closed band to x from 0 to below its period."""
    for k in range(len(positions)):
        onto(positions[k], sheet[0], sheet[1], sheet[2], sheet[3], sheet[4], sheet[5])
        if sheet[5] > 0.0:
            positions[k, 0] -= sheet[5] * np.floor(positions[k, 0] / sheet[5])


@njit(cache=True, nogil=True)
def covering(params: Floats, electrodes: Floats, period: float) -> Ints:
    """The numbers of the electrodes (n_elec, 2) under contacts (n, 4)."""
    under = np.zeros(len(electrodes), np.bool_)
    for k in range(len(params)):
        for e in range(len(electrodes)):
            along = electrodes[e, 0] - params[k, 0]
            if period > 0.0:
                along -= period * np.rint(along / period)
            under[e] |= along**2 + (electrodes[e, 1] - params[k, 1]) ** 2 < params[k, 3]
    return np.flatnonzero(under)


@njit(cache=True, nogil=True)
def responses(
    params: Floats, knots: Singles, low: Floats, pitch: Floats, steps: Ints, period: float, squares: Floats,
    gain: float, fields: Floats, pairs: Ints,
) -> tuple[Floats, Floats]:  # fmt: skip
    """What contacts (n, 4) cause (n_pairs,), and the slopes (4 n, n_pairs)."""
    n_pairs = knots.shape[-1]
    caused, slopes = np.zeros(n_pairs), np.empty((4 * len(params), n_pairs))
    for k in range(len(params)):
        x, y, effect, square = params[k]
        own = slopes[4 * k : 4 * k + 4]
        respond(x, y, square, knots, low, pitch, steps, period, squares, gain, own)
        for p in range(n_pairs):
            caused[p] += effect * own[2, p]
            own[0, p] *= effect
            own[1, p] *= effect
            own[3, p] *= effect
    scatter(params, fields, low, pitch, steps, period, np.sqrt(squares[0]), pairs, caused, slopes)
    return caused, slopes


@njit(cache=True, nogil=True)
def peaks(height: Floats, places: Floats, most: int, promise: float, apart: float, period: float) -> Ints:
    """The numbers of at most so many of the highest places (n, 2), each so far (m) from the others.

    Near an electrode, the truth may lie on its other side. Lower than a share, `promise`, of the highest is none.
    """
    taken, found = np.zeros(len(height), np.bool_), np.empty(most, np.int64)
    for count in range(most):
        best = -1
        for k in range(len(height)):
            if not taken[k] and (best < 0 or height[k] > height[best]):
                best = k
        if best < 0 or (count and height[best] < promise * height[found[0]]):
            return found[:count]
        found[count] = best
        for k in range(len(height)):
            along = places[k, 0] - places[best, 0]
            if period > 0.0:
                along -= period * np.rint(along / period)
            if np.hypot(along, places[k, 1] - places[best, 1]) < apart:
                taken[k] = True
    return found


@njit(cache=True, nogil=True)
def expected(effects: Floats, usual: float, low: Floats, high: Floats, period: float) -> tuple[Floats, Floats]:
    """Mean (4 n,) and information (4 n, 4 n) of contacts of about these effects (n,) (m2) before any data.

    Little is known, except of sizes: they are about the `usual` radius (m); strong contacts are large.
    """
    square = usual**2
    mean, information = np.zeros(4 * len(effects)), np.zeros((4 * len(effects), 4 * len(effects)))
    for k in range(len(effects)):
        larger = max(1.0, abs(effects[k]) / (STRONG * np.pi * square))
        for axis in range(2):
            at = 4 * k + axis
            mean[at] = (low[axis] + high[axis]) / 2
            if axis or period == 0.0:  # round a closed band no place is in the middle
                information[at, at] = (high[axis] - low[axis]) ** -2
        mean[4 * k + 3] = square * larger
        information[4 * k + 2, 4 * k + 2] = (10 * np.pi * square) ** -2
        information[4 * k + 3, 4 * k + 3] = (SQUARE_STD * square * larger) ** -2
    return mean, information


@njit(cache=True, nogil=True)
def refined(
    params: Floats, rows: Rows, downdates: Floats, vector: Floats, constant: float, mean: Floats, prior: Floats,
    rounds: SupportsIndex, radius: float, least: float, smallest: float, largest: float, sheet: Grid, spline: Spline,
    best: float,
) -> tuple[float, Floats, Floats, Floats]:  # fmt: skip
    """Levenberg and Marquardt, `params` (n, 4) in place: cost, curvature, what is caused, and its slopes.

    A fit ends, too, that cannot come up with the `best` cost known, by what its next step promises.
    Rows, downdates, vector and constant are those of a `QuadraticMisfit`. Compiled code gives `rounds` as an int64:
    for a constant, numba would compile all of this again.
    """
    damping, n = 1e-3, params.size
    floor, ceiling, low, high = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for i in range(0, n, 4):
        for axis in range(2):
            free = axis == 0 and sheet[5] > 0.0
            floor[i + axis] = -np.inf if free else sheet[0][axis]
            ceiling[i + axis] = np.inf if free else sheet[1][axis]
        floor[i + 2], ceiling[i + 2], floor[i + 3], ceiling[i + 3] = least, np.inf, smallest, largest
    moved = np.empty_like(params)
    cost, normal, gradient, caused, slopes = _linearised(params, rows, downdates, vector, constant, mean, prior, spline)
    for _ in range(rounds):
        for i in range(n):
            low[i], high[i] = floor[i] - params[i // 4, i % 4], ceiling[i] - params[i // 4, i % 4]
        step, slope = _bounded_step(normal, gradient, damping, low, high), 0.0
        for i in range(n):
            slope += step[i] * gradient[i]
        if not _ENOUGH <= slope < np.inf:  # also if it is no number: places would be none
            break
        if damping <= _SMALL and cost - _HOPE * slope > best:
            break
        for k in range(len(params)):
            length = np.hypot(step[4 * k], step[4 * k + 1])
            shrunk = min(1.0, radius / max(length, 1e-300))  # no longer than a radius
            moved[k, 0] = params[k, 0] + shrunk * step[4 * k]
            moved[k, 1] = params[k, 1] + shrunk * step[4 * k + 1]
            moved[k, 2] = max(params[k, 2] + step[4 * k + 2], least)
            moved[k, 3] = min(max(params[k, 3] + step[4 * k + 3], smallest), largest)
            onto(moved[k], sheet[0], sheet[1], sheet[2], sheet[3], sheet[4], sheet[5])
        trial = _linearised(moved, rows, downdates, vector, constant, mean, prior, spline)
        gain = cost - trial[0]
        if gain > 0:
            for k in range(len(params)):
                for i in range(params.shape[1]):
                    params[k, i] = moved[k, i]
            cost, normal, gradient, caused, slopes = trial
            damping /= 8
        else:
            damping = max(8 * damping, 1e-2)
        if abs(gain) < _ENOUGH or damping > 1e4:
            break
    return cost, normal, caused, slopes


@njit(cache=True, nogil=True)
def _bounded_step(normal: Floats, gradient: Floats, damping: float, floor: Floats, ceiling: Floats) -> Floats:
    """The damped step (n,), parameters that it would take beyond a bound left there: the others make up for it."""
    n, held = len(gradient), np.zeros(len(gradient), np.bool_)
    step, ends = gradient.copy(), np.zeros(n)
    for _ in range(n):
        reduced = normal.copy()
        for i in range(n):
            step[i] = gradient[i]
        for i in range(n):
            for k in range(n if held[i] else 0):
                step[k] -= normal[k, i] * ends[i]
                reduced[i, k] = reduced[k, i] = 1.0 if k == i else 0.0
        for i in range(n):
            if held[i]:
                step[i] = ends[i] * (1 + damping)
        damped_step(reduced, damping, step)
        more = False
        for i in range(n):
            if not held[i] and not floor[i] <= step[i] <= ceiling[i]:
                held[i], more = True, True
                ends[i] = floor[i] if step[i] < floor[i] else ceiling[i]
        if not more:
            break
    return step


@njit(cache=True, nogil=True)
def damped_step(normal: Floats, damping: float, step: Floats) -> None:
    """Solves (normal + damping diag(normal)) x = step, in place (Cholesky); normal is symmetric, positive definite."""
    n, lower = len(step), np.empty_like(normal)
    for i in range(n):
        for j in range(i + 1):
            total = normal[i, j] * (1 + damping) if i == j else normal[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            lower[i, j] = np.sqrt(max(total, 1e-300)) if i == j else total / lower[j, j]
        for k in range(i):
            step[i] -= lower[i, k] * step[k]
        step[i] /= lower[i, i]
    for i in range(n - 1, -1, -1):
        step[i] /= lower[i, i]
        for k in range(i):
            step[k] -= lower[i, k] * step[i]


@njit(cache=True, nogil=True)
def _linearised(
    params: Floats,
    rows: Rows,
    downdates: Floats,
    vector: Floats,
    constant: float,
    mean: Floats,
    prior: Floats,
    spline: Spline,
) -> tuple[float, Floats, Floats, Floats, Floats]:
    """Cost, its curvature (4 n, 4 n) and downhill gradient (4 n,); what is caused, and its slopes (4 n, n_pairs)."""
    caused, slopes = responses(
        params, spline[0], spline[1], spline[2], spline[3], spline[4], spline[5], spline[6], spline[7], spline[8]
    )
    n = len(slopes)
    changes, common, slope = np.empty((n + 1, len(caused))), np.empty((n + 1, n + 1)), np.empty(n + 1)
    for k in range(n + 1):  # the slopes, and last what is caused
        copy(slopes[k] if k < n else caused, changes[k])
        slope[k] = dot(vector, changes[k])
    products(rows, downdates, changes, common)
    cost, normal, gradient = constant - 2 * slope[n] + common[n, n], prior.copy(), np.zeros(n)
    off, period = np.empty(n), spline[4]
    for i in range(n):
        off[i] = mean[i] - params[i // 4, i % 4]
        if period > 0.0 and i % 4 == 0:
            off[i] -= period * np.rint(off[i] / period)
    for i in range(n):
        gradient[i] = slope[i] - common[i, n]
        for k in range(n):
            normal[i, k] += common[i, k]
            gradient[i] += prior[i, k] * off[k]
            cost += off[i] * prior[i, k] * off[k]
    return cost, normal, gradient, caused, slopes
