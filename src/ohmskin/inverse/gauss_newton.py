"""One-step Gauss-Newton images, in the coordinates of electrode pairs.

The data-space form (n_meas, n_meas), with relative conductivity change x, prior covariance Gamma and noise sigma,

    x = Gamma J^T (J Gamma J^T + sigma^2 I)^-1 dv,        J = diag(I) A G,

needs a new Gamma J^T whenever the pattern changes. In the image modes B, C of `ImageModes` what is left is

    x = B^T u,      (H^T H + (sigma / s)^2 I) u = H^T dv,      H = diag(I) A C,

which is the same image (push-through identity) from a system of at most L (L - 1) / 2 unknowns, for any pattern.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from ohmskin.arrays import Floats
from ohmskin.forward import TransferModel
from ohmskin.geometry import Cells
from ohmskin.inverse.image import Image, NoiseStd, Reconstructor
from ohmskin.inverse.modes import (
    DataSystem,
    ImageModes,
    check_positive,
    check_share,
    finite_system,
    pair_system,
    regularised,
)
from ohmskin.inverse.pixels import Pixels
from ohmskin.inverse.positivity import nonnegative
from ohmskin.inverse.priors import Prior, paper_laplacian, penalty_of
from ohmskin.scan import Difference

ILL = 1e-4  # weight over the norm of the rows below which what squares the condition number loses too many digits


@dataclass(eq=False)
class GaussNewton(Reconstructor):
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
        positive: Whether no value of the image may be negative: pressing only raises conductivity. It costs about ten
            factorisations a frame instead of none.

    Attributes:
        modes: The modes it works in.
        cells: What its images are made of: the model's mesh, or the pixels.
        penalty: The prior's penalty.

    Raises:
        ModelError: If noise or amplitude is not positive, `model_error` is negative, or the prior is unknown.
    """

    model: TransferModel
    noise: float
    prior: Prior | str = paper_laplacian
    amplitude: float = 1.0
    model_error: float = 0.0
    positive: bool = False
    pixels: Pixels | None = None

    def __post_init__(self) -> None:
        check_positive(noise=self.noise, amplitude=self.amplitude)
        check_share(model_error=self.model_error)
        self.cells: Cells = self.model.mesh if self.pixels is None else self.pixels
        self.penalty = penalty_of(self.model, self.prior) if self.pixels is None else self.pixels.penalty
        self.modes = ImageModes.of_relative(self.relative(), self.penalty, self.model.pairs)

    def with_amplitude(self, amplitude: float) -> "GaussNewton":
        """The same estimator with another prior `amplitude` (1); costs nothing.

        Raises:
            ModelError: If it is not positive.
        """
        check_positive(amplitude=amplitude)
        other = copy.copy(self)
        other.amplitude = amplitude
        return other

    def reconstruct(self, *differences: Difference) -> Image:
        system, weight = self._system(*differences)
        unknowns, noise_std = solve_modes(self.modes, system, weight, self.noise)
        values = unknowns @ self.modes.modes
        if not self.positive:
            return Image(values, noise_std, shares=self.shares)
        whole = pair_system(self.model.pairs, *differences)
        rows = whole.rows @ self.penalty.to_unknowns(self.relative())
        w = nonnegative(self.penalty.normalised, rows, whole.volts, weight)
        return Image(self.penalty.to_image(w), noise_std, shares=self.shares)

    def unexplained(self, *differences: Difference) -> tuple[Floats, Floats]:
        """The data (n_finite,) of scans, `differences`, and what an image leaves of them that may be negative (V).

        Raises:
            DataError: If no finite datum is left.
        """
        system, weight = self._system(*differences)
        unknowns, _ = solve_modes(self.modes, system, weight, self.noise)
        return system.volts, system.volts - system.rows @ unknowns

    def _system(self, *differences: Difference) -> tuple[DataSystem, float]:
        """The equations of scans in the modes, and the weight of the penalty."""
        modes, system = self.modes, self.modes.system(*differences)
        weight = system.noise(self.noise, self.model_error) / self.amplitude
        if weight >= ILL * np.linalg.norm(system.rows[:, int(modes.free_mean) :]):
            return system, weight
        relative = self.relative()  # too exact for rows of pairs, of which the largest parts cancel

        def caused(difference: Difference) -> Floats:
            return np.asarray(difference.combination(modes.pairs) @ relative @ modes.modes.T)

        return finite_system(caused, differences), weight

    @property
    def shares(self) -> sp.csc_array | None:
        """`Pixels.shares` where images are of pixels; else None."""
        return None if self.pixels is None else self.pixels.shares

    def relative(self) -> Floats:
        """Change of two-terminal resistances with the relative change of each value of the image (ohm)."""
        if self.pixels is not None:
            return self.pixels.sensitivity(self.model)
        return self.model.pair_sensitivity * self.model.conductivity


def solve_modes(modes: ImageModes, system: DataSystem, weight: float, noise: float) -> tuple[Floats, NoiseStd]:
    """The u of least |volts - rows u|^2 + weight^2 |u|^2, and the standard deviation of its image from noise (V)."""
    rows, volts, free = system.rows, system.volts, int(modes.free_mean)
    size = float(np.linalg.norm(rows[:, :free])) or 1.0
    along = rows[:, :free] / size  # a mean that is not penalised is taken out of all equations
    overlap = along.T @ rows[:, free:]
    solve, transposed = _least_squares(rows[:, free:] - along @ overlap, weight)
    rest = solve(volts - along @ (along.T @ volts))
    mean = (along.T @ volts - overlap @ rest) / size

    def noise_std(elements: ArrayLike) -> Floats:
        images = modes.modes[:, np.atleast_1d(elements)]
        level = images[:free] / size
        response = transposed(images[free:] - overlap.T @ level) + along @ level
        return np.asarray(noise * np.linalg.norm(response, axis=0))

    return np.concatenate([mean, rest]), noise_std


def _least_squares(rows: Floats, weight: float) -> tuple[Callable[[Floats], Floats], Callable[[Floats], Floats]]:
    """volts (n_meas,) -> u of least |volts - rows u|^2 + weight^2 |u|^2, and that linear map transposed."""
    size = float(np.linalg.norm(rows))
    if weight < ILL * size:  # normal equations would square the condition number
        left, singular, right = np.linalg.svd(rows, full_matrices=False)
        gain = singular / (singular**2 + max(weight, 1e-13 * size) ** 2)
        return lambda volts: (gain * (left.T @ volts)) @ right, lambda b: left @ (gain[:, None] * (right @ b))
    few = len(rows) < rows.shape[1]  # the smaller of two systems with the same solution (push-through identity)
    normal = regularised(rows @ rows.T if few else rows.T @ rows, weight)
    factor = cho_factor(normal, lower=True, overwrite_a=True, check_finite=False)

    def inverse(right: Floats) -> Floats:
        return np.asarray(cho_solve(factor, right, check_finite=False))

    def solve(volts: Floats) -> Floats:
        """With one step of iterative refinement, of which the residual takes no normal equations."""
        if few:
            y = inverse(volts)
            return rows.T @ (y + inverse(volts - rows @ (rows.T @ y) - weight**2 * y))
        u = inverse(rows.T @ volts)
        return u + inverse(rows.T @ (volts - rows @ u) - weight**2 * u)

    return solve, lambda b: inverse(rows @ b) if few else rows @ inverse(b)
