"""When adaptive drive gains: chosen injections against the best fixed set of as many; the lightest touch by place."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from ohmskin.evaluate.experiments.localisation import places as lattice
from ohmskin.evaluate.policies.pairs import READING
from ohmskin.evaluate.policies.schemes import scheme
from ohmskin.evaluate.policies.tracked import MISS, NEAR, apart, near
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.setup import setup
from ohmskin.evaluate.shapes import disc
from ohmskin.evaluate.worlds import contact

PRESSURES = 50.0 * 1.5 ** np.arange(18)  # Pa, 50 Pa to 49 kPa
WAYS = (("16O fused", "centroid"), ("best", READING), ("16P", READING))


@dataclass(frozen=True)
class Gain:
    """One, two or three contacts at random places, read from chosen injections and from the best fixed set.

    Args:
        world, decibels: As for `Static`.
        injections: Of each.
        contacts: How many there are.
        seeds: Noise seeds.
        where: Places of all contacts together.
    """

    world: str
    decibels: float
    injections: int
    contacts: int
    seeds: int
    where: int

    def run(self) -> Result:
        """Results: ``away`` (2, n_seeds, n_where) for ``16P`` and the best fixed set, the mean over the contacts of the
        distance to the closest one reported, `MISS` at most, and where it is not found (m)."""
        world, away = setup(self.world, self.decibels), np.empty((2, self.seeds, self.where))
        for w in range(self.where):
            truth = apart(np.random.default_rng([w, self.contacts, 31]), self.contacts)
            there = tuple(contact(self.world, *place) for place in truth)
            for (s, key), seed in product(enumerate(("16P", "best")), range(self.seeds)):
                seen = world.simulate(scheme(f"{key}/{self.injections}", READING), there, seed)
                found = [c.position for c in seen.contacts]
                away[s, seed, w] = np.mean([min(near(found, place), MISS) for place in truth])
        return {"away": away}


@dataclass(frozen=True)
class Sensitivity:
    """The lightest press that is detected, over the sheet.

    Args:
        decibels: Noise level (dB) on the contact-layer twin.
        seeds: Noise seeds.
        side: Places along a side of the lattice.
        radius: Of the press (m).
    """

    decibels: float
    seeds: int
    side: int = 9
    radius: float = 5e-3

    def run(self) -> Result:
        """Results: ``truth`` (n_places, 2) (m); ``least`` (n_ways, n_seeds, n_places) the pressure (Pa) of `PRESSURES`
        from which on a contact is shown within `NEAR` of the press by each of `WAYS`, infinite where none is."""
        world, truth = setup("pressed", self.decibels), lattice(self.side)
        least = np.full((len(WAYS), self.seeds, len(truth)), np.inf)
        for (p, place), (w, (key, reading)), seed in product(enumerate(truth), enumerate(WAYS), range(self.seeds)):
            mode, low, high = scheme(key, reading), -1, len(PRESSURES)  # felt from high on, as far as is known
            while high - low > 1:
                middle = (low + high) // 2
                there = (disc(place[0], place[1], self.radius, PRESSURES[middle]),)
                felt = near([c.position for c in world.simulate(mode, there, seed).contacts], place) < NEAR
                low, high = (low, middle) if felt else (middle, high)
            if high < len(PRESSURES):
                least[w, seed, p] = PRESSURES[high]
        return {"truth": truth, "least": least}
