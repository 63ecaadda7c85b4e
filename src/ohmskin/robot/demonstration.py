"""Pokes an arm that feels: MuJoCo's contacts press the physics twin, the real loop senses them, the arm yields."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field

import numpy as np

from ohmskin.arrays import Floats, as_plain
from ohmskin.engine import Engine, Touch
from ohmskin.errors import ModelError
from ohmskin.robot.arm import Arm, Poke, above

_APPROACH = 0.08  # m/s
_RETREAT = 0.25  # m/s, of the skin where it is touched
_PUSH = 0.02  # m beyond the first touch that the finger wants to go
_HOLD = 0.25  # s at the end of a push
_REST = 0.6  # s between two pokes
_LINGER = 0.15  # s that the arm goes on yielding after the last report
_LEAST_RADIUS, _MOST_PRESSURE = 2e-3, 1e6  # m, Pa: within what the virtual skin takes


@dataclass(frozen=True)
class Encounter:
    """One poke and what became of it.

    Args:
        position: Where the finger first touched the skin (m).
        reaction: Time from the first touch to the first command that yields (s); NaN if it was not felt.
        force_then: Force at that command (N).
        peak_force: Largest force (N).
        errors: Distance between the sensed and the true place, frame by frame (m).
    """

    position: tuple[float, float]
    reaction: float
    force_then: float
    peak_force: float
    errors: tuple[float, ...] = field(repr=False)


@dataclass(frozen=True)
class Moment:
    """The state after one cycle of the loop, for pictures.

    Args:
        time: Simulated time (s).
        touch: What was felt.
        poke: What presses the skin; None if nothing does.
        arm: The arm, which goes on moving: draw it now.
    """

    time: float
    touch: Touch
    poke: Poke | None
    arm: Arm = field(repr=False)


class Demonstration:
    """An arm with a skin, and an engine that senses for it.

    Time is the simulation's. Each cycle lasts as long as the device says that its scans take, and `computing` on top,
    so that the result does not depend on how fast this machine is.

    Args:
        engine: The loop on a virtual skin, calibrated.
        seed: Chooses the places of the pokes.
        yielding: Whether the arm yields; without, forces show what the sense of touch is worth.
        computing: Time for computing in each cycle (s).

    Raises:
        ModelError: If the skin is not virtual or not a rectangle.
    """

    def __init__(self, engine: Engine, seed: int = 0, yielding: bool = True, computing: float = 2e-3) -> None:
        if not engine.device.capabilities.virtual or engine.skin.sheet.shape != "rectangle":
            raise ModelError("the demonstration needs a rectangular skin on the device virtual:")
        self.engine, self.yielding, self.computing = engine, yielding, computing
        self._size = np.array([engine.skin.sheet.width, engine.skin.sheet.height])
        self.arm = Arm(*self._size)
        self._random = np.random.default_rng(seed)
        self._felt_at, self._felt_where = -np.inf, np.zeros(2)

    def pokes(self, count: int, show: Callable[[Moment], None] = lambda _: None) -> Iterator[Encounter]:
        """Poke the arm `count` times at random places; `show` is called after every cycle."""
        for _ in range(count):
            yield self._encounter(self._random.uniform(0.1, 0.9, 2) * self._size, show)

    def _encounter(self, aim: Floats, show: Callable[[Moment], None]) -> Encounter:
        pushed, held, touched_at, reacted_at = 0.0, 0.0, np.nan, np.nan
        where, force_then, peak, errors = (np.nan, np.nan), np.nan, 0.0, []
        finger = above(self.arm, aim)
        direction: Floats | None = None
        elapsed = 0.0
        while held < _HOLD:
            if direction is None:  # the finger follows the moving arm until it touches, then pushes straight on
                height = float((finger - self.arm.to_world(aim)) @ self.arm.normal)
                finger = self.arm.to_world(aim) + (height - _APPROACH * elapsed) * self.arm.normal
            elif pushed < _PUSH:
                finger = finger + direction * (_APPROACH * elapsed)
                pushed += _APPROACH * elapsed
            else:
                held += elapsed
            moment, elapsed = self._cycle(finger, elapsed)
            show(moment)
            if moment.poke is not None:
                peak = max(peak, moment.poke.force)
                if direction is None:
                    direction, touched_at = -self.arm.normal, moment.time
                    where = (float(moment.poke.position[0]), float(moment.poke.position[1]))
                for contact in moment.touch.contacts[:1]:
                    errors.append(float(np.hypot(*(np.array(contact.position) - moment.poke.position))))
                if np.isnan(reacted_at) and moment.touch.contacts:
                    # what was touched at the beginning of a cycle is known at its end
                    reacted_at, force_then = moment.time + elapsed, moment.poke.force
        end = self.arm.time + _REST
        while self.arm.time < end:
            moment, elapsed = self._cycle(above(self.arm, aim, 0.12), elapsed)
            show(moment)
        return Encounter(where, reacted_at - touched_at, force_then, peak, tuple(errors))

    def _cycle(self, finger: Floats, seconds: float) -> tuple[Moment, float]:
        """Move for the time of the last cycle, press what MuJoCo presses, sense, command; how long this one takes."""
        if seconds:
            self.arm.advance(seconds, finger)
        poke = self.arm.poke()
        position, radius, force = (poke.position, poke.radius, poke.force) if poke else (np.zeros(2), 0.0, 0.0)
        x, y = np.clip(position, 0, self._size).tolist()
        radius = max(radius, _LEAST_RADIUS)
        self.engine.press(0, (x, y), radius, min(force / (np.pi * radius**2), _MOST_PRESSURE))
        touch = self.engine.step()
        if touch is None:
            raise ModelError(f"the skin was lost: {self.engine.message}; start again")
        scan_time = self.engine.device.capabilities.scan_time
        took = self.computing + sum(scan_time(frame.pattern) for frame in touch.percept.frames)
        self._command(touch, took)
        return Moment(self.arm.time, touch, poke, self.arm), took

    def _command(self, touch: Touch, seconds: float) -> None:
        if touch.contacts:
            self._felt_at, self._felt_where = self.arm.time, np.array(touch.contacts[0].position)
        if self.yielding and self.arm.time - self._felt_at <= _LINGER:
            self.arm.retreat(self._felt_where, _RETREAT, seconds)
        elif self.arm.time - self._felt_at > 0.4:
            self.arm.relax(self.arm.rest(self.arm.time), 0.6, seconds)


def summary(encounters: list[Encounter]) -> dict[str, object]:
    """Figures of a run, for JSON: how many pokes were felt, position errors (m), reaction times (s), forces (N).

    What there is not, such as the reaction to a poke that was not felt, is None.
    """
    errors = np.concatenate([np.zeros(0), *(e.errors for e in encounters)])
    reactions = np.array([e.reaction for e in encounters])
    felt = np.isfinite(reactions)

    def spread(values: Floats) -> dict[str, float] | None:
        if not len(values):
            return None
        return {name: float(np.quantile(values, q)) for name, q in (("median", 0.5), ("p95", 0.95), ("worst", 1.0))}

    return {
        "pokes": len(encounters),
        "felt": int(felt.sum()),
        "frames_in_contact": len(errors),
        "position_error": spread(errors),
        "reaction_time": spread(reactions[felt]),
        "peak_force": spread(np.array([e.peak_force for e in encounters])),
        "encounters": [as_plain(asdict(encounter)) for encounter in encounters],
    }
