"""Numbering of electrode pairs.

Of L electrodes there are L (L - 1) / 2 pairs (i, j), i < j. Every four-terminal quantity is a combination of the
two-terminal ones F_ij by polarisation, which is what makes drive patterns cheap to change:

    F(ab, cd) = 1/2 (F_ad + F_bc - F_ac - F_bd)
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints


def n_pairs(n_elec: int) -> int:
    """Number of pairs of `n_elec` electrodes."""
    return n_elec * (n_elec - 1) // 2


def all_pairs(n_elec: int) -> Ints:
    """The pairs (n_pairs, 2) in their numbering: (0, 1), (0, 2), ..., (n_elec - 2, n_elec - 1)."""
    return np.column_stack(np.triu_indices(n_elec, k=1)).astype(np.int64)


def pair_index(a: ArrayLike, b: ArrayLike, n_elec: int) -> Ints:
    """The number of each pair {a, b}, a != b."""
    a, b = np.asarray(a), np.asarray(b)
    i, j = np.minimum(a, b), np.maximum(a, b)
    index: Ints = i * n_elec - i * (i + 1) // 2 + j - i - 1
    return index


@cache
def pair_numbers(n_elec: int) -> Ints:
    """The number of each pair (n_elec, n_elec); on the diagonal that of no pair, n_pairs."""
    numbers = np.full((n_elec, n_elec), n_pairs(n_elec), np.int64)
    i, j = np.triu_indices(n_elec, k=1)
    numbers[i, j] = numbers[j, i] = np.arange(len(i))
    numbers.setflags(write=False)
    return numbers


def two_terminal(form: Floats) -> Floats:
    """F_ij = s_ii + s_jj - s_ij - s_ji (n_pairs,) of a bilinear form s (n_elec, n_elec), as transfer resistances."""
    i, j = np.triu_indices(len(form), k=1)
    own = np.diag(form)
    pairs: Floats = own[i] + own[j] - form[i, j] - form[j, i]
    return pairs


def in_series(electrodes: Sequence[int], n_elec: int) -> Floats:
    """Change of two-terminal resistances (n_pairs, n) by 1 ohm in series with each of n electrodes (ohm)."""
    return np.asarray(_in_series(n_elec)[:, np.asarray(electrodes, int)])


@cache
def _in_series(n_elec: int) -> Floats:
    return np.asarray((all_pairs(n_elec)[:, :, None] == np.arange(n_elec)).any(axis=1).astype(float))
