"""The contact layer, calibrated: its conductance, exponent and hysteresis from presses of known force."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from scipy.optimize import minimize_scalar

from ohmskin.arrays import Floats
from ohmskin.contacts import Contact
from ohmskin.contacts.misfit import NormalEquations
from ohmskin.contacts.solution import inverse
from ohmskin.errors import DataError
from ohmskin.scan import Difference
from ohmskin.sensing.presses import Cost, PressFitter, minimised
from ohmskin.skin import Calibration

_SPREAD = np.array([1.0, 0.3, 0.2])  # of the logarithm of the layer's conductance, its exponent, its hysteresis
_EXPONENTS = 0.1, 3.0  # that a layer may have
_MOST_HYSTERESIS = 0.5


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
        unexplained: Share of the changes that no such layer explains, noise left out (1).
        error: Of the forces of those presses, fitted under it without being known, beyond what is known of each:
            standard deviation of the logarithm (1).
    """

    conductance: float
    exponent: float
    conductance_std: float
    exponent_std: float
    hysteresis: float
    unexplained: float
    error: float

    def put_into(self, calibration: Calibration) -> Calibration:
        """The same calibration with this layer."""
        stds = self.conductance_std, self.exponent_std
        own = replace(calibration, layer_conductance=self.conductance, layer_exponent=self.exponent, layer_stds=stds)
        return replace(own, layer_hysteresis=self.hysteresis, layer_error=self.error)


def fit_layer(fitter: PressFitter, presses: Sequence[KnownPress]) -> FittedLayer:
    """The layer that explains presses of known force: about ten, at places and forces all over the range.

    One with falling force follows a stronger one at the same place: such pairs determine the foam's hysteresis.

    Args:
        fitter: Knows the quiet skin, and the layer as it was believed to be.
        presses: Of known force.

    Raises:
        DataError: If there are fewer than two, a force is not positive, the first one has a falling force, one has no
            finite datum, or the forces are not those of the presses.
    """
    forces = [press.force for press in presses]
    if len(presses) < 2 or not (np.isfinite(forces).all() and min(forces) > 0):
        raise DataError(f"presses of {forces} N; give two or more, each above 0 N")
    if presses[0].peak:
        raise DataError("the first press has a falling force; begin with a rising one")
    data = [fitter.information(press.scans) for press in presses]
    layer = fitter.sheet.skin.contact_layer
    described = np.array([np.log(layer.conductance), layer.exponent, np.log1p(layer.hysteresis)])
    rising = [press.contact for press in presses if not press.peak]
    found = np.concatenate([described, *(fitter.start([contact], 1.0)[:3] for contact in rising)])

    def moved(params: Floats, step: Floats) -> Floats:
        after = params + step
        after[1:3] = np.clip(after[1:3], [_EXPONENTS[0], 0.0], [_EXPONENTS[1], np.log1p(_MOST_HYSTERESIS)])
        for k in range(3, len(after), 3):
            after[k : k + 3] = fitter.within(np.append(after[k : k + 3], fitter.usual[1]))[:3]
        return after

    def fitted(start: Floats, basis: Floats) -> tuple[Floats, float, Floats]:
        def reduced(params: Floats) -> Cost:
            cost, normal, gradient = _under_layer(fitter, params, described, presses, data)
            return cost, basis.T @ normal @ basis, basis.T @ gradient

        return minimised(start, reduced, lambda params, step: moved(params, basis @ step))

    # under another layer light presses may be of another size: first all are as large, which hard ones tell, then the
    # larger the stronger, as fingers are
    each, radii = np.eye(len(found)), np.arange(5, len(found), 3)
    alike = np.delete(each, radii[1:], axis=1)
    alike[radii, radii[0]] = 1.0
    growing = np.column_stack([alike, np.zeros(len(found))])
    growing[radii, -1] = np.log([press.force for press in presses if not press.peak])
    for basis in (alike, growing, each):
        found, _, normal = fitted(found, basis)
    if found[1] in _EXPONENTS:
        raise DataError(
            f"forces of {min(forces):.3g} to {max(forces):.3g} N do not go with what the presses change (the layer's "
            f"exponent would be {found[1]:g} or beyond); check which force belongs to which press, then press again"
        )
    stds = np.sqrt(np.diag(inverse(normal)))
    hysteresis = float(np.expm1(found[2])) if len(rising) < len(presses) else -1.0
    exact = [fitter.information(press.scans, 0.0) for press in presses]
    noise = sum(np.isfinite(scan.volts).sum() for press in presses for scan in press.scans)
    all_of_it = sum(one.constant for one in exact) - noise
    left = _under_layer(fitter, found, described, presses, exact)[0] - noise
    unexplained = sqrt(max(left, 0.0) / max(all_of_it, left, 1.0))
    conductance, exponent = float(np.exp(found[0])), float(found[1])
    under = fitter.under(replace(layer, conductance=conductance, exponent=exponent))
    error = _error(under, [press for press in presses if not press.peak])
    return FittedLayer(conductance, exponent, float(stds[0]), float(stds[1]), hysteresis, unexplained, error)


