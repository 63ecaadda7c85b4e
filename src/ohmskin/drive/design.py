"""Optimal design: which injections, of all that can be driven, say most about what is not yet known.

What is not known is a state of d numbers with a covariance P: the modes of an image, or position, effect and size of
contacts. An injection k measures H_k state + white noise of variance one, H_k (m, d). Knowing it takes

    P H_k^T (I + H_k P H_k^T)^-1 H_k P

off the covariance: m x m matrices, and an update of rank m after each choice. Two criteria serve all ends.

    A-optimal: the summed variance of `goal @ state`, such as a region's pixels. If the state is contacts and the goal
    their coordinates, it is the bound of Cramer and Rao on the squared error of position (with the prior: of van
    Trees). D-optimal: the information 1/2 log det(I + H P H^T), in nats.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy.sparse as sp
from numba import njit
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from ohmskin.arrays import Floats, Ints
from ohmskin.drive.patterns import part_of
from ohmskin.errors import ModelError, PatternError
from ohmskin.forward import TransferModel, VoltageSource
from ohmskin.scan import DrivePattern, Pairs
from ohmskin.scan.pairs import in_series

CURRENT = 1e-3  # amperes, where nothing else is said


@dataclass(frozen=True, eq=False)
class Candidates:
    """Injections to choose from, and the sensitivity of their voltages in units of the noise.

    Args:
        pattern: The injections, all with equally many measurements.
        pairs: The pairs of electrodes.
        weights: (n_meas, n_pairs) change of each voltage with the two-terminal resistances, over its noise (1/ohm);
            uncertainty of contact impedances counts as noise that is independent in each injection.
        sharp: The same with the noise of voltages alone, and the uncertainty of each contact impedance (ohm), which is
            the same in all injections. None if contact impedances are known, or driven electrodes are not measured.
    """

    pattern: DrivePattern
    pairs: Pairs
    weights: sp.csr_array
    sharp: tuple[sp.csr_array, float] | None = None

    @classmethod
    def at_currents(
        cls,
        pattern: DrivePattern,
        pairs: Pairs | int,
        noise: float,
        currents: ArrayLike = CURRENT,
        contacts: float | None = None,
    ) -> Self:
        """Candidates whose currents are given or measured.

        Args:
            pattern: The injections.
            pairs: Of electrodes; all of so many.
            noise: Standard deviation of a voltage (V).
            currents: One value, or one for each of the pairs (n_pairs,) in amperes: see `pair_currents`.
            contacts: Standard deviation of a contact impedance (ohm), where driven electrodes are measured, too
                (`DrivePattern.with_driven`); None: they are not.

        Raises:
            ModelError: If noise or currents are not positive, or the currents do not fit.
        """
        measured, pairs = pattern if contacts is None else pattern.with_driven, Pairs.all(pairs)
        sharp = (whitened(measured, pairs, noise, currents), contacts) if contacts else None
        return cls(pattern, pairs, whitened(measured, pairs, noise, currents, contacts or 0.0), sharp)

    def __len__(self) -> int:
        return self.pattern.n_inj

    def part(self, numbers: Ints) -> "Candidates":
        """The candidates of these `numbers` (n,), in their order."""
        if len(numbers) == len(self):
            return self
        pattern = part_of(self.pattern, numbers)

        def of(weights: sp.csr_array) -> sp.csr_array:
            per_injection = weights.shape[0] // len(self)
            return weights[(numbers[:, None] * per_injection + np.arange(per_injection)).ravel()]

        sharp = None if self.sharp is None else (of(self.sharp[0]), self.sharp[1])
        return Candidates(pattern, self.pairs, of(self.weights), sharp)

    def rows(self, columns: Floats) -> Floats:
        """H (..., n, min(m, d), d) of a state that changes the resistances by `columns` (..., n_pairs, d) (ohm).

        More rows than unknowns are reduced to as many, with the same information.
        """
        rows = self._whitened(columns)
        return rows if rows.shape[-2] <= columns.shape[-1] else np.asarray(np.linalg.qr(rows, mode="r"))

    def problem(self, columns: Floats, covariance: Floats, goal: Floats) -> tuple[Floats, Floats, Floats, Ints | None]:
        """Rows, covariance, goal and columns of a `Search` whose state includes the uncertainty of contact impedances.

        Args:
            columns: (..., n_pairs, d) as for `rows`.
            covariance: (d, d) of that state.
            goal: (..., k, d) as for `Search`.
        """
        if self.sharp is None:
            return self.rows(columns), covariance, goal, None
        weights, contacts = self.sharp
        driven, ends = np.unique(self.pattern.injections, return_inverse=True)
        d, n_elec, ends = covariance.shape[-1], len(driven), ends.reshape(-1, 2)
        own = replace(self, weights=weights)._whitened(columns)
        series = (weights @ (contacts * in_series(driven.tolist(), self.pairs))).reshape(len(self), -1, n_elec)
        series = np.take_along_axis(series, ends[:, None], axis=2)  # others are not in their voltages
        rows = np.concatenate([own, np.broadcast_to(series, (*own.shape[:-1], 2))], axis=-1)
        rows = rows if rows.shape[-2] <= d + 2 else np.asarray(np.linalg.qr(rows, mode="r"))
        padded = np.concatenate([goal, np.zeros((*goal.shape[:-1], n_elec))], axis=-1)
        seen = np.hstack([np.broadcast_to(np.arange(d), (len(self), d)), d + ends])
        return rows, np.asarray(block_diag(covariance, np.eye(n_elec))), padded, seen

    def _whitened(self, columns: Floats) -> Floats:
        """What the voltages (..., n, m, d) of each injection see of a state's columns (..., n_pairs, d)."""
        lead, d = columns.shape[:-2], columns.shape[-1]
        flat = np.moveaxis(columns, -2, 0).reshape(columns.shape[-2], -1)
        seen = np.moveaxis((self.weights @ flat).reshape(-1, *lead, d), 0, -2)
        return np.asarray(seen.reshape(*lead, len(self), -1, d))


