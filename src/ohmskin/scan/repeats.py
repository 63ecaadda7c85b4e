"""Repeated frames of one pattern, and statistics of values some of which are not known."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.scan.frame import Frame
from ohmskin.scan.network import NetworkFit
from ohmskin.scan.pattern import DrivePattern


@dataclass(frozen=True, eq=False)
class Repeats:
    """Frames of one pattern, one at least."""

    pattern: DrivePattern
    frames: list[Frame]

    @cached_property
    def voltages(self) -> Floats:
        """(n_frames, n_meas) in volts; NaN where missing or clipped."""
        return finite(np.stack([frame.voltages for frame in self.frames]))

    @cached_property
    def mean(self) -> Floats:
        """Mean voltage (n_meas,) of what is known (V)."""
        return known_mean(self.voltages)

    @cached_property
    def currents(self) -> Floats:
        """Mean current (n_meas,) behind each measurement (A)."""
        return known_mean(np.stack([frame.measurement_currents for frame in self.frames]))

    @cached_property
    def scatter(self) -> Floats:
        """Variance (n_meas,) estimated from successive frames, so that slow drift is no noise (V2)."""
        return known_mean(np.diff(self.voltages, axis=0) ** 2) / 2

    @cached_property
    def network(self) -> NetworkFit:
        """The network fitted to the mean."""
        return NetworkFit(self.pattern, self.currents, self.mean)


def by_pattern(frames: Iterable[Frame]) -> dict[DrivePattern, Repeats]:
    """Frames, those of one pattern together."""
    groups: dict[DrivePattern, list[Frame]] = defaultdict(list)
    for frame in frames:
        groups[frame.pattern].append(frame)
    return {pattern: Repeats(pattern, group) for pattern, group in groups.items()}


def finite(values: Floats) -> Floats:
    """The values, NaN where they are infinite."""
    return np.where(np.isfinite(values), values, np.nan)


def known_mean(values: Floats) -> Floats:
    """Mean over the first axis of what is known; NaN where nothing is."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        mean: Floats = np.where(known, values, 0.0).sum(axis=0) / known.sum(axis=0)
    return mean


def rms(values: Floats) -> float:
    """Root mean square of what is known; NaN where nothing is."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")
