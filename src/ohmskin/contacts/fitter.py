"""Contacts straight from data, in a millisecond: find the place that explains most, refine, look again.

Whether there is one contact more is a test, not a threshold on an image. At each of a set of places, the score of a
further contact there is compared with its noise (a generalised likelihood-ratio test); the bar is set by the rate of
false alarms accepted, summed over all places (Bonferroni: the true rate is lower, as neighbouring places are alike).
Whether a contact is two is another one, see `ContactFitter.are_two`.
"""

from math import log, sqrt

import numpy as np
from scipy.special import ndtri

from ohmskin.arrays import Floats, changed
from ohmskin.contacts import refit
from ohmskin.contacts.discs import APART, NEAR, Both, DiscFitter, cost_of
from ohmskin.contacts.information import Errors, Information
from ohmskin.contacts.kernels import STRONG
from ohmskin.contacts.misfit import pair_products
from ohmskin.contacts.refit import CLEAR, HALF, PROMISED, VALID
from ohmskin.contacts.solution import Solution, effect_std, nothing, similarity_prior
from ohmskin.errors import ModelError
from ohmskin.forward import ContactTable
from ohmskin.inverse.modes import check_positive, check_share
from ohmskin.scan import Difference
from ohmskin.scan.pairs import in_series

_OVERLAP = 1 / 2  # of the sum of their radii, closer than which two contacts are one
_LOST = 0.7  # share of the data that contacts leave which explain little
_COVERED = 0.25  # cost of an electrode with a flat prior, as a share of a contact's
_WIDEST = 2.0  # usual radii of a contact beyond which a pair must be as far apart as it is wide
_FEW = 8  # rounds of a fit that show which axis of a split is the best
FAINT = 3.0  # standard deviations of its effect below which a contact is none
_MORE = 1.2  # times the doubts that a search found nothing about, from which on contacts are looked for again
_PATIENT = sqrt(CLEAR)  # what is accepted of doubts that one scan of several leaves
_ALL = np.full(refit.DOUBTS, np.inf)

_Over = tuple[tuple[int, ...], Information, Information, Solution]  # electrodes covered, what is left beside, contacts


