"""Measurements: drive patterns, their frames, and the reference of the untouched skin."""

from ohmskin.scan.assessment import assess
from ohmskin.scan.baseline import Baseline, Difference, newest
from ohmskin.scan.channels import Channels
from ohmskin.scan.cost import Cost
from ohmskin.scan.frame import Frame, FrameFlag
from ohmskin.scan.network import NetworkFit, reciprocity_residuals
from ohmskin.scan.pairs import Pairs, all_pairs, n_pairs, pair_index, two_terminal
from ohmskin.scan.pattern import DrivePattern, adjacent, measure_others, needed, opposite, skip
from ohmskin.scan.quality import Quality, Verdict, left_out

__all__ = [
    "Baseline",
    "Channels",
    "Cost",
    "Difference",
    "DrivePattern",
    "Frame",
    "FrameFlag",
    "NetworkFit",
    "Pairs",
    "Quality",
    "Verdict",
    "adjacent",
    "all_pairs",
    "assess",
    "left_out",
    "measure_others",
    "n_pairs",
    "needed",
    "newest",
    "opposite",
    "pair_index",
    "reciprocity_residuals",
    "skip",
    "two_terminal",
]
