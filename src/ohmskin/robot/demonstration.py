"""Pokes a robot that feels: MuJoCo's contacts press the physics twins, the real loops sense them, the robot yields."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.body import Body, SelfTouch
from ohmskin.client.contacts import PlacedContact
from ohmskin.contacts import in_frame
from ohmskin.device import connect
from ohmskin.engine import Engine, Touch
from ohmskin.errors import ModelError
from ohmskin.robot.figures import Encounter, Hug, SelfTouchTrial
from ohmskin.robot.hands import Hand
from ohmskin.robot.reach import way_to_itself
from ohmskin.robot.scene import PADS
from ohmskin.robot.simulation import Push, RobotSimulation, above
from ohmskin.robot.strategies import strategy_named
from ohmskin.skin import Calibration, Press, Skin

_WITHDRAW = 0.25  # m/s, of a place that tells no newtons
_HOLD = 0.25  # s that the robot touches itself
_PAUSE = 0.4  # s between two pokes
_TRIES = 1000  # of places of a skin that a pad can come to
_REACHING = 0.6  # rad/s or m/s, of a robot that goes to touch itself
_FIRM = 5.0  # N, with which it does
_FREE = 24e-3  # m that the way of a hand keeps from other links
_RIM = 0.1  # of a skin's size, that pokes keep from its rim
_NEAR = 0.03  # m from a contact, within which a push is taken for what caused it
_AWAY, _UP = np.array([0.0, 0.0, 9.0]), np.array([0.0, 0.0, 1.0])  # where no hand is near


@dataclass(frozen=True)
class Sensed:
    """A sensed contact and the true one.

    Args:
        patch: Number of the skin.
        place: (x, y) on its map (m).
        contact: As the body reports it, in the frame of the root link, which is the world.
        push: The true press there, from MuJoCo; None if nothing is near.
    """

    patch: int
    place: tuple[float, float]
    contact: PlacedContact
    push: Push | None

    @property
    def error(self) -> float:
        """Distance (m) between both; infinite if nothing is near."""
        return np.inf if self.push is None else float(np.linalg.norm(self.contact.position - self.push.point))


@dataclass(frozen=True)
class Moment:
    """The state after one cycle of the loops, for pictures.

    Args:
        time: Simulated time (s).
        touches: The cycle of each skin.
        pushes: The true presses on the skins.
        sensed: All contacts.
        simulation: The robot, which continues to move: draw it now.
    """

    time: float
    touches: tuple[Touch, ...]
    pushes: tuple[Push, ...]
    sensed: tuple[Sensed, ...]
    simulation: RobotSimulation = field(repr=False)


class Demonstration:
    """A robot in skins, and an engine for each that senses for it.

    Time is the simulation's. All skins are scanned at once; each cycle lasts as long as the devices say that their
    scans take, and `computing` on top, so that the result does not depend on how fast this machine is.

    Args:
        body: The robot.
        engines: The loops on virtual skins, calibrated, in the order of its patches.
        seed: Chooses the places of the pokes.
        strategy: Reaction of the robot, one of `STRATEGIES`; a stiff robot is for comparison.
        computing: Time for computing in each cycle (s).

    Raises:
        ModelError: If a skin is not virtual, there is no such strategy, or it needs newtons and a skin is uncalibrated.
    """

    def __init__(
        self, body: Body, engines: Sequence[Engine], seed: int = 0, strategy: str = "yield", computing: float = 2e-3
    ) -> None:
        if not all(engine.device.capabilities.virtual for engine in engines) or len(engines) != len(body.patches):
            raise ModelError("the demonstration needs a skin on the device virtual: for each patch")
        self.body, self.engines, self.computing = body, tuple(engines), computing
        self.strategy = strategy_named(strategy, body)
        self.simulation = RobotSimulation(body)
        self._self_touch = SelfTouch(body)
        self._links = {placed.patch.name: placed.patch.frame for placed in body.patches}
        self._random = np.random.default_rng(seed)
        self._offset = np.zeros_like(self.simulation.target)
        self._pressed: list[int] = [0] * len(engines)
        self._elapsed = self._halted = 0.0  # s, of the last cycle; that its own movement stood still
        self._reach: Floats | None = None  # joint positions in place of the robot's own movement

    def pokes(self, count: int, show: Callable[[Moment], None] = lambda _: None) -> Iterator[Encounter]:
        """Poke the robot at random places.

        Args:
            count: How often.
            show: Called with the state after every cycle.
        """
        for _ in range(count):
            yield self._encounter(*self._reachable(), show)

    def hugs(self, count: int, show: Callable[[Moment], None] = lambda _: None) -> Iterator[Hug]:
        """Hug the robot: pads of two arms press as many skins at once, at random places; arguments as for `pokes`."""
        for _ in range(count):
            yield self._hug(show)

    def free(self, seconds: float, show: Callable[[Moment], None] = lambda _: None) -> int:
        """Move untouched for `seconds` (s), `show` as for `pokes`; the number of contacts reported all the same."""
        self.simulation.place_hand(_AWAY, _UP)
        end, found = self.simulation.time + seconds, set[tuple[str, int]]()
        while self.simulation.time < end:
            moment = self._cycle(_AWAY)
            show(moment)
            found |= {(one.contact.patch, one.contact.id) for one in moment.sensed if one.push is None}
        return len(found)

    def self_touches(self, count: int, show: Callable[[Moment], None] = lambda _: None) -> Iterator[SelfTouchTrial]:
        """Let the robot touch itself, in postures found by chance, with no hand near it; arguments as for `pokes`."""
        self.simulation.place_hand(_AWAY, _UP)
        for _ in range(count):
            yield self._touch_itself(way_to_itself(self.simulation, self._random), show)

    def _touch_itself(self, end: Floats, show: Callable[[Moment], None]) -> SelfTouchTrial:
        start, push, peak, pushed, frames, told = self.simulation.target.copy(), 0.0, 0.0, set[int](), 0, 0
        gone, held, seconds = 0.0, 0.0, float(np.abs(end - start).max()) / _REACHING
        names = [placed.patch.name for placed in self.body.patches]
        while gone >= 0:
            if held >= _HOLD:  # and back again
                gone, start = gone - self._elapsed, self._rest()
            elif gone < seconds and push < _FIRM and not held:
                gone += self._elapsed
            else:
                end = end if held else start + (end - start) * gone / seconds  # no further than it has come
                held, seconds = held + self._elapsed, gone
            self._reach = start + min(1.0, gone / seconds) * (end - start)
            moment = self._cycle(_AWAY)
            show(moment)
            push = max((push.force for push in moment.pushes), default=0.0)
            peak, pushed = max(peak, push), pushed | {push.patch for push in moment.pushes}
            own = [one for one in moment.sensed if one.push is not None]
            frames, told = frames + len(own), told + sum(bool(one.contact.self_touch) for one in own)
        self._reach = None
        return SelfTouchTrial(tuple(names[number] for number in sorted(pushed)), peak, frames, told)

    def _reachable(self) -> tuple[int, Floats]:
        """A skin, and a place on it that the finger can come to; by chance."""
        while True:
            patch = int(self._random.integers(len(self.engines)))
            if (place := self._free_place(patch, 0)) is not None:
                return patch, place

    def _free_place(self, patch: int, hand: int) -> Floats | None:
        """A place on a skin by chance; None if it is too close to the rim, or another link is in the hand's way."""
        domain = self.engines[patch].skin.domain
        x0, y0, x1, y1 = domain.bounds
        place = self._random.uniform([x0, y0], [x1, y1])
        radius = self.simulation.hands[hand]
        if domain.depth([place])[0] <= max(_RIM * min(x1 - x0, y1 - y0), radius / 2):
            return None
        robot, link = self.simulation.posed(), self.body.patches[patch].patch.frame
        ways = (above(self.simulation, patch, place, height, radius) for height in np.linspace(0.0, 0.15, 7))
        clear = all(self._self_touch.nearest(robot, way, link)[1] > radius + _FREE for way in ways)
        return place if clear else None

    def _encounter(self, patch: int, aim: Floats, show: Callable[[Moment], None]) -> Encounter:
        hand, felt_on, reacted_at = Hand(self.simulation, 0, patch, aim), "", np.nan
        errors, forces, strangers, own = list[float](), list[tuple[float, float]](), set[tuple[str, int]](), 0
        while not hand.done:
            moment = self._pressed_by([hand], show)
            for one in moment.sensed:
                if not felt_on:  # what was touched at the beginning of a cycle is known at its end
                    felt_on, reacted_at = self._links[one.contact.patch], moment.time + self._elapsed
                if hand.push is not None and one.push is hand.push:
                    errors.append(one.error)
                    own += bool(one.contact.self_touch)
                    if one.contact.force is not None:
                        forces.append((hand.push.force, one.contact.force))
                elif one.push is None and hand.push is not None:
                    strangers.add((one.contact.patch, one.contact.id))
        self._let_go([hand], show)
        reaction, name = reacted_at - hand.touched_at, self.body.patches[patch].patch.name
        told = tuple(errors), tuple(forces), len(strangers), own
        return Encounter(name, self._links[name], hand.where, felt_on, reaction, hand.peak, *told)

    def _hug(self, show: Callable[[Moment], None]) -> Hug:
        hands, errors, forces = list[Hand](), list[float](), list[tuple[float, float]]()
        totals, felt, strangers, reacted_at = list[tuple[float, float]](), set[int](), set[tuple[str, int]](), np.nan
        self.simulation.place_hand(_AWAY, _UP)
        for patch in self._random.permutation(len(self.engines))[:PADS].tolist():
            tried = (self._free_place(patch, 1 + len(hands)) for _ in range(_TRIES))
            if (place := next((place for place in tried if place is not None), None)) is not None:
                hands.append(Hand(self.simulation, 1 + len(hands), patch, place))
        while not all(hand.done for hand in hands):
            moment = self._pressed_by(hands, show)
            pressed = [hand.push for hand in hands if hand.push is not None]
            seen = [one for one in moment.sensed if one.push in pressed]
            if moment.sensed and np.isnan(reacted_at):
                reacted_at = moment.time + self._elapsed
            errors += [one.error for one in seen]
            felt |= {one.patch for one in seen}
            strangers |= {(one.contact.patch, one.contact.id) for one in moment.sensed if one.push is None and pressed}
            told = [(one.push.force, one.contact.force) for one in seen if one.push and one.contact.force is not None]
            forces += told
            if len(told) == len(pressed) > 0:
                true, said = np.sum(told, axis=0)
                totals.append((float(true), float(said)))
        self._let_go(hands, show)
        touched = [hand for hand in hands if np.isfinite(hand.touched_at)]
        names = [placed.patch.name for placed in self.body.patches]
        return Hug(
            tuple(names[hand.patch] for hand in touched),
            tuple(names[patch] for patch in sorted(felt)),
            reacted_at - min((hand.touched_at for hand in touched), default=np.nan),
            tuple(hand.peak for hand in touched),
            *(tuple(errors), tuple(forces), tuple(totals), len(strangers)),
        )

    def _pressed_by(self, hands: Sequence[Hand], show: Callable[[Moment], None]) -> Moment:
        """One cycle in which hands go on."""
        for hand in hands:
            if not hand.done:
                hand.advance(self._elapsed)
        moment = self._cycle(*self._tips(hands))
        for hand in hands:
            hand.update(moment.pushes, moment.time)
        show(moment)
        return moment

    def _let_go(self, hands: Sequence[Hand], show: Callable[[Moment], None]) -> None:
        """Let hands go back, for a pause."""
        end = self.simulation.time + _PAUSE
        while self.simulation.time < end:
            for hand in hands:
                hand.retreat(self._elapsed)
            show(self._cycle(*self._tips(hands)))
        for hand in hands:
            self.simulation.place_hand(_AWAY, _UP, hand.number)

    def _tips(self, hands: Sequence[Hand]) -> list[Floats]:
        """Where the tips of the first hands are to be, those not in use far away."""
        at = {hand.number: hand.point for hand in hands}
        return [at.get(number, _AWAY) for number in range(max(at) + 1)]

    def _cycle(self, *tips: Floats) -> Moment:
        """Move for the time of the last cycle, press what MuJoCo presses, sense, command."""
        if self._elapsed:
            self.simulation.advance(self._elapsed, *tips)
        pushes = self.simulation.pushes()
        touches = tuple(self._sense(number, engine, pushes) for number, engine in enumerate(self.engines))
        sensed = tuple(self._placed(touches, pushes))
        self._elapsed = self.computing + max(self._scanning(*pair) for pair in zip(self.engines, touches, strict=True))
        moment = Moment(self.simulation.time, touches, pushes, sensed, self.simulation)
        self._command(sensed)
        return moment

    def _sense(self, number: int, engine: Engine, pushes: Sequence[Push]) -> Touch:
        """What a skin feels of what presses it."""
        own = [push for push in pushes if push.patch == number]
        foam = engine.skin.contact_layer.foam_spread
        for which in range(max(len(own), self._pressed[number])):
            press = own[which].press(foam) if which < len(own) else Press((0.0, 0.0), 1.0, 0.0)
            engine.press(which, press.position, press.radius, press.pressure)
        self._pressed[number] = len(own)
        if (touch := engine.step()) is None:
            raise ModelError(f"skin {self.body.patches[number].patch.name!r} was lost: {engine.message}; start again")
        return touch

    def _placed(self, touches: Sequence[Touch], pushes: Sequence[Push]) -> Iterator[Sensed]:
        """All contacts as the body reports them: in the world, by the joints as measured, with self-touch."""
        if not any(touch.contacts for touch in touches):
            return  # most of the time
        robot = self.simulation.posed()
        for number, (placed, touch) in enumerate(zip(self.body.patches, touches, strict=True)):
            told = self._self_touch.with_self_touch(robot, in_frame(touch.contacts, placed.skin.chart, placed.patch))
            for on_map, contact in zip(touch.contacts, robot.place(told), strict=True):
                alone = Sensed(number, on_map.position, contact, None)
                near = (replace(alone, push=push) for push in pushes if push.patch == number)
                best = min(near, key=lambda one: one.error, default=alone)
                yield best if best.error < _NEAR else alone

    def _rest(self) -> Floats:
        """Joint positions of the robot's own movement, which may have stood still."""
        return self.simulation.rest(self.simulation.time - self._halted)

    def _scanning(self, engine: Engine, touch: Touch) -> float:
        return sum(engine.device.capabilities.scan_time(frame.pattern) for frame in touch.percept.frames)

    def _command(self, sensed: Sequence[Sensed]) -> None:
        """Answer where others touch, by its strategy; without newtons a place that gives way withdraws."""
        touched = [one for one in sensed if not one.contact.self_touch]
        if self.strategy.returns is not None:
            self._offset *= np.exp(-self._elapsed / self.strategy.returns)
        for one in touched:
            speed = self.strategy.speed(one.contact.force)
            if speed and not self.body.patches[one.patch].patch.newtons:
                speed = _WITHDRAW
            self._offset += self.simulation.inward_step(one.patch, np.array(one.place)) * speed * self._elapsed
        if touched and self.strategy.halts:
            self._halted += self._elapsed
        own = self._rest() if self._reach is None else self._reach
        self.simulation.aim(own + self._offset)


@contextmanager
def engines(body: Body, seed: int = 0, mode: str = "") -> Iterator[tuple[Engine, ...]]:
    """A loop for each patch of a body, calibrated, on a virtual skin that is as described, not as calibrated.

    Args:
        body: The body.
        seed: Seed of the first skin's noise; the others have the next ones.
        mode: Mode of all; each patch's own unless given.

    Raises:
        PatternError: If the mode is not possible on a patch.
    """
    with ExitStack() as stack:
        made = []
        for number, placed in enumerate(body.patches):
            described = replace(placed.skin, calibration=Calibration())

            def opened(described: Skin = described, seed: int = seed + number) -> Any:
                return connect("virtual:", skin=described, seed=seed, realtime=False)

            made.append(stack.enter_context(Engine(opened, placed.skin, mode or placed.mode)))
            made[-1].calibrate()
        yield tuple(made)