class ContactFitter(DiscFitter):
    """Fits contacts to data: their number, positions, radii and effects.

    Args:
        table: Responses of contacts.
        noise: Standard deviation of a difference of voltages (V).
        model_error: How far the model of a contact errs, as a share of its signal (1).
        false_alarms: Rate at which quiet data may be mistaken for a contact.
        false_twos: Rate at which one contact may be reported as two.
        most: Most contacts to look for.
        bipolar: Whether contacts may lower the conductivity, too.
        gain: Standard deviation of the relative error of a measured current (1).
        contacts: Changes with contact impedances since calibration, see `Errors`; None: these are known.
        fields: See `Errors`.

    Attributes:
        bar: Standard deviations that the score of a new contact must exceed.
        split_bar: By how much two contacts must explain data better than one, in units of the noise's variance.
        compiled: Arguments of compiled steps: settings, see `refit.refit`, the sheet, responses of contacts, and those
            of the candidates.

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
        fields: Floats | None = None,
    ) -> None:
        check_positive(noise=noise)
        check_share(model_error=model_error)
        for name, rate in (("false_alarms", false_alarms), ("false_twos", false_twos)):
            if not 0 < rate < 1:
                raise ModelError(f"{name} is {rate!r}; it must be a rate above 0 and below 1")
        if most < 1:
            raise ModelError(f"cannot look for {most} contacts; at least 1")
        contacts = np.zeros((len(table.pairs), 0)) if contacts is None else contacts
        super().__init__(table, Errors(noise, gain, contacts, model_error, fields), bipolar)
        self.noise, self.most = noise, most
        self.bar = float(-ndtri(false_alarms / (len(self.places) * (1 + bipolar))))
        self.false_twos, self.split_bar = false_twos, self.split_threshold(false_twos)
        limits = table.radius, self._least, *self.squares, model_error, self.bar, self.split_bar
        self.compiled = np.array([*limits, float(bipolar)]), table.sheet, table.spline, self._candidates
        alone = np.ascontiguousarray(in_series(range(table.n_elec), table.pairs).T)
        # (n_elec, n_pairs) each: in series with each electrode, of contacts there
        self._at_electrodes = alone, table(table.electrodes).values.copy()

    @staticmethod
    def split_threshold(rate: float) -> float:
        """By how much a second contact must explain more, to be taken for one that is not there at that rate.

        Beside a contact of any size, a pair differs by its quadrupole, which has two parts (cos and sin of twice its
        angle): chi-square of two degrees of freedom.
        """
        return -2 * log(rate)

    def fit(self, *scans: Difference) -> Solution:
        """The contacts of one of the `scans`, or of several fused, without a prior estimate.

        Raises:
            DataError: If no finite datum is left.
        """
        return self.fit_information(*self.information(*scans))

    def fit_information(
        self, nominal: Information, inflated: Information, bar: float | None = None, before: Solution | None = None
    ) -> Solution:
        """The contacts that explain what is measured, `nominal` and `inflated` of `information`; `bar` as for `split`.

        Contacts of the previous frame (`before`) are not searched again where that makes no difference.
        """
        last = None if before is None else self.refitted(nominal, inflated, before)
        if last is not None and last[1]:
            return last[0]
        if same := before and self.followed(nominal, inflated, before):
            return same
        given = nominal, inflated
        nominal, inflated = everything = whole = nominal.marginalised_common(), inflated.marginalised_common()
        found, covered = changed(nothing(len(self.table.pairs)), cost=inflated.misfit.constant), tuple[int, ...]()
        if last is not None and before is not None:
            found, covered = last[0], before.covered
            everything = self.beside_shapes(whole, before.params)
            nominal, inflated = (self.uncovered(one, covered) for one in everything)
        while len(found.params) < self.most:
            left = nominal.minus(found.caused) if len(found.params) else nominal
            beside = left.marginalised_flat(found.slopes) if len(found.params) else left
            score, power = self.scores(beside)
            more = [self.split(nominal, inflated, found, k, bar, beside) for k in range(len(found.params))]
            height = self.heights(score, power).max()
            sure = height >= self.bar + self.model_error * nominal.norm(found.caused)
            if sure or height > max(self.bar, sqrt(HALF * left.misfit.constant)):
                one = self.added(inflated, score, power, found.params)
                away = (self.table.offsets(one.params[:-1, :2], one.params[-1, :2]) ** 2).sum(axis=1)
                apart = (away > one.params[:-1, 3]).all()  # what is left in a contact is its shape
                more += [one] if apart and (sure or self.are_apart(found, one, self.bar**2)) else []
            better = [self._cleared(inflated, one) for one in more if one is not None]
            better = [one for one in better if len(one.params) > len(found.params)]
            strong = bool((np.abs(found.params[:, 2]) > STRONG * np.pi * self.table.radius**2).any())
            under = None
            if better or strong or self.poor(nominal, found.cost) or not len(found.params):
                under = self._over_an_electrode(everything, found, covered, bool(better))
            best = min(better, key=cost_of, default=None)
            if under and (best is None or self.price(under[-1], len(under[0])) < self.price(best, len(covered))):
                covered, nominal, inflated, found = under
            elif best is not None:
                found = best
            else:
                break
            for _ in range(2):  # where they are by then, they have other shapes
                everything = self.beside_shapes(whole, found.params)
                nominal, inflated = (self.uncovered(one, covered) for one in everything)
                if everything is not whole or len(found.params) > 1:
                    found = self.refine(inflated, found.params, *self.prior(found.params))
        covered, found = self.beside_electrodes(whole[1], everything[1], found, covered)
        found = self.joined(whole, found, covered)
        found = changed(found, covered=covered, shapes=self.shapes(found.params))
        if before is None or (known := self._refitted(*given, found)) is None:
            poor = before is not None and self.poor(everything[0], found.cost)
            return changed(found, poor=given[0].signals(found.caused)[1] if poor else 0.0)
        return changed(found, doubts=known[0].doubts)

    def refitted(
        self, nominal: Information, inflated: Information, before: Solution, search: bool = True
    ) -> tuple[Solution, bool] | None:
        """Contacts of the last frame, `before`, fitted to `nominal` and `inflated`; whether there are surely no others.

        None if a new search might not find them. It would find them if each exceeds the limit of a new contact, none
        may be a part of another, and the residual is no larger than usual, or than one that an earlier search could not
        explain. Without a `search` for others, these are never excluded, and the residual may be larger.
        """
        doubts = np.zeros(refit.DOUBTS) if before.doubts is None else before.doubts
        allowed = np.maximum(1.0, _MORE * doubts) if search else np.full(refit.DOUBTS, _PATIENT)
        allowed[refit.FAINT] = 1.0
        found = self._refitted(nominal, inflated, before, search, allowed)
        return None if found is None else (changed(found[0], doubts=before.doubts), found[1])

    def _refitted(
        self, nominal: Information, inflated: Information, before: Solution, search: bool = True, allowed: Floats = _ALL
    ) -> tuple[Solution, bool] | None:
        """The same, with its doubts, some of which are `allowed` (5,)."""
        params = before.params.copy()
        if not 0 < len(params) <= self.most:
            return None
        if len(params) > 1:
            away = np.linalg.norm(self.table.offsets(params[:, None, :2], params[:, :2]), axis=2)
            if (away < NEAR * self.table.radius).sum() > len(params):  # any but each of itself
                return None
        nominal, inflated = self.uncovered(nominal, before.covered), self.uncovered(inflated, before.covered)
        state, cost, normal, caused, slopes, shapes, doubts = refit.refit(
            nominal.misfit.part,
            inflated.misfit.part,
            nominal.white.part,
            params,
            *self.compiled,
            search and self.table.pairs.whole,
            allowed,
        )
        if state == refit.INVALID or {*before.covered} != {*self.covered(params)}:
            return None
        return Solution(params, cost, normal, caused, slopes.T, before.covered, shapes.T, doubts), state == VALID

    def price(self, found: Solution, electrodes: int) -> float:
        """What a fit, `found`, leaves unexplained, and what its contacts and those `electrodes` cost of which nothing
        is taken to be known (noise's variance)."""
        return found.cost + self.bar**2 * (len(found.params) + _COVERED * electrodes)

    def _over_an_electrode(
        self, everything: Both, found: Solution, covered: tuple[int, ...], better: bool
    ) -> _Over | None:
        """The data explained by a contact that covers one electrode more, if that explains them significantly better.

        A contact changes the resistance of an electrode under it by less than its response, singular there, says; so
        nothing is taken to be known of that. Electrodes, what is left of the data, and the contacts. Where contacts
        explain little, or much is left and nothing is `better`, an electrode far from all of them may be the one.
        """
        if len(covered) >= max(len(found.params), 1):
            return None
        tried = []
        away = self.table.offsets(self.table.electrodes[:, None], found.params[:, :2])
        near = (away**2).sum(axis=2) < self.squares[1]
        near[list(covered)] = False
        # in place of one contact, and of all: others may be there because of the electrode
        looks = [(number, [np.delete(found.params, k, axis=0), found.params[:0]]) for number, k in np.argwhere(near)]
        nominal, inflated = everything
        lost = bool(len(found.params)) and found.cost > _LOST * inflated.misfit.constant
        if lost or (not better and (self.poor(nominal, found.cost) or not len(found.params))):
            looks += [(number, [found.params, found.params[:0]]) for number in self._likely(nominal, found, covered)]
        for number, replaced in looks:
            under = *covered, int(number)
            nominal, inflated = (self.uncovered(one, under) for one in everything)
            for others in replaced if len(replaced[0]) else replaced[:1]:
                rest = self.refine(inflated, others) if len(others) else nothing(len(found.caused))
                score, power = self.scores(nominal.minus(rest.caused).marginalised_flat(rest.slopes))
                one = self._cleared(inflated, self.added(inflated, score, power, rest.params))
                if number in self.covered(one.params) and self.price(one, len(under)) < self.price(found, len(covered)):
                    tried.append((under, nominal, inflated, one))
        return min(tried, key=lambda each: self.price(each[3], 0), default=None)

    def _likely(self, data: Information, found: Solution, covered: tuple[int, ...]) -> list[int]:
        """The electrode that one contact more most likely covers, if there is one that promises a contact at all.

        That is estimated from what the contact does beside the electrode's own resistance.
        """
        left = data.minus(found.caused).misfit if len(found.params) else data.misfit
        alone, over = self._at_electrodes
        own, power, mixed = pair_products(left.rows, left.downdates, alone, over).T
        share = np.divide(mixed, own, np.zeros(len(own)), where=own > 1e-12 * np.max(own))  # of driven ones alone
        vector = left.vector[:-1]
        score = over @ vector - share * (alone @ vector)
        power = power - share * mixed
        height = self.heights(score, np.maximum(power, 1e-9 * np.max(power)))
        height[list(covered)] = -np.inf
        enough = height.max() > self.bar + self.model_error * data.norm(found.caused)
        return [int(np.argmax(height))] if enough else []

    def _cleared(self, data: Information, found: Solution) -> Solution:
        """The fit without contacts that turn out not to be needed, now that all have been refined together."""
        while len(found.params) > 1:
            sure = np.abs(found.params[:, 2]) / [effect_std(covariance) for covariance in found.covariances]
            faintest = int(np.argmin(sure))
            if sure[faintest] > FAINT:
                break
            rest = np.delete(found.params, faintest, axis=0)
            found = self.refine(data, rest, *self.prior(rest))
        return found

    def split(
        self,
        nominal: Information,
        inflated: Information,
        found: Solution,
        k: int,
        bar: float | None = None,
        left: Information | None = None,
    ) -> Solution | None:
        """The data explained with contact number k as two, if that explains them significantly better.

        Args:
            nominal: What is measured.
            inflated: The same, with the model's error as noise.
            found: The contacts.
            k: Which of them; the pair comes last.
            bar: The least gain, in units of the noise's variance; `split_bar` unless given.
            left: What remains to be explained in addition to the contacts, if that is known.
        """
        left = left or nominal.minus(found.caused).marginalised_flat(found.slopes)
        one = found.params[k]
        usual, own = self.table.radius, np.sqrt(one[3])
        axes, height = self.pairs(left, one)
        bar = self.split_bar if bar is None else bar
        if height.max() ** 2 < PROMISED * (bar + (self.model_error * nominal.norm(found.caused)) ** 2):
            return None
        many = len(found.params) + 1
        mean, information = self.expected(np.zeros(many))
        information += similarity_prior(many, np.array([many - 2, many - 1]), one[2])
        others, half = np.delete(found.params, k, axis=0), np.tile([one[2] / 2, usual**2 / 2], (2, 1))
        likely = axes[np.argsort(-height)]  # which ends the fits along the others the sooner
        pairs = (np.hstack([self.onto(one[:2] + np.outer([1, -1], axis)), half]) for axis in likely)
        starts = np.array([np.vstack([others, pair]) for pair in pairs])
        best = self.refine(inflated, starts, mean, information, _FEW)
        two = self.refine(inflated, best.params, mean, information)
        least = _OVERLAP if own < _WIDEST * usual else APART
        gap = float(np.linalg.norm(self.table.offsets(*two.params[-2:, :2])))
        apart = gap > usual and self._distance(two.params[-2:]) > least
        return two if apart and self.are_two(nominal, found, two, bar) else None

    def are_two(self, nominal: Information, one: Solution, two: Solution, bar: float, share: float = 1.0) -> bool:
        """Whether there are two contacts, the last ones, rather than one.

        There are two if they gain more than noise and all errors of the model of one (`gain_of`), or if they are so far
        apart that no shape of one resembles them, and they explain most of the residual of one beyond the model error.

        Args:
            nominal: What is measured.
            one: It explained with one contact.
            two: It explained with two.
            bar: The least gain, in units of the noise's variance.
            share: Share of the usual limits that suffices (1).
        """
        if self.gain_of(nominal, one, two) > share * bar:
            return True
        return self.are_apart(one, two, bar, share)

    def are_apart(self, few: Solution, many: Solution, bar: float, share: float = 1.0) -> bool:
        """Whether the last of `many` contacts is apart from the others and explains most of what `few` leave, one less;
        `bar` and `share` as for `are_two`."""
        gaps = (self._distance(many.params[[k, -1]]) for k in range(len(many.params) - 1))
        return few.cost > max(share * CLEAR, 1) * max(many.cost, bar) and all(gap > APART for gap in gaps)
