"""The compiled steps of a cycle; `Sensor.measure` and the centroid reader are their plain twin.

They run without Python's global lock and touch no memory but their tables and space. Measurements and modes are
padded with zeros to whole tiles, see `ohmskin.forward.tiles`; what is padded is flat, see `padded` there.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints, Shorts, Singles
from ohmskin.forward.tiles import padded, solve_front, tile
from ohmskin.sensing.primitives import add_row, choose, closest, combine, factorise, flood, largest, project

NOISE, AMPLITUDE, MODEL_ERROR, GAMMA_BASE, GAMMA_FINAL, FRACTION, DIP, FUSE, TRACE = range(9)


class Tables(NamedTuple):
    """What stays the same: see `CompiledCycle` for the turned modes.

    Args:
        base_columns: H_0 V (rank, n_base) in volts.
        base_squares: s^2 (rank,).
        base_injections: (n_base,) injection of each measurement.
        base_currents: (n_inj,) usual currents (A).
        base_reference, reference: (n_base,), (n_complete,) untouched transfer resistances (ohm).
        mixing: C V (n_pairs, n_modes) in ohms.
        modes: V^T B (n_modes, n_cells).
        terms: (n_complete, 4) numbers of the two-terminal resistances behind all that can be asked for, injection by
            injection.
        pairs: (n, 2) electrodes of the injections to choose from.
        reach: How far their middles may be from a contact (m).
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
    terms: Shorts
    reference: Floats
    pairs: Ints
    reach: float
    electrodes: Floats
    neighbours: Shorts
    centroids: Floats
    measures: Floats


class Workspace(NamedTuple):
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
        crossed: (most, n) summed areas of eq. (7) (m2).
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
def base_step(t: Tables, space: Workspace, settings: Floats, volts: Floats, currents: Floats) -> int:
    """The base image, its regions and the pairs to drive (`space.chosen`); -1 if a datum is not finite."""
    squares = 0.0
    for m in range(len(space.base_volts)):
        usual, current = t.base_currents[t.base_injections[m]], currents[t.base_injections[m]]
        space.base_volts[m] = (volts[m] - current * t.base_reference[m]) * (usual / current)
        squares += space.base_volts[m] ** 2
    if not np.isfinite(squares):
        return -1
    project(t.base_columns, space.base_volts, space.projected)
    weight2 = _weight2(settings, squares, len(space.base_volts))
    rank = len(space.projected)
    for k in range(rank):
        space.u_single[k] = space.projected[k] / (t.base_squares[k] + weight2)
    combine(space.u_single[:rank], t.modes[:rank], space.base_image)
    highest = largest(space.base_image)
    threshold = max(settings[GAMMA_BASE], settings[FRACTION] * highest)
    count, above = flood(
        space.base_image, t.neighbours, threshold, settings[DIP], space.keys, space.parent, space.labels
    )
    count = min(count, len(space.anchors))
    if count > 0:
        _sum_regions(space.base_image, t, space, above, count, -np.inf)
        for r in range(count):
            mass = space.regions[r, 0]
            closest(t.centroids, space.regions[r, 1] / mass, space.regions[r, 2] / mass, space.anchors[r])
    else:
        peak = 0
        while space.base_image[peak] < highest:
            peak += 1
        closest(t.centroids, t.centroids[peak, 0], t.centroids[peak, 1], space.anchors[0])
        count = 1
    choose(t.electrodes, t.pairs, t.reach, space.anchors[:count], space.crossed, space.chosen)
    return count


@njit(cache=True, nogil=True)
def second_step(t: Tables, space: Workspace, settings: Floats, volts: Floats, currents: Floats) -> int:
    """The final image and its contacts (`space.found`); how many, or -1 if a datum is not finite."""
    n_modes, rank = len(space.u_single), len(space.projected)
    per_pair = len(volts) // len(currents)
    fuse = settings[FUSE] != 0.0
    squares = 0.0
    for m in range(len(volts)):
        c = m // per_pair
        space.residual[m] = volts[m] - currents[c] * t.reference[space.chosen[c] * per_pair + m % per_pair]
        squares += space.residual[m] ** 2
    if not np.isfinite(squares):
        return -1
    count = len(volts)
    if fuse:
        for m in range(len(space.base_volts)):
            squares += space.base_volts[m] ** 2
        count += len(space.base_volts)
    weight2 = _weight2(settings, squares, count)
    for k in range(n_modes):
        known = fuse and k < rank
        space.root[k] = 1.0 / np.sqrt((t.base_squares[k] if known else 0.0) + weight2)
        space.z[k] = space.projected[k] * space.root[k] if known else 0.0
    step = padded(space.sizes[1])
    for m in range(len(volts)):
        c = m // per_pair
        terms = t.terms[space.chosen[c] * per_pair + m % per_pair]
        row = space.scaled[m * step : (m + 1) * step]
        space.residual[m] -= _row(terms, t.mixing, currents[c], space.root, space.z, row)
    _update(space)
    for k in range(n_modes):
        space.u_single[k] = space.root[k] * space.z[k]
    combine(space.u_single, t.modes, space.image)
    return _contacts(t, space, settings)


@njit(cache=True, nogil=True)
def _weight2(settings: Floats, squares: float, count: int) -> float:
    noise2 = settings[NOISE] ** 2 + settings[MODEL_ERROR] ** 2 * squares / count
    return float(max(noise2 / settings[AMPLITUDE] ** 2, 1e-14 * settings[TRACE]))


