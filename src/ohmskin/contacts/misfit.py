"""A squared misfit of two-terminal resistances, conditioned on known changes, marginalised over unknown ones."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints, Singles
from ohmskin.contacts import whitened
from ohmskin.contacts.whitened import Quadratic, Rows

_SOME, _ALL = 0.7, slice(None)  # share of the pairs below which it pays to leave out those without information
_SOLVED = 1e-8  # share of the gradient that is left once it is as good as nothing
_ROUNDED = 1e-12  # share of a direction's power that rounding reaches once others are taken off
SINGLE = 1e-5  # the same of powers in single precision
COMMON = 0.03  # by which all resistances may have changed together since calibration, as with temperature
FLAT = 1e-4  # inverse of a flat prior's standard deviation, in deviations of the data's noise


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """A squared misfit constant - 2 vector.x + x.matrix.x written out, which takes no more room the more data it has.

    Args:
        matrix: (n_pairs, n_pairs) its curvature, halved.
        vector: (n_pairs,) its downhill gradient at nothing, halved.
        constant: That of nothing.
    """

    matrix: Floats
    vector: Floats
    constant: float

    def plus(self, other: "NormalEquations", share: float) -> "NormalEquations":
        """Its `share`, and all of another."""
        return NormalEquations(
            share * self.matrix + other.matrix,
            share * self.vector + other.vector,
            share * self.constant + other.constant,
        )


@dataclass(frozen=True, eq=False)
class QuadraticMisfit:
    """A squared misfit constant - 2 vector.x + x.matrix.x, of data in units of their noise.

    Args:
        rows: What changes do to the data.
        downdates: (k, n) rows whose outer products are subtracted from the curvature; n = n_pairs + 1.
        vector: (n,) its downhill gradient at nothing, halved.
        constant: That of nothing.
        errors: How many of these are of errors, and lost from the start.
        powers: What is known of powers beside these errors, see `scores`: the pairs that data determine, what changes
            do to these, powers of changes, and as far as rounding reaches.
    """

    rows: Rows
    downdates: Floats
    vector: Floats
    constant: float
    errors: int = 0
    powers: dict[int, tuple[Ints | slice, Singles, Singles, Singles]] = field(default_factory=dict, repr=False)

    @cached_property
    def matrix(self) -> Floats:
        """(n, n) its curvature, halved."""
        whole = whitened.gram(self.rows, len(self.vector) - 1)
        return np.asarray(whole - self.downdates.T @ self.downdates)

    @property
    def part(self) -> Quadratic:
        """What compiled steps need of it."""
        return self.rows, self.downdates, self.vector, self.constant

    @property
    def trace(self) -> float:
        """What single resistances do to the data, all together, whatever is lost: the sum of its squares."""
        columns, sizes, loading, *_ = self.rows
        terms = (columns[:, :4] < len(self.vector) - 1).sum(axis=1)
        return float(terms @ sizes**2 + loading @ loading)

    @property
    def sums(self) -> NormalEquations:
        """It written out, of two-terminal resistances alone."""
        return NormalEquations(self.matrix[:-1, :-1], self.vector[:-1], self.constant)

    def minus(self, known: Floats) -> "QuadraticMisfit":
        """The misfit conditioned on known changes (n_pairs or n,), which are subtracted."""
        vector, constant = subtract(self.rows, self.downdates, self.vector, self.constant, known)
        return QuadraticMisfit(self.rows, self.downdates, vector, constant, self.errors, self.powers)

    def marginalised(self, directions: Floats) -> "QuadraticMisfit":
        """The misfit marginalised over changes (n_pairs or n, k), each with a standard deviation of one."""
        vector, downdates = self.vector.copy(), np.empty((len(self.downdates) + directions.shape[1], len(self.vector)))
        taken = marginalise(self.rows, self.downdates, np.ascontiguousarray(directions.T), vector, downdates)
        return QuadraticMisfit(self.rows, downdates, vector, self.constant - taken, self.errors, self.powers)

    def normal_products(self, changes: Floats) -> Floats:
        """What changes (m, n_pairs or n) do to the gradient (m, n)."""
        out = np.empty((len(changes), len(self.vector)))
        normal_products(self.rows, self.downdates, np.ascontiguousarray(changes), out)
        return out

    def norms(self, changes: Floats) -> Floats:
        """Norms (k,) in the data, in units of their noise, of changes (n_pairs or n, k)."""
        return norms(self.rows, self.downdates, np.ascontiguousarray(changes.T))

    def scores(self, changes: Singles) -> tuple[Floats, Floats]:
        """Products of changes (n, m) with the gradient, and the squares of their sizes (m,), to some 1e-6.

        The last row of the changes is zero, and they are always the same ones: what has been computed once for the data
        before something was taken off is not computed again. Of many pairs, data determine only some.
        """
        if id(changes) not in self.powers:
            there = np.bincount(self.rows[0].ravel().astype(np.intp), minlength=len(changes)) > 0
            rows, own = self.rows, changes
            seen: Ints | slice = _ALL
            if np.count_nonzero(there) < _SOME * len(changes):
                seen, own = np.flatnonzero(there), np.ascontiguousarray(changes[there])
                rows = ((np.cumsum(there) - 1).astype(np.uint64)[rows[0]], *rows[1:])
            whole = whitened.powers(rows, own)
            known = _downdated(whole, self.downdates[: self.errors, seen], own)
            self.powers[id(changes)] = seen, own, known, SINGLE * np.maximum(whole, whole.max() * SINGLE)
        seen, own, known, least = self.powers[id(changes)]
        power = np.maximum(_downdated(known, self.downdates[self.errors :, seen], own), least)
        return (self.vector[seen].astype(np.float32) @ own).astype(float), power.astype(float)


def _downdated(power: Singles, downdates: Floats, changes: Singles) -> Singles:
    """Powers of changes (n, m) beside rows (k, n) that are lost."""
    if not len(downdates):
        return power
    product = downdates.astype(np.float32) @ changes
    return np.asarray(power - np.einsum("km,km->m", product, product))


@njit(cache=True, nogil=True)
def normal_products(rows: Rows, downdates: Floats, changes: Floats, out: Floats) -> None:
    """What changes (m, n_pairs or n) do to the gradient, into `out` (m, n)."""
    quiet, starts, weights = rows[3], rows[4], rows[5]
    pairs, data, inner = out.shape[1] - 1, np.empty(len(quiet)), np.empty(len(weights))
    for k in range(len(changes)):
        whitened.apply(rows, changes[k], pairs, data)
        whitened.reference_products(rows, data, inner)
        for i in range(len(inner)):
            for m in range(starts[i], starts[i + 1]):
                data[m] -= weights[i] * inner[i] * quiet[m]
        out[k] = 0.0
        whitened.apply_transposed(rows, data, pairs, out[k])
        for one in downdates:
            whitened.add(-whitened.dot(one, changes[k]), one, out[k])


@njit(cache=True, nogil=True)
def ridge_solution(rows: Rows, downdates: Floats, vector: Floats, ridge: float) -> Floats:
    """The x (n,) of least squared misfit with `ridge` times its square, nothing common (conjugate gradients).

    Data determine few combinations of resistances, so that it takes as many products with their rows, and no matrix.
    """
    n = len(vector)
    x, left, product = np.zeros(n), vector.copy(), np.empty((1, n))
    left[n - 1] = 0.0
    along = left.copy().reshape((1, n))
    square = first = whitened.dot(left, left)
    for _ in range(2 * n):
        if square <= _SOLVED**2 * first or square == 0.0:
            break
        normal_products(rows, downdates, along, product)
        product[0, n - 1] = 0.0
        whitened.add(ridge, along[0], product[0])
        step = square / whitened.dot(along[0], product[0])
        whitened.add(step, along[0], x)
        whitened.add(-step, product[0], left)
        before, square = square, whitened.dot(left, left)
        for k in range(n):
            along[0, k] = left[k] + square / before * along[0, k]
    return x


@njit(cache=True, nogil=True)
def subtract(rows: Rows, downdates: Floats, vector: Floats, constant: float, known: Floats) -> tuple[Floats, float]:
    """Vector (n,) and constant conditioned on a known change (n_pairs or n,)."""
    left = np.empty((1, len(vector)))
    normal_products(rows, downdates, known.reshape((1, len(known))), left)
    constant += whitened.dot(left[0], known) - 2 * whitened.dot(vector, known)
    for k in range(len(vector)):
        left[0, k] = vector[k] - left[0, k]
    return left[0], constant


@njit(cache=True, nogil=True)
def signals(rows: Rows, downdates: Floats, vector: Floats, constant: float, caused: Floats) -> tuple[float, float]:
    """Constants beside a common change of all resistances: that of nothing, and once a change (n_pairs,) is known."""
    direction, beside = np.zeros((1, len(vector))), np.empty((len(downdates) + 1, len(vector)))
    direction[0, -1] = COMMON
    vector = vector.copy()
    constant -= marginalise(rows, downdates, direction, vector, beside)
    return constant, subtract(rows, beside, vector, constant, caused)[1]


@njit(cache=True, nogil=True)
def products(rows: Rows, downdates: Floats, changes: Floats, out: Floats) -> None:
    """What changes (m, n_pairs or n) have in common in the data, into `out` (m, m)."""
    pairs, many, injections = downdates.shape[1] - 1, len(rows[3]), len(rows[5])
    data, less = np.empty((len(changes), many)), np.empty((len(changes), injections + len(downdates)))
    for k in range(len(changes)):
        whitened.apply(rows, changes[k], pairs, data[k])
        whitened.reference_products(rows, data[k], less[k])
        for i in range(injections):
            less[k, i] *= np.sqrt(rows[5][i])
        for i in range(len(downdates)):
            less[k, injections + i] = whitened.dot(downdates[i], changes[k])
        for i in range(k + 1):
            out[i, k] = out[k, i] = whitened.dot(data[i], data[k]) - whitened.dot(less[i], less[k])


@njit(cache=True, nogil=True)
def pair_products(rows: Rows, downdates: Floats, ones: Floats, others: Floats) -> Floats:
    """Squares and product (m, 3) in the data of changes (m, n_pairs or n) and another (m, n_pairs or n) for each."""
    out, both, common = np.empty((len(ones), 3)), np.empty((2, ones.shape[1])), np.empty((2, 2))
    for k in range(len(ones)):
        whitened.copy(ones[k], both[0])
        whitened.copy(others[k], both[1])
        products(rows, downdates, both, common)
        out[k, 0], out[k, 1], out[k, 2] = common[0, 0], common[1, 1], common[0, 1]
    return out


@njit(cache=True, nogil=True)
def norms(rows: Rows, downdates: Floats, changes: Floats) -> Floats:
    """Norms (m,) in the data, in units of their noise, of changes (m, n_pairs or n)."""
    out, power = np.empty(len(changes)), np.empty((1, 1))
    for k in range(len(changes)):
        products(rows, downdates, changes[k : k + 1], power)
        out[k] = np.sqrt(max(power[0, 0], 0.0))
    return out


@njit(cache=True, nogil=True)
def marginalise(rows: Rows, downdates: Floats, directions: Floats, vector: Floats, out: Floats) -> float:
    """Downdates, into `out` (k + m, n), marginalised over directions (m, n_pairs or n) beside those before (k, n).

    One is taken after the other, and off the `vector` (n,); returns what is subtracted from the constant.
    """
    constant, before = 0.0, len(downdates)
    for i in range(before):
        whitened.copy(downdates[i], out[i])
    normal_products(rows, downdates, directions, out[before:])
    for i in range(before, len(out)):
        row, direction = out[i], directions[i - before]
        whole = whitened.dot(row, direction)
        for k in range(before, i):
            whitened.add(-whitened.dot(out[k], direction), out[k], row)
        power, slope = whitened.dot(row, direction), whitened.dot(vector, direction)
        if power < _ROUNDED * whole:  # those before are it already, and what rounding leaves would grow
            row[:] = 0.0
            continue
        root = np.sqrt(1 + max(power, 0.0))  # rounding may make it negative where it is not seen
        for k in range(len(row)):
            row[k] /= root
        whitened.add(-slope / root, row, vector)
        constant += (slope / root) ** 2
    return constant
