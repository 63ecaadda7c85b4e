"""One-step Gauss-Newton images, in the coordinates of electrode pairs.

The textbook data-space form (n_meas, n_meas), with relative conductivity change x, prior covariance Gamma and noise sigma,

    x = Gamma J^T (J Gamma J^T + sigma^2 I)^-1 dv,        J = diag(I) A G,

needs a new Gamma J^T whenever the drive pattern changes. Every J is a combination A of the same L (L - 1) / 2 pair
sensitivities G, so Gamma G^T is formed once and factored into image modes B that are independent and of unit variance a
priori: G Gamma G^T = C C^T, Gamma G^T = B^T C^T. What is left for each frame is

    x = B^T u,      (H^T H + (sigma / s)^2 I) u = H^T dv,      H = diag(I) A C,

which is the same image (push-through identity) from a system of at most L (L - 1) / 2 unknowns, for any pattern.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve

from ohmskin.errors import DataError, ModelError
from ohmskin.forward import TransferModel
from ohmskin.forward.assembly import factorise
from ohmskin.geometry import Mesh
from ohmskin.geometry.domain import Floats
from ohmskin.inverse.priors import paper_laplacian
from ohmskin.scan import Difference, DrivePattern

Prior = Callable[[Mesh], sp.csc_array]


@dataclass(frozen=True)
class Image:
    """A reconstructed image.

    Args:
        values: (n_elem,) relative change of conductivity (1).
        noise_std: Function from element numbers (n,) to the standard deviation (n,) that measurement noise gives the values.
    """

    values: Floats
    noise_std: Callable[[ArrayLike], Floats] = field(repr=False)


class GaussNewton:
    """One-step Gauss-Newton reconstruction with a fixed linearisation (paper, section III-A).

    The regularisation follows one physical rule for all patterns: noise in volts and prior amplitude, the relative
    conductivity change expected of a touch (mean over the sheet of the prior's standard deviation squared).

    Args:
        model: The untouched sheet.
        noise: Standard deviation of a voltage (V).
        prior: Function from a mesh to the penalty matrix R (n_elem, n_elem).
        amplitude: Relative conductivity change expected (1).
        model_error: Error of the linear model as a share of the root mean square of the data; added to the noise (1).

    Raises:
        ModelError: If noise or amplitude is not positive, or `model_error` is negative.
    """

    def __init__(
        self,
        model: TransferModel,
        noise: float,
        prior: Prior = paper_laplacian,
        amplitude: float = 1.0,
        model_error: float = 0.0,
    ) -> None:
        for name, value, low in (("noise", noise, 0.0), ("amplitude", amplitude, 0.0), ("model_error", model_error, -1e-300)):
            if not (np.isfinite(value) and value > low):
                raise ModelError(f"{name} is {value!r}; it must be finite and {'positive' if low == 0 else 'not negative'}")
        self.model, self.noise, self.amplitude, self.model_error = model, noise, amplitude, model_error
        solve = factorise(prior(model.mesh)).solve
        relative = model.pair_sensitivity * model.conductivity  # (n_pairs, n_elem) ohms per relative change
        smoothed = solve(relative.T).T / _mean_diagonal(solve, model.mesh.n_elem)
        covariance = relative @ smoothed.T
        variance, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
        kept = variance > 1e-13 * variance[-1]
        deviation, vectors = np.sqrt(variance[kept]), vectors[:, kept]
        self._modes: Floats = (vectors.T @ smoothed) / deviation[:, None]  # B (n_modes, n_elem)
        self._mixing: Floats = vectors * deviation  # C (n_pairs, n_modes)
        self._rows: dict[DrivePattern, Floats] = {}

    def reconstruct(self, *differences: Difference) -> Image:
        """The image of one scan, or of several fused. Channels that are not finite are left out.

        Raises:
            DataError: If no finite datum is left.
        """
        rows = np.vstack([self._pattern_rows(d.pattern) * d.currents[:, None] for d in differences])
        volts = np.concatenate([d.volts for d in differences])
        known = np.isfinite(volts) & np.isfinite(rows[:, 0])
        if not known.all():
            rows, volts = rows[known], volts[known]
        if not len(volts):
            raise DataError("no finite measurement in the frame; check the device, or that the voltages do not clip")
        noise = float(np.hypot(self.noise, self.model_error * np.sqrt(np.mean(volts**2))))
        normal = rows.T @ rows
        normal[np.diag_indices_from(normal)] += (noise / self.amplitude) ** 2
        factor = cho_factor(normal, lower=True, overwrite_a=True, check_finite=False)
        values: Floats = cho_solve(factor, rows.T @ volts, check_finite=False) @ self._modes

        def noise_std(elements: ArrayLike) -> Floats:
            response = rows @ cho_solve(factor, self._modes[:, np.atleast_1d(elements)], check_finite=False)
            std: Floats = self.noise * np.linalg.norm(response, axis=0)
            return std

        return Image(values, noise_std)

    def _pattern_rows(self, pattern: DrivePattern) -> Floats:
        if pattern not in self._rows:
            if len(self._rows) >= 64:  # adaptive patterns come and go; the fixed ones are cheap to make again
                self._rows.clear()
            self._rows[pattern] = pattern.combination(len(self.model.electrodes)) @ self._mixing
        return self._rows[pattern]


def _mean_diagonal(solve: Callable[[Floats], Floats], n: int, probes: int = 256) -> float:
    """Mean of the diagonal of an inverse, from random signs (Hutchinson); about one per cent off, the same every time."""
    signs: NDArray[np.float64] = np.random.default_rng(0).choice([-1.0, 1.0], size=(n, probes))
    return float(np.mean(signs * solve(signs)))
