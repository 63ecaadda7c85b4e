"""The paper's adaptive drive (section III-B): the electrode pairs whose connecting lines pass closest to a contact."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import PatternError
from ohmskin.geometry import Electrodes
from ohmskin.scan import DrivePattern, all_pairs, measure_others


def pair_weights(positions: ArrayLike, anchors: ArrayLike) -> Floats:
    """Weights (n_pairs,) of all electrode pairs, eq. (7): w_i = sum_k S_k / S_i.

    S_i is the summed area of the triangles that pair i forms with each anchor. A pair on a line with all anchors has no
    area; areas are clamped at a billionth of the largest so that its weight is large and finite.

    Args:
        positions: Electrode positions (n_elec, 2) in metres.
        anchors: Centroids (n_anchors, 2) of the elements closest to the contact's middle (m); the paper takes three.
    """
    positions, anchors = np.asarray(positions, float), np.asarray(anchors, float)
    i, j = all_pairs(len(positions)).T
    along = positions[j] - positions[i]
    to_anchor = anchors[None] - positions[i][:, None]
    area = 0.5 * np.abs(along[:, None, 0] * to_anchor[..., 1] - along[:, None, 1] * to_anchor[..., 0]).sum(axis=1)
    area = np.maximum(area, 1e-9 * area.max())
    return np.asarray(area.sum() / area)


def take_turns(weights: ArrayLike, count: int) -> Ints:
    """The numbers (count,) of the pairs with the largest weights (n_regions, n_pairs), regions choosing in turn."""
    ranked = np.argsort(-np.atleast_2d(weights), axis=1, kind="stable")
    in_turn = ranked.T.ravel()  # first choices of all regions, then second choices, ...
    _, first = np.unique(in_turn, return_index=True)
    return np.asarray(in_turn[np.sort(first)[:count]], np.int64)


def part_of(complete: DrivePattern, chosen: Ints) -> DrivePattern:
    """Those injections (count,) of a pattern, in that order; all its injections must have equally many measurements."""
    per_pair = complete.n_meas // complete.n_inj
    rows = (chosen[:, None] * per_pair + np.arange(per_pair)).ravel()
    measured = complete.measurements[rows].copy()
    measured[:, 0] = np.repeat(np.arange(len(chosen)), per_pair)
    return DrivePattern(complete.injections[chosen], measured)


class OptimalDrive:
    """Chooses the drive pattern for the contacts at hand.

    Args:
        electrodes: Electrode layout.
        pairs: Number of injections in a pattern (K).

    Raises:
        PatternError: If `pairs` is not between 1 and the number of electrode pairs.
    """

    def __init__(self, electrodes: Electrodes, pairs: int = 16) -> None:
        self.electrodes, self.pairs = electrodes, pairs
        self.complete = measure_others(all_pairs(len(electrodes)), range(len(electrodes)))
        if not 1 <= pairs <= self.complete.n_inj:
            raise PatternError(f"{pairs} injections per optimal scan; there are 1..{self.complete.n_inj} pairs")

    def pattern(self, regions: Sequence[ArrayLike]) -> DrivePattern:
        """The pattern for one or several regions, each given by its anchors (3, 2) in metres. A part of `complete`."""
        weights = [pair_weights(self.electrodes.positions, anchors) for anchors in regions]
        chosen = take_turns(np.array(weights), self.pairs)
        return part_of(self.complete, chosen)
