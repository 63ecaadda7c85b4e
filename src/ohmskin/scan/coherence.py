"""Whether scans can be those of a resistive network at all, in a fraction of a millisecond; no model of the sheet.

All voltages of a scan are combinations of the two-terminal resistances of its electrode pairs (see
`ohmskin.scan.network`), and there are more voltages than these combinations span. What changes against the quiet skin
leave after the best such network is noise: chi-square with as many degrees of freedom as are left. A wire that comes
off, hum, an offset or a spike contradict every network; a touch never does, however large or strange it is.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import sqrt

import numpy as np
from numba import njit

from ohmskin.arrays import Bools, Floats, Ints
from ohmskin.scan.baseline import Difference, terms_of
from ohmskin.scan.pairs import SIGNS, Pairs, n_pairs
from ohmskin.scan.pattern import DrivePattern, joined

_SINGULAR = 1e-9  # share of its own information that is left of a resistance beside the others, below which it has none


@dataclass(frozen=True)
class InstrumentErrors:
    """Errors of an instrument.

    Args:
        noise: Standard deviation of a change of voltage (V).
        gain: Of the relative error of a measured current, the same in all voltages of an injection (1).
        model: How far it is from an ideal one, as a share of the root mean square of the changes (1).
    """

    noise: float
    gain: float = 0.0
    model: float = 0.0


@dataclass(frozen=True, eq=False)
class Coherence:
    """How well data agree with one network.

    Args:
        squares: Squared misfit over the variance of the data's errors.
        freedom: Its degrees of freedom.
        residuals: (n_meas,) misfit of each voltage over its standard deviation; 0 where it is not used.
        added: (n_added,) what else adds to the voltages (V).
        expected: Standard deviation of a voltage by noise and instrument (V).
    """

    squares: float
    freedom: int
    residuals: Floats
    added: Floats
    expected: float

    @property
    def excess(self) -> float:
        """Variance of the misfit over what is expected (1); 1 where nothing is measured twice."""
        return self.squares / self.freedom if self.freedom > 0 else 1.0

    @property
    def noise(self) -> float:
        """Standard deviation of a voltage about the network (V)."""
        return self.expected * sqrt(self.excess)


class NetworkData:
    """Changes of one scan or several, to be held against one network.

    Args:
        scans: The changes against the quiet skin.
        n_elec: Number of electrodes.
        instrument: How they err.

    Attributes:
        quadruples: (n_meas, 4) source, sink, plus and minus of all of them.
        injection: (n_meas,) number of the injection behind each.
        scan: (n_meas,) number of its scan.
        known: (n_meas,) which of them are finite.
    """

    def __init__(self, scans: Sequence[Difference], n_elec: int, instrument: InstrumentErrors) -> None:
        patterns = tuple(scan.pattern for scan in scans)
        self._pattern = whole = joined(patterns)
        self.quadruples, self._driven, self._n_elec = whole.quadruples, whole.driven, n_elec
        self.injection = whole.injection_numbers
        self.scan: Ints = np.repeat(np.arange(len(scans)), [pattern.n_meas for pattern in patterns])
        self._columns, signs, self._count = _resistances(whole, n_elec)
        self._volts, currents = (np.concatenate([getattr(scan, name) for scan in scans]) for name in _GIVEN)
        self._quiet, loading = (_together(scans, name) for name in ("reference", "source_loading"))
        self.known: Bools = np.isfinite(self._volts) & np.isfinite(currents)
        self._entries = signs * currents[:, None]
        if loading.any():
            self._entries[:, 4] = -loading * currents
        self._instrument = instrument

    @property
    def quadruple_numbers(self) -> Ints:
        """(n_meas,) a number of each quadruple, different ones for different quadruples."""
        return np.asarray(np.ravel_multi_index(tuple(self.quadruples.T), [self._n_elec] * 4))

    def power(self, kept: Bools) -> float:
        """Mean square (V2) of the changes of idle electrodes' voltages, of those of `kept` (n_meas,) that are known."""
        volts = self._volts[kept & self.known & ~self._driven]
        return float(volts @ volts) / max(len(volts), 1)

    def largest(self, kept: Bools) -> float:
        """The largest change (V) of those of `kept` (n_meas,) that are known."""
        return float(np.abs(self._volts[kept & self.known]).max(initial=0.0))

    def without(self, electrodes: Iterable[int]) -> Bools:
        """Which measurements (n_meas,) involve none of these electrodes."""
        return ~self._pattern.uses(list(electrodes))

    def uses(self, electrode: int) -> Bools:
        """Whether each measurement (n_meas,) involves an electrode, driven or measured."""
        return self._pattern.uses(electrode)

    def coherence(self, kept: Bools | None = None, added: Floats | None = None) -> Coherence:
        """How well they agree with one network.

        Args:
            kept: (n_meas,) which to use, of those known; all unless given.
            added: (n_added, n_meas) what else may add to the voltages, such as an offset, per volt of it.
        """
        scale, noise = self._scale(self.known if kept is None else self.known & kept)
        more = np.zeros((0, len(scale))) if added is None else added
        return Coherence(
            *_coherence(
                self._columns, self._entries, np.ascontiguousarray(more.T), self.injection, scale,
                self._volts, self._quiet, self._instrument.gain, self._count,
            ),
            noise,
        )  # fmt: skip

    def projection(self, kept: Bools) -> tuple[Floats, Floats]:
        """What is left (n_meas, n_meas) of each voltage beside all networks, in units of its noise, and of the data.

        Without a voltage the squared misfit falls by the square of what is left of the datum over what is left of it.
        """
        used = self.known & kept
        scale, _ = self._scale(used)
        gains, n = self.injection.max() + 1, self._count + 1  # the last column is of no pair
        rows, beside = np.arange(len(scale)), np.arange(gains)
        known = np.zeros((len(scale) + gains, n + gains))
        np.add.at(known, (rows[:, None], self._columns), scale[:, None] * np.where(used[:, None], self._entries, 0.0))
        known[rows, n + self.injection] = scale * self._instrument.gain * self._quiet
        known[len(scale) + beside, n + beside] = 1.0  # what is known of the currents beforehand
        values, vectors = np.linalg.eigh(known.T @ known)
        seen = values > _SINGULAR * values[-1]
        span = known[: len(scale)] @ (vectors[:, seen] / np.sqrt(values[seen]))
        projection = np.diag(used.astype(float)) - span @ span.T
        return projection, projection @ (scale * np.where(used, self._volts, 0.0))

    def _scale(self, used: Bools) -> tuple[Floats, float]:
        """One over the standard deviation of each voltage (n_meas,), 0 if not used; the latter of most (V)."""
        squares, counts = np.zeros(2), np.zeros(2)
        for k, own in enumerate((used & ~self._driven, used & self._driven)):
            squares[k], counts[k] = float((self._volts[own] ** 2).sum()), own.sum()
        one = self._instrument
        # driven electrodes have the larger changes, and err by a share of these
        variance = one.noise**2 + one.model**2 * squares / np.maximum(counts, 1)
        scale = np.where(used, np.where(self._driven, *(variance[::-1] ** -0.5)), 0.0)
        return scale, float(np.sqrt(variance[0]))


