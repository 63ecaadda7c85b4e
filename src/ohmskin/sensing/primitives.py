"""Compiled parts of a cycle that know nothing of it: products, floods, the choice of eq. (7)."""

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints, Shorts, Singles
from ohmskin.contacts.regions import join_peaks
from ohmskin.drive.optimal import BEYOND
from ohmskin.forward.tiles import eliminate_front, padded, tile


@njit(cache=True, nogil=True, fastmath=True)
def project(columns: Floats, volts: Floats, projected: Floats) -> None:
    """projected = columns @ volts."""
    for k in range(len(columns)):
        total = 0.0
        for m in range(len(volts)):
            total += columns[k, m] * volts[m]
        projected[k] = total


@njit(cache=True, nogil=True, fastmath=True)
def combine(u: Singles, modes: Singles, image: Singles) -> None:
    """image = u @ modes, eight modes at a time: reads `modes` once, at the speed of memory."""
    image[:] = np.float32(0.0)
    whole = len(u) // 8 * 8
    for k in range(0, whole, 8):
        a, b, c, d, e, f, g, h = u[k], u[k + 1], u[k + 2], u[k + 3], u[k + 4], u[k + 5], u[k + 6], u[k + 7]
        for i in range(len(image)):
            image[i] += (
                (a * modes[k, i] + b * modes[k + 1, i]) + (c * modes[k + 2, i] + d * modes[k + 3, i])
                + (e * modes[k + 4, i] + f * modes[k + 5, i]) + (g * modes[k + 6, i] + h * modes[k + 7, i])
            )  # fmt: skip
    for k in range(whole, len(u)):
        for i in range(len(image)):
            image[i] += u[k] * modes[k, i]


@njit(cache=True, nogil=True, fastmath=True)
def largest(values: Singles) -> float:
    """The largest value."""
    highest = values[0]
    for k in range(len(values)):
        highest = max(highest, values[k])
    return float(highest)


@njit(cache=True, nogil=True, fastmath=True)
def add_row(weight: float, rows: Floats, at: int, total: Floats) -> None:
    """total += weight times the row that begins at `at`."""
    for k in range(len(total)):
        total[k] += weight * rows[at + k]


@njit(cache=True, nogil=True)
def factorise(rows: Floats, depth: int, system: Floats, n: int) -> None:
    """Eliminate I + R^T R (n, n), R (depth, n); in flat arrays."""
    step = padded(n)
    for i in range(0, n, 4):
        for j in range(i, n, 8):
            tile(system, i * step + j, step, False, rows, i, step, 1, rows, j, step, depth)
        for k in range(i, i + 4):
            system[k * step + k] += 1.0
    eliminate_front(system, 0, step, n, n)


@njit(cache=True, nogil=True)
def flood(
    image: Singles, neighbours: Shorts, threshold: float, dip: float, keys: Ints, parent: Shorts, labels: Shorts
) -> tuple[int, int]:
    """`ohmskin.contacts.label_peaks` without new memory: `labels` of the cells above a threshold, not negative.

    Returns:
        How many regions there are, and how many cells above, left in `keys`, the highest last.
    """
    above = 0
    bits = image.view(np.int32)
    for p in range(len(image)):
        if image[p] > threshold:
            # of positive floats the bits sort as the values do; of equal ones the lower number is the higher key
            keys[above] = (np.int64(bits[p]) << 32) | np.int64(len(image) - p)
            above += 1
    keys[:above].sort()
    for at in range(above):
        keys[at] = len(image) - (keys[at] & 0xFFFFFFFF)
    return join_peaks(image, neighbours, keys[:above], dip, parent, labels), above


@njit(cache=True, nogil=True)
def closest(centroids: Floats, x: float, y: float, anchors: Floats) -> None:
    """The three centroids closest to a point, the lower number first of equals."""
    best0 = best1 = best2 = np.inf
    p0 = p1 = p2 = 0
    for p in range(len(centroids)):
        away = (centroids[p, 0] - x) ** 2 + (centroids[p, 1] - y) ** 2
        if away < best2:
            best2, p2 = away, p
            if best2 < best1:
                best1, p1, best2, p2 = best2, p2, best1, p1
            if best1 < best0:
                best0, p0, best1, p1 = best1, p1, best0, p0
    for axis in range(2):
        anchors[0, axis], anchors[1, axis] = centroids[p0, axis], centroids[p1, axis]
        anchors[2, axis] = centroids[p2, axis]


@njit(cache=True, nogil=True)
def choose(electrodes: Floats, pairs: Ints, reach: float, anchors: Floats, crossed: Floats, chosen: Ints) -> None:
    """Eq. (7): the pairs of smallest summed triangle areas, regions in turn; `OptimalDrive.pattern` compiled.

    Args:
        electrodes: (n_elec, 2) in metres.
        pairs: (n_pairs, 2) electrodes of each.
        reach: How far the middle of a pair may be from the first anchor (m); see `pair_weights`.
        anchors: (n_regions, 3, 2) in metres.
        crossed: (>= n_regions, n_pairs) memory.
        chosen: (n,) to fill.
    """
    n_regions = len(anchors)
    for r in range(n_regions):
        largest = 0.0
        for p in range(len(pairs)):
            i, j = pairs[p]
            x, y = electrodes[i]
            along_x, along_y = electrodes[j, 0] - x, electrodes[j, 1] - y
            area = 0.0
            for k in range(anchors.shape[1]):
                area += 0.5 * abs(along_x * (anchors[r, k, 1] - y) - along_y * (anchors[r, k, 0] - x))
            crossed[r, p] = area
            largest = max(largest, area)
        for p in range(len(pairs)):
            crossed[r, p] = max(crossed[r, p], 1e-9 * largest)
            if reach < np.inf:
                one, other = electrodes[pairs[p, 0]], electrodes[pairs[p, 1]]
                x, y = anchors[r, 0, 0] - (one[0] + other[0]) / 2, anchors[r, 0, 1] - (one[1] + other[1]) / 2
                away = np.hypot(x, y)
                if away > reach:
                    crossed[r, p] = BEYOND * away
    count = 0
    while count < len(chosen):
        for r in range(n_regions):
            best = 0
            for p in range(len(pairs)):
                if crossed[r, p] < crossed[r, best]:
                    best = p
            crossed[r, best] = np.inf
            known = False
            for k in range(count):
                known = known or chosen[k] == best
            if not known and count < len(chosen):
                chosen[count] = best
                count += 1
