"""How well contacts explain data: what they would cause, and in which units misfits count.

Data of a scan are y = I A (sum_k s_k h(x_k, q_k)) + noise, with the effect s (relative conductivity change times
area), place x and squared radius q of contact k and the response h of `ContactTable`. Only the rows' four entries are
ever touched: A is not formed. Noise is white but for a few known directions V (what the model gets wrong, what is not
yet known): its inverse covariance (sigma^2 I + V V^T)^-1 is applied by the matrix inversion lemma.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import DataError
from ohmskin.forward import ContactTable
from ohmskin.scan import Difference, pair_index

PER_CONTACT = 4  # x, y, effect, squared radius


@dataclass(frozen=True, eq=False)
class Data:
    """Changes of voltage of one or several scans, and how pair quantities make them. All finite.

    Args:
        pairs: (k, n_meas) numbers of the pairs whose two-terminal quantities make each measurement, k = 4 or 5.
        weights: (k, n_meas) with which they do, times the current (A).
        volts: (n_meas,) change of voltage (V).
        currents: (n_meas,) behind them (A).
        n_pairs: Number of electrode pairs.
        known: Which of the scans' measurements these are.
        driven: (n_meas,) which of these involve an electrode that carries the current.
        share: (n_meas,) by which weights and volts have been multiplied, to count less what is less sure (1).
    """

    pairs: Ints
    weights: Floats
    volts: Floats
    currents: Floats
    n_pairs: int
    known: NDArray[np.bool_]
    driven: NDArray[np.bool_]
    share: Floats

    @classmethod
    def of(cls, n_elec: int, *differences: Difference) -> "Data":
        """The data of one scan, or of several fused. Channels that are not finite are left out.

        Raises:
            DataError: If no finite datum is left.
        """
        if not differences:
            raise DataError("no scan to find contacts in; give at least one")
        four = np.concatenate([d.pattern.quadruples for d in differences])
        volts = np.concatenate([d.volts for d in differences])
        currents = np.concatenate([d.currents for d in differences])
        known = np.isfinite(volts) & np.isfinite(currents)
        if not known.any():
            raise DataError("no finite measurement in the frame; check the device, or that the voltages do not clip")
        a, b, c, d = four[known].T
        first, second = np.stack([a, b, a, b]), np.stack([d, c, c, d])
        weights = np.repeat([0.5, 0.5, -0.5, -0.5], len(a)).reshape(4, -1)
        if any(difference.source_loading is not None for difference in differences):  # the pair driven counts, too
            loads = [np.zeros(d.pattern.n_meas) if d.source_loading is None else d.source_loading for d in differences]
            first, second = np.vstack([first, a]), np.vstack([second, b])
            weights = np.vstack([weights, -np.concatenate(loads)[known]])
        distinct = first != second  # a driven electrode that is also measured: F_ii = 0
        pairs = np.where(distinct, pair_index(first, np.where(distinct, second, first + 1), n_elec), 0)
        weights = weights * currents[known] * distinct
        driven, share = np.concatenate([d.pattern.driven for d in differences])[known], np.ones(len(a))
        return cls(pairs, weights, volts[known], currents[known], n_elec * (n_elec - 1) // 2, known, driven, share)

    @classmethod
    def together(cls, parts: Sequence["Data"]) -> "Data":
        """The data of several frames as one; all with or all without a sagging source."""
        arrays = [field.name for field in fields(cls) if field.name != "n_pairs"]
        joined = {name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in arrays}
        return cls(**joined, n_pairs=parts[0].n_pairs)

    def counted(self, noise: float, model_error: float) -> "Data":
        """These data with those of driven electrodes counted as much less as their larger changes err more.

        Args:
            noise: Standard deviation of a voltage (V).
            model_error: How far the model errs, as a share of the root mean square of each of the two kinds (1).
        """
        if not self.driven.any() or self.driven.all():
            return self
        squares = (float(np.mean(self.volts[kind] ** 2)) for kind in (~self.driven, self.driven))
        usual, theirs = (np.hypot(noise, model_error * np.sqrt(square)) for square in squares)
        share = np.where(self.driven, min(1.0, usual / theirs), 1.0)
        return replace(self, weights=self.weights * share, volts=self.volts * share, share=self.share * share)

    def less(self, explained: Floats) -> "Data":
        """These data without what is explained already (n_meas,) in volts."""
        return replace(self, volts=self.volts - explained)

    def rows(self, quantities: Floats) -> Floats:
        """What is measured (n_meas, ...) of pair quantities (n_pairs, ...) in ohms: I A times them (V)."""
        weights = self.weights.reshape(*self.weights.shape, *[1] * (quantities.ndim - 1))
        total: Floats = quantities[self.pairs[0]] * weights[0]
        for pairs, weight in zip(self.pairs[1:], weights[1:], strict=True):
            total += quantities[pairs] * weight
        return total

    @cached_property
    def matrix(self) -> Floats:
        """What `rows` multiplies by, per ampere: A (n_meas, n_pairs)."""
        matrix = np.zeros((len(self.volts), self.n_pairs))
        at = np.arange(len(self.volts))
        for pairs, weight in zip(self.pairs, self.weights, strict=True):
            matrix[at, pairs] += weight / self.currents
        return matrix

    @cached_property
    def root_mean_square(self) -> float:
        """Of the data whose electrodes carry no current, if there are any (V)."""
        counted = self.volts if self.driven.all() else self.volts[~self.driven]
        return float(np.sqrt(np.mean(counted**2)))


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise of a covariance sigma^2 I + V V^T.

    Args:
        sigma: Standard deviation of the white part (V).
        directions: V (n_meas, k) in volts.
    """

    sigma: float
    directions: Floats

    @cached_property
    def _small(self) -> tuple[Floats, bool]:
        gram = self.directions.T @ self.directions
        gram[np.diag_indices_from(gram)] += self.sigma**2
        factor: tuple[Floats, bool] = cho_factor(gram, lower=True, check_finite=False)
        return factor

    def inner(self, left: Floats, right: Floats) -> Floats:
        """left^T (sigma^2 I + V V^T)^-1 right, of columns (n_meas, ...)."""
        plain = left.T @ right
        if self.directions.shape[1]:
            solved = cho_solve(self._small, self.directions.T @ right, check_finite=False)
            plain = plain - (left.T @ self.directions) @ solved
        return np.asarray(plain / self.sigma**2)

    def apply(self, values: Floats) -> Floats:
        """sigma^2 (sigma^2 I + V V^T)^-1 of values (n_meas,): what of them is not explained by the directions."""
        if not self.directions.shape[1]:
            return values
        solved = cho_solve(self._small, self.directions.T @ values, check_finite=False)
        return np.asarray(values - self.directions @ solved)

    def gains(self, columns: Floats, residual: Floats) -> tuple[Floats, Floats]:
        """The scores c^T C^-1 r and the powers c^T C^-1 c of each of many columns c (n_meas, n); (n,) each."""
        variance = self.sigma**2
        score, power = residual @ columns, np.einsum("mn,mn->n", columns, columns)
        if self.directions.shape[1]:
            seen = self.directions.T @ columns
            solved = cho_solve(self._small, seen, check_finite=False)
            score = score - (self.directions.T @ residual) @ solved
            power = power - np.einsum("kn,kn->n", seen, solved)
        return score / variance, np.maximum(power, 1e-12 * power.max()) / variance


