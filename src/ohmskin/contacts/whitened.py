"""Rows of data in units of their noise: what changes of two-terminal resistances do to the voltages of scans.

A voltage is a sum of four two-terminal resistances, so that rows are applied without ever being written out: a product
costs a tenth of one with the matrix of 120 by 120 numbers that sums up the same data. Rows are six arrays:

    columns (n_rows, 5): numbers of the two-terminal resistances F_ad, F_bc, F_ac, F_bd, F_ab; n_pairs: none;
        without a sign, as indices without one are read most quickly
    sizes (n_rows,): what a change of the first two does to the datum, and minus that of the next two (1/ohm)
    loading (n_rows,): minus that of the last (1/ohm); or (0,) if there is none
    quiet (n_rows,): what a common relative change of all resistances does (1)
    starts (n_inj + 1,): the first row of each injection, and the number of rows
    weights (n_inj,): information lost for an error of each current, which looks like the quiet data
"""

from typing import Any

import numpy as np
from numba import njit

from ohmskin.arrays import Bools, Floats, Ints, Singles

Rows = tuple[Any, Floats, Floats, Floats, Ints, Floats]
Quadratic = tuple[Rows, Floats, Floats, float]  # rows, downdates, vector and constant of a `QuadraticMisfit`
Reduced = tuple[Floats, Floats, float]  # the same without the rows
Scan = tuple[Ints, Ints, Bools, Floats, Floats, Floats, Floats, Ints, int, bool]  # see `whiten`
ErrorTerms = tuple[float, float, float, Floats]  # noise, gain, model and contacts of `Errors`, the last (n_pairs, k)

_ENDS = np.array([[0, 3], [1, 2], [0, 2], [1, 3], [0, 1]])  # F_ad, F_bc, F_ac, F_bd; F_ab as far as it takes current


def scaled_rows(rows: Rows, share: float) -> Rows:
    """The same with all errors larger: this share of the information remains."""
    columns, sizes, loading, quiet, starts, weights = rows
    root = np.sqrt(share)
    return columns, root * sizes, root * loading, root * quiet, starts, weights / share


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def dot(one: Floats, other: Floats) -> float:
    """The product of two vectors, as far as both go."""
    total = 0.0
    for k in range(min(len(one), len(other))):
        total += one[k] * other[k]
    return total


@njit(cache=True, nogil=True)
def add(share: float, one: Floats, out: Floats) -> None:
    """Adds a share of a vector (n,) to another, `out`."""
    for k in range(len(out)):
        out[k] += share * one[k]


@njit(cache=True, nogil=True)
def copy(one: Floats, out: Floats) -> None:
    """Copies a vector (n,) into another, `out`."""
    for k in range(len(out)):
        out[k] = one[k]


@njit(cache=True, nogil=True)
def whiten(
    four: Ints, which: Ints, driven: Bools, amperes: Floats, volts: Floats, quiet: Floats, loading: Floats,
    numbers: Ints, injections: int, loaded: bool, noise: float, model: float,
) -> tuple[Rows, Floats]:  # fmt: skip
    """The finite data of scans as rows, errors of currents not counted, and the data themselves (n_rows,).

    Data of driven electrodes count as much less as their larger changes are modelled worse, by a share `model` of them.
    """
    counts, squares = np.zeros(2, np.int64), np.zeros(2)
    for row in range(len(four)):
        if np.isfinite(volts[row]) and np.isfinite(amperes[row]):
            counts[int(driven[row])] += 1
            squares[int(driven[row])] += volts[row] ** 2
    count, share = counts[0] + counts[1], 1.0
    if counts[0] > 0 and counts[1] > 0:
        usual, theirs = squares[0] / counts[0], squares[1] / counts[1]
        share = min(1.0, np.sqrt((noise**2 + model**2 * usual) / (noise**2 + model**2 * theirs)))
    columns, sizes, load = np.empty((count, 5), np.uint64), np.empty(count), np.empty(count if loaded else 0)
    rest, data, starts = np.empty(count), np.empty(count), np.zeros(injections + 1, np.int64)
    at = 0
    for row in range(len(four)):
        if np.isfinite(volts[row]) and np.isfinite(amperes[row]):
            scale = (share if driven[row] else 1.0) / noise
            for term in range(5):
                columns[at, term] = numbers[four[row, _ENDS[term, 0]], four[row, _ENDS[term, 1]]]
            sizes[at] = 0.5 * scale * amperes[row]
            if loaded:
                load[at] = scale * amperes[row] * loading[row]
            rest[at] = scale * quiet[row] if np.isfinite(quiet[row]) else 0.0
            data[at] = scale * volts[row]
            at += 1
            starts[which[row] + 1] = at
    for k in range(injections):
        starts[k + 1] = max(starts[k], starts[k + 1])
    return (columns, sizes, load, rest, starts, np.zeros(injections)), data


