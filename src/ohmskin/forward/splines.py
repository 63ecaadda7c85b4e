"""The compiled steps of a table of contacts: splines read at a place, and what dipoles do to each other's fields."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ohmskin.arrays import Floats, Ints, Singles

Spline = tuple[Singles, Floats, Floats, Ints, float, Floats, float, Floats, Ints]
Grid = tuple[Floats, Floats, Floats, Floats, float, float]
Complexes = NDArray[np.complex128]


@njit(cache=True, nogil=True)
def weigh(
    x: float, y: float, low: Floats, pitch: Floats, steps: Ints, period: float, first: Ints, weights: Floats
) -> None:
    """The cubic B-splines that reach a place: the number of the first of four along each axis, `first` (2,), and
    `weights` (2, 2, 4), of each axis, their values and derivatives."""
    if period > 0.0:
        x -= period * np.floor(x / period)
    for axis in range(2):
        at = min(max(((y if axis else x) - low[axis]) / pitch[axis], 0.0), float(steps[axis]))
        first[axis] = min(int(at), steps[axis] - 1) if at > 0.0 else 0  # if it is no number, too: nor are the weights
        t = at - first[axis]
        s, value, slope = 1 - t, weights[axis, 0], weights[axis, 1]
        value[0], value[1], value[3] = s**3 / 6, (3 * t**3 - 6 * t**2 + 4) / 6, t**3 / 6
        value[2] = 1 - value[0] - value[1] - value[3]
        slope[0], slope[1], slope[3] = -(s**2) / 2, 1.5 * t**2 - 2 * t, t**2 / 2
        slope[2] = -slope[0] - slope[1] - slope[3]
        for k in range(4):
            slope[k] /= pitch[axis]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def respond(
    x: float, y: float, square: float, knots: Singles, low: Floats, pitch: Floats, steps: Ints, period: float,
    squares: Floats, gain: float, out: Floats,
) -> None:  # fmt: skip
    """Response of one contact at (x, y) (m) of a squared radius (m2), per square metre of its effect.

    Into `out` (4, n_pairs): the derivatives by x and y (ohm/m3), the values (ohm/m2), and that by the squared radius;
    what the knots say times `gain`.
    """
    first, weights = np.empty(2, np.int64), np.empty((2, 2, 4))
    weigh(x, y, low, pitch, steps, period, first, weights)
    layer = 0
    while layer < len(squares) - 2 and square >= squares[layer + 1]:
        layer += 1
    width = squares[layer + 1] - squares[layer]
    share = (square - squares[layer]) / width
    out[:] = 0.0
    for i in range(4):
        for j in range(4):
            both = gain * weights[0, 0, i] * weights[1, 0, j]
            along, across = gain * weights[0, 1, i] * weights[1, 0, j], gain * weights[0, 0, i] * weights[1, 1, j]
            smaller, larger = knots[first[0] + i, first[1] + j, layer], knots[first[0] + i, first[1] + j, layer + 1]
            for p in range(out.shape[1]):
                wider = larger[p] - smaller[p]
                mixed = smaller[p] + share * wider
                out[0, p] += along * mixed
                out[1, p] += across * mixed
                out[2, p] += both * mixed
                out[3, p] += both * wider / width


@njit(cache=True, nogil=True)
def respond_at(discs: Floats, spline: Spline, out: Floats) -> None:
    """Responses, into `out` (n, 4, n_pairs), of discs (n, 3): x, y (m) and squared radius (m2)."""
    for k in range(len(discs)):
        x, y, square = discs[k]
        respond(x, y, square, spline[0], spline[1], spline[2], spline[3], spline[4], spline[5], spline[6], out[k])


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _fields_at(
    params: Floats, fields: Floats, low: Floats, pitch: Floats, steps: Ints, period: float,
    field: Complexes, slope: Complexes,
) -> None:  # fmt: skip
    """Adds the fields u_x - i u_y of all electrodes at places (n, 2 or more), and their slopes along x (n, n_elec)."""
    n_elec, first, weights = fields.shape[2] // 2, np.empty(2, np.int64), np.empty((2, 2, 4))
    for k in range(len(params)):
        weigh(params[k, 0], params[k, 1], low, pitch, steps, period, first, weights)
        for i in range(4):
            for j in range(4):
                both, along = weights[0, 0, i] * weights[1, 0, j], weights[0, 1, i] * weights[1, 0, j]
                knot = fields[first[0] + i, first[1] + j]
                for m in range(n_elec):
                    field[k, m] += both * complex(knot[m], -knot[n_elec + m])
                    slope[k, m] += along * complex(knot[m], -knot[n_elec + m])


@njit(cache=True, nogil=True)
def lopsided(
    places: Floats, fields: Floats, low: Floats, pitch: Floats, steps: Ints, period: float, pairs: Ints, out: Floats
) -> None:
    """What contacts at places (n, 2) change that conduct more one way than across it, into `out` (2 n, n_pairs)."""
    n_elec = fields.shape[2] // 2
    field, slope = np.zeros((len(places), n_elec), np.complex128), np.zeros((len(places), n_elec), np.complex128)
    _fields_at(places, fields, low, pitch, steps, period, field, slope)
    for k in range(len(places)):
        for p in range(len(pairs)):
            square = (field[k, pairs[p, 0]] - field[k, pairs[p, 1]]) ** 2
            out[2 * k, p], out[2 * k + 1, p] = -square.real, square.imag


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def scatter(
    params: Floats, fields: Floats, low: Floats, pitch: Floats, steps: Ints, period: float, least: float,
    pairs: Ints, caused: Floats, slopes: Floats,
) -> None:  # fmt: skip
    """Adds what contacts (n, 4) do to each other's fields to what they cause (n_pairs,) and the slopes (4 n, n_pairs).

    With a = u_x - i u_y the field of a pair of electrodes, a disc of effect e adds e conj(a) / (2 pi d^2) to it at a
    distance d = d_x + i d_y: two dipoles (Rayleigh 1892); below `least` (m), deep in each other, ever less.
    """
    n, n_elec = len(params), fields.shape[2] // 2
    if n < 2:
        return
    field, slope = np.zeros((n, n_elec), np.complex128), np.zeros((n, n_elec), np.complex128)
    _fields_at(params, fields, low, pitch, steps, period, field, slope)
    for k in range(n):
        for other in range(k):
            x, y = params[other, 0] - params[k, 0], params[other, 1] - params[k, 1]
            if period > 0.0:
                x -= period * np.rint(x / period)
            square, back = x * x + y * y, complex(x, -y)
            below = square**2 + least**4
            near = back**2 / below
            by_x = 2 * back / below - 4 * square * x / below * near
            by_y = -2j * back / below - 4 * square * y / below * near
            effects = -params[k, 2] * params[other, 2] / np.pi
            for p in range(len(pairs)):
                i, j = pairs[p]
                one, two = (field[k, i] - field[k, j]).conjugate(), (field[other, i] - field[other, j]).conjugate()
                mutual = one * two
                felt, along, across = (mutual * near).real, (mutual * by_x).real, (mutual * by_y).real
                by_one = (slope[k, i] - slope[k, j]).conjugate() * two * near
                by_two = (slope[other, i] - slope[other, j]).conjugate() * one * near
                caused[p] += effects * felt
                slopes[4 * k + 2, p] -= params[other, 2] / np.pi * felt
                slopes[4 * other + 2, p] -= params[k, 2] / np.pi * felt
                slopes[4 * k, p] += effects * (by_one.real - along)
                slopes[4 * k + 1, p] += effects * (by_one.imag - across)
                slopes[4 * other, p] += effects * (by_two.real + along)
                slopes[4 * other + 1, p] += effects * (by_two.imag + across)
