"""The compiled steps of a cycle; `ohmskin.cycle.reference` is their plain twin.

They run without Python's global lock and touch no memory but their tables and desk. Measurements and modes are
padded with zeros to whole tiles, see `ohmskin.forward.tiles`; what is padded is flat, see `padded` there.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ohmskin.forward.tiles import eliminate_front, padded, solve_front, tile
from ohmskin.geometry.domain import Floats
from ohmskin.geometry.mesh import Ints

Singles = NDArray[np.float32]
Shorts = NDArray[np.int32]

NOISE, AMPLITUDE, MODEL_ERROR, GAMMA_BASE, GAMMA_FINAL, FRACTION, DIP, FUSE, TRACE = range(9)


class Tables(NamedTuple):
    """What stays the same: see `FastCycle` for the turned modes.

    Args:
        base_columns: H_0 V (rank, n_base) in volts.
        base_squares: s^2 (rank,).
        base_injections: (n_base,) injection of each measurement.
        base_currents: (n_inj,) usual currents (A).
        base_reference, reference: (n_base,), (n_complete,) untouched transfer resistances (ohm).
        mixing: C V (n_pairs, n_modes) in ohms.
        modes: V^T B (n_modes, n_cells).
        quadruples: (n_complete, 4) of all that can be asked for, pair by pair.
        pairs: (n_pairs, 2) electrodes.
        electrodes: (n_elec, 2) in metres.
        neighbours: (n_cells, 3 or 4), -1 where there is none.
        centroids, measures: (n_cells, 2), (n_cells,) in m, m2.
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
    centroids: Floats
    measures: Floats


class Desk(NamedTuple):
    """Memory for one frame; nothing is allocated while frames come.

    Args:
        base_image, image: (n_cells,), the newest.
        base_volts: (n_base,) changes of voltage at the usual currents (V).
        projected: (rank,) V^T H_0^T v.
        u_single: (n_modes,) coordinates of an image.
        root: (n_modes,) D^1/2.
        z: (n_modes,) D^-1/2 u.
        scaled: S = H D^1/2 (n_meas, n_modes), flat.
        turned: S^T, flat; empty where there are fewer modes than measurements.
        system: I + S S^T, or I + S^T S if that is smaller; then eliminated.
        residual: (n_meas,) voltages that the base scan does not explain (V).
        solved: (n_meas or n_modes, 8) right-hand sides of the system, flat.
        own: (n_modes, 8) modes of eight peaks, flat.
        seen: (n_meas, 8) what the second scan sees of them, flat.
        sizes: n_meas, n_modes, in whole tiles.
        keys, parent, labels: (n_cells,) of `flood`.
        regions: (most, 6) mass, moments, area, peak and its cell of each region.
        anchors: (most, 3, 2) in metres.
        crossed: (most, n_pairs) summed areas of eq. (7) (m2).
        chosen: Pairs to drive.
        found: (most, 6) contacts.
    """

    base_image: Singles
    image: Singles
    base_volts: Floats
    projected: Floats
    u_single: Singles
    root: Floats
    z: Floats
    scaled: Floats
    turned: Floats
    system: Floats
    residual: Floats
    solved: Floats
    own: Floats
    seen: Floats
    sizes: Ints
    keys: Ints
    parent: Shorts
    labels: Shorts
    regions: Floats
    anchors: Floats
    crossed: Floats
    chosen: Ints
    found: Floats


@njit(cache=True, nogil=True, error_model="numpy")
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
    highest = largest(desk.base_image)
    threshold = max(settings[GAMMA_BASE], settings[FRACTION] * highest)
    count, above = flood(desk.base_image, t.neighbours, threshold, settings[DIP], desk.keys, desk.parent, desk.labels)
    count = min(count, len(desk.anchors))
    if count > 0:
        _sum_regions(desk.base_image, t, desk, above, count, -np.inf)
        for r in range(count):
            mass = desk.regions[r, 0]
            _closest(t.centroids, desk.regions[r, 1] / mass, desk.regions[r, 2] / mass, desk.anchors[r])
    else:
        peak = 0
        while desk.base_image[peak] < highest:
            peak += 1
        _closest(t.centroids, t.centroids[peak, 0], t.centroids[peak, 1], desk.anchors[0])
        count = 1
    choose(t.electrodes, t.pairs, desk.anchors[:count], desk.crossed, desk.chosen)
    return count


