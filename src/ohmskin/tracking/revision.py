"""Revisions: a contact is moved elsewhere, two are taken for one, one for two or none, if that fits better."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import linear_sum_assignment

from ohmskin.arrays import changed
from ohmskin.contacts.discs import NEAR
from ohmskin.contacts.fitter import ContactFitter
from ohmskin.contacts.information import Information
from ohmskin.contacts.solution import PER_CONTACT, Solution
from ohmskin.tracking.lift import known_gone
from ohmskin.tracking.state import STATE, TrackState

_TRIALS = 1e3  # looks at whether one contact is two over which `false_twos` holds
_ELSEWHERE = 6.0  # squared misfit by which another place must be better for a contact that has just come
_RESTED = 3  # frames in which contacts rested, from which on they are looked for afresh
_MORE = 2.0  # times the doubts, or the gain expected of two, when that last failed, from which on it is tried again,
_ANYWAY = 4  # and turns after which it is
_HYSTERESIS = 0.5  # share of the bar of a split below which two contacts become one again, and a faint one is none


def revision_threshold(fitter: ContactFitter) -> float:
    """By how much two contacts must explain the last frames better than one, if they are looked at again and again."""
    return fitter.split_threshold(fitter.false_twos / _TRIALS)


def just_came(state: TrackState) -> bool:
    """Whether a contact came as many frames ago as its first look afresh takes."""
    before = state.history[_RESTED - 1].time if len(state.history) >= _RESTED else None
    return any(state.tracks[k].since == before for k in state.pressing)


def with_revision(state: TrackState, fitter: ContactFitter, bar: float, speed: float, turn: int) -> TrackState:
    """The state after one revision at most.

    Args:
        state: With a history.
        fitter: What explains data by contacts.
        bar: By how much two contacts must explain the last frames better than one.
        speed: Standard deviation of a contact's velocity (m/s).
        turn: Which contact's turn it is to be looked at for two, counted on from one revision to the next.
    """
    pressing = state.pressing
    if not pressing:
        return state
    stationary = _Stationary.of(state, fitter)
    nominal, _, _, here = stationary.minus_all_but(pressing)
    doubt = fitter.relative_cost(nominal, here.cost) if stationary.count >= _RESTED else 0.0
    young = {k for k in pressing if state.tracks[k].since >= state.history[-1].time}  # their first frames may mislead
    again = bool(state.refuted) and (doubt > _MORE * state.refuted or turn % _ANYWAY == 0)
    if doubt > 1 and (young or again) and (seen := _afresh(stationary, bar, speed)) is not None:
        return seen
    refuted = 0.0 if doubt <= 1 else doubt if young or again else state.refuted or 1 / _MORE
    if refuted != state.refuted:
        state = changed(state, refuted=refuted)
        stationary = changed(stationary, state=state)
    for k in sorted(young):
        if (placed := _placed(stationary, speed, k)) is not None:
            return placed
    for place, k in enumerate(pressing):
        for other in pressing[place + 1 :]:
            apart = float(np.linalg.norm(fitter.table.offsets(state.mean[k, :2], state.mean[other, :2])))
            near = apart < NEAR * fitter.table.radius
            if near and (merged := _merged(stationary, bar, speed, (k, other))) is not None:
                return merged
    if (rest := _without_needless(stationary, bar)) is not None:
        return rest
    if len(pressing) < fitter.most:
        turn, place = divmod(turn, len(pressing))
        return _split(stationary, bar, speed, pressing[place], turn % _ANYWAY == 0)
    return state


def _afresh(stationary: "_Stationary", bar: float, speed: float) -> TrackState | None:
    """The state with other contacts, if these explain the last frames significantly better than its own do."""
    state, fitter, pressing = stationary.state, stationary.fitter, stationary.state.pressing
    nominal, inflated, _, here = stationary.minus_all_but(pressing)
    there = fitter.fit_information(nominal, inflated, bar)
    more = max(len(there.params) - len(here.params), 0)
    if fitter.poor(nominal, there.cost) or here.cost - there.cost < _ELSEWHERE + more * fitter.bar**2:
        return None  # nothing gained, or something else than contacts disturbs
    away = np.linalg.norm(fitter.table.offsets(there.params[:, None, :2], state.mean[pressing, :2]), axis=2)
    named = dict(zip(*linear_sum_assignment(away), strict=True))
    after = state.without(pressing)
    for n, (params, covariance) in enumerate(zip(there.params, there.covariances, strict=True)):
        name = state.tracks[pressing[named[n]]].id if n in named else None
        after = after.with_contact(params, covariance, speed, name)
    return changed(after, history=(), covered=tuple(sorted({*state.covered, *there.covered})), refuted=0.0)


def _without_needless(stationary: "_Stationary", bar: float) -> TrackState | None:
    """The state without its faintest contact, if the others explain the last frames as usual, and nearly as well."""
    state, fitter, pressing = stationary.state, stationary.fitter, stationary.state.pressing
    if len(pressing) < 2:
        return None
    faintest = min(pressing, key=lambda k: abs(float(state.mean[k, 2])))
    others = [k for k in pressing if k != faintest]
    nominal, inflated, _, many = stationary.minus_all_but(pressing)
    few = fitter.refine(inflated, state.params[others])
    if few.cost - many.cost > _HYSTERESIS * bar or fitter.poor(nominal, few.cost):
        return None
    return changed(known_gone(state, fitter, faintest), history=())


def _placed(stationary: "_Stationary", speed: float, k: int) -> TrackState | None:
    """The state with one contact where the frames since it came want it, if that is elsewhere."""
    state, fitter = stationary.state, stationary.fitter
    nominal, inflated, _, here = stationary.minus_all_but([k])
    there = fitter.added(inflated, *fitter.scores(nominal))
    if here.cost - there.cost < _ELSEWHERE:
        return None
    mean, covariance = state.mean.copy(), state.covariance.copy()
    at = slice(STATE * k, STATE * (k + 1))
    mean[k, :PER_CONTACT], mean[k, PER_CONTACT:] = there.params[0], 0.0
    covariance[at], covariance[:, at] = 0.0, 0.0
    covariance[at, at] = block_diag(there.covariance, speed**2 * np.eye(2))
    return changed(state, mean=mean, covariance=covariance, history=())


def _split(stationary: "_Stationary", bar: float, speed: float, k: int, anyway: bool) -> TrackState:
    """The state with one contact as two, if these explain the last frames better; the closer one keeps the name.

    Two that were fitted without success are fitted again once a larger gain is expected, or `anyway`.
    """
    state, fitter = stationary.state, stationary.fitter
    nominal, inflated, error, one = stationary.minus_all_but([k])
    left = nominal.minus(one.caused).marginalised_flat(one.slopes)
    promise = float(fitter.pairs(left, one.params[0])[1].max()) ** 2
    if promise < _MORE * state.tracks[k].refuted and not anyway:
        return state
    two = fitter.split(nominal, inflated, one, 0, bar + error, left)
    if two is None:
        tracks = [*state.tracks]
        tracks[k] = changed(tracks[k], refuted=promise)
        return changed(state, tracks=tuple(tracks))
    closer, farther = np.argsort(np.linalg.norm(fitter.table.offsets(two.params[:, :2], state.mean[k, :2]), axis=1))
    rest, covariances = state.without([k]), two.covariances
    kept = rest.with_contact(two.params[closer], covariances[closer], speed, state.tracks[k].id)
    return changed(kept.with_contact(two.params[farther], covariances[farther], speed), history=())


def _merged(stationary: "_Stationary", bar: float, speed: float, both: tuple[int, int]) -> TrackState | None:
    """The state with two contacts as one, if one explains the last frames nearly as well; it keeps the older name."""
    state, fitter = stationary.state, stationary.fitter
    nominal, inflated, error, two = stationary.minus_all_but(both)
    pair = state.params[list(both)].copy()
    pair[1, :2] = pair[0, :2] + fitter.table.offsets(pair[1, :2], pair[0, :2])
    weight = np.abs(pair[:, 2]) / np.abs(pair[:, 2]).sum()
    start = weight @ pair
    start[2] = pair[:, 2].sum()
    one = fitter.refine(inflated, start[None])
    if fitter.are_two(nominal, one, two, bar + error, _HYSTERESIS):
        return None
    kept = min(state.tracks[k].id for k in both)
    return changed(state.without(both).with_contact(one.params[0], one.covariance, speed, kept), history=())


@dataclass(frozen=True, eq=False)
class _Stationary:
    """Information of the newest frames in which all contacts rested.

    Args:
        state: The state after them.
        fitter: What explains data by contacts.
        count: How many they are.
        nominal: Their information, combined.
        inflated: The same with noise inflated by the model's error.
    """

    state: TrackState
    fitter: ContactFitter
    count: int
    nominal: Information
    inflated: Information
    _fitted: dict[tuple[int, ...], tuple[Information, Information, float, Solution]] = field(default_factory=dict)

    @classmethod
    def of(cls, state: TrackState, fitter: ContactFitter) -> "_Stationary":
        pressing = state.pressing
        speed = float(np.linalg.norm(state.mean[pressing, PER_CONTACT:], axis=1).max())
        came = max(state.tracks[k].since for k in pressing)
        play = [3 * state.effect(k)[1] + 0.1 * abs(state.mean[k, 2]) for k in pressing]
        used = []
        for residuals in state.history:
            effects = np.array([residuals.effects.get(state.tracks[k].id, np.nan) for k in pressing])
            absent = np.isnan(effects).any() and residuals.time < came
            changed = (np.abs(effects - state.mean[pressing, 2]) > play).any()
            if absent or changed or (state.time - residuals.time) * speed > fitter.table.radius / 4:
                break
            used.append(residuals.observation)
        used = used or [state.history[0].observation]
        nominal = Information.combined([observation.nominal for observation in used])
        return cls(
            state, fitter, len(used), nominal, nominal.with_misfits([observation.inflated for observation in used])
        )

    def minus_all_but(self, chosen: Sequence[int]) -> tuple[Information, Information, float, Solution]:
        """Their information, nominal and inflated, less all contacts but the chosen ones, marginalised over shapes
        that small ones may have; how much of it may be errors of the others' model (noise's variance); the chosen
        ones fitted."""
        if (known := self._fitted.get(tuple(chosen))) is not None:
            return known
        params, fitter = self.state.params, self.fitter
        nominal, inflated, error = self.nominal, self.inflated, 0.0
        if len(chosen) < len(params):
            others = fitter.responses(np.delete(params, chosen, axis=0))[0]
            error = (fitter.model_error * nominal.norm(others)) ** 2
            nominal, inflated = nominal.minus(others), inflated.minus(others)
        if (shapes := fitter.shapes(params[list(chosen)])).size:
            nominal, inflated = nominal.marginalised(shapes), inflated.marginalised(shapes)
        found = nominal, inflated, error, fitter.refine(inflated, params[list(chosen)])
        self._fitted[tuple(chosen)] = found
        return found
