"""How hard something presses: presses on the contact layer fitted to data, so that force is separated from area.

A contact's strength alone does not determine its force: under more pressure the layer saturates, a wider finger is felt
more strongly, and where patches end matters. So the patches themselves are modelled (`PressedSheet`), and of each
contact place, radius and pressure are fitted together. Force is the integral of the pressure.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, expm1, sqrt
from operator import attrgetter
from typing import TypeVar

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtr

from ohmskin.arrays import Floats, Ints
from ohmskin.contacts import Contact
from ohmskin.contacts.information import Information
from ohmskin.contacts.kernels import damped_step
from ohmskin.contacts.misfit import NormalEquations
from ohmskin.contacts.solution import inverse
from ohmskin.scan import Difference
from ohmskin.sensing.model import SkinModel
from ohmskin.skin import ContactLayer, Press, PressedSheet

_PER_PRESS = 4  # x, y (m), logarithms of radius (m) and pressure (Pa)
_SPREAD = np.array([0.5, 1.5])  # prior standard deviations of the logarithms of radius and pressure
_WIDER, _HARDER = 4.0, 20.0  # factors by which radius and pressure may differ from the usual ones
_MODEL_ERROR = 0.02  # share of a press's signal that the model of the layer gets wrong, here and there
_AMPLITUDE = 0.01  # and of all of it alike
_SIZES = (0.6, 1.0)  # usual radii from which a fit starts
_OTHER = 1.25  # factor of the radius to the next fits that are tried, of the same force
LINEAR = np.array([5e-4, 5e-4, 0.1, 0.2])  # m, m, logarithms of radius and pressure: changes that are small
_NEAR = 0.04  # m; presses so far from each other change 1 to 3 % of what both cause, those half as far 6 %
_ROUNDS, ENOUGH = 25, 0.02  # most steps, and the gain in squared misfit below which a fit stops
Cost = tuple[float, Floats, Floats]  # cost, half its curvature and half its downhill gradient
T = TypeVar("T")
cost_of = attrgetter("cost")


@dataclass(frozen=True)
class FittedPress:
    """A press fitted to a contact.

    Args:
        press: Place, radius and pressure.
        force: Integral of the pressure (N).
        force_std: Its standard deviation (N).
        covariance: (4, 4) of x, y (m), and the logarithms of radius and pressure.
    """

    press: Press
    force: float
    force_std: float
    covariance: Floats

    def scaled(self, share: float, relative: float) -> "FittedPress":
        """A share of the press, whose force has a `relative` standard deviation (1)."""
        press, force = replace(self.press, pressure=share * self.press.pressure), share * self.force
        return FittedPress(press, force, relative * force, self.covariance)


@dataclass(frozen=True, eq=False)
class Optimum:
    """Presses that explain data better than any like them.

    Args:
        params: (4 n,) of the presses, see `PressFitter.start`.
        cost: Squared misfit, the prior included.
        covariance: (4 n, 4 n).
    """

    params: Floats
    cost: float
    covariance: Floats


class PressFitter:
    """Fits presses on the contact layer to the contacts of a frame.

    Args:
        known: What is known of the quiet skin.
        model_error: Share of a press's signal that the model of the layer gets wrong (1).
    """

    def __init__(self, known: SkinModel, model_error: float = _MODEL_ERROR) -> None:
        self.known, self._model_error, self._calibration = known, model_error, known.skin.calibration
        self.usual = np.log([1.5 * known.skin.imaging.mesh_size, known.skin.contact_layer.pressure_scale])

    @cached_property
    def sheet(self) -> PressedSheet:
        """The skin as measured by its quiet frames, under its layer as calibrated; made when it is first needed."""
        return self.known.pressed_sheet.with_layer(self.known.skin.calibrated_layer)

    def under(self, layer: ContactLayer) -> "PressFitter":
        """The same fitter, with the skin under another layer, as if that were known exactly."""
        other = copy(self)
        other.sheet = self.sheet.with_layer(layer)
        other._calibration = replace(self._calibration, layer_stds=(), layer_error=0.0)
        return other

    def fit(self, contacts: Sequence[Contact], *scans: Difference) -> tuple[FittedPress, ...]:
        """The presses that explain what `scans` show, one for each of the `contacts` (n,).

        Raises:
            DataError: If no finite datum is left.
        """
        if not contacts:
            return ()
        data = self.information(scans)
        found = [self._optimum(data, self.start(contacts, size)) for size in _SIZES]
        best, before = min(found, key=cost_of), np.inf
        while best.cost < before - ENOUGH:
            found += [self._optimum(data, self.resized(best.params, factor)) for factor in (1 / _OTHER, _OTHER)]
            best, before = min(found, key=cost_of), best.cost
        return self.weighed(distinct(sorted(found, key=cost_of), attrgetter("params")))

    def growth(self, params: Floats) -> float:
        """Derivative of the logarithm of a force by that of the radius, at one pressure; `params` (4,) of the press."""
        spread, radius = self.known.skin.contact_layer.foam_spread, float(np.exp(params[2]))
        return radius * (6 * radius + 3 * spread) / (3 * radius**2 + 3 * radius * spread + spread**2)

    def information(self, scans: Sequence[Difference], frames: float = 1.0) -> NormalEquations:
        """Information of scans, for this number of `frames` like them; noise averages out, the model's error does not.

        With 0 frames, for a model without error.
        """
        fitter, four = self.known.fitter, np.concatenate([scan.pattern.quadruples for scan in scans])
        numbers = np.ravel_multi_index(tuple(four.T), (int(four.max()) + 1,) * 4)  # sorted much faster than rows
        repeats = frames * len(four) / len(np.unique(numbers))
        errors = replace(fitter.errors, model=self._model_error * np.sqrt(repeats))
        return Information.of(fitter.table.pairs, errors, scans)[1].misfit.sums

    def start(self, contacts: Sequence[Contact], size: float = 1.0) -> Floats:
        """Parameters (4 n,) of presses at `contacts` (n,): x, y (m), logarithm of the radius (m), which is `size` times
        the usual one, and of the pressure (Pa)."""
        usual = self.usual + np.array([np.log(size), 0.0])
        return np.concatenate([[*contact.position, *usual] for contact in contacts])

    def presses(self, params: Floats) -> list[Press]:
        """The presses of `params` (4 n,), as `start` gives them."""
        return [self.press(one) for one in params.reshape(-1, _PER_PRESS)]

    def press(self, params: Floats) -> Press:
        """The press of `params` (4,), as `start` gives them."""
        x, y, radius, pressure = (float(value) for value in params)
        return Press((x, y), float(np.exp(radius)), float(np.exp(pressure)))

    def within(self, params: Floats) -> Floats:
        """Parameters `params` (4 n,) with places on the sheet, radii and pressures not absurd."""
        inside = params.reshape(-1, _PER_PRESS).copy()
        inside[:, :2] = self.known.fitter.onto(inside[:, :2])
        reach = np.log([_WIDER, _HARDER])
        inside[:, 2:] = np.clip(inside[:, 2:], self.usual - reach, self.usual + reach)
        return inside.ravel()

    def _optimum(self, data: NormalEquations, start: Floats) -> Optimum:
        """The presses near `start` (4 n,) that explain data best."""
        found, cost, normal = minimised(start, lambda params: self.cost(data, params, *self.caused(params)), self.moved)
        return Optimum(found, cost, inverse(normal))

    def resized(self, params: Floats, factor: float) -> Floats:
        """Presses `params` (4 n,) with radii `factor` times as large, of the same force, about."""
        other = params.reshape(-1, _PER_PRESS).copy()
        other[:, 2:] += np.log(factor) * np.array([1.0, -2.0])
        return self.within(other.ravel())

    def moved(self, params: Floats, step: Floats) -> Floats:
        """Parameters `params` (4 n,) after a `step` (4 n,), limited to the allowed range."""
        by_press, radius = step.reshape(-1, _PER_PRESS).copy(), self.known.fitter.table.radius
        by_press[:, :2] *= np.minimum(1, radius / np.maximum(np.hypot(*by_press[:, :2].T), 1e-300))[:, None]
        by_press[:, 2:] = np.clip(by_press[:, 2:], -1.0, 1.0)
        return self.within(params + by_press.ravel())

    def caused(self, params: Floats) -> tuple[Floats, Floats]:
        """Change of two-terminal resistances (n_pairs,) due to presses, `params` (4 n,), and its slopes (n_pairs, 4 n).

        Of presses far from each other what they do to each other is taken to first order: time grows with the cube of
        the size.
        """
        presses = self.presses(params)
        caused, slopes = self.sheet.linearised(presses, self.groups(presses))
        return caused, slopes[:, : len(params)]

    def groups(self, presses: Sequence[Press]) -> Ints:
        """The group (n,) of each of the `presses`: those near each other, by single linkage, are in one."""
        if len(presses) == 1:
            return np.zeros(1, int)
        places = np.array([press.position for press in presses])
        offsets = self.known.fitter.table.offsets
        near = [np.hypot(*offsets(np.tile(place, (len(places), 1)), places).T) < _NEAR for place in places]
        return np.asarray(connected_components(np.array(near), directed=False)[1])

    def most_contacts(self, presses: Sequence[Press]) -> int:
        """Most contacts of patches that one of the `groups` of `presses` may close; time grows with its cube."""
        groups = self.groups(presses)
        return max(
            self.sheet.contacts_under(press for press, one in zip(presses, groups, strict=True) if one == group)
            for group in np.unique(groups)
        )

    def cost(self, data: NormalEquations, params: Floats, caused: Floats, slopes: Floats) -> Cost:
        """Cost, curvature, downhill gradient in `data`; `params` as for `caused`, `caused` and `slopes` as of it."""
        cost, normal, gradient = self.explained(data, caused, slopes)
        own, precision, pull = self.prior(params.reshape(-1, _PER_PRESS))
        return cost + own, normal + np.diag(precision), gradient + pull

    @staticmethod
    def explained(data: NormalEquations, caused: Floats, slopes: Floats) -> Cost:
        """Cost, curvature and downhill gradient in `data` of what is `caused` (n_pairs,) (ohm), up to a common error of
        all of it, by its `slopes` (n_pairs, k)."""
        matrix, vector = data.matrix, data.vector
        left, seen = vector - matrix @ caused, matrix @ slopes
        error = _AMPLITUDE * caused
        felt = matrix @ error
        share = 1 / (1 + error @ felt)
        cost = data.constant - caused @ (vector + left) - share * (error @ left) ** 2
        normal = slopes.T @ seen - share * np.outer(slopes.T @ felt, felt @ slopes)
        return float(cost), normal, slopes.T @ (left - share * felt * (error @ left))

    def prior(self, presses: Floats) -> tuple[float, Floats, Floats]:
        """What is known of `presses` (n, 4) before: its cost, precision (4 n,) and pull (4 n,)."""
        off = np.zeros_like(presses)
        off[:, 2:] = (self.usual - presses[:, 2:]) / _SPREAD
        stds = np.tile([*[2 * self.known.fitter.table.radius] * 2, *_SPREAD], len(presses))
        return float((off**2).sum()), stds**-2.0, off.ravel() / stds

    def weighed(self, fits: Sequence[Optimum], settled: Sequence[bool] = ()) -> tuple[FittedPress, ...]:
        """The presses, by all that they may be.

        Light and wide may explain data as well as hard and narrow. So each of the `fits` has its share, by likelihood;
        the force told is the median, and how all differ is a part of its error.

        Args:
            fits: What presses may be, the likeliest first.
            settled: Which of them count for the median; all unless given.
        """
        there = np.array(settled or [True] * len(fits))
        costs = np.array([fit.cost for fit in fits])
        shares = np.exp(np.minimum(costs[there].min() - costs, 0.0) / 2)
        likely, best = [self._fitted(fit.params, fit.covariance) for fit in fits], int(there.argmax())
        told = []
        for presses in zip(*likely, strict=True):
            logs, stds = np.log([(one.force, 1 + one.force_std / one.force) for one in presses]).T
            middle = _median(logs[there], stds[there], shares[there])
            std = sqrt(float(np.average(stds**2 + (logs - middle) ** 2, weights=shares)))
            told.append(presses[best].scaled(exp(middle) / presses[best].force, expm1(std)))
        return tuple(told)

    def _fitted(self, params: Floats, covariance: Floats) -> tuple[FittedPress, ...]:
        """Presses, `params` (4 n,) of a `covariance` (4 n, 4 n), with forces; uncertainty of the layer included. Errors
        are of the logarithm, at most its prior's: that of a force is of the upper one."""
        fitted, layer, calibration = [], self.sheet.skin.contact_layer, self._calibration
        stds = calibration.layer_stds or (0.0, 0.0)
        for k, own in enumerate(params.reshape(-1, _PER_PRESS)):
            at = slice(_PER_PRESS * k, _PER_PRESS * (k + 1))
            press = self.press(own)
            force, slope = press.force(layer.foam_spread), np.array([self.growth(own), 1.0])
            variance = min(slope @ covariance[at, at][2:, 2:] @ slope, ((slope * _SPREAD) ** 2).sum())
            off = np.array([1.0, np.log(press.pressure / layer.pressure_scale)]) / layer.exponent
            std = sqrt(variance + float(((off * np.array(stds)) ** 2).sum()) + calibration.layer_error**2)
            fitted.append(FittedPress(press, force, force * expm1(std), covariance[at, at]))
        return tuple(fitted)


