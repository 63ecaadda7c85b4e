"""Two contacts or one: how often they are told apart, how often one is taken for two, and what no method could do."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from ohmskin.drive import complete_pattern
from ohmskin.evaluate.policies.lab import Lab, lab
from ohmskin.evaluate.policies.likeness import Likeness
from ohmskin.evaluate.policies.schemes import scheme
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.shapes import disc
from ohmskin.evaluate.worlds import CURRENT
from ohmskin.forward import ContactTable
from ohmskin.geometry.domain import Floats
from ohmskin.inverse.discs import effective_change
from ohmskin.scan import Difference, DrivePattern

RADIUS = 6e-3  # metres
ALPHA = 0.01  # rate of false twos
# A disc over a point electrode, where the field is singular, looks like nothing else: two of a hundred single contacts that
# happened to lie there had statistics of thousands, and would have set the threshold for all. They are left out, and it is said.
_CLEAR = 11e-3  # metres from a contact's centre to an electrode
_MARGIN = 15e-3  # metres from a contact's centre to the rim


@dataclass(frozen=True)
class Pairs:
    """Two discs side by side at several distances, and single ones for the threshold and for the rate of false twos.

    A single one is as large as one of the two, or has the area of both, which looks most like them.

    Args:
        decibels: Noise level (dB).
        seeds: Noise seeds of each pair.
        singles: Single contacts, each with one noise seed: so many to set the threshold, twice as many to check it.
        distances: Between the centres (m).
        where: Places, and directions, of the pairs, drawn once.
        strength: Relative conductivity change of each disc (1).
        schemes: Which injections; keys of `schemes.SCHEMES`.
    """

    decibels: float
    seeds: int
    singles: int
    distances: tuple[float, ...]
    where: int = 12
    strength: float = 0.5
    schemes: tuple[str, ...] = ("16O", "16P")

    def run(self) -> Result:
        """Results: ``statistic`` (n_schemes, n_distances, n_where, n_seeds), see `one_or_two`; ``near`` (same), whether each of its
        two discs is closer to its own true contact than half their distance; ``counted`` (same), contacts that
        `Explainer.fit` finds by itself. ``learn`` (n_schemes, n_singles) and ``check`` (n_schemes, 2 n_singles), the
        statistic of single contacts; ``counted_single`` (as ``check``), contacts counted in those.
        """
        room = lab("discs", self.decibels)
        spots = list(pair_places(self.where, max(self.distances), room.skin.electrodes.positions))
        shape = (len(self.schemes), len(self.distances), len(spots), self.seeds)
        statistic, near, counted = np.zeros(shape), np.zeros(shape, bool), np.zeros(shape, int)
        for d, distance in enumerate(self.distances):
            for w, spot in enumerate(spots):
                truth = apart(spot, distance)
                contacts = tuple(disc(place[0], place[1], RADIUS, self.strength) for place in truth)
                for seed in range(self.seeds):
                    for s, key in enumerate(self.schemes):
                        data = scheme(key).gather(room, room.scan(contacts, seed))[1]
                        statistic[s, d, w, seed], found = one_or_two(room, data)
                        near[s, d, w, seed] = told(found, truth)
                        counted[s, d, w, seed] = len(room.explainer.fit(*data).params)
        single = []
        for part, count in enumerate((self.singles, 2 * self.singles)):
            places = single_places(count, part, room.skin.electrodes.positions)
            radii = np.where(np.arange(count) % 2, RADIUS, np.sqrt(2) * RADIUS)
            single.append(np.empty((len(self.schemes), count)))
            taken = np.empty((len(self.schemes), count), int)
            for k, (place, radius) in enumerate(zip(places, radii, strict=True)):
                contacts = (disc(place[0], place[1], radius, self.strength),)
                for s, key in enumerate(self.schemes):
                    data = scheme(key).gather(room, room.scan(contacts, k))[1]
                    single[part][s, k] = one_or_two(room, data)[0]
                    taken[s, k] = len(room.explainer.fit(*data).params)
        return {
            "statistic": statistic,
            "near": near,
            "counted": counted,
            "learn": single[0],
            "check": single[1],
            "counted_single": taken,
        }


def threshold(learn: Floats) -> Floats:
    """What the statistic must exceed for two contacts (n_schemes,), from that of single ones (n_schemes, n_singles).

    For half the rate of false twos that is allowed, because the threshold is known only as well as the data tell.
    """
    return np.asarray(np.quantile(learn, 1 - ALPHA / 2, axis=1, method="higher"))


def one_or_two(room: Lab, data: tuple[Difference, ...]) -> tuple[float, Floats]:
    """The fall of the cost from the best disc to the best two, and where these are (2, 2) in metres."""
    likeness = Likeness.of(room.table, room.noise, data)
    one = likeness.one()
    two = likeness.two(one)
    return one.cost - two.cost, two.positions


@dataclass(frozen=True)
class PairLimits:
    """How far two discs are, in units of the noise, from the single disc that looks most like them.

    If both hypotheses were known in every number, no test could do better than Neyman and Pearson's, whose power at a rate
    `ALPHA` of false twos follows from that distance. Contacts act linearly here, as in `ContactTable`.

    Args:
        decibels, distances, where, strength: As for `Pairs`.
        schemes: Whose injections, chosen without noise.
    """

    decibels: float
    distances: tuple[float, ...]
    where: int = 12
    strength: float = 0.5
    schemes: tuple[str, ...] = ("16O", "16P")
    count: int = 28

    def run(self) -> Result:
        """Results: ``distance`` (n_schemes, n_distances, n_where) in noise units; ``any`` (n_distances, n_where), an upper bound
        on it over all ways to choose `count` different injections; ``all`` (same), with every injection there is.
        """
        room = lab("discs", self.decibels)
        quiet = lab("discs", 200.0)
        spots = list(pair_places(self.where, max(self.distances), room.skin.electrodes.positions))
        shape = (len(self.distances), len(spots))
        found = {"distance": np.empty((len(self.schemes), *shape)), "any": np.empty(shape), "all": np.empty(shape)}
        effect = float(effective_change(np.log1p(self.strength))[0]) * np.pi * RADIUS**2
        complete = complete_pattern(room.electrodes)
        for d, distance in enumerate(self.distances):
            for w, spot in enumerate(spots):
                truth = apart(spot, distance)
                change = effect * room.table(truth, RADIUS).values.sum(axis=0)
                contacts = tuple(disc(place[0], place[1], RADIUS, self.strength) for place in truth)
                for s, key in enumerate(self.schemes):
                    data = scheme(key).gather(quiet, quiet.scan(contacts, 0))[1]
                    rows = (
                        np.vstack([each.pattern.combination(room.table.n_elec).toarray() for each in data]) * CURRENT / room.noise
                    )
                    found["distance"][s, d, w] = np.sqrt((unlike_one(room.table, rows, change, truth, effect) ** 2).sum())
                rows = complete.combination(room.table.n_elec).toarray() * CURRENT / room.noise
                left = unlike_one(room.table, rows, change, truth, effect)
                found["all"][d, w] = np.sqrt((left**2).sum())
                found["any"][d, w] = np.sqrt(best_of(complete, left, self.count))
        return found


def best_of(pattern: DrivePattern, left: Floats, count: int) -> float:
    """The largest sum of squares of what one disc leaves (n_meas,) that so many injections of a pattern can have.

    For any choice of injections the best single disc leaves no more than this one does, so this bounds them all.
    """
    each = np.bincount(pattern.measurements[:, 0], left**2, pattern.n_inj)
    return float(np.sort(each)[-count:].sum())


def unlike_one(table: ContactTable, rows: Floats, change: Floats, truth: Floats, effect: float) -> Floats:
    """What the best single disc, of any size, leaves (n_data,) of data that two cause, in noise units.

    Args:
        table: Responses.
        rows: (n_data, n_pairs) what two-terminal resistances do to the data, in noise units per ohm.
        change: (n_pairs,) that two discs cause (ohm).
        truth: (2, 2) where they are (m).
        effect: That of each (m2).
    """
    likeness = Likeness(table, rows, rows @ change, informed=False)
    between = np.linspace(truth[0], truth[1], 5)  # the best one may be in the middle, or close to one of the two
    starts = [np.array([[*at, np.log(2 * effect), np.log(radius)]]) for at in between for radius in (RADIUS, 2 * RADIUS)]
    one = min((likeness.refine(start) for start in starts), key=lambda discs: discs.cost).params
    return np.asarray(rows @ (change - np.exp(one[0, 2]) * table(one[:, :2], np.exp(one[0, 3])).values[0]))


def ideal_power(distance: Floats, alpha: float = ALPHA) -> Floats:
    """Power of Neyman and Pearson's test between two known means so many noise units apart."""
    return np.asarray(norm.sf(norm.isf(alpha) - distance))


