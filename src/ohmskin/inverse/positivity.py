"""Quadratic problems in the space of the data, also with images that are nowhere negative."""

import numpy as np
import scipy.sparse as sp

from ohmskin.arrays import Bools, Floats
from ohmskin.forward.assembly import factorise
from ohmskin.inverse.modes import regularised

_ROUNDS = 15  # within which a set of zeros repeats, or does not at all
_RELEASED, _FLAT, _TINY = 2000, 1e-9, 1e-300  # unknowns, at most; share of the steepest slope that is none


def penalised(matrix: sp.csc_array, rows: Floats, volts: Floats, noise: float, free: Bools | None = None) -> Floats:
    """The unknowns w (n,) that minimise |volts - rows w|^2 / noise^2 + w^T matrix w, in the space of the data.

    Args:
        matrix: (n, n) sparse, symmetric positive definite.
        rows: (n_meas, n).
        volts: (n_meas,).
        noise: Standard deviation of the data.
        free: (n,) which unknowns may differ from zero; all unless given.
    """
    free = np.ones(rows.shape[1], bool) if free is None else free
    w = np.zeros(rows.shape[1])
    if free.any():
        smoothed, normal = _data_space(sp.csc_array(matrix[free][:, free]), rows[:, free], noise)
        w[free] = smoothed @ np.linalg.solve(normal, volts)
    return w


def noise_gain(matrix: sp.csc_array, rows: Floats, noise: float, image: sp.csr_array) -> Floats:
    """How far noise of one volt moves some values (n,) of the image, `image` (n, n_unknowns) times `penalised`."""
    smoothed, normal = _data_space(matrix, rows, noise)
    return np.asarray(np.linalg.norm(np.linalg.solve(normal, (image @ smoothed).T), axis=0))


def _data_space(matrix: sp.csc_array, rows: Floats, noise: float) -> tuple[Floats, Floats]:
    """matrix^-1 rows^T (n, n_meas), and the covariance (n_meas, n_meas) of the data under this prior."""
    smoothed: Floats = factorise(matrix).solve(np.ascontiguousarray(rows.T))
    return smoothed, regularised(rows @ smoothed, noise)


def nonnegative(matrix: sp.csc_array, rows: Floats, volts: Floats, noise: float, fixed: Bools | None = None) -> Floats:
    """The same with w >= 0, exactly, by the primal-dual active set method (Hintermueller, Ito and Kunisch 2002).

    Unknowns are fixed at zero where their gradient says so, and solved for elsewhere, until the set repeats. Where
    noise is small against the data it may go in circles; from there on unknowns are released one by one (Lawson and
    Hanson 1974).

    Args:
        matrix, rows, volts, noise: As for `penalised`.
        fixed: (n,) which unknowns are expected to be zero, such as those of a similar problem.
    """

    def slope(w: Floats) -> Floats:
        return np.asarray(matrix @ w - rows.T @ (volts - rows @ w) / noise**2)

    fixed = penalised(matrix, rows, volts, noise) < 0 if fixed is None else fixed
    for _ in range(_ROUNDS):
        w = penalised(matrix, rows, volts, noise, ~fixed)
        wanted = np.where(fixed, slope(w) > 0, w < 0)
        if np.array_equal(wanted, fixed):
            return np.maximum(w, 0.0)
        fixed = wanted
    w = np.maximum(w, 0.0)
    free, released, flat = w > 0, -1, _FLAT * float(np.abs(rows.T @ volts).max()) / noise**2
    for _ in range(_RELEASED):
        while (down := free & ((best := penalised(matrix, rows, volts, noise, free)) <= 0)).any():
            shares = w[down] / np.maximum(w[down] - best[down], _TINY)
            w = w + shares.min() * (best - w)
            w[down] = np.where(shares <= shares.min(), 0.0, w[down])
            free = w > 0
        w, gradient = best, np.where(free, 0.0, slope(best))
        if gradient.min() >= -flat or gradient.argmin() == released:  # which rounding has put back
            break
        released = int(gradient.argmin())
        free = free | (np.arange(len(w)) == released)
    return w
