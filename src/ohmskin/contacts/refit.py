"""Contacts of the last frame fitted to the next one, and whether these are all; in one compiled pass."""

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints, Singles
from ohmskin.contacts.kernels import STRONG, all_onto, expected, refined
from ohmskin.contacts.misfit import COMMON, FLAT, SINGLE, marginalise, norms, subtract
from ohmskin.contacts.solution import inverse
from ohmskin.contacts.whitened import Quadratic, dot, powers
from ohmskin.forward.splines import Grid, Spline, lopsided, respond_at

USUAL = 0.2  # share of the variance allowed to the model's errors that they usually take
CLEAR = 3.0  # times more that one contact then leaves, from which on there are two whatever the model may get wrong
HALF = 0.5  # of what is left, that a contact more must promise to explain if errors of the model might do it, too
PROMISED = 0.02  # share of the gain asked of a split that a small one must promise, to be worth a fit
WIDE = 1.5  # usual radii of a contact beyond which a pair may be as far apart as it is wide
LOPSIDED = 4.0  # times the model's error by which a small contact conducts more one way than across it (deviation)
SMALL = 1.5  # squares of the usual radius: an effect from which on it does not
MOVED = 0.25  # usual radii by which a contact has another place, where small ones have other shapes
_ANGLES = np.arange(4) * np.pi / 4
AXES = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])  # along which a pair may lie
INVALID, UNCERTAIN, VALID = 0, 1, 2  # a contact is not as it was; all are, but there may be more; there are no others
MISFIT, FAINT, WIDER, ANOTHER, PAIR = range(5)  # what makes a search worth it, see `refit`
DOUBTS = 5


@njit(cache=True, nogil=True)
def refit(
    nominal: Quadratic, inflated: Quadratic, white: Quadratic, params: Floats, settings: Floats, sheet: Grid,
    spline: Spline, candidates: Singles, search: bool, allowed: Floats,
) -> tuple[int, float, Floats, Floats, Floats, Floats, Floats]:  # fmt: skip
    """Contacts `params` (n, 4), in place, fitted where they were, and whether these are all.

    Args:
        nominal: What is measured, with nominal noise.
        inflated: The same with noise inflated by the model's error.
        white: The same if voltages err by white noise alone.
        params: What was there.
        settings: Usual radius (m), least effect (m2), smallest and largest squared radius (m2), the model's error (1),
            the bar of a contact more (deviations), that of a split (squared misfit), and whether contacts may lower
            the conductivity, too.
        sheet: Where contacts may be.
        spline: What they do.
        candidates: (n_pairs + 1, n_places) what those do that are looked for.
        search: Whether to look for more of them.
        allowed: (5,) what is accepted of each of the doubts.

    Returns:
        `INVALID`, `UNCERTAIN` or `VALID`; cost, normal, caused and slopes (4 n, n_pairs) of a solution; shapes
        (2 k, n_pairs) that it was fitted beside; and doubts (5,), each as a share of its limit, of what was examined:
        residual, faintest contact, strongest one, another one, and one that is two.
    """
    radius, least, smallest, largest, error, bar, split_bar = settings[:7]
    count, n = len(white[0][1]), len(params)
    all_onto(params, sheet)
    for k in range(n):
        params[k, 3] = min(max(params[k, 3], smallest), largest)
    common, doubts = np.zeros((1, len(nominal[2]))), np.zeros(DOUBTS)
    common[0, -1] = COMMON
    shapes = shapes_of(params, radius, error, spline)
    mean, prior = expected(params[:, 2].copy(), radius, sheet[0], sheet[1], sheet[5])
    whole, start = marginalised(inflated, common), params[:, :2].copy()
    fit = marginalised(whole, shapes)
    cost, normal, caused, slopes = refined(
        params, fit[0], fit[1], fit[2], fit[3], mean, prior, np.int64(40), radius, least, smallest, largest, sheet,
        spline, np.inf,
    )  # fmt: skip
    remaining, moved = cost, 0.0
    for k in range(n):  # a sum along an axis takes numba three seconds to compile
        moved = max(moved, (params[k, 0] - start[k, 0]) ** 2 + (params[k, 1] - start[k, 1]) ** 2)
    if len(shapes) and moved > (MOVED * radius) ** 2:
        beside = marginalised(whole, shapes_of(params, radius, error, spline))
        remaining = max(cost, subtract(beside[0], beside[1], beside[2], beside[3], caused)[1])
    signal = max(white[3], 0.0) / count
    share = 1 / (1 + error**2 * signal)
    doubts[MISFIT] = np.sqrt(remaining / (count * (share + USUAL * (1 - share))))
    covariance, others = inverse(normal), np.empty((1, len(caused)))
    for k in range(n if doubts[MISFIT] <= allowed[MISFIT] else 0):
        own = inverse(np.ascontiguousarray(covariance[4 * k : 4 * k + 4, 4 * k : 4 * k + 4]))
        height = abs(params[k, 2]) * np.sqrt(own[2, 2])
        for p in range(len(caused)):
            others[0, p] = caused[p] - params[k, 2] * slopes[4 * k + 2, p]
        asked = (bar + error * norms(white[0], white[1], others)[0]) / max(height, 1e-300)
        clear = np.sqrt(CLEAR * max(cost, bar**2) / (cost + height**2))
        doubts[FAINT] = max(doubts[FAINT], min(asked, clear))
    if not (doubts <= allowed).all():
        return INVALID, cost, normal, caused, slopes, shapes, doubts
    doubts[WIDER] = np.abs(params[:, 2]).max() / (STRONG * np.pi * radius**2)
    if not search or doubts[WIDER] > allowed[WIDER]:
        return UNCERTAIN, cost, normal, caused, slopes, shapes, doubts
    left = marginalised(marginalised(nominal, common), shapes)
    vector, constant = subtract(left[0], left[1], left[2], left[3], caused)
    left = marginalised((left[0], left[1], vector, constant), flat_prior(white, slopes))
    everything = error * norms(white[0], white[1], caused.reshape((1, -1)))[0]
    most = _highest(left, candidates, settings[7] > 0.0)
    doubts[ANOTHER] = most / min(bar + everything, max(bar, np.sqrt(HALF * constant)))
    if doubts[ANOTHER] > allowed[ANOTHER]:
        return UNCERTAIN, cost, normal, caused, slopes, shapes, doubts
    for k in range(n):
        _, height = split_gains(left, params[k], radius, sheet, spline)
        gain = max(height.max(), 0.0)
        doubts[PAIR] = max(doubts[PAIR], gain / np.sqrt(PROMISED * (split_bar + everything**2)))
    if doubts[PAIR] > allowed[PAIR]:
        return UNCERTAIN, cost, normal, caused, slopes, shapes, doubts
    return VALID, cost, normal, caused, slopes, shapes_of(params, radius, error, spline), doubts


