"""Places spread evenly over a sheet of any shape, some of them on its rim."""

from collections.abc import Callable

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.geometry.domain import Domain
from ohmskin.geometry.mesh import folded, shortest

_FINE = 14  # candidates along the mean distance of two places
_ROUNDS = 12


def spread(domain: Domain, count: int, scale: Callable[[Floats], Floats]) -> Floats:
    """Places (count, 2) on a sheet, its rim included, as far from each other as can be (m).

    Farthest-point choice, then each place in turn is moved to where it is farthest from the others.

    Args:
        domain: The sheet, a map of the skin.
        count: How many.
        scale: Metres on the skin for a metre on the map (n,), at places (n, 2).
    """
    step = float(np.sqrt(domain.area / count)) / _FINE
    loops = (domain, *domain.holes)
    rims = [loop.rim(np.linspace(0, loop.perimeter, round(loop.perimeter / step), endpoint=False)) for loop in loops]
    corners = [loop.rim(loop.corners) for loop in loops]
    x0, y0, x1, y1 = domain.bounds
    lattice = np.stack(np.meshgrid(np.arange(x0, x1, step), np.arange(y0, y1, step)), axis=-1).reshape(-1, 2)
    sites = np.vstack([*corners, *rims, lattice[domain.depth(lattice) > step / 2]])
    sites = folded(sites, domain.period)
    scales = scale(sites)

    def away(k: int) -> Floats:
        offsets = shortest(sites - sites[k], domain.period)
        return np.asarray(np.linalg.norm(offsets, axis=1) * (scales + scales[k]) / 2)

    chosen = [0]
    gaps = [away(0)]
    while len(chosen) < count:
        chosen.append(int(np.min(gaps, axis=0).argmax()))
        gaps.append(away(chosen[-1]))
    for _ in range(_ROUNDS):
        before = list(chosen)
        for k in range(count):
            others = np.min(gaps[:k] + gaps[k + 1 :], axis=0)
            best = int(others.argmax())
            if others[best] > others[chosen[k]] * (1 + 1e-9):
                chosen[k], gaps[k] = best, away(best)
        if chosen == before:
            break
    return np.asarray(sites[chosen])
