"""Sensitivities of all electrode pairs at once, from the electrodes' potentials: the kernels behind `TransferModel`.

With E_i the field of a current into electrode i (and out of the first), the two-terminal resistance of electrodes i
and j depends on the conductivity of an element e as dR_ij/dsigma_e = -|e| |E_i - E_j|^2.
"""

import numpy as np
import scipy.sparse as sp
from numba import njit

from ohmskin.arrays import Floats, Ints
from ohmskin.geometry import Mesh
from ohmskin.scan import all_pairs
from ohmskin.scan.pairs import n_pairs

_BLOCK = 128  # elements whose fields are kept in the fastest cache


def pair_sensitivity(mesh: Mesh, potentials: Floats, shape: Floats | None = None) -> Floats:
    """dR_ij/dsigma (n_pairs, n_elem) in ohm/siemens.

    Args:
        mesh: The skin.
        potentials: (n_nodes, n_elec) for 1 A into each electrode and out of the first (V).
        shape: (n_elem, dim, dim) tensors of which the conductivity is the factor; None if isotropic.
    """
    if shape is None:
        sensitivity = np.empty((n_pairs(potentials.shape[1]), mesh.n_elem))
        fill_pairs(mesh.elements, mesh.gradients, mesh.measures, potentials, sensitivity)
        return sensitivity
    field = np.einsum("ekd,ekl->led", mesh.gradients, potentials[mesh.elements])
    flux = np.einsum("ecd,led->lec", shape, field)
    i, j = all_pairs(potentials.shape[1]).T
    sensitivity = np.empty((len(i), mesh.n_elem))
    for first in range(potentials.shape[1] - 1):
        rows = np.flatnonzero(i == first)
        difference, other = field[first] - field[j[rows]], flux[first] - flux[j[rows]]
        sensitivity[rows] = -np.einsum("ped,ped->pe", difference, other) * mesh.measures
    return sensitivity


@njit(cache=True, nogil=True, fastmath=True)
def fill_pairs(elements: Ints, gradients: Floats, measures: Floats, potentials: Floats, sensitivity: Floats) -> None:
    """`pair_sensitivity` of an isotropic skin, block by block; twin of its last loop."""
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
        pair = 0
        for i in range(n_elec):
            for j in range(i + 1, n_elec):
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
                pair += 1


def grouped_sensitivity(mesh: Mesh, potentials: Floats, shares: sp.csc_array) -> Floats:
    """dR_ij (n_pairs, n_groups) when element e changes by `shares`[e, g] siemens: sensitivity @ shares.

    The sensitivity of single elements is never stored, which for many electrodes and elements no memory would hold:
    each group takes a product of a matrix (n_elec, n_fields) with its transpose. Isotropic skins only.

    Args:
        mesh: The skin.
        potentials: (n_nodes, n_elec) for 1 A into each electrode and out of the first (V).
        shares: (n_elem, n_groups) sparse, not negative.
    """
    grouped = np.zeros((n_pairs(potentials.shape[1]), shares.shape[1]))
    columns = sp.csc_array(shares)
    fill_groups(
        mesh.elements, mesh.gradients, mesh.measures, potentials,
        columns.indptr.astype(np.int64), columns.indices.astype(np.int64), columns.data, grouped,
    )  # fmt: skip
    return grouped


@njit(cache=True, nogil=True)
def fill_groups(
    elements: Ints, gradients: Floats, measures: Floats, potentials: Floats,
    indptr: Ints, indices: Ints, shares: Floats, grouped: Floats,
) -> None:  # fmt: skip
    """`grouped_sensitivity`; eight groups at a time, so that rows of the result are written in lines of the cache."""
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
            grams[g] = np.dot(fields.T, fields)
        pair = 0
        for i in range(n_elec):
            for j in range(i + 1, n_elec):
                for g in range(count):
                    grouped[pair, first + g] = 2 * grams[g, i, j] - grams[g, i, i] - grams[g, j, j]
                pair += 1
