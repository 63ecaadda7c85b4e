"""Sparse Bayesian images: as few compact contacts as explain the data."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import cKDTree

from ohmskin.arrays import Floats
from ohmskin.forward import TransferModel
from ohmskin.geometry import Mesh
from ohmskin.inverse.image import Image, Reconstructor
from ohmskin.inverse.modes import check_positive, check_share, pair_system, regularised
from ohmskin.scan import Difference


@dataclass(eq=False)
class SparseBayes(Reconstructor):
    """Sparse Bayesian learning (relevance determination, Tipping 2001; made to converge as in Wipf and Nagarajan 2008).

    An image is a sum of round blobs, one about each triangle, each with a prior variance of its own. The variances are
    learned from the data, which drives all but a few to zero.

    Args:
        model: The untouched sheet.
        noise: Standard deviation of a voltage (V).
        amplitude: Relative conductivity change expected (1), from which learning starts.
        radius: Radius of a blob (m); 5 % of the sheet's longest side unless given.
        model_error: Error of the linear model as a share of the root mean square of the data; added to the noise (1).
        positive: Whether contacts only raise conductivity; blobs that would lower it are dropped.
        rounds: Rounds of learning.

    Raises:
        ModelError: If a setting is out of range.
    """

    model: TransferModel
    noise: float
    amplitude: float = 1.0
    radius: float | None = None
    model_error: float = 0.0
    positive: bool = True
    rounds: int = 60

    def __post_init__(self) -> None:
        if self.radius is None:
            self.radius = 0.05 * float(np.ptp(self.model.mesh.nodes, axis=0).max())
        check_positive(noise=self.noise, amplitude=self.amplitude, radius=self.radius, rounds=self.rounds)
        check_share(model_error=self.model_error)
        self._blobs = blobs(self.model.mesh, self.radius)
        relative = self.model.pair_sensitivity * self.model.conductivity
        self._response: Floats = relative @ self._blobs  # (n_pairs, n_elem)

    def reconstruct(self, *differences: Difference) -> Image:
        pairs = pair_system(self.model.pairs, *differences)
        noise = pairs.noise(self.noise, self.model_error)
        rows = pairs.rows @ self._response
        kept = np.arange(rows.shape[1])
        variance = np.full(len(kept), self.amplitude**2)
        for _ in range(self.rounds):
            some = rows[:, kept]
            factor = _factor(some, variance, noise)
            weights = variance * (some.T @ cho_solve(factor, pairs.volts))
            relevance = np.sqrt(np.einsum("me,me->e", some, cho_solve(factor, some)))
            size = np.maximum(weights, 0.0) if self.positive else np.abs(weights)
            variance = size / relevance
            alive = variance > 1e-6 * max(float(variance.max()), 1e-12 * self.amplitude**2)
            kept, variance = kept[alive], variance[alive]
            if not len(kept):
                break
        return self._image(rows[:, kept], kept, variance, noise, pairs.volts)

    def _image(self, some: Floats, kept: np.ndarray, variance: Floats, noise: float, volts: Floats) -> Image:
        image = self._blobs[:, kept]
        if not len(kept):
            return Image(np.zeros(image.shape[0]), lambda elements: np.zeros(np.size(elements)))
        response = variance[:, None] * cho_solve(_factor(some, variance, noise), some).T  # (n_kept, n_meas)
        weights = response @ volts
        if self.positive:
            weights = np.maximum(weights, 0.0)

        def noise_std(elements: ArrayLike) -> Floats:
            return np.asarray(self.noise * np.linalg.norm(image[np.atleast_1d(elements)] @ response, axis=1))

        return Image(image @ weights, noise_std)


def blobs(mesh: Mesh, radius: float) -> sp.csr_array:
    """Round blobs (n_elem, n_elem), one about each triangle: 1 - (distance / radius)^2, one triangle at least."""
    tree = cKDTree(mesh.centroids)
    near = tree.sparse_distance_matrix(tree, radius, output_type="coo_matrix")
    height = np.maximum(1 - (near.data / radius) ** 2, 0.0)
    shape = (mesh.n_elem, mesh.n_elem)
    blob = sp.csr_array((height, (near.row, near.col)), shape=shape)
    blob.setdiag(1.0)
    return blob


def _factor(rows: Floats, variance: Floats, noise: float) -> tuple[Floats, bool]:
    covariance = regularised((rows * variance) @ rows.T, noise)
    return tuple(cho_factor(covariance, lower=True, overwrite_a=True, check_finite=False))
