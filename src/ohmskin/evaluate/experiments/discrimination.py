"""Figure 8: how close two contacts may be and still be distinguished."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ohmskin.evaluate.methods import Bench
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.setup import View
from ohmskin.evaluate.shapes import Shape
from ohmskin.evaluate.two_points import one_or_two, resolved
from ohmskin.evaluate.worlds import Contacts

RADIUS = 5e-3  # metres; two weights 12 mm apart, as in the paper, cannot be much larger
STRENGTH = {"discs": 2.0, "pressed": 12.5e3}  # relative change: 10 mm and +50 % together | pascals: 100 g on this area


@dataclass(frozen=True)
class Area:
    """Where a pair of contacts is centred (x, y) in metres, and the direction from one to the other (radians)."""

    position: tuple[float, float]
    angle: float

    def pair(self, distance: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """The two places, `distance` metres apart."""
        (x, y), dx, dy = self.position, distance / 2 * np.cos(self.angle), distance / 2 * np.sin(self.angle)
        return (float(x - dx), float(y - dy)), (float(x + dx), float(y + dy))


def areas(count: int = 3, seed: int = 2022, width: float = 0.2, margin: float = 0.015) -> tuple[Area, ...]:
    """Areas drawn at random, once, such that contacts 60 mm apart are at least `margin` metres from the rim."""
    random = np.random.default_rng(seed)
    found: list[Area] = []
    while len(found) < count:
        x, y = random.uniform(margin, width - margin, 2)
        area = Area((round(float(x), 4), round(float(y), 4)), round(float(random.uniform(0, np.pi)), 4))
        if all(margin <= value <= width - margin for place in area.pair(60e-3) for value in place):
            found.append(area)
    return tuple(found)


@dataclass(frozen=True)
class Discrimination(Bench):
    """Two contacts at falling distances in one area, and single contacts there for the rate of false twos.

    Args:
        seeds: Number of noise seeds.
        area: The area, one of `Area`.
        methods: Which methods.
        distances: Between the two contacts (m).
        fitted: Whether one and two contacts are fitted, too, or only the dip is evaluated.
    """

    seeds: int
    area: Area
    distances: tuple[float, ...]
    methods: tuple[str, ...] = ("16I", "16O", "16O fused")
    fitted: bool = True

    def run(self) -> Result:
        """Results, for pairs (n_methods, n_distances, n_seeds) and, with prefix ``single_``, for single ones
        (n_methods, 4, n_seeds), two in the middle and one 15 mm either way: ``dip``, whether the image has two
        contacts, parted by a dip, each closer to its own true contact than half their distance (for singles: whether
        there is more than one contact at all); ``statistic``, how much better two fitted contacts explain the data than
        one (`one_or_two`); ``near``, whether the two are each closer to its own true contact than half their distance;
        ``chi_square``, the residual of the fit with the true number of contacts, over its degrees of freedom. The last
        three only if contacts are `fitted`.
        """
        middle, (left, right) = self.area.position, self.area.pair(30e-3)
        singles = ((middle, 1.0), (middle, 2.0), (left, 1.0), (right, 1.0))  # with the strength of one and of two
        cases = [tuple(self._press(at) for at in self.area.pair(d)) for d in self.distances]
        rates = _rates if self.fitted else _dip
        pairs = self.read(self.methods, cases, self.seeds, rates)
        alone = self.read(self.methods, [(self._press(*single),) for single in singles], self.seeds, rates)
        return pairs | {f"single_{name}": array for name, array in alone.items()}

    def _press(self, at: tuple[float, float], times: float = 1.0) -> Shape:
        return self.usual_contact(*at, RADIUS, STRENGTH[self.world], times)


def _dip(view: View, contacts: Contacts) -> dict[str, Any]:
    truth, places = ([contact.position for contact in each] for each in (contacts, view.contacts))
    return {"dip": len(places) > 1 if len(truth) == 1 else resolved(places, truth)}


def _rates(view: View, contacts: Contacts) -> dict[str, Any]:
    truth = [contact.position for contact in contacts]
    statistic, one, two = one_or_two(view.setup.trusting_fitter, *view.differences)
    caused = (one if len(truth) == 1 else two).caused
    left = np.concatenate([d.volts - d.caused_by(caused) for d in view.differences]) / view.setup.noise
    return _dip(view, contacts) | {
        "statistic": statistic,
        "near": len(truth) == 2 and resolved(two.params[:, :2], truth),
        "chi_square": left @ left / (len(left) - 4 * len(truth)),
    }
