"""Contacts fitted to the data themselves: one or several discs with position, radius, strength and their covariances."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.errors import ModelError
from ohmskin.forward import TransferModel
from ohmskin.geometry.domain import Floats
from ohmskin.inverse.discs import DiscResponse, effective_change
from ohmskin.inverse.image import Image
from ohmskin.inverse.modes import System, check_positive, check_share, pair_system
from ohmskin.scan import Difference


@dataclass(frozen=True)
class DiscContact:
    """One contact as the data have it.

    Args:
        position: (dim,) in metres.
        radius: In metres.
        strength: Relative conductivity change inside (1), above -1.
        covariance: (dim + 2, dim + 2) of position (m), radius (m) and strength.
    """

    position: Floats
    radius: float
    strength: float
    covariance: Floats = field(repr=False)

    @property
    def std(self) -> Floats:
        """Standard deviations (dim + 2,) of position (m), radius (m) and strength."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def area(self) -> float:
        """In square metres."""
        return float(np.pi * self.radius**2)


@dataclass(frozen=True)
class ContactFit:
    """Contacts that explain the data best.

    Args:
        contacts: Strongest first (strength times area).
        chi_square: Squared residuals over the noise's variance; about `n_data` less the parameters when all is explained.
        n_data: Number of independent data.
        criteria: The information criterion of 0, 1, 2, ... contacts as far as tried; the lowest was taken. Infinite where the
            weakest contact is too weak to count.
        covariance: (n_params, n_params) of all contacts together: position, radius, strength of the first, the second, ...
        image: The contacts, drawn.
    """

    contacts: tuple[DiscContact, ...]
    chi_square: float
    n_data: int
    criteria: tuple[float, ...]
    covariance: Floats = field(repr=False)
    image: Image = field(repr=False)


@dataclass(frozen=True)
class _State:
    """Parameters (n_discs, dim + 2): position, log radius, log conductivity ratio; residuals and slopes, prior included."""

    params: Floats
    residual: Floats
    slopes: Floats
    chi_square: float

    @property
    def cost(self) -> float:
        return float(self.residual @ self.residual)


