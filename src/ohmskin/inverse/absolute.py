"""Iterated Gauss-Newton: images that explain the voltages, with the forward model solved anew in each round."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.forward import TransferModel
from ohmskin.inverse.image import Image
from ohmskin.inverse.modes import DataSystem, check_positive, check_share, pair_system
from ohmskin.inverse.positivity import noise_gain, penalised
from ohmskin.inverse.priors import Prior, paper_laplacian, penalty_of, triangle_means
from ohmskin.inverse.variation import Variation
from ohmskin.scan import Baseline, Difference, Frame

_UNEXPLAINED = 0.1  # of the voltages: more is not what a model that fits leaves


@dataclass(frozen=True)
class _Point:
    """Unknowns (n_unknowns,) of the log conductivity relative to the model's, and what was computed there."""

    w: Floats
    model: TransferModel
    left: Floats
    cost: float


@dataclass(frozen=True)
class Iterations:
    """Course of an iteration.

    Args:
        image: The image.
        costs: Squared residual over the noise's variance plus penalty, at the start and after each round, falling.
        residual: Root mean square residual over the noise.
        converged: Whether it stopped at a minimum that explains the data: to second order, the next step would not
            lower the cost by `tolerance`, and the residual is a tenth of the voltages at most. Data that no
            conductivity explains, such as those of the wrong sign, have a minimum, too.
    """

    image: Image = field(repr=False)
    costs: tuple[float, ...]
    residual: float
    converged: bool


