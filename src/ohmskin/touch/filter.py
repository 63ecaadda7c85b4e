"""Contacts over time: few measurements a frame suffice, because what was known a moment ago still nearly holds.

Every contact is a disc that moves: place, effect, squared radius, velocity, with one covariance for all contacts. A frame
corrects it (iterated extended Kalman filter: the most probable state given the frame and what was believed before). What the
contacts do not explain is kept for a dozen frames and searched for new ones; what stays unexplained is learned as drift.
The rules are told in docs/guide/tracking.md.
"""

from dataclasses import replace

import numpy as np

from ohmskin.errors import ModelError
from ohmskin.geometry.domain import Floats
from ohmskin.scan import Difference
from ohmskin.touch.birth import LONGEST, bar_of_birth, born, scored
from ohmskin.touch.contacts import Contact
from ohmskin.touch.drift import learned, taken_off, warmed
from ohmskin.touch.explain import Explainer
from ohmskin.touch.glance import Glance, Reading
from ohmskin.touch.lift import settled
from ohmskin.touch.likelihood import PER_CONTACT
from ohmskin.touch.motion import Motion, moved
from ohmskin.touch.revision import bar_of_revision, revised
from ohmskin.touch.scene import STATE, Scene
from ohmskin.touch.solution import Solution, inverse, nothing

_WARM = 0.01  # by how much all resistances may have changed together before the first frame
_LEARN_EVERY = 5  # frames between two lessons on drift; has no factor in common with a round of six exploring drives
_REVISE_EVERY = 8  # frames between two looks at whether one contact is two, or two are one


