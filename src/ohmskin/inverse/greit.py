"""GREIT: an image matrix trained so that small targets look alike wherever they are (Adler et al. 2009)."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.distance import cdist

from ohmskin.arrays import Floats
from ohmskin.errors import DataError, ModelError
from ohmskin.forward import TransferModel
from ohmskin.geometry.overlap import disc_overlap
from ohmskin.inverse.choice import noise_figures
from ohmskin.inverse.gauss_newton import solve_modes
from ohmskin.inverse.image import Image
from ohmskin.inverse.modes import ImageModes, check_positive
from ohmskin.scan import Difference

_TARGET = 0.05  # radius of the targets, as a share of the sheet's longest side
_BLUR = 3.0  # radius of what they should look like, over theirs
_SPACING = 0.5  # distance between targets, over their radius


@dataclass(eq=False)
class Greit:
    """GREIT images on the triangles of any domain; put them on a `Raster` for pixels.

    The matrix that brings the training targets closest to their desired images, noise considered, is Y D^T (D D^T +
    w^2 I)^-1. D and Y are trained once in pair coordinates; for each pattern w is set to give the required noise
    figure.

    Args:
        model: The untouched sheet.
        noise: Standard deviation of a voltage (V); only for the image's ``noise_std``.
        noise_figure: Signal-to-noise ratio of the data over that of the image, for a small target in the middle.

    Attributes:
        responses: (n_pairs, n_targets) change of two-terminal resistances due to each training target (ohm).
        desired: (n_elem, n_targets) desired image of each target.

    Raises:
        ModelError: If a setting is out of range.
    """

    model: TransferModel
    noise: float
    noise_figure: float = 1.0

    def __post_init__(self) -> None:
        check_positive(noise=self.noise, noise_figure=self.noise_figure)
        self.responses, self.desired = train(self.model)
        basis, triangle = np.linalg.qr(self.responses.T)
        self.modes = ImageModes(basis.T @ self.desired.T, triangle.T.copy(), self.model.pairs)
        self._weights: dict[object, float] = {}

    def reconstruct(self, *differences: Difference) -> Image:
        """The image of one scan, or of several fused; arguments as of `GaussNewton.reconstruct`.

        Raises:
            DataError: If no finite datum is left, or the scans do not all have the same current.
            ModelError: If the noise figure cannot be reached with these scans; the message says which can.
        """
        system = self.modes.system(*differences)
        unknowns, noise_std = solve_modes(self.modes, system, self.weight(differences), self.noise)
        return Image(unknowns @ self.modes.modes, noise_std)

    def weight(self, differences: tuple[Difference, ...]) -> float:
        """The regularisation with the wanted noise figure, remembered by pattern, currents and channels.

        Arguments and errors as of `reconstruct`.
        """
        known = tuple((np.isfinite(d.volts) & np.isfinite(d.currents)).tobytes() for d in differences)
        currents = tuple(np.round(d.currents, 12).tobytes() for d in differences)
        key = (tuple(d.pattern for d in differences), known, currents)
        if key in self._weights:
            return self._weights[key]
        left, singular, right = np.linalg.svd(self.modes.system(*differences).rows, full_matrices=False)
        if not singular[0] > 0:
            raise DataError("the scan drives no current; there is nothing to make an image of")
        figure = noise_figures(self.model, self.modes, (left, singular, right), differences)
        weights = singular[0] * np.geomspace(1e2, 1e-6, 33)
        figures = figure(weights)
        above = figures > self.noise_figure
        if above[0] or not above.any():
            choices = f"{figures[0]:.3g} to {figures.max():.3g}"
            raise ModelError(f"noise figure {self.noise_figure:g} cannot be reached with this scan; choose {choices}")
        k = int(np.argmax(above))
        inside = np.log(weights[k]), np.log(weights[k - 1])
        weight = float(np.exp(brentq(lambda weight: figure(np.exp(weight))[0] - self.noise_figure, *inside)))
        if len(self._weights) >= 64:
            self._weights.clear()
        self._weights[key] = weight
        return weight


def train(model: TransferModel) -> tuple[Floats, Floats]:
    """Targets on a grid over the sheet: what they do to the data, and how they should look, smooth and all alike.

    The integral of the round blob that a target should look like is the target's.

    Returns:
        (n_pairs, n_targets) what each does to the electrode pairs (ohm); (n_elem, n_targets) how each should look.
    """
    mesh = model.mesh
    radius = _TARGET * float(np.ptp(mesh.nodes, axis=0).max())
    steps = np.round((mesh.centroids - mesh.nodes.min(axis=0)) / (_SPACING * radius)).astype(int)
    _, chosen = np.unique(steps, axis=0, return_index=True)  # one place for each cell of the grid on the sheet
    cover = disc_overlap(mesh, mesh.centroids[chosen], radius)
    responses = (cover @ (model.pair_sensitivity * (model.conductivity / mesh.measures)).T).T
    distance = cdist(mesh.centroids, mesh.centroids[chosen]) / (_BLUR * radius)
    blobs = np.where(distance < 1, 0.5 * (1 + np.cos(np.pi * distance)), 0.0)
    place, element = cover.nonzero()  # a mesh coarser than the blob still has something to show
    blobs[element, place] = np.maximum(blobs[element, place], 1e-12)
    return responses, blobs * (cover.sum(axis=1) / (mesh.measures @ blobs))
