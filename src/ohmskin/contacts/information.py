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
from scipy.linalg.blas import dtrsm

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
        n = len(changes) + 2
        gram, gains = np.zeros((n, n)), np.zeros((int(starts[-1]) if errors.gain > 0 else 0, n))
        kinds = np.array([errors.noise, errors.gain, errors.model])
        count = _products(four, which, driven, amperes, volts, quiet, loading, pair_numbers(n_elec), kinds, gram, gains)
        if not count:
            raise DataError("no finite measurement in the frame; check the device, or that the voltages do not clip")
        larger = 1 + errors.model**2 * gram[-1, -1] / count
        beside = [_whitened(gram, gains, changes, errors.gain, variance) for variance in (1.0, larger)]
        told, wary, white, warier = (
            Misfit(*_parts(one), np.empty((0, n - 1))) for one in (*beside, gram, gram / larger)
        )
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
def _products(
    four: Ints, which: Ints, driven: Bools, amperes: Floats, volts: Floats, quiet: Floats, loading: Floats,
    numbers: Ints, errors: Floats, gram: Floats, gains: Floats,
) -> int:  # fmt: skip
    """Products of the columns of the problem in units of noise, and the number of finite data.

    Into `gram` (n, n) those of all two-terminal resistances, the quiet data and the data; into `gains` (n_inj, n) those
    with an error of the current of each injection. The `errors` are noise, gain and model of `Errors`.
    """
    noise, gain, model = errors
    counts, squares = np.zeros(2, np.int64), np.zeros(2)
    for row in range(len(four)):
        if np.isfinite(volts[row]) and np.isfinite(amperes[row]):
            counts[int(driven[row])] += 1
            squares[int(driven[row])] += volts[row] ** 2
    count, share = counts[0] + counts[1], 1.0
    if counts[0] > 0 and counts[1] > 0:  # driven electrodes count less, as their larger changes are modelled worse
        usual, theirs = squares[0] / counts[0], squares[1] / counts[1]
        share = min(1.0, np.sqrt((noise**2 + model**2 * usual) / (noise**2 + model**2 * theirs)))
    pairs = numbers[0, 0]  # on the diagonal: of no pair
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
            if gain > 0:  # an error of the current looks like the quiet skin
                gains[which[row], columns[p]] += gain * entries[many - 2] * entries[p]
    return int(count)


def _parts(products: Floats) -> Parts:
    """Curvature, gradient and constant from products (n + 1, n + 1) of columns, the data last."""
    return np.ascontiguousarray(products[:-1, :-1]), products[-1, :-1].copy(), float(products[-1, -1])


def _whitened(gram: Floats, gains: Floats, contacts: Floats, gain: float, variance: float) -> Floats:
    """Products (n, n) of columns of data beside errors, if the noise has that variance.

    Args:
        gram: (n, n) theirs.
        gains: (n_inj, n) theirs with errors of the currents, which have no data in common.
        contacts: (n_pairs, k) changes of two-terminal resistances of one standard deviation of further errors.
        gain: Standard deviation of the relative error of a current (1).
        variance: Of the noise.
    """
    pairs = len(contacts)
    beside, sizes = contacts.T @ gram[:pairs], gain * gains[:, pairs]
    own = beside[:, :pairs] @ contacts
    ridge = variance + _ROUNDING * (sizes.sum() + np.trace(own))
    root = 1 / np.sqrt(ridge + sizes)[:, None]
    first = root * gains
    both = first[:, :pairs] @ contacts
    lower = np.linalg.cholesky(own + ridge * np.eye(len(own)) - both.T @ both)
    second = dtrsm(1.0, lower, beside - both.T @ first, lower=1)
    whitened = gram - first.T @ first - second.T @ second
    whitened[np.diag_indices(len(gram))] += _ROUNDING * np.diag(gram)  # or rounding would leave less than nothing
    return np.asarray(whitened / variance)
