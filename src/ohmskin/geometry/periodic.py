"""Places of a closed band: x goes round it, and whole turns do not count. Of other skins the period is 0."""

import numpy as np
from scipy.spatial import cKDTree

from ohmskin.arrays import Floats
from ohmskin.geometry.domain import Domain


def shortest(offsets: Floats, period: float) -> Floats:
    """Vectors (..., 2) between places of a closed band, the short way round; as they are if it is none."""
    if period:
        offsets = offsets.copy()
        offsets[..., 0] -= period * np.rint(offsets[..., 0] / period)
    return offsets


def folded(points: Floats, period: float) -> Floats:
    """Places (..., 2) of a closed band with x from 0 to below `period` (m); as they are if it is none."""
    if period:
        points = points.copy()
        points[..., 0] %= period
        points[..., 0][points[..., 0] >= period] = 0.0  # a tiny negative number plus the period is the period
    return points


def depth(domain: Domain, points: Floats) -> Floats:
    """Distance (m) of places (n, 2) inside the rim, as `Domain.depth`; also below 0 more than a turn off a band."""
    inside, (x, _) = domain.depth(points), points.T
    return np.minimum.reduce([inside, x + domain.period, 2 * domain.period - x]) if domain.period else inside


def tree(points: Floats, period: float = 0.0) -> cKDTree:
    """What finds the closest of points (n, dim); of a closed band, the short way round."""
    return cKDTree(points, boxsize=[period, 0.0] if period else None)


def unrolled(corners: Floats, period: float) -> Floats:
    """Corners (n_elem, dim + 1, dim of space) with all beside the first one."""
    return np.asarray(corners[:, :1] + shortest(corners - corners[:, :1], period)) if period else corners