def whitened(
    pattern: DrivePattern, pairs: Pairs | int, noise: float, currents: ArrayLike = CURRENT, contacts: float = 0.0
) -> sp.csr_array:
    """A pattern's voltages over their noise, by pairs (n_meas, n_pairs); arguments as `Candidates.at_currents`."""
    given, pairs = np.asarray(currents, float), Pairs.all(pairs)
    if given.shape not in ((), (len(pairs),)) or not (np.isfinite(given) & (given > 0)).all():
        allowed = f"give one value or one for each of {len(pairs)} electrode pairs, all positive"
        raise ModelError(f"currents of shape {given.shape}, least {given.min(initial=np.inf):.3g} A; {allowed}")
    if not (np.isfinite(noise) and noise > 0):
        raise ModelError(f"noise is {noise!r}; it must be finite and positive")
    pattern.check(pairs.n_elec)
    source, sink, _, _ = pattern.quadruples.T
    amperes = np.broadcast_to(given, len(pairs))[pairs.index(source, sink)]
    noises = np.hypot(noise, np.where(pattern.driven, amperes * contacts, 0.0))
    return sp.csr_array(sp.diags_array(amperes / noises) @ pattern.combination(pairs))


@dataclass(frozen=True, eq=False)
class Selection:
    """Injections in the order of the choice.

    Args:
        chosen: (count,) their numbers.
        values: (count + 1,) the criterion before and after: summed variance, or information (nats), mean over cases.
    """

    chosen: Ints
    values: Floats