@njit(cache=True, nogil=True)
def apply(rows: Rows, change: Floats, pairs: int, out: Floats) -> None:
    """What a change (n_pairs,) of two-terminal resistances does to data (n_rows,), or with (n_pairs + 1,) the common
    change of all of them last."""
    columns, sizes, loading, quiet, _, _ = rows
    own = np.zeros(pairs + 1)
    for p in range(pairs):
        own[p] = change[p]
    for m in range(len(columns)):
        out[m] = sizes[m] * (own[columns[m, 0]] + own[columns[m, 1]] - own[columns[m, 2]] - own[columns[m, 3]])
    for m in range(len(loading)):
        out[m] -= loading[m] * own[columns[m, 4]]
    if len(change) > pairs:
        for m in range(len(columns)):
            out[m] += quiet[m] * change[pairs]


@njit(cache=True, nogil=True)
def apply_transposed(rows: Rows, data: Floats, pairs: int, out: Floats) -> None:
    """Adds to `out` (n_pairs + 1,) the products of data (n_rows,) with what each resistance, and last the common change
    of all of them, does to them."""
    columns, sizes, loading, quiet, _, _ = rows
    own = np.zeros(pairs + 1)
    for m in range(len(columns)):
        value = sizes[m] * data[m]
        own[columns[m, 0]] += value
        own[columns[m, 1]] += value
        own[columns[m, 2]] -= value
        own[columns[m, 3]] -= value
        out[pairs] += quiet[m] * data[m]
    for m in range(len(loading)):
        own[columns[m, 4]] -= loading[m] * data[m]
    for p in range(pairs):
        out[p] += own[p]


@njit(cache=True, nogil=True)
def reference_products(rows: Rows, data: Floats, out: Floats) -> None:
    """The products (n_inj,) of the data (n_rows,) of each injection with its quiet data."""
    quiet, starts = rows[3], rows[4]
    for k in range(len(starts) - 1):
        out[k] = 0.0
        for m in range(starts[k], starts[k + 1]):
            out[k] += quiet[m] * data[m]


@njit(cache=True, nogil=True, fastmath={"contract"})
def powers(rows: Rows, changes: Singles) -> Singles:
    """Squared sizes in the data of changes, beside errors of currents, the changes (n_pairs + 1, n) in columns, the
    last row zero."""
    columns, sizes, loading, quiet, starts, weights = rows
    n = changes.shape[1]
    value, inner, total = np.empty(n, np.float32), np.empty(n, np.float32), np.zeros(n, np.float32)
    for k in range(len(weights)):
        inner[:] = 0.0
        for m in range(starts[k], starts[k + 1]):  # loops that write one array each, or they are not vectorised
            one, two = changes[columns[m, 0]], changes[columns[m, 1]]
            three, four = changes[columns[m, 2]], changes[columns[m, 3]]
            size, at_rest = np.float32(sizes[m]), np.float32(quiet[m])
            for p in range(n):
                value[p] = size * (one[p] + two[p] - three[p] - four[p])
            if len(loading):
                load, own = np.float32(loading[m]), changes[columns[m, 4]]
                for p in range(n):
                    value[p] -= load * own[p]
            for p in range(n):
                total[p] += value[p] * value[p]
            for p in range(n):
                inner[p] += at_rest * value[p]
        weight = np.float32(weights[k])
        for p in range(n):
            total[p] -= weight * inner[p] * inner[p]
    return total


