"""From presses of known force to all that a calibration says of newtons."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from ohmskin.calibrate.force import ForceCurve, fit_auxiliary, fit_force
from ohmskin.calibrate.instrumented import ForceSampler
from ohmskin.calibrate.presses import PressGuide
from ohmskin.errors import OhmskinError
from ohmskin.sensing import FittedLayer, KnownPress, PressFitter, SkinModel, fit_layer
from ohmskin.skin import Calibration

Presses: TypeAlias = PressGuide | ForceSampler
_EXPLAINED = 0.2  # share of presses that a contact layer may leave unexplained
_ASTRAY = 0.5  # standard deviation of the logarithm by which forces told under it may be off


def fit_newtons(found: Calibration, presses: Presses, known: SkinModel) -> tuple[Calibration, ForceCurve, list[str]]:
    """A calibration with force curve, contact layer and auxiliary channel, as far as presses determine them.

    Args:
        found: The calibration so far; its mode is that of the presses.
        presses: Samples of known force.
        known: The quiet skin that was pressed.

    Returns:
        The calibration, the curve, and the results as sentences.

    Raises:
        DataError: If fewer than two forces were detected.
    """
    curve = fit_force(presses.samples)
    found = fit_auxiliary(presses.samples, known.quiet.rest, curve.put_into(found))
    layer, why = _layer(PressFitter(known), _detected(presses))
    words = [
        f"force {curve.forces[0]:.2f} to {curve.forces[-1]:.2f} N in mode {found.mode}: "
        f"error {curve.error:.2g} N rms, hysteresis {100 * curve.hysteresis:.2g} %, "
        f"{100 * curve.scatter:.2g} % between places, {curve.missed} missed"
    ]
    found = found if layer is None else layer.put_into(found)
    if found.auxiliary_gain:
        off = f"{100 * found.auxiliary_error:.2g} % off from press to press"
        words.append(f"auxiliary channel: {found.auxiliary_gain:.4g} for each newton, {off}")
    words.append(why)
    if curve.flat:
        flat = ", ".join(f"{newtons:.2f}" for newtons in curve.flat)
        why = "the skin is saturated, or strength differs more between places"
        words.append(f"note: {flat} N cannot be distinguished from smaller forces; {why}")
    return found, curve, words


def _layer(fitter: PressFitter, presses: Sequence[KnownPress]) -> tuple[FittedLayer | None, str]:
    """The contact layer, if the presses determine it, and a message; presses that fit no model are kept."""
    try:
        layer = fit_layer(fitter, presses)
    except OhmskinError as error:
        return None, f"note: the described contact layer is kept: {error}"
    told = f"contact layer {layer.conductance:.4g} S/m2 +- {100 * layer.conductance_std:.2g} %, growing with"
    told += f" pressure^{layer.exponent:.2f} +- {layer.exponent_std:.2g}"
    if layer.hysteresis >= 0:
        told += f", hysteresis {100 * layer.hysteresis:.2g} %"
    if layer.unexplained >= _EXPLAINED:
        left = f"{100 * layer.unexplained:.2g} % of what the presses change"
        return None, f"note: {told}, would leave {left} unexplained; the described layer is kept"
    off = f"{100 * np.expm1(layer.error):.2g} %"
    if layer.error >= _ASTRAY:
        return None, f"note: {told}, would tell these presses' own forces {off} wrong; the force curve is used"
    return layer, told + (f"; forces are {off} less certain than it tells" if layer.error > 0 else "")


def _detected(presses: Presses) -> list[KnownPress]:
    """The presses that were detected; those that eased off only where one that rose was, too."""
    felt, risen = list[KnownPress](), None
    for one, peak in zip(presses.samples, presses.peaks, strict=True):
        risen = one.at if one.contact is not None and not peak else risen
        if one.contact is not None and one.at == risen:
            felt.append(KnownPress(one.force, one.contact, one.scans, peak))
    return felt
