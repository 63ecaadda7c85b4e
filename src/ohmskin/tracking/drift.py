"""Drift: what changes beside contacts, all resistances together (temperature) or pairs one by one."""

import numpy as np

from ohmskin.arrays import changed
from ohmskin.contacts.fitter import ContactFitter
from ohmskin.scan import Difference
from ohmskin.tracking.motion import Motion
from ohmskin.tracking.state import TrackState


def without_drift(state: TrackState, fitter: ContactFitter, difference: Difference) -> Difference:
    """A frame without the drift and the temperature of the state."""
    volts = difference.volts - difference.caused_by(state.drift, fitter.table.pairs)
    if difference.reference is not None:
        volts = volts - state.common_drift[0] * np.nan_to_num(difference.reference)
    return changed(difference, volts=volts)


def with_common_drift(state: TrackState, fitter: ContactFitter) -> TrackState:
    """The state with the common change of all resistances that its newest frame shows beside all its contacts."""
    newest = state.history[0]
    told, share = newest.innovation.misfit, fitter.allowance(newest.innovation)
    change = np.zeros(len(told.vector))
    change[-1] = 1.0
    if not (curvature := float(told.sizes(change[:, None])[0]) ** 2):
        return state
    variance = 1 / (1 / state.common_drift[1] + share * curvature)
    rise = variance * share * float(told.vector[-1])
    change[-1] = rise
    newest = changed(newest, residual=newest.residual.less(change))
    common_drift = (state.common_drift[0] + rise, variance)
    return changed(state, common_drift=common_drift, history=(newest, *state.history[1:]))


def learned(state: TrackState, fitter: ContactFitter, motion: Motion, elapsed: float) -> TrackState:
    """The state with part of its newest frame's residual, as much as belongs to a time (s), taken for drift."""
    newest = state.history[0]
    share, left = elapsed / (elapsed + _time(state, motion)), newest.residual
    if state.tracks:  # what might be a contact's is left to it; errors of the model of a strong one are not learned
        left = left.beside(fitter.responses(state.params)[1])
        share /= 1 + fitter.model_error**2 * newest.energy / left.count
    return changed(state, drift=state.drift + share * left.drift())


def _time(state: TrackState, motion: Motion) -> float:
    """Over which what no contact explains becomes drift (s): sooner where there are only lifted ones."""
    return motion.settling if state.tracks and not state.pressing else motion.drifting
