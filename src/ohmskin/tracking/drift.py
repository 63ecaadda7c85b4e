"""Drift: what changes beside contacts, all resistances together (temperature) or pairs one by one."""

import numpy as np

from ohmskin.arrays import changed
from ohmskin.contacts.fitter import ContactFitter
from ohmskin.scan.smoothing import smoothing_factor
from ohmskin.tracking.kernels import updated_common
from ohmskin.tracking.motion import Motion
from ohmskin.tracking.state import TrackState

STEP_STD = 1.0  # of a change of all resistances together that is a step
_STEP = 200.0  # squared size of what was not foreseen, over noise, from which on it may be a step of all resistances,
_STEP_LEAVES = 0.05  # if that leaves at most this share of it


def is_step(state: TrackState) -> bool:
    """Whether what was not foreseen of the newest frame is a change of all resistances together, as a step of the
    instrument's gain makes it, and next to nothing else."""
    innovation = state.history[0].innovation
    signal = innovation.misfit.constant - innovation.count
    if signal < _STEP:
        return False
    _, step = updated_common(innovation.misfit.part, (0.0, STEP_STD**2), 1.0)
    gain = step * innovation.misfit.vector[-1]
    return bool(signal - gain < _STEP_LEAVES * gain)


def with_common_drift(state: TrackState, fitter: ContactFitter, before: tuple[float, float]) -> TrackState:
    """The state with the common change of all resistances that its newest frame shows beside all its contacts, given
    what was known `before` it, and its variance (1)."""
    newest = state.history[0]
    common = updated_common(newest.innovation.misfit.part, before, fitter.allowance(newest.innovation))[0]
    change = np.zeros(len(newest.innovation.misfit.vector))
    change[-1] = common[0] - state.common_drift[0]
    newest = changed(newest, residual=newest.residual.minus(change))
    return changed(state, common_drift=common, history=(newest, *state.history[1:]))


def with_learned_drift(state: TrackState, fitter: ContactFitter, motion: Motion, elapsed: float) -> TrackState:
    """The state with part of its newest frame's residual, as much as belongs to a time (s), taken for drift."""
    newest = state.history[0]
    share, left = smoothing_factor(elapsed, _time(state, motion)), newest.residual
    if state.tracks:  # what might be a contact's is left to it; errors of the model of a strong one are not learned
        slopes = fitter.responses(state.params)[1]
        left = left.marginalised_flat(slopes)
        share /= 1 + fitter.model_error**2 * newest.energy / left.count
    uneven = state.uneven
    if not (state.pressing or state.degraded):
        beside = newest.residual.excluding(slopes) if state.tracks else left
        uneven = uneven.followed(*fitter.errors.drift(beside)[1:], share / 2, elapsed)
    return changed(state, drift=state.drift + share * left.drift(), uneven=uneven)


def _time(state: TrackState, motion: Motion) -> float:
    """Over which what no contact explains becomes drift (s): sooner where there are only lifted ones."""
    return motion.settling_time if state.tracks and not state.pressing else motion.drift_time
