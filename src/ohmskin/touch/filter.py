"""Contacts over time: few measurements a frame suffice, because what was known a moment ago still nearly holds.

Every contact is a disc that moves: place, effect, squared radius, velocity, with one covariance for all contacts. A frame
corrects it (iterated extended Kalman filter: the most probable state given the frame and what was believed before). What the
contacts do not explain is kept for a dozen frames and searched for new ones; what stays unexplained is learned as drift.
The rules are told in docs/guide/tracking.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.special import ndtr, ndtri

from ohmskin.drive.policy import Target
from ohmskin.errors import ModelError
from ohmskin.geometry.domain import Floats
from ohmskin.scan import Difference
from ohmskin.touch.contacts import Contact
from ohmskin.touch.explain import FAINT, SQUARE_STD, Explainer, Solution, effect_std, inverse, nothing, unknown
from ohmskin.touch.likelihood import PER_CONTACT, Data, Misfit, gain_directions, responses

_WINDOWS = np.array([1, 2, 3, 4, 6, 8, 12])  # frames over which new contacts are looked for
_STATE = 6  # x, y, effect, squared radius, velocity
_LIFTED, _AGAIN = 0.1, 0.2  # shares of its peak below which a contact is lifted, above which it is there again
_SETTLED = 5.0  # settling times after which nothing is left of a lifted contact
_LEAST_EFFECT = 0.1  # change of conductivity that even a light contact may gain in a moment
_LEARN_EVERY = 5  # frames between two lessons on drift; has no factor in common with a round of six exploring drives
_EVERY = 8  # frames between two looks at whether one contact is two, or two are one
_TRIALS = 1e3  # such looks over which `false_twos` holds
_NEAR = 4.0  # radii, within which two contacts may be one
_ELSEWHERE = 6.0  # squared misfit by which another place must be better for a contact that has just come
_HYSTERESIS = 0.5  # share of the bar of a split below which two contacts become one again
_WARM = 0.01  # by how much all resistances may have changed together before the first frame
_RIDGE = 0.05  # of the rows of a frame, so that drift is not learned where they say nothing


@dataclass(frozen=True)
class Motion:
    """How contacts and the skin may change. The defaults are for fingers on foam.

    Args:
        speed: Standard deviation of a contact's velocity, along each axis (m/s).
        memory: Time over which a velocity is forgotten to 1/e (s).
        pressing: Relative change of an effect in a second, for its random walk (1/sqrt(s)).
        widening: Time over which a radius is forgotten (s).
        warming: Random walk of the common factor of all resistances in a second (1/sqrt(s)); temperature.
        drifting: Time over which what no contact explains becomes part of the baseline (s).
        settling: Time over which what is left of a lifted contact does (s).
        creeping: Time over which the foam recovers from a press (s); until then, what is next to nothing beside it is no contact.
    """

    speed: float = 0.3
    memory: float = 0.3
    pressing: float = 2.0
    widening: float = 1.0
    warming: float = 5e-4
    drifting: float = 5.0
    settling: float = 2.0
    creeping: float = 30.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value > 0):
                raise ModelError(f"{name} is {value!r}; it must be finite and positive")


@dataclass(frozen=True)
class Held:
    """What is remembered of a contact beside its state.

    Args:
        id: Its name.
        peak: Its largest effect so far (m2).
        since: When it came (s).
        lifted: Since when it is lifted (s); zero while it presses.
    """

    id: int
    peak: float
    since: float
    lifted: float = 0.0


@dataclass(frozen=True, eq=False)
class _Glance:
    """One frame of the last few, and what it says of a contact more.

    Args:
        difference: The frame, drift and temperature taken off.
        data: What is finite of it.
        errors: (n_meas, k) directions in which it errs (V).
        left: (n_meas,) what was not foreseen of it (V).
        rest: (n_meas,) what the contacts known by then do not explain (V).
        unsure: (n_meas, k) directions in which it is not known any better (V).
        energy: Squared norm of what they do explain, or did a moment ago (V2).
        effects: Of each contact known by then, by its name (m2).
        time: When it was taken (s).
        score, power: (n_places,) of a contact more at each place.
    """

    difference: Difference
    data: Data
    errors: Floats
    left: Floats
    rest: Floats
    unsure: Floats
    energy: float
    effects: dict[int, float]
    time: float
    score: Floats = field(default_factory=lambda: np.empty(0))
    power: Floats = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, eq=False)
class Scene:
    """What is believed to touch the skin. Start with ``ContactFilter.start()``.

    Args:
        held: The contacts in the order in which they came, lifted ones included.
        mean: (n, 6) x, y (m), effect (m2), squared radius (m2) and velocity (m/s) of each.
        covariance: (6 n, 6 n) of all of them together.
        warmth: Common relative change of all resistances since the calibration, and its variance (1).
        drift: (n_pairs,) what else has changed in the baseline: two-terminal resistances (ohm).
        contacts: The contacts to report, strongest first.
        next_id: The name of the next contact.
        turn: Frames so far.
        time: Since the start (s).
        echo: Squared norm of what contacts cause, or did before the foam forgot it (V2).
        glances: The last frames, newest first.
    """

    held: tuple[Held, ...]
    mean: Floats
    covariance: Floats = field(repr=False)
    warmth: tuple[float, float]
    drift: Floats = field(repr=False)
    contacts: tuple[Contact, ...] = ()
    next_id: int = 1
    turn: int = 0
    time: float = 0.0
    echo: float = 0.0
    glances: tuple[_Glance, ...] = field(default=(), repr=False)

    @property
    def params(self) -> Floats:
        """(n, 4) x, y (m), effect (m2), squared radius (m2) of each contact."""
        return self.mean[:, :PER_CONTACT]

    def recent(self, injections: int) -> tuple[Difference, ...]:
        """The newest frames that have at least so many injections together, drift and temperature taken off; newest first."""
        taken: list[Difference] = []
        for glance in self.glances:
            if sum(difference.pattern.n_inj for difference in taken) >= injections:
                break
            taken.append(glance.difference)
        return tuple(taken)

    @property
    def targets(self) -> tuple[Target, ...]:
        """The contacts, as a policy wants them."""
        return tuple(Target(np.array(c.position), np.array(c.covariance), c.strength, c.radius or 0.0) for c in self.contacts)


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
        self.bar = float(-ndtri(ndtr(-explainer.bar) / len(_WINDOWS)))
        self.split_bar = explainer.bar_of_split(explainer.false_twos / _TRIALS)
        self._square = explainer.table.radius**2

    def start(self) -> Scene:
        """Nothing touches the skin."""
        n_pairs = self.explainer.table.responses.shape[1]
        return Scene((), np.empty((0, _STATE)), np.empty((0, 0)), (0.0, _WARM**2), np.zeros(n_pairs))

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
        whole = Data.of(self.explainer.table.n_elec, difference)
        warm = np.zeros(len(whole.volts)) if reference is None else np.asarray(reference, float)[whole.known]
        scene = self._moved(scene, elapsed)
        before, warmth = scene, scene.warmth
        data = whole.less(whole.rows(scene.drift) + warmth[0] * warm)
        volts = np.full(len(whole.known), np.nan)
        volts[whole.known] = data.volts
        corrected = replace(difference, volts=volts)
        unsure = _none(data)
        if reference is not None:
            unsure = (np.sqrt(warmth[1]) * warm)[:, None]  # stays the last column, see `_warmed`
            if self.gain:
                errors = gain_directions(difference, np.asarray(reference, float), self.gain)[whole.known]
                unsure = np.hstack([errors, unsure])
        scene, seen = self._corrected(scene, data, self.explainer.misfit(data, unsure))
        innovation, directions = self._innovation(before, scene, data, seen)
        # what the foam keeps of a press, and what was learned as drift of the model's error, must not be taken for contacts
        energy = max(float(seen.caused @ seen.caused), scene.echo * float(np.exp(-2 * elapsed / self.motion.creeping)))
        effects = {held.id: float(effect) for held, effect in zip(scene.held, scene.mean[:, 2], strict=True)}
        free = np.hstack([directions, unsure])
        rest = data.volts - seen.caused
        glance = self._glance(_Glance(corrected, data, unsure, innovation, rest, free, energy, effects, scene.time))
        glances = (glance, *scene.glances[: int(_WINDOWS[-1]) - 1])
        scene = replace(scene, glances=glances, echo=energy, turn=scene.turn + 1)
        scene = self._settled(self._warmed(self._born(scene, elapsed), warm), elapsed)
        if scene.turn % _EVERY == 0 and scene.glances:
            scene = self._parted(scene)
        if scene.turn % _LEARN_EVERY == 0 and scene.glances:
            scene = self._drifted(scene, scene.glances[0], _LEARN_EVERY * elapsed)
        return replace(scene, contacts=self._contacts(scene))

    # --- the contacts known ----------------------------------------------------------------------------------------------

    def _moved(self, scene: Scene, elapsed: float) -> Scene:
        """The scene some time later, with nothing measured since."""
        motion, n = self.motion, len(scene.held)
        warmth = (scene.warmth[0], scene.warmth[1] + motion.warming**2 * elapsed)
        if not n:
            return replace(scene, warmth=warmth, time=scene.time + elapsed)
        kept, sized = np.exp(-elapsed / motion.memory), np.exp(-elapsed / motion.widening)
        path = motion.memory * (1 - kept)
        one = np.diag([1.0, 1.0, 1.0, sized, kept, kept])
        one[[0, 1], [4, 5]] = path
        added = np.zeros((n, _STATE))
        pressing = np.array([held.lifted == 0 for held in scene.held])
        added[pressing, 4:] = motion.speed**2 * (1 - kept**2)
        added[pressing, :2] = added[pressing, 4:] * elapsed**2 / 3
        added[:, 2] = motion.pressing**2 * elapsed * (np.abs(scene.mean[:, 2]) + _LEAST_EFFECT * np.pi * self._square) ** 2
        added[:, 3] = (1 - sized**2) * (SQUARE_STD * self._square) ** 2
        step = np.kron(np.eye(n), one)
        mean = scene.mean @ one.T
        mean[:, 3] += (1 - sized) * self._square
        mean[:, :2] = self.explainer.onto(mean[:, :2])
        covariance = step @ scene.covariance @ step.T + np.diag(added.ravel())
        return replace(scene, mean=mean, covariance=covariance, warmth=warmth, time=scene.time + elapsed)

    def _corrected(self, scene: Scene, data: Data, misfit: Misfit) -> tuple[Scene, Solution]:
        """The scene after a frame, its contacts being those that it holds, and how they explain it."""
        n = len(scene.held)
        if not n:
            return scene, nothing(data)
        measured = _measured(n)
        before = scene.covariance[np.ix_(measured, measured)]
        seen = self.explainer.refine(data, scene.params, misfit, scene.params.ravel(), inverse(before), rounds=3)
        gain = np.linalg.solve(before, scene.covariance[measured]).T
        mean = scene.mean + (gain @ (seen.params - scene.params).ravel()).reshape(n, _STATE)
        mean[:, :PER_CONTACT] = seen.params
        covariance = scene.covariance - gain @ (before - inverse(seen.normal)) @ gain.T
        return replace(scene, mean=mean, covariance=(covariance + covariance.T) / 2), seen

    # --- what they do not explain ----------------------------------------------------------------------------------------

    def _innovation(self, before: Scene, after: Scene, data: Data, seen: Solution) -> tuple[Floats, Floats]:
        """What was not foreseen of a frame (n_meas,), and in which directions (n_meas, 4 n) contacts may have caused it (V)."""
        n = len(before.held)
        if not n:
            return data.volts, seen.slopes
        measured = _measured(n)
        spread = np.linalg.cholesky(_balanced(before.covariance[np.ix_(measured, measured)]))
        return data.volts - seen.caused + seen.slopes @ (after.params - before.params).ravel(), seen.slopes @ spread

    def _warmed(self, scene: Scene, warm: Floats) -> Scene:
        """The scene after a frame has said by how much all resistances have changed together, contacts that it brought known."""
        newest = scene.glances[0]
        if not warm.any():
            return scene
        both = np.column_stack([warm, newest.left])
        inner = self.explainer.misfit(newest.data, newest.unsure[:, :-1]).inner(both, both)
        certainty = 1 / (1 / scene.warmth[1] + inner[0, 0])
        rise = float(certainty * inner[0, 1])
        newest = replace(newest, rest=newest.rest - rise * warm)
        return replace(scene, warmth=(scene.warmth[0] + rise, float(certainty)), glances=(newest, *scene.glances[1:]))

    def _glance(self, glance: _Glance) -> _Glance:
        """A glance with its scores."""
        score, power = self.explainer.scores(glance.data, glance.left, Misfit(self.explainer.noise, glance.unsure))
        return replace(glance, score=score, power=power)

    def _born(self, scene: Scene, elapsed: float) -> Scene:
        """The scene with new contacts: places where one explains what is left of the last frames significantly better."""
        explainer = self.explainer
        while sum(not held.lifted for held in scene.held) < explainer.most:
            glances = scene.glances
            windows = _WINDOWS[: np.searchsorted(_WINDOWS, len(glances), side="right")]
            score = np.cumsum([glance.score for glance in glances], axis=0)[windows - 1]
            power = np.cumsum([glance.power for glance in glances], axis=0)[windows - 1]
            energy = np.cumsum([glance.energy for glance in glances])[windows - 1, None]
            # the noise of the reference, and of what was learned of its drift, is the same in all frames: it does not average out
            shared = 1 + (windows[:, None] - 1) * (1 / self.repeats + min(_LEARN_EVERY * elapsed / self.motion.drifting, 1) / 2)
            height = explainer.heights(score, power * shared) - explainer.model_error * np.sqrt(energy) / explainer.noise
            window, place = np.unravel_index(np.argmax(height), height.shape)
            if height[window, place] < self.bar:
                break
            used = glances[: int(windows[window])]
            data = Data.together([glance.data.less(glance.data.volts - glance.left) for glance in used])
            unsure = block_diag(*[glance.unsure for glance in used])
            found = explainer.added(data, explainer.misfit(data, unsure), score[window], power[window])
            moved = self.motion.speed * (scene.time - used[-1].time) / 2
            covariance = inverse(found.normal)
            covariance[[0, 1], [0, 1]] += moved**2
            scene = self._with(scene, found.params[0], covariance)
            scene = replace(scene, glances=tuple(self._reviewed(glance, found.params) for glance in glances))
        return scene

    def _reviewed(self, glance: _Glance, params: Floats) -> _Glance:
        """A glance after one contact more (1, 4) has been found in it."""
        caused, slopes = responses(self.explainer.table, glance.data, params)
        free = unknown(slopes, glance.data.volts)
        return self._glance(
            replace(
                glance,
                left=glance.left - caused,
                rest=glance.rest - caused,
                unsure=np.hstack([free, glance.unsure]),
                energy=glance.energy + float(caused @ caused),
            )
        )

    def _with(self, scene: Scene, params: Floats, covariance: Floats) -> Scene:
        """The scene with one contact more (4,), at rest."""
        n = len(scene.held)
        whole = np.zeros((_STATE * (n + 1), _STATE * (n + 1)))
        whole[: _STATE * n, : _STATE * n] = scene.covariance
        whole[_STATE * n : _STATE * n + PER_CONTACT, _STATE * n : _STATE * n + PER_CONTACT] = covariance
        whole[[-2, -1], [-2, -1]] = self.motion.speed**2
        held = Held(scene.next_id, abs(float(params[2])), scene.time)
        mean = np.vstack([scene.mean, [*params, 0.0, 0.0]])
        return replace(scene, held=(*scene.held, held), mean=mean, covariance=whole, next_id=scene.next_id + 1)

    def _without(self, scene: Scene, gone: Sequence[int]) -> Scene:
        """The scene without some of its contacts."""
        kept = np.array([k for k in range(len(scene.held)) if k not in gone], int)
        state = (kept[:, None] * _STATE + np.arange(_STATE)).ravel()
        held = tuple(scene.held[k] for k in kept)
        return replace(scene, held=held, mean=scene.mean[kept], covariance=scene.covariance[np.ix_(state, state)])

    # --- coming and going ------------------------------------------------------------------------------------------------

    def _settled(self, scene: Scene, elapsed: float) -> Scene:
        """The scene with lifted contacts told from pressing ones; what is left of lifted ones goes over into the drift."""
        scene = self._cleared(scene)
        held, mean, drift, next_id = [], scene.mean.copy(), scene.drift, scene.next_id
        share = 1 - np.exp(-elapsed / self.motion.settling)
        for k, one in enumerate(scene.held):
            effect, std = self._effect(scene, k)
            if not one.lifted:
                one = replace(one, peak=max(one.peak, effect))
                if effect < max(_LIFTED * one.peak, FAINT * std):
                    one = replace(one, lifted=max(elapsed, 1e-9))
                    mean[k, 4:] = 0.0
            elif effect > max(_AGAIN * one.peak, self.bar * std):
                one = Held(next_id, effect, scene.time)
                next_id += 1
            else:
                one = replace(one, lifted=one.lifted + elapsed)
                if effect > FAINT * std:
                    response = self.explainer.table(mean[k, None, :2], np.sqrt(mean[k, 3])).values[0]
                    drift = drift + share * mean[k, 2] * response
                    mean[k, 2] *= 1 - share
            held.append(one)
        scene = replace(scene, held=tuple(held), mean=mean, drift=drift, next_id=next_id)
        return self._without(scene, [k for k, one in enumerate(held) if one.lifted > _SETTLED * self.motion.settling])

    def _cleared(self, scene: Scene) -> Scene:
        """The scene without a faint contact beside another one, which takes over its effect: two were seen where one is."""
        if len(scene.held) < 2:
            return scene
        apart = np.linalg.norm(scene.mean[:, None, :2] - scene.mean[:, :2], axis=2)
        for k, one in enumerate(scene.held):
            beside = [j for j, other in enumerate(scene.held) if j != k and not other.lifted]
            effect, std = self._effect(scene, k)
            near = beside and apart[k, beside].min() < _NEAR * self.explainer.table.radius
            if near and (one.lifted or effect < max(_LIFTED * one.peak, FAINT * std)):
                at = _STATE * k + 2
                gain = scene.covariance[:, at] / scene.covariance[at, at]
                mean = scene.mean - (gain * scene.mean[k, 2]).reshape(scene.mean.shape)
                mean[:, :2] = self.explainer.onto(mean[:, :2])
                mean[:, 3] = np.clip(mean[:, 3], *self.explainer.squares)
                covariance = scene.covariance - np.outer(gain, scene.covariance[at])
                names = list(scene.held)
                if not one.lifted:
                    j = min(beside, key=lambda j: float(apart[k, j]))
                    names[j] = replace(names[j], id=min(one.id, names[j].id))
                return self._without(replace(scene, held=tuple(names), mean=mean, covariance=covariance), [k])
        return scene

    def _effect(self, scene: Scene, k: int) -> tuple[float, float]:
        """The size of a contact's effect, and its standard deviation (m2)."""
        at = slice(_STATE * k, _STATE * k + PER_CONTACT)
        return abs(float(scene.mean[k, 2])), effect_std(scene.covariance[at, at])

    def _parted(self, scene: Scene) -> Scene:
        """The scene with a contact moved elsewhere, two taken for one, or one taken for two, where the last frames say so."""
        pressing = [k for k, held in enumerate(scene.held) if not held.lifted]
        for k in pressing:
            young = scene.held[k].since >= scene.glances[-1].time  # its first frame may have misled
            if young and (placed := self._placed(scene, k)) is not None:
                return placed
        for place, k in enumerate(pressing):
            for other in pressing[place + 1 :]:
                apart = float(np.linalg.norm(scene.mean[k, :2] - scene.mean[other, :2]))
                if apart < _NEAR * self.explainer.table.radius and (merged := self._merged(scene, k, other)) is not None:
                    return merged
        if pressing and len(pressing) < self.explainer.most:
            return self._split(scene, pressing[scene.turn // _EVERY % len(pressing)])
        return scene

    def _now(self, scene: Scene, chosen: Sequence[int]) -> tuple[Data, Floats]:
        """The frames in which the chosen contacts were where and as strong as they are now, as if only these were there."""
        speed = float(np.linalg.norm(scene.mean[chosen, PER_CONTACT:], axis=1).max())
        used = []
        for glance in scene.glances:
            effects = np.array([glance.effects.get(scene.held[k].id, np.nan) for k in chosen])
            changed = np.abs(effects - scene.mean[chosen, 2]) > [
                3 * self._effect(scene, k)[1] + 0.1 * abs(scene.mean[k, 2]) for k in chosen
            ]
            young = np.isnan(effects).any() and glance.time < max(scene.held[k].since for k in chosen)
            if young or changed.any() or (scene.time - glance.time) * speed > self.explainer.table.radius / 4:
                break
            used.append(glance)
        used = used or [scene.glances[0]]
        data = Data.together([glance.data for glance in used])
        others = responses(self.explainer.table, data, np.delete(scene.params, chosen, axis=0))[0]
        return data.less(others), block_diag(*[glance.errors for glance in used])

    def _placed(self, scene: Scene, k: int) -> Scene | None:
        """The scene with one contact where the frames since it came want it, if that is elsewhere."""
        explainer, (data, errors) = self.explainer, self._now(scene, [k])
        misfit = explainer.misfit(data, errors)
        here = explainer.refine(data, scene.params[[k]], misfit)
        there = explainer.added(data, misfit, *explainer.scores(data, data.volts, Misfit(explainer.noise, errors)))
        if here.cost - there.cost < _ELSEWHERE:
            return None
        mean, covariance = scene.mean.copy(), scene.covariance.copy()
        at = slice(_STATE * k, _STATE * (k + 1))
        mean[k, :PER_CONTACT], mean[k, PER_CONTACT:] = there.params[0], 0.0
        covariance[at], covariance[:, at] = 0.0, 0.0
        covariance[at, at] = block_diag(there.covariance, self.motion.speed**2 * np.eye(2))
        return replace(scene, mean=mean, covariance=covariance, glances=())

    def _split(self, scene: Scene, k: int) -> Scene:
        data, errors = self._now(scene, [k])
        misfit = self.explainer.misfit(data, errors)
        one = self.explainer.refine(data, scene.params[[k]], misfit)
        two = self.explainer.split(data, one, 0, self.split_bar, errors)
        if two is None:
            return scene
        covariance = two.covariance
        order = np.argsort(np.linalg.norm(two.params[:, :2] - scene.mean[k, :2], axis=1))
        for number in order:
            at = slice(PER_CONTACT * number, PER_CONTACT * (number + 1))
            scene = self._with(scene, two.params[number], covariance[at, at])
        held = [*scene.held[:-2], replace(scene.held[-2], id=scene.held[k].id), replace(scene.held[-1], id=scene.next_id - 2)]
        return self._without(replace(scene, held=tuple(held), next_id=scene.next_id - 1, glances=()), [k])

    def _merged(self, scene: Scene, k: int, other: int) -> Scene | None:
        data, errors = self._now(scene, [k, other])
        misfit = self.explainer.misfit(data, errors)
        pair = scene.params[[k, other]]
        weight = np.abs(pair[:, 2]) / np.abs(pair[:, 2]).sum()
        start = weight @ pair
        start[2] = pair[:, 2].sum()
        two, one = self.explainer.refine(data, pair, misfit), self.explainer.refine(data, start[None], misfit)
        if self.explainer.gained(data, one, two) > _HYSTERESIS * self.split_bar:
            return None
        kept = min(scene.held[k].id, scene.held[other].id)
        scene = self._with(self._without(scene, [k, other]), one.params[0], one.covariance)
        held = (*scene.held[:-1], replace(scene.held[-1], id=kept))
        return replace(scene, held=held, next_id=scene.next_id - 1, glances=())

    def _drifted(self, scene: Scene, glance: _Glance, elapsed: float) -> Scene:
        """The scene with some of what no contact explains of a frame taken for a change of the baseline."""
        settling = scene.held and all(held.lifted for held in scene.held)
        share = elapsed / (elapsed + (self.motion.settling if settling else self.motion.drifting))
        data, left = glance.data, glance.rest
        if len(scene.held):  # what might be a contact's is left to it, and what the model gets wrong of a strong one is not learned
            slopes = responses(self.explainer.table, data, scene.params)[1]
            left = Misfit(self.explainer.noise, unknown(slopes, left)).apply(left)
            error = self.explainer.model_error**2 * glance.energy / len(left)
            share *= self.explainer.noise**2 / (self.explainer.noise**2 + error)
        rows = data.matrix
        gram = rows @ rows.T
        gram[np.diag_indices_from(gram)] += _RIDGE
        learned = rows.T @ np.linalg.solve(gram, left / data.currents)
        return replace(scene, drift=scene.drift + share * learned)

    def _contacts(self, scene: Scene) -> tuple[Contact, ...]:
        """The pressing contacts, strongest first."""
        found = []
        for k, held in enumerate(scene.held):
            if not held.lifted:
                at = slice(_STATE * k, _STATE * k + PER_CONTACT)
                velocity = (float(scene.mean[k, 4]), float(scene.mean[k, 5]))
                contact = self.explainer.contact(scene.params[k], scene.covariance[at, at])
                found.append(replace(contact, id=held.id, velocity=velocity))
        return tuple(sorted(found, key=lambda contact: -abs(contact.strength)))


def _measured(n: int) -> np.ndarray:
    """Where in the state of n contacts the parameters are that a frame depends on."""
    return (np.arange(n)[:, None] * _STATE + np.arange(PER_CONTACT)).ravel()


def _none(data: Data) -> Floats:
    """No direction (n_meas, 0)."""
    return np.zeros((len(data.volts), 0))


def _balanced(covariance: Floats) -> Floats:
    """The covariance with a trace of its diagonal added, so that rounding cannot make it indefinite."""
    return np.asarray(covariance + 1e-12 * np.diag(np.diag(covariance)))
