"""Discs fitted to data: a given number of them, with places, effects and radii free.

A contact's parameters are x, y (m), effect (relative conductivity change times area, m2) and squared radius (m2).
"""

from copy import copy
from dataclasses import replace
from math import erf, pi, sqrt
from operator import attrgetter
from typing import Self

import numpy as np

from ohmskin.arrays import Floats, changed
from ohmskin.contacts import kernels, refit
from ohmskin.contacts.finder import Contact
from ohmskin.contacts.information import Errors, Information
from ohmskin.contacts.solution import PER_CONTACT, Solution, effect_std, nothing, similarity_prior
from ohmskin.forward import ContactTable
from ohmskin.scan import Difference
from ohmskin.scan.pairs import in_series

_LEAST, _MOST = 0.1, 9.0  # squared radius that a fit may take, as shares of the usual one; the table ends there
_STARTS, _PROMISE = 3, 0.7  # places from which a fit starts, and the share of the best score that makes one worth it
NEAR = 4.0  # radii, within which two contacts may be one
APART = 1.15  # of the sum of their radii, from which on no shape of one contact looks like two
_SIZES = 0.7, 1.0, 1.6  # usual radii, from which the fit of one contact in place of two starts
_BLUR = 1.4  # radii times the model's error: how far that may move a contact
_SAME = 1.2  # times what is left of one frame's data which the next one may leave if it is to show the same
_BESIDE = 2.0  # usual radii within which two contacts may be one beside an electrode
_REACH = 1.5  # usual radii within which a contact is beside an electrode
_MOVES = 10.0  # times the model's error: share of a contact's effect that may lie on one side of it (deviation)
_AS_WELL = 0.25  # share by which one contact may leave more there than two, where the model's error is what they leave
_ALTERED = 2.0  # times the effect that a contact then may have
cost_of = attrgetter("cost")
Both = tuple[Information, Information]  # with nominal noise, and with noise inflated by the model's error


