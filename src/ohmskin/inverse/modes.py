"""Image modes: all images that electrode data can call for under a prior, in coordinates that are independent a priori.

Every sensitivity is a combination of the L (L - 1) / 2 pair sensitivities G (relative conductivity). With prior
covariance Gamma, G Gamma G^T = C C^T is factored once, and Gamma G^T = B^T C^T. An image is B^T u with u white a
priori, and data are I A C u: whatever the pattern A and the mesh, a problem has at most L (L - 1) / 2 unknowns.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import DataError, ModelError
from ohmskin.inverse.priors import Penalty
from ohmskin.scan import Difference, DrivePattern

_KEPT_ROWS = 64  # adaptive patterns come and go; the fixed ones are cheap to make again


@dataclass(frozen=True)
class System:
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

    def compressed(self) -> "System":
        """The same least squares problem in no more equations than unknowns."""
        if len(self.rows) <= self.rows.shape[1]:
            return self
        basis, triangle = np.linalg.qr(self.rows)
        return System(triangle, basis.T @ self.volts)


@dataclass(frozen=True)
class ImageModes:
    """Modes of the image and how data depend on them.

    Args:
        modes: B (n_modes, n_elem), relative conductivity change.
        mixing: C (n_pairs, n_modes), two-terminal resistances (ohm) that the modes cause.
        n_elec: Number of electrodes.
    """

    modes: Floats
    mixing: Floats
    n_elec: int
    _rows: dict[DrivePattern, Floats] = field(default_factory=dict, repr=False)

    @classmethod
    def of_relative(cls, relative: Floats, penalty: Penalty, n_elec: int) -> "ImageModes":
        """The modes of any image under a prior, of average variance one over the sheet.

        `relative` (n_pairs, n_image): change of two-terminal resistances with each value's relative change (ohm).
        """
        if len(relative) > relative.shape[1] and penalty.image is None and penalty.places is not None:
            # more pairs than unknowns: the modes are the unknowns, whitened, and no matrix (n_pairs, n_pairs) is formed
            return cls(penalty.whitened(np.eye(relative.shape[1])), penalty.whitened(relative.T).T.copy(), n_elec)
        smoothed = penalty.covariance(relative.T).T
        return cls.of_products(smoothed, relative @ smoothed.T, n_elec)

    @classmethod
    def of_products(cls, smoothed: Floats, covariance: Floats, n_elec: int) -> "ImageModes":
        """The modes with Gamma G^T the transpose of `smoothed` (n_pairs, n_elem), and G Gamma G^T `covariance`."""
        variance, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
        # variances span more decades than rounding leaves intact; a floor, unlike a cut, keeps B^T C^T = Gamma G^T
        deviation = np.sqrt(np.maximum(variance, 1e-15 * variance[-1]))
        return cls((vectors.T @ smoothed) / deviation[:, None], vectors * deviation, n_elec)

    @property
    def n_modes(self) -> int:
        return len(self.modes)

    def rows(self, pattern: DrivePattern) -> Floats:
        """What a pattern measures of each mode at one ampere: A C (n_meas, n_modes) in ohms."""
        if pattern not in self._rows:
            if len(self._rows) >= _KEPT_ROWS:
                self._rows.clear()
            pattern.check(self.n_elec)
            self._rows[pattern] = combined(pattern.quadruples, self.mixing, self.n_elec)
        return self._rows[pattern]

    def system(self, *differences: Difference) -> System:
        """The equations of one scan, or of several fused. Channels that are not finite are left out.

        Raises:
            DataError: If no finite datum is left.
        """

        def rows(d: Difference) -> Floats:
            return self.rows(d.pattern) if d.source_loading is None else d.combination(self.n_elec) @ self.mixing

        return finite_system(rows, differences)


@njit(cache=True, nogil=True)
def combined(quadruples: Ints, pairs: Floats, n_elec: int) -> Floats:
    """`DrivePattern.combination` @ pairs (n_pairs, n), without the sparse matrix."""
    rows = np.zeros((len(quadruples), pairs.shape[1]))
    for m in range(len(quadruples)):
        a, b, c, d = quadruples[m]
        for i, j, sign in ((a, d, 0.5), (b, c, 0.5), (a, c, -0.5), (b, d, -0.5)):
            if i != j:
                low, high = min(i, j), max(i, j)
                pair = low * n_elec - low * (low + 1) // 2 + high - low - 1
                for k in range(pairs.shape[1]):
                    rows[m, k] += sign * pairs[pair, k]
    return rows


def finite_system(rows_of: Callable[[Difference], Floats], differences: tuple[Difference, ...]) -> System:
    """The equations of scans with known rows (n_meas, n_unknowns) in volts per ampere, but for channels not finite.

    Raises:
        DataError: If no finite datum is left.
    """
    if not differences:
        raise DataError("no scan to make an image of; give at least one")
    rows = [rows_of(difference) * difference.currents[:, None] for difference in differences]
    stacked = rows[0] if len(rows) == 1 else np.vstack(rows)
    volts = differences[0].volts if len(rows) == 1 else np.concatenate([d.volts for d in differences])
    known = np.isfinite(volts) & np.isfinite(stacked[:, 0])  # a current that is not finite spoils its whole row
    if not known.all():
        stacked, volts = stacked[known], volts[known]
    if not len(volts):
        raise DataError("no finite measurement in the frame; check the device, or that the voltages do not clip")
    return System(stacked, volts)


def pair_system(n_elec: int, *differences: Difference) -> System:
    """The equations of scans in the two-terminal resistances (n_pairs,) of all pairs, no more of them than pairs.

    Raises:
        DataError: If no finite datum is left.
    """
    return finite_system(lambda difference: difference.combination(n_elec).toarray(), differences).compressed()


def regularised(normal: Floats, noise: float) -> Floats:
    """A normal matrix with the noise's variance added to its diagonal, in place.

    Below a ten-millionth of the data, noise drowns in the rounding of the matrix; it is taken for that much.
    """
    normal[np.diag_indices_from(normal)] += max(noise**2, 1e-14 * normal.trace())
    return normal


def check_positive(**settings: float) -> None:
    """Raise ModelError unless every setting is finite and positive."""
    for name, value in settings.items():
        if not (np.isfinite(value) and value > 0):
            raise ModelError(f"{name} is {value!r}; it must be finite and positive")


def check_share(**settings: float) -> None:
    """Raise ModelError unless every setting is finite and not negative."""
    for name, value in settings.items():
        if not (np.isfinite(value) and value >= 0):
            raise ModelError(f"{name} is {value!r}; it must be finite and not negative")
