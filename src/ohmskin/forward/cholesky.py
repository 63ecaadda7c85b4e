"""Sparse Cholesky factors of matrices whose unknowns have places in space, as those of finite elements have.

Cutting space in halves, and the halves again, gives an elimination order in which the factor stays sparse (George
1973, nested dissection): unknowns of one half know nothing of those of the other, except through the separator, which
is eliminated last. Each part of the order is one dense front of the multifrontal method (Duff and Reid 1983, Liu
1992), so that nearly all work is products of small dense matrices; it grows as n^1.5 in the plane, memory as n log n.

Fronts of a few dozen unknowns are too small for BLAS: all products are made of one, `tile`, that stays in registers.
"""

import numpy as np
import scipy.sparse as sp
from numba import njit

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import ModelError
from ohmskin.forward.dissection import borders, dissect
from ohmskin.forward.tiles import eliminate_front, tile

_LEAF = 24  # unknowns below which a part is cut no further: dense work is cheaper than book-keeping


class Elimination:
    """The order of elimination and what it fills: all of a factorisation that does not depend on the values.

    Args:
        pattern: (n, n) sparse symmetric matrix, both halves; only its pattern counts.
        places: (n, dim) where each unknown is.
        without: An unknown that is held at zero and left out, such as a grounded node.
    """

    def __init__(self, pattern: sp.csc_array, places: Floats, without: int = -1) -> None:
        self.n = pattern.shape[0]
        self.indptr, self.indices = pattern.indptr.astype(np.int64), pattern.indices.astype(np.int64)
        places = np.array(places, dtype=float, order="C")  # one type of array is compiled for: C and writable
        self.order, part_of, self.start, self.parent = dissect(self.indptr, self.indices, places, without, _LEAF)
        self.place = np.full(self.n, -1)
        self.place[self.order] = np.arange(len(self.order))
        filled = borders(self.indptr, self.indices, self.order, part_of, self.start, self.parent)
        self.border_start, self.border = filled
        own, beyond = np.diff(self.start), np.diff(self.border_start)
        self.factor_start = np.concatenate([[0], np.cumsum(own * (own + beyond))])
        self.largest = int((own + beyond).max())

    def fits(self, matrix: sp.csc_array) -> bool:
        """Whether a matrix has the pattern that this was made for."""
        return np.array_equal(matrix.indptr, self.indptr) and np.array_equal(matrix.indices, self.indices)

    def factorise(self, values: Floats) -> "Factor":
        """The factor of the matrix with these values (n_entries,), in the order of the pattern's own.

        Raises:
            ModelError: If the matrix is not positive definite.
        """
        factor = np.empty(self.factor_start[-1] + 4 * self.largest + 4)
        factor[self.factor_start[-1] :] = 0.0  # read by tiles that reach beyond the last row, and not used
        bad = eliminate(
            self.indptr, self.indices, np.ascontiguousarray(values, dtype=float), self.order, self.place, self.start,
            self.parent, self.border_start, self.border, self.factor_start, factor,
        )  # fmt: skip
        if bad >= 0:
            raise ModelError(f"the system is not positive definite at unknown {bad}; check the conductivities")
        return Factor(self, factor)


