"""Patterns that cover a whole sheet, and the round of them that finds contacts wherever they appear."""

from collections.abc import Sequence
from copy import copy

import numpy as np

from ohmskin.arrays import Ints
from ohmskin.drive.drive import Target
from ohmskin.drive.optimal import part_of
from ohmskin.errors import PatternError
from ohmskin.geometry import Electrodes
from ohmskin.scan import DrivePattern, all_pairs, measure_others, pair_index


class Exploration:
    """Goes round a fixed set of injections, whatever is believed: finds contacts wherever they appear.

    Args:
        electrodes: Electrode layout.
        injections: Injections per frame.
        drives: (n, 2) source and sink of the set; opposite electrodes of the rim unless given. All are measured.

    Raises:
        PatternError: If there are no injections, or an electrode is not there.
    """

    scans, adjustable = 1, True

    def __init__(self, electrodes: Electrodes, injections: int = 4, drives: Ints | None = None) -> None:
        self.complete = complete_pattern(electrodes)
        self.injections = _within(injections, self.complete)
        self.drives = _numbers(opposite_pairs(electrodes) if drives is None else np.asarray(drives), electrodes)

    @property
    def patterns(self) -> tuple[DrivePattern, ...]:
        """All pairs: each of its patterns is a part of them."""
        return (self.complete,)

    def with_injections(self, count: int) -> "Exploration":
        """The same round with another number of injections a frame."""
        other = copy(self)
        other.injections = _within(count, self.complete)
        return other

    def next(self, targets: Sequence[Target], turn: int) -> DrivePattern:
        """The next injections of the round."""
        return part_of(self.complete, self.numbers(turn, self.injections))

    def numbers(self, turn: int, count: int) -> Ints:
        """The numbers in `complete` of the next `count`, if each of the `turn` frames before took as many."""
        return np.asarray(self.drives[(turn * count + np.arange(count)) % len(self.drives)])


def complete_pattern(electrodes: Electrodes | int) -> DrivePattern:
    """All pairs of electrodes, or of so many, driven and all others measured: every adaptive choice is a part of it."""
    n_elec = electrodes if isinstance(electrodes, int) else len(electrodes)
    return measure_others(all_pairs(n_elec), range(n_elec))


def base_pattern(electrodes: Electrodes) -> DrivePattern:
    """Opposite electrodes of the rim driven, all others measured, inner ones too: the base scan of ``16P``.

    Of all sets of six it has, within a hundredth, the least position error over the paper's sheet (`best_fixed`).
    """
    return measure_others(opposite_pairs(electrodes), range(len(electrodes)))


def opposite_pairs(electrodes: Electrodes) -> Ints:
    """Opposite electrodes of the rim (n, 2), in an order in which neighbours in time drive across each other."""
    rim = electrodes.rings[0]
    half = len(rim) // 2
    stride = next((s for s in range(max(half // 2, 1), half) if np.gcd(s, half) == 1), 1)
    order = [(k * stride) % half for k in range(half)]
    return np.array([(rim[k], rim[k + half]) for k in order])


def _numbers(drives: Ints, electrodes: Electrodes) -> Ints:
    if drives.ndim != 2 or drives.shape[1] != 2 or drives.min() < 0 or drives.max() >= len(electrodes):
        raise PatternError(f"drives of shape {drives.shape}; give (n, 2) numbers of the {len(electrodes)} electrodes")
    return pair_index(drives[:, 0], drives[:, 1], len(electrodes))


def _within(injections: int, complete: DrivePattern) -> int:
    if not 1 <= injections <= complete.n_inj:
        raise PatternError(f"{injections} injections per frame; there are 1..{complete.n_inj} pairs to choose from")
    return injections
