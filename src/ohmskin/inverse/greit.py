"""GREIT: an image matrix trained so that small targets look alike wherever they are (Adler et al. 2009)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import DataError, ModelError
from ohmskin.forward import TransferModel
from ohmskin.geometry.overlap import disc_overlap
from ohmskin.inverse.choice import noise_figures, signal_of, small_target
from ohmskin.inverse.gauss_newton import solve_modes
from ohmskin.inverse.image import Image
from ohmskin.inverse.modes import ImageModes, check_positive
from ohmskin.scan import Difference


@dataclass(frozen=True)
class Training:
    """What GREIT is trained on.

    Args:
        places: (n_targets, dim) centres of the targets (m).
        responses: (n_pairs, n_targets) what each does to the electrode pairs (ohm).
        desired: (n_elem, n_targets) how each should look.
    """

    places: Floats
    responses: Floats
    desired: Floats


class Greit:
    """GREIT images on the triangles of any domain; put them on a `Raster` for pixels.

    The matrix that brings the training targets closest to their desired images, noise considered, is Y D^T (D D^T +
    w^2 I)^-1. D and Y are trained once in pair coordinates; w is set for each pattern for the noise figure wanted.

    Args:
        model: The untouched sheet.
        noise: Standard deviation of a voltage (V); only for the image's ``noise_std``.
        noise_figure: Signal-to-noise ratio of the data over that of the image, for a small target in the middle.
        target_radius: Radius of the targets (m); 5 % of the sheet's longest side unless given.
        blur: Radius of the desired round blob over that of the target. The integral stays the target's.
        spacing: Distance between targets (m); half a target's radius unless given.

    Raises:
        ModelError: If a setting is out of range.
    """

    def __init__(
        self,
        model: TransferModel,
        noise: float,
        noise_figure: float = 1.0,
        target_radius: float | None = None,
        blur: float = 3.0,
        spacing: float | None = None,
    ) -> None:
        extent = float(np.ptp(model.mesh.nodes, axis=0).max())
        target_radius = 0.05 * extent if target_radius is None else target_radius
        spacing = 0.5 * target_radius if spacing is None else spacing
        check_positive(noise=noise, noise_figure=noise_figure, target_radius=target_radius, blur=blur, spacing=spacing)
        if blur < 1:
            raise ModelError(f"blur is {blur}; no image is sharper than its target, so it must be at least 1")
        self.model, self.noise, self.noise_figure = model, noise, noise_figure
        self.training = train(model, target_radius, blur, spacing)
        seen, desired = self.training.responses, self.training.desired
        self.modes = ImageModes.of_products(seen @ desired.T, seen @ seen.T, len(model.electrodes))
        self._weights: dict[object, float] = {}

    def reconstruct(self, *differences: Difference) -> Image:
        """The image of one scan, or of several fused. Channels that are not finite are left out.

        Raises:
            DataError: If no finite datum is left, or the scans do not all have the same current.
            ModelError: If the noise figure cannot be had with these scans; the message says which can.
        """
        system = self.modes.system(*differences)
        u, noise_std = solve_modes(self.modes, system, self._weight(differences), self.noise)
        return Image(u @ self.modes.modes, noise_std)

    def _weight(self, differences: tuple[Difference, ...]) -> float:
        """The regularisation with the wanted noise figure, remembered by pattern, currents and channels."""
        known = tuple((np.isfinite(d.volts) & np.isfinite(d.currents)).tobytes() for d in differences)
        currents = tuple(np.round(d.currents, 12).tobytes() for d in differences)
        key = (tuple(d.pattern for d in differences), known, currents)
        if key not in self._weights:
            if len(self._weights) >= 64:
                self._weights.clear()
            self._weights[key] = self._find_weight(differences)
        return self._weights[key]

    def _find_weight(self, differences: tuple[Difference, ...]) -> float:
        left, singular, right = np.linalg.svd(self.modes.system(*differences).rows, full_matrices=False)
        if not singular[0] > 0:
            raise DataError("the scan drives no current; there is nothing to make an image of")
        signal = signal_of(self.model, small_target(self.model.mesh), differences)

        def figure(weight: ArrayLike) -> Floats:
            areas = self.model.mesh.measures
            return noise_figures(self.modes, left, singular, right, signal, areas, np.atleast_1d(weight))

        weights = singular[0] * np.geomspace(1e2, 1e-6, 33)
        figures = figure(weights)
        above = figures > self.noise_figure
        if above[0] or not above.any():
            choices = f"{figures[0]:.3g} to {figures.max():.3g}"
            raise ModelError(f"noise figure {self.noise_figure:g} cannot be had with this scan; choose {choices}")
        k = int(np.argmax(above))
        high, low = np.log(weights[k - 1]), np.log(weights[k])
        for _ in range(40):
            middle = (high + low) / 2
            if figure(np.exp(middle))[0] > self.noise_figure:
                low = middle
            else:
                high = middle
        return float(np.exp((high + low) / 2))


def train(model: TransferModel, radius: float, blur: float, spacing: float) -> Training:
    """Targets on a grid over the sheet, what they do to the data, and how they should look: smooth, all alike."""
    mesh = model.mesh
    steps = np.round((mesh.centroids - mesh.nodes.min(axis=0)) / spacing).astype(int)
    _, chosen = np.unique(steps, axis=0, return_index=True)  # one place for each cell of the grid on the sheet
    places = mesh.centroids[chosen]
    cover = disc_overlap(mesh, places, radius)
    responses = (cover @ (model.pair_sensitivity * (model.conductivity / mesh.measures)).T).T
    desired, wide = np.empty((mesh.n_elem, len(places))), blur * radius
    for k, place in enumerate(places):
        elements = cover.indices[cover.indptr[k] : cover.indptr[k + 1]]
        distance = np.linalg.norm(mesh.centroids - place, axis=1) / wide
        blob = np.where(distance < 1, 0.5 * (1 + np.cos(np.pi * np.minimum(distance, 1.0))), 0.0)
        blob[elements] = np.maximum(blob[elements], 1e-12)  # a mesh coarser than the blob still has something to show
        desired[:, k] = blob * cover.data[cover.indptr[k] : cover.indptr[k + 1]].sum() / (blob @ mesh.measures)
    return Training(places, responses, desired)
