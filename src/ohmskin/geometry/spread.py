"""Electrode places spread evenly over a sheet of any shape: some along its rim, the others inside."""

from collections.abc import Callable

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.geometry.domain import Domain
from ohmskin.geometry.electrodes import to_corners
from ohmskin.geometry.periodic import folded, shortest

_APART = 1.2  # distance along the rim over that of places on a square grid: beyond the rim nothing is to be felt
_FINE = 14  # places looked at along that distance
_ROUNDS = 12


def spread(domain: Domain, count: int, scale: Callable[[Floats], Floats]) -> Floats:
    """Places (count, 2) on a sheet, evenly along its rims, the others inside as far from all as can be (m).

    Farthest-point choice; then each place inside is moved to where it is farthest from the others, in turn.

    Args:
        domain: The sheet, a map of the skin.
        count: How many, at least 4.
        scale: Metres on the skin for a metre on the map (n,), at places (n, 2).
    """
    x0, y0, x1, y1 = domain.bounds
    step = float(np.sqrt(domain.area / count)) / _FINE
    lattice = np.stack(np.meshgrid(np.arange(x0, x1, step), np.arange(y0, y1, step)), axis=-1).reshape(-1, 2)
    sites = folded(lattice[domain.depth(lattice) > step], domain.period)
    scales = scale(sites)
    rim = _along_rims(domain, count, _APART * float(np.sqrt((scales**2).mean() * domain.area / count)), scale)
    chosen = folded(rim, domain.period)

    def away(places: Floats) -> Floats:
        offsets = shortest(sites[:, None] - places, domain.period)
        return np.asarray(np.linalg.norm(offsets, axis=2) * (scales[:, None] + scale(places)) / 2)

    gaps = away(chosen)
    while gaps.shape[1] < count:
        best = sites[[gaps.min(axis=1).argmax()]]
        chosen, gaps = np.vstack([chosen, best]), np.hstack([gaps, away(best)])
    for _ in range(_ROUNDS):
        before = chosen.copy()
        for k in range(len(rim), count):
            chosen[k] = sites[np.delete(gaps, k, axis=1).min(axis=1).argmax()]
            gaps[:, [k]] = away(chosen[[k]])
        if (chosen == before).all():
            break
    return chosen


def _along_rims(domain: Domain, count: int, apart: float, scale: Callable[[Floats], Floats]) -> Floats:
    """Places (n, 2) about so far apart along each rim (m on the skin), from a corner on; not more than `count`."""
    loops, lengths = (domain, *domain.holes), []
    for loop in loops:
        start = float(loop.corners[0]) if len(loop.corners) else 0.0
        arcs = start + np.linspace(0, loop.perimeter, 721)
        lengths.append((arcs, np.append(0, np.cumsum(scale(loop.rim(arcs[:-1] + arcs[1] / 1440)) * np.diff(arcs)))))
    wanted = np.array([along[-1] for _, along in lengths]) / apart
    most = np.maximum(1, np.floor(wanted * min(1.0, count / wanted.sum()) + 1e-9)).astype(int)
    counts = [max(4, round(wanted[0]))] if len(loops) == 1 else np.minimum(np.maximum(1, np.rint(wanted)), most)
    found = []
    for loop, (arcs, along), many in zip(loops, lengths, counts, strict=True):
        at = along[-1] * np.arange(min(int(many), count)) / min(int(many), count)
        found.append(loop.rim(to_corners(loop, np.interp(at, along, arcs))))
    return np.vstack(found)
