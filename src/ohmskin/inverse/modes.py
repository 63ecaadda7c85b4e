"""Image modes: all images that electrode data can call for under a prior, in coordinates that are independent a priori.

Every sensitivity is a combination of the L (L - 1) / 2 pair sensitivities G (relative conductivity). With prior
covariance Gamma = W^T W, W G^T = Q C^T is factored once, and B = Q^T W. An image is B^T u with u white a priori, and
data are I A C u: whatever the pattern A and the mesh, a problem has at most L (L - 1) / 2 unknowns. Factors of G Gamma
G^T would be the same, but with the square of the condition number, which is the rounding error of images at low noise.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.linalg import qr

from ohmskin.arrays import Floats, Ints, real
from ohmskin.errors import DataError, ModelError
from ohmskin.inverse.priors import FREE, Penalty
from ohmskin.scan import Difference, DrivePattern, Pairs
from ohmskin.scan.baseline import terms_of

_KEPT_ROWS = 64  # adaptive patterns come and go; the fixed ones are cheap to make again


@dataclass(frozen=True)
class DataSystem:
    """Linear equations: volts = rows u + noise.

    Args:
        rows: (n_meas, n_unknowns) in volts.
        volts: (n_meas,) change of voltage (V), all finite.
    """

    rows: Floats
    volts: Floats

    def noise(self, noise: float, model_error: float) -> float:
        """Standard deviation (V) of data with this noise (V) and a model error as a share of their root mean square."""
        return float(np.hypot(noise, model_error * np.sqrt(np.mean(self.volts**2))))

    def compressed(self) -> "DataSystem":
        """The same least squares problem in no more equations than unknowns."""
        if len(self.rows) <= self.rows.shape[1]:
            return self
        basis, triangle = np.linalg.qr(self.rows)
        return DataSystem(triangle, basis.T @ self.volts)


@dataclass(frozen=True)
class ImageModes:
    """Modes of the image and how data depend on them.

    Args:
        modes: B (n_modes, n_elem), relative conductivity change.
        mixing: C (n_pairs, n_modes), two-terminal resistances (ohm) that the modes cause.
        pairs: The pairs of electrodes.
        free_mean: Whether the first mode is uniform, and has no prior.
    """

    modes: Floats
    mixing: Floats
    pairs: Pairs
    free_mean: bool = False
    _rows: dict[DrivePattern, Floats] = field(default_factory=dict, repr=False)

    @classmethod
    def of_relative(cls, relative: Floats, penalty: Penalty, pairs: Pairs) -> "ImageModes":
        """The modes of any image under a prior, of average variance one over the sheet.

        Args:
            relative: (n_pairs, n_image) change of two-terminal resistances with each value's relative change (ohm).
            penalty: Of the prior.
            pairs: The pairs, in the order of the resistances.
        """
        white = penalty.whitened(relative.T)
        if len(white) < len(relative):  # more pairs than unknowns: the modes are the unknowns, whitened
            basis, triangle = np.eye(len(white)), white
        else:
            basis, triangle = qr(white, mode="economic", check_finite=False)  # NumPy's takes half as long again
        modes, mixing = penalty.coloured(basis).T, triangle.T
        if penalty.free_mean:
            level = np.full((1, relative.shape[1]), FREE)
            modes, mixing = np.vstack([level, modes]), np.hstack([relative @ level.T, mixing])
        return cls(np.ascontiguousarray(modes), np.ascontiguousarray(mixing), pairs, penalty.free_mean)

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return len(self.modes)

    def rows(self, pattern: DrivePattern) -> Floats:
        """Voltages of a pattern due to each mode at 1 A: A C (n_meas, n_modes) in ohms."""
        if pattern not in self._rows:
            if len(self._rows) >= _KEPT_ROWS:
                self._rows.clear()
            self._rows[pattern] = combined(terms_of(pattern, self.pairs), self.mixing)
        return self._rows[pattern]

    def system(self, *differences: Difference) -> DataSystem:
        """The equations of one scan, or of several fused; arguments and errors as of `GaussNewton.reconstruct`."""

        def rows(d: Difference) -> Floats:
            return self.rows(d.pattern) if d.source_loading is None else d.combination(self.pairs) @ self.mixing

        return finite_system(rows, differences)


@njit(cache=True, nogil=True)
def combined(terms: Ints, pairs: Floats) -> Floats:
    """`DrivePattern.combination` @ pairs (n_pairs, n), without the sparse matrix, from `terms_of` (5, n_meas)."""
    rows = np.zeros((terms.shape[1], pairs.shape[1]))
    for m in range(len(rows)):
        for t in range(4):
            pair, sign = terms[t, m], 0.5 if t < 2 else -0.5
            if pair < len(pairs):
                for k in range(pairs.shape[1]):
                    rows[m, k] += sign * pairs[pair, k]
    return rows


def finite_system(rows_of: Callable[[Difference], Floats], differences: tuple[Difference, ...]) -> DataSystem:
    """The equations of scans with known rows (n_meas, n_unknowns) in volts per ampere, but for channels not finite.

    Raises:
        DataError: If no finite datum is left.
    """
    if not differences:
        raise DataError("no scan to make an image of; give at least one")
    if other := [type(d).__name__ for d in differences if not isinstance(d, Difference)]:
        raise DataError(f"images are made of differences, not of a {other[0]}: `Baseline.difference` gives them")
    currents = [np.where(np.isfinite(difference.currents), difference.currents, np.nan) for difference in differences]
    rows = [rows_of(difference) * amperes[:, None] for difference, amperes in zip(differences, currents, strict=True)]
    stacked = rows[0] if len(rows) == 1 else np.vstack(rows)
    volts = differences[0].volts if len(rows) == 1 else np.concatenate([d.volts for d in differences])
    known = np.isfinite(volts) & np.isfinite(stacked[:, 0])  # a current that is not finite spoils its whole row
    if not known.all():
        stacked, volts = stacked[known], volts[known]
    if not len(volts):
        raise DataError("no finite measurement in the frame; check the device, or that the voltages do not clip")
    return DataSystem(stacked, volts)


def pair_system(pairs: Pairs | int, *differences: Difference) -> DataSystem:
    """The equations of scans in the two-terminal resistances (n_pairs,), no more of them than pairs.

    Raises:
        DataError: If no finite datum is left.
    """
    return finite_system(lambda difference: difference.combination(pairs).toarray(), differences).compressed()


def regularised(normal: Floats, noise: float) -> Floats:
    """A normal matrix with the noise's variance added to its diagonal, in place.

    Below a ten-millionth of the data, noise drowns in the rounding of the matrix; it is taken for that much.
    """
    normal[np.diag_indices_from(normal)] += max(noise**2, 1e-14 * normal.trace())
    return normal


def _number(value: ArrayLike, name: str) -> float:
    array = real(value, f"{name} is", ModelError)
    if array.size != 1:
        raise ModelError(f"{name} is an array of shape {array.shape}; give one number")
    return float(array.item())


def check_positive(**settings: float) -> None:
    """Raise ModelError unless every setting is finite and positive."""
    for name, value in settings.items():
        number = _number(value, name)
        if not (np.isfinite(number) and number > 0):
            raise ModelError(f"{name} is {number}; it must be finite and positive")


def check_share(**settings: float) -> None:
    """Raise ModelError unless every setting is finite and not negative."""
    for name, value in settings.items():
        number = _number(value, name)
        if not (np.isfinite(number) and number >= 0):
            raise ModelError(f"{name} is {number}; it must be finite and not negative")