class Factor:
    """A factorised matrix; see `Elimination`."""

    def __init__(self, elimination: Elimination, values: Floats) -> None:
        self.elimination, self.values = elimination, values

    def solve(self, loads: Floats) -> Floats:
        """The unknowns (n,) or (n, k) under loads (n,) or (n, k); zero where an unknown is held."""
        given = np.asarray(loads, float)
        columns = given.reshape(self.elimination.n, -1)
        result = np.zeros(columns.shape)
        substitute_up(*self._layout, self._down(columns), result)
        return result.reshape(given.shape)

    def half_solve(self, loads: Floats) -> Floats:
        """W loads (n, k), with W^T W the inverse of the matrix: it whitens a Gaussian field."""
        columns = np.asarray(loads, float).reshape(self.elimination.n, -1)
        return self._down(columns)[:, : columns.shape[1]]

    def half_solve_transposed(self, white: Floats) -> Floats:
        """W^T white (n, k): colours a white field (n or n - 1, k), with W as in `half_solve`."""
        inner = np.zeros((len(white), (white.shape[1] + 7) // 8 * 8))
        inner[:, : white.shape[1]] = white
        result = np.zeros((self.elimination.n, white.shape[1]))
        substitute_up(*self._layout, inner, result)
        return result

    def _down(self, loads: Floats) -> Floats:
        inner = np.zeros((len(self.elimination.order), (loads.shape[1] + 7) // 8 * 8))
        substitute_down(*self._layout, np.require(loads, float, ["C", "W"]), inner)
        return inner

    @property
    def _layout(self) -> tuple[Ints, Ints, Ints, Ints, Ints, Floats, int]:
        e = self.elimination
        return e.order, e.start, e.border_start, e.border, e.factor_start, self.values, e.largest


@njit(cache=True, nogil=True)
def eliminate(
    indptr: Ints, indices: Ints, values: Floats, order: Ints, place: Ints, start: Ints, parent: Ints,
    border_start: Ints, border: Ints, factor_start: Ints, factor: Floats,
) -> int:  # fmt: skip
    """Fill `factor`, own rows of each front; an unknown where the matrix is not positive definite, else -1."""
    parts = len(parent)
    skip, width, depth = np.empty(parts, np.int64), np.empty(parts, np.int64), np.zeros(parts, np.int64)
    room, front = np.zeros(parts, np.int64), np.empty(parts, np.int64)
    for part in range(parts - 1, -1, -1):  # of the fronts at one depth one is under way at a time: they share memory
        skip[part] = start[part + 1] - start[part] + 3 & -4
        width[part] = skip[part] + border_start[part + 1] - border_start[part]
        if parent[part] >= 0:
            depth[part] = depth[parent[part]] + 1
        room[depth[part]] = max(room[depth[part]], (width[part] + 4) * (width[part] + 8))
    total = 0
    for level in range(parts):  # where the room of each depth begins
        total, room[level] = total + room[level], total
    for part in range(parts):
        front[part] = room[depth[part]]
    work = np.empty(total)
    is_open = np.zeros(parts, np.bool_)
    into = np.zeros(len(order), np.int64)
    for part in range(parts):
        first, last, above = start[part], start[part + 1], parent[part]
        own, step = last - first, width[part] + 8
        for p in (part, above):
            if p >= 0 and not is_open[p]:
                is_open[p] = True
                for i in range(width[p] + 3 & -4):
                    work[front[p] + i * (width[p] + 8) + (i & -4) : front[p] + (i + 1) * (width[p] + 8)] = 0.0
        its_border = border[border_start[part] : border_start[part + 1]]
        for k, i in enumerate(its_border):
            into[i] = skip[part] + k
        for j in range(first, last):
            row = front[part] + (j - first) * step
            for at in range(indptr[order[j]], indptr[order[j] + 1]):
                i = place[indices[at]]
                if i >= j:
                    work[row + (i - first if i < last else into[i])] += values[at]
        bad = eliminate_front(work, front[part], step, own, width[part])
        if bad >= 0:
            return int(order[first + bad])
        to = factor_start[part]
        for k in range(own):
            row = front[part] + k * step
            for i in range(own):
                factor[to + i] = work[row + i] if i >= k & -4 else 0.0
            for i in range(own, own + len(its_border)):
                factor[to + i] = work[row + skip[part] - own + i]
            to += own + len(its_border)
        if above < 0:
            continue
        at = border_start[above]
        for k, i in enumerate(its_border):
            if i < start[above + 1]:
                into[k] = i - start[above]
            else:
                while border[at] < i:
                    at += 1
                into[k] = skip[above] + at - border_start[above]
        for i in range(len(its_border)):
            source = front[part] + (skip[part] + i) * step + skip[part]
            target = front[above] + into[i] * (width[above] + 8)
            for j in range(i, len(its_border)):
                work[target + into[j]] += work[source + j]
    return -1


@njit(cache=True, nogil=True)
def substitute_down(
    order: Ints, start: Ints, border_start: Ints, border: Ints, factor_start: Ints, factor: Floats, largest: int,
    loads: Floats, x: Floats,
) -> None:  # fmt: skip
    """Add L^-1 loads to x (n, whole tiles), zero before, in the order of elimination."""
    columns, width = loads.shape[1], x.shape[1]
    front = np.zeros((largest + 8, width))
    for part in range(len(start) - 1):
        first, own = start[part], start[part + 1] - start[part]
        its_border = border[border_start[part] : border_start[part + 1]]
        size, skip = own + len(its_border), own + 3 & -4
        for i in range(own):
            for c in range(columns):
                front[i, c] = x[first + i, c] + loads[order[first + i], c]
        for i in range(0, own, 4):
            block = factor_start[part] + i
            for c in range(0, width, 8):
                at = i * width + c
                tile(front, at, width, True, factor, block, size, 1, front, c, width, i)
                tile(front, at, width, False, factor, block + i * size, size, 1, front, at, width, min(4, own - i))
        for i in range(0, len(its_border), 4):
            block = factor_start[part] + own + i
            for c in range(0, width, 8):
                tile(front, (skip + i) * width + c, width, False, factor, block, size, 1, front, c, width, own)
        for i in range(own):
            for c in range(width):
                x[first + i, c] = front[i, c]
        for i, j in enumerate(its_border):
            for c in range(width):
                x[j, c] -= front[skip + i, c]


@njit(cache=True, nogil=True)
def substitute_up(
    order: Ints, start: Ints, border_start: Ints, border: Ints, factor_start: Ints, factor: Floats, largest: int,
    x: Floats, result: Floats,
) -> None:  # fmt: skip
    """L^-T x in place, x (n, whole tiles) in the order of elimination; also to `result`, by unknowns."""
    columns, width = result.shape[1], x.shape[1]
    front = np.zeros((largest + 8, width))
    for part in range(len(start) - 2, -1, -1):
        first, own = start[part], start[part + 1] - start[part]
        its_border = border[border_start[part] : border_start[part + 1]]
        size, skip = own + len(its_border), own + 3 & -4
        for i in range(own):
            for c in range(width):
                front[i, c] = x[first + i, c]
        for i, j in enumerate(its_border):
            for c in range(width):
                front[skip + i, c] = x[j, c]
        for i in range(skip - 4, -1, -4):
            block = factor_start[part] + i * size
            for c in range(0, width, 8):
                at = i * width + c
                below = skip * width + c
                tile(front, at, width, True, factor, block + own, 1, size, front, below, width, len(its_border))
                tile(front, at, width, True, factor, block + i + 4, 1, size, front, at + 4 * width, width, own - i - 4)
                tile(front, at, width, False, factor, block + i, 1, size, front, at, width, min(4, own - i))
        for i in range(own):
            for c in range(width):
                x[first + i, c] = front[i, c]
        for i in range(own):
            for c in range(columns):
                result[order[first + i], c] = front[i, c]
