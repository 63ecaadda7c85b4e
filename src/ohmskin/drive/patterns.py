"""Patterns that cover a whole sheet, and parts of them."""

from functools import lru_cache

import numpy as np

from ohmskin.arrays import Ints
from ohmskin.geometry import Electrodes
from ohmskin.scan import DrivePattern, all_pairs, measure_others


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


def part_of(complete: DrivePattern, chosen: Ints) -> DrivePattern:
    """Those injections (count,) of a pattern, in that order; all its injections must have equally many measurements.

    The same ones give the same object again: what is known of a pattern is worked out once.
    """
    return _part_of(complete, tuple(chosen.tolist()))


@lru_cache(maxsize=1024)
def _part_of(complete: DrivePattern, numbers: tuple[int, ...]) -> DrivePattern:
    chosen = np.array(numbers)
    per_pair = complete.n_meas // complete.n_inj
    rows = (chosen[:, None] * per_pair + np.arange(per_pair)).ravel()
    measured = complete.measurements[rows].copy()
    measured[:, 0] = np.repeat(np.arange(len(chosen)), per_pair)
    return DrivePattern.valid(complete.injections[chosen], measured)
