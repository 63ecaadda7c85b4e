"""One-step Gauss-Newton images, in the coordinates of electrode pairs.

The data-space form (n_meas, n_meas), with relative conductivity change x, prior covariance Gamma and noise sigma,

    x = Gamma J^T (J Gamma J^T + sigma^2 I)^-1 dv,        J = diag(I) A G,

needs a new Gamma J^T whenever the pattern changes. In the image modes B, C of `ImageModes` what is left is

    x = B^T u,      (H^T H + (sigma / s)^2 I) u = H^T dv,      H = diag(I) A C,

which is the same image (push-through identity) from a system of at most L (L - 1) / 2 unknowns, for any pattern.
"""

import copy
from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from ohmskin.arrays import Floats
from ohmskin.forward import TransferModel
from ohmskin.geometry import Cells
from ohmskin.inverse.image import Image, NoiseStd
from ohmskin.inverse.modes import ImageModes, System, check_positive, check_share, pair_system
from ohmskin.inverse.pixels import Pixels
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
        pixels: Pixels to make the image of, with their own prior (eq. 5 read for pixels), instead of one value per
            triangle: then neither the image nor its cost depends on the mesh. `prior` does not count.
        positive: Whether the image may be nowhere negative: pressing only raises conductivity. Costs some ten
            factorisations a frame instead of none.

    Attributes:
        modes: The modes it works in.
        cells: What its images are made of: the model's mesh, or the pixels.

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
        pixels: Pixels | None = None,
    ) -> None:
        check_positive(noise=noise, amplitude=amplitude)
        check_share(model_error=model_error)
        self.model, self.noise, self.amplitude, self.model_error = model, noise, amplitude, model_error
        self.positive, self.pixels = positive, pixels
        self.cells: Cells = model.mesh if pixels is None else pixels
        self._penalty = penalty_of(model, prior) if pixels is None else pixels.penalty
        self.modes = ImageModes.of_relative(self._relative(), self._penalty, len(model.electrodes))

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
        u, noise_std = solve_modes(self.modes, system, self._weight(system), self.noise)
        if not self.positive:
            return Image(u @ self.modes.modes, noise_std)
        pairs = pair_system(len(self.model.electrodes), *differences)
        rows = pairs.rows @ self._penalty.to_unknowns(self._relative())
        w = nonnegative(self._penalty.normalised, rows, pairs.volts, self._weight(system))
        return Image(self._penalty.to_image(w), noise_std)

    def _weight(self, system: System) -> float:
        return float(np.hypot(self.noise, self.model_error * system.root_mean_square)) / self.amplitude

    def _relative(self) -> Floats:
        """Change of two-terminal resistances with the relative change of each value of the image (ohm)."""
        if self.pixels is not None:
            return self.pixels.sensitivity(self.model)
        return self.model.pair_sensitivity * self.model.conductivity


def solve_modes(modes: ImageModes, system: System, weight: float, noise: float) -> tuple[Floats, NoiseStd]:
    """The u of least |volts - rows u|^2 + weight^2 |u|^2, and the image's standard deviation from noise (V)."""
    rows, few = system.rows, len(system.rows) < len(modes.modes)
    # the smaller of two systems with the same solution (push-through identity)
    normal = rows @ rows.T if few else rows.T @ rows
    # below a ten-millionth of the data, noise drowns in the rounding of the normal matrix
    normal[np.diag_indices_from(normal)] += max(weight**2, 1e-14 * normal.trace())
    factor = cho_factor(normal, lower=True, overwrite_a=True, check_finite=False)
    u: Floats
    if few:
        u = rows.T @ cho_solve(factor, system.volts, check_finite=False)
    else:
        u = cho_solve(factor, rows.T @ system.volts, check_finite=False)

    def noise_std(elements: ArrayLike) -> Floats:
        some = modes.modes[:, np.atleast_1d(elements)]
        solve = partial(cho_solve, factor, check_finite=False)
        response = solve(rows @ some) if few else rows @ solve(some)
        return np.asarray(noise * np.linalg.norm(response, axis=0))

    return u, noise_std
