"""Exponential moving averages over frames."""

from math import expm1

_MOST = 0.2  # of the newest frame, however late it came: a finger that comes or goes within a frame may spoil it


def smoothing_factor(elapsed: float, time: float) -> float:
    """Weight of the newest frame in a mean over a `time` (s), `elapsed` (s) after the frame before: never of few."""
    return min(-expm1(-elapsed / time), _MOST)