@njit(cache=True, nogil=True)
def gram(rows: Rows, pairs: int) -> Floats:
    """Products (n_pairs + 1, n_pairs + 1) of the columns of data beside errors of currents, the common change last."""
    columns, sizes, loading, quiet, starts, weights = rows
    whole, inner = np.zeros((pairs + 2, pairs + 2)), np.zeros(pairs + 2)  # that before the last is of no pair
    at, value = np.empty(6, np.int64), np.zeros(6)
    for k in range(len(weights)):
        inner[:] = 0.0
        for m in range(starts[k], starts[k + 1]):
            for t in range(6):
                at[t] = columns[m, t] if t < 5 else pairs + 1
                value[t] = sizes[m] * (1.0 if t < 2 else -1.0)
            value[4], value[5] = -loading[m] if len(loading) else 0.0, quiet[m]
            for t in range(6):
                inner[at[t]] += quiet[m] * value[t]
                for u in range(6):
                    whole[at[t], at[u]] += value[t] * value[u]
        for p in range(pairs + 2):
            if inner[p] != 0.0:
                add(-weights[k] * inner[p], inner, whole[p])
    out = np.empty((pairs + 1, pairs + 1))
    for p in range(pairs + 1):
        row = whole[p if p < pairs else pairs + 1]
        for q in range(pairs + 1):
            out[p, q] = row[q if q < pairs else pairs + 1]
    return out


@njit(cache=True, nogil=True)
def without_drift(scan: Scan, drift: Floats, common: float) -> Floats:
    """The voltages (n_meas,) of a scan less those of changes (n_pairs,) of two-terminal resistances (ohm), and of a
    `common` relative change of all of them (1)."""
    four, _, _, amperes, volts, quiet, loading, numbers, _, _ = scan
    own, out, pairs = np.zeros(5), np.empty(len(volts)), len(drift)
    for row in range(len(four)):
        for term in range(5):
            number = numbers[four[row, _ENDS[term, 0]], four[row, _ENDS[term, 1]]]
            own[term] = drift[number] if number < pairs else 0.0
        change = 0.5 * (own[0] + own[1] - own[2] - own[3]) - loading[row] * own[4]
        at_rest = quiet[row] if np.isfinite(quiet[row]) else 0.0
        out[row] = volts[row] - amperes[row] * change - common * at_rest
    return out


@njit(cache=True, nogil=True)
def likelihood(
    scan: Scan, errors: ErrorTerms, drift: Floats, common: float
) -> tuple[Floats, Quadratic, Quadratic, Quadratic, int]:
    """Voltages (n_meas,) of scans less known changes, see `without_drift`; their squared misfits, as
    `marginalise_errors` returns them; and how many of their data are finite."""
    noise, gain, model, contacts = errors
    four, which, driven, amperes, _, quiet, loading, numbers, injections, loaded = scan
    volts = without_drift(scan, drift, common)
    rows, data = whiten(
        four, which, driven, amperes, volts, quiet, loading, numbers, injections, loaded, noise, model
    )  # fmt: skip
    nominal, inflated, white = marginalise_errors(rows, data, contacts, gain, model)
    return volts, nominal, inflated, white, len(data)


