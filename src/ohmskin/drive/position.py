"""Policies that choose what to measure next by what is not yet known: from tables, in microseconds, or exactly.

A table holds, for each cell of a grid over the sheet, the injections in the order of a greedy choice for a contact
somewhere in that cell. A frame takes the next ones of that order, so that frames complement each other.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import product
from math import atan2, cos, hypot, sin, sqrt
from typing import Self

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.cache import cached
from ohmskin.drive.bound import ContactPrior, contact_columns, design_inputs, position_goals
from ohmskin.drive.design import Candidates, Search
from ohmskin.drive.drive import Exploration, SecondScan, Target
from ohmskin.drive.patterns import numbers_of, part_of
from ohmskin.errors import PatternError
from ohmskin.forward import ContactTable
from ohmskin.geometry import Electrodes
from ohmskin.scan import DrivePattern

_CELL = 2.5  # radii of a contact: 20 mm for one of 8 mm
_DEPTH = 24  # injections of a table's cell, after which frames start again with the best
_TRACKED = 0.6  # radii to which a tracker knows a contact's place between two frames
_BASED = 2.5  # radii to which it is known before a base scan refines it
_SIZE = 0.3  # of what a radius that is not known counts, against a place: force is told from it
_EFFECT = 0.5  # share to which a tracker knows its effect
Design = Callable[[], tuple[ContactTable, Candidates]]
_CLOSEST = 96  # candidates that may tell of a contact in a cell where only near pairs are driven
_KEPT = 64  # candidates; with them the paper's sheet loses nothing, 32 electrodes 0.1 % of the error


class Ranking:
    """Injections ranked by information about a contact in each cell of a grid over the sheet.

    Args:
        table: Responses of contacts.
        candidates: The injections.
        depth: Number of injections to rank in each cell.
        known: Numbers of the injections that each frame measures in any case.
        prior: Prior of a contact in the cell; that of a tracker unless given.
        cell: Approximate width of a cell (m); 2.5 radii of a contact unless given. A cell takes about 5 ms.
        size: Weight of the error of the radius relative to that of the position (1).

    Attributes:
        order: (n_x, n_y, depth) numbers of injections, best first.
        values: (n_x, n_y, depth + 1) the squared error of position, plus the weighted one of the radius, before and
            after each (m2).

    Raises:
        PatternError: If depth or cell are not positive.
    """

    def __init__(
        self,
        table: ContactTable,
        candidates: Candidates,
        depth: int = _DEPTH,
        known: Sequence[int] = (),
        prior: ContactPrior | None = None,
        cell: float | None = None,
        size: float = 0.0,
    ) -> None:
        cell = _CELL * table.radius if cell is None else cell
        prior = prior or ContactPrior.usual(table.radius, _TRACKED, _EFFECT)
        if depth < 1 or not cell > 0:
            raise PatternError(f"{depth} injections ranked in cells of {cell!r} m; both must be positive")
        goals = np.concatenate([position_goals(1), [[[0.0, 0.0, 0.0, size * table.radius]]]], axis=1)
        low, high = table.places.min(axis=0), table.places.max(axis=0)
        self._shape: list[int] = np.maximum(np.round((high - low) / cell).astype(int), 1).tolist()
        width = (high - low) / self._shape
        self.order: Ints = np.empty((*self._shape, depth), np.int64)
        self.values: Floats = np.empty((*self._shape, depth + 1))
        for at in product(*(range(n) for n in self._shape)):
            middle = low + (np.array(at) + 0.5) * width
            # the contact is somewhere in the cell: four places stand for it, and the choice is good for all of them
            places = middle + 0.25 * width * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]])
            columns = contact_columns(table, prior.at(places))
            near = _near(table, candidates, middle)
            problem = candidates.part(near).problem(columns, prior.covariance(), goals)
            search = Search(*problem, repeats=True)
            for number in np.flatnonzero(np.isin(near, known)):
                search.take(int(number))
            search.chosen.clear()
            chosen, self.values[at] = _ranked(search, depth)
            self.order[at] = near[chosen]
        self._low, self._cell, self._order = low.tolist(), width.tolist(), self.order.tolist()

    @classmethod
    def of(cls, order: Ints, values: Floats, low: Floats, cell: Floats) -> Self:
        """A ranking made before.

        Args:
            order, values: Its attributes.
            low: (2,) lowest corner of its grid (m).
            cell: (2,) width of a cell (m).
        """
        ranking = object.__new__(cls)
        ranking.order, ranking.values, ranking._shape = order, values, list(order.shape[:2])
        ranking._low, ranking._cell, ranking._order = low.tolist(), cell.tolist(), order.tolist()
        return ranking

    def cell_of(self, position: Sequence[float] | Floats) -> tuple[int, int]:
        """The cell of a position (2,) in metres; the closest one for positions off the sheet."""
        x, y = ((float(position[k]) - self._low[k]) / self._cell[k] for k in range(2))
        return min(max(int(x), 0), self._shape[0] - 1), min(max(int(y), 0), self._shape[1] - 1)

    def in_turn(self, positions: Sequence[Sequence[float] | Floats], count: int, turn: int) -> list[int]:
        """The next injections from the rankings of all cells with contacts, in turn; a cell counts once.

        Args:
            positions: (n, 2) of the contacts (m).
            count: How many injections a frame has.
            turn: Number of previous frames with as many injections.
        """
        ranked = [self._order[x][y] for x, y in dict.fromkeys(map(self.cell_of, positions))]
        depth, many = self.order.shape[-1], len(ranked)
        served = range(turn * count, (turn + 1) * count)  # after those that frames before this one have had
        return [ranked[number % many][number // many % depth] for number in served]


def _near(table: ContactTable, candidates: Candidates, place: Floats) -> Ints:
    """The numbers of the candidates closest to a place; of all where all pairs of electrodes are."""
    if table.pairs.whole:
        return np.arange(len(candidates))
    one, other = table.electrodes[candidates.pattern.injections.T]
    away = np.linalg.norm(table.offsets(one + table.offsets(other, one) / 2, place), axis=1)
    return np.sort(np.argsort(away, kind="stable")[:_CLOSEST])


def _ranked(search: Search, depth: int) -> tuple[list[int], Floats]:
    """The greedy choice and its values. After two, which set the directions, only the `_KEPT` best are looked at."""
    first = search.choose(min(2, depth))
    kept = np.sort(np.argsort(search.scores(), kind="stable")[:_KEPT])
    rest = search.among(kept)
    after = rest.choose(depth - len(search.chosen))
    return [*search.chosen, *kept[rest.chosen]], np.append(first, after[1:])


class TrackingDrive(Exploration):
    """A `Drive` of the injections that are most informative about the contacts, and some to explore.

    Args:
        electrodes, injections, drives, period: As `Exploration`.
        design: Gives the responses of contacts and all pairs with their currents and noise (`Candidates` of
            `candidate_pattern(electrodes)`), such as `Skin.design`; called when a contact is first followed.
        explore: Number of a frame's injections that explore, half of them at most. With two of four, 93 % of new
            contacts or more are found within three frames (docs/policies.md).
        exact: Evaluate all candidates for the present belief, for all contacts together with their covariances, in
            about 1 ms. Otherwise contacts take turns with their cell's ranking, in a tenth of that time.

    Raises:
        PatternError: If the counts are out of range. Later, if the candidates are not complete.
    """

    def __init__(
        self,
        electrodes: Electrodes,
        design: Design,
        injections: int = 4,
        explore: int = 2,
        exact: bool = False,
        drives: Ints | None = None,
        period: float = 0.0,
    ) -> None:
        if explore < 1:
            raise PatternError(f"{explore} exploring injections; give at least one, so that new contacts are found")
        super().__init__(electrodes, injections, drives, period)
        self.explore, self.exact, self._design = explore, exact, design

    @cached_property
    def _known(self) -> tuple[ContactTable, Candidates]:
        table, candidates = self._design()
        if candidates.pattern != self.complete:
            raise PatternError("the candidates must be all injections of candidate_pattern(electrodes), in its order")
        return table, candidates

    @cached_property
    def _ranking(self) -> Ranking | None:
        return None if self.exact else _ranking(*self._known, _DEPTH, (), _TRACKED, _EFFECT)

    def next(self, targets: Sequence[Target], turn: int) -> DrivePattern:
        """The pattern of frame number `turn` (from 0), given the belief about contacts, the `targets`.

        Where one more contact may be (of effect 0), every second frame measures only there; the others continue as
        usual, so that a lasting doubt costs half of the frames.
        """
        return part_of(self.complete, self._choose(targets, turn))

    @property
    def _exploring(self) -> int:
        """How many injections of a frame explore while contacts are known."""
        return max(1, min(self.explore, self.injections // 2))

    def _choose(self, targets: Sequence[Target], turn: int) -> Ints | Sequence[int]:
        if not targets:
            return self.numbers(turn, self.injections)
        sought = [target for target in targets if not target.effect]
        if alone := bool(sought) and turn % 2 == 0:
            targets = sought
        explored = self.numbers(turn, 0 if alone else self._exploring)
        wanted = self.injections - len(explored)
        if self._ranking is not None:
            places = [target.position for target in targets]
            return [*explored, *self._ranking.in_turn(places, wanted, 0 if alone else turn)]
        search = self._search(targets)
        for number in explored:
            search.take(int(number))
        for _ in range(wanted):
            search.take(search.best())
        return search.chosen

    def _search(self, targets: Sequence[Target]) -> Search:
        table, candidates = self._known
        prior = ContactPrior.usual(table.radius, _TRACKED, _EFFECT)
        targets = [target if target.effect else replace(target, effect=prior.effect) for target in targets]
        columns = np.hstack(list(contact_columns(table, targets)))
        problem = candidates.problem(columns, prior.covariance(targets), position_goals(len(targets)))
        return Search(*problem, repeats=True)


class PositionDrive(SecondScan):
    """The second scan of mode ``16P``: the pairs most informative about where contacts are, given the base scan.

    Args:
        electrodes, pairs, period: As `SecondScan`; an injection may be chosen more than once.
        design: Gives the responses of contacts and the candidates; called when the first pattern is asked for.
        base: (n, 2) source and sink of the base scan.

    Raises:
        PatternError: If there are no injections.
    """

    repeats = True

    def __init__(self, electrodes: Electrodes, design: Design, pairs: int, base: Ints, period: float = 0.0) -> None:
        super().__init__(electrodes, pairs, period)
        self._design = design
        self._base = numbers_of(self.complete, base)

    @cached_property
    def ranking(self) -> Ranking:
        """The injections for a contact in each cell; made when it is first needed, in about a second."""
        return _ranking(*self._design(), self.pairs, tuple(self._base.tolist()), _BASED, size=_SIZE)

    def next(self, targets: Sequence[Target]) -> DrivePattern:
        """The pattern for all places where `targets` may be: the estimated ones, and one standard deviation around."""
        places = [place for target in targets for place in _sigma_points(target)]
        return part_of(self.complete, self.ranking.in_turn(places, self.pairs, turn=0))

    def choose(self, regions: Sequence[Floats]) -> Ints:
        return np.array(self.ranking.in_turn([anchors.mean(axis=0) for anchors in regions], self.pairs, turn=0))


@lru_cache(maxsize=8)
def _ranking(
    table: ContactTable,
    candidates: Candidates,
    depth: int,
    known: tuple[int, ...],
    position: float,
    effect_spread: float = 1.0,
    size: float = 0.0,
) -> Ranking:
    prior = ContactPrior.usual(table.radius, position, effect_spread)
    given = depth, repr(known), position, effect_spread, size

    def make() -> dict[str, Floats | Ints]:
        made = Ranking(table, candidates, depth, known, prior, size=size)
        return {"order": made.order, "values": made.values, "low": np.array(made._low), "cell": np.array(made._cell)}

    return Ranking.of(**cached("ranking", (*design_inputs(table, candidates), *given), make))


def _sigma_points(target: Target) -> list[tuple[float, float]]:
    """Where a contact is believed to be, and a standard deviation off along both axes of its ellipse (m)."""
    (x, y), ((xx, xy), (_, yy)) = target.position.tolist(), target.covariance.tolist()
    half, middle = hypot((xx - yy) / 2, xy), (xx + yy) / 2
    angle = atan2(xy, (xx - yy) / 2) / 2  # of the long axis
    long, short = sqrt(max(middle + half, 0.0)), sqrt(max(middle - half, 0.0))
    sides = [(-short * sin(angle), short * cos(angle)), (long * cos(angle), long * sin(angle))]
    return [(x, y), *((x + sign * dx, y + sign * dy) for sign in (1, -1) for dx, dy in sides)]