class ContactFilter:
    """Follows contacts from frame to frame; each frame may have another pattern.

    Args:
        explainer: What explains data by contacts; its `false_alarms` are per frame here, and `false_twos` per ten seconds or so.
        motion: How contacts and the skin may change.
        repeats: Quiet frames behind the reference, whose noise is the same in all frames.
        gain: Standard deviation of the error of a measured current (1); it is the same in all voltages of an injection.

    Attributes:
        bar: Standard deviations by which the score of a new contact must stand out.
        split_bar: By how much two contacts must explain the last frames better than one.
    """

    def __init__(self, explainer: Explainer, motion: Motion | None = None, repeats: float = np.inf, gain: float = 0.0) -> None:
        self.explainer, self.motion, self.repeats, self.gain = explainer, motion or Motion(), repeats, gain
        self.bar, self.split_bar = bar_of_birth(explainer), bar_of_revision(explainer)

    def start(self) -> Scene:
        """Nothing touches the skin."""
        n_pairs = self.explainer.table.responses.shape[1]
        return Scene((), np.empty((0, STATE)), np.empty((0, 0)), (0.0, _WARM**2), np.zeros(n_pairs))

    def lifted(self, scene: Scene) -> Scene:
        """The scene with nothing on the skin; what is known of its drift is kept."""
        warmth = scene.warmth[0], _WARM**2
        return replace(self.start(), warmth=warmth, drift=scene.drift, echo=scene.echo, next_id=scene.next_id)

    def update(self, scene: Scene, difference: Difference, elapsed: float, reference: Floats | None = None) -> Scene:
        """What is believed after one frame more.

        Args:
            scene: What was believed after the last one.
            difference: The frame's change against the untouched skin.
            elapsed: Time since the last one (s).
            reference: (n_meas,) voltages of the untouched skin at the currents of this frame (V). A common change of all
                resistances (temperature) is followed only where they are given.

        Raises:
            DataError: If no finite datum is left.
            ModelError: If the time is negative or not finite.
        """
        if not (np.isfinite(elapsed) and elapsed >= 0):
            raise ModelError(f"elapsed is {elapsed!r} s; it must be finite and not negative")
        explainer, motion = self.explainer, self.motion
        before = moved(scene, explainer, motion, elapsed)
        reading = taken_off(before, explainer.table.n_elec, difference, reference, self.gain)
        scene, seen = self._corrected(before, reading)
        scene = self._remembered(before, scene, reading, seen, elapsed)
        scene = born(scene, explainer, self.bar, self._common(elapsed), motion.speed)
        scene = settled(warmed(scene, explainer), explainer, self.bar, motion.settling, elapsed)
        if scene.turn % _REVISE_EVERY == 0:
            scene = revised(scene, explainer, self.split_bar, motion.speed, scene.turn // _REVISE_EVERY)
        if scene.turn % _LEARN_EVERY == 0 and scene.glances:
            scene = learned(scene, explainer, motion, _LEARN_EVERY * elapsed)
        return replace(scene, contacts=self._contacts(scene))

    def _corrected(self, scene: Scene, reading: Reading) -> tuple[Scene, Solution]:
        """The scene after a frame, its contacts being those that it holds, and how they explain it."""
        data, measured = reading.data, scene.measured
        if not scene.held:
            return scene, nothing(data)
        before = scene.covariance[np.ix_(measured, measured)]
        misfit = self.explainer.misfit(data, reading.errors)
        seen = self.explainer.refine(data, scene.params, misfit, scene.params.ravel(), inverse(before), rounds=3)
        gain = np.linalg.solve(before, scene.covariance[measured]).T
        mean = scene.mean + (gain @ (seen.params - scene.params).ravel()).reshape(scene.mean.shape)
        mean[:, :PER_CONTACT] = seen.params
        covariance = scene.covariance - gain @ (before - inverse(seen.normal)) @ gain.T
        return replace(scene, mean=mean, covariance=(covariance + covariance.T) / 2), seen

    def _remembered(self, before: Scene, after: Scene, reading: Reading, seen: Solution, elapsed: float) -> Scene:
        """The scene with a frame among its glances, from what was believed before and after it."""
        innovation, directions = _innovation(before, after, reading, seen)
        # what the foam keeps of a press, and what was learned as drift of the model's error, must not be taken for contacts
        energy = max(float(seen.caused @ seen.caused), after.echo * float(np.exp(-2 * elapsed / self.motion.creeping)))
        effects = {held.id: float(effect) for held, effect in zip(after.held, after.mean[:, 2], strict=True)}
        residual, unsure = reading.data.volts - seen.caused, np.hstack([directions, reading.errors])
        glance = scored(Glance(reading, innovation, residual, unsure, energy, effects, after.time), self.explainer)
        return replace(after, glances=(glance, *after.glances[: LONGEST - 1]), echo=energy, turn=after.turn + 1)

    def _common(self, elapsed: float) -> float:
        """Share of the noise's variance that all frames have in common: of the reference, and of what was learned of its drift."""
        return 1 / self.repeats + min(_LEARN_EVERY * elapsed / self.motion.drifting, 1) / 2

    def _contacts(self, scene: Scene) -> tuple[Contact, ...]:
        """The pressing contacts, strongest first."""
        found = []
        for k in scene.pressing:
            contact = self.explainer.contact(scene.params[k], scene.covariance_of(k))
            velocity = float(scene.mean[k, 4]), float(scene.mean[k, 5])
            found.append(replace(contact, id=scene.held[k].id, velocity=velocity))
        return tuple(sorted(found, key=lambda contact: -abs(contact.strength)))


def _innovation(before: Scene, after: Scene, reading: Reading, seen: Solution) -> tuple[Floats, Floats]:
    """What was not foreseen of a frame (n_meas,), and in which directions (n_meas, 4 n) contacts may have caused it (V)."""
    volts, measured = reading.data.volts, before.measured
    if not before.held:
        return volts, seen.slopes
    spread = np.linalg.cholesky(_balanced(before.covariance[np.ix_(measured, measured)]))
    return volts - seen.caused + seen.slopes @ (after.params - before.params).ravel(), seen.slopes @ spread


def _balanced(covariance: Floats) -> Floats:
    """The covariance with a trace of its diagonal added, so that rounding cannot make it indefinite."""
    return np.asarray(covariance + 1e-12 * np.diag(np.diag(covariance)))
