"""Patterns that cover a whole sheet, and parts of them."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.geometry import Electrodes
from ohmskin.geometry.periodic import folded, shortest, tree
from ohmskin.scan import DrivePattern, Pairs, all_pairs, measure_others
from ohmskin.scan.pairs import pairs_measured

MOST_WHOLE = 40  # electrodes of which all pairs are candidates
_REACH = 2.1  # distances of neighbours to which electrodes are near: two steps of a grid, and a little more
_LONG = 1.8  # of the same, from which on a pair is long enough for a base scan
_MEASURED = 10  # electrodes at which a near pair is measured, beside its own


def complete_pattern(electrodes: Electrodes | int) -> DrivePattern:
    """All pairs of `electrodes` (or of this number) driven, all others measured: it contains every adaptive choice."""
    n_elec = electrodes if isinstance(electrodes, int) else len(electrodes)
    return measure_others(all_pairs(n_elec), range(n_elec))


def is_local(electrodes: Electrodes) -> bool:
    """Whether only pairs of near electrodes are driven: of many electrodes that cover a skin, not its rim alone."""
    return len(electrodes) > MOST_WHOLE and len(electrodes.rings) > 1


@lru_cache(maxsize=16)
def candidate_pattern(electrodes: Electrodes, period: float = 0.0) -> DrivePattern:
    """All injections that a drive may choose from: `complete_pattern`, or where electrodes are many, near pairs.

    Near pairs are measured at the electrodes closest to their middle alone: what changes a voltage lies near both of
    its pairs (its sensitivity falls with the fourth power of the distance), and their number grows as the skin does.
    Neighbours in the pattern are neighbours on the skin.

    Args:
        electrodes: Electrode layout.
        period: Of a closed band, 0 of others (m).
    """
    if not is_local(electrodes):
        return complete_pattern(electrodes)
    around = tree(folded(electrodes.positions, period), period)
    pairs = around.query_pairs(_REACH * spacing(electrodes, period), output_type="ndarray")
    middles = folded(_middles(electrodes, pairs, period), period)
    order = tree(middles, period).indices
    pairs, middles = np.sort(pairs[order], axis=1), middles[order]
    _, closest = around.query(middles, k=_MEASURED + 2)
    rows = []
    for number, (pair, middle) in enumerate(zip(pairs, middles, strict=True)):
        others = closest[number][~np.isin(closest[number], pair)][:_MEASURED]
        away = shortest(electrodes.positions[others] - middle, period)
        walk = others[np.argsort(np.arctan2(away[:, 1], away[:, 0]), kind="stable")]
        rows.append(np.column_stack([np.full(len(walk) - 1, number), walk[:-1], walk[1:]]))
    return DrivePattern(pairs, np.vstack(rows))


@lru_cache(maxsize=16)
def candidate_pairs(electrodes: Electrodes, period: float = 0.0) -> Pairs:
    """The pairs of electrodes behind all voltages of `candidate_pattern`, driven electrodes measured, too.

    Arguments as for `base_pattern`.
    """
    if not is_local(electrodes):
        return Pairs.all(len(electrodes))
    return pairs_measured(len(electrodes), [candidate_pattern(electrodes, period).with_driven.quadruples])


def spacing(electrodes: Electrodes, period: float = 0.0) -> float:
    """How far an electrode is from the one closest to it, the largest such distance (m)."""
    around = folded(electrodes.positions, period)
    return float(tree(around, period).query(around, k=2)[0][:, 1].max())


def base_pattern(electrodes: Electrodes, period: float = 0.0) -> DrivePattern:
    """The base scan of ``16P``: opposite electrodes of the rim driven, all others measured, inner ones too.

    Its position error over the paper's sheet is within 1 % of that of the best set of six (`best_fixed`). Where
    electrodes are many, near pairs all over the skin, half as many as electrodes, first those farthest from each other.

    Args:
        electrodes: Those of the skin.
        period: Width (m) of a closed band, after which it meets itself; 0 of other skins.
    """
    if is_local(electrodes):
        return part_of(candidate_pattern(electrodes, period), _spread(electrodes, period))
    return measure_others(opposite_pairs(electrodes), range(len(electrodes)))


@lru_cache(maxsize=16)
def _spread(electrodes: Electrodes, period: float) -> Ints:
    """Candidates as far from each other as can be, each as far from those before."""
    injections = candidate_pattern(electrodes, period).injections
    ends = electrodes.positions[injections]
    length = np.linalg.norm(shortest(ends[:, 1] - ends[:, 0], period), axis=1)
    usable = np.flatnonzero(length > _LONG * spacing(electrodes, period))
    middles, chosen = _middles(electrodes, injections[usable], period), [0]
    away = np.full(len(usable), np.inf)
    while len(chosen) < min(len(electrodes) // 2, len(usable)):
        away = np.minimum(away, np.linalg.norm(shortest(middles - middles[chosen[-1]], period), axis=1))
        chosen.append(int(np.argmax(away)))
    return usable[chosen]


def _middles(electrodes: Electrodes, pairs: Ints, period: float) -> Floats:
    one, other = electrodes.positions[pairs.T]
    return np.asarray(one + shortest(other - one, period) / 2)


def opposite_pairs(electrodes: Electrodes) -> Ints:
    """Opposite electrodes of the rim (n, 2), in an order in which neighbours in time drive across each other."""
    rim = electrodes.rings[0]
    half = len(rim) // 2
    stride = next((s for s in range(max(half // 2, 1), half) if np.gcd(s, half) == 1), 1)
    order = [(k * stride) % half for k in range(half)]
    return np.array([(rim[k], rim[k + half]) for k in order])


def numbers_of(pattern: DrivePattern, injections: Ints) -> Ints:
    """The numbers in a pattern of injections (n, 2), whatever their direction; the pattern must have them all."""
    codes = Pairs.of(1 + int(pattern.injections.max()), pattern.injections)
    at = np.empty(len(codes), np.int64)
    at[codes.index(*pattern.injections.T)] = np.arange(pattern.n_inj)
    return np.asarray(at[codes.index(*np.asarray(injections).T)])


def part_of(complete: DrivePattern, chosen: Ints | Sequence[int]) -> DrivePattern:
    """The `chosen` injections (count,) of a `complete` pattern, in that order; all must have equally many measurements.

    The same choice returns the same object, so that quantities of a pattern are computed once.
    """
    return _part_of(complete, tuple(map(int, chosen)))


@lru_cache(maxsize=1024)
def _part_of(complete: DrivePattern, numbers: tuple[int, ...]) -> DrivePattern:
    chosen = np.array(numbers)
    per_pair = complete.n_meas // complete.n_inj
    rows = (chosen[:, None] * per_pair + np.arange(per_pair)).ravel()
    measured = complete.measurements[rows].copy()
    measured[:, 0] = np.repeat(np.arange(len(chosen)), per_pair)
    return DrivePattern.valid(complete.injections[chosen], measured)