class DiscFitter:
    """Fits discs to data.

    Args:
        table: Responses of contacts.
        errors: How data err.
        bipolar: Whether contacts may lower the conductivity, too.

    Attributes:
        model_error: How far the model of a contact errs, as a share of its signal (1).
        places: (n_places, 2) where new contacts are looked for (m).
        squares: Least and largest squared radius (m2).
    """

    def __init__(self, table: ContactTable, errors: Errors, bipolar: bool = False) -> None:
        self.table, self.errors, self.bipolar, self.model_error = table, errors, bipolar, errors.model
        chosen = table.spaced(1.25 * table.radius)
        self.places: Floats = table.places[chosen]
        candidates = table(self.places).values.T  # (n_pairs, n_places), and a row that no pair has
        candidates = np.concatenate([candidates, np.zeros((1, len(chosen)))])
        self._candidates = np.ascontiguousarray(candidates, np.float32)
        self.squares = _LEAST * table.radius**2, _MOST * table.radius**2
        self._least = -np.inf if bipolar else 1e-3 * table.radius**2

    def drifting(self, uneven: float) -> Self:
        """The same for a sheet that drifts unevenly, by a relative change of conductivity (1)."""
        if uneven == self.errors.uneven:
            return self
        other = copy(self)
        other.errors = replace(self.errors, uneven=uneven)
        return other

    # --- what is measured ---------------------------------------------------------------------------------------------

    def information(self, *scans: Difference, drift: Floats | None = None) -> tuple[Information, Information]:
        """Information of one scan, or of several fused; and the same with the model's error as noise.

        Args:
            scans: As measured.
            drift: (n_pairs,) known change of two-terminal resistances beside contacts (ohm).

        Raises:
            DataError: If no finite datum is left.
        """
        return Information.of(self.table.pairs, self.errors, scans, drift)

    def allowance(self, data: Information) -> float:
        """How much data count when contacts are fitted: less than by their noise, as the model errs, too (1)."""
        return 1 / (1 + (self.model_error * data.signal) ** 2)

    def relative_cost(self, nominal: Information, cost: float) -> float:
        """How many times more a fit of that cost leaves of what is measured than is usual, noise and the model's
        errors."""
        share = self.allowance(nominal)
        return cost / (nominal.count * (share + refit.USUAL * (1 - share)))

    def poor(self, nominal: Information, cost: float) -> bool:
        """Whether a fit of that cost leaves more than is usual."""
        return self.relative_cost(nominal, cost) > 1

    def usual_squares(self, squares: float, count: int) -> float:
        """What contacts usually leave of voltages, so many, whose squares have that sum (V2)."""
        return count * self.errors.noise**2 + refit.USUAL * self.model_error**2 * squares

    def onto(self, positions: Floats) -> Floats:
        """Positions (n, 2), those off the sheet replaced by the closest place on it (m)."""
        inside = np.array(positions, float, order="C")
        kernels.all_onto(inside, self.table.sheet)
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

    def shapes(self, params: Floats) -> Floats:
        """What small contacts of (n, 4) may change (n_pairs, 2 k) more one way than across, for one deviation (ohm)."""
        own = np.ascontiguousarray(params[:, :PER_CONTACT])
        return np.asarray(refit.shapes_of(own, self.table.radius, self.model_error, self.table.spline).T)

    def covered(self, params: Floats) -> list[int]:
        """The electrodes under contacts (n, 4)."""
        return list(kernels.covering(params, self.table.electrodes, self.table.period).tolist())

    def uncovered(self, data: Information, covered: tuple[int, ...]) -> Information:
        """Data of which nothing that the resistances of some electrodes do is taken to be known."""
        return data.excluding(in_series(covered, self.table.pairs)) if covered else data

    def beside_electrodes(
        self, whole: Information, data: Information, found: Solution, covered: tuple[int, ...]
    ) -> tuple[tuple[int, ...], Solution]:
        """The electrodes under contacts, and the contacts with nothing taken to be known of the resistances of these.

        Those that no contact lies on any more, once that is not known, are not counted; nor are any where contacts
        move there only because of the shapes that they had elsewhere.

        Args:
            whole: What is measured, with the model's error as noise.
            data: The same, beside shapes of the contacts.
            found: The contacts.
            covered: The electrodes under them whose resistances are not known.
        """
        under = (*covered, *(number for number in self.covered(found.params) if number not in covered))
        if under == covered:
            return covered, found
        beside = self.refine(self.uncovered(data, under), found.params, *self.prior(found.params))
        here, there = (self._left_by(self.uncovered(whole, under), one) for one in (found, beside))
        return (under, beside) if {*under} <= {*self.covered(beside.params)} and there <= here else (covered, found)

    def _left_by(self, data: Information, found: Solution) -> float:
        """What contacts leave of the data beside the shapes that they may have where they are (noise's variance)."""
        return data.marginalised(self.shapes(found.params)).minus(found.caused).misfit.constant

    def joined(self, whole: Both, found: Solution, covered: tuple[int, ...]) -> Solution:
        """The contacts, one in place of two that are closer than one is wide, or over an electrode where one leaves no
        more than is usual.

        Two that are taken for ones so close are the patches under one press. Patches over an electrode reach beyond it,
        on one side further than on the other. No disc does that, but two do, one on each side: over an electrode, what
        the model gets wrong of one contact looks like two. Patches beside it short what is under a side of it, as if it
        had moved; beside an electrode that has, one contact may explain as much as two do.

        Args:
            whole: What is measured, and the same with the model's error as noise.
            found: The contacts.
            covered: The electrodes under them.
        """
        ends = np.argwhere(np.triu(np.ones((len(found.params),) * 2, bool), 1))
        for both in sorted(ends, key=lambda both: self._distance(found.params[both])):
            pair, others = found.params[both], np.delete(found.params, both, axis=0)
            alike, gap = pair[0, 2] * pair[1, 2] > 0, float(np.linalg.norm(self.table.offsets(*pair[:, :2])))
            close = alike and gap < self.table.radius
            if close or (self._distance(pair) <= APART and {*self.covered(pair)} & {*covered}):
                one, left = self._in_place_of(pair, others, whole, covered)
                if {*covered} <= {*self.covered(one.params)} and (close or left <= 1):
                    return self.joined(whole, one, covered)
            elif alike and gap < _BESIDE * self.table.radius:
                limit = (1 + _AS_WELL * (1 - self.allowance(whole[0]))) * found.cost
                for number in self._near(pair):
                    one, left = self._in_place_of(pair, others, whole, (*covered, number), number)
                    if left <= 1 and one.cost < limit:
                        return self.joined(whole, one, covered)
        return found

    def _near(self, params: Floats) -> list[int]:
        """The electrodes beside or under contacts (n, 4)."""
        away = (self.table.offsets(self.table.electrodes[:, None], params[:, :2]) ** 2).sum(axis=2)
        return list(np.flatnonzero((away < (_REACH * self.table.radius) ** 2).any(axis=1)).tolist())

    def _in_place_of(
        self, pair: Floats, others: Floats, whole: Both, unknown: tuple[int, ...], moved: int | None = None
    ) -> tuple[Solution, float]:
        """One contact in place of two (2, 4) beside `others` (n, 4), and how many times more than usual it leaves.

        Nothing is taken to be known of `unknown` electrodes' resistances; that contact may have `moved` an electrode.
        """
        share, together = abs(pair[1, 2]) / np.abs(pair[:, 2]).sum(), pair[:, 2].sum()
        middle = self.onto(pair[:1, :2] + share * self.table.offsets(pair[1:, :2], pair[:1, :2]))[0]
        squares = ((size * self.table.radius) ** 2 for size in _SIZES)
        starts = np.array([np.vstack([others, [*middle, together, square]]) for square in squares])
        if moved is not None:
            ways = _MOVES * self.model_error * together * self._moves(moved)
            whole = whole[0].marginalised(ways), whole[1].marginalised(ways)
        usual, data = (self.uncovered(one, unknown) for one in self.beside_shapes(whole, starts[0]))
        one = self.refine(data, starts, *self.prior(starts[0]))
        return one, self.relative_cost(usual, self._left_by(self.uncovered(whole[1], unknown), one))

    def _moves(self, electrode: int) -> Floats:
        """What a contact's effect of 1 m2 on one side of an electrode rather than on the other changes (n_pairs, 2)."""
        sides = self.table.radius * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        changes = self.table(self.onto(self.table.electrodes[electrode] + sides)).values
        return np.asarray((changes[::2] - changes[1::2]).T / 2)

    def pairs(self, left: Information, one: Floats) -> tuple[Floats, Floats]:
        """Axes (n, 2) (m) along which a contact (4,) may be a small pair, and by how many deviations (n,) it would
        stand out, given what remains to be explained beside all contacts."""
        return refit.split_gains(left.misfit.part, one, self.table.radius, self.table.sheet, self.table.spline)

    def gain_of(self, nominal: Information, few: Solution, many: Solution) -> float:
        """By how much `many` contacts explain `nominal` data better than `few` (noise's variance), less model error."""
        return (few.cost - many.cost) / self.allowance(nominal) - (self.model_error * nominal.norm(few.caused)) ** 2

    def _distance(self, pair: Floats) -> float:
        """Of two contacts (2, 4), over the sum of their radii (1)."""
        return float(np.linalg.norm(self.table.offsets(*pair[:, :2])) / np.sqrt(pair[:, 3]).sum())

    # --- one contact more? --------------------------------------------------------------------------------------------

    def scores(self, left: Information) -> tuple[Floats, Floats]:
        """Score and power (n_places,) of a further contact at each place: their ratio is its effect (m2)."""
        return left.misfit.scores(self._candidates)

    def heights(self, score: Floats, power: Floats) -> Floats:
        """Standard deviations by which scores stand out; signed where contacts only raise the conductivity."""
        return np.asarray((np.abs(score) if self.bipolar else score) / np.sqrt(power))

    def added(self, data: Information, score: Floats, power: Floats, known: Floats | None = None) -> Solution:
        """The contacts `known` (n, 4) and one more that explain the data best, of a few places that promise most."""
        apart, period = 1.4 * self.table.radius, self.table.period
        places = kernels.peaks(self.heights(score, power), self.places, _STARTS, _PROMISE, apart, period)
        starts = np.empty((len(places), (0 if known is None else len(known)) + 1, PER_CONTACT))
        starts[:, :-1] = starts[:, :0] if known is None else known
        starts[:, -1, :2], starts[:, -1, 3] = self.places[places], self.table.radius**2
        starts[:, -1, 2] = score[places] / power[places]
        return self.refine(data, starts)

    # --- fitting ------------------------------------------------------------------------------------------------------

    def expected(self, effects: Floats) -> tuple[Floats, Floats]:
        """Mean (4 n,) and information (4 n, 4 n) of contacts of about these effects (n,) (m2) before any data."""
        low, high, *_, period = self.table.sheet
        return kernels.expected(np.ascontiguousarray(effects, float), self.table.radius, low, high, period)

    def prior(self, params: Floats) -> tuple[Floats, Floats]:
        """Prior mean (4 n,) and information of contacts about `params` (n, 4): close ones are about equally strong.

        Data show how strong these are together, and hardly which share each has: without that, one may become a shadow
        of the other.
        """
        mean, information = self.expected(params[:, 2])
        if len(params) > 1:
            away = np.linalg.norm(self.table.offsets(params[:, None, :2], params[:, :2]), axis=2)
            for both in np.argwhere(np.triu(away < NEAR * self.table.radius, 1)):
                information += similarity_prior(len(params), both, np.abs(params[both, 2]).sum())
        return mean, information

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
            start: Where to start; of several (m, n, 4) the one that leads to the best fit.
            mean: (4 n,) believed before, as `expected` of the effects unless given.
            information: (4 n, 4 n) inverse of its covariance, likewise.
            rounds: Most steps.
        """
        misfit, best = data.misfit, nothing(len(data.misfit.vector) - 1, np.inf)
        for one in np.array(start[..., :PER_CONTACT], float).reshape(-1, *start.shape[-2:-1], PER_CONTACT):
            known, prior = mean, information
            if known is None or prior is None:
                known, prior = self.expected(one[:, 2])
            cost, normal, caused, slopes = kernels.refined(
                one, misfit.rows, misfit.downdates, misfit.vector, misfit.constant, known, np.ascontiguousarray(prior),
                rounds, self.table.radius, self._least, *self.squares, self.table.sheet, self.table.spline, best.cost,
            )  # fmt: skip
            if cost < best.cost or not len(best.params):
                best = Solution(one, cost, normal, caused, slopes.T)
        return best

    def beside_shapes(self, both: Both, params: Floats) -> Both:
        """Information without what it says of the shapes of contacts (n, 4)."""
        shapes = self.shapes(params)
        return (both[0].marginalised(shapes), both[1].marginalised(shapes)) if shapes.size else both

    def followed(self, nominal: Information, inflated: Information, before: Solution) -> Solution | None:
        """Contacts that explained the last frame poorly, fitted to one that looks the same: a search would take long,
        without success. None where they explained it, or this one looks different.

        Args:
            nominal: What is measured.
            inflated: The same, with the model's error as noise.
            before: The contacts of the last frame.
        """
        if not (before.poor and len(before.params)):
            return None
        beside = self.uncovered(inflated.marginalised_common(), before.covered)
        found = self.refine(beside, before.params, *self.prior(before.params))
        left = nominal.signals(found.caused)[1] / before.poor
        effects = found.params[:, 2] / before.params[:, 2]
        away = np.linalg.norm(self.table.offsets(found.params[:, :2], before.params[:, :2]), axis=1)
        alike = 1 / _SAME < left < _SAME and effects.min() > 1 / _ALTERED and effects.max() < _ALTERED
        if not alike or away.max() > self.table.radius:
            return None
        return changed(found, covered=before.covered, shapes=self.shapes(found.params), poor=before.poor)

    def contact(self, params: Floats, covariance: Floats) -> Contact:
        """A contact to report, from its parameters (4,) and their covariance (4, 4)."""
        (x, y), (effect, square) = self.onto(params[None, :2])[0].tolist(), params[2:].tolist()
        # the model's own error moves a contact by about its share of two radii, however little noise there is
        floor = (_BLUR * self.model_error * self.table.radius) ** 2
        (xx, xy), (_, yy) = covariance[:2, :2].tolist()
        area = pi * square
        return Contact(
            position=(x, y),
            extent=area,
            strength=effect,
            confidence=0.5 * (1 + erf(abs(effect) / (sqrt(2) * effect_std(covariance)))),
            peak=effect / area,
            covariance=((xx + floor, xy), (xy, yy + floor)),
            radius=sqrt(square),
        )

    def contacts(self, found: Solution) -> tuple[Contact, ...]:
        """The contacts of a fit, strongest first."""
        listed = [self.contact(*one) for one in zip(found.params, found.covariances, strict=True)]
        return tuple(sorted(listed, key=lambda contact: -abs(contact.strength)))
