"""Dense matrices of some dozen unknowns, too small for BLAS: a product that stays in registers, and factors of it."""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from ohmskin.arrays import Floats

_PANEL = 32  # rows of a front eliminated at once
_STRIP = 64  # columns of a front that a panel is taken from at once


def _tile(
    typing: Any, c: Any, c_at: Any, c_step: Any, less: Any, a: Any, a_at: Any, a_step: Any, a_next: Any,
    b: Any, b_at: Any, b_step: Any, depth: Any,
) -> tuple[Any, Any]:  # fmt: skip
    """C = A^T B, or C - A^T B if `less`, for 4 rows and 8 columns of C, which may be B; in flat arrays (n,).

    The loops below in plain Python, but with all of C in registers; LLVM does not see that they do not overlap.

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
                one = builder.insert_element(
                    nothing, builder.load(builder.gep(a, [at])), ir.Constant(ir.IntType(32), 0)
                )
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
def padded(n: int) -> int:
    """Length of the rows in which n numbers are kept.

    It has room for a tile that reaches beyond, and is an odd number of cache lines, or numbers below each other would
    drive each other out of the cache.
    """
    return int(8 * ((n + 15) // 8 | 1))


@njit(cache=True, nogil=True)
def eliminate_front(work: Floats, front: int, step: int, own: int, width: int) -> int:
    """Eliminate the first `own` unknowns of a front in place, panel by panel; the number of a bad one, else -1.

    A front is the upper half of a matrix, by rows from `front` on. Its own rows are filled up to whole tiles, and its
    columns with them, so that tiles that reach beyond do no harm. Squares on the diagonal are left as R^-1, which is
    all that solving asks for.
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
                    at = front + i * step + j
                    tile(work, at, step, True, work, top + i, step, 1, work, top + j, step, last - first)
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
def solve_front(work: Floats, step: int, own: int, x: Floats) -> None:
    """Solve eight right-hand sides x (own * 8,) in place, with an eliminated front of `own` unknowns, whole tiles."""
    for i in range(0, own, 4):
        tile(x, i * 8, 8, True, work, i, step, 1, x, 0, 8, i)
        tile(x, i * 8, 8, False, work, i * step + i, step, 1, x, i * 8, 8, 4)
    for i in range(own - 4, -1, -4):
        at = i * step + i
        tile(x, i * 8, 8, True, work, at + 4, 1, step, x, (i + 4) * 8, 8, own - i - 4)
        tile(x, i * 8, 8, False, work, at, 1, step, x, i * 8, 8, 4)