_GIVEN = ("volts", "currents")


@lru_cache(maxsize=256)
def _resistances(pattern: DrivePattern, n_elec: int) -> tuple[Ints, Floats, int]:
    """The numbers (n_meas, 5) of the two-terminal resistances behind each voltage, among those alone that the pattern
    tells of, the last its injection's own; their signs: 0 for the last one, and for the F_ii = 0 of a driven electrode;
    and how many they are."""
    columns, none = terms_of(pattern, Pairs.all(n_elec)).T, n_pairs(n_elec)
    told = np.zeros(none + 1, bool)
    told[columns] = True
    told[none] = True  # of no pair, the last one
    signs = np.append(SIGNS, 0.0) * (columns != none)
    return np.ascontiguousarray((np.cumsum(told) - 1)[columns]), signs, int(told.sum()) - 1


def _together(scans: Sequence[Difference], name: str) -> Floats:
    """Something that not all scans may have (n_meas,); zero where it is not known."""
    given = [getattr(scan, name) for scan in scans]
    one = np.concatenate([np.zeros(s.pattern.n_meas) if g is None else g for s, g in zip(scans, given, strict=True)])
    return np.where(np.isfinite(one), one, 0.0)


@njit(cache=True, nogil=True)
def _coherence(
    columns: Ints, entries: Floats, added: Floats, injection: Ints, scale: Floats, volts: Floats, quiet: Floats,
    gain: float, n_pairs: int,
) -> tuple[float, int, Floats, Floats]:  # fmt: skip
    """Squared misfit, degrees of freedom, residuals (n_meas,) and sizes of what is added; rows of scale 0 are left."""
    few, more = columns.shape[1], added.shape[1]
    n = n_pairs + 1 + more  # one column takes what is of no pair
    gram, beside, inner, count, last = np.zeros((n + 1, n + 1)), np.zeros(n + 1), 0.0, 0, -1  # the data last
    at, values = np.empty(few + more + 1, np.int64), np.empty(few + more + 1)
    for k in range(more + 1):
        at[few + k] = n_pairs + 1 + k
    for row in range(len(columns)):
        if scale[row] == 0:
            continue
        if injection[row] != last:
            _without(gram, beside, inner, gain)
            inner, last = 0.0, injection[row]
        count += 1
        for k in range(few):
            at[k], values[k] = columns[row, k], scale[row] * entries[row, k]
        for k in range(more):
            values[few + k] = scale[row] * added[row, k]
        values[few + more] = scale[row] * volts[row]
        own = scale[row] * quiet[row]
        inner += own * own
        for p in range(len(at)):
            beside[at[p]] += own * values[p]
            for q in range(len(at)):
                if at[p] <= at[q]:
                    gram[at[p], at[q]] += values[p] * values[q]
    _without(gram, beside, inner, gain)
    rank = _eliminated(gram)
    solution = np.zeros(n)
    for i in range(n - 1, -1, -1):
        if gram[i, i] > 0:
            solution[i] = gram[i, n]
            for j in range(i + 1, n):
                solution[i] -= gram[i, j] * solution[j]
            solution[i] /= gram[i, i]
    residuals = np.zeros(len(columns))
    for row in range(len(columns)):
        if scale[row] > 0:
            residuals[row] = scale[row] * volts[row]
            for k in range(few):
                residuals[row] -= scale[row] * entries[row, k] * solution[columns[row, k]]
            for k in range(more):
                residuals[row] -= scale[row] * added[row, k] * solution[n_pairs + 1 + k]
    return max(gram[n, n], 0.0), count - rank, residuals, solution[n_pairs + 1 :]


