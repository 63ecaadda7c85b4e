"""Sparse Cholesky factors of matrices whose unknowns have places in space, as those of finite elements have.

Cutting space in halves, and the halves again, gives an elimination order in which the factor stays sparse (George 1973, nested
dissection): unknowns of one half know nothing of those of the other, except through the separator, which is eliminated last. Each
part of the order is one dense front of the multifrontal method (Duff and Reid 1983, Liu 1992), so that nearly all work is
products of small dense matrices; for n unknowns in the plane it grows as n^1.5, memory as n log n.

Fronts of a few dozen unknowns are too small for BLAS: all products are made of one small one, `tile`, that stays in registers.
"""

from typing import Any

import numpy as np
import scipy.sparse as sp
from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from ohmskin.errors import ModelError
from ohmskin.geometry.domain import Floats
from ohmskin.geometry.mesh import Ints

_LEAF = 24  # unknowns below which a part is cut no further: dense work is cheaper than book-keeping
_PANEL = 32  # rows of a front eliminated at once
_STRIP = 64  # columns of a front that a panel is taken from at once


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
        self.order, part_of, self.start, self.parent = dissect(
            self.indptr, self.indices, np.ascontiguousarray(places, dtype=float), without, _LEAF
        )
        self.place = np.full(self.n, -1)
        self.place[self.order] = np.arange(len(self.order))
        self.border_start, self.border = borders(self.indptr, self.indices, self.order, part_of, self.start, self.parent)
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
            self.indptr, self.indices, np.ascontiguousarray(values, dtype=float), self.order, self.place, self.start, self.parent,
            self.border_start, self.border, self.factor_start, factor,
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
        columns = given.reshape(self.elimination.n, -1)
        result = np.zeros(columns.shape)
        substitute_up(*self._layout, self._down(columns), result)
        return result.reshape(given.shape)

    def half_solve(self, loads: Floats) -> Floats:
        """W loads (n, k), with W^T W the inverse of the matrix: what white noise makes of a Gaussian field, the other way round."""
        columns = np.asarray(loads, float).reshape(self.elimination.n, -1)
        return self._down(columns)[:, : columns.shape[1]]

    def _down(self, loads: Floats) -> Floats:
        inner = np.zeros((len(self.elimination.order), (loads.shape[1] + 7) // 8 * 8))
        substitute_down(*self._layout, loads, inner)
        return inner

    @property
    def _layout(self) -> tuple[Ints, Ints, Ints, Ints, Ints, Floats, int]:
        e = self.elimination
        return e.order, e.start, e.border_start, e.border, e.factor_start, self.values, e.largest


@njit(cache=True, nogil=True)
def dissect(indptr: Ints, indices: Ints, places: Floats, without: int, leaf: int) -> tuple[Ints, Ints, Ints, Ints]:
    """Nested dissection by coordinates: space is cut first, then unknowns that see others across a cut are lifted to it.

    Returns:
        order (n,) of elimination; the part of each unknown (n,), -1 of the one left out; of each part its first place in the order
        (n_parts + 1,), and the later part that it hangs on (n_parts,), -1 of the last.
    """
    n, dim = places.shape
    order = np.array([v for v in range(n) if v != without])
    count = len(order)
    buffer, part_of, parent = np.empty(count, np.int64), np.full(n, -1), np.empty(2 * count + 1, np.int64)
    low_of, high_of, above = np.empty(count + 1, np.int64), np.empty(count + 1, np.int64), np.empty(count + 1, np.int64)
    low_of[0], high_of[0], above[0] = 0, count, -1
    waiting, parts = 1, 0
    while waiting > 0:  # each part, all of its right half, all of its left half: the order of elimination turned round
        waiting -= 1
        low, high, part = low_of[waiting], high_of[waiting], parts
        parent[part] = above[waiting]
        parts += 1
        if high - low <= leaf:
            for i in range(low, high):
                part_of[order[i]] = part
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
        n_left = n_right = 0
        for i in range(low, high):
            v = order[i]
            is_left = places[v, axis] < cut
            order[low + n_left] = buffer[n_right] = v
            n_left += is_left
            n_right += not is_left
        for i in range(n_right):
            order[low + n_left + i] = buffer[i]
        if n_left == 0 or n_right == 0:  # most unknowns share a coordinate: cut the list instead
            n_left = (high - low) // 2
        for first, last in ((low, low + n_left), (low + n_left, high)):
            low_of[waiting], high_of[waiting], above[waiting] = first, last, part
            waiting += 1
    # the edges across each cut, in a linked list
    left, right, following = np.empty(len(indices), np.int64), np.empty(len(indices), np.int64), np.empty(len(indices), np.int64)
    newest = np.full(parts, -1)
    edges = 0
    for v in range(n):
        for at in range(indptr[v], indptr[v + 1]):
            one, other = part_of[v], part_of[indices[at]]
            if one > other >= 0:
                left[edges], right[edges] = v, indices[at]
                while one != other:
                    one, other = (parent[one], other) if one > other else (one, parent[other])
                following[edges], newest[one] = newest[one], edges
                edges += 1
    seen = np.full(n, -1)
    for part in range(parts):
        n_left = n_right = 0
        edge = newest[part]
        while edge >= 0:
            v, w = left[edge], right[edge]
            if part_of[v] > part and part_of[w] > part:  # else the edge is cut already
                n_left += seen[v] != part
                n_right += seen[w] != part
                seen[v] = seen[w] = part
            edge = following[edge]
        thinner, thicker = (left, right) if n_left <= n_right else (right, left)
        edge = newest[part]
        while edge >= 0:
            if part_of[thinner[edge]] > part and part_of[thicker[edge]] > part:
                part_of[thinner[edge]] = part
            edge = following[edge]
    start = np.zeros(parts + 1, np.int64)
    for v in order:
        part_of[v] = parts - 1 - part_of[v]
        start[part_of[v] + 1] += 1
    start = np.cumsum(start)
    free = start.copy()
    for v in order:
        buffer[free[part_of[v]]] = v
        free[part_of[v]] += 1
    parent = parts - 1 - parent[:parts][::-1]
    parent[-1] = -1
    return buffer, part_of, start, parent


@njit(cache=True, nogil=True)
def borders(indptr: Ints, indices: Ints, order: Ints, part_of: Ints, start: Ints, parent: Ints) -> tuple[Ints, Ints]:
    """Of each front, the later unknowns (places in the order, rising) that eliminating its own ties together.

    They are in the borders of the parts of their earlier neighbours and of all parts on the way up to their own (Liu 1990).
    """
    parts = len(parent)
    border_start, border = np.zeros(parts + 1, np.int64), np.empty(0, np.int64)
    for filling in (False, True):
        newest, free = np.full(parts, -1), np.zeros(parts, np.int64)
        for part in range(parts):
            for j in range(start[part], start[part + 1]):
                for at in range(indptr[order[j]], indptr[order[j] + 1]):
                    below = part_of[indices[at]]
                    while 0 <= below < part and newest[below] != j:
                        newest[below] = j
                        if filling:
                            border[border_start[below] + free[below]] = j
                        free[below] += 1
                        below = parent[below]
        if not filling:
            for part in range(parts):
                border_start[part + 1] = border_start[part] + free[part]
            border = np.empty(border_start[-1], np.int64)
    return border_start, border


def _tile(
    typing: Any, c: Any, c_at: Any, c_step: Any, less: Any, a: Any, a_at: Any, a_step: Any, a_next: Any,
    b: Any, b_at: Any, b_step: Any, depth: Any,
) -> tuple[Any, Any]:  # fmt: skip
    """C = A^T B, or C - A^T B if `less`, for 4 rows and 8 columns of C, which may be B; in flat arrays (n,).

    The loops below in plain Python, but with all of C in registers; LLVM itself does not see that C, A and B do not overlap.

        for i in range(4):
            for j in range(8):
                total = sum(a[a_at + k * a_step + i * a_next] * b[b_at + k * b_step + j] for k in range(depth))
                c[c_at + i * c_step + j] = c[c_at + i * c_step + j] - total if less else total
    """
    tools: Any = cgutils
    vector = ir.VectorType(ir.DoubleType(), 8)
    nothing, zeros = ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), 8), [0] * 8)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        c, c_at, c_step, less, a, a_at, a_step, a_next, b, b_at, b_step, depth = arguments
        c, a, b = (context.make_array(signature.args[k])(context, builder, arguments[k]).data for k in (0, 4, 8))

        def eight(array: Any, at: Any) -> Any:
            return builder.bitcast(builder.gep(array, [at]), vector.as_pointer())

        totals = [tools.alloca_once_value(builder, ir.Constant(vector, [0.0] * 8)) for _ in range(4)]
        with tools.for_range(builder, depth) as loop:
            row = builder.load(eight(b, builder.add(b_at, builder.mul(loop.index, b_step))), align=8)
            at = builder.add(a_at, builder.mul(loop.index, a_step))
            for total in totals:
                one = builder.insert_element(nothing, builder.load(builder.gep(a, [at])), ir.Constant(ir.IntType(32), 0))
                product = builder.fmul(builder.shuffle_vector(one, nothing, zeros), row, flags=["contract"])
                builder.store(builder.fadd(builder.load(total), product, flags=["contract"]), total)
                at = builder.add(at, a_next)
        for total in totals:
            place, value = eight(c, c_at), builder.load(total)
            difference = builder.fsub(builder.load(place, align=8), value)
            builder.store(builder.select(less, difference, value), place, align=8)
            c_at = builder.add(c_at, c_step)
        return context.get_dummy_value()

    whole = types.int64
    return types.void(c, whole, whole, types.boolean, a, whole, whole, whole, b, whole, whole, whole), emit


