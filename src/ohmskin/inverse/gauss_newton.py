"""One-step Gauss-Newton images, in the coordinates of electrode pairs.

The textbook data-space form (n_meas, n_meas), with relative conductivity change x, prior covariance Gamma and noise sigma,

    x = Gamma J^T (J Gamma J^T + sigma^2 I)^-1 dv,        J = diag(I) A G,

needs a new Gamma J^T whenever the drive pattern changes. In the image modes B, C of `ImageModes` what is left for each frame is

    x = B^T u,      (H^T H + (sigma / s)^2 I) u = H^T dv,      H = diag(I) A C,

which is the same image (push-through identity) from a system of at most L (L - 1) / 2 unknowns, for any pattern.
"""

import copy
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from ohmskin.forward import TransferModel
from ohmskin.geometry.domain import Floats
from ohmskin.inverse.image import Image
from ohmskin.inverse.modes import ImageModes, System, check_positive, check_share, pair_system
from ohmskin.inverse.positivity import nonnegative
from ohmskin.inverse.priors import Prior, paper_laplacian, penalty_of
from ohmskin.scan import Difference


class GaussNewton:
    """One-step Gauss-Newton reconstruction with a fixed linearisation (paper, section III-A).

    The regularisation follows one physical rule for all patterns: noise in volts and prior amplitude, the relative
    conductivity change expected of a touch (mean over the sheet of the prior's standard deviation squared).

    Args:
        model: The untouched sheet.
        noise: Standard deviation of a voltage (V).
        prior: Function from a mesh to the penalty, or the name of one of `PRIORS`.
        amplitude: Relative conductivity change expected (1).
        model_error: Error of the linear model as a share of the root mean square of the data; added to the noise (1).
        positive: Whether the image may be nowhere negative: pressing only raises conductivity. Costs some ten factorisations
            a frame instead of none.

    Attributes:
        modes: The modes it works in.

    Raises:
        ModelError: If noise or amplitude is not positive, `model_error` is negative, or the prior is unknown.
    """

    def __init__(
        self,
        model: TransferModel,
        noise: float,
        prior: Prior | str = paper_laplacian,
        amplitude: float = 1.0,
        model_error: float = 0.0,
        positive: bool = False,
    ) -> None:
        check_positive(noise=noise, amplitude=amplitude)
        check_share(model_error=model_error)
        self.model, self.noise, self.amplitude, self.model_error = model, noise, amplitude, model_error
        self.positive = positive
        self._penalty = penalty_of(model, prior)
        self.modes = ImageModes.of_prior(model, self._penalty)

    def with_amplitude(self, amplitude: float) -> "GaussNewton":
        """The same estimator with another prior amplitude; costs nothing."""
        check_positive(amplitude=amplitude)
        other = copy.copy(self)
        other.amplitude = amplitude
        return other

    def reconstruct(self, *differences: Difference) -> Image:
        """The image of one scan, or of several fused. Channels that are not finite are left out.

        Raises:
            DataError: If no finite datum is left.
        """
        system = self.modes.system(*differences)
        noise = float(np.hypot(self.noise, self.model_error * system.root_mean_square))
        u, noise_std = solve_modes(self.modes, system, noise / self.amplitude, self.noise)
        if not self.positive:
            return Image(u @ self.modes.modes, noise_std)
        pairs = pair_system(len(self.model.electrodes), *differences)
        rows = pairs.rows @ self._penalty.to_unknowns(self.model.pair_sensitivity * self.model.conductivity)
        w = nonnegative(self._penalty.normalised, rows, pairs.volts, noise / self.amplitude)
        return Image(self._penalty.to_image(w), noise_std)


def solve_modes(modes: ImageModes, system: System, weight: float, noise: float) -> tuple[Floats, Callable[[ArrayLike], Floats]]:
    """The u that minimises |volts - rows u|^2 + weight^2 |u|^2, and the standard deviation that noise (V) gives the image."""
    rows = system.rows
    normal = rows.T @ rows
    # below a ten-millionth of the data, noise drowns in the rounding of the normal matrix
    normal[np.diag_indices_from(normal)] += max(weight**2, 1e-14 * normal.trace())
    factor = cho_factor(normal, lower=True, overwrite_a=True, check_finite=False)
    u: Floats = cho_solve(factor, rows.T @ system.volts, check_finite=False)

    def noise_std(elements: ArrayLike) -> Floats:
        response = rows @ cho_solve(factor, modes.modes[:, np.atleast_1d(elements)], check_finite=False)
        std: Floats = noise * np.linalg.norm(response, axis=0)
        return std

    return u, noise_std
