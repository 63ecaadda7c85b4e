"""How far contacts are believed: what they, or the image that shows them, leave unexplained of the data."""

from collections.abc import Sequence

import numpy as np

from ohmskin.arrays import Floats, changed
from ohmskin.contacts import Contact
from ohmskin.errors import DataError
from ohmskin.inverse import ModelMatch, match_model
from ohmskin.scan import Difference, DrivePattern, Frame
from ohmskin.sensing.model import SkinModel

_USUAL = 0.1  # share of a frame's change that contacts, or an image, of real skins leave unexplained at most
_UNLIKE, _UNLIKE_IMAGE = 0.5, 0.3  # what they leave of data that are not of the skin, and what an image does
_COMMON = 0.92, 0.98  # share of a change that is common to all voltages: contacts are believed, and not at all


def fit_confidence(unexplained: float) -> float:
    """How far contacts are believed that leave a share of the data unexplained (1): of other data, such as another
    skin's, half or more."""
    return _decreasing(unexplained, _UNLIKE)


def image_confidence(misfit: float) -> float:
    """How far contacts are believed that are seen in an image of that `image_misfit` (1)."""
    return _decreasing(misfit, _UNLIKE_IMAGE)


def quiet_confidence(known: SkinModel, pattern: DrivePattern) -> float:
    """How far contacts are believed whose quiet voltages fit the model as these do (1).

    The conductivity as a whole, and an offset, may be others. Real tanks fit to 3 to 6 %, electrodes in another order
    leave half or more. Where presses have shown how channels follow the model, that is known better.
    """
    match = None if known.channels is not None else quiet_match(known, pattern)
    return 1.0 if match is None else _decreasing(match.misfit, _UNLIKE)


def quiet_match(known: SkinModel, pattern: DrivePattern) -> ModelMatch | None:
    """How the quiet voltages of idle electrodes match the model; None if too few are known."""
    volts = known.baseline.reference(pattern)
    idle = np.where(pattern.driven & ~pattern.driven.all(), np.nan, volts)
    try:
        return match_model(known.model, Frame(pattern, idle, np.ones(pattern.n_inj)))
    except DataError:
        return None


def _decreasing(left: float, unlike: float) -> float:
    return min(max((unlike - left) / (unlike - _USUAL), 0.0), 1.0)


def scaled_confidence(contacts: Sequence[Contact], share: float) -> tuple[Contact, ...]:
    """Contacts whose confidence is that share of what it was (1)."""
    if share == 1.0:
        return tuple(contacts)
    return tuple(changed(contact, confidence=share * contact.confidence) for contact in contacts)


def image_misfit(known: SkinModel, scans: Sequence[Difference]) -> float:
    """Share of the signal of scans that no change of the sheet's conductivity explains (1).

    Judged by the one-step image, which follows real tanks to 1 %; of values that have nothing to do with the skin it
    leaves 40 to 80 %, of a press on a skin whose electrodes are in another order a quarter to two thirds.

    Raises:
        DataError: If no finite datum is left.
    """
    one_step = known.one_step(known.estimator("gauss-newton"))
    volts, rest = one_step.unexplained(*(scan.undriven for scan in scans))
    noise = len(volts) * known.noise**2
    changed, left = float(volts @ volts) - noise, float(rest @ rest) - noise
    return max(left, 0.0) / changed if changed > 0 else 0.0


def common_change(known: SkinModel, scans: Sequence[Difference]) -> tuple[float, float]:
    """By what share all voltages changed alike (1), as with the conductivity of the whole sheet, and the share of the
    signal that this explains (1).

    Of targets in real tanks it explains 0.6 at most, of one in the middle with opposite drive 0.9, of an empty tank
    that warms up all.
    """
    volts, quiet = (np.concatenate(parts) for parts in zip(*(_with_quiet(known, scan) for scan in scans), strict=True))
    factor = float(volts @ quiet) / max(float(quiet @ quiet), 1e-300)
    left, noise = volts - factor * quiet, len(volts) * known.noise**2
    changed, rest = float(volts @ volts) - noise, float(left @ left) - noise
    return factor, 1 - max(rest, 0.0) / changed if changed > 0 else 0.0


def crowd_confidence(count: int, n_elec: int) -> float:
    """How far `count` contacts in one image are believed (1): all up to half as many as there are electrodes, none from
    as many on. More are noise and the errors of the model, as too little regularisation shows them."""
    return min(max(2 - 2 * count / n_elec, 0.0), 1.0)


def common_confidence(share: float) -> float:
    """How far contacts are believed where a common change of all voltages explains that share of the signal (1)."""
    low, high = _COMMON
    return min(max((high - share) / (high - low), 0.0), 1.0)


def _with_quiet(known: SkinModel, scan: Difference) -> tuple[Floats, Floats]:
    """What is known of the changes of idle electrodes' voltages, and these voltages on the quiet skin (V)."""
    idle = scan.undriven
    quiet = known.baseline.reference(idle.pattern) * idle.currents
    both = np.isfinite(idle.volts + quiet)
    return idle.volts[both], quiet[both]


def as_measured(cleaned: Sequence[Difference], measured: Sequence[Difference]) -> list[Difference]:
    """Scans without what was found bad in them, but with the weight that they had before they were doubted."""
    both = zip(cleaned, measured, strict=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return [one if one is other else one.times(other.currents / one.currents) for one, other in both]
