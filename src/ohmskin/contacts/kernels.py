"""The compiled steps of a fit of contacts (n, 4): x, y (m), effect (m2) and squared radius (m2) of each."""

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints
from ohmskin.forward.response import Grid, Spline, respond, scatter

SQUARE_STD = 0.75  # prior standard deviation of the squared radius, as a share of the usual one
STRONG = 1.5  # effect over area of a contact that is taken to be larger than usual if it is stronger; at most it is 2
_SMALL, _HOPE = 1e-2, 10.0  # damping at which a step promises about all that can be gained, and times it may err
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
def all_onto(positions: Floats, sheet: Grid) -> None:
    """Moves positions (n, 2) onto the sheet, in place."""
    for k in range(len(positions)):
        onto(positions[k], sheet[0], sheet[1], sheet[2], sheet[3], sheet[4])


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
def peaks(height: Floats, places: Floats, most: int, promise: float, apart: float) -> Ints:
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
            if np.hypot(places[k, 0] - places[best, 0], places[k, 1] - places[best, 1]) < apart:
                taken[k] = True
    return found


@njit(cache=True, nogil=True)
def fitted(
    starts: Floats, matrix: Floats, vector: Floats, constant: float, mean: Floats, prior: Floats, rounds: int,
    usual: float, least: float, smallest: float, largest: float, sheet: Grid, spline: Spline,
) -> tuple[Floats, float, Floats, Floats, Floats]:  # fmt: skip
    """The best fit from several starts (m, n, 4): parameters, cost, curvature, what is caused, and its slopes.

    Without `mean` and `prior`, what is `expected` of contacts of the effects of each start.
    """
    best = starts[0], np.inf, prior, mean, prior
    for k in range(len(starts)):
        params = starts[k].copy()
        known = (mean, prior) if len(mean) else expected(params[:, 2].copy(), usual, sheet[0], sheet[1])
        found = refined(
            params, matrix, vector, constant, known[0], known[1], rounds, usual, least, smallest, largest, sheet,
            spline, best[1],
        )  # fmt: skip
        if k == 0 or found[0] < best[1]:
            best = params, found[0], found[1], found[2], found[3]
    return best


@njit(cache=True, nogil=True)
def expected(effects: Floats, usual: float, low: Floats, high: Floats) -> tuple[Floats, Floats]:
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
            information[at, at] = (high[axis] - low[axis]) ** -2
        mean[4 * k + 3] = square * larger
        information[4 * k + 2, 4 * k + 2] = (10 * np.pi * square) ** -2
        information[4 * k + 3, 4 * k + 3] = (SQUARE_STD * square * larger) ** -2
    return mean, information


@njit(cache=True, nogil=True)
def refined(
    params: Floats, matrix: Floats, vector: Floats, constant: float, mean: Floats, prior: Floats, rounds: int,
    radius: float, least: float, smallest: float, largest: float, sheet: Grid, spline: Spline, best: float,
) -> tuple[float, Floats, Floats, Floats]:  # fmt: skip
    """Levenberg and Marquardt, `params` (n, 4) in place: cost, curvature, what is caused, and its slopes.

    A fit ends, too, that cannot come up with the `best` cost known, by what its next step promises.
    The `matrix` (n_pairs + 1, n_pairs + 1) and `vector` are those of a `Misfit`.
    """
    damping, floor, ceiling = 1e-3, np.full(params.size, -np.inf), np.full(params.size, np.inf)
    for axis in range(2):
        floor[axis::4], ceiling[axis::4] = sheet[0][axis], sheet[1][axis]
    floor[2::4], floor[3::4], ceiling[3::4] = least, smallest, largest
    cost, normal, gradient, caused, slopes = _linearised(params, matrix, vector, constant, mean, prior, spline)
    for _ in range(rounds):
        at, slope = params.copy().reshape(-1), 0.0
        step = _bounded_step(normal, gradient, damping, floor - at, ceiling - at)
        for i in range(len(step)):
            slope += step[i] * gradient[i]
        if not _ENOUGH <= slope < np.inf:  # also if it is no number: places would be none
            break
        if damping <= _SMALL and cost - _HOPE * slope > best:
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
    params: Floats, matrix: Floats, vector: Floats, constant: float, mean: Floats, prior: Floats, spline: Spline
) -> tuple[float, Floats, Floats, Floats, Floats]:
    """Cost, its curvature (4 n, 4 n) and downhill gradient (4 n,); what is caused, and its slopes (4 n, n_pairs)."""
    caused, slopes = responses(params, *spline)
    n = len(caused)
    seen, left = np.zeros_like(slopes), vector[:n].copy()
    _multiplied(matrix, slopes, seen)
    for i in range(n):
        for j in range(n):
            left[j] -= caused[i] * matrix[i, j]
    off = mean - params.copy().reshape(-1)
    pull = prior @ off
    cost = float(constant - caused @ (vector[:n] + left) + off @ pull)
    return cost, seen @ slopes.T + prior, slopes @ left + pull, caused, slopes


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _multiplied(matrix: Floats, rows: Floats, out: Floats) -> None:
    """Adds the product of rows (m, n) with a matrix, four of its rows at a time."""
    n = rows.shape[1]
    for i in range(0, n - 3, 4):
        for k in range(len(rows)):
            a, b, c, d = rows[k, i], rows[k, i + 1], rows[k, i + 2], rows[k, i + 3]
            for j in range(n):
                out[k, j] += a * matrix[i, j] + b * matrix[i + 1, j] + c * matrix[i + 2, j] + d * matrix[i + 3, j]
    for i in range(n - n % 4, n):
        for k in range(len(rows)):
            for j in range(n):
                out[k, j] += rows[k, i] * matrix[i, j]
