"""Local measurement patterns near the pressed region (the paper's reference [14]), the drive that it improves on.

The paper says of it: "adaptively select a set of local patterns near the pressed region for acquiring more detailed
information". Read concretely here: currents flow only between neighbours, that is between electrodes no further apart
than the diagonal of a cell of the layout, and of these short pairs the ones whose middle is closest to the region are
driven. The injections and the electrodes measured are as many as in the paper's own scheme, for comparison.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ohmskin.drive.optimal import part_of, take_turns
from ohmskin.errors import PatternError
from ohmskin.geometry import Electrodes
from ohmskin.scan import DrivePattern, all_pairs, measure_others


class LocalDrive:
    """Chooses the short electrode pairs that are closest to the contacts at hand.

    Args:
        electrodes: Electrode layout.
        pairs: Number of injections in a pattern.

    Raises:
        PatternError: If `pairs` is not between 1 and the number of electrode pairs.
    """

    def __init__(self, electrodes: Electrodes, pairs: int = 16) -> None:
        self.electrodes, self.pairs = electrodes, pairs
        self.complete = measure_others(all_pairs(len(electrodes)), range(len(electrodes)))
        if not 1 <= pairs <= self.complete.n_inj:
            raise PatternError(f"{pairs} injections per local scan; there are 1..{self.complete.n_inj} pairs")
        ends = electrodes.positions[all_pairs(len(electrodes))]
        length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        spacing = float(cKDTree(electrodes.positions).query(electrodes.positions, k=2)[0][:, 1].max())
        reach = np.maximum(1.5 * spacing, np.sort(length)[pairs - 1])  # a cell's diagonal is 1.41 times its side
        self._middle, self._long = ends.mean(axis=1), length > reach

    def pattern(self, regions: Sequence[ArrayLike]) -> DrivePattern:
        """The pattern for one or several regions, each given by its anchors (3, 2) in metres. A part of `complete`."""
        centres = np.array([np.mean(np.asarray(anchors, float), axis=0) for anchors in regions])
        distance = np.linalg.norm(self._middle - centres[:, None], axis=2)
        chosen = take_turns(-np.where(self._long, np.inf, distance), self.pairs)
        return part_of(self.complete, chosen)
