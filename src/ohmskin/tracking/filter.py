"""Contacts over time: few measurements a frame suffice, because what was known a moment ago still nearly holds.

Every contact is a disc that moves: place, effect, squared radius, velocity, with one covariance for all contacts. A
frame corrects it (iterated extended Kalman filter: the most probable state given the frame and what was believed
before). What the contacts do not explain is kept for a dozen frames and searched for new ones; what stays unexplained
is learned as drift. The rules are in docs/guide/tracking.md.
"""

from math import sqrt

import numpy as np

from ohmskin.arrays import changed
from ohmskin.contacts.finder import Contact
from ohmskin.contacts.fitter import ContactFitter
from ohmskin.contacts.information import NO_DATA, arguments
from ohmskin.contacts.uneven import UnevenDrift
from ohmskin.errors import DataError, ModelError
from ohmskin.scan import Difference
from ohmskin.scan.pairs import in_series
from ohmskin.tracking import kernels
from ohmskin.tracking.birth import LONGEST, birth_threshold, with_births
from ohmskin.tracking.degraded import with_better_degradation, without_degraded
from ohmskin.tracking.drift import STEP_STD, is_step, with_common_drift, with_learned_drift
from ohmskin.tracking.lift import explain_too_much, with_lifts
from ohmskin.tracking.motion import Motion, moved
from ohmskin.tracking.residuals import Observation, Residuals
from ohmskin.tracking.revision import just_came, revision_threshold, with_revision
from ohmskin.tracking.state import STATE, TrackState

_COMMON_STD = 0.01  # by how much all resistances may have changed together before the first frame
_LEARN_EVERY = 5  # frames between two lessons on drift; has no factor in common with a round of six exploring drives
_REVISE_EVERY = 8  # frames between two looks at whether one contact is two, or two are one


