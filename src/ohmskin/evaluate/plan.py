"""Which experiments make up the reproduction: one place that names every position, size, noise level and count."""

from dataclasses import dataclass
from itertools import product
from typing import Self

from ohmskin.errors import OhmskinError
from ohmskin.evaluate import experiments
from ohmskin.evaluate.assumptions import ASSUMPTIONS, assumption
from ohmskin.evaluate.experiments.discrimination import areas
from ohmskin.evaluate.methods import Bench
from ohmskin.evaluate.result import Experiment, Groups, chosen
from ohmskin.evaluate.shapes import SHAPES, Shape
from ohmskin.evaluate.worlds import WORLDS, contact

FIGURES = ("fig3", "fig4", "fig5", "table1", "fig6", "fig7", "fig8", "sweep", "assumptions")

UPPER_LEFT = (0.05, 0.15)  # metres; the paper's upper left position, whose coordinates it does not give
SINGLE = {"upper left": UPPER_LEFT, "centre": (0.10, 0.10), "near the rim": (0.17, 0.10), "lower right": (0.14, 0.05)}
SEVERAL = {
    "two": ((0.05, 0.10), (0.15, 0.10)),
    "three": ((0.05, 0.14), (0.15, 0.14), (0.10, 0.05)),
    "four": ((0.05, 0.05), (0.15, 0.05), (0.05, 0.15), (0.15, 0.15)),
}
DISTANCES = tuple(d / 1000 for d in (*range(60, 30, -5), *range(30, 7, -1)))  # by 5 mm, then by 1 mm
DISTANCES_FEW = (0.06, 0.05, 0.04, 0.03, 0.025, 0.02, 0.017, 0.012)  # with the paper's two
DISTANCES_QUICK = (0.06, 0.05, 0.04, 0.03, 0.025, 0.02, 0.015, 0.01)
_COMPARED = ("16I", "16O", "16O fused")  # in Figs. 7 and 8 under other assumptions
SHAPE_PLACE, SHAPE_RADIUS, SHAPE_PRESSURE = (0.10, 0.10), 0.03, 20e3


@dataclass(frozen=True)
class Settings:
    """Settings of the reproduction.

    Args:
        noise: Noise levels (dB); the first is that of the figures and of Table I, all make the sweep.
        amplitude: Prior amplitudes (relative conductivity change); the first is that of the figures, all make the
            sweep.
        seeds: Noise seeds of every experiment; the single touch of Fig. 5 and Table I, which is cheap, has ten times
            as many.
        fine_noise: Level of the second, quieter run of Fig. 8 (dB).
        distances: Of the two contacts of Fig. 8 (m).
        side: Places along a side of the sheet in Fig. 7, in the sweep and under other assumptions.
        assumptions: Which of `ASSUMPTIONS` to try; a quarter of the seeds each.

    Raises:
        OhmskinError: If a list is empty or a value is out of range.
    """

    noise: tuple[float, ...] = (45.0, 30.0, 35.0, 40.0, 50.0, 55.0, 60.0)
    amplitude: tuple[float, ...] = (0.1, 0.03, 0.3)
    seeds: int = 20
    fine_noise: float = 60.0
    distances: tuple[float, ...] = DISTANCES
    side: int = 9
    assumptions: tuple[str, ...] = tuple(ASSUMPTIONS)

    def __post_init__(self) -> None:
        if not self.noise or any(not 0 <= level <= 200 for level in self.noise):
            raise OhmskinError(f"noise levels are {self.noise}; give one or more of 0 to 200 dB")
        if not self.amplitude or any(not 0 < value <= 100 for value in self.amplitude):
            raise OhmskinError(f"prior amplitudes are {self.amplitude}; give one or more, above 0 and at most 100")
        if not 1 <= self.seeds <= 100_000:
            raise OhmskinError(f"seeds are {self.seeds}; it must be 1 to 100000")

    @classmethod
    def quick(cls) -> Self:
        """Few seeds and levels: what takes a minute or two on two cores."""
        return cls((45.0, 35.0, 55.0), (0.1,), seeds=5, distances=DISTANCES_QUICK, assumptions=())


def plan(settings: Settings, only: tuple[str, ...] = ()) -> Groups:
    """The experiments of each figure by name: ``world``, ``world/area/dB`` or, in the sweep,
    ``what/world/dB/amplitude``, and of the assumptions ``what/world/assumption``; all unless some are named.

    Raises:
        OhmskinError: If a figure is unknown.
    """
    db, s, n = settings.noise[0], settings.amplitude[0], settings.seeds
    found: Groups = {name: {} for name in FIGURES}
    for world in WORLDS:
        single = tuple((contact(world, *place),) for place in SINGLE.values())
        several = tuple(tuple(contact(world, *place) for place in places) for places in SEVERAL.values())
        found["fig3"][world] = experiments.Touches(world, db, s, n, single)
        found["fig4"][world] = experiments.Touches(world, db, s, n, several)
        found["fig5"][world] = experiments.Sections(world, db, s, 10 * n, single[0][0])
        found["table1"][world] = experiments.Merits(world, db, s, 10 * n, single[0][0])
        found["fig7"][world] = experiments.MatchedLocalisation(world, s, n, side=settings.side)
        for level in dict.fromkeys((db, settings.fine_noise)):
            for number, area in enumerate(areas()):
                name = f"{world}/{level:g}/{number}"
                found["fig8"][name] = experiments.Discrimination(world, level, s, n, area, settings.distances)
        for at in product((world,), settings.noise, settings.amplitude):
            where = "{}/{:g}/{:g}".format(*at)
            found["sweep"][f"localisation/{where}"] = experiments.Localisation(*at, n, settings.side)
            found["sweep"][f"merits/{where}"] = experiments.Merits(*at, 10 * n, single[0][0])
    found["assumptions"] = _assumptions(settings)
    shapes = tuple(Shape(kind, SHAPE_PLACE, SHAPE_RADIUS, SHAPE_PRESSURE) for kind in SHAPES)
    found["fig6"]["pressed"] = experiments.PressedShapes(db, s, n, shapes)
    return chosen({name: group for name, group in found.items() if group}, only, "figure")


def _assumptions(settings: Settings) -> dict[str, Experiment]:
    """Table I, Fig. 7 and Fig. 8 (its quieter run, by the dip) under each assumption."""
    found: dict[str, Experiment] = {}
    s, n = settings.amplitude[0], max(settings.seeds // 4, 2)
    for name in settings.assumptions:
        taken = assumption(name)
        level, fine = (taken.decibels or usual for usual in (settings.noise[0], settings.fine_noise))
        for world in taken.worlds:
            at = (world, level, s)
            touch = Bench(*at, assumption=name).usual_contact(*UPPER_LEFT)
            found[f"merits/{world}/{name}"] = experiments.Merits(*at, 10 * n, touch, assumption=name)
            found[f"localisation/{world}/{name}"] = (
                experiments.Localisation(*at, n, settings.side, _COMPARED, assumption=name)
                if taken.decibels
                else experiments.MatchedLocalisation(
                    world, s, n, side=settings.side, step=0.5, methods=_COMPARED, assumption=name
                )
            )
            for number, area in enumerate(areas()):
                found[f"discrimination/{world}/{name}/{number}"] = experiments.Discrimination(
                    world, fine, s, n, area, DISTANCES_FEW, fitted=False, assumption=name
                )
    return found