@njit(cache=True, nogil=True)
def _without(gram: Floats, reference: Floats, inner: float, gain: float) -> None:
    """Takes an error of one injection's current, which looks like its quiet voltages, off the products, in place."""
    if gain > 0 and inner > 0:
        for p in range(len(reference)):
            if reference[p] != 0:
                weight = reference[p] / (1 / gain**2 + inner)
                for q in range(p, len(reference)):
                    gram[p, q] -= weight * reference[q]
    reference[:] = 0.0


@njit(cache=True, nogil=True)
def _eliminated(gram: Floats) -> int:
    """Gaussian elimination of all columns but the last, in place, in the upper triangle; the rank.

    Columns that others determine are left out: their diagonal becomes 0. What stays last on the diagonal is the misfit.
    """
    n, rank = len(gram) - 1, 0
    least = np.empty(n)
    for i in range(n):
        least[i] = _SINGULAR * gram[i, i]
    for i in range(n):
        pivot = gram[i, i]
        if not pivot > least[i]:
            gram[i, i:] = 0.0
            continue
        rank += 1
        row = gram[i]
        for j in range(i + 1, n + 1):
            share = row[j] / pivot
            if share != 0:
                other = gram[j]
                for k in range(j, n + 1):
                    other[k] -= share * row[k]
    return rank
