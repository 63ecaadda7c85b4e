"""Touches at places known beforehand, simulated in microseconds: exact on the mesh, whatever its size.

A touch multiplies the conductivity of its elements by 1 + f. With K = B^T B what these elements add to the conductance
matrix, G the Green's matrix of the untouched skin at their nodes and X the potentials that the electrodes cause there,
Woodbury's identity and B G B^T = W diag(a) W^T give

    R(f) = R_0 - Y^T diag(f / (1 + f a)) Y,      Y = W^T B X,

for touches of any strength. Rows of Y that vanish, potentials that no current from outside makes, are left out: what
is left of a touch is about as many modes as it has nodes on its outline (11 of a square of 3 x 3 cells). Several
touches are a dense system in their modes; where they overlap, one touches the other from inside and all modes count.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from ohmskin.arrays import Bools, Floats, Ints
from ohmskin.errors import ModelError
from ohmskin.forward.assembly import local_stiffness
from ohmskin.forward.transfer import TransferModel
from ohmskin.forward.update import LocalUpdate


class TouchTable:
    """Transfer resistances of a skin touched at any of a set of places. Where touches overlap, their changes add up.

    Args:
        model: The untouched skin.
        touches: Elements (n,) of each place; all of a place change by the same factor.

    Attributes:
        coupling: Y (n_places, n_modes, n_elec), first the modes that electrodes can measure at all, rows of zeros last.
        spread: a (n_places, n_modes), eigenvalues (1).

    Raises:
        ModelError: If there is no place, or one has no elements, or names one twice or one that is not there.
    """

    def __init__(self, model: TransferModel, touches: Sequence[ArrayLike]) -> None:
        mesh, chosen = model.mesh, [np.asarray(touch) for touch in touches]
        for k, elements in enumerate(chosen):
            good = elements.ndim == 1 and elements.dtype.kind in "iu" and len(elements) == len(np.unique(elements)) > 0
            if not good or elements.min() < 0 or elements.max() >= mesh.n_elem:
                raise ModelError(f"place {k} needs elements (n,), distinct, within 0..{mesh.n_elem - 1}, one at least")
        if not chosen:
            raise ModelError("a touch table needs one place at least")
        self.model = model
        update = LocalUpdate(model, np.unique(np.concatenate([mesh.elements[elements].ravel() for elements in chosen])))
        self._green = update.green
        modes = [self._modes_of(update, elements) for elements in chosen]
        member = np.zeros((len(chosen), mesh.n_elem), np.float32)
        for k, elements in enumerate(chosen):
            member[k, elements] = 1
        self._overlap = member @ member.T > 0
        self._all: Ints = np.array([len(spread) for spread, *_ in modes])
        self._measured: Ints = np.array([measured for *_, measured in modes])
        self.spread, self.coupling, self._basis, self._nodes = map(stacked, list(zip(*modes, strict=True))[:4])

    @staticmethod
    def _modes_of(update: LocalUpdate, elements: Ints) -> tuple[Floats, Floats, Floats, Ints, int]:
        mesh, model = update.model.mesh, update.model
        weights = model.conductivity[elements] * mesh.measures[elements]
        nodes, stiffness = local_stiffness(model.gradients[elements], weights, mesh.elements[elements])
        strength, vectors = np.linalg.eigh(stiffness)
        kept = strength > 1e-12 * strength[-1]
        factor = (vectors[:, kept] * np.sqrt(strength[kept])).T
        rows = np.searchsorted(update.nodes, nodes)
        inner = factor @ update.green[np.ix_(rows, rows)] @ factor.T
        spread, turn = np.linalg.eigh((inner + inner.T) / 2)
        basis = turn.T @ factor
        coupling = basis @ update.caused[rows]
        size = np.linalg.norm(coupling, axis=1)
        measured = size > 1e-12 * size.max()
        order = np.argsort(~measured, kind="stable")  # those that are felt from outside come first
        return spread[order], coupling[order], basis[order], rows, int(measured.sum())

    def __len__(self) -> int:
        return len(self.spread)

    def transfer_resistance(self, places: ArrayLike, changes: ArrayLike) -> Floats:
        """(n_elec, n_elec) transfer resistances in ohms under k touches.

        Args:
            places: (k,) numbers of places.
            changes: (k,) relative conductivity change f of each (1), not negative.

        Raises:
            ModelError: As `many`.
        """
        return np.asarray(self.many(np.atleast_1d(places)[None], np.atleast_1d(changes)[None])[0])

    def many(self, places: ArrayLike, changes: ArrayLike, threads: int = 1) -> Floats:
        """(n, n_elec, n_elec) transfer resistances in ohms of n cases of up to k touches each.

        Args:
            places: (n, k) numbers of places; -1 where a scene has fewer touches.
            changes: (n, k) relative conductivity change f of each (1), not negative.
            threads: Number of threads that share the work; they do not hold Python's global lock.

        Raises:
            ModelError: If a place is not there, a change is negative or not finite, or the shapes do not fit.
        """
        where, change = np.asarray(places), np.asarray(changes, float)
        if where.ndim != 2 or where.dtype.kind not in "iu" or where.shape != change.shape:
            raise ModelError(f"places and changes have shapes {where.shape} and {change.shape}; give both (n, k)")
        if where.size and not (where.min() >= -1 and where.max() < len(self)):
            raise ModelError(f"places {where.min()}..{where.max()}; there are {len(self)} (from 0), -1 for none")
        if not ((change >= 0) & (change < np.inf)).all():
            raise ModelError("a conductivity change is negative or not finite; use LocalUpdate to lower it")
        where, change = np.ascontiguousarray(where, dtype=np.int64), np.ascontiguousarray(change)
        n_elec = len(self.model.electrodes)
        out = np.empty((len(where), n_elec, n_elec))
        untouched = self.model.transfer_resistance

        def part(share: slice) -> None:
            known = (self._basis, self._nodes, self._measured, self._all, self._overlap, self._green)
            touched(untouched, self.coupling, self.spread, *known, where[share], change[share], out[share])

        cuts = np.linspace(0, len(where), threads + 1).astype(int)
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(part, [slice(low, high) for low, high in pairwise(cuts)]))
        return out


def stacked(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Arrays of different lengths in one, the shorter ones filled up with zeros."""
    whole = np.zeros((len(arrays), *np.max([array.shape for array in arrays], axis=0)), arrays[0].dtype)
    for k, array in enumerate(arrays):
        whole[k][tuple(slice(n) for n in array.shape)] = array
    return whole


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def touched(
    untouched: Floats, coupling: Floats, spread: Floats, basis: Floats, nodes: Ints, measured: Ints, every: Ints,
    overlap: Bools, green: Floats, places: Ints, changes: Floats, out: Floats,
) -> None:  # fmt: skip
    """`TouchTable.many`, scene by scene."""
    n_elec = len(untouched)
    for scene in range(len(places)):
        here = out[scene]
        n_touches, newest = 0, 0
        for k in range(places.shape[1]):
            if places[scene, k] >= 0 and changes[scene, k] > 0.0:
                n_touches += 1
                newest = k
        if n_touches == 1:  # one touch is a sum over its modes
            place, f = places[scene, newest], changes[scene, newest]
            here[:] = untouched
            for m in range(measured[place]):
                weight, row = f / (1.0 + f * spread[place, m]), coupling[place, m]
                for i in range(n_elec):
                    own = weight * row[i]
                    for j in range(n_elec):
                        here[i, j] -= own * row[j]
            continue
        counts = measured
        for k in range(places.shape[1]):
            for other in range(k):
                one, two = places[scene, k], places[scene, other]
                if one >= 0 and two >= 0 and overlap[one, two]:
                    counts = every
        size = 0
        for k in range(places.shape[1]):
            if places[scene, k] >= 0:
                size += counts[places[scene, k]]
        system, load = np.zeros((size, size)), np.zeros((size, n_elec))
        first = 0
        for k in range(places.shape[1]):
            p = places[scene, k]
            if p < 0:
                continue
            root = np.sqrt(changes[scene, k])
            for m in range(counts[p]):
                system[first + m, first + m] = 1.0 + changes[scene, k] * spread[p, m]
                load[first + m] = root * coupling[p, m]
            second = 0
            for other in range(k):
                q = places[scene, other]
                if q < 0:
                    continue
                between = _between(basis[p, : counts[p]], nodes[p], basis[q, : counts[q]], nodes[q], green)
                scale = root * np.sqrt(changes[scene, other])
                system[first : first + counts[p], second : second + counts[q]] = scale * between
                second += counts[q]
            first += counts[p]
        lower = np.linalg.cholesky(system)
        for i in range(size):
            for m in range(i):
                for c in range(n_elec):
                    load[i, c] -= lower[i, m] * load[m, c]
            load[i] /= lower[i, i]
        here[:] = untouched - np.dot(load.T, load)


@njit(cache=True, nogil=True)
def _between(one: Floats, one_nodes: Ints, other: Floats, other_nodes: Ints, green: Floats) -> Floats:
    """B_p G B_q^T: what the modes of one place cause at those of another."""
    between = np.empty((len(one_nodes), len(other_nodes)))
    for i in range(len(one_nodes)):
        for j in range(len(other_nodes)):
            between[i, j] = green[one_nodes[i], other_nodes[j]]
    caused: Floats = np.dot(one, np.dot(between, other.T))
    return caused