tile: Any = intrinsic(_tile)


@njit(cache=True, nogil=True)
def eliminate(
    indptr: Ints,
    indices: Ints,
    values: Floats,
    order: Ints,
    place: Ints,
    start: Ints,
    parent: Ints,
    border_start: Ints,
    border: Ints,
    factor_start: Ints,
    factor: Floats,
) -> int:
    """Fill `factor`, own rows of each front; the number of an unknown where the matrix is not positive definite, else -1."""
    parts = len(parent)
    skip, width, depth = np.empty(parts, np.int64), np.empty(parts, np.int64), np.zeros(parts, np.int64)
    room, front = np.zeros(parts + 1, np.int64), np.empty(parts, np.int64)
    for part in range(parts - 1, -1, -1):  # of the fronts at one depth only one is under way at a time: they share their room
        skip[part] = start[part + 1] - start[part] + 3 & -4
        width[part] = skip[part] + border_start[part + 1] - border_start[part]
        if parent[part] >= 0:
            depth[part] = depth[parent[part]] + 1
        room[depth[part]] = max(room[depth[part]], (width[part] + 4) * (width[part] + 8))
    for part in range(parts):
        front[part] = room[: depth[part]].sum()
    work = np.empty(room.sum())
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
def eliminate_front(work: Floats, front: int, step: int, own: int, width: int) -> int:
    """Eliminate the first `own` unknowns of a front in place, panel by panel; the number of a bad one, else -1.

    A front is the upper half of a matrix, by rows from `front` on. Its own rows are filled up to whole tiles, and its columns with
    them, so that tiles that reach beyond do no harm. Squares on the diagonal are left as R^-1, which is all that solving asks for.
    """
    for first in range(0, own, _PANEL):
        last = min(first + _PANEL, own)
        top, beyond = front + first * step, last + 3 & -4
        for i in range(first, last, 4):
            row, rows = front + i * step, min(4, last - i)
            for j in range(i, width, 8):
                tile(work, row + j, step, True, work, top + i, step, 1, work, top + j, step, i - first)
            bad = invert_root(work, row + i, step, rows)
            if bad >= 0:
                return i + bad
            for j in range(i + 4, width, 8):
                tile(work, row + j, step, False, work, row + i, step, 1, work, row + j, step, rows)
        for strip in range(beyond, width, _STRIP):
            end = min(strip + _STRIP, width)
            for i in range(beyond, end, 4):
                for j in range(strip + max(0, i - strip & -8), end, 8):
                    tile(work, front + i * step + j, step, True, work, top + i, step, 1, work, top + j, step, last - first)
    return -1


