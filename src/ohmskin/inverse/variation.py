"""Total variation: images of few, sharp edges."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.forward import TransferModel
from ohmskin.forward.assembly import stiffness
from ohmskin.geometry import Mesh
from ohmskin.inverse.image import Image, Reconstructor
from ohmskin.inverse.modes import DataSystem, check_positive, check_share, pair_system
from ohmskin.inverse.positivity import noise_gain, nonnegative, penalised
from ohmskin.inverse.priors import triangle_means
from ohmskin.scan import Difference

_ROUNDED = 0.01  # of a jump of the amplitude within one triangle: gradients below this share are rounded off


@dataclass(frozen=True)
class Variation:
    """Total variation of a field that is linear in each triangle, and the quadratic penalty that touches it at a field.

    The integral of the length of the gradient does not know the directions of the mesh's edges; sums over jumps between
    triangles do, and make hexagons of discs.

    Args:
        mesh: The mesh.
        amplitude: Change that counts as a jump (1).
        outline: Length of outline of that change that costs 1 (m).
    """

    mesh: Mesh
    amplitude: float
    outline: float

    @cached_property
    def _step(self) -> float:
        """The slope below which gradients are rounded off (1/m)."""
        edge = float(np.sqrt(np.mean(1 / np.einsum("ekd,ekd->ek", self.mesh.gradients, self.mesh.gradients))))
        return _ROUNDED * self.amplitude / edge

    def _slopes(self, w: Floats) -> Floats:
        """Length of the gradient in each triangle (n_elem,), rounded off (1/m)."""
        gradient = np.einsum("ekd,ek->ed", self.mesh.gradients, w[self.mesh.elements])
        return np.asarray(np.sqrt(np.einsum("ed,ed->e", gradient, gradient) + self._step**2))

    def cost(self, w: Floats) -> float:
        """Of a nodal field (n_nodes,): twice its variation over amplitude times outline, and the ridge."""
        return float(2 * self.mesh.measures @ self._slopes(w) / (self.amplitude * self.outline) + self._ridge @ w**2)

    def matrix(self, w: Floats) -> sp.csc_array:
        """The matrix (n_nodes, n_nodes) of the quadratic penalty with the gradient of `cost` at a nodal field."""
        flat = stiffness(self.mesh, 1 / (self.amplitude * self.outline * self._slopes(w)))
        return sp.csc_array(flat + sp.diags_array(self._ridge))

    @cached_property
    def _ridge(self) -> Floats:
        """A sheet that is all at the amplitude costs one: variation alone leaves the mean free."""
        shares = self.mesh.measures @ triangle_means(self.mesh)
        return np.asarray(shares / (shares.sum() * self.amplitude**2))


@dataclass(eq=False)
class TotalVariation(Reconstructor):
    """Total-variation images: the x that minimises

        |dv - J x|^2 / noise^2 + 2 TV(x) / (amplitude outline).

    Solved by lagged diffusivity (Vogel and Oman 1996): each round is a quadratic problem in the space of the data, the
    gradient of each triangle weighted by its last length.

    Args:
        model: The untouched sheet.
        noise: Standard deviation of a voltage (V).
        amplitude: Relative conductivity change expected (1).
        outline: Length of outlines in the penalty above (m); larger gives more detail. Unless given, it is found for
            each frame by the discrepancy principle: the least variation that fits the data as well as their noise
            allows.
        model_error: Error of the linear model as a share of the root mean square of the data; added to the noise (1).
        positive: Whether the image may be nowhere negative: pressing only raises conductivity.
        rounds: Most rounds for one weight.

    Raises:
        ModelError: If a setting is out of range.
    """

    model: TransferModel
    noise: float
    amplitude: float = 1.0
    outline: float | None = None
    model_error: float = 0.0
    positive: bool = False
    rounds: int = 30

    def __post_init__(self) -> None:
        check_positive(noise=self.noise, amplitude=self.amplitude, rounds=self.rounds)
        check_share(model_error=self.model_error)
        if self.outline is not None:
            check_positive(outline=self.outline)
        self._means = triangle_means(self.model.mesh)
        relative = self.model.pair_sensitivity * self.model.conductivity
        self._relative: Floats = relative @ self._means  # (n_pairs, n_nodes)

    def reconstruct(self, *differences: Difference) -> Image:
        pairs = pair_system(self.model.pairs, *differences)
        noise = pairs.noise(self.noise, self.model_error)
        system = DataSystem(pairs.rows @ self._relative, pairs.volts)
        w = np.zeros(self.model.mesh.n_nodes)
        if self.outline is not None:
            variation = Variation(self.model.mesh, self.amplitude, self.outline)
            w = self._solve(system, noise, variation, w)
        else:
            w, variation = self._by_discrepancy(system, noise, w)

        def noise_std(elements: ArrayLike) -> Floats:
            """With the edges of the image held as they are."""
            return self.noise * noise_gain(
                variation.matrix(w), system.rows, noise, self._means[np.atleast_1d(elements)]
            )

        return Image(self._means @ w, noise_std)

    def _by_discrepancy(self, system: DataSystem, noise: float, w: Floats) -> tuple[Floats, Variation]:
        """Bisection over the logarithm of the outline; each image starts from the last."""
        extent = float(np.ptp(self.model.mesh.nodes, axis=0).max())
        low, high = np.log(1e-6 * extent), np.log(1e1 * extent)
        goal = len(system.volts) * noise**2
        for _ in range(12):
            middle = (low + high) / 2
            variation = Variation(self.model.mesh, self.amplitude, float(np.exp(middle)))
            w = self._solve(system, noise, variation, w)
            if np.sum((system.volts - system.rows @ w) ** 2) > goal:
                low = middle
            else:
                high = middle
        return w, variation

    def _solve(self, system: DataSystem, noise: float, variation: Variation, w: Floats) -> Floats:
        for _ in range(self.rounds):
            matrix, old = variation.matrix(w), w
            if self.positive:
                w = nonnegative(matrix, system.rows, system.volts, noise, w <= 0 if w.any() else None)
            else:
                w = penalised(matrix, system.rows, system.volts, noise)
            if np.abs(w - old).max() < 3e-3 * max(float(np.abs(w).max()), 1e-3 * self.amplitude):
                break
        return w
