"""Nested dissection: the order in which unknowns that have places in space are eliminated, and what that fills."""

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints


@njit(cache=True, nogil=True)
def dissect(indptr: Ints, indices: Ints, places: Floats, without: int, leaf: int) -> tuple[Ints, Ints, Ints, Ints]:
    """Nested dissection by coordinates: space is cut, then unknowns with neighbours across a cut are lifted to it.

    Returns:
        order (n,) of elimination; the part of each unknown (n,), -1 of the one left out; of each part its first place
            in the order (n_parts + 1,), and the later part that it hangs on (n_parts,), -1 of the last.
    """
    n, dim = places.shape
    count = n - (0 <= without < n)
    order = np.empty(count, np.int64)
    for i in range(count):
        order[i] = i + (0 <= without <= i)
    buffer, part_of, parent = np.empty_like(order), np.full(n, -1), np.empty(2 * count + 1, np.int64)
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
    left, right, following = np.empty_like(indices), np.empty_like(indices), np.empty_like(indices)
    newest, edges = np.full(parts, -1), 0
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
    for part in range(parts):
        start[part + 1] += start[part]
    free = start.copy()
    for v in order:
        buffer[free[part_of[v]]] = v
        free[part_of[v]] += 1
    above = np.empty(parts, np.int64)
    for part in range(parts):
        above[part] = parts - 1 - parent[parts - 1 - part]
    above[parts - 1] = -1
    return buffer, part_of, start, above


@njit(cache=True, nogil=True)
def borders(indptr: Ints, indices: Ints, order: Ints, part_of: Ints, start: Ints, parent: Ints) -> tuple[Ints, Ints]:
    """Of each front, the later unknowns (places in the order, rising) that eliminating its own ties together.

    They are in the borders of the parts of their earlier neighbours and of all parts up to their own (Liu 1990).
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
