"""Quadratic problems with images that are nowhere negative."""

import numpy as np
import scipy.sparse as sp

from ohmskin.arrays import Bools, Floats
from ohmskin.forward.assembly import factorise


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
        some = rows[:, free]
        smoothed = factorise(sp.csc_array(matrix[free][:, free])).solve(np.ascontiguousarray(some.T))
        normal = some @ smoothed
        normal[np.diag_indices_from(normal)] += max(noise**2, 1e-14 * normal.trace())
        w[free] = smoothed @ np.linalg.solve(normal, volts)
    return w


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