class Search:
    """A covariance, its reduction by each candidate, and the candidates chosen so far.

    Args:
        rows: (n, m, w), or (n_cases, n, m, w): cases are alternatives, such as places, over which means are taken.
        covariance: (d, d) or (n_cases, d, d) before.
        goal: (k, d): the sum of the variances of goal @ state is minimised; (n_goals, k, d): several such sums.
            None: the information is maximised.
        columns: (n, w) entries of the state on which each candidate's rows depend; all d unless given.
        repeats: Whether an injection may be chosen again, which averages noise.

    Attributes:
        covariance: (n_cases, d, d) now.
        chosen: Numbers so far.
    """

    def __init__(
        self,
        rows: Floats,
        covariance: Floats,
        goal: Floats | None = None,
        columns: Ints | None = None,
        repeats: bool = False,
    ) -> None:
        self._rows = np.ascontiguousarray(rows if rows.ndim == 4 else rows[None])
        _, n, _, width = self._rows.shape
        columns = np.arange(width) if columns is None else columns
        self._columns: Ints = np.array(np.broadcast_to(columns, (n, width)), order="C")
        shape = (len(self._rows), *covariance.shape[-2:])
        self.covariance: Floats = np.array(np.broadcast_to(covariance, shape), float, order="C")
        self._goal = None if goal is None else goal.reshape(-1, *goal.shape[-2:])
        self._repeats = repeats
        self._information = np.zeros(len(self._rows))
        self.chosen: list[int] = []

    def among(self, numbers: Ints) -> "Search":
        """A search that continues with only the candidates of these `numbers` (n,), renumbered from 0."""
        return Search(self._rows[:, numbers], self.covariance, self._goal, self._columns[numbers], self._repeats)

    @property
    def sums(self) -> Floats:
        """Summed variances (n_cases, n_goals) now; without a goal the information (n_cases, 1) so far, in nats."""
        if self._goal is None:
            return self._information[:, None]
        return np.asarray(((self._goal @ self.covariance[:, None]) * self._goal).sum(axis=(-1, -2)))

    def gains(self) -> Floats:
        """Improvement of the sums by each candidate (n, n_cases, n_goals): less variance, or more information."""
        goals, k, d = (0, 1, self.covariance.shape[-1]) if self._goal is None else self._goal.shape
        goal = np.zeros((0, d)) if self._goal is None else self._goal.reshape(-1, d)
        information, less = _gains(self._rows, self._columns, self.covariance, self.covariance @ goal.T)
        if self._goal is None:
            return np.asarray(information.T[..., None])
        return np.asarray(np.moveaxis(less.reshape(*less.shape[:2], goals, k).sum(axis=-1), 1, 0))

    def scores(self) -> Floats:
        """The criterion to minimise (n,): minus each candidate's mean gain."""
        return np.asarray(-self.gains().mean(axis=(1, 2)))

    def best(self) -> int:
        """The candidate of largest gain, the first of equals; raises PatternError if all are chosen."""
        scores = self.scores()
        if not self._repeats:
            scores[self.chosen] = np.inf
        best = int(np.argmin(scores))
        if not np.isfinite(scores[best]):
            raise PatternError(f"all {len(scores)} injections are chosen; ask for fewer, or allow repeats")
        return best

    def take(self, number: int) -> None:
        """Choose candidate `number`: condition the covariance on its measurements."""
        self._update(number, 1.0)
        self.chosen.append(number)

    def drop(self, number: int) -> None:
        """Undo `take` of candidate `number`."""
        self._update(number, -1.0)
        self.chosen.remove(number)

    def choose(self, count: int) -> Floats:
        """Take the best candidate `count` times; the mean of the sums (count + 1,) before and after each.

        Raises:
            PatternError: If there are fewer candidates.
        """
        values = [self.sums.mean()]
        for _ in range(count):
            self.take(self.best())
            values.append(self.sums.mean())
        return np.array(values)

    def _update(self, number: int, sign: float) -> None:
        rows, own = self._rows[:, number], self._columns[number]
        across = rows @ self.covariance[:, own]
        inner = np.eye(rows.shape[-2]) + sign * across[..., own] @ rows.swapaxes(-1, -2)
        if self._goal is None:
            self._information += 0.5 * np.linalg.slogdet(inner)[1]
        self.covariance -= sign * across.swapaxes(-1, -2) @ np.linalg.solve(inner, across)


