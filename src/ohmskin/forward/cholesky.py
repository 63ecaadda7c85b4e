"""Sparse Cholesky factors of matrices whose unknowns have places in space, as those of finite elements have.

Cutting space in halves, and the halves again, gives an elimination order in which the factor stays sparse (George 1973, nested
dissection): unknowns of one half know nothing of those of the other, except through the separator, which is eliminated last. Each
part of the order is one dense front of the multifrontal method (Duff and Reid 1983, Liu 1992), so that nearly all work is
products of small dense matrices; for n unknowns in the plane it grows as n^1.5, memory as n log n.
"""

import numpy as np
import scipy.sparse as sp
from numba import njit

from ohmskin.errors import ModelError
from ohmskin.geometry.domain import Floats
from ohmskin.geometry.mesh import Ints

_LEAF = 16  # unknowns below which a part is cut no further: dense work is cheaper than book-keeping
_PANEL = 32  # columns of a front eliminated at once


class Elimination:
    """The order in which unknowns are eliminated and what that fills: all of a factorisation that the values do not change.

    Args:
        pattern: (n, n) sparse symmetric matrix, both halves; only its pattern counts.
        places: (n, dim) where each unknown is.
        without: An unknown that is held at zero and left out, such as a grounded node.
    """

    def __init__(self, pattern: sp.csc_array, places: Floats, without: int = -1) -> None:
        self.n = pattern.shape[0]
        self.indptr, self.indices = pattern.indptr.astype(np.int64), pattern.indices.astype(np.int64)
        self.order, start, stop, parent = dissect(
            self.indptr, self.indices, np.ascontiguousarray(places, dtype=float), without, _LEAF
        )
        by_start = np.lexsort((stop, start))  # a front without unknowns of its own comes after those that it joins
        rank = np.empty(len(by_start), np.int64)
        rank[by_start] = np.arange(len(by_start))
        self.start, self.stop = start[by_start], stop[by_start]
        self.parent = np.where(parent[by_start] >= 0, rank[parent[by_start]], -1)
        self.place = np.full(self.n, -1)
        self.place[self.order] = np.arange(len(self.order))
        self.border_start, self.border = borders(
            self.indptr, self.indices, self.order, self.place, self.start, self.stop, self.parent
        )
        own, beyond = self.stop - self.start, np.diff(self.border_start)
        self.factor_start = np.concatenate([[0], np.cumsum(own * (own + beyond))])

    def fits(self, matrix: sp.csc_array) -> bool:
        """Whether a matrix has the pattern that this was made for."""
        return np.array_equal(matrix.indptr, self.indptr) and np.array_equal(matrix.indices, self.indices)

    def factorise(self, values: Floats) -> "Factor":
        """The factor of the matrix with these values (n_entries,), in the order of the pattern's own.

        Raises:
            ModelError: If the matrix is not positive definite.
        """
        factor = np.empty(self.factor_start[-1])
        bad = eliminate(
            self.indptr, self.indices, np.ascontiguousarray(values, dtype=float), self.order, self.place, self.start, self.stop,
            self.parent, self.border_start, self.border, self.factor_start, factor, _PANEL,
        )  # fmt: skip
        if bad >= 0:
            raise ModelError(f"the system is not positive definite at unknown {bad}; check conductivities and contact impedances")
        return Factor(self, factor)


class Factor:
    """A factorised matrix; see `Elimination`."""

    def __init__(self, elimination: Elimination, values: Floats) -> None:
        self.elimination, self.values = elimination, values

    def solve(self, loads: Floats) -> Floats:
        """The unknowns (n,) or (n, k) under loads (n,) or (n, k); zero where an unknown is held."""
        given = np.asarray(loads, float)
        inner = self.half_solve(given)
        substitute_up(*self._layout, inner)
        result = np.zeros((self.elimination.n, inner.shape[1]))
        result[self.elimination.order] = inner
        return result.reshape(given.shape)

    def half_solve(self, loads: Floats) -> Floats:
        """W loads (n, k), with W^T W the inverse of the matrix: what white noise makes of a Gaussian field, the other way round."""
        inner = np.ascontiguousarray(np.asarray(loads, float).reshape(self.elimination.n, -1)[self.elimination.order])
        substitute_down(*self._layout, inner)
        return inner

    @property
    def _layout(self) -> tuple[Ints, Ints, Ints, Ints, Ints, Floats]:
        e = self.elimination
        return e.start, e.stop, e.border_start, e.border, e.factor_start, self.values