@njit(cache=True, nogil=True)
def shapes_of(params: Floats, radius: float, error: float, spline: Spline) -> Floats:
    """What small contacts of (n, 4) may change (2 k, n_pairs) more one way than across, for one deviation (ohm).

    Args:
        params: Contacts.
        radius: The usual one (m).
        error: Of the model (1).
        spline: What contacts do.
    """
    effects, most = np.abs(params[:, 2]), SMALL * radius**2
    small = np.flatnonzero(effects < most)
    out = np.empty((2 * len(small), len(spline[8])))
    lopsided(params[small], spline[7], spline[1], spline[2], spline[3], spline[4], spline[8], out)
    for k in range(len(small)):
        effect = effects[small[k]]
        share = LOPSIDED * error * effect * (1 - effect / most) ** 2
        for p in range(out.shape[1]):
            out[2 * k, p] *= share
            out[2 * k + 1, p] *= share
    return out


@njit(cache=True, nogil=True)
def split_gains(left: Quadratic, one: Floats, radius: float, sheet: Grid, spline: Spline) -> tuple[Floats, Floats]:
    """How a contact (4,) may be two: axes (n, 2) (m), and the gain (n,) that a small pair along each promises.

    An equal pair differs from one contact by the second derivative along its axis.

    Args:
        left: What remains to be explained beside the contacts.
        one: The contact.
        radius: The usual one (m).
        sheet: Where contacts may be.
        spline: What they do.
    """
    own, many = np.sqrt(one[3]), len(AXES)
    axes = np.empty((2 * many if own > WIDE * radius else many, 2))
    n = len(axes)
    discs, found = np.empty((2 * n + 1, 3)), np.empty((2 * n + 1, 4, len(spline[8])))
    discs[:, 2] = min(one[3], spline[5][-1])
    for axis in range(2):
        discs[2 * n, axis] = one[axis]
        for k in range(n):
            axes[k, axis] = (radius if k < many else own) * AXES[k % many, axis]
            discs[k, axis], discs[n + k, axis] = one[axis] + axes[k, axis], one[axis] - axes[k, axis]
    all_onto(discs, sheet)
    respond_at(discs, spline, found)
    bend = found[:n, 2] + found[n:-1, 2] - 2 * found[-1, 2]
    power, height = norms(left[0], left[1], bend), np.empty(len(axes))
    for k in range(len(axes)):
        height[k] = dot(left[2], bend[k]) / max(power[k], 1e-6 * power.max())
    return axes, height


