"""Iterated Gauss-Newton: images that explain the voltages, with the forward model solved anew in each round."""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import DataError, ModelError
from ohmskin.forward import TransferModel
from ohmskin.forward.assembly import factorise
from ohmskin.inverse.image import Image
from ohmskin.inverse.modes import check_positive, check_share
from ohmskin.inverse.positivity import penalised
from ohmskin.inverse.priors import Penalty, Prior, paper_laplacian, penalty_of, triangle_means
from ohmskin.inverse.variation import Variation
from ohmskin.scan import Baseline, Difference, Frame


class _Quadratic:
    """A quadratic penalty in the form of `Variation`."""

    def __init__(self, penalty: Penalty, amplitude: float) -> None:
        self._matrix = sp.csc_array(penalty.normalised / amplitude**2)

    def cost(self, w: Floats) -> float:
        return float(w @ (self._matrix @ w))

    def matrix(self, w: Floats) -> sp.csc_array:
        return self._matrix


@dataclass(frozen=True)
class _Point:
    """Unknowns (n_unknowns,) of the log conductivity relative to the model's, and what was computed there."""

    w: Floats
    model: TransferModel
    left: Floats
    cost: float


@dataclass(frozen=True)
class Iterations:
    """How an iteration went.

    Args:
        image: The image.
        costs: Squared residual over the noise's variance plus penalty, at the start and after each round, falling.
        residual: Root mean square of what is left of the data, over the noise.
        converged: Whether it stopped because nothing changed any more.
    """

    image: Image = field(repr=False)
    costs: tuple[float, ...]
    residual: float
    converged: bool


