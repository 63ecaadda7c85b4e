"""Faults while the loop runs - loose wires, interference, drift - and what the loop reports meanwhile.

The product's own loop (`ohmskin.engine.Engine`) on the paper's virtual skin with its own instrument, calibrated as a
user's is.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.device import Capabilities, Device, Feature, PressCommand
from ohmskin.engine import Engine, Touch
from ohmskin.evaluate.policies.tracked import near
from ohmskin.evaluate.result import Result
from ohmskin.scan import DrivePattern, Frame, n_pairs
from ohmskin.skin import Fault, Skin, VirtualSkin

Spoil = Callable[[Frame, np.random.Generator], Frame]
RADIUS, PRESSURE = 8e-3, 20e3  # m and Pa of a press
MODES = "16P", "16T"
NONE, WIRE = "none", "electrode "
_RIM = 15e-3  # m from a press to the rim
_LATE, _HELD, _GONE = 16, 24, 16  # frames of a press that do not count, of all of it, and after it
_SLIDE = 1e-3, 20, 30  # m a frame, frames, and frames in which its end may be noticed
_BETWEEN = 2e-3  # s between frames, in which the loop computes
_COMES, _LEAVES, _ENDS = 30.0, 60.0, 70.0  # s, of a finger
_GRACE = 3  # frames in which a contact may come and go


def _added(volts: Callable[[Frame, np.random.Generator], Floats | float]) -> Spoil:
    return lambda frame, random: replace(frame, voltages=frame.voltages + volts(frame, random))


def _hum(volts: float) -> Spoil:
    return _added(lambda frame, _: volts * float(np.sin(2 * np.pi * 50 * frame.time)))


def _spike(frame: Frame, random: np.random.Generator) -> Floats:
    volts = np.zeros_like(frame.voltages)
    volts[random.integers(len(volts))] = random.choice([-0.1, 0.1]) if random.random() < 0.1 else 0.0
    return volts


INTERFERENCE: dict[str, Spoil] = {
    "50 Hz hum of 1 mV": _hum(1e-3),
    "50 Hz hum of 5 mV": _hum(5e-3),
    "offset of 10 mV": _added(lambda *_: 10e-3),
    "a spike of 0.1 V in one of ten scans": _added(_spike),
    "voltages clip at 0.1 V": lambda frame, _: replace(frame, voltages=np.clip(frame.voltages, -0.1, 0.1)),
}


class FaultyDevice(Device):
    """The paper's virtual skin, with nothing between it and the loop, with faults of its wires and frames.

    Args:
        seed: Of its noise.

    Attributes:
        spoil: What happens to each frame.
        late: What its clock is ahead of the instrument's (s).
    """

    def __init__(self, seed: int) -> None:
        self.virtual, self._random = VirtualSkin(Skin.load("paper"), seed, contacts=4), np.random.default_rng(seed)
        n_elec, can = len(self.virtual.skin.electrodes), Feature.VIRTUAL | Feature.DRIVEN_MEASURED
        super().__init__("bench:", Capabilities("bench", n_elec, 24, 512, features=can))
        self.spoil: Spoil = lambda frame, _: frame
        self.late = 0.0

    @property
    def time(self) -> float:
        """Its clock (s)."""
        return self.virtual.time + self.late

    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        return self.spoil(replace(self.virtual.scan(pattern), time=self.time), self._random)

    def _press(self, press: PressCommand) -> None:
        self.virtual.press(press.number, press.x, press.y, press.radius, press.pressure)

    def _close(self) -> None:
        pass


class LoopUnderTest:
    """The loop on a bench, calibrated.

    Args:
        mode: Name of the mode.
        seed: Of noise and places.
    """

    def __init__(self, mode: str, seed: int) -> None:
        self.bench, self.random = FaultyDevice(seed), np.random.default_rng([seed, 11])
        self.engine = Engine(lambda: self.bench, self.bench.virtual.skin, mode)
        self.engine.calibrate()

    def run(self, frames: int, period: float = _BETWEEN) -> list[Touch]:
        """The next frames; between them the clock goes ahead by a period (s)."""
        seen = []
        for _ in range(frames):
            self.bench.late += period
            if (touch := self.engine.step()) is not None:
                seen.append(touch)
        return seen

    def place(self) -> Floats:
        """A place off the rim (m)."""
        return self.random.uniform(_RIM, 0.2 - _RIM, 2)

    def press(self, at: Floats, pressure: float = PRESSURE) -> None:
        """Press there (m), or lift the press."""
        self.engine.press(0, (float(at[0]), float(at[1])), RADIUS, pressure)

    def error(self, at: Floats) -> float:
        """Press there and lift: the median error (m); infinite unless exactly one contact is shown in each frame."""
        self.press(at)
        seen = self.run(_HELD)[_LATE:]
        self.press(at, 0.0)
        self.run(_GONE)
        ones = [touch.contacts[0].position for touch in seen if len(touch.contacts) == 1]
        return float(np.median([near([one], at) for one in ones])) if ones and len(ones) == len(seen) else np.inf

    def slide(self) -> float:
        """Press, slide and lift: frames until no contact is left; infinite if one stays."""
        (step, frames, patience), at, angle = _SLIDE, self.place(), self.random.uniform(0, 2 * np.pi)
        towards = np.sign(0.1 - at) * np.abs([np.cos(angle), np.sin(angle)])
        for k in range(frames):
            self.press(at + k * step * towards)
            self.run(1)
        self.press(at, 0.0)
        counts = [len(touch.contacts) for touch in self.run(patience)]
        return next((float(k) for k in range(patience) if not any(counts[k:])), np.inf)

    def spoil(self, trouble: str) -> None:
        """Have something go wrong: one of `INTERFERENCE`, ``electrode N`` opens, or ``none``."""
        self.bench.spoil = INTERFERENCE.get(trouble, lambda frame, _: frame)
        wires = [Fault("open", (int(trouble.removeprefix(WIRE)),))] if trouble.startswith(WIRE) else []
        self.bench.virtual.rewire(*wires)


@dataclass(frozen=True)
class Troubled:
    """Something goes wrong, and is mended: quiet frames, presses and slides before, meanwhile and after.

    Args:
        mode: Name of the mode.
        troubles: What goes wrong, one after the other: see `LoopUnderTest.spoil`.
        frames: Quiet frames while it is wrong.
        presses: Presses of 8 mm before, while and after; after it as many slides.
        seed: Of noise and places.
    """

    mode: str
    troubles: tuple[str, ...]
    frames: int = 80
    presses: int = 2
    seed: int = 0

    def run(self) -> Result:
        """Results, of each of the troubles: ``false`` (n_troubles,) quiet frames with a contact; ``named``, seconds
        until it is reported, an open electrode by its number, infinite if it never is; ``well``, seconds from its mend
        until no electrode is left out and nothing is detected; ``sound``, ``away``, ``after`` (n_troubles, n_presses),
        errors before, while and after (m), see `LoopUnderTest.error`; ``gone`` (same), simulate `Loop.slide`, after it.
        """
        loop = LoopUnderTest(self.mode, self.seed)
        with loop.engine:
            loop.run(10)
            rows = [self._through(loop, trouble) for trouble in self.troubles]
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def _through(self, loop: LoopUnderTest, trouble: str) -> dict[str, object]:
        places = [loop.place() for _ in range(self.presses)]
        sound = [loop.error(at) for at in places]
        loop.spoil(trouble)
        begin = loop.bench.time
        seen = loop.run(self.frames)
        told = [touch.percept.frames[-1].time - begin for touch in seen if _named(touch, trouble)]
        away = [loop.error(at) for at in places]
        loop.spoil(NONE)
        begin, well = loop.bench.time, np.inf
        while not np.isfinite(well) and loop.bench.time < begin + 5:
            (touch,) = loop.run(1) or (None,)
            if touch is not None and not touch.percept.diagnosis.bad and not touch.contacts:
                well = loop.bench.time - begin
        after = [loop.error(at) for at in places]
        return {
            "false": sum(bool(touch.contacts) for touch in seen),
            "named": min(told, default=np.inf),
            "well": well,
            "sound": sound,
            "away": away,
            "after": after,
            "gone": [loop.slide() for _ in range(self.presses)],
        }


def _named(touch: Touch, trouble: str) -> bool:
    causes = [finding.cause for finding in touch.percept.findings]
    return ("open", (int(trouble.removeprefix(WIRE)),)) in causes if trouble.startswith(WIRE) else bool(causes)


@dataclass(frozen=True)
class Drifting:
    """Two-terminal resistances drift within a minute, each by itself; after half of it a finger comes, rests, and
    leaves at its end.

    Args:
        mode: Name of the mode.
        times: Standard deviation of the drift in the end, over that of a voltage's noise.
        seed: Of noise, drift and place.
        period: Time between frames (s).
    """

    mode: str
    times: float
    seed: int
    period: float = 0.1

    def run(self) -> Result:
        """Results, without drift and with it: ``ghosts`` (2,) frames with more contacts than fingers, ``lost`` with
        fewer, `_GRACE` frames aside in which one may come and go; ``away``, mean error (m), inf if never detected."""
        rows = [self._under(times) for times in (0.0, self.times)]
        return dict(zip(("ghosts", "lost", "away"), np.array(rows).T, strict=True))

    def _under(self, times: float) -> tuple[int, int, float]:
        loop = LoopUnderTest(self.mode, self.seed)
        with loop.engine:
            skin, start, at = loop.bench.virtual.skin, loop.bench.time, loop.place()
            drift = times * skin.converter.noise * loop.random.standard_normal(n_pairs(len(skin.electrodes)))

            def spoil(frame: Frame, _: np.random.Generator) -> Frame:
                share = min((frame.time - start) / _LEAVES, 1.0) * frame.currents / frame.currents.mean()
                change = frame.pattern.combination(len(skin.electrodes)) @ drift
                return replace(frame, voltages=frame.voltages + share[frame.pattern.measurements[:, 0]] * change)

            loop.bench.spoil = spoil
            before = loop.run(round(_COMES / self.period), self.period)
            loop.press(at)
            there = loop.run(round((_LEAVES - _COMES) / self.period), self.period)
            loop.press(at, 0.0)
            gone = loop.run(round((_ENDS - _LEAVES) / self.period), self.period)
        quiet, counts = before + gone[_GRACE:], [len(touch.contacts) for touch in there[_GRACE:]]
        ghosts = sum(bool(touch.contacts) for touch in quiet) + sum(count > 1 for count in counts)
        off = [near([c.position for c in touch.contacts], at) for touch in there[_GRACE:] if touch.contacts]
        return ghosts, counts.count(0), float(np.mean(off)) if off else np.inf
