"""A squared misfit of two-terminal resistances, and what is left of it once some changes are known, or not at all."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numba import njit
from scipy.linalg.blas import dtrmm

from ohmskin.arrays import Floats

_ROUNDED = 1e-12  # share of a direction's power that rounding reaches once others are taken off

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
        many, seen = len(known), self.seen(known[None])[0]
        constant = self.constant - float(known @ (2 * self.vector[:many] - seen[:many]))
        return Misfit(self.whole, self.vector - seen, constant, self.lost, self.powers)

    def without(self, directions: Floats) -> "Misfit":
        """What is left beside changes (n_pairs or n, k), each with a standard deviation of one."""
        changes, vector = np.ascontiguousarray(directions.T), self.vector.copy()
        rows = np.concatenate((self.lost, self.seen(changes)))
        constant = self.constant - _taken_off(rows[len(self.lost) :], changes, vector)
        return Misfit(self.whole, vector, constant, rows, self.powers)

    def seen(self, changes: Floats) -> Floats:
        """What changes (m, n_pairs or n) do to the gradient (m, n)."""
        many = changes.shape[1]
        seen = changes @ self.whole[:many]
        return np.asarray(seen - (changes @ self.lost[:, :many].T) @ self.lost if len(self.lost) else seen)

    def sizes(self, changes: Floats) -> Floats:
        """How large each of changes (n_pairs or n, k) is in the data (k,) (1)."""
        seen = self.seen(changes.T)[:, : len(changes)]
        return np.asarray(np.sqrt(np.maximum(np.einsum("kn,nk->k", seen, changes), 0.0)))

    def power(self, changes: Floats) -> Floats:
        """The squares of the sizes of changes (m, n_pairs), always the same ones; that of the whole is told once."""
        many = changes.shape[1]
        if (known := self.powers.get(id(changes))) is None:
            half = self.whole[:many, :many].copy()  # the curvature is symmetric
            half.flat[:: many + 1] *= 0.5
            known = 2 * np.einsum("np,np->p", dtrmm(1.0, half.T, changes.T, lower=1), changes.T)
            self.powers[id(changes)] = known
        return np.asarray(known - ((changes @ self.lost[:, :many].T) ** 2).sum(axis=1) if len(self.lost) else known)


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _taken_off(rows: Floats, directions: Floats, vector: Floats) -> float:
    """Makes of what directions (k, n_pairs or n) do to the gradient, `rows` (k, n), that whose products are lost.

    One is taken after the other, and off the `vector` (n,); so much is taken off the constant.
    """
    constant = 0.0
    for i in range(len(rows)):
        row, direction = rows[i], directions[i]
        whole = 0.0
        for k in range(len(direction)):
            whole += row[k] * direction[k]
        for before in rows[:i]:
            share = 0.0
            for k in range(len(direction)):
                share += before[k] * direction[k]
            for k in range(len(row)):
                row[k] -= share * before[k]
        power, told = 0.0, 0.0
        for k in range(len(direction)):
            power += row[k] * direction[k]
            told += vector[k] * direction[k]
        if power < _ROUNDED * whole:  # those before are it already, and what rounding leaves would grow
            row[:] = 0.0
            continue
        root = np.sqrt(1 + max(power, 0.0))  # rounding may make it negative where it is not seen
        told /= root
        for k in range(len(row)):
            row[k] /= root
            vector[k] -= told * row[k]
        constant += told * told
    return constant
