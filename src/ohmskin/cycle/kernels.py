"""The compiled steps of a cycle; `ohmskin.cycle.reference` is their plain twin.

They run without Python's global lock and, but for systems of more than 128 measurements, touch no memory but their tables and desk.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ohmskin.forward.cholesky import eliminate_dense
from ohmskin.geometry.domain import Floats
from ohmskin.geometry.mesh import Ints

Singles = NDArray[np.float32]
Shorts = NDArray[np.int32]

_TILE = 128  # columns of a large system made at once

NOISE, AMPLITUDE, MODEL_ERROR, GAMMA_BASE, GAMMA_FINAL, FRACTION, DIP, FUSE, TRACE, PITCH, X0, Y0 = range(12)


class Tables(NamedTuple):
    """What stays the same: see `FastCycle` for the turned modes.

    Args:
        base_columns: H_0 V (rank, n_base) in volts.
        base_squares: s^2 (rank,).
        base_injections: (n_base,) injection of each measurement.
        base_currents: (n_inj,) usual currents (A).
        base_reference, reference: (n_base,), (n_complete,) untouched transfer resistances (ohm).
        mixing: C V (n_pairs, n_modes) in ohms.
        modes: V^T B (n_modes, n_pixels).
        quadruples: (n_complete, 4) of all that can be asked for, pair by pair.
        pairs: (n_pairs, 2) electrodes.
        electrodes: (n_elec, 2) in metres.
        neighbours: (n_pixels, 4), -1 where there is none.
        numbers: (ny, nx) the pixel of each cell of the grid, -1 where there is none.
        centres, areas: (n_pixels, 2), (n_pixels,) in m, m2.
    """

    base_columns: Floats
    base_squares: Floats
    base_injections: Ints
    base_currents: Floats
    base_reference: Floats
    mixing: Floats
    modes: Singles
    quadruples: Shorts
    reference: Floats
    pairs: Ints
    electrodes: Floats
    neighbours: Shorts
    numbers: Shorts
    centres: Floats
    areas: Floats


class Desk(NamedTuple):
    """Memory for one frame; nothing is allocated while frames come."""

    base_image: Singles
    image: Singles
    base_volts: Floats
    projected: Floats
    u: Floats
    u_single: Singles
    inverse: Floats
    pixel: Floats
    rows: Floats
    scaled: Floats
    system: Floats
    volts: Floats
    solved: Floats
    keys: Ints
    parent: Shorts
    labels: Shorts
    regions: Floats
    anchors: Floats
    crossed: Floats
    chosen: Ints
    found: Floats


@njit(cache=True, nogil=True)
def look(t: Tables, desk: Desk, settings: Floats, volts: Floats, currents: Floats) -> int:
    """The base image, its regions and the pairs to drive (`desk.chosen`); -1 if a datum is not finite."""
    squares = 0.0
    for m in range(len(desk.base_volts)):
        usual, current = t.base_currents[t.base_injections[m]], currents[t.base_injections[m]]
        desk.base_volts[m] = (volts[m] - current * t.base_reference[m]) * (usual / current)
        squares += desk.base_volts[m] ** 2
    if not np.isfinite(squares):
        return -1
    project(t.base_columns, desk.base_volts, desk.projected)
    weight2 = _weight2(settings, squares, len(desk.base_volts))
    rank = len(desk.projected)
    for k in range(rank):
        desk.u_single[k] = desk.projected[k] / (t.base_squares[k] + weight2)
    combine(desk.u_single[:rank], t.modes[:rank], desk.base_image)
    highest = np.float32(-np.inf)
    peak = 0
    for p in range(len(desk.base_image)):
        if desk.base_image[p] > highest:
            highest, peak = desk.base_image[p], p
    threshold = max(settings[GAMMA_BASE], settings[FRACTION] * highest)
    count, above = flood(desk.base_image, t.neighbours, threshold, settings[DIP], desk.keys, desk.parent, desk.labels)
    count = min(count, len(desk.anchors))
    if count > 0:
        _sum_regions(desk.base_image, t, desk, above, count, -np.inf)
        for r in range(count):
            mass = desk.regions[r, 0]
            _closest(t, settings, desk.regions[r, 1] / mass, desk.regions[r, 2] / mass, desk.anchors[r])
    else:
        _closest(t, settings, t.centres[peak, 0], t.centres[peak, 1], desk.anchors[0])
        count = 1
    choose(t.electrodes, t.pairs, desk.anchors[:count], desk.crossed, desk.chosen)
    return count


@njit(cache=True, nogil=True)
def see(t: Tables, desk: Desk, settings: Floats, volts: Floats, currents: Floats) -> int:
    """The final image and its contacts (`desk.found`); how many, or -1 if a datum is not finite."""
    n_meas, n_modes = desk.rows.shape
    rank = len(desk.projected)
    per_pair = n_meas // len(desk.chosen)
    fuse = settings[FUSE] != 0.0
    squares = 0.0
    for c in range(len(desk.chosen)):
        for k in range(per_pair):
            m, whole = c * per_pair + k, desk.chosen[c] * per_pair + k
            desk.volts[m] = volts[m] - currents[c] * t.reference[whole]
            squares += desk.volts[m] ** 2
            _row(t.quadruples[whole], t.mixing, len(t.electrodes), currents[c], desk.rows[m])
    if not np.isfinite(squares):
        return -1
    count = n_meas
    if fuse:
        for m in range(len(desk.base_volts)):
            squares += desk.base_volts[m] ** 2
        count += len(desk.base_volts)
    weight2 = _weight2(settings, squares, count)
    for k in range(n_modes):
        seen = t.base_squares[k] if fuse and k < rank else 0.0
        desk.inverse[k] = 1.0 / (seen + weight2)
        desk.u[k] = desk.projected[k] * desk.inverse[k] if fuse and k < rank else 0.0
    _update(desk)
    for k in range(n_modes):
        desk.u_single[k] = desk.u[k]
    combine(desk.u_single, t.modes, desk.image)
    return _contacts(t, desk, settings, weight2)


@njit(cache=True, nogil=True)
def _weight2(settings: Floats, squares: float, count: int) -> float:
    noise2 = settings[NOISE] ** 2 + settings[MODEL_ERROR] ** 2 * squares / count
    return float(max(noise2 / settings[AMPLITUDE] ** 2, 1e-14 * settings[TRACE]))


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
    """image = u @ modes, sixteen modes at a time: reads `modes` once, at the speed of memory."""
    n = len(image)
    image[:] = np.float32(0.0)
    whole = len(u) // 16 * 16
    for k in range(0, whole, 16):
        a, b, c, d, e, f, g, h = u[k], u[k + 1], u[k + 2], u[k + 3], u[k + 4], u[k + 5], u[k + 6], u[k + 7]
        o, p, q, r, s, t, v, w = u[k + 8], u[k + 9], u[k + 10], u[k + 11], u[k + 12], u[k + 13], u[k + 14], u[k + 15]
        for i in range(n):
            image[i] += (
                a * modes[k, i] + b * modes[k + 1, i] + c * modes[k + 2, i] + d * modes[k + 3, i]
                + (e * modes[k + 4, i] + f * modes[k + 5, i] + g * modes[k + 6, i] + h * modes[k + 7, i])
                + (o * modes[k + 8, i] + p * modes[k + 9, i] + q * modes[k + 10, i] + r * modes[k + 11, i])
                + (s * modes[k + 12, i] + t * modes[k + 13, i] + v * modes[k + 14, i] + w * modes[k + 15, i])
            )  # fmt: skip
    for k in range(whole, len(u)):
        for i in range(n):
            image[i] += u[k] * modes[k, i]


@njit(cache=True, nogil=True, fastmath=True)
def _row(quadruple: Shorts, mixing: Floats, n_elec: int, current: float, row: Floats) -> None:
    """Fill what one measurement sees of each mode (V)."""
    a, b, c, d = quadruple[0], quadruple[1], quadruple[2], quadruple[3]
    # no measurement of the complete pattern touches a driven electrode, so that all four pairs exist
    ad, bc = mixing[_pair(a, d, n_elec)], mixing[_pair(b, c, n_elec)]
    ac, bd = mixing[_pair(a, c, n_elec)], mixing[_pair(b, d, n_elec)]
    half = 0.5 * current
    for k in range(len(row)):
        row[k] = half * (ad[k] + bc[k] - ac[k] - bd[k])


@njit(cache=True, nogil=True)
def _pair(i: int, j: int, n_elec: int) -> int:
    low, high = int(min(i, j)), int(max(i, j))
    return low * n_elec - low * (low + 1) // 2 + high - low - 1


@njit(cache=True, nogil=True, fastmath=True)
def _update(desk: Desk) -> None:
    """u += D H^T (I + H D H^T)^-1 (volts - H u); leaves the Cholesky factor in `desk.system`."""
    n_meas, n_modes = desk.rows.shape
    u, inverse, root = desk.u, desk.inverse, desk.pixel  # the last is free until a contact is found
    for k in range(n_modes):
        root[k] = np.sqrt(inverse[k])
    for m in range(n_meas):
        row, scaled = desk.rows[m], desk.scaled[m]
        total = 0.0
        for k in range(n_modes):
            total += row[k] * u[k]
        for k in range(n_modes):
            scaled[k] = row[k] * root[k]
        desk.solved[m] = desk.volts[m] - total
    if n_meas <= _TILE:
        np.dot(desk.scaled, desk.scaled.T, desk.system)
    else:  # large ones: the lower half only
        for low in range(0, n_meas, _TILE):
            high = min(low + _TILE, n_meas)
            desk.system[low:, low:high] = np.dot(desk.scaled[low:], desk.scaled[low:high].T)
    for m in range(n_meas):
        desk.system[m, m] += 1.0
    eliminate_dense(desk.system, n_meas, 32)
    _back(desk.system, desk.solved)
    for m in range(n_meas):
        row, y = desk.rows[m], desk.solved[m]
        for k in range(n_modes):
            u[k] += inverse[k] * row[k] * y


@njit(cache=True, nogil=True, fastmath=True)
def _back(factor: Floats, x: Floats) -> None:
    """Solve L L^T x = x in place."""
    for i in range(len(x)):
        total = x[i]
        for k in range(i):
            total -= factor[i, k] * x[k]
        x[i] = total / factor[i, i]
    for i in range(len(x) - 1, -1, -1):
        x[i] /= factor[i, i]
        for k in range(i):
            x[k] -= factor[i, k] * x[i]


@njit(cache=True, nogil=True)
def flood(
    image: Singles, neighbours: Shorts, threshold: float, dip: float, keys: Ints, parent: Shorts, labels: Shorts
) -> tuple[int, int]:
    """`ohmskin.touch.label_peaks` without new memory: `labels` of the pixels above a threshold, which must not be negative.

    Returns:
        How many regions there are, and how many pixels are above; these are left in `keys`, see `_pixel`, the highest last.
    """
    above = 0
    bits = image.view(np.int32)
    for p in range(len(image)):
        labels[p] = -1
        parent[p] = -1
        if image[p] > threshold:
            # of positive floats the bits sort as the values do; of equal ones the lower number is the higher key
            keys[above] = (np.int64(bits[p]) << 32) | np.int64(len(image) - p)
            above += 1
    keys[:above].sort()
    for at in range(above - 1, -1, -1):
        e = _pixel(keys[at], len(image))
        root = -1
        for k in range(neighbours.shape[1]):
            other = neighbours[e, k]
            if other < 0 or parent[other] < 0:
                continue
            while parent[other] != other:
                parent[other] = parent[parent[other]]
                other = parent[other]
            if root < 0:
                root = other
            elif other != root:
                high, low = (root, other) if image[root] >= image[other] else (other, root)
                if image[e] > (1.0 - dip) * image[low]:
                    parent[low] = high
                root = high
        parent[e] = e if root < 0 else root
    count = 0
    for at in range(above - 1, -1, -1):
        e = _pixel(keys[at], len(image))
        root = e
        while parent[root] != root:
            root = parent[root]
        if labels[root] < 0:
            labels[root] = count
            count += 1
        labels[e] = labels[root]
    return count, above


@njit(cache=True, nogil=True)
def _pixel(key: int, n_pixels: int) -> int:
    return n_pixels - (key & 0xFFFFFFFF)


@njit(cache=True, nogil=True)
def _sum_regions(image: Singles, t: Tables, desk: Desk, above: int, count: int, share: float) -> None:
    """Of each region: mass, first moments, area, peak and its pixel, over the pixels above `share` of the peak."""
    regions = desk.regions
    for r in range(count):
        regions[r, :] = 0.0
        regions[r, 4] = -np.inf
    for at in range(above - 1, -1, -1):  # from the highest: a region's first pixel is its peak
        p = _pixel(desk.keys[at], len(image))
        r = desk.labels[p]
        if r >= count:
            continue
        if regions[r, 4] == -np.inf:
            regions[r, 4], regions[r, 5] = image[p], p
        if image[p] > share * regions[r, 4]:
            mass = image[p] * t.areas[p]
            regions[r, 0] += mass
            regions[r, 1] += mass * t.centres[p, 0]
            regions[r, 2] += mass * t.centres[p, 1]
            regions[r, 3] += t.areas[p]


@njit(cache=True, nogil=True)
def _closest(t: Tables, settings: Floats, x: float, y: float, anchors: Floats) -> None:
    """The centres of the three pixels closest to a point, the lower number first of equals."""
    ny, nx = t.numbers.shape
    column, row = int(np.round((x - settings[X0]) / settings[PITCH])), int(np.round((y - settings[Y0]) / settings[PITCH]))
    reach = 2
    while True:
        best0 = best1 = best2 = np.inf
        p0 = p1 = p2 = -1
        for j in range(max(0, row - reach), min(ny, row + reach + 1)):
            for i in range(max(0, column - reach), min(nx, column + reach + 1)):
                p = t.numbers[j, i]
                if p < 0:
                    continue
                away = (t.centres[p, 0] - x) ** 2 + (t.centres[p, 1] - y) ** 2
                if away < best0:
                    best2, p2, best1, p1, best0, p0 = best1, p1, best0, p0, away, p
                elif away < best1:
                    best2, p2, best1, p1 = best1, p1, away, p
                elif away < best2:
                    best2, p2 = away, p
        if (p2 >= 0 and np.sqrt(best2) <= reach * settings[PITCH]) or reach > max(nx, ny):
            break
        reach *= 2
    anchors[0], anchors[1], anchors[2] = t.centres[p0], t.centres[p1], t.centres[p2]


@njit(cache=True, nogil=True)
def choose(electrodes: Floats, pairs: Ints, anchors: Floats, crossed: Floats, chosen: Ints) -> None:
    """Eq. (7): the pairs with the smallest summed triangle areas, regions choosing in turn; `OptimalDrive.pattern` compiled.

    Args:
        electrodes: (n_elec, 2) in metres.
        pairs: (n_pairs, 2) electrodes of each.
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


