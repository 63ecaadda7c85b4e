"""How hard something presses: presses on the contact layer fitted to data, so that force is separated from area.

A contact's strength alone does not determine its force: under more pressure the layer saturates, a wider finger is felt
more strongly, and where patches end matters. So the patches themselves are modelled (`PressedSheet`), and of each
contact place, radius and pressure are fitted together. Force is the integral of the pressure.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import expm1, sqrt

import numpy as np
from scipy.sparse.csgraph import connected_components

from ohmskin.arrays import Floats
from ohmskin.contacts import Contact
from ohmskin.contacts.information import Information
from ohmskin.contacts.kernels import damped_step
from ohmskin.contacts.misfit import NormalEquations
from ohmskin.contacts.solution import inverse
from ohmskin.errors import DataError
from ohmskin.scan import Difference
from ohmskin.sensing.model import SkinModel
from ohmskin.skin import Calibration, Press, PressedSheet

_PER_PRESS = 4  # x, y (m), logarithms of radius (m) and pressure (Pa)
_SPREAD = np.array([0.5, 1.5])  # prior standard deviations of the logarithms of radius and pressure
_LAYER_SPREAD = np.array([1.0, 0.3, 0.2])  # of the logarithm of the layer's conductance, its exponent, its hysteresis
_WIDER, _HARDER = 4.0, 20.0  # factors by which radius and pressure may differ from the usual ones
_MODEL_ERROR = 0.02  # share of a press's signal that the model of the layer gets wrong, here and there
_AMPLITUDE = 0.01  # and of all of it alike
_SIZES = (0.6, 1.0)  # usual radii from which a fit starts
_MOST_HYSTERESIS = 0.5
_NEAR = 0.04  # m; presses so far from each other change 1 to 3 % of what both cause, those half as far 6 %
_ROUNDS, _ENOUGH = 25, 0.02  # most steps, and the gain in squared misfit below which a fit stops
_Cost = tuple[float, Floats, Floats]  # cost, half its curvature and half its downhill gradient


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
class KnownPress:
    """A press of known force and its measurements.

    Args:
        force: Force (N).
        contact: Its contact.
        scans: The changes due to it.
        peak: The greatest force before it fell to this one (N); 0: it was rising.
    """

    force: float
    contact: Contact
    scans: tuple[Difference, ...]
    peak: float = 0.0


@dataclass(frozen=True)
class FittedLayer:
    """A contact layer fitted to presses of known force.

    Args:
        conductance: Per area at the layer's pressure scale (S/m2).
        exponent: Of its growth with pressure (1).
        conductance_std: Standard deviation of the logarithm of the conductance (1).
        exponent_std: Standard deviation of the exponent.
        hysteresis: Of the foam (1), see `ContactLayer`; below 0: unknown, because no press had a falling force.
        unexplained: Share of the changes that no such layer explains, noise included (1).
    """

    conductance: float
    exponent: float
    conductance_std: float
    exponent_std: float
    hysteresis: float
    unexplained: float

    def put_into(self, calibration: Calibration) -> Calibration:
        """The same calibration with this layer."""
        stds = self.conductance_std, self.exponent_std
        own = replace(calibration, layer_conductance=self.conductance, layer_exponent=self.exponent, layer_stds=stds)
        return replace(own, layer_hysteresis=self.hysteresis)


class PressFitter:
    """Fits presses on the contact layer to the contacts of a frame.

    Args:
        known: What is known of the quiet skin.
        model_error: Share of a press's signal that the model of the layer gets wrong (1).
    """

    def __init__(self, known: SkinModel, model_error: float = _MODEL_ERROR) -> None:
        self.known, self._model_error = known, model_error
        self._usual = np.log([1.5 * known.skin.imaging.mesh_size, known.skin.contact_layer.pressure_scale])

    @cached_property
    def sheet(self) -> PressedSheet:
        """The skin as measured by its quiet frames, under its layer as calibrated; made when it is first needed."""
        return self.known.pressed_sheet.with_layer(self.known.skin.calibrated_layer)

    def fit(self, contacts: Sequence[Contact], *scans: Difference) -> tuple[FittedPress, ...]:
        """The presses that explain what `scans` show, one for each of the `contacts` (n,).

        Raises:
            DataError: If no finite datum is left.
        """
        if not contacts:
            return ()
        data = self.information(scans)
        found = min((self._fitted(data, self.start(contacts, size)) for size in _SIZES), key=lambda one: one[1])
        return self.fitted(found[0], inverse(found[2]))

    def fit_layer(self, presses: Sequence[KnownPress]) -> FittedLayer:
        """The layer that explains presses of known force: about ten, at places and forces all over the range.

        One with falling force follows a stronger one at the same place: such pairs determine the foam's hysteresis.

        Raises:
            DataError: If there are fewer than two, a force is not positive, the first one has a falling force, or one
                has no finite datum.
        """
        forces = [press.force for press in presses]
        if len(presses) < 2 or not (np.isfinite(forces).all() and min(forces) > 0):
            raise DataError(f"presses of {forces} N; give two or more, each above 0 N")
        if presses[0].peak:
            raise DataError("the first press has a falling force; begin with a rising one")
        data = [self.information(press.scans) for press in presses]
        layer = self.sheet.skin.contact_layer
        described = np.array([np.log(layer.conductance), layer.exponent, np.log1p(layer.hysteresis)])
        rising = [press.contact for press in presses if not press.peak]
        start = np.concatenate([described, *(self.start([contact], 1.0)[:3] for contact in rising)])

        def moved(params: Floats, step: Floats) -> Floats:
            after = params + step
            after[1:3] = np.clip(after[1:3], [0.1, 0.0], [3.0, np.log1p(_MOST_HYSTERESIS)])
            for k in range(3, len(after), 3):
                after[k : k + 3] = self._within(np.append(after[k : k + 3], self._usual[1]))[:3]
            return after

        found, cost, normal = _minimised(
            start, lambda params: self._under_layer(params, described, presses, data), moved
        )
        stds, all_of_it = np.sqrt(np.diag(inverse(normal))), sum(one.constant for one in data)
        hysteresis = float(np.expm1(found[2])) if len(rising) < len(presses) else -1.0
        left = sqrt(max(cost, 0.0) / all_of_it)
        return FittedLayer(float(np.exp(found[0])), float(found[1]), float(stds[0]), float(stds[1]), hysteresis, left)

    def _under_layer(
        self, params: Floats, described: Floats, presses: Sequence[KnownPress], data: Sequence[NormalEquations]
    ) -> tuple[float, Floats, Floats]:
        """Cost, curvature and downhill gradient of a layer, and of place and size of presses of known force under it.

        Args:
            params: (3 + 3 n,) logarithm of the layer's conductance, its exponent, logarithm of one and its hysteresis;
                x, y and logarithm of the radius of each press that rises, and of those that ease off from it.
            described: (3,) the layer as it was believed to be.
            presses: Of known force.
            data: What was measured under each.
        """
        layer = self.sheet.skin.contact_layer
        sheet = self.sheet.with_layer(replace(layer, conductance=float(np.exp(params[0])), exponent=float(params[1])))
        off = (described - params[:3]) / _LAYER_SPREAD
        cost, normal, gradient = float(off @ off), np.zeros((len(params),) * 2), np.zeros(len(params))
        normal[:3, :3], gradient[:3] = np.diag(_LAYER_SPREAD**-2), off / _LAYER_SPREAD
        number = -1
        for press, measured in zip(presses, data, strict=True):
            number += not press.peak
            at = np.r_[0:3, 3 + 3 * number : 6 + 3 * number]
            turned = layer.turned(press.force / press.peak) if press.peak else 0.0
            own = np.append(params[at[3:]], 0.0)
            own[3] = np.log(press.force / self._press(own).force(layer.foam_spread)) + turned * params[2]
            caused, slopes = sheet.linearised([self._press(own)])
            slopes[:, 2] -= slopes[:, 3] * self._growth(own)  # a wider one of the same force presses less
            slopes[:, 3] *= turned
            part = self._explained(measured, caused, slopes[:, [4, 5, 3, 0, 1, 2]])
            cost += part[0]
            normal[np.ix_(at, at)] += part[1]
            gradient[at] += part[2]
            if not press.peak:
                prior = self._prior(own[None])
                cost += prior[0]
                normal[at[3:], at[3:]] += prior[1][:3]
                gradient[at[3:]] += prior[2][:3]
        return cost, normal, gradient

    def _growth(self, params: Floats) -> float:
        """Derivative of the logarithm of the force by that of the radius, at one pressure."""
        spread, radius = self.known.skin.contact_layer.foam_spread, float(np.exp(params[2]))
        return radius * (6 * radius + 3 * spread) / (3 * radius**2 + 3 * radius * spread + spread**2)

    def information(self, scans: Sequence[Difference], frames: float = 1.0) -> NormalEquations:
        """Information of scans, for this number of `frames` like them; noise averages out, the model's error does not.

        With 0 frames, for a model without error.
        """
        fitter, four = self.known.fitter, np.concatenate([scan.pattern.quadruples for scan in scans])
        repeats = frames * len(four) / len(np.unique(four, axis=0))
        errors = replace(fitter.errors, model=self._model_error * np.sqrt(repeats))
        return Information.of(fitter.table.pairs, errors, scans)[1].misfit.sums

    def start(self, contacts: Sequence[Contact], size: float = 1.0) -> Floats:
        """Parameters (4 n,) of presses at `contacts` (n,): x, y (m), logarithm of the radius (m), which is `size` times
        the usual one, and of the pressure (Pa)."""
        usual = self._usual + np.array([np.log(size), 0.0])
        return np.concatenate([[*contact.position, *usual] for contact in contacts])

    def presses(self, params: Floats) -> list[Press]:
        """The presses of `params` (4 n,), as `start` gives them."""
        return [self._press(one) for one in params.reshape(-1, _PER_PRESS)]

    def _press(self, params: Floats) -> Press:
        x, y, radius, pressure = (float(value) for value in params)
        return Press((x, y), float(np.exp(radius)), float(np.exp(pressure)))

    def _within(self, params: Floats) -> Floats:
        """Parameters (4 n,) with places on the sheet, radii and pressures not absurd."""
        inside = params.reshape(-1, _PER_PRESS).copy()
        inside[:, :2] = self.known.fitter.onto(inside[:, :2])
        reach = np.log([_WIDER, _HARDER])
        inside[:, 2:] = np.clip(inside[:, 2:], self._usual - reach, self._usual + reach)
        return inside.ravel()

    def _fitted(self, data: NormalEquations, start: Floats) -> tuple[Floats, float, Floats]:
        """The parameters (4 n,) of presses near `start` that explain data best, their cost and its curvature."""
        return _minimised(start, lambda params: self.cost(data, params, *self.caused(params)), self.moved)

    def moved(self, params: Floats, step: Floats) -> Floats:
        """Parameters `params` (4 n,) after a `step` (4 n,), limited to the allowed range."""
        by_press, radius = step.reshape(-1, _PER_PRESS).copy(), self.known.fitter.table.radius
        by_press[:, :2] *= np.minimum(1, radius / np.maximum(np.hypot(*by_press[:, :2].T), 1e-300))[:, None]
        by_press[:, 2:] = np.clip(by_press[:, 2:], -1.0, 1.0)
        return self._within(params + by_press.ravel())

    def caused(self, params: Floats) -> tuple[Floats, Floats]:
        """Change of two-terminal resistances (n_pairs,) due to presses, `params` (4 n,), and its slopes (n_pairs, 4 n).

        Presses far from each other are computed separately and added, with an error of about 2 %: time grows with the
        cube of the size.
        """
        presses = self.presses(params)
        groups, parts = self.groups(presses), list[tuple[Floats, Floats]]()
        for group in groups:
            caused, slopes = self.sheet.linearised([presses[k] for k in group])
            parts.append((caused, slopes[:, : _PER_PRESS * len(group)]))
        back = np.argsort(np.concatenate(groups))
        slopes = np.hstack([own for _, own in parts]).reshape(-1, len(presses), _PER_PRESS)[:, back]
        return np.sum([own for own, _ in parts], axis=0), slopes.reshape(len(slopes), -1)

    def groups(self, presses: Sequence[Press]) -> list[list[int]]:
        """Numbers of presses that are near each other, by single linkage."""
        places = np.array([press.position for press in presses])
        offsets = self.known.fitter.table.offsets
        near = [np.hypot(*offsets(np.tile(place, (len(places), 1)), places).T) < _NEAR for place in places]
        labels = connected_components(np.array(near), directed=False)[1]
        return [np.flatnonzero(labels == label).tolist() for label in range(labels.max() + 1)]

    def most_contacts(self, presses: Sequence[Press]) -> int:
        """Most contacts of patches that one of the `groups` of `presses` may close; time grows with its cube."""
        groups = self.groups(presses)
        return max(self.sheet.contacts_under([presses[k] for k in group]) for group in groups)

    def cost(self, data: NormalEquations, params: Floats, caused: Floats, slopes: Floats) -> _Cost:
        """Cost, curvature, downhill gradient in `data`; `params` as for `caused`, `caused` and `slopes` as of it."""
        cost, normal, gradient = self._explained(data, caused, slopes)
        own, precision, pull = self._prior(params.reshape(-1, _PER_PRESS))
        return cost + own, normal + np.diag(precision), gradient + pull

    @staticmethod
    def _explained(data: NormalEquations, caused: Floats, slopes: Floats) -> _Cost:
        """Cost, curvature and downhill gradient of what is caused, up to a common error of all of it."""
        matrix, vector = data.matrix, data.vector
        left, seen = vector - matrix @ caused, matrix @ slopes
        error = _AMPLITUDE * caused
        felt = matrix @ error
        share = 1 / (1 + error @ felt)
        cost = data.constant - caused @ (vector + left) - share * (error @ left) ** 2
        normal = slopes.T @ seen - share * np.outer(slopes.T @ felt, felt @ slopes)
        return float(cost), normal, slopes.T @ (left - share * felt * (error @ left))

    def _prior(self, presses: Floats) -> tuple[float, Floats, Floats]:
        """What is known of presses (n, 4) before: its cost, precision (4 n,) and pull (4 n,)."""
        off = np.zeros_like(presses)
        off[:, 2:] = (self._usual - presses[:, 2:]) / _SPREAD
        stds = np.tile([*[2 * self.known.fitter.table.radius] * 2, *_SPREAD], len(presses))
        return float((off**2).sum()), stds**-2.0, off.ravel() / stds

    def fitted(self, params: Floats, covariance: Floats) -> tuple[FittedPress, ...]:
        """Presses, `params` (4 n,) of a `covariance` (4 n, 4 n), with forces; uncertainty of the layer included. Errors
        are of the logarithm, at most its prior's: that of a force is of the upper one."""
        fitted, layer, stds = [], self.sheet.skin.contact_layer, self.known.skin.calibration.layer_stds or (0.0, 0.0)
        for k, own in enumerate(params.reshape(-1, _PER_PRESS)):
            at = slice(_PER_PRESS * k, _PER_PRESS * (k + 1))
            press = self._press(own)
            force, slope = press.force(layer.foam_spread), np.array([self._growth(own), 1.0])
            variance = min(slope @ covariance[at, at][2:, 2:] @ slope, ((slope * _SPREAD) ** 2).sum())
            off = np.array([1.0, np.log(press.pressure / layer.pressure_scale)]) / layer.exponent
            std = sqrt(variance + float(((off * np.array(stds)) ** 2).sum()))
            fitted.append(FittedPress(press, force, force * expm1(std), covariance[at, at]))
        return tuple(fitted)


def _minimised(
    params: Floats, evaluated: Callable[[Floats], _Cost], moved: Callable[[Floats, Floats], Floats]
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
        if step @ gradient < _ENOUGH:
            break
        after = moved(params, step)
        trial = evaluated(after)
        gain = cost - trial[0]
        if gain > 0:
            params, (cost, normal, gradient), damping = after, trial, damping / 8
        else:
            damping *= 8
        if abs(gain) < _ENOUGH or damping > 1e4:
            break
    return params, cost, normal
