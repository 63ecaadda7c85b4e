"""Where single contacts seem to be, and how well that could be known: patterns and estimators apart from each other."""

from dataclasses import dataclass

import numpy as np

from ohmskin.evaluate.experiments.localisation import places
from ohmskin.evaluate.policies.lab import SOUND, Flaw, Lab, lab
from ohmskin.evaluate.policies.schemes import ESTIMATORS, scheme, within
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.worlds import CONTACT_RADIUS, CONTACT_STRENGTH, CURRENT, contact
from ohmskin.geometry.domain import Floats
from ohmskin.inverse.discs import effective_change
from ohmskin.scan import Difference

RADIUS_FACTOR = 1.5  # by which a radius may well differ from the expected one, as `DiscFit` has it


@dataclass(frozen=True)
class Static:
    """Single contacts on a lattice and at random places.

    Args:
        world: One of `worlds.WORLDS`.
        decibels: Noise level (dB).
        seeds: Number of noise seeds.
        schemes: Keys of `schemes.SCHEMES`.
        estimators: Of `schemes.ESTIMATORS`.
        side: Places along a side of the lattice, those of Fig. 7.
        random: Number of random places, drawn once, at least 10 mm from the rim.
        instrument: Where given, all schemes have the time that the paper's has on it; see `schemes.within`.
        flaw: What is wrong with the model or the skin.
        first: Number of the first seed.
    """

    world: str
    decibels: float
    seeds: int
    schemes: tuple[str, ...]
    estimators: tuple[str, ...] = tuple(ESTIMATORS)
    side: int = 9
    random: int = 79
    instrument: str = ""
    flaw: Flaw = SOUND
    first: int = 0

    def run(self) -> Result:
        """Results: ``truth`` (n_places, 2) and ``estimate`` (n_schemes, n_estimators, n_seeds, n_places, 2) in metres, NaN where
        nothing was found; ``bound`` (n_schemes, n_seeds, n_places), see `position_bound`, of the patterns that were driven,
        NaN on the pressed twin, which has no discs; ``injections`` (n_schemes,).
        """
        room, truth = lab(self.world, self.decibels, self.flaw), static_places(self.side, self.random)
        compared = [within(key, self.instrument, room) if self.instrument else scheme(key) for key in self.schemes]
        estimate = np.full((len(compared), len(self.estimators), self.seeds, len(truth), 2), np.nan)
        bound = np.full((len(compared), self.seeds, len(truth)), np.nan)
        for p, place in enumerate(truth):
            contacts = (contact(self.world, *place),)
            for seed in range(self.seeds):
                for s, each in enumerate(compared):
                    image, data = each.gather(room, room.scan(contacts, self.first + seed))
                    for e, name in enumerate(self.estimators):
                        estimate[s, e, seed, p] = ESTIMATORS[name](room, image, data)
                    if self.world == "discs":
                        bound[s, seed, p] = position_bound(room, data, place)
        return {
            "truth": truth,
            "estimate": estimate,
            "bound": bound,
            "injections": np.array([each.injections for each in compared]),
        }


def static_places(side: int, count: int) -> Floats:
    """The lattice of Fig. 7 and `count` random places (side^2 + count, 2) in metres."""
    return np.vstack([places(side) if side else np.empty((0, 2)), np.random.default_rng(81).uniform(0.01, 0.19, (count, 2))])


def position_bound(room: Lab, data: tuple[Difference, ...], place: Floats) -> float:
    """Cramer-Rao bound on the position of the usual disc at a place: root of the summed variance of x and y (m).

    Its effect is unknown; of its radius it is known that it may well be `RADIUS_FACTOR` larger or smaller.
    """
    radius = CONTACT_RADIUS["discs"]
    effect = float(effective_change(np.log1p(CONTACT_STRENGTH["discs"]))[0]) * np.pi * radius**2
    response = room.table(place, radius)
    columns = effect * np.vstack([response.slopes[0], response.values, 2 * radius**2 * response.widening])
    rows = np.vstack([d.pattern.combination(room.table.n_elec) @ columns.T for d in data]) * CURRENT / room.noise
    information = rows.T @ rows
    information[-1, -1] += 1 / np.log(RADIUS_FACTOR) ** 2
    return float(np.sqrt(np.linalg.inv(information)[:2, :2].trace()))
