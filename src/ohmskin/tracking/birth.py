"""Births: new contacts, where one more explains what is left of the last frames significantly better."""

from collections.abc import Sequence
from math import sqrt

import numpy as np
from scipy.special import ndtr, ndtri

from ohmskin.arrays import changed
from ohmskin.contacts.degraded import Degradation, strong
from ohmskin.contacts.discs import Both
from ohmskin.contacts.fitter import ContactFitter
from ohmskin.contacts.information import Information
from ohmskin.contacts.solution import Solution
from ohmskin.tracking.degraded import degradation_instead, with_degradation
from ohmskin.tracking.kernels import POSSIBLE, energy_of, most_significant
from ohmskin.tracking.residuals import Residuals
from ohmskin.tracking.state import TrackState

_WINDOWS = np.array([1, 2, 3, 4, 6, 8, 12])  # frames over which new contacts are looked for
_ENOUGH, _SHORT = 6.0, 0.6  # standard deviations of a contact's effect without an electrode, and share that then lacks
_BLAMED = 3  # of the newest frames in which one electrode alone shows a contact, from which on its wire is loose
_NOTHING = 1e-9  # share of the power that a frame keeps whose score counts for nothing
_GROSS = 10.0  # times all other changes, by which those of a loose wire are larger
_POOR = 0.1  # of what contacts explain of one frame that they may leave, beyond what is usual, to be believed at once
_REPEATED, _NEAR = 3, 2.5  # frames and usual radii within which a doubted contact that is seen again is one
_SEARCH_EVERY = 16  # frames, once contacts of so many frames in a row are doubted
LONGEST = int(_WINDOWS[-1])


def birth_threshold(fitter: ContactFitter) -> float:
    """Standard deviations at which a new contact's score must stand out for a stated rate of false alarms per frame."""
    return float(-ndtri(ndtr(-fitter.bar) / len(_WINDOWS)))


def with_scores(residuals: Residuals, fitter: ContactFitter) -> Residuals:
    """The residuals with their scores; those that are not sound are no evidence of a contact."""
    score, power = fitter.scores(residuals.marginal_innovation)
    if not residuals.sound:
        score, power = np.zeros_like(score), _NOTHING * power
    return changed(residuals, score=score, power=power)


def with_births(state: TrackState, fitter: ContactFitter, bar: float, common: float, speed: float) -> TrackState:
    """The state with new contacts.

    Args:
        state: With a scored history.
        fitter: What explains data by contacts.
        bar: Standard deviations that the score of a new contact must exceed.
        common: Share of the noise's variance that is the same in all frames: it does not average out.
        speed: Standard deviation of a contact's velocity (m/s).
    """
    possible = -1
    while len(state.pressing) < fitter.most:
        count, place, height = _most_significant(state.history, fitter, common)
        if height < bar:
            possible = place if height > POSSIBLE else -1
            break
        used = state.history[:count]
        alone = count == 1 and not _seen_before(place, state.history, fitter)
        if alone and state.turn % _SEARCH_EVERY and state.doubted_frames >= _REPEATED:
            state = _with_doubt(state, fitter, place)
            continue
        found = _added(used, fitter)
        if (loose := _from_one_electrode(state, fitter, found, used)) is not None:
            suspect, frame = loose
            frames = [*state.history]
            frames[frame] = with_scores(changed(frames[frame], only_electrode=suspect), fitter)
            blamed = [residuals.only_electrode for residuals in frames].count(suspect) >= _BLAMED
            state = changed(state, history=tuple(frames), suspects=(suspect,) if blamed else state.suspects)
            continue
        if not state.pressing:  # several may have come at once, and one alone would be led astray by the others
            nominal, inflated = _combined(used)
        else:
            nominal = Information.combined([residuals.marginal_innovation for residuals in used])
            inflated = nominal.scaled(fitter.allowance(nominal))
        several = fitter.fit_information(nominal, inflated)
        if len(several.params) == 1 or (len(several.params) and not state.pressing):
            found = several
        weak = not strong(fitter, found.params).any()
        if weak and (degradation := degradation_instead(state, fitter, _combined(used), found.params)) is not None:
            state = _without(state, fitter, degradation)
            continue
        if alone and _is_poor(used[0], nominal, fitter, found):
            state = _with_doubt(state, fitter, place)
            continue
        moved = speed * (state.time - used[-1].time) / 2
        for params, covariance in zip(found.params, found.covariances, strict=True):
            covariance[[0, 1], [0, 1]] += moved**2
            state = state.with_contact(params, covariance, speed)
        variance = state.common_drift[1]
        history = tuple(_updated(residuals, fitter, found, variance) for residuals in state.history)
        state = changed(state, history=history, covered=tuple(sorted({*state.covered, *found.covered})))
    doubted = bool(state.history) and state.history[0].doubted is not None
    return changed(state, possible=possible, doubted_frames=state.doubted_frames + 1 if doubted else 0)


def _most_significant(history: Sequence[Residuals], fitter: ContactFitter, common: float) -> tuple[int, int, float]:
    """Over how many of the newest frames a contact more stands out most, at which place, and by how many deviations."""
    windows = _WINDOWS[: np.searchsorted(_WINDOWS, len(history), side="right")]
    score, power = (np.array([getattr(one, name) for one in history], np.float32) for name in ("score", "power"))
    energy = np.array([one.energy for one in history])
    window, place, height = most_significant(score, power, energy, windows, common, fitter.model_error, fitter.bipolar)
    return int(windows[window]), place, height