def no_directions(data: Data) -> Floats:
    """None in which data err beside white noise (n_meas, 0)."""
    return np.zeros((len(data.volts), 0))


def gain_directions(difference: Difference, reference: Floats, gain: float) -> Floats:
    """What an error of each injection's current does (n_meas, n_inj): all its voltages change by the same share (V).

    Args:
        difference: The scan.
        reference: (n_meas,) its voltages on the untouched skin (V).
        gain: Standard deviation of that share (1).
    """
    which = difference.pattern.measurements[:, 0]
    return np.asarray(gain * reference[:, None] * (which[:, None] == np.arange(difference.pattern.n_inj)))


def contact_directions(difference: Difference, spread: Floats) -> Floats:
    """What a change of contact impedance does at each electrode that carries current and is measured (n_meas, k) (V).

    Args:
        difference: The scan.
        spread: (n_elec,) standard deviation of the change (ohm).
    """
    source, sink, plus, minus = difference.pattern.quadruples.T
    electrodes = np.unique(difference.pattern.quadruples[difference.pattern.driven, 2:])
    into = (source[:, None] == electrodes).astype(float) - (sink[:, None] == electrodes)
    across = (plus[:, None] == electrodes).astype(float) - (minus[:, None] == electrodes)
    directions = difference.currents[:, None] * into * across * spread[electrodes]
    return np.asarray(directions[:, directions.any(axis=0)])


def responses(table: ContactTable, data: Data, params: Floats) -> tuple[Floats, Floats]:
    """What contacts `params` (n, 4) cause together (n_meas,), and its derivatives (n_meas, 4 n) by them.

    A contact's parameters are x, y (m), effect (m2), squared radius (m2).
    """
    if not len(params):
        return np.zeros(len(data.volts)), no_directions(data)
    found = table(params[:, :2], np.sqrt(params[:, 3]))
    effect = params[:, 2, None]
    slopes = effect[:, None] * found.slopes
    parts = np.stack([slopes[:, 0], slopes[:, 1], found.values, effect * found.widening], axis=1)
    slopes = data.rows(np.ascontiguousarray(parts.reshape(-1, parts.shape[-1]).T))
    return slopes[:, 2::PER_CONTACT] @ params[:, 2], slopes
