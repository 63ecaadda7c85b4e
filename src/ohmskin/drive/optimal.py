"""Second scans chosen by where contacts are alone: the paper's, and the one that it improves on."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ohmskin.arrays import Floats, Ints
from ohmskin.drive.drive import SecondScan
from ohmskin.geometry import Electrodes
from ohmskin.scan import all_pairs


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


class OptimalDrive(SecondScan):
    """The paper's adaptive drive (section III-B): the pairs whose connecting lines pass closest to a contact."""

    def choose(self, regions: Sequence[Floats]) -> Ints:
        weights = [pair_weights(self.electrodes.positions, anchors) for anchors in regions]
        return take_turns(np.array(weights), self.pairs)


class LocalDrive(SecondScan):
    """Local measurement patterns near the pressed region: the paper's reference [14], the drive that it improves on.

    The paper says of it: "adaptively select a set of local patterns near the pressed region for acquiring more detailed
    information". Read concretely here: currents flow only between neighbours, that is between electrodes no further
    apart than the diagonal of a cell of the layout, and of these short pairs the ones whose middle is closest to the
    region are driven. The injections and the electrodes measured are as many as in the paper's own scheme, for
    comparison.
    """

    def __init__(self, electrodes: Electrodes, pairs: int = 16) -> None:
        super().__init__(electrodes, pairs)
        ends = electrodes.positions[all_pairs(len(electrodes))]
        length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        spacing = float(cKDTree(electrodes.positions).query(electrodes.positions, k=2)[0][:, 1].max())
        reach = np.maximum(1.5 * spacing, np.sort(length)[pairs - 1])  # a cell's diagonal is 1.41 times its side
        self._middle, self._long = ends.mean(axis=1), length > reach

    def choose(self, regions: Sequence[Floats]) -> Ints:
        centres = np.array([anchors.mean(axis=0) for anchors in regions])
        distance = np.linalg.norm(self._middle - centres[:, None], axis=2)
        return take_turns(-np.where(self._long, np.inf, distance), self.pairs)
