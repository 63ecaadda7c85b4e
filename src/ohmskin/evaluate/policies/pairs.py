"""Two contacts or one: how often they are distinguished, how often one is taken for two, and what none could do."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, product, repeat

import numpy as np
from scipy.stats import norm

from ohmskin.arrays import Floats
from ohmskin.contacts import ContactFitter
from ohmskin.drive import complete_pattern
from ohmskin.evaluate.policies.schemes import scheme
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.setup import Setup, setup
from ohmskin.evaluate.shapes import disc
from ohmskin.evaluate.two_points import resolved
from ohmskin.evaluate.worlds import CURRENT, Contacts
from ohmskin.forward.response import effective_change
from ohmskin.scan import Difference, DrivePattern

RADIUS = 6e-3  # metres
ALPHA = 0.01  # rate of false twos
# A disc over a point electrode, where the field is singular, looks like nothing else: two of a hundred single contacts
# that happened to lie there had statistics of thousands. They are left out, and it is said.
_CLEAR = 11e-3  # metres from a contact's centre to an electrode
_MARGIN = 15e-3  # metres from a contact's centre to the rim
READING = "fit, driven"  # electrodes that carry the current are measured, too
_EXACT = 1e-2  # share of the noise to which an oracle's disc is fitted


@dataclass(frozen=True)
class PairDiscrimination:
    """Two discs side by side at several distances, and single ones for the rate of false twos.

    A single one is as large as one of the two, or has the area of both, which resembles them most.

    Args:
        decibels: Noise level (dB).
        seeds: Noise seeds of each pair.
        singles: Single contacts, each with one noise seed.
        distances: Between the centres (m).
        where: Number of places, and directions, of the pairs, drawn once.
        strength: Relative conductivity change of each disc (1).
        schemes: The injections; keys, see `schemes.scheme`.
    """

    decibels: float
    seeds: int
    singles: int
    distances: tuple[float, ...]
    where: int = 12
    strength: float = 0.5
    schemes: tuple[str, ...] = ("16O fused", "16P")

    def run(self) -> Result:
        """Results: ``right`` (n_schemes, n_distances, n_where, n_seeds), whether the reader finds two contacts, each
        closer to its own true one than half their distance; ``counted`` (n_schemes, n_singles), contacts found where
        there is one.
        """
        where = setup("discs", self.decibels)
        right = np.zeros((len(self.schemes), len(self.distances), self.where, self.seeds), bool)
        for d, w, truth, contacts in _pairs(self, where):
            for seed, (s, key) in product(range(self.seeds), enumerate(self.schemes)):
                seen = where.simulate(scheme(key, READING), contacts, seed).contacts
                right[s, d, w, seed] = len(seen) == 2 and resolved([one.position for one in seen], truth)
        places = single_places(self.singles, 1, where.electrodes.positions)
        counted = np.empty((len(self.schemes), len(places)), int)
        for (k, (x, y)), (s, key) in product(enumerate(places), enumerate(self.schemes)):
            contacts = (disc(x, y, RADIUS if k % 2 else np.sqrt(2) * RADIUS, self.strength),)
            counted[s, k] = len(where.simulate(scheme(key, READING), contacts, k).contacts)
        return {"right": right, "counted": counted}


@dataclass(frozen=True)
class PairLimits:
    """Distance of two discs, in units of the noise, from the single disc that resembles them most.

    If all parameters of
    both hypotheses were known, no test could be better than Neyman and Pearson's, whose power at a rate `ALPHA` of
    false twos follows from that distance. Contacts act linearly here, as in `ContactTable`.

    Args:
        decibels, distances, where, strength: As for `PairDiscrimination`.
        schemes: The injections, chosen without noise.
        count: Number of injections of the best set of all.
    """

    decibels: float
    distances: tuple[float, ...]
    where: int = 12
    strength: float = 0.5
    schemes: tuple[str, ...] = ("16O fused", "16P")
    count: int = 28

    def run(self) -> Result:
        """Results: ``distance`` (n_schemes, n_distances, n_where) in noise units; ``uncertain`` (same) if contact
        impedances may have changed as the reader allows for; ``any`` (n_distances, n_where), an upper bound on the
        distance over all ways to choose `count` different injections; ``all`` (same), with every injection there is.
        """
        where, quiet = setup("discs", self.decibels), setup("discs", 200.0)
        shape = (len(self.distances), self.where)
        found = {"any": np.empty(shape), "all": np.empty(shape)}
        found |= {name: np.empty((len(self.schemes), *shape)) for name in ("distance", "uncertain")}
        effect = float(effective_change(np.log1p(self.strength))[0]) * np.pi * RADIUS**2
        complete = complete_pattern(where.electrodes).with_driven
        for d, w, truth, contacts in _pairs(self, where):
            for s, key in enumerate(self.schemes):
                sensor = where.sensor(scheme(key, READING))
                _, seen = sensor.step(sensor.start(), quiet.scan(contacts, 0))
                patterns, errors = [frame.pattern for frame in seen.frames], sensor.known.contact_changes
                found["distance"][s, d, w] = unlike_one(where, patterns, truth, effect)[1]
                found["uncertain"][s, d, w] = unlike_one(where, patterns, truth, effect, errors)[1]
            left, _ = unlike_one(where, [complete], truth, effect)
            found["all"][d, w], found["any"][d, w] = np.linalg.norm(left), np.sqrt(best_of(complete, left, self.count))
        return found


def _pairs(task: PairDiscrimination | PairLimits, where: Setup) -> Iterator[tuple[int, int, Floats, Contacts]]:
    """Number of the distance and of the place, the two places (2, 2), and the discs there, of all pairs."""
    spots = list(pair_places(task.where, max(task.distances), where.electrodes.positions))
    for (d, distance), (w, spot) in product(enumerate(task.distances), enumerate(spots)):
        truth = apart(spot, distance)
        yield d, w, truth, tuple(disc(x, y, RADIUS, task.strength) for x, y in truth)


def best_of(pattern: DrivePattern, left: Floats, count: int) -> float:
    """The largest sum of squares of what one disc leaves (n_meas,) that so many injections of a pattern can have.

    For any choice of injections the best single disc leaves no more than this one does, so this bounds them all.
    """
    each = np.bincount(pattern.measurements[:, 0], left**2, pattern.n_inj)
    return float(np.sort(each)[-count:].sum())


def unlike_one(
    where: Setup, patterns: Sequence[DrivePattern], truth: Floats, effect: float, errors: Floats | None = None
) -> tuple[Floats, float]:
    """What the best single disc, of any size, leaves (n_meas,) of scans of two discs without noise, in noise units; and
    how large that is beside what contact impedances may do.

    Args:
        where: Responses, and the noise.
        patterns: The scans.
        truth: (2, 2) where the discs are (m).
        effect: That of each (m2).
        errors: (n_pairs, n_elec) change of two-terminal resistances with a standard deviation of each contact
            impedance (ohm); None: they are known.
    """
    change = effect * where.table(truth, RADIUS).values.sum(axis=0)
    volts = [CURRENT * pattern.combination(where.table.n_elec) @ change for pattern in patterns]
    scans = [Difference(p, np.full(p.n_meas, CURRENT), v) for p, v in zip(patterns, volts, strict=True)]
    may = None if errors is None else _EXACT * errors
    fitter = ContactFitter(where.table, _EXACT * where.noise, model_error=0.0, contacts=may)
    unknown = np.zeros(4)
    resolved, _ = fitter.information(*scans)
    between = np.linspace(truth[0], truth[1], 5)  # the best one may be in the middle, or close to one of the two
    starts = [np.array([[*at, 2 * effect, radius**2]]) for at in between for radius in (RADIUS, 2 * RADIUS)]
    found = [fitter.refine(resolved, start, unknown, np.diag(unknown), rounds=40) for start in starts]
    best = min(found, key=lambda one: one.cost)
    left = np.concatenate([scan.volts - scan.caused_by(best.caused) for scan in scans]) / where.noise
    return left, _EXACT * float(np.sqrt(max(best.cost, 0.0)))


def ideal_power(distance: Floats) -> Floats:
    """Power of Neyman and Pearson's test between two known means so many noise units apart."""
    return np.asarray(norm.sf(norm.isf(ALPHA) - distance))