def single_places(count: int, seed: int, electrodes: Floats) -> Floats:
    """Places (count, 2) in metres at random, off the rim and off the electrodes (n_elec, 2)."""
    random = np.random.default_rng([seed, 12])
    found: list[Floats] = []
    while len(found) < count:
        place = random.uniform(_MARGIN, 0.2 - _MARGIN, 2)
        if np.linalg.norm(electrodes - place, axis=1).min() > _CLEAR:
            found.append(place)
    return np.array(found)


def pair_places(count: int, widest: float, electrodes: Floats, seed: int = 2) -> Iterator[Floats]:
    """Middles and directions (x, y, angle) at random; contacts up to `widest` metres apart stay off the rim and the electrodes."""
    random, found = np.random.default_rng(seed), 0
    while found < count:
        spot = np.array([*random.uniform(_MARGIN, 0.2 - _MARGIN, 2), random.uniform(0, np.pi)])
        ends = apart(spot, widest)
        line = np.linspace(ends[0], ends[1], 13)
        clear = np.linalg.norm(electrodes - line[:, None], axis=2).min() > _CLEAR
        if clear and ((ends >= _MARGIN) & (ends <= 0.2 - _MARGIN)).all():
            found += 1
            yield spot


def apart(spot: Floats, distance: float) -> Floats:
    """The two places (2, 2) so far apart (m)."""
    half = distance / 2 * np.array([np.cos(spot[2]), np.sin(spot[2])])
    return np.array([spot[:2] - half, spot[:2] + half])


def told(found: Floats, truth: Floats) -> bool:
    """Whether each true place (2, 2) has one of those found (n, 2) closer than half their distance."""
    half = np.linalg.norm(truth[0] - truth[1]) / 2
    return bool((np.linalg.norm(found[:, None] - truth, axis=2) < half).any(axis=0).all())
