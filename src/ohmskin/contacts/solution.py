"""Solutions: contacts that explain data, how well, and how surely they are known."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints

PER_CONTACT = 4  # x, y, effect, squared radius
_ALIKE = 1 / 3  # of their sum, by which the effects of two contacts differ that may be one


@dataclass(frozen=True, eq=False)
class Solution:
    """Contacts fitted to data.

    Args:
        params: (n, 4) x, y (m), effect (m2), squared radius (m2) of each.
        cost: Squared misfit in units of its noise, the prior included.
        normal: (4 n, 4 n) curvature: the inverse of their covariance.
        caused: (n_pairs,) what they change of the two-terminal resistances (ohm).
        slopes: (n_pairs, 4 n) its derivatives by their parameters.
        covered: Electrodes under them, whose resistance is treated as unknown.
        shapes: (n_pairs, 2 k) further changes due to small contacts, which are anisotropic, for one standard deviation
            of each (ohm); None: only discs were fitted.
        doubts: (5,) remaining doubts after a search without a result, see `refitted`; None: there was no search.
        poor: What it leaves of the data beyond noise, squared and in units of the noise's variance, if that is more
            than usual although all else was tried, and contacts cannot be judged one by one; 0 of all others.
    """

    params: Floats
    cost: float
    normal: Floats
    caused: Floats
    slopes: Floats
    covered: tuple[int, ...] = ()
    shapes: Floats | None = None
    doubts: Floats | None = None
    poor: float = 0.0

    @property
    def covariance(self) -> Floats:
        """Of all contacts together (4 n, 4 n)."""
        return inverse(np.ascontiguousarray(self.normal))

    @property
    def covariances(self) -> list[Floats]:
        """Of each contact (4, 4)."""
        starts = range(0, self.params.size, PER_CONTACT)
        whole = self.covariance if starts else np.empty((0, 0))
        return [np.ascontiguousarray(whole[at : at + PER_CONTACT, at : at + PER_CONTACT]) for at in starts]


def nothing(n_pairs: int, cost: float = 0.0) -> Solution:
    """Data explained by no contact; its cost is unknown unless given."""
    return Solution(np.empty((0, PER_CONTACT)), cost, np.empty((0, 0)), np.zeros(n_pairs), np.empty((n_pairs, 0)))


@njit(cache=True, nogil=True)
def inverse(normal: Floats) -> Floats:
    """Inverse of a positive definite matrix whose parameters have unlike units (Gauss and Jordan)."""
    n = len(normal)
    scale, out = np.empty(n), np.empty_like(normal)
    for i in range(n):
        scale[i] = 1 / np.sqrt(normal[i, i])
    for i in range(n):
        for k in range(n):
            out[i, k] = normal[i, k] * scale[i] * scale[k]
    for pivot in range(n):
        share = 1 / out[pivot, pivot]
        out[pivot, pivot] = 1.0
        for k in range(n):
            out[pivot, k] *= share
        for i in range(n):
            share = out[i, pivot]
            if i != pivot:
                out[i, pivot] = 0.0
                for k in range(n):
                    out[i, k] -= share * out[pivot, k]
    for i in range(n):
        for k in range(i + 1):
            out[i, k] = out[k, i] = (out[i, k] + out[k, i]) / 2 * scale[i] * scale[k]
    return out


def effect_std(covariance: Floats) -> float:
    """How surely there is a contact: deviation of its effect (m2), its place and size taken as given.

    From their covariance (4, 4). Where the place is unknown, the effect is less certain, but not whether it is zero.
    """
    return float(1 / np.sqrt(inverse(np.ascontiguousarray(covariance))[2, 2]))


def similarity_prior(count: int, both: Ints, together: float) -> Floats:
    """Information (4 n, 4 n) about so many contacts: two of them, `both`, have about half of an effect `together` (m2)
    each."""
    apart = np.zeros((count, PER_CONTACT))
    apart[both, 2] = np.array([1, -1]) / (_ALIKE * together)
    return np.outer(apart, apart)
