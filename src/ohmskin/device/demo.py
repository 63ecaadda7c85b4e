"""A finger that wanders over the skin until somebody presses, so that there is something to see at once."""

import math

import numpy as np

from ohmskin.geometry import Domain

_RADIUS, _PRESSURE = 8e-3, 20e3  # m, Pa: a firm fingertip


def demo_finger(domain: Domain, seconds: float) -> tuple[tuple[float, float], float, float]:
    """Where the finger is (x, y) in metres, its radius (m) and its pressure (Pa), `seconds` after it began."""
    x0, y0, x1, y1 = domain.bounds
    across, up = 0.36 * (x1 - x0), 0.36 * (y1 - y0)
    x = (x0 + x1) / 2 + across * math.sin(2 * math.pi * seconds / 17)
    y = (y0 + y1) / 2 + up * math.sin(2 * math.pi * seconds / 11 + 1)
    place = np.array([x, y])
    if domain.depth(place[None])[0] < 0:  # of a sheet cut to any shape, the edge of what is closest
        loops = (domain, *domain.holes)
        edge = min(
            (loop.rim(loop.arc(place[None]))[0] for loop in loops), key=lambda at: float(np.hypot(*(at - place)))
        )
        inwards = (edge - place) / max(float(np.hypot(*(edge - place))), 1e-9)
        tried = np.array([edge + step * inwards for step in (1e-3, 3e-4, 1e-4, 0.0)])
        x, y = tried[int(np.argmax(domain.depth(tried) >= 0))].tolist()
    return (x, y), _RADIUS, _PRESSURE * (0.7 + 0.3 * math.sin(2 * math.pi * seconds / 3))
