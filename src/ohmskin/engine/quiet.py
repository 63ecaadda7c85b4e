"""Quiet frames: every pattern again and again, while nothing touches the skin."""

from collections.abc import Callable, Sequence

from ohmskin.device import Capabilities
from ohmskin.scan import DrivePattern, Frame

_REPEATS = 40  # of each pattern, for the baseline


def quiet_frames(
    patterns: Sequence[DrivePattern],
    able: Capabilities,
    scan: Callable[[DrivePattern], Frame],
    progress: Callable[[float], None],
) -> list[Frame]:
    """Frames of all patterns, in pieces that the device takes at once.

    Args:
        patterns: What will be driven.
        able: What the device takes.
        scan: Scans a pattern.
        progress: Called with the share done, 0 to 1.
    """
    pieces = [piece for pattern in patterns for piece in pattern.split(able.max_injections, able.max_measurements)]
    frames = []
    for done in range(_REPEATS):
        progress(done / _REPEATS)
        frames += [scan(piece) for piece in pieces]
    return frames
