"""What is measured: drive patterns, the frames that come of them, and the untouched reference."""

from ohmskin.scan.baseline import Baseline, Difference
from ohmskin.scan.frame import Frame, FrameFlag
from ohmskin.scan.pairs import all_pairs, n_pairs, pair_index
from ohmskin.scan.pattern import DrivePattern, adjacent, measure_others, opposite, skip

__all__ = [
    "Baseline",
    "Difference",
    "DrivePattern",
    "Frame",
    "FrameFlag",
    "adjacent",
    "all_pairs",
    "measure_others",
    "n_pairs",
    "opposite",
    "pair_index",
    "skip",
]
