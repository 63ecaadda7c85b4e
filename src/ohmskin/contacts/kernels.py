"""The compiled steps of a fit of contacts (n, 4): x, y (m), effect (m2) and squared radius (m2) of each."""

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints
from ohmskin.forward.response import Grid, Spline, respond, scatter

_ENOUGH = 0.02  # gain in squared misfit below which a fit stops: a seventh of a standard deviation


@njit(cache=True, nogil=True)
def onto(position: Floats, low: Floats, high: Floats, pitch: Floats, closest: Floats, reach: float) -> None:
    """Moves a position (2,) onto the sheet, in place."""
    for axis in range(2):
        position[axis] = min(max(position[axis], low[axis]), high[axis])
    there = closest[int(np.rint((position[0] - low[0]) / pitch[0])), int(np.rint((position[1] - low[1]) / pitch[1]))]
    if np.hypot(position[0] - there[0], position[1] - there[1]) > reach:
        position[0], position[1] = there[0], there[1]


@njit(cache=True, nogil=True)
def responses(
    params: Floats, knots: Floats, low: Floats, pitch: Floats, steps: Ints, squares: Floats, fields: Floats
) -> tuple[Floats, Floats]:
    """What contacts (n, 4) cause (n_pairs,), and the slopes (4 n, n_pairs)."""
    n_pairs = knots.shape[-1]
    caused, slopes = np.zeros(n_pairs), np.empty((4 * len(params), n_pairs))
    for k in range(len(params)):
        x, y, effect, square = params[k]
        own = slopes[4 * k : 4 * k + 4]
        respond(x, y, square, knots, low, pitch, steps, squares, own)
        for p in range(n_pairs):
            caused[p] += effect * own[2, p]
            own[0, p] *= effect
            own[1, p] *= effect
            own[3, p] *= effect
    scatter(params, fields, low, pitch, steps, np.sqrt(squares[0]), caused, slopes)
    return caused, slopes


@njit(cache=True, nogil=True)
def refined(
    params: Floats, matrix: Floats, vector: Floats, constant: float, mean: Floats, prior: Floats, rounds: int,
    radius: float, least: float, smallest: float, largest: float, sheet: Grid, spline: Spline,
) -> tuple[float, Floats, Floats, Floats]:  # fmt: skip
    """Levenberg and Marquardt, `params` (n, 4) in place: cost, curvature, what is caused, and its slopes.

    The `matrix` (n_pairs + 1, n_pairs + 1) and `vector` are those of a `Misfit`.
    """
    damping = 1e-3
    cost, normal, gradient, caused, slopes = _linearised(params, matrix, vector, constant, mean, prior, spline)
    for _ in range(rounds):
        step, slope = gradient.copy(), 0.0
        damped_step(normal, damping, step)
        for i in range(len(step)):
            slope += step[i] * gradient[i]
        if not _ENOUGH <= slope < np.inf:  # also if it is no number: places would be none
            break
        moved = params.copy()
        for k in range(len(params)):
            length = np.hypot(step[4 * k], step[4 * k + 1])
            shrunk = min(1.0, radius / max(length, 1e-300))  # no longer than a radius
            moved[k, 0] += shrunk * step[4 * k]
            moved[k, 1] += shrunk * step[4 * k + 1]
            moved[k, 2] = max(moved[k, 2] + step[4 * k + 2], least)
            moved[k, 3] = min(max(moved[k, 3] + step[4 * k + 3], smallest), largest)
            onto(moved[k, :2], *sheet)
        trial = _linearised(moved, matrix, vector, constant, mean, prior, spline)
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
    params: Floats, matrix: Floats, vector: Floats, constant: float, mean: Floats, prior: Floats, spline: Spline
) -> tuple[float, Floats, Floats, Floats, Floats]:
    """Cost, its curvature (4 n, 4 n) and downhill gradient (4 n,); what is caused, and its slopes (4 n, n_pairs)."""
    caused, slopes = responses(params, *spline)
    seen, left, n = np.zeros_like(slopes), vector.copy(), len(caused)
    for i in range(n):
        row, change = matrix[i], caused[i]
        for j in range(n):
            left[j] -= change * row[j]
        for k in range(len(slopes)):
            slope = slopes[k, i]
            for j in range(n):
                seen[k, j] += slope * row[j]
    off = mean - params.copy().reshape(-1)
    pull = prior @ off
    left = left[:n]
    cost = float(constant - caused @ (vector[:n] + left) + off @ pull)
    return cost, seen @ slopes.T + prior, slopes @ left + pull, caused, slopes