class ContactFilter:
    """Filter that tracks contacts on the data; each frame may have another pattern.

    Args:
        fitter: Explains data by contacts; its `false_alarms` are per frame here, `false_twos` per ten seconds or so.
        motion: How contacts and the skin may change.
        repeats: Number of quiet frames of the reference, whose noise is the same in all frames.

    Attributes:
        bar: Standard deviations that the score of a new contact must exceed.
        split_bar: Least gain of two contacts over one in the last frames.
    """

    def __init__(self, fitter: ContactFitter, motion: Motion | None = None, repeats: float = np.inf) -> None:
        self.fitter, self.motion, self.repeats = fitter, motion or Motion(), repeats
        self.bar, self.split_bar = birth_threshold(fitter), revision_threshold(fitter)

    def start(self) -> TrackState:
        """The state before anything touches the skin."""
        n_pairs = len(self.fitter.table.pairs)
        drift, exact = np.zeros(n_pairs), np.empty((n_pairs, 0))
        uneven = UnevenDrift.none(self.fitter.errors)
        return TrackState((), np.empty((0, STATE)), np.empty((0, 0)), (0.0, _COMMON_STD**2), drift, uneven, exact)

    def lifted(self, state: TrackState) -> TrackState:
        """The state with nothing on the skin; the estimate of its drift is kept."""
        common_drift = state.common_drift[0], _COMMON_STD**2
        start = self.start()
        return changed(
            start,
            common_drift=common_drift,
            drift=state.drift,
            uneven=state.uneven,
            newest_energy=state.newest_energy,
            kept_signal=state.kept_signal,
            next_id=state.next_id,
        )

    def update(self, state: TrackState, difference: Difference, elapsed: float) -> TrackState:
        """The track state after one more frame.

        Args:
            state: The one after the last frame.
            difference: The frame's change against the untouched skin. A common change of all resistances (temperature)
                is estimated only where it has a reference.
            elapsed: Time since the last one (s).

        Raises:
            DataError: If no finite datum is left.
            ModelError: If the time is negative or not finite.
        """
        if not (np.isfinite(elapsed) and elapsed >= 0):
            raise ModelError(f"elapsed is {elapsed!r} s; it must be finite and not negative")
        fitter, motion = self.fitter.drifting(state.uneven.size), self.motion
        if state.time > state.doubted:
            state = without_degraded(state)
        before = moved(state, fitter, motion, elapsed)
        under = fitter.covered(before.params[before.pressing]) if state.covered else []
        covered = tuple(e for e in state.covered if e in under)
        state = self._updated(before, covered, difference, elapsed)
        if is_step(state):
            before = changed(before, common_drift=(before.common_drift[0], STEP_STD**2))
            state = self._updated(before, covered, difference, elapsed)
        if not before.pressing and explain_too_much(state, fitter, self.bar):
            state = self._updated(before.without(range(len(before.tracks))), covered, difference, elapsed)
        state = with_better_degradation(state)
        newest = state.history[0]
        state = with_births(state, fitter, self.bar, self._common(elapsed), motion.speed)
        if state.history[0] is not newest:
            state = with_common_drift(state, fitter, before.common_drift)
        state = with_lifts(state, fitter, self.bar, motion.settling_time, elapsed, self.explains(state))
        if state.turn % _REVISE_EVERY == 0 or just_came(state):
            state = with_revision(state, fitter, self.split_bar, motion.speed, state.turn // _REVISE_EVERY)
        if state.turn % _LEARN_EVERY == 0 and state.history and state.history[0].sound:
            state = with_learned_drift(state, fitter, motion, _LEARN_EVERY * elapsed)
        unexplained = state.unexplained if state.pressing else 0.0
        if state.pressing and state.history[:1] != (newest,):  # there are other contacts than those held by the frame
            unexplained = newest.observation.data.unexplained(fitter.responses(state.params)[0])
        return changed(state, contacts=self._contacts(state), unexplained=unexplained)

    def explains(self, state: TrackState) -> bool:
        """Whether contacts, if there are any in a `state`, explain the newest frame as well as usual; none that is
        doubted."""
        if not state.history:
            return not state.pressing
        newest = state.history[0]
        if not state.pressing or newest.doubted is not None:
            return newest.doubted is None
        data = newest.observation.data
        return not self.fitter.poor(data, newest.residual.misfit.constant * self.fitter.allowance(data))

    def _updated(
        self, before: TrackState, covered: tuple[int, ...], difference: Difference, elapsed: float
    ) -> TrackState:
        """The state after a frame, its contacts being those that it holds, and the frame among its history.

        What resistances of `covered` electrodes, under contacts, do is left out.
        """
        pairs = self.fitter.table.pairs
        mean, covariance = before.mean.copy(), before.covariance.copy()
        scan, errors = arguments(pairs, self.fitter.drifting(before.uneven.size).errors, [difference])
        unknown = np.ascontiguousarray(in_series(covered, pairs).T) if covered else np.empty((0, len(pairs)))
        pressing = len(before.pressing) == len(before.tracks)
        found = kernels.updated(
            scan,
            errors,
            unknown,
            np.ascontiguousarray(before.degraded_errors.T),
            before.drift,
            before.common_drift,
            mean,
            covariance,
            pressing,
            before.possible,
            *self.fitter.compiled,
        )
        if not found.likelihood[-1]:
            raise DataError(NO_DATA)
        observation = Observation(changed(difference, volts=found.volts), found)
        data = observation.data
        known = found.predicted if before.tracks else None
        # a press that ends within a frame, what foam keeps of it, and model error learned as drift are no contacts
        kept = self.motion.kept(before.kept_signal, sqrt(found.energy), elapsed)
        energy = max(found.energy, before.newest_energy, kept**2)
        newest = Residuals(
            observation,
            data.reduced_to(found.innovation, known),
            data.reduced_to(found.residual, found.caused),
            energy,
            {track.id: effect for track, effect in zip(before.tracks, mean[:, 2].tolist(), strict=True)},
            before.time,
            data.reduced_to(found.marginal_innovation, known),
            found.score,
            found.power,
        )
        return changed(
            before,
            mean=mean,
            covariance=covariance,
            common_drift=found.common,
            history=(newest, *before.history[: LONGEST - 1]),
            newest_energy=found.energy,
            kept_signal=kept,
            turn=before.turn + 1,
            suspects=(),
            covered=covered,
            unexplained=data.share_unexplained(*found.signals),
        )

    def _common(self, elapsed: float) -> float:
        """Share of the noise's variance that all frames share: of the reference and its learned drift."""
        return 1 / self.repeats + min(_LEARN_EVERY * elapsed / self.motion.drift_time, 1) / 2

    def _contacts(self, state: TrackState) -> tuple[Contact, ...]:
        """The pressing contacts, strongest first."""
        found = []
        for k in state.pressing:
            contact = self.fitter.contact(state.params[k], state.covariance_of(k))
            velocity = float(state.mean[k, 4]), float(state.mean[k, 5])
            found.append(changed(contact, id=state.tracks[k].id, velocity=velocity))
        return tuple(sorted(found, key=lambda contact: -abs(contact.strength)))
