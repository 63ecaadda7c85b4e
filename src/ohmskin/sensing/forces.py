"""Newtons: the presses behind contacts, followed from frame to frame, for few evaluations of the sheet's model.

A fit of presses from nothing takes some twelve evaluations of 5 ms. From one frame to the next presses change little:
the information of the last frames is summed, and solved for small changes of the presses about where the model was
evaluated last. It is evaluated anew when they have changed by more, or are not found yet. Since light and wide may look
like hard and narrow, several fits are followed until all but one are far less likely, and then another size is tried
beside it. The force told is the median of fits that are found, by likelihood; how all differ is a part of its error.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import exp, hypot, log, sqrt
from operator import attrgetter
from typing import Protocol

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.contacts import Contact
from ohmskin.contacts.kernels import damped_step
from ohmskin.contacts.misfit import NormalEquations
from ohmskin.contacts.solution import inverse
from ohmskin.errors import ModelError
from ohmskin.scan import Difference
from ohmskin.sensing.model import SkinModel
from ohmskin.sensing.presses import LINEAR, FittedPress, Optimum, PressFitter, cost_of, distinct, small
from ohmskin.skin import Foam, Mode, Press

_KEPT = 0.05  # s for which a press is taken to stay as it is
_SIZES = (0.6, 1.0, 1.4)  # usual radii from which fits start
_OTHER = 1.4  # factor of the radius to the next fit that is tried
_DAMPED = 1e-2  # at the start; a step damped by more is no measure of the distance to the best
_JUMPED = 0.05  # share of the squared signal that changes at once where presses may be of another size since
_UNLIKELY = 20.0  # squared misfit beyond that of the best fit, from which on another one is given up
_LOST = 4e-3  # m from its contact, beyond which a press is looked for afresh
_MOST = 1200  # contacts of patches under presses near each other, some three fingers: time goes with the cube
_PREPARING = 0.2  # s of idle time for which one patch is prepared, which takes some 5 ms
_CHANGED, _CREPT = 0.05, 0.25  # logarithm of a pressure, and share of the time in which foam creeps, worth following
_UNKNOWN_SIZE = 0.5  # share of a force that is not known where the size of what presses is not


@dataclass(frozen=True, eq=False)
class Fit:
    """Presses that may be the ones behind contacts.

    Args:
        params: (4 n,) where the model was evaluated last, see `PressFitter.start`.
        caused, slopes: What they change there of the two-terminal resistances (n_pairs,) (ohm), and its slopes.
        damping: Of the next step.
        found: (4 n,) the best there is, if it is near enough; None: not yet.
        covariance: (4 n, 4 n) of the best so far; None: before the first step.
        cost: Squared misfit.
    """

    params: Floats
    caused: Floats
    slopes: Floats
    damping: float = _DAMPED
    found: Floats | None = None
    covariance: Floats | None = None
    cost: float = np.inf

    @property
    def best(self) -> Floats:
        """(4 n,) the best there is."""
        return self.params if self.found is None else self.found

    @property
    def expected(self) -> Floats:
        """(n_pairs,) what the next frame should show (ohm)."""
        return self.caused + self.slopes @ (self.best - self.params)


@dataclass(frozen=True, eq=False)
class Presses:
    """What is known of the presses behind contacts. Start with ``Presses()``.

    Args:
        ids: Of the contacts, rising.
        fits: What they may be, the likeliest first; none: too many or too wide to determine.
        data: Information of the last frames; None: nothing yet.
        exact: That of the last ones with an exact model: by how much presses have changed since.
        scans: What has been measured since, and
        elapsed: in which time, or since a place was prepared while nothing touches (s).
        estimates: The presses found last, by contact, by what of them acts on the sheet, and
        foam: what the foam under them was last, and how long ago (s).
        wider: Whether the next other size that is tried is a wider one.
    """

    ids: tuple[int, ...] = ()
    fits: tuple[Fit, ...] = ()
    data: NormalEquations | None = None
    exact: NormalEquations | None = None
    scans: tuple[Difference, ...] = ()
    elapsed: float = 0.0
    estimates: dict[int, FittedPress] = field(default_factory=dict)
    foam: dict[int, tuple[Foam, float]] = field(default_factory=dict)
    wider: bool = False


class Forces(Protocol):
    """Tells the forces of contacts."""

    def update(
        self, before: Presses, contacts: Sequence[Contact], scans: Sequence[Difference], elapsed: float
    ) -> tuple[Presses, tuple[Contact, ...]]:
        """What is known of presses after one frame more, and its contacts with their forces, where they are known.

        Args:
            before: What was known.
            contacts: Those of the frame, with ids.
            scans: What they changed.
            elapsed: Time since the last frame (s).
        """
        ...


class PressFollower:
    """`Forces` of the presses on a calibrated contact layer that explain the data best; see `PressFitter`.

    Args:
        fitter: Knows what presses change.
        injections: What a fit is improved with, at least: frames of few are gathered.
    """

    def __init__(self, fitter: PressFitter, injections: int) -> None:
        self.fitter, self._injections = fitter, injections
        fitter.sheet.prepare()  # the model is made now, not at the first contact

    def update(
        self, before: Presses, contacts: Sequence[Contact], scans: Sequence[Difference], elapsed: float
    ) -> tuple[Presses, tuple[Contact, ...]]:
        """See `Forces`. While nothing touches, what a first press needs is made, a place now and then."""
        found = sorted(contacts, key=lambda contact: contact.id)
        if not found:
            if (idle := before.elapsed + elapsed) >= _PREPARING:
                self.fitter.sheet.prepare()
                idle = 0.0
            return Presses(elapsed=idle), ()
        state, ids = before, tuple(contact.id for contact in found)
        if state.ids != ids or not state.fits or self._lost(state, found):
            state = self._begun(state, ids, found)
        if state.fits:
            state = replace(state, scans=(*state.scans, *scans), elapsed=state.elapsed + elapsed)
            if sum(scan.pattern.n_inj for scan in state.scans) >= self._injections:
                state = self._improved(self._accumulated(state, found))
        pressing, foam = self._pressing(state, before.foam, elapsed)
        estimates = tuple(_with_force(contact, pressing.get(contact.id)) for contact in contacts)
        return replace(state, foam=foam), estimates

    def _pressing(
        self, state: Presses, before: dict[int, tuple[Foam, float]], elapsed: float
    ) -> tuple[dict[int, FittedPress], dict[int, tuple[Foam, float]]]:
        """What presses, of which foam shows more than there is; and the foam as of the last change that counts."""
        layer = self.fitter.sheet.skin.contact_layer
        if not layer.remembers:
            return state.estimates, {}
        pressing, foam = {}, {}
        for number, one in state.estimates.items():
            last, since = before.get(number, (None, 0.0))
            now, acting = layer.pressing(last, one.press.pressure, since + elapsed), one.press.pressure
            share = now.pressure / acting
            pressing[number] = one.scaled(share, one.force_std / one.force)
            band = max(_CHANGED, one.force_std / one.force)
            if last is None or abs(log(now.pressure / last.pressure)) > band or since > _CREPT * layer.creep_time:
                last, since = now, -elapsed
            foam[number] = last, since + elapsed
        return pressing, foam

    def _lost(self, state: Presses, contacts: Sequence[Contact]) -> bool:
        """Whether a press is far from its contact."""
        places = [fit.params.reshape(-1, len(LINEAR))[:, :2] for fit in state.fits[:1]]
        now = np.array([contact.position for contact in contacts])
        away = [self.fitter.known.fitter.table.offsets(own, now) for own in places]
        return any(bool((np.hypot(*one.T) > _LOST).any()) for one in away)

    def _begun(self, before: Presses, ids: tuple[int, ...], contacts: Sequence[Contact]) -> Presses:
        """Presses at contacts; those known before as they were, if they are still there and can be evaluated so."""
        spots = [Press(contact.position, contact.radius or 1e-3, 0.0) for contact in contacts]
        if self.fitter.most_contacts(spots) > _MOST:
            return Presses(ids)
        estimates = {number: press for number, press in before.estimates.items() if number in ids}
        if fits := self._started(contacts, estimates):
            return Presses(ids, fits, estimates=estimates)
        return Presses(ids, self._started(contacts, {}))

    def _started(self, contacts: Sequence[Contact], estimates: dict[int, FittedPress]) -> tuple[Fit, ...]:
        """Fits of several sizes at contacts; presses with an estimate as they were."""
        fits = list[Fit]()
        for size in _SIZES if len(estimates) < len(contacts) else _SIZES[:1]:
            params = self.fitter.start(contacts, size).reshape(-1, len(LINEAR))
            for own, contact in zip(params, contacts, strict=True):
                if (known := estimates.get(contact.id)) is not None:
                    own[2:] = np.log([known.press.radius, known.press.pressure])
            fits += self._evaluated(params.ravel())
        return tuple(fits)

    def _evaluated(self, params: Floats) -> list[Fit]:
        """A fit where the model is evaluated at presses (4 n,); none if that would take too long or cannot be done."""
        if self.fitter.most_contacts(self.fitter.presses(params)) > _MOST:
            return []
        try:
            return [Fit(params, *self.fitter.caused(params))]
        except ModelError:  # of presses too hard for the mesh: contacts are reported all the same
            return []

    def _accumulated(self, state: Presses, contacts: Sequence[Contact]) -> Presses:
        """The state with what it has gathered among its data, of which the older count less, the more so the more
        presses have changed since; where they have jumped, fits are started afresh beside those that were found."""
        exact = self.fitter.information(state.scans, 0.0)
        changed, jumped = (0.0, False) if state.exact is None else _changed(state.fits[0], state.exact, exact)
        kept = exp(-max(state.elapsed, 1e-3) / _KEPT - changed)
        new = self.fitter.information(state.scans, 1 / (1 - kept))
        data = new if state.data is None else state.data.plus(new, kept)
        fits = state.fits
        found = [fit for fit in fits if fit.found is not None]
        if jumped and found and len(fits) < len(found) + 2:  # more that are not found yet are a search afresh
            fits = (*found, *self._started(contacts, {}))
        return replace(state, fits=fits, data=data, exact=exact, scans=(), elapsed=0.0)

    def _improved(self, state: Presses) -> Presses:
        """The state with presses that explain its data better."""
        assert state.data is not None
        fits = sorted((one for fit in state.fits for one in self._stepped(fit, state.data)), key=cost_of)
        if not fits:
            return Presses(state.ids)
        if fits[0].found is not None:
            likely = [fit for fit in fits if fit.found is None or fit.cost < fits[0].cost + _UNLIKELY]
            fits = distinct(likely, attrgetter("best"))
        estimates = self._estimates(state, fits)
        if len(fits) == 1 and fits[0].found is not None:
            fits += self._other(fits[0], state.wider)
        return replace(state, fits=tuple(fits), estimates=estimates, wider=not state.wider)

    def _other(self, fit: Fit, wider: bool) -> list[Fit]:
        """Presses of another size than a fit's, and of the same force, about."""
        return self._evaluated(self.fitter.resized(fit.best, _OTHER if wider else 1 / _OTHER))

    def _stepped(self, fit: Fit, data: NormalEquations) -> list[Fit]:
        """A fit closer to the data: solved for, if that is near to where it is linear, else evaluated there."""
        fitter = self.fitter
        cost, normal, gradient = fitter.cost(data, fit.params, fit.caused, fit.slopes)
        step = _step(normal, gradient, fit.damping)
        if not small(step):
            if not (after := self._evaluated(fitter.moved(fit.params, step))):
                return []
            trial = fitter.cost(data, after[0].params, after[0].caused, after[0].slopes)
            if trial[0] < cost:
                cost, normal, gradient = trial
                fit = replace(after[0], damping=fit.damping / 8, found=fit.found, covariance=fit.covariance)
            else:
                fit = replace(fit, damping=max(8 * fit.damping, _DAMPED))  # bold as many good steps made it
            step = _step(normal, gradient, fit.damping)
        cost -= float(step @ gradient)
        near, covariance = small(step) and fit.damping <= _DAMPED, inverse(normal)
        if not near:  # how far it is from here to the best is not known
            covariance = covariance + np.outer(step, step)
        found = None if fit.found is None and not near else fitter.moved(fit.params, step)
        return [replace(fit, found=found, covariance=covariance, cost=cost)]

    def _estimates(self, state: Presses, fits: Sequence[Fit]) -> dict[int, FittedPress]:
        """The likeliest presses, if some are found; how much likely ones differ is a part of what is not known.

        While all are sought afresh there is none: the last estimates no longer hold.
        """
        if all(fit.found is None for fit in fits):
            return {}
        tried = [(fit, fit.covariance) for fit in fits if fit.covariance is not None]
        optima = [Optimum(fit.best, fit.cost, covariance) for fit, covariance in tried]
        told = self.fitter.weighed(optima, [fit.found is not None for fit, _ in tried])
        return dict(zip(state.ids, told, strict=True))


