"""Numbering of electrode pairs.

Of L electrodes there are L (L - 1) / 2 pairs (i, j), i < j. Every four-terminal quantity is a combination of the
two-terminal ones F_ij by polarisation, which is what makes drive patterns cheap to change:

    F(ab, cd) = 1/2 (F_ad + F_bc - F_ac - F_bd)

Where many electrodes cover a large skin, only pairs of near ones are driven and measured, and only these are numbered.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints, ReadOnly, lock
from ohmskin.errors import PatternError


@dataclass(frozen=True, eq=False)
class Pairs(ReadOnly):
    """Numbered pairs of electrodes. Two-terminal quantities of a skin are listed in this order.

    Args:
        n_elec: Number of electrodes.
        ends: (n_pairs, 2) the electrodes of each pair, the lower one first, in rising order.

    Attributes:
        numbers: (n_elec, n_elec) the number of each pair; n_pairs of none.
    """

    n_elec: int
    ends: Ints
    numbers: Ints = field(init=False)

    def __post_init__(self) -> None:
        numbers = np.full((self.n_elec, self.n_elec), len(self.ends), np.int64)
        i, j = self.ends.T
        numbers[i, j] = numbers[j, i] = np.arange(len(self.ends))
        object.__setattr__(self, "numbers", numbers)
        lock(self)

    @classmethod
    def of(cls, n_elec: int, ends: Ints) -> "Pairs":
        """The pairs of some electrodes.

        Args:
            n_elec: Number of electrodes.
            ends: (n, 2) the electrodes of each pair, in any order, repetitions allowed; pairs of an electrode with
                itself are left out.
        """
        ends = np.unique(np.sort(ends[ends[:, 0] != ends[:, 1]], axis=1), axis=0)
        return Pairs.all(n_elec) if len(ends) == n_pairs(n_elec) else cls(n_elec, ends)

    @staticmethod
    def all(given: "Pairs | int") -> "Pairs":
        """All pairs of this number of electrodes; given pairs are returned unchanged."""
        return given if isinstance(given, Pairs) else _all(int(given))

    def __len__(self) -> int:
        return len(self.ends)

    @cached_property
    def whole(self) -> bool:
        """Whether these are all pairs of the electrodes."""
        return len(self) == n_pairs(self.n_elec)

    def index(self, a: ArrayLike, b: ArrayLike) -> Ints:
        """The number of each pair {a, b}; n_pairs where a = b.

        Raises:
            PatternError: If one is not among them.
        """
        a, b = np.asarray(a), np.asarray(b)
        found: Ints = self.numbers[a, b]
        if not self.whole and ((missing := found == len(self)) & (a != b)).any():
            k = np.flatnonzero(missing & (a != b))[0]
            pair = f"{a.ravel()[k]} and {b.ravel()[k]}"
            told = f"electrodes {pair} are not a pair that this skin is driven and measured by"
            raise PatternError(f"{told}: of {self.n_elec} electrodes only near ones are; drive and measure near ones")
        return found

    def covers(self, quadruples: Ints) -> bool:
        """Whether all measurements are combinations of these pairs.

        Args:
            quadruples: (n, 4) source, sink, plus, minus of each.
        """
        i, j = terms(quadruples)
        return self.whole or not ((self.numbers[i, j] == len(self)) & (i != j)).any()  # a driven electrode's F_ii = 0


@cache
def _all(n_elec: int) -> Pairs:
    return Pairs(n_elec, all_pairs(n_elec))


_ENDS = np.array([[0, 3], [1, 2], [0, 2], [1, 3]])  # of F_ad, F_bc, F_ac and F_bd in a measurement
SIGNS = np.array([0.5, 0.5, -0.5, -0.5])  # theirs in it


def terms(quadruples: Ints) -> tuple[Ints, Ints]:
    """The ends, (n, 4) each, of the two-terminal resistances F_ad, F_bc, F_ac and F_bd behind measurements (n, 4)."""
    return quadruples[:, _ENDS[:, 0]], quadruples[:, _ENDS[:, 1]]


def pairs_measured(n_elec: int, measurements: Iterable[Ints]) -> Pairs:
    """The pairs behind measurements, arrays (n, 4) of source, sink, plus, minus; those driven among them."""
    ends = [part for each in measurements for part in (np.stack(terms(each), axis=-1).reshape(-1, 2), each[:, :2])]
    return Pairs.of(n_elec, np.concatenate(ends))


def n_pairs(n_elec: int) -> int:
    """Number of pairs of `n_elec` electrodes."""
    return n_elec * (n_elec - 1) // 2


def all_pairs(n_elec: int) -> Ints:
    """The pairs (n_pairs, 2) in their numbering: (0, 1), (0, 2), ..., (n_elec - 2, n_elec - 1)."""
    return np.column_stack(np.triu_indices(n_elec, k=1)).astype(np.int64)


def pair_index(a: ArrayLike, b: ArrayLike, n_elec: int) -> Ints:
    """The number of each pair {a, b}, a != b, among all pairs of `n_elec` electrodes."""
    return np.asarray(Pairs.all(n_elec).numbers[np.asarray(a), np.asarray(b)])


def two_terminal(form: Floats, pairs: Pairs | None = None) -> Floats:
    """F_ij = s_ii + s_jj - s_ij - s_ji (n_pairs,) of a bilinear form s (n_elec, n_elec), as transfer resistances.

    Of all `pairs` unless some are given.
    """
    i, j = (all_pairs(len(form)) if pairs is None else pairs.ends).T
    own = np.diag(form)
    found: Floats = own[i] + own[j] - form[i, j] - form[j, i]
    return found


def in_series(electrodes: Sequence[int], pairs: Pairs | int) -> Floats:
    """Change of two-terminal resistances (n_pairs, n) by 1 ohm in series with each of n electrodes (ohm)."""
    return np.asarray(_in_series(Pairs.all(pairs))[:, np.asarray(electrodes, int)])


@cache
def _in_series(pairs: Pairs) -> Floats:
    return np.asarray((pairs.ends[:, :, None] == np.arange(pairs.n_elec)).any(axis=1).astype(float))
