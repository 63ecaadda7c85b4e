"""Many presses on a layer of floating patches at once, compiled: what `FloatingPatches.linearised` says of each."""

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _divide(lower: Floats, load: Floats) -> None:
    """Divides `load` (n, k) by a lower triangle (n, n), in place."""
    for i in range(len(load)):
        for m in range(i):
            for c in range(load.shape[1]):
                load[i, c] -= lower[i, m] * load[m, c]
        for c in range(load.shape[1]):
            load[i, c] /= lower[i, i]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def pressed(
    untouched: Floats, first: Ints, touching: Ints, conductance: Floats, corners: Ints, weights: Floats,
    caused: Floats, green: Floats, slots: Ints, own: Ints, near: Ints, missed: Floats, out: Floats,
) -> None:  # fmt: skip
    """Transfer resistances `out` (n, n_elec, n_elec) in ohms of n cases.

    Args:
        untouched: (n_elec, n_elec) of the untouched skin (ohm).
        first: (n + 1,) where each scene's contacts begin among `touching`.
        touching: (m,) numbers of the contacts that touch; each has a `conductance` (m,) (siemens).
        corners, weights: (n_points, k) nodes of each contact's element, and its barycentric coordinates.
        caused: (n_points, n_elec) potentials that the electrodes cause at the contacts (ohm).
        green: (n_nodes, n_nodes) potentials that nodes cause at each other (ohm).
        slots: (n_points,) the patch of each contact, from 0.
        own: (n_patches, n_own) contacts of each patch, -1 where it has fewer.
        near: (n_patches, n_near) contacts near each patch, -1 likewise.
        missed: (n_patches, n_near, n_own) what the mesh misses there (ohm).
        out: Filled.
    """
    n_elec, n_corners = caused.shape[1], corners.shape[1]
    row = np.full(len(corners), -1)  # of contacts, nodes and patches in the scene at hand
    node = np.full(len(green), -1)
    member = np.full(len(own), -1)
    for case in range(len(first) - 1):
        points = touching[first[case] : first[case + 1]]
        n = len(points)
        if n == 0:
            out[case] = untouched
            continue
        nodes, patches = np.empty(n * n_corners, np.int64), np.empty(n, np.int64)
        n_nodes, n_patches = 0, 0
        for i in range(n):
            row[points[i]] = i
            for corner in corners[points[i]]:
                if node[corner] < 0:
                    node[corner], nodes[n_nodes] = n_nodes, corner
                    n_nodes += 1
            if member[slots[points[i]]] < 0:
                member[slots[points[i]]], patches[n_patches] = n_patches, slots[points[i]]
                n_patches += 1
        half = np.zeros((n, n_nodes))
        for i in range(n):
            for c in range(n_corners):
                weight, at = weights[points[i], c], corners[points[i], c]
                for m in range(n_nodes):
                    half[i, m] += weight * green[at, nodes[m]]
        system = np.zeros((n, n))
        for i in range(n):
            for j in range(i + 1):
                for c in range(n_corners):
                    system[i, j] += half[i, node[corners[points[j], c]]] * weights[points[j], c]
            system[i, i] += 1 / conductance[first[case] + i]
        for patch in patches[:n_patches]:
            for k in range(near.shape[1]):
                at = near[patch, k]
                if at < 0 or row[at] < 0:
                    continue
                for o in range(own.shape[1]):
                    by = own[patch, o]
                    if by >= 0 and row[by] >= 0:
                        i, j = max(row[at], row[by]), min(row[at], row[by])
                        system[i, j] += missed[patch, k, o] * (1.0 if i == j else 0.5)
        load = np.zeros((n, n_elec + n_patches))
        for i in range(n):
            load[i, :n_elec] = caused[points[i]]
            load[i, n_elec + member[slots[points[i]]]] = 1.0
        lower = np.linalg.cholesky(system).astype(np.float64)
        _divide(lower, load)
        gram = np.dot(load.T, load)
        floating: Floats = np.ascontiguousarray(gram[n_elec:, :n_elec])
        lower = np.linalg.cholesky(np.ascontiguousarray(gram[n_elec:, n_elec:]))
        _divide(lower, floating)
        out[case] = untouched - gram[:n_elec, :n_elec] + np.dot(floating.T, floating)
        for i in range(n):
            row[points[i]] = -1
        for m in range(n_nodes):
            node[nodes[m]] = -1
        for k in range(n_patches):
            member[patches[k]] = -1
