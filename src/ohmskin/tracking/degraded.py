"""Electrodes whose contacts degrade while contacts are tracked: what they do is drift, and no contact."""

import numpy as np

from ohmskin.arrays import Floats, changed
from ohmskin.contacts.degraded import DOUBTED, Degradation, with_degraded
from ohmskin.contacts.discs import Both
from ohmskin.contacts.fitter import ContactFitter
from ohmskin.tracking.state import TrackState


def degradation_instead(known: TrackState, fitter: ContactFitter, data: Both, more: Floats) -> Degradation | None:
    """Degraded contacts of electrodes that explain data better than more contacts do, if there are any.

    Args:
        known: The contacts that are known.
        fitter: What explains data by contacts.
        data: What is measured, and the same with the model's error as noise.
        more: (n, 4) the others.
    """
    if not len(more):
        return None
    pressing = known.params[known.pressing]
    nominal, inflated = data
    if len(pressing) < len(known.tracks):
        caused, slopes = fitter.responses(known.without(known.pressing).params)
        nominal, inflated = (one.minus(caused).marginalised_flat(slopes) for one in data)
    found = fitter.refine(inflated, np.vstack([pressing, more]))
    return with_degraded(fitter, (nominal, inflated), found, pressing).degradation


def with_degradation(state: TrackState, degradation: Degradation) -> TrackState:
    """The state with what degraded contacts of electrodes do taken for drift; its frames are as they were."""
    return changed(
        state,
        drift=state.drift + degradation.change,
        degraded=tuple(sorted({*state.degraded, *degradation.electrodes})),
        degraded_errors=np.hstack([state.degraded_errors, degradation.errors]),
        doubted=state.time + DOUBTED,
    )


def without_degraded(state: TrackState) -> TrackState:
    """The state with no electrode whose contact has degraded just now."""
    if not state.degraded:
        return state
    return changed(state, degraded=(), degraded_errors=np.empty((len(state.drift), 0)))


def with_better_degradation(state: TrackState) -> TrackState:
    """The state with what degraded contacts do corrected by its newest frame, if nothing touches."""
    errors, left = state.degraded_errors, state.history[0].marginal_innovation.misfit
    if state.pressing or not errors.size:
        return state
    change = errors @ (errors.T @ left.vector[:-1])  # as it is in the curvature of what is marginalised over the errors
    covariance = np.eye(errors.shape[1]) - left.normal_products(np.ascontiguousarray(errors.T))[:, :-1] @ errors
    sizes, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    better = errors @ axes * np.sqrt(np.clip(sizes, 0.0, 1.0))
    return changed(state, drift=state.drift + change, degraded_errors=better)
