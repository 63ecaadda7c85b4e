"""Cost of a scan: its time, by which drive policies are compared."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import PatternError
from ohmskin.scan.pattern import DrivePattern


@dataclass(frozen=True)
class Cost:
    """Time that a device takes for a scan.

    Args:
        settle: Waiting time after each change of injection (s).
        conversion: Time of one conversion (s).
        channels: Voltages converted at once; 1 if multiplexed one by one, 0 if all of an injection are parallel.
        overhead: Of each scan, such as the link's (s).

    Raises:
        PatternError: If a number is negative or not finite.
    """

    settle: float
    conversion: float
    channels: int = 0
    overhead: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value >= 0):
                raise PatternError(f"cost {name} is {value!r}; it must be finite and not negative")

    def time(self, pattern: DrivePattern) -> float:
        """How long a scan of `pattern` takes (s)."""
        return _time(self, pattern)

    def times(self, pattern: DrivePattern) -> Floats:
        """When each voltage (n_meas,) of a `pattern` is converted, from the start of a scan (s)."""
        which, measured, each = pattern.measurements[:, 0], pattern.measured, self._injections(pattern.measured)
        within = np.arange(pattern.n_meas) - (measured.cumsum() - measured)[which]
        conversions = within // self.channels + 1 if self.channels else 1
        return np.asarray((each.cumsum() - each)[which] + self.settle + self.conversion * conversions)

    def injections(self, pattern: DrivePattern, seconds: float) -> int:
        """How many injections of `pattern`, whichever they are, fit into a scan of this many seconds.

        Raises:
            PatternError: If not even one fits.
        """
        one = float(self._injections(pattern.measured.max()))
        left = seconds - self.overhead
        if not left >= one * (1 - 1e-9):  # false for nan, too
            raise PatternError(f"{seconds!r} s a frame; one injection takes {self.overhead + one:.3g} s, the least")
        return pattern.n_inj if one == 0 else min(int(left / one * (1 + 1e-9)), pattern.n_inj)

    def _injections(self, measured: Ints) -> Floats:
        """How long injections (n,) take of which so many voltages (n,) are measured (s)."""
        conversions = -(-measured // self.channels) if self.channels else np.minimum(measured, 1)
        return np.asarray(self.settle + self.conversion * conversions)


@lru_cache(maxsize=1024)
def _time(cost: Cost, pattern: DrivePattern) -> float:
    return cost.overhead + float(cost._injections(pattern.measured).sum())