@njit(cache=True, nogil=True, fastmath=True)
def _row(terms: Shorts, mixing: Floats, current: float, root: Floats, z: Floats, scaled: Floats) -> float:
    """Fill what one measurement sees of each mode, times its root (V); what it sees of D^1/2 z."""
    # no measurement of the complete pattern touches a driven electrode, so that all four pairs exist
    ad, bc, ac, bd = mixing[terms[0]], mixing[terms[1]], mixing[terms[2]], mixing[terms[3]]
    half, total = 0.5 * current, 0.0
    for k in range(mixing.shape[1]):
        scaled[k] = half * root[k] * (ad[k] + bc[k] - ac[k] - bd[k])
        total += scaled[k] * z[k]
    return total


@njit(cache=True, nogil=True)
def _update(space: Workspace) -> None:
    """z += S^T (I + S S^T)^-1 residual = (I + S^T S)^-1 S^T residual, by the smaller of the two systems."""
    n_meas, n_modes = space.sizes
    step, across = padded(n_modes), padded(n_meas)
    if len(space.turned) == 0:
        total = space.own[: len(space.z)]  # free until a contact is found
        total[:] = 0.0
        for m in range(len(space.residual)):
            add_row(space.residual[m], space.scaled, m * step, total)
        for k in range(len(total)):
            space.solved[8 * k] = total[k]
        factorise(space.scaled, n_meas, space.system, n_modes)
        solve_front(space.system, step, n_modes, space.solved)
        for k in range(len(total)):
            space.z[k] += space.solved[8 * k]
    else:
        for m in range(0, n_meas, 4):
            for k in range(n_modes):
                for r in range(m, m + 4):
                    space.turned[k * across + r] = space.scaled[r * step + k]
        for m in range(len(space.residual)):
            space.solved[8 * m] = space.residual[m]
        factorise(space.turned, n_modes, space.system, n_meas)
        solve_front(space.system, across, n_meas, space.solved)
        for m in range(len(space.residual)):
            add_row(space.solved[8 * m], space.scaled, m * step, space.z)


@njit(cache=True, nogil=True)
def _sum_regions(image: Singles, t: Tables, space: Workspace, above: int, count: int, share: float) -> None:
    """Of each region: mass, first moments, area, peak and its cell, over the cells above `share` of the peak."""
    regions = space.regions
    for r in range(count):
        regions[r, :] = 0.0
        regions[r, 4] = -np.inf
    for at in range(above - 1, -1, -1):  # from the highest: a region's first cell is its peak
        p = space.keys[at]
        r = space.labels[p]
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
def _contacts(t: Tables, space: Workspace, settings: Floats) -> int:
    """`ContactFinder.find`: place, extent, strength, peak and its deviation of each contact, strongest first."""
    highest = largest(space.image)
    cut = max(settings[GAMMA_FINAL], settings[FRACTION] * highest)
    if not highest > cut:
        return 0
    count, above = flood(space.image, t.neighbours, cut / 2, settings[DIP], space.keys, space.parent, space.labels)
    count = min(count, len(space.found))
    _sum_regions(space.image, t, space, above, count, 0.5)
    found = 0
    for r in range(count):
        mass, peak = space.regions[r, 0], space.regions[r, 4]
        if peak <= cut:
            continue
        space.found[found, 0], space.found[found, 1] = space.regions[r, 1] / mass, space.regions[r, 2] / mass
        space.found[found, 2], space.found[found, 3], space.found[found, 4] = space.regions[r, 3], mass, peak
        space.found[found, 5] = space.regions[r, 5]  # the peak's number, until its deviation takes the place
        found += 1
    for first in range(0, found, 8):
        _deviations(t, space, space.found[first : min(first + 8, found)], settings[NOISE], settings[FUSE] != 0.0)
    return found


@njit(cache=True, nogil=True, fastmath=True)
def _deviations(t: Tables, space: Workspace, found: Floats, noise: float, fuse: bool) -> None:
    """What white noise makes of up to eight peaks: noise |H N^-1 b|, N the normal matrix and b a peak's modes.

    With S = H D^1/2, q = D^1/2 b and y = (I + S S^T)^-1 S q, N^-1 b is D^1/2 r, r = q - S^T y = (I + S^T S)^-1 q, and
    the second scan sees y = S r of it.
    """
    n_meas, n_modes = space.sizes
    step, across = padded(n_modes), padded(n_meas)
    for f in range(len(found)):
        cell = int(found[f, 5])
        for k in range(len(space.root)):
            space.own[8 * k + f] = space.root[k] * t.modes[k, cell]
    if len(space.turned) == 0:
        solve_front(space.system, step, n_modes, space.own)
        for m in range(0, n_meas, 4):
            tile(space.seen, 8 * m, 8, False, space.scaled, m * step, 1, step, space.own, 0, 8, n_modes)
    else:
        for m in range(0, n_meas, 4):
            tile(space.seen, 8 * m, 8, False, space.turned, m, across, 1, space.own, 0, 8, n_modes)
        solve_front(space.system, across, n_meas, space.seen)
        if fuse:
            for k in range(0, n_modes, 4):
                tile(space.own, 8 * k, 8, True, space.scaled, k, step, 1, space.seen, 0, 8, n_meas)
    for f in range(len(found)):
        squares = 0.0
        for m in range(n_meas):
            squares += space.seen[8 * m + f] ** 2
        if fuse:
            for k in range(len(space.projected)):
                squares += t.base_squares[k] * (space.root[k] * space.own[8 * k + f]) ** 2
        found[f, 5] = noise * np.sqrt(squares)