class CalibratedForces:
    """Forces by the curve of a calibration: of what was pressed then. What is wider or narrower gets a wrong force.

    Args:
        known: What is known of the skin.
    """

    def __init__(self, known: SkinModel) -> None:
        self._calibration = known.skin.calibration

    def update(
        self, before: Presses, contacts: Sequence[Contact], scans: Sequence[Difference], elapsed: float
    ) -> tuple[Presses, tuple[Contact, ...]]:
        """See `Forces`."""
        forces = self._calibration.force([abs(contact.strength) for contact in contacts]).tolist() if contacts else []
        error = self._calibration.force_error
        return before, tuple(
            replace(contact, force=force, force_std=hypot(error, _UNKNOWN_SIZE * force))
            for contact, force in zip(contacts, forces, strict=True)
        )


def forces_of(known: SkinModel, mode: Mode) -> Forces | None:
    """What estimates forces of a skin in a mode; None if it was not calibrated for that."""
    calibration = known.skin.calibration
    if calibration.layer_conductance:
        return PressFollower(PressFitter(known), known.skin.imaging.pairs)
    return CalibratedForces(known) if calibration.forces and calibration.mode == mode.name else None


def _step(normal: Floats, gradient: Floats, damping: float) -> Floats:
    step = gradient.copy()
    damped_step(normal, damping, step)
    return step


def _changed(fit: Fit, before: NormalEquations, now: NormalEquations) -> tuple[float, bool]:
    """By how many standard deviations of chi-square presses differ between two looks, beyond one (1); whether they
    have jumped."""
    found, normals = [], []
    for one in (before, now):
        normals.append(fit.slopes.T @ one.matrix @ fit.slopes + np.diag(np.tile(LINEAR, len(fit.params) // 4) ** -2.0))
        found.append(np.linalg.solve(normals[-1], fit.slopes.T @ (one.vector - one.matrix @ fit.caused)))
    step = found[1] - found[0]
    both = inverse(normals[0]) + inverse(normals[1])
    square = float(step @ np.linalg.solve(both, step))
    jumped = square > _JUMPED * max(before.constant, now.constant)
    return max((square - len(step)) / sqrt(2 * len(step)) - 1, 0.0), jumped


def _with_force(contact: Contact, press: FittedPress | None) -> Contact:
    if press is None:
        return contact
    area = press.force / press.press.pressure
    return replace(contact, force=press.force, force_std=press.force_std, pressure=press.press.pressure, area=area)
