"""What scans say of two-terminal resistances: all that contacts are fitted to, whatever the patterns driven.

Voltages of a scan change by y = A x + D z + noise: x are the changes of the two-terminal resistances (ohm) and, last,
a common relative change of all of them; z are errors that the data themselves cannot tell from x beforehand, such as
those of currents and contact impedances, each with a standard deviation of one. With white noise the squared misfit, z
at its best, is constant - 2 vector.x + x.matrix.x. That is sufficient: scans with errors of their own add up.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from math import sqrt

import numpy as np
from numba import njit

from ohmskin.arrays import Bools, Floats, Ints
from ohmskin.contacts.misfit import Misfit, Parts
from ohmskin.errors import DataError, PatternError
from ohmskin.scan import Difference
from ohmskin.scan.pairs import n_pairs, pair_numbers

_UNSAID = 1e-4  # share of its size in the data by which a direction of which nothing is known may still be seen
_COMMON = 0.03  # by which all resistances may have changed together since calibration, as with temperature
_SAID = 2.0  # squared size of data beyond their noise, from which on they say anything
_ROUNDING = 1e-13  # of sums of squares
_RIDGE = 0.05  # of what a voltage says of a pair, so that drift is not learned where data say nothing
_ENDS = np.array([[0, 3], [1, 2], [0, 2], [1, 3], [0, 1]])  # F_ad, F_bc, F_ac, F_bd; F_ab as far as it takes current
_SIGNS = np.array([0.5, 0.5, -0.5, -0.5])


@dataclass(frozen=True, eq=False)
class Errors:
    """How data err beside the white noise of voltages.

    Args:
        noise: Standard deviation of a difference of voltages (V).
        gain: Of the relative error of a measured current, the same in all voltages of an injection (1).
        contacts: (n_pairs, n_elec) change of two-terminal resistances with each electrode's contact impedance, for one
            standard deviation of it (ohm); None: they are known.
        model: How far the model of a contact errs, as a share of the root mean square of the data (1).
    """

    noise: float
    gain: float = 0.0
    contacts: Floats | None = None
    model: float = 0.0

    def drift(self, data: "Information", known: Floats | float = 0.0) -> Floats:
        """Likeliest change (n_pairs,) of two-terminal resistances by contacts, if nothing touches the skin (ohm).

        Args:
            data: What is measured.
            known: Of it (n_pairs,), what has been taken off the data.
        """
        assert self.contacts is not None
        curvature = data.white.matrix[:-1, :-1]
        seen = self.contacts.T @ curvature
        volts = self.contacts.T @ data.white.vector[:-1] + (seen @ known if np.ndim(known) else 0.0)
        return np.asarray(self.contacts @ np.linalg.solve(seen @ self.contacts + np.eye(len(seen)), volts))


@dataclass(frozen=True, eq=False)
class Information:
    """What one or several scans say.

    Args:
        told: The misfit, errors of all kinds at their best.
        white: The same if voltages erred by white noise alone.
        count: Data.
    """

    told: Misfit
    white: Misfit
    count: int

    @classmethod
    def of(cls, n_elec: int, errors: Errors, scans: Sequence[Difference]) -> tuple["Information", "Information"]:
        """What scans say whose contacts are in the same state, and the same wary: the model's error is noise, too.

        Channels that are not finite are left out. Data of driven electrodes count as much less as their larger changes
        are modelled worse.

        Raises:
            DataError: If no finite datum is left.
            PatternError: If a pattern names an electrode that is not there.
        """
        if not scans:
            raise DataError("no scan to find contacts in; give at least one")
        four = np.concatenate([scan.pattern.quadruples for scan in scans])
        if four.max() >= n_elec:
            raise PatternError(f"the pattern names electrode {four.max()}; there are {n_elec} (0..{n_elec - 1})")
        driven = np.concatenate([scan.pattern.driven for scan in scans])
        volts = np.concatenate([scan.volts for scan in scans])
        amperes = np.concatenate([scan.currents for scan in scans])
        starts = np.cumsum([0, *(scan.pattern.n_inj for scan in scans)])
        which = np.concatenate([scan.pattern.measurements[:, 0] + n for scan, n in zip(scans, starts, strict=False)])
        zeros = [np.zeros(scan.pattern.n_meas) for scan in scans]
        quiet, loading = (
            np.concatenate([own if own is not None else zero for own, zero in zip(given, zeros, strict=True)])
            for given in ([scan.reference for scan in scans], [scan.source_loading for scan in scans])
        )
        changes = np.empty((n_pairs(n_elec), 0)) if errors.contacts is None else errors.contacts
        *found, count = _statistics(
            four, which, driven, amperes, volts, quiet, loading, pair_numbers(n_elec), int(starts[-1]),
            errors.noise, errors.gain, errors.model, changes,
        )  # fmt: skip
        if not count:
            raise DataError("no finite measurement in the frame; check the device, or that the voltages do not clip")
        told, wary, white, warier = (Misfit(*one, np.empty((0, len(one[1])))) for one in found)
        return cls(told, white, count), cls(wary, warier, count)

    @classmethod
    def together(cls, parts: Sequence["Information"]) -> "Information":
        """What several say whose errors are their own."""
        told, white = (
            Misfit(
                reduce(np.add, [one.whole for one in each]),
                reduce(np.add, [one.vector for one in each]),
                sum(one.constant for one in each),
                np.concatenate([one.lost for one in each]),
            )
            for each in ([part.told for part in parts], [part.white for part in parts])
        )
        return cls(told, white, sum(part.count for part in parts))

    @property
    def signal(self) -> float:
        """Root mean square of the data over their noise (1)."""
        return sqrt(max(self.white.constant, 0.0) / self.count)

    def less(self, known: Floats) -> "Information":
        """What is left to say once changes (n_pairs or n,) are known to be a part of it."""
        return Information(self.told.less(known), self.white.less(known), self.count)

    def without(self, directions: Floats) -> "Information":
        """What is said beside changes (n_pairs or n, k), each with a standard deviation of one."""
        return Information(self.told.without(directions), self.white, self.count)

    def beside_common(self, variance: float = _COMMON**2) -> "Information":
        """What is said beside a common relative change of all resistances, of which the variance is known (1)."""
        direction = np.zeros((len(self.told.vector), 1))
        direction[-1] = sqrt(variance)
        return self.without(direction)

    def unexplained(self, caused: Floats) -> float:
        """Share of what is said beyond noise, if that is much, that is left beside what contacts cause (n_pairs,)."""
        said, left = self.signals(caused)
        return min(max(left / said, 0.0), 1.0) if said > _SAID * self.count else 0.0

    def signals(self, caused: Floats) -> tuple[float, float]:
        """What is said beyond noise, and what of it is left beside what contacts cause (n_pairs,); squared sizes."""
        beside = self.beside_common()
        return beside.told.constant - self.count, beside.less(caused).told.constant - self.count

    def drift(self) -> Floats:
        """Change (n_pairs,) of each two-terminal resistance that explains what is said; none where nothing is (ohm)."""
        matrix, ridge = self.told.matrix[:-1, :-1], _RIDGE * np.trace(self.white.matrix[:-1, :-1]) / self.count
        return np.asarray(np.linalg.solve(matrix + ridge * np.eye(len(matrix)), self.told.vector[:-1]))

    def beside(self, directions: Floats) -> "Information":
        """What is said beside changes (n_pairs or n, k) of which nothing is known."""
        return self.without(self._unknown(directions))

    def leaving_out(self, directions: Floats) -> "Information":
        """What is said if changes (n_pairs or n, k) count for nothing, not in the size of others either."""
        unknown = self._unknown(directions)
        return Information(self.told.without(unknown), self.white.without(unknown), self.count)

    def _unknown(self, directions: Floats) -> Floats:
        """Changes (n_pairs or n, k) as large as they are where nothing is known of them."""
        sizes = self.white.sizes(directions)
        return np.asarray(directions[:, sizes > 0] / (_UNSAID * sizes[sizes > 0]))

    def times(self, share: float) -> "Information":
        """The same with all errors larger: `share` of what is known."""
        told = self.told
        less = Misfit(share * told.whole, share * told.vector, share * told.constant, sqrt(share) * told.lost)
        return Information(less, self.white, self.count)

    def size(self, changes: Floats) -> float:
        """How large changes (n_pairs or n,) are in the data, in standard deviations of white noise."""
        return float(self.white.sizes(changes[:, None])[0])


@njit(cache=True, nogil=True)
def _statistics(
    four: Ints, which: Ints, driven: Bools, amperes: Floats, volts: Floats, quiet: Floats, loading: Floats,
    numbers: Ints, n_inj: int, noise: float, gain: float, model: float, contacts: Floats,
) -> tuple[Parts, Parts, Parts, Parts, int]:  # fmt: skip
    """The curvature, gradient and constant of the misfit beside errors of all kinds; the same wary of the model's
    error; both with white noise alone; and the number of finite data."""
    counts, squares = np.zeros(2, np.int64), np.zeros(2)
    for row in range(len(four)):
        if np.isfinite(volts[row]) and np.isfinite(amperes[row]):
            counts[int(driven[row])] += 1
            squares[int(driven[row])] += volts[row] ** 2
    count, share = counts.sum(), 1.0
    if counts.min() > 0:  # driven electrodes count as much less as their larger changes are modelled worse
        usual, theirs = noise**2 + model**2 * squares / counts
        share = min(1.0, np.sqrt(usual / theirs))
    pairs = numbers[0, 0]  # on the diagonal: of no pair
    n, n_gain = pairs + 2, n_inj if gain > 0 else 0
    gram, gains, sizes = np.zeros((n, n)), np.zeros((n_gain, n)), np.empty(n_gain)
    columns, entries = np.empty(7, np.int64), np.empty(7)
    for row in range(len(four)):
        if not (np.isfinite(volts[row]) and np.isfinite(amperes[row])):
            continue
        scale = (share if driven[row] else 1.0) / noise
        many = 0
        for term in range(5):
            one, other = four[row, _ENDS[term, 0]], four[row, _ENDS[term, 1]]
            value = scale * amperes[row] * (-loading[row] if term == 4 else _SIGNS[term])
            if one != other and value != 0:  # a driven electrode that is also measured: F_ii = 0
                columns[many], entries[many] = numbers[one, other], value
                many += 1
        columns[many], columns[many + 1] = pairs, pairs + 1
        entries[many] = scale * quiet[row] if np.isfinite(quiet[row]) else 0.0
        entries[many + 1] = scale * volts[row]
        many += 2
        for p in range(many):
            for q in range(many):
                gram[columns[p], columns[q]] += entries[p] * entries[q]
            if n_gain:  # an error of the current looks like the quiet skin
                gains[which[row], columns[p]] += gain * entries[many - 2] * entries[p]
    for m in range(n_gain):
        sizes[m] = gain * gains[m, pairs]
    changes = np.ascontiguousarray(contacts.T)
    beside = changes @ gram[:pairs]
    own = np.ascontiguousarray(beside[:, :pairs]) @ contacts
    mixed = np.ascontiguousarray(gains[:, :pairs]) @ contacts
    larger = 1 + model**2 * gram[n - 1, n - 1] / max(count, 1)
    told = _whitened(gram, gains, sizes, beside, own, mixed, 1.0)
    wary = _whitened(gram, gains, sizes, beside, own, mixed, larger)
    return _parts(told), _parts(wary), _parts(gram), _parts(gram / larger), count


@njit(cache=True, nogil=True)
def _parts(products: Floats) -> Parts:
    """Curvature, gradient and constant from products (n + 1, n + 1) of columns, the data last."""
    return np.ascontiguousarray(products[:-1, :-1]), products[-1, :-1].copy(), products[-1, -1]


@njit(cache=True, nogil=True)
def _whitened(
    gram: Floats, gains: Floats, sizes: Floats, beside: Floats, own: Floats, mixed: Floats, variance: float
) -> Floats:
    """Products (n, n) of columns of data beside errors, if the noise has that variance.

    Args:
        gram: (n, n) theirs.
        gains: (n_gain, n) theirs with errors that have no data in common.
        sizes: (n_gain,) squares of these.
        beside: (k, n) theirs with further errors.
        own: (k, k) products of the further errors.
        mixed: (n_gain, k) of both kinds of errors.
        variance: Of the noise.
    """
    ridge = variance + _ROUNDING * (sizes.sum() + np.trace(own))
    rows, known = np.concatenate((gains, beside)), len(gains)
    root = 1 / np.sqrt(ridge + sizes).reshape(-1, 1)
    rows[:known] *= root
    both = root * mixed
    rows[known:] -= both.T @ rows[:known]
    lower = np.linalg.cholesky(own + ridge * np.eye(len(own)) - both.T @ both)
    for i in range(len(own)):
        for k in range(i):
            rows[known + i] -= lower[i, k] * rows[known + k]
        rows[known + i] /= lower[i, i]
    whitened: Floats = rows.T @ rows
    share = 1 / variance
    for i in range(len(gram)):
        for k in range(len(gram)):
            whitened[i, k] = (gram[i, k] - whitened[i, k]) * share
        whitened[i, i] += _ROUNDING * share * gram[i, i]  # or where errors leave nothing, rounding would leave less
    return whitened