@njit(cache=True, nogil=True)
def dissect(indptr: Ints, indices: Ints, places: Floats, without: int, leaf: int) -> tuple[Ints, Ints, Ints, Ints]:
    """Nested dissection by coordinates.

    Returns:
        order (n,) of elimination, and of each part its first and its last but one place in the order and the part it hangs on.
    """
    n, dim = places.shape
    order = np.empty(n, np.int64)
    count = 0
    for v in range(n):
        if v != without:
            order[count] = v
            count += 1
    order = order[:count]
    buffer = np.empty(count, np.int64)
    faces = np.zeros(count, np.bool_)  # whether an unknown sees one of the other half
    side = np.full(n, -1, np.int64)  # the newest half that an unknown was put in
    start, stop = np.empty(2 * count + 1, np.int64), np.empty(2 * count + 1, np.int64)
    parent = np.empty(2 * count + 1, np.int64)
    low_of, high_of, parent_of = np.empty(count + 1, np.int64), np.empty(count + 1, np.int64), np.empty(count + 1, np.int64)
    low_of[0], high_of[0], parent_of[0] = 0, count, -1
    waiting, parts = 1, 0
    while waiting > 0:
        waiting -= 1
        low, high, above = low_of[waiting], high_of[waiting], parent_of[waiting]
        part = parts
        parts += 1
        parent[part], stop[part] = above, high
        if high - low <= leaf:
            start[part] = low
            continue
        axis, widest, cut = 0, -1.0, 0.0
        for k in range(dim):
            least = most = places[order[low], k]
            total = 0.0
            for i in range(low, high):
                x = places[order[i], k]
                least, most = min(least, x), max(most, x)
                total += x
            if most - least > widest:
                axis, widest, cut = k, most - least, total / (high - low)  # the mean: quicker to find than the median
        left, right = 2 * part, 2 * part + 1
        n_left = 0
        for i in range(low, high):
            is_left = places[order[i], axis] < cut
            side[order[i]] = left if is_left else right
            n_left += is_left
        if n_left == 0 or n_left == high - low:  # most unknowns share a coordinate: cut the list instead
            n_left = (high - low) // 2
            for i in range(low, high):
                side[order[i]] = left if i - low < n_left else right
        facing_left = facing_right = 0
        faces[low:high] = False
        for i in range(low, high):
            own = side[order[i]]
            for at in range(indptr[order[i]], indptr[order[i] + 1]):
                other = side[indices[at]]
                if other != own and (other in (left, right)):
                    if own == left:
                        facing_left += 1
                    else:
                        facing_right += 1
                    faces[i] = True
                    break
        thinner = left if facing_left <= facing_right else right
        # the separator: unknowns of the thinner front line that see the other half; it goes to the end
        to_left, to_right, to_end = 0, 0, 0
        n_separator = min(facing_left, facing_right)
        n_left -= n_separator if thinner == left else 0
        n_right = high - low - n_left - n_separator
        for i in range(low, high):
            v = order[i]
            own = side[v]
            if own == thinner and faces[i]:
                buffer[n_left + n_right + to_end] = v
                to_end += 1
            elif own == left:
                buffer[to_left] = v
                to_left += 1
            else:
                buffer[n_left + to_right] = v
                to_right += 1
        order[low:high] = buffer[: high - low]
        start[part] = high - n_separator
        for first, last in ((low, low + n_left), (low + n_left, low + n_left + n_right)):
            if last > first:
                low_of[waiting], high_of[waiting], parent_of[waiting] = first, last, part
                waiting += 1
    return order, start[:parts].copy(), stop[:parts].copy(), parent[:parts].copy()


@njit(cache=True, nogil=True)
def borders(indptr: Ints, indices: Ints, order: Ints, place: Ints, start: Ints, stop: Ints, parent: Ints) -> tuple[Ints, Ints]:
    """Of each front, the later unknowns (places in the order, rising) that eliminating its own ties together."""
    parts = len(start)
    border_start = np.zeros(parts + 1, np.int64)
    border = np.empty(4 * len(order) + 64, np.int64)
    seen = np.full(len(order), -1, np.int64)
    first_child, next_child = np.full(parts, -1, np.int64), np.full(parts, -1, np.int64)
    for part in range(parts):
        if parent[part] >= 0:
            next_child[part] = first_child[parent[part]]
            first_child[parent[part]] = part
    used = 0
    for part in range(parts):
        begin = used
        for j in range(start[part], stop[part]):
            for at in range(indptr[order[j]], indptr[order[j] + 1]):
                i = place[indices[at]]
                if i >= stop[part] and seen[i] != part:
                    if used == len(border):
                        border = np.concatenate((border, np.empty_like(border)))
                    seen[i] = part
                    border[used] = i
                    used += 1
        child = first_child[part]
        while child >= 0:
            for at in range(border_start[child], border_start[child + 1]):
                i = border[at]
                if i >= stop[part] and seen[i] != part:
                    if used == len(border):
                        border = np.concatenate((border, np.empty_like(border)))
                    seen[i] = part
                    border[used] = i
                    used += 1
            child = next_child[child]
        border[begin:used].sort()
        border_start[part + 1] = used
    return border_start, border[:used].copy()