@njit(cache=True, nogil=True)
def see(t: Tables, desk: Desk, settings: Floats, volts: Floats, currents: Floats) -> int:
    """The final image and its contacts (`desk.found`); how many, or -1 if a datum is not finite."""
    n_modes, rank = len(desk.u_single), len(desk.projected)
    per_pair = len(volts) // len(currents)
    fuse = settings[FUSE] != 0.0
    squares = 0.0
    for m in range(len(volts)):
        c = m // per_pair
        desk.residual[m] = volts[m] - currents[c] * t.reference[desk.chosen[c] * per_pair + m % per_pair]
        squares += desk.residual[m] ** 2
    if not np.isfinite(squares):
        return -1
    count = len(volts)
    if fuse:
        for m in range(len(desk.base_volts)):
            squares += desk.base_volts[m] ** 2
        count += len(desk.base_volts)
    weight2 = _weight2(settings, squares, count)
    for k in range(n_modes):
        known = fuse and k < rank
        desk.root[k] = 1.0 / np.sqrt((t.base_squares[k] if known else 0.0) + weight2)
        desk.z[k] = desk.projected[k] * desk.root[k] if known else 0.0
    step = padded(desk.sizes[1])
    for m in range(len(volts)):
        c = m // per_pair
        quadruple = t.quadruples[desk.chosen[c] * per_pair + m % per_pair]
        row = desk.scaled[m * step : (m + 1) * step]
        desk.residual[m] -= _row(quadruple, t.mixing, len(t.electrodes), currents[c], desk.root, desk.z, row)
    _update(desk)
    for k in range(n_modes):
        desk.u_single[k] = desk.root[k] * desk.z[k]
    combine(desk.u_single, t.modes, desk.image)
    return _contacts(t, desk, settings)


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
def _row(quadruple: Shorts, mixing: Floats, n_elec: int, current: float, root: Floats, z: Floats, scaled: Floats) -> float:
    """Fill what one measurement sees of each mode, times its root (V); what it sees of D^1/2 z."""
    a, b, c, d = quadruple[0], quadruple[1], quadruple[2], quadruple[3]
    # no measurement of the complete pattern touches a driven electrode, so that all four pairs exist
    ad, bc = mixing[_pair(a, d, n_elec)], mixing[_pair(b, c, n_elec)]
    ac, bd = mixing[_pair(a, c, n_elec)], mixing[_pair(b, d, n_elec)]
    half, total = 0.5 * current, 0.0
    for k in range(mixing.shape[1]):
        scaled[k] = half * root[k] * (ad[k] + bc[k] - ac[k] - bd[k])
        total += scaled[k] * z[k]
    return total


@njit(cache=True, nogil=True)
def _pair(i: int, j: int, n_elec: int) -> int:
    low, high = int(min(i, j)), int(max(i, j))
    return low * n_elec - low * (low + 1) // 2 + high - low - 1


@njit(cache=True, nogil=True)
def _update(desk: Desk) -> None:
    """z += S^T (I + S S^T)^-1 residual = (I + S^T S)^-1 S^T residual, by the smaller of the two systems."""
    n_meas, n_modes = desk.sizes
    step, across = padded(n_modes), padded(n_meas)
    if len(desk.turned) == 0:
        total = desk.own[: len(desk.z)]  # free until a contact is found
        total[:] = 0.0
        for m in range(len(desk.residual)):
            add_row(desk.residual[m], desk.scaled, m * step, total)
        for k in range(len(total)):
            desk.solved[8 * k] = total[k]
        factorise(desk.scaled, n_meas, desk.system, n_modes)
        solve_front(desk.system, step, n_modes, desk.solved)
        for k in range(len(total)):
            desk.z[k] += desk.solved[8 * k]
    else:
        for m in range(0, n_meas, 4):
            for k in range(n_modes):
                for r in range(m, m + 4):
                    desk.turned[k * across + r] = desk.scaled[r * step + k]
        for m in range(len(desk.residual)):
            desk.solved[8 * m] = desk.residual[m]
        factorise(desk.turned, n_modes, desk.system, n_meas)
        solve_front(desk.system, across, n_meas, desk.solved)
        for m in range(len(desk.residual)):
            add_row(desk.solved[8 * m], desk.scaled, m * step, desk.z)


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
    """`ohmskin.touch.label_peaks` without new memory: `labels` of the cells above a threshold, which must not be negative.

    Returns:
        How many regions there are, and how many cells are above; these are left in `keys`, see `_cell`, the highest last.
    """
    above = 0
    bits = image.view(np.int32)
    labels[:] = -1
    parent[:] = -1
    for p in range(len(image)):
        if image[p] > threshold:
            # of positive floats the bits sort as the values do; of equal ones the lower number is the higher key
            keys[above] = (np.int64(bits[p]) << 32) | np.int64(len(image) - p)
            above += 1
    keys[:above].sort()
    for at in range(above - 1, -1, -1):
        e = _cell(keys[at], len(image))
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
        e = _cell(keys[at], len(image))
        root = e
        while parent[root] != root:
            root = parent[root]
        if labels[root] < 0:
            labels[root] = count
            count += 1
        labels[e] = labels[root]
    return count, above