@njit(cache=True, nogil=True)
def invert_root(work: Floats, at: int, step: int, rows: int) -> int:
    """Replace a small square matrix R^T R by the upper triangle R^-1; the number of a bad row, else -1."""
    for k in range(rows):
        for i in range(k):
            for j in range(k, rows):
                work[at + k * step + j] -= work[at + i * step + k] * work[at + i * step + j]
        if not work[at + k * step + k] > 0.0:
            return k
        scale = 1 / np.sqrt(work[at + k * step + k])
        work[at + k * step + k] = scale  # of R^-1
        for j in range(k + 1, rows):
            work[at + k * step + j] *= scale
    for j in range(rows - 1, -1, -1):
        for i in range(j - 1, -1, -1):
            total = 0.0
            for k in range(i + 1, j + 1):
                total -= work[at + i * step + k] * work[at + k * step + j]
            work[at + i * step + j] = total * work[at + i * step + i]
            work[at + j * step + i] = 0.0
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
    """L^-T x in place, x (n, whole tiles) in the order of elimination; also to `result`, in the order of the unknowns."""
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
                tile(front, at, width, True, factor, block + own, 1, size, front, skip * width + c, width, len(its_border))
                tile(front, at, width, True, factor, block + i + 4, 1, size, front, at + 4 * width, width, own - i - 4)
                tile(front, at, width, False, factor, block + i, 1, size, front, at, width, min(4, own - i))
        for i in range(own):
            for c in range(width):
                x[first + i, c] = front[i, c]
        for i in range(own):
            for c in range(columns):
                result[order[first + i], c] = front[i, c]


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
        rest = size - k1
        turned = np.zeros((k1 - k0, rest + 4))  # four columns of nothing, as tiles reach so far too far to the left
        step = rest + 4
        for i in range(rest):
            for k in range(k1 - k0):
                turned[k, 4 + i] = front[k1 + i, k0 + k]
        for i in range(0, rest & -4, 4):
            for j in range(i - 4, -8, -8):
                tile(front, (k1 + i) * size + k1 + j, size, True, turned, 4 + i, step, 1, turned, 4 + j, step, k1 - k0)
        for i in range(rest & -4, rest):
            for j in range(i + 1):
                for k in range(k1 - k0):
                    front[k1 + i, k1 + j] -= turned[k, 4 + i] * turned[k, 4 + j]
    return -1
