"""Sensitivities of all electrode pairs at once, from the electrodes' potentials: the kernels behind `TransferModel`.

With E_i the field of a current into electrode i (and out of the first), the two-terminal resistance of electrodes i
and j depends on the conductivity of an element e as dR_ij/dsigma_e = -|e| |E_i - E_j|^2.
"""

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints

_BLOCK = 128  # elements whose fields are kept in the fastest cache


@njit(cache=True, nogil=True, fastmath=True)
def fill_pairs(
    elements: Ints, gradients: Floats, measures: Floats, potentials: Floats, pairs: Ints, sensitivity: Floats
) -> None:
    """dR_ij/dsigma (n_pairs, n_elem) in ohm/siemens, to `sensitivity`, block by block.

    Args:
        elements: (n_elem, dim + 1) nodes of each.
        gradients: (n_elem, dim + 1, d) of the shape functions, in coordinates in which the skin is isotropic (1/m).
        measures: (n_elem,) areas (m2) or volumes (m3).
        potentials: (n_nodes, n_elec) for 1 A into each electrode and out of the first (V).
        pairs: (n_pairs, 2) electrodes of each pair.
    """
    n_elem, corners, dim = gradients.shape
    n_elec = potentials.shape[1]
    field = np.empty((n_elec, dim, _BLOCK))
    row = np.empty(n_elec)
    for start in range(0, n_elem, _BLOCK):
        size = min(_BLOCK, n_elem - start)
        for b in range(size):
            e = start + b
            root = np.sqrt(measures[e])
            for d in range(dim):
                row[:] = 0.0
                for k in range(corners):
                    slope = gradients[e, k, d] * root
                    for n in range(n_elec):
                        row[n] += slope * potentials[elements[e, k], n]
                for n in range(n_elec):
                    field[n, d, b] = row[n]
        for pair in range(len(pairs)):
            i, j = pairs[pair]
            out = sensitivity[pair, start : start + size]
            if dim == 2:  # the usual case in one pass
                for b in range(size):
                    x, y = field[i, 0, b] - field[j, 0, b], field[i, 1, b] - field[j, 1, b]
                    out[b] = -(x * x + y * y)
            else:
                for b in range(size):
                    x, y = field[i, 0, b] - field[j, 0, b], field[i, 1, b] - field[j, 1, b]
                    z = field[i, 2, b] - field[j, 2, b]
                    out[b] = -(x * x + y * y + z * z)


@njit(cache=True, nogil=True)
def fill_groups(
    elements: Ints, gradients: Floats, measures: Floats, potentials: Floats,
    indptr: Ints, indices: Ints, shares: Floats, pairs: Ints, grouped: Floats,
) -> None:  # fmt: skip
    """dR_ij (n_pairs, n_groups) when groups of elements change by `shares` siemens each, to `grouped`, zero before.

    The sensitivity of single elements is never stored, which for many electrodes and elements no memory would hold:
    each group takes a product of a matrix (n_elec, n_fields) with its transpose. Eight groups at a time, so that rows
    of the result are written in lines of the cache. Skin as in `fill_pairs`; shares in compressed columns (n_elem,
    n_groups), not negative.
    """
    corners, dim = gradients.shape[1], gradients.shape[2]
    n_elec, n_groups = potentials.shape[1], len(indptr) - 1
    grams = np.empty((8, n_elec, n_elec))
    for first in range(0, n_groups, 8):
        count = min(8, n_groups - first)
        for g in range(count):
            low, high = indptr[first + g], indptr[first + g + 1]
            fields = np.zeros(((high - low) * dim, n_elec))
            for at in range(low, high):
                e = indices[at]
                root = np.sqrt(measures[e] * shares[at])
                for d in range(dim):
                    row = fields[(at - low) * dim + d]
                    for k in range(corners):
                        slope = gradients[e, k, d] * root
                        for n in range(n_elec):
                            row[n] += slope * potentials[elements[e, k], n]
            np.dot(fields.T, fields, grams[g])
        for pair in range(len(pairs)):
            i, j = pairs[pair]
            for g in range(count):
                grouped[pair, first + g] = 2 * grams[g, i, j] - grams[g, i, i] - grams[g, j, j]