@dataclass(eq=False)
class AbsoluteGaussNewton:
    """Iterated Gauss-Newton on absolute voltages, in log conductivity, so that conductivity stays positive.

    Each round linearises the forward model at the current image (a new factorisation), takes the regularised step in
    the space of the data, and shortens it until the cost falls.

    Args:
        model: The untouched sheet: the start of the iteration, and the reference of relative conductivity.
        noise: Standard deviation of a voltage (V).
        prior: Function from a mesh to the penalty of the log conductivity, or the name of one of `PRIORS`.
        amplitude: Relative conductivity change expected (1).
        outline: Penalise total variation instead, as `TotalVariation` does with this outline (m).
        model_error: Error of the model as a share of the root mean square of the data's change; added to the noise (1).
        baseline: Quiet reference: the model's error for the untouched skin is subtracted from the data.
        rounds: Most rounds.
        tolerance: The iteration ends when a round lowers the cost by less than this share.

    Raises:
        ModelError: If a setting is out of range or the prior is unknown.
    """

    model: TransferModel
    noise: float
    prior: Prior | str = paper_laplacian
    amplitude: float = 1.0
    outline: float | None = None
    model_error: float = 0.0
    baseline: Baseline | None = None
    rounds: int = 12
    tolerance: float = 1e-3

    def __post_init__(self) -> None:
        check_positive(noise=self.noise, amplitude=self.amplitude, tolerance=self.tolerance, rounds=self.rounds)
        check_share(model_error=self.model_error)
        self._cost: Callable[[Floats], float]  # of unknowns (n_unknowns,)
        self._matrix: Callable[[Floats], sp.csc_array]  # of the quadratic penalty that touches it there
        if self.outline is None:
            penalty = penalty_of(self.model, self.prior)
            matrix = sp.csc_array(penalty.normalised / self.amplitude**2)
            self._cost, self._matrix = lambda w: float(w @ (matrix @ w)), lambda w: matrix
            self._means = penalty.image
        else:
            check_positive(outline=self.outline)
            variation = Variation(self.model.mesh, self.amplitude, self.outline)
            self._cost, self._matrix = variation.cost, variation.matrix
            self._means = triangle_means(self.model.mesh)
        self._to_image = sp.eye_array(self.model.mesh.n_elem).tocsr() if self._means is None else self._means

    def reconstruct(self, *frames: Frame | Difference) -> Image:
        """The image of one of the `frames`, or of several fused. Channels that are not finite are left out.

        A change against the untouched skin (`Difference`) is added to the voltages of the model, so that the model's
        error for the untouched skin cancels.

        Raises:
            DataError: If no finite datum is left.
        """
        return self.iterate(*frames).image

    def iterate(self, *frames: Frame | Difference) -> Iterations:
        """The image and the course of the iteration; arguments and errors as for `reconstruct`."""
        data = pair_system(self.model.pairs, *(self._as_absolute(frame) for frame in frames))
        start = np.zeros(self._to_image.shape[1])
        change = self._at(start, data, self.noise).left
        noise = DataSystem(data.rows, change).noise(self.noise, self.model_error)
        point = self._at(start, data, noise)
        costs = [point.cost]
        while True:
            jacobian, matrix = self._jacobian(point, data), self._matrix(point.w)
            wanted = penalised(matrix, jacobian, point.left + jacobian @ point.w, noise)
            left = point.left - jacobian @ (wanted - point.w)
            gain = (point.left @ point.left - left @ left) / noise**2 + point.w @ (matrix @ point.w)
            converged = bool(gain - wanted @ (matrix @ wanted) < self.tolerance * point.cost)
            new = None if converged or len(costs) > self.rounds else self._search(point, wanted, data, noise)
            if new is None:
                break
            point = new
            costs.append(point.cost)
        converged &= bool(np.linalg.norm(point.left) <= _UNEXPLAINED * np.linalg.norm(data.volts))
        residual = float(np.sqrt(np.mean(point.left**2))) / noise
        return Iterations(self._image(point, data, noise), tuple(costs), residual, converged)

    def _as_absolute(self, frame: Frame | Difference) -> Difference:
        """Measured voltages, or those that the model would have, in place of a change."""
        if isinstance(frame, Difference):
            modelled = frame.combination(self.model.pairs) @ self.model.pair_resistances
            return replace(frame, volts=frame.volts + frame.currents * modelled, reference=None)
        modelled = self.model.voltages(frame.pattern)
        offset = 0.0 if self.baseline is None else self.baseline.reference(frame.pattern) - modelled
        currents = frame.measurement_currents
        return Difference(frame.pattern, currents, frame.voltages - currents * offset)

    def _at(self, w: Floats, data: DataSystem, noise: float) -> _Point:
        changed = self.model.conductivity * np.exp(self._to_image @ w)
        model = self.model.with_conductivity(changed) if w.any() else self.model
        left = data.volts - data.rows @ model.pair_resistances
        return _Point(w, model, left, float(left @ left) / noise**2 + self._cost(w))

    def _jacobian(self, point: _Point, data: DataSystem) -> Floats:
        """By the unknowns: (n_meas, n_unknowns) in volts."""
        by_log = point.model.pair_sensitivity * point.model.conductivity
        return np.asarray(data.rows @ (by_log if self._means is None else by_log @ self._means))

    def _search(self, point: _Point, wanted: Floats, data: DataSystem, noise: float) -> _Point | None:
        """The first point on the way to `wanted`, each step half the last, where the cost falls; None if nowhere."""
        way = wanted - point.w
        step = min(1.0, 3.0 / max(float(np.abs(way).max()), 1e-300))  # a factor of twenty in conductivity at most
        for _ in range(8):
            new = self._at(point.w + step * way, data, noise)
            if new.cost < point.cost:
                return new
            step /= 2
        return None

    def _image(self, point: _Point, data: DataSystem, noise: float) -> Image:
        ratio = np.exp(self._to_image @ point.w)

        def noise_std(elements: ArrayLike) -> Floats:
            """By the last linearisation."""
            some = np.atleast_1d(elements)
            penalty, jacobian = self._matrix(point.w), self._jacobian(point, data)
            return np.asarray(self.noise * noise_gain(penalty, jacobian, noise, self._to_image[some]) * ratio[some])

        return Image(ratio - 1, noise_std, logarithmic=True)
