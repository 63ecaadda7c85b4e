"""A touch put on a virtual skin."""

import math
from dataclasses import dataclass

from ohmskin.errors import DeviceRefused

# The least and the most of each value; each limit is exact as a 32-bit float, which is how it travels.
RANGES = {"x": (-100.0, 100.0), "y": (-100.0, 100.0), "radius": (2.0**-20, 10.0), "pressure": (0.0, 1e9)}
_UNITS = {"x": "m", "y": "m", "radius": "m", "pressure": "Pa"}


@dataclass(frozen=True)
class PressCommand:
    """A round touch; pressing the same number again moves it.

    Args:
        number: Which touch, 0..65535.
        x: Place on the sheet (m).
        y: Place on the sheet (m).
        radius: Radius (m).
        pressure: Pressure (Pa); 0 lifts it.

    Raises:
        DeviceRefused: If a value is not finite or out of range.
    """

    number: int
    x: float
    y: float
    radius: float
    pressure: float

    def __post_init__(self) -> None:
        if not 0 <= self.number <= 0xFFFF:
            raise DeviceRefused(f"press number {self.number}; it must be 0..65535")
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise DeviceRefused(f"press {name} is {value} {_UNITS[name]}; it must be {low:g}..{high:g}")