class AbsoluteGaussNewton:
    """Iterated Gauss-Newton on absolute voltages, in log conductivity, so that conductivity stays positive.

    Each round linearises the forward model where it stands (a new factorisation), takes the regularised step in the
    space of the data, and shortens it until the cost falls.

    Args:
        model: The untouched sheet, from which it starts and by whose conductivity images are relative.
        noise: Standard deviation of a voltage (V).
        prior: Function from a mesh to the penalty of the log conductivity, or the name of one of `PRIORS`.
        amplitude: Relative conductivity change expected (1).
        outline: Penalise total variation instead, as `TotalVariation` does with this outline (m).
        model_error: Error of the model as a share of the root mean square of the data's change; added to the noise (1).
        baseline: Quiet reference: what the model gets wrong of the untouched skin is taken off the data.
        rounds: Most rounds.
        tolerance: Share by which a round must lower the cost to go on.

    Raises:
        ModelError: If a setting is out of range or the prior is unknown.
    """

    def __init__(
        self,
        model: TransferModel,
        noise: float,
        prior: Prior | str = paper_laplacian,
        amplitude: float = 1.0,
        outline: float | None = None,
        model_error: float = 0.0,
        baseline: Baseline | None = None,
        rounds: int = 12,
        tolerance: float = 1e-3,
    ) -> None:
        check_positive(noise=noise, amplitude=amplitude, tolerance=tolerance)
        check_share(model_error=model_error)
        if rounds < 1:
            raise ModelError(f"rounds is {rounds}; it must be at least 1")
        self.model, self.noise, self.amplitude, self.model_error = model, noise, amplitude, model_error
        self.baseline, self.rounds, self.tolerance = baseline, rounds, tolerance
        self._to_image: sp.csr_array | None
        self._penalty: _Quadratic | Variation
        if outline is None:
            penalty = penalty_of(model, prior)
            self._to_image, self._penalty = penalty.image, _Quadratic(penalty, amplitude)
        else:
            check_positive(outline=outline)
            self._to_image, self._penalty = triangle_means(model.mesh), Variation(model.mesh, amplitude, outline)

    def reconstruct(self, *frames: Frame | Difference) -> Image:
        """The image of one frame, or of several fused. Channels that are not finite are left out.

        A change against the untouched skin stands for the voltages that the model would have with it: what the model
        gets wrong of the untouched skin cancels.

        Raises:
            DataError: If no finite datum is left.
        """
        return self.iterate(*frames).image

    def iterate(self, *frames: Frame | Difference) -> Iterations:
        """The image of one frame, or of several fused, with how it was reached.

        Raises:
            DataError: If no finite datum is left.
        """
        rows, volts = self._equations(frames)
        start = np.zeros(self.model.mesh.n_elem if self._to_image is None else self._to_image.shape[1])
        change = self._at(start, rows, volts, self.noise).left
        noise = float(np.hypot(self.noise, self.model_error * np.sqrt(np.mean(change**2))))
        point = self._at(start, rows, volts, noise)
        costs, converged = [point.cost], False
        for _ in range(self.rounds):
            jacobian = self._jacobian(point, rows)
            wanted = penalised(self._penalty.matrix(point.w), jacobian, point.left + jacobian @ point.w, noise)
            new = self._search(point, wanted, rows, volts, noise)
            if new is None:
                converged = True
                break
            point, gain = new, point.cost - new.cost
            costs.append(point.cost)
            if gain < self.tolerance * costs[-1]:
                converged = True
                break
        residual = float(np.sqrt(np.mean(point.left**2))) / noise
        return Iterations(self._image(point, rows, noise), tuple(costs), residual, converged)

    def _equations(self, frames: tuple[Frame | Difference, ...]) -> tuple[Floats, Floats]:
        """Rows (n_meas, n_pairs) in amperes that make voltages of pair resistances, and voltages (n_meas,)."""
        if not frames:
            raise DataError("no frame to make an image of; give at least one")
        rows, volts = [], []
        for frame in frames:
            modelled = self.model.voltages(frame.pattern)
            if isinstance(frame, Difference):
                currents, measured = frame.currents, frame.volts + frame.currents * modelled
            else:
                currents = frame.currents[frame.pattern.measurements[:, 0]]
                offset = 0.0 if self.baseline is None else self.baseline.reference(frame.pattern) - modelled
                measured = frame.voltages - currents * offset
            rows.append(frame.pattern.combination(len(self.model.electrodes)).toarray() * currents[:, None])
            volts.append(measured)
        stacked, data = np.vstack(rows), np.concatenate(volts)
        known = np.isfinite(data) & np.isfinite(stacked).all(axis=1)
        if not known.any():
            raise DataError("no finite measurement in the frame; check the device, or that the voltages do not clip")
        stacked, data = stacked[known], data[known]
        if len(stacked) > stacked.shape[1]:
            basis, stacked = np.linalg.qr(stacked)
            data = basis.T @ data
        return stacked, data

    def _change(self, w: Floats) -> Floats:
        """Log conductivity (n_elem,) relative to the model's."""
        return w if self._to_image is None else np.asarray(self._to_image @ w)

    def _at(self, w: Floats, rows: Floats, volts: Floats, noise: float) -> _Point:
        changed = self.model.conductivity * np.exp(self._change(w))
        model = self.model.with_conductivity(changed) if w.any() else self.model
        left = volts - rows @ pair_resistances(model)
        return _Point(w, model, left, float(left @ left) / noise**2 + self._penalty.cost(w))

    def _jacobian(self, point: _Point, rows: Floats) -> Floats:
        """By the unknowns: (n_meas, n_unknowns) in volts."""
        by_log = point.model.pair_sensitivity * point.model.conductivity
        return np.asarray(rows @ (by_log if self._to_image is None else by_log @ self._to_image))

    def _search(self, point: _Point, wanted: Floats, rows: Floats, volts: Floats, noise: float) -> _Point | None:
        """The first point on the way to `wanted`, each step half the last, where the cost falls; None if nowhere."""
        way = wanted - point.w
        step = min(1.0, 3.0 / max(float(np.abs(way).max()), 1e-300))  # a factor of twenty in conductivity at most
        for _ in range(8):
            new = self._at(point.w + step * way, rows, volts, noise)
            if new.cost < point.cost:
                return new
            step /= 2
        return None

    def _image(self, point: _Point, rows: Floats, noise: float) -> Image:
        ratio = np.exp(self._change(point.w))

        def noise_std(elements: ArrayLike) -> Floats:
            """By the last linearisation."""
            chosen = np.atleast_1d(elements)
            jacobian = self._jacobian(point, rows)
            smoothed = factorise(self._penalty.matrix(point.w)).solve(np.ascontiguousarray(jacobian.T))
            normal = jacobian @ smoothed
            normal[np.diag_indices_from(normal)] += max(noise**2, 1e-14 * normal.trace())
            response = np.linalg.solve(normal, self._change(smoothed)[chosen].T)
            return np.asarray(self.noise * np.linalg.norm(response, axis=0) * ratio[chosen])

        return Image(ratio - 1, noise_std, logarithmic=True)


def pair_resistances(model: TransferModel) -> Floats:
    """Two-terminal resistances (n_pairs,) of all electrode pairs (ohm)."""
    s = model.transfer_resistance
    i, j = np.triu_indices(len(s), k=1)
    return np.asarray(s[i, i] + s[j, j] - s[i, j] - s[j, i])