def single_places(count: int, seed: int, electrodes: Floats) -> Floats:
    """Places (count, 2) in metres at random, off the rim and off the electrodes (n_elec, 2)."""
    random = np.random.default_rng([seed, 12])
    drawn = (random.uniform(_MARGIN, 0.2 - _MARGIN, 2) for _ in repeat(None))
    return np.array(list(islice((at for at in drawn if np.linalg.norm(electrodes - at, axis=1).min() > _CLEAR), count)))


def pair_places(count: int, widest: float, electrodes: Floats) -> Iterator[Floats]:
    """Random middles and directions (x, y, angle); contacts up to `widest` (m) apart stay off rim and electrodes."""
    random, found = np.random.default_rng(2), 0
    while found < count:
        spot = np.array([*random.uniform(_MARGIN, 0.2 - _MARGIN, 2), random.uniform(0, np.pi)])
        ends = apart(spot, widest)
        away = np.linalg.norm(electrodes - np.linspace(ends[0], ends[1], 13)[:, None], axis=2)
        if away.min() > _CLEAR and ((ends >= _MARGIN) & (ends <= 0.2 - _MARGIN)).all():
            found += 1
            yield spot


def apart(spot: Floats, distance: float) -> Floats:
    """The two places (2, 2) so far apart (m)."""
    half = distance / 2 * np.array([np.cos(spot[2]), np.sin(spot[2])])
    return np.array([spot[:2] - half, spot[:2] + half])
