"""The logarithm, a line source's potential on a sheet: its means over contacts, and what of it leaves over edges."""

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints

_SMALL = 3.0  # sides of a contact beyond which it is nearly a point


@njit(cache=True, nogil=True)
def log_means(targets: Floats, sources: Floats, sides: Floats) -> Floats:
    """Mean (n_targets, n_sources) of the logarithm of the distance (m) of targets from parallelograms.

    By Gauss's theorem: the logarithm of r is the divergence of (log r - 1/2) r / 2.

    Args:
        targets: (n_targets, 2) (m).
        sources: (n_sources, 2) middles of the parallelograms (m).
        sides: (n_sources, 2, 2) two sides of each, as rows (m).
    """
    means = np.empty((len(targets), len(sources)))
    corner = np.empty((5, 2))
    for j in range(len(sources)):
        p, q = sides[j, 0], sides[j, 1]
        area, span = p[0] * q[1] - p[1] * q[0], p[0] ** 2 + p[1] ** 2 + q[0] ** 2 + q[1] ** 2
        for i in range(len(targets)):
            x, y = sources[j, 0] - targets[i, 0], sources[j, 1] - targets[i, 1]
            square = x * x + y * y
            if square > _SMALL**2 * span:
                along = (p[0] * x + p[1] * y) ** 2 + (q[0] * x + q[1] * y) ** 2
                means[i, j] = 0.5 * np.log(square) + (span * square - 2 * along) / (24 * square * square)
                continue
            for k in range(5):
                a, b = (0.5 if k in (1, 2) else -0.5), (0.5 if k in (2, 3) else -0.5)
                corner[k, 0], corner[k, 1] = x + a * p[0] + b * q[0], y + a * p[1] + b * q[1]
            flux = 0.0
            for k in range(4):
                dx, dy = corner[k + 1, 0] - corner[k, 0], corner[k + 1, 1] - corner[k, 1]
                length = np.hypot(dx, dy)
                off = (corner[k, 0] * dy - corner[k, 1] * dx) / length
                low = (corner[k, 0] * dx + corner[k, 1] * dy) / length
                flux += off * (_log_integral(low + length, off) - _log_integral(low, off))
            means[i, j] = flux / (2 * area)
    return means


@njit(cache=True, nogil=True)
def _log_integral(along: float, off: float) -> float:
    """Integral of log r - 1/2 along a straight line that passes the origin at `off`, from there on."""
    if off == 0.0:
        return 0.0  # it is weighed by `off`
    return float(along * (0.5 * np.log(along * along + off * off) - 1.5) + off * np.arctan(along / off))


@njit(cache=True, nogil=True)
def add_flux(load: Floats, rows: Ints, ends: Floats, sources: Floats, inside: Floats) -> None:
    """Adds to `load` (n, n_sources) what leaves over edges of the rim, `ends` (n_edges, 2, 2), from unit line sources.

    Args:
        load: Of linear shape functions, in place.
        rows: (n_edges, 2) rows of it.
        ends: The ends of the edges (m).
        sources: (n_sources, 2) (m).
        inside: (2,) a point on the inner side of the edges (m).
    """
    for e in range(len(rows)):
        dx, dy = ends[e, 1, 0] - ends[e, 0, 0], ends[e, 1, 1] - ends[e, 0, 1]
        length = np.hypot(dx, dy)
        tx, ty = dx / length, dy / length
        nx, ny = ty, -tx
        if (inside[0] - ends[e, 0, 0]) * nx + (inside[1] - ends[e, 0, 1]) * ny > 0:
            nx, ny = -nx, -ny
        for j in range(len(sources)):
            x, y = ends[e, 0, 0] - sources[j, 0], ends[e, 0, 1] - sources[j, 1]
            off, low = x * nx + y * ny, x * tx + y * ty
            high = low + length
            if off == 0.0:
                continue
            angle = np.arctan(high / off) - np.arctan(low / off)
            second = (off / 2 * np.log((high**2 + off**2) / (low**2 + off**2)) - low * angle) / length
            load[rows[e, 1], j] -= second / (2 * np.pi)
            load[rows[e, 0], j] -= (angle - second) / (2 * np.pi)
