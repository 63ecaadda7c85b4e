"""Second scans chosen by where contacts are alone: the paper's, and the one that it improves on."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints
from ohmskin.drive.drive import SecondScan
from ohmskin.drive.patterns import is_local, spacing
from ohmskin.errors import PatternError
from ohmskin.geometry import Electrodes
from ohmskin.geometry.periodic import shortest
from ohmskin.scan import all_pairs

_NEAR = 2.0  # distances of neighbours to which a pair is near a contact


def pair_weights(
    positions: ArrayLike, anchors: ArrayLike, period: float = 0.0, pairs: Ints | None = None, reach: float = np.inf
) -> Floats:
    """Weights (n_pairs,) of electrode pairs, eq. (7): w_i = sum_k S_k / S_i.

    S_i is the summed area of the triangles that pair i forms with each anchor. A pair on a line with all anchors has no
    area; areas are clamped at a billionth of the largest so that its weight is large and finite.

    Args:
        positions: Electrode positions (n_elec, 2) in metres.
        anchors: Centroids (n_anchors, 2) of the elements closest to the contact's middle (m); the paper takes three.
        period: Of a closed band, on which lines go the short way round; 0 of others (m).
        pairs: (n_pairs, 2) the pairs; all unless given.
        reach: How far the middle of a pair may be from the first anchor (m): short pairs farther away, whose extended
            lines pass the contact, have almost no weight, decreasing with distance.

    Raises:
        PatternError: If the electrodes are not on a flat map.
    """
    positions, anchors = np.asarray(positions, float), np.asarray(anchors, float)
    if positions.shape[1] != 2:
        raise PatternError("eq. (7) chooses pairs on the flat map of a skin, not in space; see Chart")
    i, j = (all_pairs(len(positions)) if pairs is None else pairs).T
    along = shortest(positions[j] - positions[i], period)
    to_anchor = anchors[None] - positions[i][:, None]
    if period:  # the anchors that are closest to the middle of the line
        from_middle = to_anchor - along[:, None] / 2
        to_anchor += shortest(from_middle, period) - from_middle
    area = 0.5 * np.abs(along[:, None, 0] * to_anchor[..., 1] - along[:, None, 1] * to_anchor[..., 0]).sum(axis=1)
    area = np.maximum(area, 1e-9 * area.max())
    if np.isfinite(reach):
        away = np.linalg.norm(to_anchor[:, 0] - along / 2, axis=1)
        area = np.where(away > reach, BEYOND * away, area)
    return np.asarray(area.sum() / area)


BEYOND = 1e9  # m: the area of a pair beyond reach, over its distance


def round_robin(weights: ArrayLike, count: int) -> Ints:
    """The numbers (count,) of the pairs with the largest weights (n_regions, n_pairs), regions choosing in turn."""
    ranked = np.argsort(-np.atleast_2d(weights), axis=1, kind="stable")
    in_turn = ranked.T.ravel()  # first choices of all regions, then second choices, ...
    _, first = np.unique(in_turn, return_index=True)
    return np.asarray(in_turn[np.sort(first)[:count]], np.int64)


class OptimalDrive(SecondScan):
    """The paper's adaptive drive (section III-B): the pairs whose connecting lines pass closest to a contact.

    Args:
        electrodes, pairs, period: As for `SecondScan`.
    """

    @cached_property
    def reach(self) -> float:
        """Largest distance of the middle of a pair from a contact (m); infinite where all pairs are driven."""
        return _NEAR * spacing(self.electrodes, self.period) if is_local(self.electrodes) else np.inf

    def choose(self, regions: Sequence[Floats]) -> Ints:
        given = self.period, self.complete.injections, self.reach
        weights = [pair_weights(self.electrodes.positions, anchors, *given) for anchors in regions]
        return round_robin(np.array(weights), self.pairs)


class LocalDrive(SecondScan):
    """Local measurement patterns near the pressed region: the paper's reference [14], an earlier adaptive drive.

    The paper says of it: "adaptively select a set of local patterns near the pressed region for acquiring more detailed
    information". Our interpretation: currents flow only between neighbours, electrodes no further apart than the
    diagonal of a cell of the layout; of these short pairs, those with the midpoints closest to the region are driven.
    The numbers of injections and of measured electrodes are those of the paper's own scheme, for comparison.

    Args:
        electrodes: Those of the skin.
        pairs: Number of pairs driven.
        period: Width (m) of a closed band, after which it meets itself; 0 of other skins.
    """

    def __init__(self, electrodes: Electrodes, pairs: int = 16, period: float = 0.0) -> None:
        super().__init__(electrodes, pairs, period)
        starts, ends = np.moveaxis(electrodes.positions[self.complete.injections], 1, 0)
        along = shortest(ends - starts, period)
        length = np.linalg.norm(along, axis=1)
        reach = np.maximum(
            1.5 * spacing(electrodes, period), np.sort(length)[pairs - 1]
        )  # a cell's diagonal is 1.41 times its side
        self._middle, self._long = starts + along / 2, length > reach

    def choose(self, regions: Sequence[Floats]) -> Ints:
        centres = np.array(
            [anchors[0] + shortest(anchors - anchors[0], self.period).mean(axis=0) for anchors in regions]
        )
        distance = np.linalg.norm(shortest(self._middle - centres[:, None], self.period), axis=2)
        return round_robin(-np.where(self._long, np.inf, distance), self.pairs)