@njit(cache=True, nogil=True)
def _cell(key: int, n_cells: int) -> int:
    return n_cells - (key & 0xFFFFFFFF)


@njit(cache=True, nogil=True)
def _sum_regions(image: Singles, t: Tables, desk: Desk, above: int, count: int, share: float) -> None:
    """Of each region: mass, first moments, area, peak and its cell, over the cells above `share` of the peak."""
    regions = desk.regions
    for r in range(count):
        regions[r, :] = 0.0
        regions[r, 4] = -np.inf
    for at in range(above - 1, -1, -1):  # from the highest: a region's first cell is its peak
        p = _cell(desk.keys[at], len(image))
        r = desk.labels[p]
        if r >= count:
            continue
        if regions[r, 4] == -np.inf:
            regions[r, 4], regions[r, 5] = image[p], p
        if image[p] > share * regions[r, 4]:
            mass = image[p] * t.measures[p]
            regions[r, 0] += mass
            regions[r, 1] += mass * t.centroids[p, 0]
            regions[r, 2] += mass * t.centroids[p, 1]
            regions[r, 3] += t.measures[p]


@njit(cache=True, nogil=True)
def _closest(centroids: Floats, x: float, y: float, anchors: Floats) -> None:
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
    anchors[0], anchors[1], anchors[2] = centroids[p0], centroids[p1], centroids[p2]


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
def _contacts(t: Tables, desk: Desk, settings: Floats) -> int:
    """`ContactFinder.find`: place, extent, strength, peak and its standard deviation of each contact, strongest first."""
    highest = largest(desk.image)
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
        desk.found[found, 5] = desk.regions[r, 5]  # the peak's number, until its deviation takes the place
        found += 1
    for first in range(0, found, 8):
        _deviations(t, desk, desk.found[first : min(first + 8, found)], settings[NOISE], settings[FUSE] != 0.0)
    return found


@njit(cache=True, nogil=True, fastmath=True)
def _deviations(t: Tables, desk: Desk, found: Floats, noise: float, fuse: bool) -> None:
    """What white noise makes of up to eight peaks: noise |H N^-1 b|, N the normal matrix and b a peak's modes.

    With S = H D^1/2, q = D^1/2 b and y = (I + S S^T)^-1 S q, N^-1 b is D^1/2 r, r = q - S^T y = (I + S^T S)^-1 q, and the second
    scan sees y = S r of it.
    """
    n_meas, n_modes = desk.sizes
    step, across = padded(n_modes), padded(n_meas)
    for f in range(len(found)):
        cell = int(found[f, 5])
        for k in range(len(desk.root)):
            desk.own[8 * k + f] = desk.root[k] * t.modes[k, cell]
    if len(desk.turned) == 0:
        solve_front(desk.system, step, n_modes, desk.own)
        for m in range(0, n_meas, 4):
            tile(desk.seen, 8 * m, 8, False, desk.scaled, m * step, 1, step, desk.own, 0, 8, n_modes)
    else:
        for m in range(0, n_meas, 4):
            tile(desk.seen, 8 * m, 8, False, desk.turned, m, across, 1, desk.own, 0, 8, n_modes)
        solve_front(desk.system, across, n_meas, desk.seen)
        if fuse:
            for k in range(0, n_modes, 4):
                tile(desk.own, 8 * k, 8, True, desk.scaled, k, step, 1, desk.seen, 0, 8, n_meas)
    for f in range(len(found)):
        squares = 0.0
        for m in range(n_meas):
            squares += desk.seen[8 * m + f] ** 2
        if fuse:
            for k in range(len(desk.projected)):
                squares += t.base_squares[k] * (desk.root[k] * desk.own[8 * k + f]) ** 2
        found[f, 5] = noise * np.sqrt(squares)