@njit(cache=True, nogil=True)
def marginalised(part: Quadratic, directions: Floats) -> Quadratic:
    """The part with changes (m, n_pairs or n_pairs + 1) as errors, each with a standard deviation of one."""
    vector, downdates = part[2].copy(), np.empty((len(part[1]) + len(directions), len(part[2])))
    taken = marginalise(part[0], part[1], directions, vector, downdates)
    return part[0], downdates, vector, part[3] - taken


@njit(cache=True, nogil=True)
def flat_prior(white: Quadratic, directions: Floats) -> Floats:
    """Changes (m, n_pairs) that data show, as large as they are where nothing is known of them."""
    size = norms(white[0], white[1], directions)
    seen = np.flatnonzero(size > 0)
    out = directions[seen]
    for k in range(len(seen)):
        share = FLAT * size[seen[k]]
        for p in range(out.shape[1]):
            out[k, p] /= share
    return out


@njit(cache=True, nogil=True)
def _highest(left: Quadratic, candidates: Singles, bipolar: bool) -> float:
    """Standard deviations by which the score of the likeliest of more contacts stands out."""
    (score, power), best = scores(left, candidates), 0.0
    for k in range(len(power)):
        height = score[k] / np.sqrt(power[k])
        best = max(best, abs(height) if bipolar else height)
    return best


@njit(cache=True, nogil=True, fastmath={"contract"})
def scores(left: Quadratic, candidates: Singles) -> tuple[Singles, Singles]:
    """Score and power (n_places,) of a contact more at each place, as `QuadraticMisfit.scores`."""
    whole, score = powers(left[0], candidates), np.zeros(candidates.shape[1], np.float32)
    power, product, observed = whole.copy(), np.empty(len(whole), np.float32), _observed(left)
    _combined(left[2], observed, candidates, score)
    for one in left[1]:
        product[:] = 0.0
        _combined(one, observed, candidates, product)
        for k in range(len(power)):
            power[k] -= product[k] * product[k]
    most = whole.max() * np.float32(SINGLE)
    for k in range(len(whole)):
        power[k] = max(power[k], np.float32(SINGLE) * max(whole[k], most))
    return score, power


@njit(cache=True, nogil=True)
def _observed(left: Quadratic) -> Ints:
    """The numbers of the pairs of which data have information."""
    out, count = np.empty(len(left[2]), np.int64), 0
    for p in range(len(left[2])):
        informed = left[2][p] != 0.0
        for k in range(len(left[1])):
            informed = informed or left[1][k, p] != 0.0
        if informed:
            out[count] = p
            count += 1
    return out[:count]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _combined(shares: Floats, used: Ints, rows: Singles, out: Singles) -> None:
    """Adds shares (n,) of the `used` rows (n, m) to `out` (m,); four at a time, as memory is what takes the time."""
    n = len(used)
    for k in range(0, n - 3, 4):
        a, b, c, d = rows[used[k]], rows[used[k + 1]], rows[used[k + 2]], rows[used[k + 3]]
        one, two = np.float32(shares[used[k]]), np.float32(shares[used[k + 1]])
        three, four = np.float32(shares[used[k + 2]]), np.float32(shares[used[k + 3]])
        for p in range(len(out)):
            out[p] += one * a[p] + two * b[p] + three * c[p] + four * d[p]
    for k in range(n - n % 4, n):
        last, one = rows[used[k]], np.float32(shares[used[k]])
        for p in range(len(out)):
            out[p] += one * last[p]
