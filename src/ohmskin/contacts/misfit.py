"""A squared misfit of two-terminal resistances, and what is left of it once some changes are known, or not at all."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numba import njit
from scipy.linalg.blas import dtrmm

from ohmskin.arrays import Floats

Parts = tuple[Floats, Floats, float]


@dataclass(frozen=True, eq=False)
class Misfit:
    """A squared misfit constant - 2 vector.x + x.matrix.x, of data in units of their noise.

    Args:
        whole: (n, n) its curvature, halved, but for what is lost; n = n_pairs + 1.
        vector: (n,) its downhill gradient at nothing, halved.
        constant: That of nothing.
        lost: (k, n) rows whose products with themselves are to be taken off the `whole`.
        powers: Of the whole, as far as they have been asked for, see `power`.
    """

    whole: Floats
    vector: Floats
    constant: float
    lost: Floats
    powers: dict[int, Floats] = field(default_factory=dict, repr=False)

    @cached_property
    def matrix(self) -> Floats:
        """(n, n) its curvature, halved."""
        return self.whole - self.lost.T @ self.lost if len(self.lost) else self.whole

    @property
    def diagonal(self) -> Floats:
        """(n,) that of the matrix."""
        return np.asarray(np.diag(self.whole) - (self.lost**2).sum(axis=0))

    def less(self, known: Floats) -> "Misfit":
        """What is left once changes (n_pairs or n,) are known."""
        vector, constant = _less(self.whole, self.vector, self.constant, self.lost, np.ascontiguousarray(known))
        return Misfit(self.whole, vector, constant, self.lost, self.powers)

    def without(self, directions: Floats) -> "Misfit":
        """What is left beside changes (n_pairs or n, k), each with a standard deviation of one."""
        given = self.whole, self.vector, self.constant, self.lost, np.ascontiguousarray(directions.T)
        return Misfit(self.whole, *_without(*given), self.powers)

    def seen(self, changes: Floats) -> Floats:
        """What changes (m, n_pairs or n) do to the gradient (m, n)."""
        return _seen(self.whole, self.lost, changes)

    def sizes(self, changes: Floats) -> Floats:
        """How large each of changes (n_pairs or n, k) is in the data (k,) (1)."""
        return _sizes(self.whole, self.lost, np.ascontiguousarray(changes.T))

    def power(self, changes: Floats) -> Floats:
        """The squares of the sizes of changes (m, n_pairs), always the same ones; that of the whole is told once."""
        many = changes.shape[1]
        if (known := self.powers.get(id(changes))) is None:
            half = self.whole[:many, :many].copy()  # the curvature is symmetric
            half.flat[:: many + 1] *= 0.5
            known = 2 * np.einsum("np,np->p", dtrmm(1.0, half.T, changes.T, lower=1), changes.T)
            self.powers[id(changes)] = known
        return np.asarray(known - ((changes @ self.lost[:, :many].T) ** 2).sum(axis=1) if len(self.lost) else known)


@njit(cache=True, nogil=True)
def _seen(whole: Floats, lost: Floats, changes: Floats) -> Floats:
    """What changes (m, many) do to the gradient (m, n)."""
    many = changes.shape[1]
    seen: Floats = changes @ whole[:many]
    return seen - (changes @ np.ascontiguousarray(lost[:, :many]).T) @ lost if len(lost) else seen


@njit(cache=True, nogil=True)
def _less(whole: Floats, vector: Floats, constant: float, lost: Floats, known: Floats) -> tuple[Floats, float]:
    """Gradient and constant once changes (n_pairs or n,) are known."""
    seen = _seen(whole, lost, known.reshape(1, -1))[0]
    for i in range(len(known)):
        constant -= known[i] * (2 * vector[i] - seen[i])
    return vector - seen, constant


@njit(cache=True, nogil=True)
def _without(
    whole: Floats, vector: Floats, constant: float, lost: Floats, directions: Floats
) -> tuple[Floats, float, Floats]:
    """Gradient, constant and what is lost beside directions (k, n_pairs or n), taken off one after the other."""
    many, had, left = directions.shape[1], len(lost), vector.copy()
    rows = np.concatenate((lost, _seen(whole, lost, directions)))
    for i in range(len(directions)):
        row, direction = rows[had + i], directions[i]
        for k in range(had, had + i):
            row -= (rows[k, :many] @ direction) * rows[k]
        # rounding may make it negative where it is not seen
        root = np.sqrt(1 + max(row[:many] @ direction, 0.0))
        row /= root
        told = (left[:many] @ direction) / root
        left -= told * row
        constant -= told**2
    return left, constant, rows


@njit(cache=True, nogil=True)
def _sizes(whole: Floats, lost: Floats, changes: Floats) -> Floats:
    """How large changes (m, n_pairs or n) are (m,)."""
    seen = _seen(whole, lost, changes)[:, : changes.shape[1]]
    sizes: Floats = np.sqrt(np.maximum((seen * changes).sum(axis=1), 0.0))
    return sizes