def distinct(fits: Sequence[T], params: Callable[[T], Floats]) -> list[T]:
    """Fits, the best first, those left out whose `params` (4 n,) are those of a better one, about."""
    kept = list[T]()
    for fit in fits:
        if not any(small(params(fit) - params(other)) for other in kept):
            kept.append(fit)
    return kept


def small(step: Floats) -> bool:
    """Whether a step (4 n,) is so small that what presses change is linear in it, about."""
    return bool((np.abs(step.reshape(-1, _PER_PRESS)) <= LINEAR).all())


def _median(means: Floats, stds: Floats, shares: Floats) -> float:
    """Of normal distributions, each with its share."""
    grid = np.linspace(float((means - 3 * stds).min()), float((means + 3 * stds).max()), 500)
    below = ndtr((grid[:, None] - means) / stds) @ shares
    return float(np.interp(shares.sum() / 2, below, grid))


def minimised(
    params: Floats, evaluated: Callable[[Floats], Cost], moved: Callable[[Floats, Floats], Floats]
) -> tuple[Floats, float, Floats]:
    """Levenberg and Marquardt: parameters, cost and curvature.

    Args:
        params: Where to start.
        evaluated: Cost, half its curvature and half its downhill gradient at parameters.
        moved: Parameters after a step, within bounds.
    """
    damping = 1e-2
    cost, normal, gradient = evaluated(params)
    for _ in range(_ROUNDS):
        step = gradient.copy()
        damped_step(normal, damping, step)
        if step @ gradient < ENOUGH:
            break
        after = moved(params, step)
        trial = evaluated(after)
        gain = cost - trial[0]
        if gain > 0:
            params, (cost, normal, gradient), damping = after, trial, damping / 8
        else:
            damping *= 8
        if abs(gain) < ENOUGH or damping > 1e4:
            break
    return params, cost, normal
