"""Presses on a layer of floating patches, compiled: the system of one, and many at once."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ohmskin.arrays import Floats, Ints


@njit(cache=True, nogil=True)
def closed(
    touching: Ints, conductance: Floats, corners: Ints, weights: Floats, caused: Floats, green: Floats, slots: Ints,
    own: Ints, count: Ints, near: Ints, missed: NDArray[np.int16], unit: Floats,
) -> tuple[Floats, Floats]:  # fmt: skip
    """The lower half of G + 1/g (n, n), and [X, B] (n, n_elec + patches that touch) of `ohmskin.forward.patches` (ohm).

    Args:
        touching: (n,) numbers of the contacts that touch; each has a `conductance` (n,) (siemens).
        corners, weights: (n_points, k) nodes of each contact's element, and its barycentric coordinates.
        caused: (n_points, n_elec) potentials that the electrodes cause at the contacts (ohm).
        green: (n_nodes, n_nodes) potentials that nodes cause at each other (ohm).
        slots: (n_points,) the patch of each contact, from 0.
        own, count, near, missed, unit: Of the near field of each patch, `ohmskin.forward.near_field.Table`.
    """
    n, n_elec, n_corners = len(touching), caused.shape[1], corners.shape[1]
    row, node, member = np.full(len(corners), -1), np.full(len(green), -1), np.full(len(own), -1)
    nodes, patches = np.empty(n * n_corners, np.int64), np.empty(n, np.int64)
    n_nodes, n_patches = 0, 0
    for i in range(n):
        row[touching[i]] = i
        for corner in corners[touching[i]]:
            if node[corner] < 0:
                node[corner], nodes[n_nodes] = n_nodes, corner
                n_nodes += 1
        if member[slots[touching[i]]] < 0:
            member[slots[touching[i]]], patches[n_patches] = n_patches, slots[touching[i]]
            n_patches += 1
    half = np.zeros((n, n_nodes))
    for i in range(n):
        for c in range(n_corners):
            weight, at = weights[touching[i], c], corners[touching[i], c]
            for m in range(n_nodes):
                half[i, m] += weight * green[at, nodes[m]]
    system = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            for c in range(n_corners):
                system[i, j] += half[i, node[corners[touching[j], c]]] * weights[touching[j], c]
        system[i, i] += 1 / conductance[i]
    for patch in patches[:n_patches]:
        for k in range(count[patch]):
            at = row[near[patch, k]]
            if at < 0:
                continue
            for o in range(own.shape[1]):
                by = row[own[patch, o]] if own[patch, o] >= 0 else -1
                if by >= 0:
                    system[max(at, by), min(at, by)] += unit[patch] * missed[patch, k, o] * (1.0 if at == by else 0.5)
    load = np.zeros((n, n_elec + n_patches))
    for i in range(n):
        for e in range(n_elec):  # to assign a row takes ten times as long to compile
            load[i, e] = caused[touching[i], e]
        load[i, n_elec + member[slots[touching[i]]]] = 1.0
    return system, load


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
    out: Floats, untouched: Floats, first: Ints, touching: Ints, conductance: Floats, corners: Ints, weights: Floats,
    caused: Floats, green: Floats, slots: Ints, own: Ints, count: Ints, near: Ints, missed: NDArray[np.int16],
    unit: Floats,
) -> None:  # fmt: skip
    """Transfer resistances (n, n_elec, n_elec) in ohms of n cases.

    Args:
        out: Filled with them.
        untouched: (n_elec, n_elec) of the untouched skin (ohm).
        first: (n + 1,) where each case's contacts begin among `touching` (m,), which have a `conductance` (m,).
        corners, weights, caused, green, slots, own, count, near, missed, unit: As of `closed`.
    """
    n_elec = caused.shape[1]
    for case in range(len(first) - 1):
        its = slice(first[case], first[case + 1])
        if first[case] == first[case + 1]:
            out[case] = untouched
            continue
        system, load = closed(
            touching[its], conductance[its], corners, weights, caused, green, slots, own, count, near, missed, unit
        )
        _divide(np.linalg.cholesky(system).astype(np.float64), load)
        gram = np.dot(load.T, load)
        floating: Floats = np.ascontiguousarray(gram[n_elec:, :n_elec])
        lower = np.linalg.cholesky(np.ascontiguousarray(gram[n_elec:, n_elec:]))
        _divide(lower, floating)
        out[case] = untouched - gram[:n_elec, :n_elec] + np.dot(floating.T, floating)