@njit(cache=True, nogil=True)
def eliminate(
    indptr: Ints,
    indices: Ints,
    values: Floats,
    order: Ints,
    place: Ints,
    start: Ints,
    stop: Ints,
    parent: Ints,
    border_start: Ints,
    border: Ints,
    factor_start: Ints,
    factor: Floats,
    panel: int,
) -> int:
    """Fill `factor`; the number of an unknown where the matrix is not positive definite, else -1."""
    parts = len(start)
    local = np.zeros(len(order), np.int64)
    # what fronts leave to their parents, stacked: children are next to each other on top when their parent's turn comes
    left_part, left_start = np.empty(parts + 1, np.int64), np.empty(parts + 1, np.int64)
    left = np.empty(1 << 16)
    depth, used = 0, 0
    for part in range(parts):
        own = stop[part] - start[part]
        n_border = border_start[part + 1] - border_start[part]
        size = own + n_border
        front = np.zeros((size, size))
        for k in range(own):
            local[start[part] + k] = k
        for k in range(n_border):
            local[border[border_start[part] + k]] = own + k
        for k in range(own):
            v = order[start[part] + k]
            for at in range(indptr[v], indptr[v + 1]):
                i = place[indices[at]]
                if i >= start[part] + k:
                    front[local[i], k] += values[at]
        while depth > 0 and parent[left_part[depth - 1]] == part:
            depth -= 1
            child = left_part[depth]
            first = border_start[child]
            m = border_start[child + 1] - first
            at = left_start[depth]
            for i in range(m):
                row = local[border[first + i]]
                for j in range(i + 1):
                    front[row, local[border[first + j]]] += left[at + j]
                at += i + 1
            used = left_start[depth]
        bad = eliminate_dense(front, own, panel)
        if bad >= 0:
            return int(order[start[part] + bad])
        factor[factor_start[part] : factor_start[part + 1]] = front[:, :own].copy().reshape(-1)
        if n_border > 0:
            needed = n_border * (n_border + 1) // 2
            if used + needed > len(left):
                larger = np.empty(max(2 * len(left), used + needed))
                larger[:used] = left[:used]
                left = larger
            left_part[depth], left_start[depth] = part, used
            depth += 1
            for i in range(n_border):
                left[used : used + i + 1] = front[own + i, own : own + i + 1]
                used += i + 1
    return -1


# sums may be taken in any order, which makes them quick; no other "fast" arithmetic, so that what is not finite is still seen
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def eliminate_dense(front: Floats, own: int, panel: int) -> int:
    """Eliminate the first `own` unknowns of a front, lower half, in place; the number of a bad one, else -1."""
    size = len(front)
    for k0 in range(0, own, panel):
        k1 = min(k0 + panel, own)
        for j in range(k0, k1):
            known = front[j, k0:j]
            for i in range(j, size):
                row = front[i, k0:j]
                total = 0.0
                for k in range(j - k0):
                    total += row[k] * known[k]
                front[i, j] -= total
            if not front[j, j] > 0.0:
                return j
            scale = np.sqrt(front[j, j])
            front[j, j] = scale
            for i in range(j + 1, size):
                front[i, j] /= scale
        if k1 < size:
            columns = front[k1:, k0:k1].copy()
            for c0 in range(0, size - k1, 128):
                c1 = min(c0 + 128, size - k1)
                front[k1 + c0 :, k1 + c0 : k1 + c1] -= np.dot(columns[c0:], columns[c0:c1].T)
    return -1


@njit(cache=True, nogil=True)
def substitute_down(
    start: Ints, stop: Ints, border_start: Ints, border: Ints, factor_start: Ints, factor: Floats, x: Floats
) -> None:
    """L^-1 x in place, x (n, k) in the order of elimination."""
    width = x.shape[1]
    for part in range(len(start)):
        own, first = stop[part] - start[part], border_start[part]
        n_border = border_start[part + 1] - first
        block = factor[factor_start[part] : factor_start[part + 1]].reshape((own + n_border, own))
        mine = x[start[part] : stop[part]]
        for i in range(own):
            for k in range(i):
                for c in range(width):
                    mine[i, c] -= block[i, k] * mine[k, c]
            for c in range(width):
                mine[i, c] /= block[i, i]
        if n_border > 0 and own > 0:
            beyond = np.dot(block[own:], mine)
            for i in range(n_border):
                for c in range(width):
                    x[border[first + i], c] -= beyond[i, c]


@njit(cache=True, nogil=True)
def substitute_up(start: Ints, stop: Ints, border_start: Ints, border: Ints, factor_start: Ints, factor: Floats, x: Floats) -> None:
    """L^-T x in place, x (n, k) in the order of elimination."""
    width = x.shape[1]
    for part in range(len(start) - 1, -1, -1):
        own, first = stop[part] - start[part], border_start[part]
        n_border = border_start[part + 1] - first
        block = factor[factor_start[part] : factor_start[part + 1]].reshape((own + n_border, own))
        mine = x[start[part] : stop[part]]
        if n_border > 0 and own > 0:
            beyond = np.empty((n_border, width))
            for i in range(n_border):
                beyond[i] = x[border[first + i]]
            mine -= np.dot(block[own:].T, beyond)
        for i in range(own - 1, -1, -1):
            for c in range(width):
                mine[i, c] /= block[i, i]
            for k in range(i):
                for c in range(width):
                    mine[k, c] -= block[i, k] * mine[i, c]
