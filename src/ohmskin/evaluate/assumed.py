"""Verdicts on Table I, Fig. 7 and Fig. 8 under each assumption that the paper leaves open."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ohmskin.evaluate import paper
from ohmskin.evaluate.assumptions import assumption
from ohmskin.evaluate.claims import ADAPTIVE, FIGURES_OF_MERIT
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.experiments.touches import COLUMNS
from ohmskin.evaluate.methods import METHODS
from ohmskin.evaluate.plan import Settings
from ohmskin.evaluate.resolution import limits
from ohmskin.evaluate.result import Outcome
from ohmskin.evaluate.statistics import ConfidenceInterval, median, ratio_of_means
from ohmskin.evaluate.verdict import NO, OPEN, SURE, YES, above, ladder

MERITS = ("AR", "PE", "SD", "RNG")
"""Whose order, from 12B over 16B and 16I to 16O, the paper's own table has (not RES)."""
_WORST = (NO, OPEN, YES)


@dataclass(frozen=True)
class Assumed:
    """Verdicts under one assumption in one world, for one form of the adaptive drive.

    Args:
        name: Of the assumption.
        world: One of `WORLDS`.
        best: The adaptive drive, of `ADAPTIVE`.
        orders: Verdict on the order of each of `MERITS`, and
        steps: how many of its three steps are confirmed.
        decibels: Noise level of Fig. 7 (dB).
        adjacent, adaptive: Mean localisation errors of 16I and of the adaptive drive (m).
        ratio: The first over the second.
        distances: (2,) from which on 16I and the adaptive drive distinguish two by the dip, infinite if none of
            those tried (m).
        fig8: Verdict on both of them.
    """

    name: str
    world: str
    best: str
    orders: Mapping[str, str]
    steps: Mapping[str, int]
    decibels: float
    adjacent: ConfidenceInterval
    adaptive: ConfidenceInterval
    ratio: ConfidenceInterval
    distances: tuple[float, float]
    fig8: str

    @property
    def title(self) -> str:
        """What is assumed."""
        return assumption(self.name).title

    @property
    def verdicts(self) -> tuple[str, str, str]:
        """On Table I (all of its orders), on Fig. 7 (a ratio as large as the paper's) and on Fig. 8."""
        table = min(self.orders.values(), key=_WORST.index)
        return table, above(self.ratio, paper.RATIO), self.fig8


def assumed(done: Outcome[Settings]) -> list[Assumed]:
    """Verdicts under each assumption that was run."""
    group = done.results.get("assumptions", {})
    runs = [name.split("/")[1:] for name in group if name.startswith("merits/")]
    return [_assumed(done, world, name, best) for world, name in runs for best in ADAPTIVE]


def _assumed(done: Outcome[Settings], world: str, name: str, best: str) -> Assumed:
    results, where = done.results["assumptions"], f"{world}/{name}"
    merits, chain = results[f"merits/{where}"]["modern"], ("12B", "16B", "16I", best)
    orders, steps = dict[str, str](), dict[str, int]()
    for key, lower in ((key, less) for key, _, _, less in FIGURES_OF_MERIT if key in MERITS):
        values = [np.abs(merits[METHODS.index(method), :, COLUMNS.index(key)]) for method in chain]
        orders[key] = ladder(values, lower)[0]
        steps[key] = sum(ladder(pair, lower)[0] == YES for pair in pairwise(values))
    ((_, localisation, located),) = done.of("assumptions", f"localisation/{where}")
    methods, means = localisation.methods, errors(located).mean(axis=2)  # (n_methods, n_seeds)
    ours, theirs = means[methods.index(best)], means[methods.index("16I")]
    pairs = list(done.of("assumptions", f"discrimination/{where}/"))
    task = pairs[0][1]
    found = limits(task.distances, [result for _, _, result in pairs], "dip")
    rows = [task.methods.index("16I"), task.methods.index(best)]
    wanted = np.array(list(paper.DISCRIMINATION.values()))  # 16I, 16O
    sure = float(np.mean((found.resampled[rows] <= wanted[:, None] + 1e-9).all(axis=0)))
    fig8 = NO if not (found.overall[rows] <= wanted + 1e-9).all() else YES if sure >= SURE else OPEN
    distances = float(found.overall[rows[0]]), float(found.overall[rows[1]])
    level = float(located["decibels"]) if "decibels" in located else assumption(name).decibels
    ratio = ratio_of_means(theirs, ours)
    return Assumed(name, world, best, orders, steps, level, median(theirs), median(ours), ratio, distances, fig8)