def _added(used: Sequence[Residuals], fitter: ContactFitter) -> Solution:
    """The contact that explains most of what is left of some frames."""
    score, power = (np.sum([getattr(one, name) for one in used], axis=0, dtype=float) for name in ("score", "power"))
    data = Information.combined([residuals.marginal_innovation for residuals in used])
    return fitter.added(data.scaled(fitter.allowance(data)), score, power)


def _from_one_electrode(
    state: TrackState, fitter: ContactFitter, found: Solution, used: Sequence[Residuals]
) -> tuple[int, int] | None:
    """The electrode whose voltages alone show a contact that others should see, too, and the frame in which they
    show it most, of those that no electrode is blamed for yet; None where others do.

    Its voltages have changed by far more than all others, on which the contact's effect would be larger than it is.
    """
    others, response = fitter.responses(state.params)[0], fitter.responses(found.params)[0]
    scans = [residuals.observation.difference.minus(others, fitter.table.pairs).undriven for residuals in used]
    seen, caused = (
        np.concatenate(each)
        for each in ([s.volts for s in scans], [s.caused_by(response, fitter.table.pairs) for s in scans])
    )
    finite = np.isfinite(seen) & np.isfinite(caused)
    seen, caused = (np.where(finite, each, 0.0) / fitter.errors.noise for each in (seen, caused))
    electrodes = np.concatenate([scan.pattern.quadruples for scan in scans])
    own = finite[:, None] & (electrodes[:, :, None] == np.arange(fitter.table.n_elec)).any(axis=1)
    rest = finite[:, None] & ~own
    measured, expected = (seen * caused) @ rest, caused**2 @ rest
    theirs, elsewhere = (seen**2 @ each / np.maximum(each.sum(axis=0), 1) for each in (own, rest))
    known = fitter.model_error**2 * sum(residuals.energy for residuals in used) / max(int(finite.sum()), 1)
    stands_out = theirs / np.maximum(elsewhere, 1 + known)
    alone = (expected > _ENOUGH**2) & (measured < (1 - _SHORT) * expected) & (stands_out > _GROSS**2)
    if not alone.any():
        return None
    suspect = int(np.argmax(np.where(alone, stands_out, 0.0)))
    starts = np.cumsum([0, *(len(scan.volts) for scan in scans[:-1])])
    shown = np.add.reduceat(seen**2 * own[:, suspect], starts)
    return suspect, int(np.argmax(np.where([one.only_electrode is None for one in used], shown, -1.0)))


def _combined(used: Sequence[Residuals]) -> Both:
    """The information of frames, nominal and inflated."""
    observations = [residuals.observation for residuals in used]
    nominal = Information.combined([observation.nominal for observation in observations])
    return nominal, nominal.with_misfits([observation.inflated for observation in observations])


def _without(state: TrackState, fitter: ContactFitter, degradation: Degradation) -> TrackState:
    """The state with what degraded contacts do taken for drift, and its frames without that."""
    history = []
    for residuals in state.history:
        innovation, residual, marginal = map(
            degradation.removed_from, (residuals.innovation, residuals.residual, residuals.marginal_innovation)
        )
        observation = residuals.observation.without(degradation, fitter.table.pairs)
        reviewed = changed(residuals, observation=observation, innovation=innovation, residual=residual)
        history.append(with_scores(changed(reviewed, marginal_innovation=marginal), fitter))
    return changed(with_degradation(state, degradation), history=tuple(history))


def _seen_before(place: int, history: Sequence[Residuals], fitter: ContactFitter) -> bool:
    """Whether a frame shortly before the newest one was doubted for a contact near a place."""
    doubted = [residuals.doubted for residuals in history[1 : 1 + _REPEATED] if residuals.doubted is not None]
    away = fitter.table.offsets(fitter.places[doubted], fitter.places[place])
    return bool((np.hypot(*away.T) < fitter.table.radius * _NEAR).any())


def _with_doubt(state: TrackState, fitter: ContactFitter, place: int) -> TrackState:
    """The state with what its newest frame shows at a place doubted."""
    newest = with_scores(changed(state.history[0], doubted=place), fitter)
    return changed(state, history=(newest, *state.history[1:]))


def _is_poor(newest: Residuals, data: Information, fitter: ContactFitter, found: Solution) -> bool:
    """Whether contacts leave more of the newest frame's `data` than is usual, by a good part of what they explain."""
    whole = newest.observation.data
    share = fitter.allowance(whole)
    before, left = (share * one.misfit.constant for one in (data, data.minus(found.caused)))
    usual = (1 + 2 * sqrt(2 / whole.count)) / fitter.relative_cost(whole, 1.0)
    return bool(left - usual > _POOR * (before - left))


def _updated(residuals: Residuals, fitter: ContactFitter, found: Solution, variance: float) -> Residuals:
    """The residuals after one contact more, or several, have been found in them, given the variance of the common
    change."""
    caused, slopes = fitter.responses(found.params)
    data = residuals.observation.data
    innovation = fitter.uncovered(residuals.innovation.minus(caused).marginalised_flat(slopes), found.covered)
    reviewed = changed(
        residuals,
        innovation=innovation,
        residual=fitter.uncovered(residuals.residual.minus(caused), found.covered),
        energy=residuals.energy + energy_of(data.misfit.part, data.white.part, caused),
        marginal_innovation=innovation.marginalised_common(variance).marginalised(fitter.shapes(found.params)),
    )
    return with_scores(reviewed, fitter)
