"""Quadratic problems in the space of the data, also with images that are nowhere negative."""

import numpy as np
import scipy.sparse as sp

from ohmskin.arrays import Bools, Floats
from ohmskin.forward.assembly import factorise
from ohmskin.inverse.modes import regularised


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


def nonnegative(matrix: sp.csc_array, rows: Floats, volts: Floats, noise: float, rounds: int = 40) -> Floats:
    """The same with w >= 0, by the primal-dual active set method (Hintermueller, Ito and Kunisch 2002).

    Unknowns are held at zero where their gradient says so, and solved for elsewhere, until the set repeats. For the
    penalties of this package that takes some five to ten rounds and is then exact.
    """
    w = penalised(matrix, rows, volts, noise)
    held = w < 0
    for _ in range(rounds):
        w = penalised(matrix, rows, volts, noise, ~held)
        gradient = matrix @ w - rows.T @ (volts - rows @ w) / noise**2
        wanted = np.where(held, gradient > 0, w < 0)
        if np.array_equal(wanted, held):
            break
        held = wanted
    return np.maximum(w, 0.0)
