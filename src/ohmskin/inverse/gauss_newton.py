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
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve

from ohmskin.errors import DataError, ModelError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Cells
from ohmskin.geometry.domain import Floats
from ohmskin.inverse.image import Image
from ohmskin.inverse.modes import ImageModes, System, check_positive, check_share, pair_system
from ohmskin.inverse.pixels import Pixels
from ohmskin.inverse.positivity import nonnegative
from ohmskin.inverse.priors import Prior, paper_laplacian, penalty_of
from ohmskin.scan import Difference, DrivePattern

_FRAMES = 4096  # images made at once: enough for products at full speed, little memory


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
        pixels: Pixels to make the image of, with their own prior (eq. 5 read for pixels), instead of one value per triangle:
            then neither the image nor its cost depends on the mesh. `prior` does not count.
        positive: Whether the image may be nowhere negative: pressing only raises conductivity. Costs some ten factorisations
            a frame instead of none.

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
        u, noise_std = self._solve(system)
        if not self.positive:
            return Image(u @ self.modes.modes, noise_std)
        pairs = pair_system(len(self.model.electrodes), *differences)
        rows = pairs.rows @ self._penalty.to_unknowns(self._relative())
        w = nonnegative(self._penalty.normalised, rows, pairs.volts, self._weight(system))
        return Image(self._penalty.to_image(w), noise_std)

    def reconstruct_many(self, pattern: DrivePattern, currents: ArrayLike, volts: ArrayLike, out: NDArray | None = None) -> NDArray:
        """Images (n_frames, n_image) of many scans of one pattern, such as a whole recording; equal to `reconstruct` one by one.

        Frames driven with the same currents share one factorisation, whatever their noise; the images are one product of matrices.

        Args:
            pattern: The pattern that all of them drove.
            currents: Behind each measurement (A): one value, (n_meas,) or (n_frames, n_meas).
            volts: (n_frames, n_meas) changes of voltage (V), see `Difference`. Channels that are not finite are left out.
            out: Where to put the images, (n_frames, n_image) of float32 or float64; float32 unless given.

        Raises:
            DataError: If a shape is wrong, or a frame has no finite datum.
        """
        if self.positive:
            raise ModelError("images nowhere negative have no bulk form; reconstruct() them one by one")
        data = np.asarray(volts, float)
        if data.ndim != 2 or data.shape[1] != pattern.n_meas:
            raise DataError(f"volts have shape {data.shape}; the pattern needs (n_frames, {pattern.n_meas})")
        try:
            amperes = np.broadcast_to(np.asarray(currents, float), data.shape)
        except ValueError:
            raise DataError(f"currents have shape {np.shape(currents)}; they must fit volts {data.shape}") from None
        n_image = self.modes.modes.shape[1]
        images = np.empty((len(data), n_image), np.float32) if out is None else out
        if images.shape != (len(data), n_image):
            raise DataError(f"out has shape {images.shape}; the images need ({len(data)}, {n_image})")
        known = np.isfinite(data) & np.isfinite(amperes)
        alike: dict[bytes, list[int]] = {}
        for k in range(len(data)):
            alike.setdefault(amperes[k].tobytes() + known[k].tobytes(), []).append(k)
        basis = self.modes.modes.astype(images.dtype, copy=False)
        u = np.empty((len(data), len(basis)))
        for frames in alike.values():
            kept = known[frames[0]]
            if not kept.any():
                raise DataError(f"no finite measurement in frame {frames[0]}; leave it out")
            rows = (self.modes.rows(pattern) * amperes[frames[0]][:, None])[kept]
            volts_kept = data[np.ix_(frames, kept)]
            if len(frames) > 1:
                u[frames] = self._solve_many(rows, volts_kept)
            else:
                u[frames[0]] = self._solve(System(rows, volts_kept[0]))[0]
        for start in range(0, len(data), _FRAMES):
            block = slice(start, start + _FRAMES)
            np.matmul(u[block].astype(images.dtype, copy=False), basis, out=images[block])
        return images

    def _weight(self, system: System) -> float:
        return float(np.hypot(self.noise, self.model_error * system.root_mean_square)) / self.amplitude

    def _solve(self, system: System) -> tuple[Floats, Callable[[ArrayLike], Floats]]:
        return solve_modes(self.modes, system, self._weight(system), self.noise)

    def _solve_many(self, rows: Floats, volts: Floats) -> Floats:
        """u (n_frames, n_modes) of frames with the same rows but, because of the model error, each its own noise."""
        left, s, right = np.linalg.svd(rows, full_matrices=False)
        noise2 = self.noise**2 + self.model_error**2 * np.mean(volts**2, axis=1)
        weight2 = np.maximum(noise2 / self.amplitude**2, 1e-14 * float(s @ s))
        return np.asarray((volts @ left * (s / (s**2 + weight2[:, None]))) @ right)

    def _relative(self) -> Floats:
        """Change of two-terminal resistances with the relative change of each value of the image (ohm)."""
        return self.model.pair_sensitivity * self.model.conductivity if self.pixels is None else self.pixels.sensitivity(self.model)


def solve_modes(modes: ImageModes, system: System, weight: float, noise: float) -> tuple[Floats, Callable[[ArrayLike], Floats]]:
    """The u that minimises |volts - rows u|^2 + weight^2 |u|^2, and the standard deviation that noise (V) gives the image."""
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
        response = cho_solve(factor, rows @ some, check_finite=False) if few else rows @ cho_solve(factor, some, check_finite=False)
        std: Floats = noise * np.linalg.norm(response, axis=0)
        return std

    return u, noise_std
