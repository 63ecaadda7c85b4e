"""Lifts: which contacts are lifted, which are there again, and what becomes of what is left of them."""

from math import sqrt

import numpy as np

from ohmskin.arrays import changed
from ohmskin.contacts.discs import NEAR
from ohmskin.contacts.fitter import FAINT, ContactFitter
from ohmskin.scan.smoothing import smoothing_factor
from ohmskin.tracking.state import STATE, Track, TrackState

_LIFTED, _AGAIN = 0.1, 0.2  # shares of its peak below which a contact is lifted, above which it is there again
_SETTLED = 5.0  # settling times after which nothing is left of a lifted contact


def with_lifts(
    state: TrackState, fitter: ContactFitter, bar: float, settling: float, elapsed: float, explained: bool = True
) -> TrackState:
    """The state with lifted contacts separated from pressing ones; what is left of lifted ones becomes drift.

    Args:
        state: After a frame.
        fitter: What explains data by contacts.
        bar: Standard deviations of its effect above which a lifted contact may be there again.
        settling: Time over which what is left of a lifted contact becomes drift (s).
        elapsed: Since the frame before (s).
        explained: Whether contacts explain the frame as well as usual; if not, it does not tell what is left of any.
    """
    state = _without_double(state, fitter)
    tracks, mean, drift, next_id = [], state.mean.copy(), state.drift, state.next_id
    share = smoothing_factor(elapsed, settling) if explained else 0.0
    came = any(one.since == state.time for one in state.tracks)
    bar = _limit(state, fitter, bar)
    for k, one in enumerate(state.tracks):
        effect, std = state.effect(k)
        if not one.lifted:
            one = changed(one, peak=max(one.peak, effect))
            if _faint(effect, std, one):
                one = changed(one, lifted=max(elapsed, 1e-9))
                mean[k, 4:] = 0.0
        elif effect > max(_AGAIN * one.peak, bar * std) and not came:
            one = Track(next_id, effect, state.time)
            next_id += 1
        else:
            one = changed(one, lifted=one.lifted + elapsed)
            if effect > FAINT * std:
                response = fitter.table(mean[k, None, :2], np.sqrt(mean[k, 3])).values[0]
                drift = drift + share * mean[k, 2] * response
                mean[k, 2] *= 1 - share
        tracks.append(one)
    state = changed(state, tracks=tuple(tracks), mean=mean, drift=drift, next_id=next_id)
    return state.without([k for k, one in enumerate(tracks) if one.lifted > _SETTLED * settling])


def explain_too_much(state: TrackState, fitter: ContactFitter, bar: float) -> bool:
    """Whether contacts of a state, all lifted, explain a contact's signal together, and more than may be left of one,
    and none is surely there again: another one has come among them."""
    if not state.tracks or state.newest_energy < bar**2:
        return False
    limit = _limit(state, fitter, bar)
    effects = [(*state.effect(k), one.peak) for k, one in enumerate(state.tracks)]
    return any(_AGAIN * peak < effect for effect, _, peak in effects) and not any(
        max(_AGAIN * peak, limit * std) < effect for effect, std, peak in effects
    )


def _limit(state: TrackState, fitter: ContactFitter, bar: float) -> float:
    """Standard deviations of its effect above which a lifted contact is there again."""
    return bar + fitter.model_error * sqrt(state.newest_energy)


def _faint(effect: float, std: float, track: Track) -> bool:
    """Whether so small an effect, known as well as that (m2), is no press any more."""
    return effect < max(_LIFTED * track.peak, FAINT * std)


def _without_double(state: TrackState, fitter: ContactFitter) -> TrackState:
    """The state without a faint contact beside another one, which takes over its effect: two were seen where one is."""
    if len(state.tracks) < 2:
        return state
    apart = np.linalg.norm(fitter.table.offsets(state.mean[:, None, :2], state.mean[:, :2]), axis=2)
    for k, one in enumerate(state.tracks):
        beside = [j for j in state.pressing if j != k]
        near = beside and apart[k, beside].min() < NEAR * fitter.table.radius
        if near and (one.lifted or _faint(*state.effect(k), one)):
            tracks = list(state.tracks)
            if not one.lifted:
                heir = min(beside, key=lambda j: float(apart[k, j]))
                tracks[heir] = changed(tracks[heir], id=min(one.id, tracks[heir].id))
            return known_gone(changed(state, tracks=tuple(tracks)), fitter, k)
    return state


def known_gone(state: TrackState, fitter: ContactFitter, k: int) -> TrackState:
    """The state without a contact, its effect known to be zero; the others are conditioned on that."""
    at = STATE * k + 2
    gain = state.covariance[:, at] / state.covariance[at, at]
    mean = fitter.within(state.mean - (gain * state.mean[k, 2]).reshape(state.mean.shape))
    covariance = state.covariance - np.outer(gain, state.covariance[at])
    return changed(state, mean=mean, covariance=covariance).without([k])
