"""Where single contacts seem to be, and how well that could be known: patterns and estimators apart from each other."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.drive import ContactPrior, position_bound
from ohmskin.evaluate.experiments.localisation import places
from ohmskin.evaluate.flaws import SOUND, Flaw
from ohmskin.evaluate.policies.schemes import scheme, within
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.setup import Setup, setup
from ohmskin.evaluate.worlds import CONTACT_RADIUS, CONTACT_STRENGTH, CURRENT, contact
from ohmskin.forward.response import effective_change
from ohmskin.scan import Difference

RADIUS_FACTOR = 1.5  # by which a radius may well differ from the expected one, whose usual value is known


@dataclass(frozen=True)
class Static:
    """Single contacts on a lattice and at random places.

    Args:
        world: One of `worlds.WORLDS`.
        decibels: Noise level (dB).
        seeds: Number of noise seeds.
        schemes: Keys, see `schemes.scheme`.
        readers: As for `schemes.scheme`.
        side: Places along a side of the lattice, those of Fig. 7.
        random: Number of random places, drawn once, at least 10 mm from the rim.
        corners: Number of additional places in the corners, 10 to 18 mm from both sides.
        instrument: If given, all schemes have the time that the paper's takes on it; see `schemes.within`.
        flaw: Errors of the model or changes of the skin.
        first: Number of the first seed.
    """

    world: str
    decibels: float
    seeds: int
    schemes: tuple[str, ...]
    readers: tuple[str, ...] = ("centroid", "fit")
    side: int = 9
    random: int = 79
    corners: int = 0
    instrument: str = ""
    flaw: Flaw = SOUND
    first: int = 0

    def run(self) -> Result:
        """Results: ``truth`` (n_places, 2) and ``estimate`` (n_schemes, n_readers, n_seeds, n_places, 2) in metres,
        NaN where nothing was found; ``bound`` (n_schemes, n_seeds, n_places), simulate `bound_of`, of the patterns
        that were driven for the last reader, NaN on the pressed twin, which has no discs; ``injections`` (n_schemes,);
        ``stated`` (n_schemes, n_readers, n_seeds, n_places), the root of the stated variance of x and y together (m),
        and ``nees`` (same), the squared error over the stated covariance; NaN where a reader states none.
        """
        where = setup(self.world, self.decibels, flaw=self.flaw)
        truth = static_places(self.side, self.random, self.corners)
        compared = [within(key, self.instrument, where) if self.instrument else scheme(key) for key in self.schemes]
        ways = [scheme(self.schemes[0], reading) for reading in self.readers]
        estimate = np.full((len(compared), len(self.readers), self.seeds, len(truth), 2), np.nan)
        stated, nees = np.full((2, *estimate.shape[:-1]), np.nan)
        bound = np.full((len(compared), self.seeds, len(truth)), np.nan)
        for p, place in enumerate(truth):
            contacts = (contact(self.world, *place),)
            for seed, (s, each) in product(range(self.seeds), enumerate(compared)):
                for e, way in enumerate(ways):
                    mode = replace(each, reader=way.reader, driven=way.driven)
                    seen = where.simulate(mode, contacts, self.first + seed)
                    estimate[s, e, seed, p] = seen.strongest
                    if seen.contacts and seen.contacts[0].covariance is not None:
                        covariance, off = np.array(seen.contacts[0].covariance), seen.strongest - place
                        stated[s, e, seed, p] = np.sqrt(np.trace(covariance))
                        nees[s, e, seed, p] = off @ np.linalg.solve(covariance, off)
                if self.world == "discs":
                    bound[s, seed, p] = bound_of(where, seen.differences, place)
        injections = np.array([each.injections for each in compared])
        found = {"truth": truth, "estimate": estimate, "bound": bound, "injections": injections}
        return found | {"stated": stated, "nees": nees}


def static_places(side: int, count: int, corners: int = 0) -> Floats:
    """The lattice of Fig. 7, `count` random places, and `corners` in the corners (side^2 + count + corners, 2) (m)."""
    inside = np.random.default_rng(5).uniform(0.010, 0.018, (corners, 2))
    far = np.resize([[0.0, 0.0], [0.2, 0.0], [0.0, 0.2], [0.2, 0.2]], (corners, 2))
    return np.vstack([places(side), np.random.default_rng(81).uniform(0.01, 0.19, (count, 2)), np.abs(far - inside)])


def bound_of(setup: Setup, data: tuple[Difference, ...], place: Floats) -> float:
    """Cramer-Rao bound on the position of the usual disc at a place from given scans: root of the summed variance of x
    and y (m).

    Its effect is unknown; of its radius it is known that it may well be `RADIUS_FACTOR` larger or smaller.
    """
    radius, patterns = CONTACT_RADIUS["discs"], [each.pattern for each in data]
    effect = float(effective_change(np.log1p(CONTACT_STRENGTH["discs"]))[0]) * np.pi * radius**2
    prior = ContactPrior(effect, radius, position=1e3, effect_spread=1e6, radius_spread=float(np.log(RADIUS_FACTOR)))
    return float(position_bound(setup.table, place, lambda _: patterns, setup.noise, CURRENT, prior)[0])
