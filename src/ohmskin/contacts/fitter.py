"""Contacts straight from data, in milliseconds: find the place that explains most, refine, look again.

Whether there is one contact more is a test, not a threshold on an image. At each of a set of places, the score of a
further contact there is compared with its noise (a generalised likelihood-ratio test); the bar is set by the rate of
false alarms accepted, summed over all places (Bonferroni: the true rate is lower, as neighbouring places are alike).
"""

from math import erf, sqrt

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import cKDTree
from scipy.special import ndtri

from ohmskin.arrays import Floats
from ohmskin.contacts.finder import Contact
from ohmskin.contacts.likelihood import Data, NoiseModel, no_directions, responses
from ohmskin.contacts.solution import Solution, effect_std, nothing, unknown
from ohmskin.errors import ModelError
from ohmskin.forward import ContactTable
from ohmskin.inverse.modes import check_positive, check_share
from ohmskin.scan import Difference

_LEAST, _MOST = 0.1, 4.0  # squared radius that a fit may take, as shares of the usual one; the table ends there
SQUARE_STD = 0.75  # prior standard deviation of the squared radius, likewise
_ENOUGH = 0.02  # gain in squared misfit below which a fit stops: a seventh of a standard deviation
_STARTS, _PROMISE = 3, 0.7  # places from which a fit starts, and the share of the best score that makes one worth it
_BLUR = 2.0  # radii times the model's error: how far that may move a contact
FAINT = 3.0  # standard deviations of its effect below which a contact is none
_HALO = 8  # places around a contact where the model of it may err
_ANGLES = np.arange(_HALO) * 2 * np.pi / _HALO
_DIRECTIONS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])


