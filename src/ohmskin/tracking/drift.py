"""Drift: what changes beside contacts, all resistances together (temperature) or pairs one by one."""

from ohmskin.arrays import changed
from ohmskin.contacts.fitter import ContactFitter
from ohmskin.tracking.motion import Motion
from ohmskin.tracking.state import TrackState


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
