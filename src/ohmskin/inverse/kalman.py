"""Images that follow each other: the Kalman filter, exact, in the coordinates of image modes.

What is outside the modes (`ImageModes`) is never seen by any datum and never correlates with what is, so the filter on
the full image and the one on at most L (L - 1) / 2 modes give the same. Each scan may have another pattern.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from ohmskin.arrays import Floats
from ohmskin.errors import ModelError
from ohmskin.forward import TransferModel
from ohmskin.inverse.image import Image
from ohmskin.inverse.modes import ImageModes, check_positive, check_share, regularised
from ohmskin.inverse.priors import Prior, paper_laplacian, penalty_of
from ohmskin.scan import Difference


@dataclass(frozen=True)
class KalmanState:
    """Mean and covariance of the image. Start with `Kalman.start`.

    Args:
        mean: (n_modes,) mean of the modes.
        covariance: (n_modes, n_modes) of the modes.
        noise: (n_modes, n_modes) covariance of the mean due to measurement noise alone.
        modes: The modes.
    """

    mean: Floats
    covariance: Floats = field(repr=False)
    noise: Floats = field(repr=False)
    modes: ImageModes = field(repr=False)

    @property
    def image(self) -> Image:
        """The mean, as an image."""

        def noise_std(elements: ArrayLike) -> Floats:
            columns = self.modes.modes[:, np.atleast_1d(elements)]
            variance = np.einsum("me,mn,ne->e", columns, self.noise, columns, optimize=True)
            return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

        return Image(self.mean @ self.modes.modes, noise_std)


@dataclass(eq=False)
class Kalman:
    """Kalman filter on images of relative conductivity change.

    Between scans the image decays to the prior (``time_constant``), is a random walk (``walk``), or both.

    Args:
        model: The untouched sheet.
        noise: Standard deviation of a voltage (V).
        prior: Function from a mesh to the penalty, or the name of one of `PRIORS`; also the shape of the changes.
        amplitude: Relative conductivity change expected (1).
        time_constant: Time over which an image is forgotten to 1/e (s); infinite for a pure random walk.
        walk: Standard deviation by which the image wanders in a second (1).
        period: Time between updates unless they say otherwise (s).
        model_error: Error of the linear model as a share of the root mean square of the data; added to the noise (1).

    Raises:
        ModelError: If a setting is out of range or the prior is unknown.
    """

    model: TransferModel
    noise: float
    prior: Prior | str = paper_laplacian
    amplitude: float = 1.0
    time_constant: float = np.inf
    walk: float = 0.0
    period: float = 1.0
    model_error: float = 0.0

    def __post_init__(self) -> None:
        check_positive(noise=self.noise, amplitude=self.amplitude, period=self.period)
        check_share(walk=self.walk, model_error=self.model_error)
        if not self.time_constant > 0:
            raise ModelError(f"time_constant is {self.time_constant!r}; it must be positive (s), or infinite")
        relative = self.model.pair_sensitivity * self.model.conductivity
        self.modes = ImageModes.of_relative(relative, penalty_of(self.model, self.prior), self.model.pairs)

    def start(self) -> KalmanState:
        """The belief before any measurement: the prior."""
        n = self.modes.n_modes
        return KalmanState(np.zeros(n), self.amplitude**2 * np.eye(n), np.zeros((n, n)), self.modes)

    def predict(self, belief: KalmanState, elapsed: float) -> KalmanState:
        """The belief after some time without measurements.

        Args:
            belief: The belief at the last update.
            elapsed: Time since then (s), 0 or more.

        Raises:
            ModelError: If the time is negative.
        """
        check_share(elapsed=elapsed)
        kept = np.exp(-elapsed / self.time_constant)
        added = (1 - kept**2) * self.amplitude**2 + self.walk**2 * elapsed
        covariance = kept**2 * belief.covariance
        covariance[np.diag_indices_from(covariance)] += added
        return KalmanState(kept * belief.mean, covariance, kept**2 * belief.noise, self.modes)

    def update(self, belief: KalmanState, *differences: Difference, elapsed: float | None = None) -> KalmanState:
        """The belief after one more scan, or several taken at once. Channels that are not finite are left out.

        Args:
            belief: The belief at the last update.
            differences: The scans.
            elapsed: Time since the last update (s); ``period`` unless given.

        Raises:
            DataError: If no finite datum is left.
            ModelError: If the time is negative.
        """
        before = self.predict(belief, self.period if elapsed is None else elapsed)
        system = self.modes.system(*differences)
        deviation = system.noise(self.noise, self.model_error)
        system = system.compressed()
        rows, volts = system.rows, system.volts
        cross = rows @ before.covariance
        factor = cho_factor(regularised(cross @ rows.T, deviation), lower=True)
        gain = cho_solve(factor, cross).T
        root = solve_triangular(factor[0], cross, lower=True)
        rest = np.eye(len(before.mean)) - gain @ rows
        covariance = before.covariance - root.T @ root
        mean, noise = before.mean + gain @ (volts - rows @ before.mean), rest @ before.noise @ rest.T
        return KalmanState(mean, (covariance + covariance.T) / 2, noise + self.noise**2 * gain @ gain.T, self.modes)

    def reconstruct(self, *differences: Difference) -> Image:
        """The image of one frame alone, `differences`: that of `GaussNewton.reconstruct`."""
        return self.update(self.start(), *differences, elapsed=0.0).image
