"""Figure 7: where single contacts seem to be, at 81 places."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.evaluate.methods import METHODS, Bench
from ohmskin.evaluate.result import Result

CENTRE = 0.1  # metres; the middle of the sheet, the best guess for a place when nothing is found


@dataclass(frozen=True)
class Localisation(Bench):
    """Single contacts on a lattice over the sheet.

    Args:
        seeds: Number of noise seeds.
        side: Places along one side, in steps of the sheet's width over `side` + 1.
        methods: Which methods.
    """

    seeds: int
    side: int = 9
    methods: tuple[str, ...] = METHODS

    def run(self) -> Result:
        """Results: ``truth`` (n_places, 2) and `View.place`, ``estimate`` (n_methods, n_seeds, n_places, 2) (m)."""
        truth = places(self.side)
        cases = [(self.usual_contact(x, y),) for x, y in truth]
        view = self.read(self.methods, cases, self.seeds, lambda view, _: {"estimate": view.place})
        return {"truth": truth, "estimate": np.ascontiguousarray(view["estimate"].swapaxes(1, 2))}


@dataclass(frozen=True)
class MatchedLocalisation:
    """`Localisation` at the noise level at which one method's mean error has a given value.

    The level is found for that method only: the one at which its mean error is closest to the given value.

    Args:
        world, amplitude, seeds, side, methods, assumption: As for `Localisation`.
        error: The mean error (m).
        by: The method.
        step: Steps of the level (dB).
    """

    world: str
    amplitude: float
    seeds: int
    error: float = 13.01e-3  # metres; the paper's adjacent drive
    by: str = "16I"
    side: int = 9
    step: float = 0.25
    methods: tuple[str, ...] = METHODS
    assumption: str = "stated"

    def run(self) -> Result:
        """Results of `Localisation`, and ``decibels`` () and ``matched`` (), the level and the mean error there (m)."""
        trial = Localisation(
            self.world, 0.0, self.amplitude, self.seeds, self.side, (self.by,), assumption=self.assumption
        )

        @cache
        def mean(level: int) -> float:
            return float(np.mean(errors(replace(trial, decibels=level * self.step).run())))

        low, high = round(10 / self.step), round(80 / self.step)
        while high - low > 1:  # the error falls as the noise does
            middle = (low + high) // 2
            low, high = (middle, high) if mean(middle) > self.error else (low, middle)
        level = min(low, high, key=lambda k: abs(mean(k) - self.error))
        result = replace(trial, decibels=level * self.step, methods=self.methods).run()
        return result | {"decibels": np.array(level * self.step), "matched": np.array(mean(level))}


def places(side: int, width: float = 0.2) -> Floats:
    """Places (side * side, 2) on a lattice over a square sheet (m)."""
    steps = width * np.arange(1, side + 1) / (side + 1)
    return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)


def errors(result: Result, name: str = "estimate") -> Floats:
    """Distances (..., n_places) between an estimate (..., n_places, 2) and the truth in metres.

    Args:
        result: Results of an experiment, with ``truth``.
        name: The name of the estimate.

    Where nothing was found, the estimate is the sheet's centre, the best guess without data.
    """
    estimate = np.where(np.isfinite(result[name]), result[name], CENTRE)
    distance: Floats = np.linalg.norm(estimate - result["truth"], axis=-1)
    return distance
