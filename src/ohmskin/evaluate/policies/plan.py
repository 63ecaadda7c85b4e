"""Which experiments make up the comparison of policies: one place that names every level, count and distance."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Self

from ohmskin.errors import OhmskinError
from ohmskin.evaluate.flaws import SOUND, Flaw
from ohmskin.evaluate.policies.adaptivity import Gain, Sensitivity
from ohmskin.evaluate.policies.interference import INTERFERENCE, MODES, NONE, WIRE, Drifting, Troubled
from ohmskin.evaluate.policies.pairs import PairDiscrimination, PairLimits
from ohmskin.evaluate.policies.presses import ForceErrors, PressCounts
from ohmskin.evaluate.policies.schemes import INSTRUMENTS
from ohmskin.evaluate.policies.static import Static
from ohmskin.evaluate.policies.tracked import Detection, FrameCost, Moving, Quiet
from ohmskin.evaluate.result import Groups, chosen
from ohmskin.evaluate.worlds import WORLDS

SECTIONS = (
    *("static", "driven", "time", "gain", "moving", "pairs", "press", "sensitivity", "detection", "quiet", "trouble"),
    *("robust", "cost"),
)
"""The parts of the comparison, as `ohmskin policies --only` names them."""

DISTANCES = tuple(d / 1000 for d in (12, 15, 17, 20, 25, 30))
STRENGTHS = (0.5, 1.4)  # of 6 mm discs: the usual contact's change; about the usual contact's whole effect
READ = ("centroid", "fit")  # readers
CORNERS = 20  # places 10 to 18 mm from both sides
DRIVEN = ("fit", "fit, driven")  # without and with the electrodes that carry the current
SCHEMES = ("12B", "16I", "best/16", "16P/16", "best", "16O fused", "16P")
OFF = "electrodes 2 mm off, uneven by 5 %"
TOLD = f"{OFF}, self-calibrated"
POOR = {
    f"contacts of {ohms} ohm, x {since:g}": Flaw(ohms / 3.54, since)
    for ohms, since in ((30, 1.2), (300, 1.2), (300, 0.8))
}
WITH_DRIVEN = {  # flaws; contact impedances, of 3.54 ohm unless said, have changed by a factor since the calibration
    "none": SOUND,
    "contact impedance x 1.2": Flaw(since=1.2),
    "contact impedance x 3": Flaw(since=3.0),
    **POOR,
    OFF: Flaw(misplaced=2e-3, uneven=0.05),
    TOLD: Flaw(misplaced=2e-3, uneven=0.05, calibrated=True),
}
PRESSES = {"light": (5e-3, 850.0), "usual": (8e-3, 20e3), "hard": (25e-3, 20e3)}  # radius (m) and pressure (Pa)
FLAWS = {
    "none": SOUND,
    "contact impedance x 3": Flaw(wear=3.0),
    "contact impedance x 3 since calibration": Flaw(since=3.0),
    "electrodes 2 mm off": Flaw(misplaced=2e-3),
    "conductivity uneven by 5 %": Flaw(uneven=0.05),
    "all three, x 3 throughout": Flaw(wear=3.0, misplaced=2e-3, uneven=0.05),
}


@dataclass(frozen=True)
class Settings:
    """Settings of the comparison.

    Args:
        seeds: Noise seeds.
        side: Places along a side of the lattice of static contacts.
        random: Number of random places in addition.
        levels: Noise levels of static contacts (dB); the first is that of the goals, of moving contacts, of detection,
            and of the gain of adaptive drive with other numbers of injections and contacts.
        noises: Noise levels at which the gain of adaptive drive is measured (dB).
        counts: Injections a frame for which it is measured, in addition to 28.
        frames: Length of a moving contact's path.
        fine: Noise levels of pairs (dB).
        where: Number of places of pairs.
        singles: Single contacts, to measure how often one is reported as two.
        trials: New contacts to detect, per case.
        quiet: Frames without a contact.
        draws: Of random flaws.
        wires: Electrodes that open while the loop runs.
        opened: Noise seeds with which each of them does.
        troubled: Quiet frames under interference.
        drifted: Seeds of drift of single pairs.
        period: Time between frames while single pairs drift (s).
        timed: Frames of which the computing is timed, for each number of contacts.

    Raises:
        OhmskinError: If a count is below one.
    """

    seeds: int = 20
    side: int = 9
    random: int = 19
    levels: tuple[float, ...] = (40.0, 50.0)
    noises: tuple[float, ...] = (30.0, 40.0, 50.0, 60.0)
    counts: tuple[int, ...] = (12, 16, 20, 40)
    frames: int = 60
    fine: tuple[float, ...] = (50.0, 60.0)
    where: int = 12
    singles: int = 1000
    trials: int = 600
    quiet: int = 100_000
    draws: int = 5
    wires: int = 16
    opened: int = 3
    troubled: int = 1000
    drifted: int = 20
    period: float = 0.1
    timed: int = 300

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, int) and value < 1:
                raise OhmskinError(f"{name} is {value}; it must be 1 or more")

    @classmethod
    def quick(cls) -> Self:
        """Smaller settings, which take ten minutes or more on two cores."""
        return cls(
            seeds=5,
            side=5,
            random=15,
            levels=(40.0,),
            noises=(40.0, 50.0),
            counts=(16,),
            frames=40,
            where=4,
            singles=100,
            trials=60,
            quiet=5_000,
            draws=2,
            wires=4,
            opened=1,
            troubled=100,
            drifted=5,
            period=0.5,
            timed=100,
        )


def plan(settings: Settings, only: tuple[str, ...] = ()) -> Groups:
    """The experiments of each section by name.

    Args:
        settings: Seeds, noise levels and counts.
        only: Names of sections; all of `SECTIONS` unless given.

    Raises:
        OhmskinError: If a section is unknown.
    """
    s, level = settings, settings.levels[0]
    found: Groups = {name: {} for name in SECTIONS}
    for world in WORLDS:
        for decibels in s.levels:
            task = Static(world, decibels, s.seeds, SCHEMES, READ, s.side, s.random)
            found["static"][f"{world}/{decibels:g}"] = task
        found["moving"][world] = Moving(world, level, s.seeds, s.frames)
        for others in (0, 1, 2):
            found["detection"][f"{world}/{others}"] = Detection(world, level, s.trials, others)
    for (world, decibels), (name, flaw) in product(
        (("discs", 40.0), ("discs", 50.0), ("pressed", 50.0)), WITH_DRIVEN.items()
    ):
        if world == "pressed" or flaw.since == 1:  # point electrodes have no contact impedance
            for draw, seeds, own in _draws(flaw, s):
                usual = Static(world, decibels, seeds, ("best", "16O fused", "16P"), DRIVEN, s.side, s.random, CORNERS)
                found["driven"][f"{world}/{decibels:g}/{name}/{draw}"] = replace(usual, flaw=own, first=draw * seeds)
    for world in WORLDS:
        cells = [(noise, 28, 1) for noise in sorted({*s.noises, level})]
        cells += [(level, count, 1) for count in s.counts] + [(level, 28, count) for count in (2, 3)]
        for decibels, count, contacts in cells:
            gain = Gain(world, decibels, count, contacts, s.seeds, 2 * s.where)
            found["gain"][f"frames/{world}/{decibels:g}/{count}/{contacts}"] = gain
        for decibels in s.noises:
            found["gain"][f"tracking/{world}/{decibels:g}"] = Moving(
                world, decibels, s.seeds, s.frames, (), (), ("16T/4", "rotating/4", "rotating best/4")
            )
    found["sensitivity"]["twin"] = Sensitivity(50.0, -(-s.seeds // 4), s.side)
    for mode in MODES:
        same = Troubled(mode, (NONE, *INTERFERENCE), s.troubled, s.where)
        found["trouble"][f"troubled/{mode}/interference"] = same
        for seed in range(s.opened):
            wires = tuple(f"{WIRE}{16 * k // s.wires}" for k in range(s.wires))
            found["trouble"][f"troubled/{mode}/wires/{seed}"] = Troubled(mode, wires, seed=seed)
        for seed in range(s.drifted):
            found["trouble"][f"drifting/{mode}/{seed}"] = Drifting(mode, 3.0, seed, s.period)
    blocks = max(1, s.quiet // 12_500)
    for block in range(blocks):  # contacts tracked, and contacts fitted while contact impedances are followed
        fitted = Quiet("pressed", s.levels[-1], s.quiet // blocks, "16P", "fit, driven", block)
        found["quiet"][f"16T/{block}"] = Quiet("discs", level, s.quiet // blocks, seed=block)
        found["quiet"][f"16P/{block}"] = fitted
    for instrument in INSTRUMENTS:
        usual = Static("discs", level, s.seeds, ("12B", "16I", "best", "16O fused", "16P"), READ, s.side, s.random)
        found["time"][instrument] = replace(usual, instrument=instrument)
    for decibels, strength in product(s.fine, STRENGTHS):
        name, keys = f"{decibels:g}/{strength:g}", ("best", "16O fused", "16P")
        discs = (DISTANCES, s.where, strength, keys if strength == STRENGTHS[0] else ("best", "16P"))
        found["pairs"][f"told/{name}"] = PairDiscrimination(decibels, s.seeds, s.singles, *discs)
        found["pairs"][f"limit/{name}"] = PairLimits(decibels, *discs)
    for name, (radius, pressure) in PRESSES.items():
        found["press"][f"felt/{name}"] = PressCounts(50.0, s.seeds, radius, pressure, 2 * s.where)
    for draw in range(s.draws):
        found["press"][f"force/{draw}"] = ForceErrors(50.0, -(-s.where // 2), draw)
    for name, flaw in FLAWS.items():
        for draw, seeds, own in _draws(flaw, s):
            first, side = draw * seeds, min(s.side, 5)
            frames, trackers = ("16I", "best", "16O fused", "16P"), ("16T/4", "rotating/4")
            static = Static("pressed", s.levels[-1], seeds, frames, READ, side, 0, 0, "", own, first)
            moving = Moving("pressed", s.levels[-1], seeds, s.frames, (), (), trackers, own, first)
            found["robust"][f"static/{name}/{draw}"], found["robust"][f"moving/{name}/{draw}"] = static, moving
    found["cost"]["tracker"] = FrameCost(level, frames=s.timed)
    return chosen(found, only, "section")


def _draws(flaw: Flaw, settings: Settings) -> Iterator[tuple[int, int, Flaw]]:
    """Number, noise seeds and flaw of each draw of a flaw; of one that is not random there is one."""
    draws = settings.draws if flaw.misplaced or flaw.uneven else 1
    for draw in range(draws):
        yield draw, -(-settings.seeds // draws), replace(flaw, draw=draw)