def _error(fitter: PressFitter, presses: Sequence[KnownPress]) -> float:
    """How far forces of known presses are off, beyond what is known of each (standard deviation of the logarithm)."""
    told = [fitter.fit([press.contact], *press.scans)[0] for press in presses]
    off = np.log([one.force / press.force for one, press in zip(told, presses, strict=True)])
    known = np.log1p([one.force_std / one.force for one in told])

    def surprise(error: float) -> float:
        """Minus twice the logarithm of the likelihood: an uncertain press has a say as far as it tells anything."""
        variance = known**2 + error**2
        return float((off**2 / variance + np.log(variance)).sum())

    likeliest = minimize_scalar(surprise, bounds=(0.0, float(np.abs(off).max())), method="bounded").x
    return float(likeliest) if surprise(likeliest) < surprise(0.0) else 0.0


def _under_layer(
    fitter: PressFitter,
    params: Floats,
    described: Floats,
    presses: Sequence[KnownPress],
    data: Sequence[NormalEquations],
) -> Cost:
    """Cost, curvature and downhill gradient of a layer, and of place and size of presses of known force under it.

    Args:
        params: (3 + 3 n,) logarithm of the layer's conductance, its exponent, logarithm of one and its hysteresis;
            x, y and logarithm of the radius of each press that rises, and of those that ease off from it.
        described: (3,) the layer as it was believed to be.
        presses: Of known force.
        data: What was measured under each.
    """
    layer = fitter.sheet.skin.contact_layer
    sheet = fitter.sheet.with_layer(replace(layer, conductance=float(np.exp(params[0])), exponent=float(params[1])))
    off = (described - params[:3]) / _SPREAD
    cost, normal, gradient = float(off @ off), np.zeros((len(params),) * 2), np.zeros(len(params))
    normal[:3, :3], gradient[:3] = np.diag(_SPREAD**-2), off / _SPREAD
    number = -1
    for press, measured in zip(presses, data, strict=True):
        number += not press.peak
        at = np.r_[0:3, 3 + 3 * number : 6 + 3 * number]
        turned = layer.turned(press.force / press.peak) if press.peak else 0.0
        own = np.append(params[at[3:]], 0.0)
        own[3] = np.log(press.force / fitter.press(own).force(layer.foam_spread)) + turned * params[2]
        caused, slopes = sheet.linearised([fitter.press(own)])
        slopes[:, 2] -= slopes[:, 3] * fitter.growth(own)  # a wider one of the same force presses less
        slopes[:, 3] *= turned
        part = fitter.explained(measured, caused, slopes[:, [4, 5, 3, 0, 1, 2]])
        cost += part[0]
        normal[np.ix_(at, at)] += part[1]
        gradient[at] += part[2]
        if not press.peak:
            prior = fitter.prior(own[None])
            cost += prior[0]
            normal[at[3:], at[3:]] += prior[1][:3]
            gradient[at[3:]] += prior[2][:3]
    return cost, normal, gradient
