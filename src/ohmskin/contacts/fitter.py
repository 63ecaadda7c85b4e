"""Contacts straight from data, in a millisecond: find the place that explains most, refine, look again.

Whether there is one contact more is a test, not a threshold on an image. At each of a set of places, the score of a
further contact there is compared with its noise (a generalised likelihood-ratio test); the bar is set by the rate of
false alarms accepted, summed over all places (Bonferroni: the true rate is lower, as neighbouring places are alike).
A contact's parameters are x, y (m), effect (relative conductivity change times area, m2) and squared radius (m2).
"""

from math import erf, log, sqrt
from operator import attrgetter

import numpy as np
from scipy.special import ndtri

from ohmskin.arrays import Floats
from ohmskin.contacts import kernels
from ohmskin.contacts.finder import Contact
from ohmskin.contacts.information import Errors, Information
from ohmskin.contacts.solution import PER_CONTACT, Solution, effect_std, nothing
from ohmskin.errors import ModelError
from ohmskin.forward import ContactTable
from ohmskin.inverse.modes import check_positive, check_share
from ohmskin.scan import Difference, DrivePattern
from ohmskin.scan.pairs import in_series

_LEAST, _MOST = 0.1, 9.0  # squared radius that a fit may take, as shares of the usual one; the table ends there
SQUARE_STD = 0.75  # prior standard deviation of the squared radius, likewise
_STRONG = 1.5  # effect over area of a contact that is taken to be larger than usual if it is stronger; at most it is 2
_ALIKE = 1 / 3  # of their sum, by which the effects of two contacts differ that were taken for one
_OVERLAP = 2 / 3  # of the sum of their radii, closer than which two contacts are one
_STARTS, _PROMISE = 3, 0.7  # places from which a fit starts, and the share of the best score that makes one worth it
_PROMISED = 0.02  # share of the gain asked of a split that a small one must promise, to be worth a fit
_WIDE = 1.5  # usual radii of a contact beyond which a pair in its place may be as far apart as it is wide
_LIKELY = 2  # axes along which a contact of usual size may be a pair
_FEW = 5  # rounds of a fit that tell which axis of a split is the best
_BLUR = 1.4  # radii times the model's error: how far that may move a contact
FAINT = 3.0  # standard deviations of its effect below which a contact is none
_ANGLES = np.arange(4) * np.pi / 4
_AXES = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])  # along which a pair may lie
_cost = attrgetter("cost")


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
        gain: Standard deviation of the relative error of a measured current (1).
        contacts: (n_pairs, n_elec) change of two-terminal resistances with each contact impedance, for one standard
            deviation of its change since calibration (ohm); None: they are known.

    Attributes:
        errors: How data err.
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
        gain: float = 0.0,
        contacts: Floats | None = None,
    ) -> None:
        check_positive(noise=noise)
        check_share(model_error=model_error)
        for name, rate in (("false_alarms", false_alarms), ("false_twos", false_twos)):
            if not 0 < rate < 1:
                raise ModelError(f"{name} is {rate!r}; it must be a rate above 0 and below 1")
        if most < 1:
            raise ModelError(f"cannot look for {most} contacts; at least 1")
        self.errors = Errors(noise, gain, contacts, model_error)
        self.table, self.noise, self.model_error, self.bipolar, self.most = table, noise, model_error, bipolar, most
        chosen = table.spaced(1.25 * table.radius)
        self.places: Floats = table.places[chosen]
        self._candidates = table.responses[chosen]
        self._largest = (self._candidates**2).max(axis=0)
        self.squares = _LEAST * table.radius**2, _MOST * table.radius**2
        self.bar = float(-ndtri(false_alarms / (len(self.places) * (1 + bipolar))))
        self.false_twos, self.split_bar = false_twos, self.split_threshold(false_twos)
        quiet = DrivePattern(np.array([[0, 1]]), np.array([[0, 0, 1]]))
        told, _ = self.information(Difference(quiet, np.ones(1), np.zeros(1)))
        self.refine(told, self.prior[0][None])  # compile now, not at the first contact

    @staticmethod
    def split_threshold(rate: float) -> float:
        """By how much a second contact must explain more, to be taken for one that is not there at that rate.

        Beside a contact of any size, a pair differs by its quadrupole, which has two parts (as cos and sin of twice its
        angle): chi-square of two degrees of freedom.
        """
        return -2 * log(rate)

    # --- what is measured ---------------------------------------------------------------------------------------------

    def information(self, *scans: Difference) -> tuple[Information, Information]:
        """What one scan says, or several fused; and the same wary of the model's error.

        Raises:
            DataError: If no finite datum is left.
        """
        return Information.of(self.table.n_elec, self.errors, scans)

    def allowance(self, data: Information) -> float:
        """How much data count when contacts are fitted: less than by their noise, as the model errs, too (1)."""
        return 1 / (1 + (self.model_error * data.signal) ** 2)

    def onto(self, positions: Floats) -> Floats:
        """Positions (n, 2), those off the sheet replaced by the closest place on it (m)."""
        inside = np.array(positions, float)
        for position in inside:
            kernels.onto(position, *self.table.sheet)
        return inside

    def within(self, params: Floats) -> Floats:
        """Parameters (n, 4 or more) with places on the sheet and radii that the table has."""
        inside = params.copy()
        inside[:, :2] = self.onto(params[:, :2])
        inside[:, 3] = np.clip(params[:, 3], *self.squares)
        return inside

    def responses(self, params: Floats) -> tuple[Floats, Floats]:
        """What contacts (n, 4) change of the two-terminal resistances (n_pairs,), and its slopes (n_pairs, 4 n)."""
        caused, slopes = kernels.responses(np.ascontiguousarray(params[:, :PER_CONTACT]), *self.table.spline)
        return caused, slopes.T

    # --- one contact more? --------------------------------------------------------------------------------------------

    def scores(self, left: Information) -> tuple[Floats, Floats]:
        """Score and power (n_places,) of a further contact at each place: their ratio is its effect (m2)."""
        power = np.einsum("pn,pn->p", self._candidates @ left.told.matrix[:-1, :-1], self._candidates)
        least = 1e-12 * float(self._largest @ np.diag(left.white.matrix)[:-1])  # rounding reaches that far
        return self._candidates @ left.told.vector[:-1], np.maximum(power, least)

    def heights(self, score: Floats, power: Floats) -> Floats:
        """Standard deviations by which scores stand out; signed where contacts only raise the conductivity."""
        return np.asarray((np.abs(score) if self.bipolar else score) / np.sqrt(power))

    def added(self, data: Information, score: Floats, power: Floats, known: Floats | None = None) -> Solution:
        """The contacts `known` (n, 4) and one more that explain the data best, of a few places that promise most."""
        height = self.heights(score, power)
        taken, starts = np.zeros(len(height), bool), list[Floats]()
        for _ in range(_STARTS):
            place = int(np.argmax(np.where(taken, -np.inf, height)))
            if starts and height[place] < _PROMISE * height.max():
                break
            # near an electrode, the truth may lie on its other side
            taken |= np.linalg.norm(self.places - self.places[place], axis=1) < 1.4 * self.table.radius
            start = np.array([[*self.places[place], score[place] / power[place], self.table.radius**2]])
            starts.append(start if known is None else np.vstack([known, start]))
        return min((self.refine(data, start) for start in starts), key=_cost)

    # --- fitting ------------------------------------------------------------------------------------------------------

    @property
    def prior(self) -> tuple[Floats, Floats]:
        """What is known of a contact before any data: mean (4,) and information (4,). Little, except of its size."""
        square, (low, high, *_) = self.table.radius**2, self.table.sheet
        stds = np.array([*(high - low), 10 * np.pi * square, SQUARE_STD * square])
        return np.array([*(low + high) / 2, 0.0, square]), stds**-2.0

    def expected(self, effects: Floats) -> tuple[Floats, Floats]:
        """Mean (4 n,) and information (4 n, 4 n) of contacts of about these effects (n,) (m2); strong are large."""
        (centre, precision), square = self.prior, self.table.radius**2
        larger = np.maximum(1.0, np.abs(effects) / (_STRONG * np.pi * square))
        means, precisions = (np.tile(one, (len(effects), 1)) for one in (centre, precision))
        means[:, 3] *= larger
        precisions[:, 3] /= larger**2
        return means.ravel(), np.diag(precisions.ravel())

    def refine(
        self,
        data: Information,
        start: Floats,
        mean: Floats | None = None,
        information: Floats | None = None,
        rounds: int = 40,
    ) -> Solution:
        """The contacts near `start` (n, 4) that explain the data best (Levenberg and Marquardt).

        Args:
            data: What is measured.
            start: Where to start.
            mean: (4 n,) believed before, `prior` unless given.
            information: (4 n, 4 n) inverse of its covariance, likewise.
            rounds: Most steps.
        """
        if mean is None or information is None:
            mean, information = self.expected(start[:, 2])
        radius, least = self.table.radius, -np.inf if self.bipolar else 1e-3 * self.table.radius**2
        params = np.array(start[:, :PER_CONTACT], float)
        cost, normal, caused, slopes = kernels.refined(
            params, data.told.matrix, data.told.vector, data.told.constant,
            np.asarray(mean, float), np.ascontiguousarray(information), rounds, radius, least, *self.squares,
            self.table.sheet, self.table.spline,
        )  # fmt: skip
        return Solution(params, cost, normal, caused, slopes.T)

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

    def fit(self, *scans: Difference) -> Solution:
        """The contacts of one scan, or of several fused, with nothing known before.

        Raises:
            DataError: If no finite datum is left.
        """
        return self.explained(*self.information(*scans))

    def explained(self, told: Information, data: Information) -> Solution:
        """The contacts that explain what is measured, given as `information` gives it."""
        told, data = everything = told.beside_common(), data.beside_common()
        found, covered = nothing(self.table.responses.shape[1]), tuple[int, ...]()
        while len(found.params) < self.most:
            score, power = self.scores(told.less(found.caused).beside(found.slopes) if len(found.params) else told)
            more = [self.split(told, data, found, k) for k in range(len(found.params))]
            if self.heights(score, power).max() >= self.bar + self.model_error * told.size(found.caused):
                one = self.added(data, score, power, found.params)
                away = ((one.params[:-1, :2] - one.params[-1, :2]) ** 2).sum(axis=1)
                more += [one] if (away > one.params[:-1, 3]).all() else []  # what is left in a contact is its shape
            better = [self._cleared(data, one) for one in more if one is not None]
            better = [one for one in better if len(one.params) > len(found.params)]
            strong = np.abs(found.params[:, 2]) > _STRONG * np.pi * self.table.radius**2
            look = len(covered) < len(found.params) and (len(better) > 0 or bool(strong.any()))
            under = self._over_an_electrode(everything, found, covered) if look else None
            if under is not None:
                covered, told, data, found = under
            elif better:
                found = min(better, key=_cost)
            else:
                break
        return found

    def _over_an_electrode(
        self, everything: tuple[Information, Information], found: Solution, covered: tuple[int, ...]
    ) -> tuple[tuple[int, ...], Information, Information, Solution] | None:
        """The data explained by a contact that covers one electrode more, if that explains them significantly better.

        A contact changes the resistance of an electrode under it by less than its response, singular there, says; so
        nothing is taken to be known of that. Electrodes, what is left of the data, and the contacts.
        """
        tried, electrodes = [], self.table.electrodes
        near = ((electrodes[:, None] - found.params[:, :2]) ** 2).sum(axis=2) < self.squares[1]
        near[list(covered)] = False
        for number, k in np.argwhere(near).tolist():
            under = *covered, number
            told, data = (one.beside(in_series(under, self.table.n_elec)) for one in everything)
            # in place of one contact, and of all: the others may be there only because of the electrode
            replaced = [np.delete(found.params, k, axis=0), found.params[:0]]
            for others in replaced if len(found.params) > 1 else replaced[:1]:
                rest = self.refine(data, others) if len(others) else nothing(len(found.caused))
                score, power = self.scores(told.less(rest.caused).beside(rest.slopes))
                one = self._cleared(data, self.added(data, score, power, rest.params))
                over = ((one.params[:, :2] - electrodes[number]) ** 2).sum(axis=1) < one.params[:, 3]
                worth = self.bar**2 * (1 + len(one.params) - len(found.params))
                if over.any() and found.cost - one.cost > worth:
                    tried.append((under, told, data, one))
        return min(tried, key=lambda each: each[3].cost + self.bar**2 * len(each[3].params), default=None)

    def _cleared(self, data: Information, found: Solution) -> Solution:
        """The fit without contacts that turn out not to be needed, now that all have been refined together."""
        while len(found.params) > 1:
            sure = np.abs(found.params[:, 2]) / [effect_std(covariance) for covariance in found.covariances]
            faintest = int(np.argmin(sure))
            if sure[faintest] > FAINT:
                break
            found = self.refine(data, np.delete(found.params, faintest, axis=0))
        return found

    def split(
        self, told: Information, data: Information, found: Solution, k: int, bar: float | None = None
    ) -> Solution | None:
        """The data explained with contact number k as two, if that explains them significantly better.

        Args:
            told: What is measured.
            data: The same, wary of the model's error.
            found: The contacts.
            k: Which of them; the pair comes last.
            bar: The least gain, in units of the noise's variance; `split_bar` unless given.
        """
        one = found.params[k]
        # an equal pair differs from one contact by the second derivative along its axis: does any promise a gain?
        usual, own = self.table.radius, np.sqrt(one[3])
        reaches = np.array([usual, own] if own > _WIDE * usual else [usual])
        axes = (reaches[:, None, None] * _AXES).reshape(-1, 2)
        values = self.table(self.onto(one[:2] + np.concatenate([axes, -axes, [[0.0, 0.0]]])), own).values
        ahead, behind = values[:-1].reshape(2, *axes.shape[:1], -1)
        bend, left = ahead + behind - 2 * values[-1], told.less(found.caused).beside(found.slopes)
        power = np.einsum("pn,pn->p", bend @ left.told.matrix[:-1, :-1], bend)
        height = bend @ left.told.vector[:-1] / np.sqrt(np.maximum(power, 1e-12 * power.max()))
        bar = self.split_bar if bar is None else bar
        if height.max() ** 2 < _PROMISED * (bar + (self.model_error * told.size(found.caused)) ** 2):
            return None
        count, (centre, precision) = len(found.params) + 1, self.prior
        mean, information = np.tile(centre, count), np.diag(np.tile(precision, count))
        unlike = np.zeros(len(mean))
        unlike[[-6, -2]] = np.array([1, -1]) / (_ALIKE * one[2])
        information += np.outer(unlike, unlike)
        others, half = np.delete(found.params, k, axis=0), np.tile([one[2] / 2, usual**2 / 2], (2, 1))
        likely = axes[np.argsort(-height)[:_LIKELY]] if len(reaches) == 1 else axes
        pairs = (np.hstack([self.onto(one[:2] + np.outer([1, -1], axis)), half]) for axis in likely)
        starts = [np.vstack([others, pair]) for pair in pairs]
        tried = [self.refine(data, start, mean, information, _FEW) for start in starts]
        two = self.refine(data, min(tried, key=_cost).params, mean, information)
        away = np.linalg.norm(two.params[-1, :2] - two.params[-2, :2])
        if away < _OVERLAP * np.sqrt(two.params[-2:, 3]).sum():
            return None
        return two if self.gained(told, found, two) > bar else None

    def gained(self, told: Information, few: Solution, many: Solution) -> float:
        """How much better more contacts explain data, less what the model's error may do; over the noise's variance."""
        return (few.cost - many.cost) / self.allowance(told) - (self.model_error * told.size(few.caused)) ** 2