class DiscFit:
    """Fits discs to the data by Levenberg-Marquardt, and says how many there are.

    A disc more is sought where it explains most of what is left of the data, or by splitting one that is there; it stays if it
    lowers the Bayesian information criterion and is not too weak. Small discs act on the data by strength times area; the
    prior of the radius settles the rest, and the covariances say so.

    Args:
        model: The untouched sheet.
        noise: Standard deviation of a voltage (V).
        radius: Radius expected (m); 5 % of the sheet's longest side unless given.
        radius_factor: Factor by which radii may well differ from it (one standard deviation; above 1).
        ratio_factor: Factor by which the conductivity in a contact may well differ from the sheet's (above 1).
        most: Most contacts to look for.
        count: Exact number of contacts, if it is known.
        fraction: Least effect of a contact (effective change times area) as a share of the strongest's; keeps out what the model
            gets wrong of a strong one.
        model_error: Error of the model as a share of the root mean square of the data; added to the noise (1).
        positive: Whether contacts only raise conductivity.

    Raises:
        ModelError: If a setting is out of range.
    """

    def __init__(
        self,
        model: TransferModel,
        noise: float,
        radius: float | None = None,
        radius_factor: float = 1.5,
        ratio_factor: float = 3.0,
        most: int = 4,
        count: int | None = None,
        fraction: float = 0.1,
        model_error: float = 0.0,
        positive: bool = True,
    ) -> None:
        radius = 0.05 * float(np.ptp(model.mesh.nodes, axis=0).max()) if radius is None else radius
        check_positive(noise=noise, radius=radius)
        check_share(model_error=model_error, fraction=fraction)
        for name, value in (("radius_factor", radius_factor), ("ratio_factor", ratio_factor)):
            if not (np.isfinite(value) and value > 1):
                raise ModelError(f"{name} is {value!r}; it must be finite and above 1")
        if (count is not None and count < 1) or most < 1:
            raise ModelError(f"cannot look for {count if count is not None else most} contacts; at least 1")
        self.model, self.noise, self.radius, self.model_error, self.positive = model, noise, radius, model_error, positive
        self.most, self.count, self.fraction = most if count is None else count, count, fraction
        self._response = DiscResponse(model)
        self._spread = np.log([radius_factor, ratio_factor])
        self._candidates = self._response.at_triangles(radius)

    def reconstruct(self, *differences: Difference) -> Image:
        """The contacts of one scan, or of several fused, drawn as an image.

        Raises:
            DataError: If no finite datum is left.
        """
        return self.fit(*differences).image

    def fit(self, *differences: Difference) -> ContactFit:
        """The contacts of one scan, or of several fused. Channels that are not finite are left out.

        Raises:
            DataError: If no finite datum is left.
        """
        pairs = pair_system(len(self.model.electrodes), *differences)
        noise = float(np.hypot(self.noise, self.model_error * pairs.root_mean_square))
        system = System(pairs.rows / noise, pairs.volts / noise)
        dim = self.model.mesh.nodes.shape[1]
        best = self._linearise(system, np.empty((0, dim + 2)))
        states, criteria = [best], [best.cost]
        for number in range(1, self.most + 1):
            best = min((self._refine(system, start) for start in self._starts(system, states[-1])), key=lambda state: state.cost)
            states.append(best)
            criteria.append(best.cost + number * (dim + 1) * np.log(len(system.volts)))
            effects = np.abs(effective_change(best.params[:, -1], self._response.dim)[0]) * np.exp(
                self._response.dim * best.params[:, -2]
            )
            if effects.min() < self.fraction * effects.max():
                criteria[-1] = np.inf
            if self.count is None and criteria[-1] > criteria[-2]:
                break
        return self._result(system, states[int(np.argmin(criteria)) if self.count is None else self.count], tuple(criteria))

    def _starts(self, system: System, state: _State) -> list[Floats]:
        """Parameters to start from for one disc more."""
        left = state.residual[: len(system.volts)]
        columns = system.rows @ self._candidates
        power = np.einsum("me,me->e", columns, columns)
        change = (left @ columns) / np.maximum(power, 1e-12 * power.max())
        gain = np.where(change > 0, change, 0.0 if self.positive else change) ** 2 * power
        best = int(np.argmax(gain))
        place, dim = self.model.mesh.centroids[best], self._response.dim
        start = np.array([[*place, np.log(self.radius), self._log_ratio(float(change[best]), dim)]])
        starts = [np.vstack([state.params, start])]
        for k, disc in enumerate(state.params):
            others = np.delete(state.params, k, axis=0)
            for axis in np.eye(len(place)):
                pair = np.stack([disc, disc])
                pair[:, : len(place)] += np.outer([1, -1], axis) * np.exp(disc[-2])
                pair[:, -1] = self._log_ratio(float(effective_change(disc[-1], dim)[0]) / 2, dim)
                starts.append(np.vstack([others, pair]))
        return starts

    @staticmethod
    def _log_ratio(change: float, dim: int) -> float:
        """The log of the conductivity ratio with an effective change, within bounds that keep it sensible."""
        e = float(np.clip(change, -0.9, 0.9 * dim))
        return float(np.log((dim + (dim - 1) * e) / (dim - e)))

    def _linearise(self, system: System, params: Floats) -> _State:
        """Residuals (n_data + 2 n_discs,) and slopes (.., n_discs (dim + 2)) by the parameters."""
        n, width = params.shape
        left, slopes = system.volts.copy(), np.zeros((len(left := system.volts.copy()) + 2 * n, n * width))
        prior = np.empty(2 * n)
        for k, disc in enumerate(params):
            change, derivatives = self._response(disc[:-2], float(np.exp(disc[-2])), float(disc[-1]))
            left -= system.rows @ change
            slopes[: len(left), k * width : (k + 1) * width] = system.rows @ derivatives
            prior[2 * k : 2 * k + 2] = -(disc[-2:] - [np.log(self.radius), 0.0]) / self._spread
            for j in range(2):
                slopes[len(left) + 2 * k + j, (k + 1) * width - 2 + j] = 1 / self._spread[j]
        return _State(params, np.concatenate([left, prior]), slopes, float(left @ left))

    def _refine(self, system: System, params: Floats, rounds: int = 40) -> _State:
        state, damping = self._linearise(system, params), 1e-2
        dim = params.shape[1] - 2
        for _ in range(rounds):
            normal, gradient = state.slopes.T @ state.slopes, state.slopes.T @ state.residual
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), gradient).reshape(params.shape)
            step[:, :dim] *= np.minimum(1.0, self.radius / np.maximum(np.linalg.norm(step[:, :dim], axis=1, keepdims=True), 1e-300))
            step[:, dim:] = np.clip(step[:, dim:], -0.5, 0.5)
            moved = state.params + step
            moved[:, :dim] = [self._response.discs.onto(place) for place in moved[:, :dim]]
            if self.positive:
                moved[:, -1] = np.maximum(moved[:, -1], 1e-6)
            trial = self._linearise(system, moved)
            gain = state.cost - trial.cost
            if gain > 0:
                state, damping = trial, damping / 5
                if gain < 1e-4:
                    break
            else:
                damping *= 6
                if damping > 1e6:
                    break
        return state

    def _result(self, system: System, state: _State, criteria: tuple[float, ...]) -> ContactFit:
        n, width = state.params.shape
        strength, radius = np.expm1(state.params[:, -1]), np.exp(state.params[:, -2])
        order = np.argsort(-np.abs(strength) * radius**2)
        scale = np.ones((n, width))
        scale[:, -2], scale[:, -1] = radius, 1 + strength
        inverse = _inverse(state.slopes.T @ state.slopes)
        covariance = inverse * np.outer(scale.ravel(), scale.ravel())
        place = (order[:, None] * width + np.arange(width)).ravel()
        covariance = covariance[np.ix_(place, place)]
        blocks = [slice(k * width, (k + 1) * width) for k in range(n)]
        contacts = tuple(
            DiscContact(state.params[k, :-2].copy(), float(radius[k]), float(strength[k]), covariance[block, block])
            for k, block in zip(order, blocks, strict=True)
        )
        return ContactFit(contacts, state.chi_square, len(system.volts), criteria, covariance, self._draw(contacts, covariance))

    def _draw(self, contacts: tuple[DiscContact, ...], covariance: Floats) -> Image:
        if not contacts:
            return Image(np.zeros(self.model.mesh.n_elem), lambda elements: np.zeros(np.size(elements)))

        def draw(shift: Floats) -> Floats:
            params = [np.array([*c.position, c.radius, c.strength]) for c in contacts]
            moved = np.reshape(params, (len(contacts), -1)) + shift.reshape(len(contacts), -1)
            return self._response.image(moved[:, :-2], np.maximum(moved[:, -2], 1e-9), moved[:, -1])

        values = draw(np.zeros(len(covariance)))

        def noise_std(elements: ArrayLike) -> Floats:
            """First order, by differences of a tenth of a standard deviation."""
            std = np.sqrt(np.diag(covariance))
            step = 0.1 * np.maximum(std, 1e-12)
            slopes = [(draw(row) - draw(-row))[np.atleast_1d(elements)] / (2 * np.sum(row)) for row in np.diag(step)]
            return np.asarray(np.sqrt(np.einsum("pe,pq,qe->e", slopes, covariance, slopes)))

        return Image(values, noise_std)


def _inverse(normal: Floats) -> Floats:
    """Inverse of a normal matrix; zero in directions that parameters cannot take, such as off a curved surface."""
    scale = np.sqrt(np.diag(normal))
    scale = np.where(scale > 0, scale, 1.0)
    inverse: Floats = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)
    return inverse