@njit(cache=True, nogil=True)
def _gains(rows: Floats, columns: Ints, covariance: Floats, wanted: Floats) -> tuple[Floats, Floats]:
    """Information (n_cases, n) of each candidate, in nats, and variance (n_cases, n, g) that it takes off each goal.

    Args:
        rows: H (n_cases, n, m, w).
        columns: (n, w) numbers of the state that they are of.
        covariance: P (n_cases, d, d).
        wanted: P G^T (n_cases, d, g) of goals G.
    """
    cases, n, m, width = rows.shape
    information, less = np.zeros((cases, n)), np.zeros((cases, n, wanted.shape[2]))
    known, seen = np.empty((width, width)), np.empty(width)
    factor, solved = np.zeros((m, m)), np.empty(m)
    for c in range(cases):
        for i in range(n):
            for k in range(width):
                for q in range(width):
                    known[k, q] = covariance[c, columns[i, k], columns[i, q]]
            for r in range(m):  # Cholesky's factor of 1 + H P H^T
                for k in range(width):
                    seen[k] = 0.0
                    for q in range(width):
                        seen[k] += rows[c, i, r, q] * known[k, q]
                for q in range(r + 1):
                    total = 1.0 if r == q else 0.0
                    for k in range(width):
                        total += seen[k] * rows[c, i, q, k]
                    for k in range(q):
                        total -= factor[r, k] * factor[q, k]
                    factor[r, q] = np.sqrt(total) if r == q else total / factor[q, q]
                information[c, i] += np.log(factor[r, r])
            for g in range(wanted.shape[2]):
                for r in range(m):
                    total = 0.0
                    for k in range(width):
                        total += rows[c, i, r, k] * wanted[c, columns[i, k], g]
                    for k in range(r):
                        total -= factor[r, k] * solved[k]
                    solved[r] = total / factor[r, r]
                    less[c, i, g] += solved[r] ** 2
    return information, less


def greedy(
    rows: Floats, covariance: Floats, count: int, goal: Floats | None = None, repeats: bool = False
) -> Selection:
    """Choose injections one by one, each the best given the previous ones.

    Args:
        rows, covariance, goal, repeats: As for `Search`.
        count: Number of injections.

    Raises:
        PatternError: If there are fewer injections than are to be chosen.
    """
    search = Search(rows, covariance, goal, repeats=repeats)
    values = search.choose(count)
    return Selection(np.array(search.chosen, np.int64), values)


def exchange(rows: Floats, covariance: Floats, count: int, goal: Floats | None = None) -> Ints:
    """Choose `count` injections greedily, then exchange single ones as long as that helps; arguments as for `greedy`.

    Raises:
        PatternError: If there are fewer injections than are to be chosen.
    """
    search = Search(rows, covariance, goal)
    for _ in range(count):
        search.take(search.best())
    kept = 0
    while kept < count:  # until none of them is given up for another
        oldest = search.chosen[0]
        search.drop(oldest)
        scores = search.scores()
        best = search.best()
        better = scores[best] < scores[oldest] - 1e-9 * abs(scores[oldest])
        search.take(best if better else oldest)
        kept = 0 if better else kept + 1
    return np.array(search.chosen, np.int64)


def pair_currents(model: TransferModel, source: VoltageSource, limit: float = np.inf) -> Floats:
    """The current (n_pairs,) that a voltage source drives through each of the model's pairs, at most `limit` (A).

    Raises:
        ModelError: If an electrode is a point, whose own resistance is that of the mesh.
    """
    return np.asarray(np.minimum(source.pair_currents(model), limit))