@njit(cache=True, nogil=True)
def marginalise_errors(
    rows: Rows, data: Floats, contacts: Floats, gain: float, model: float
) -> tuple[Quadratic, Quadratic, Quadratic]:
    """Squared misfits of data (n_rows,) marginalised over errors of currents and contact impedances.

    Args:
        rows: Theirs, for noise of variance 1.
        data: In the same units.
        contacts: (n_pairs, k) changes of two-terminal resistances of one standard deviation of further errors.
        gain: Standard deviation of the relative error of a current (1).
        model: How far the model errs, as a share of the root mean square of the data (1).

    Returns:
        With nominal noise; with noise inflated by the model's error; and with white noise alone.
    """
    columns, sizes, loading, quiet, starts, _ = rows
    pairs, k, injections = len(contacts), contacts.shape[1], len(starts) - 1
    changes = np.zeros((pairs + 1, k))  # the last of no pair
    for p in range(pairs):
        copy(contacts[p], changes[p])
    # each further error, and last the data: in the gradient, beside quiet data, and with each other
    error, seen = np.empty(k + 1), np.zeros((pairs + 2, k + 1))
    inner, own, along = np.zeros((injections, k + 1)), np.zeros((k + 1, k + 1)), np.zeros((injections, pairs + 2))
    squares = np.zeros(injections)
    for j in range(injections):
        for m in range(starts[j], starts[j + 1]):
            a, b, c, d, e = columns[m, 0], columns[m, 1], columns[m, 2], columns[m, 3], columns[m, 4]
            size, at_rest, load = sizes[m], quiet[m], loading[m] if len(loading) else 0.0
            for i in range(k):
                error[i] = size * (changes[a, i] + changes[b, i] - changes[c, i] - changes[d, i]) - load * changes[e, i]
            error[k] = data[m]
            for i in range(k + 1):  # each element by itself: slices of so few take longer than what is done to them
                value = size * error[i]
                seen[a, i] += value
                seen[b, i] += value
                seen[c, i] -= value
                seen[d, i] -= value
                seen[e, i] -= load * error[i]
                seen[pairs + 1, i] += at_rest * error[i]
                inner[j, i] += at_rest * error[i]
            for i in range(k + 1):
                for h in range(i + 1):
                    own[i, h] += error[i] * error[h]
            along[j, a] += size * at_rest
            along[j, b] += size * at_rest
            along[j, c] -= size * at_rest
            along[j, d] -= size * at_rest
            along[j, e] -= load * at_rest
            along[j, pairs + 1] += at_rest**2
            squares[j] += at_rest**2
    gradients, at_rests = np.empty((k + 1, pairs + 1)), np.empty((injections, pairs + 1))
    for p in range(pairs + 1):
        row = p if p < pairs else pairs + 1
        for i in range(k + 1):
            gradients[i, p] = seen[row, i]
        for j in range(injections):
            at_rests[j, p] = along[j, row]
    white = rows, np.zeros((0, pairs + 1)), gradients[k].copy(), float(own[k, k])
    larger = 1 + model**2 * float(own[k, k]) / max(len(data), 1)
    return (
        _marginalised(rows, gradients, inner, own, at_rests, squares, gain, 1.0),
        _marginalised(rows, gradients, inner, own, at_rests, squares, gain, larger),
        white,
    )


@njit(cache=True, nogil=True)
def _marginalised(
    rows: Rows, seen: Floats, inner: Floats, own: Floats, quiet: Floats, squares: Floats, gain: float, variance: float
) -> Quadratic:
    """The squared misfit of the data, the last of errors, marginalised over the others and errors of currents, with
    noise of that variance."""
    k, share, weights = len(seen) - 1, 1 / variance, np.zeros(len(squares))
    seen, own = share * seen, share * own
    for j in range(len(squares) if gain > 0 else 0):
        weights[j] = gain**2 / (1 + gain**2 * share * squares[j])
        for i in range(k + 1):
            less = -weights[j] * share * inner[j, i]
            add(share * less, quiet[j], seen[i])
            for h in range(i + 1):
                own[i, h] += less * share * inner[j, h]
    trace = 1.0
    for i in range(k):
        trace += 1e-13 * own[i, i]
    for i in range(k + 1):  # Cholesky, rows as it goes on; the last is of the data
        for j in range(i + (i < k)):
            total = own[i, j] + (trace if i == j else 0.0)
            for h in range(j):
                total -= own[i, h] * own[j, h]
            own[i, j] = np.sqrt(total) if i == j else total / own[j, j]
        for j in range(i):
            add(-own[i, j], seen[j], seen[i])
        for p in range(seen.shape[1] if i < k else 0):
            seen[i, p] /= own[i, i]
    constant, root = own[k, k], np.sqrt(share)
    for j in range(k):
        constant -= own[k, j] ** 2
    scaled = (rows[0], root * rows[1], root * rows[2], root * rows[3], rows[4], weights)
    return scaled, seen[:k].copy(), seen[k].copy(), float(constant)