class ContactFitter:
    """Explains data by contacts.

    Args:
        table: Responses of contacts.
        noise: Standard deviation of a difference of voltages (V).
        model_error: How far the model of a contact errs, as a share of its signal (1).
        false_alarms: Rate at which quiet data may be taken for a contact.
        false_twos: Rate at which one contact may be taken for two.
        most: Most contacts to look for.
        bipolar: Whether contacts may lower the conductivity, too.

    Attributes:
        places: (n_places, 2) where new contacts are looked for (m).
        bar: Standard deviations by which the score of a new contact must stand out.
        split_bar: By how much two contacts must explain data better than one, in units of the noise's variance.
        squares: Least and largest squared radius (m2).

    Raises:
        ModelError: If a setting is out of range.
    """

    def __init__(
        self,
        table: ContactTable,
        noise: float,
        model_error: float = 0.05,
        false_alarms: float = 1e-6,
        false_twos: float = 1e-2,
        most: int = 6,
        bipolar: bool = False,
    ) -> None:
        check_positive(noise=noise)
        check_share(model_error=model_error)
        for name, rate in (("false_alarms", false_alarms), ("false_twos", false_twos)):
            if not 0 < rate < 1:
                raise ModelError(f"{name} is {rate!r}; it must be a rate above 0 and below 1")
        if most < 1:
            raise ModelError(f"cannot look for {most} contacts; at least 1")
        self.table, self.noise, self.model_error, self.bipolar, self.most = table, noise, model_error, bipolar, most
        chosen = _spaced(table.places, 1.25 * table.radius)
        self.places: Floats = table.places[chosen]
        self._candidates = np.ascontiguousarray(table.responses[chosen].T)
        self.squares = _LEAST * table.radius**2, _MOST * table.radius**2
        self._low, self._high = table.places.min(axis=0), table.places.max(axis=0)
        self._tree = cKDTree(table.places)
        axes = [np.unique(table.places[:, k]) for k in range(2)]
        self._whole = len(table.places) == len(axes[0]) * len(axes[1])  # a rectangle, not a disc or a polygon in one
        self.bar = float(-ndtri(false_alarms / (len(self.places) * (1 + bipolar))))
        self.false_twos, self.split_bar = false_twos, self.split_threshold(false_twos)

    @staticmethod
    def split_threshold(rate: float) -> float:
        """By how much a second contact must explain more, to be taken for one that is not there at that rate.

        The pair has an axis to choose, about eight directions: a chi-square of one degree of freedom for each.
        """
        return float(ndtri(rate / _HALO) ** 2)

    # --- the model of the noise ---------------------------------------------------------------------------------------

    def data(self, *differences: Difference) -> Data:
        """The data of one scan, or of several fused.

        Raises:
            DataError: If no finite datum is left.
        """
        return Data.of(self.table.n_elec, *differences).counted(self.noise, self.model_error)

    def noise_model(self, data: Data, more: Floats | None = None) -> NoiseModel:
        """The noise of data; `more` (n_meas, k) are further directions not known (V)."""
        sigma = float(np.hypot(self.noise, self.model_error * data.root_mean_square))
        return NoiseModel(sigma, no_directions(data) if more is None else more)

    def _noise_after(self, found: Solution, noise_model: NoiseModel, left: Floats) -> NoiseModel:
        """The noise of what is `left` (n_meas,) of data (V) after a fit whose contacts are still free to change."""
        return NoiseModel(self.noise, np.hstack([noise_model.directions, unknown(found.slopes, left)]))

    def onto(self, positions: Floats) -> Floats:
        """Positions (n, 2), those off the sheet replaced by the closest place on it (m)."""
        inside: Floats = np.minimum(np.maximum(positions, self._low), self._high)
        if self._whole:
            return inside
        distance, closest = self._tree.query(inside)
        far = distance > self.table.radius
        if far.any():
            inside[far] = self.table.places[closest[far]]
        return inside

    def within(self, params: Floats) -> Floats:
        """Parameters (n, 4 or more) with places on the sheet and radii that the table has."""
        inside = params.copy()
        inside[:, :2] = self.onto(params[:, :2])
        inside[:, 3] = np.clip(params[:, 3], *self.squares)
        return inside

    # --- one contact more? --------------------------------------------------------------------------------------------

    def scores(self, data: Data, residual: Floats, noise_model: NoiseModel) -> tuple[Floats, Floats]:
        """Score and power (n_places,) of a further contact at each place: their ratio is its effect (m2)."""
        return noise_model.gains(data.rows(self._candidates), residual)

    def heights(self, score: Floats, power: Floats) -> Floats:
        """Standard deviations by which scores stand out; signed where contacts only raise the conductivity."""
        height = score / np.sqrt(power)
        return np.asarray(np.abs(height) if self.bipolar else height)

    def added(
        self, data: Data, noise_model: NoiseModel, score: Floats, power: Floats, known: Floats | None = None
    ) -> Solution:
        """The contacts `known` (n, 4) and one more that explain the data best, of a few places that promise most."""
        height = self.heights(score, power)
        taken = np.zeros(len(height), bool)
        best: Solution | None = None
        for _ in range(_STARTS):
            place = int(np.argmax(np.where(taken, -np.inf, height)))
            if best is not None and height[place] < _PROMISE * height.max():
                break
            # near an electrode, the truth may lie on its other side
            taken |= np.linalg.norm(self.places - self.places[place], axis=1) < 1.4 * self.table.radius
            start = np.array([[*self.places[place], score[place] / power[place], self.table.radius**2]])
            found = self.refine(data, start if known is None else np.vstack([known, start]), noise_model)
            best = found if best is None or found.cost < best.cost else best
        assert best is not None
        return best

    # --- fitting ------------------------------------------------------------------------------------------------------

    @property
    def prior(self) -> tuple[Floats, Floats]:
        """What is known of a contact before any data: mean (4,) and information (4,). Little, except of its size."""
        square = self.table.radius**2
        middle = (self._low + self._high) / 2
        stds = np.array([*(self._high - self._low), 10 * np.pi * square, SQUARE_STD * square])
        return np.array([*middle, 0.0, square]), stds**-2.0

    def refine(
        self,
        data: Data,
        start: Floats,
        noise_model: NoiseModel,
        mean: Floats | None = None,
        information: Floats | None = None,
        rounds: int = 12,
    ) -> Solution:
        """The contacts near `start` (n, 4) that explain the data best (Levenberg and Marquardt).

        Args:
            data: The data.
            start: Where to start.
            noise_model: What is not explained.
            mean: (4 n,) believed before, `prior` unless given.
            information: (4 n, 4 n) inverse of its covariance, likewise.
            rounds: Most steps.
        """
        if mean is None or information is None:
            centre, precision = self.prior
            mean, information = np.tile(centre, len(start)), np.diag(np.tile(precision, len(start)))
        params, damping = start, 1e-3
        state = self._linearise(data, params, noise_model, mean, information)
        for _ in range(rounds):
            cost, normal, gradient = state[:3]
            damped = normal.copy()
            damped[np.diag_indices_from(damped)] *= 1 + damping
            step = cho_solve(cho_factor(damped, check_finite=False), gradient, check_finite=False).reshape(params.shape)
            if float(step.ravel() @ gradient) < _ENOUGH:
                break
            moved = self._stepped(params, step)
            trial = self._linearise(data, moved, noise_model, mean, information)
            gain = cost - trial[0]
            if gain > 0:
                params, state, damping = moved, trial, damping / 8
            else:
                damping = max(8 * damping, 1e-2)
            if abs(gain) < _ENOUGH or damping > 1e4:
                break
        return Solution(params, *state[:2], *state[3:])

    def _stepped(self, params: Floats, step: Floats) -> Floats:
        """Parameters (n, 4) after a step, no longer than a radius, that keeps them within what a contact may be."""
        length = np.linalg.norm(step[:, :2], axis=1, keepdims=True)
        bounded = step.copy()
        bounded[:, :2] *= np.minimum(1.0, self.table.radius / np.maximum(length, 1e-300))
        moved = self.within(params + bounded)
        if not self.bipolar:
            moved[:, 2] = np.maximum(moved[:, 2], 1e-3 * self.table.radius**2)
        return moved

    def _linearise(
        self, data: Data, params: Floats, noise_model: NoiseModel, mean: Floats, information: Floats
    ) -> tuple[float, Floats, Floats, Floats, Floats]:
        """Cost, its curvature (4 n, 4 n) and downhill gradient (4 n,); what is caused, and its slopes."""
        caused, slopes = responses(self.table, data, params)
        both = np.column_stack([slopes, data.volts - caused])
        inner = noise_model.inner(both, both)
        off = mean - params.ravel()
        pull = information @ off
        return float(inner[-1, -1] + off @ pull), inner[:-1, :-1] + information, inner[:-1, -1] + pull, caused, slopes

    def contact(self, params: Floats, covariance: Floats) -> Contact:
        """A contact to report, from its parameters (4,) and their covariance (4, 4)."""
        x, y, effect, square = (float(value) for value in params)
        # the model's own error moves a contact by about its share of two radii, however little noise there is
        floor = (_BLUR * self.model_error * self.table.radius) ** 2
        (xx, xy), (_, yy) = covariance[:2, :2] + floor * np.eye(2)
        area = np.pi * square
        return Contact(
            position=(x, y),
            extent=area,
            strength=effect,
            confidence=0.5 * (1 + erf(abs(effect) / (sqrt(2) * effect_std(covariance)))),
            peak=effect / area,
            covariance=((float(xx), float(xy)), (float(xy), float(yy))),
            radius=sqrt(square),
        )

    def contacts(self, found: Solution) -> tuple[Contact, ...]:
        """The contacts of a fit, strongest first."""
        listed = [self.contact(*one) for one in zip(found.params, found.covariances, strict=True)]
        return tuple(sorted(listed, key=lambda contact: -abs(contact.strength)))

    # --- one frame, nothing known before ------------------------------------------------------------------------------

    def fit(self, *differences: Difference, unsure: Floats | None = None) -> Solution:
        """The contacts of one scan, or of several fused, with nothing known before.

        Args:
            differences: The scans.
            unsure: (n_meas, k) directions in which their data err beside white noise (V), see `gain_directions`.

        Raises:
            DataError: If no finite datum is left.
        """
        data = self.data(*differences)
        noise_model = self.noise_model(data, None if unsure is None else unsure[data.known] * data.share[:, None])
        found = nothing(data)
        while len(found.params) < self.most:
            left = data.volts - found.caused
            score, power = self.scores(data, left, self._noise_after(found, noise_model, left))
            wrong = self.model_error * float(np.linalg.norm(found.caused)) / self.noise
            if self.heights(score, power).max() < self.bar + wrong:
                break
            count = len(found.params)
            found = self._cleared(data, noise_model, self.added(data, noise_model, score, power, found.params))
            if len(found.params) <= count:
                break
        for k in range(len(found.params)):
            if len(found.params) < self.most:
                found = self.split(data, found, k, unsure=noise_model.directions) or found
        return found

    def _cleared(self, data: Data, noise_model: NoiseModel, found: Solution) -> Solution:
        """The fit without contacts that turn out not to be needed, now that all have been refined together."""
        while len(found.params) > 1:
            sure = np.abs(found.params[:, 2]) / [effect_std(covariance) for covariance in found.covariances]
            faintest = int(np.argmin(sure))
            if sure[faintest] > FAINT:
                break
            found = self.refine(data, np.delete(found.params, faintest, axis=0), noise_model)
        return found

    def split(
        self, data: Data, found: Solution, k: int, bar: float | None = None, unsure: Floats | None = None
    ) -> Solution | None:
        """The data explained with contact number k as two, if that explains them significantly better.

        `bar` is the least gain, in units of the noise's variance; `split_bar` unless given. The pair comes last.
        """
        one = found.params[k]
        noise_model = self.noise_model(data, unsure)
        left = data.volts - found.caused
        # an equal pair differs from one contact by the second derivative along its axis: which axis gains most?
        reach = np.sqrt(max(one[3], self.table.radius**2))
        axes = _DIRECTIONS[: _HALO // 2]
        ends = one[:2] + reach * np.concatenate([axes, -axes, [[0.0, 0.0]]])
        values = self.table(self.onto(ends), np.sqrt(one[3])).values
        bend = data.rows(np.ascontiguousarray((values[:4] + values[4:8] - 2 * values[8]).T))
        score, power = self._noise_after(found, noise_model, left).gains(bend, left)
        height = score / np.sqrt(power)
        if height.max() < 1.0:
            return None
        axis = axes[int(np.argmax(height))]
        pair = np.stack([one, one])
        pair[:, :2] = self.onto(one[:2] + np.outer([reach, -reach], axis))
        pair[:, 2] /= 2
        pair[:, 3] = self.table.radius**2 / 2
        two = self.refine(data, np.vstack([np.delete(found.params, k, axis=0), pair]), noise_model, rounds=25)
        return two if self.gained(data, found, two) > (self.split_bar if bar is None else bar) else None

    def gained(self, data: Data, few: Solution, many: Solution) -> float:
        """How much better more contacts explain data, less what the model's error may do; over the noise's variance."""
        better = (few.cost - many.cost) * self.noise_model(data).sigma ** 2
        wrong = self.model_error * float(np.linalg.norm(few.caused))
        return (better - wrong**2) / self.noise**2


def _spaced(places: Floats, spacing: float) -> np.ndarray:
    """Numbers of places, one in each square of a grid: the one closest to the square's middle."""
    low = places.min(axis=0)
    count = np.maximum(np.rint(np.ptp(places, axis=0) / spacing), 1)
    cell = (places - low) / np.ptp(places, axis=0) * count
    middle = np.rint(cell)
    off = np.linalg.norm(cell - middle, axis=1)
    order = np.argsort(off, kind="stable")
    _, first = np.unique(middle[order], axis=0, return_index=True)
    return np.sort(order[first])