@njit(cache=True, nogil=True)
def _contacts(t: Tables, desk: Desk, settings: Floats, weight2: float) -> int:
    """`ContactFinder.find`: place, extent, strength, peak and its standard deviation of each contact, strongest first."""
    highest = np.float32(-np.inf)
    for p in range(len(desk.image)):
        highest = max(highest, desk.image[p])
    cut = max(settings[GAMMA_FINAL], settings[FRACTION] * highest)
    if not highest > cut:
        return 0
    count, above = flood(desk.image, t.neighbours, cut / 2, settings[DIP], desk.keys, desk.parent, desk.labels)
    count = min(count, len(desk.found))
    _sum_regions(desk.image, t, desk, above, count, 0.5)
    found = 0
    for r in range(count):
        mass, peak = desk.regions[r, 0], desk.regions[r, 4]
        if peak <= cut:
            continue
        desk.found[found, 0], desk.found[found, 1] = desk.regions[r, 1] / mass, desk.regions[r, 2] / mass
        desk.found[found, 2], desk.found[found, 3], desk.found[found, 4] = desk.regions[r, 3], mass, peak
        desk.found[found, 5] = settings[NOISE] * _deviation(t, desk, int(desk.regions[r, 5]), weight2)
        found += 1
    return found


@njit(cache=True, nogil=True, fastmath=True)
def _deviation(t: Tables, desk: Desk, pixel: int, weight2: float) -> float:
    """What white noise of one volt makes of a pixel: |H N^-1 b|, N = H^T H + w^2 the normal matrix and b the pixel's modes."""
    n_meas, n_modes = desk.rows.shape
    u, inverse, own = desk.u, desk.inverse, desk.pixel
    for k in range(n_modes):
        own[k] = t.modes[k, pixel]
        u[k] = inverse[k] * own[k]
    for m in range(n_meas):
        row = desk.rows[m]
        total = 0.0
        for k in range(n_modes):
            total += row[k] * u[k]
        desk.solved[m] = total
    _back(desk.system, desk.solved)
    for m in range(n_meas):
        row, y = desk.rows[m], desk.solved[m]
        for k in range(n_modes):
            u[k] -= inverse[k] * row[k] * y
    seen = 0.0
    for k in range(n_modes):
        seen += own[k] * u[k] - weight2 * u[k] ** 2
    return float(np.sqrt(max(seen, 0.0)))
