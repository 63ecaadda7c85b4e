"""What a mesh misses of the potentials that contacts of patches cause close by."""

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import ModelError
from ohmskin.forward.assembly import local_stiffness
from ohmskin.forward.logarithm import add_flux, log_means
from ohmskin.forward.transfer import TransferModel
from ohmskin.geometry.periodic import folded, shortest, tree

_NEAR = 2.5  # edges of the mesh from a contact within which it does not resolve what the contact causes
_ALIKE = 1e-9  # m, to which places and sides are the same where patches lie alike
_MOST_ALIKE = 32  # tables of the logarithm's means, of 0.7 MB each
_AROUND = 4.0  # edges round a patch to which what the mesh makes of its contacts is looked at

Table = tuple[Ints, Ints, Ints, NDArray[np.int16], Floats]
"""Contacts (n, n_own) of each of n patches, -1 where it has fewer; the number (n,) of contacts near it, -1 before that
is known; these contacts (n, n_near); what the mesh misses there of each of its own (n, n_near, n_own), in a unit (n,)
(ohm)."""


class NearField:
    """What a mesh misses of the potentials that contacts of a patch cause at contacts nearby, on a flat sheet."""

    def __init__(
        self, model: TransferModel, points: Floats, patches: Ints, sizes: Floats, corners: Ints, weights: Floats
    ) -> None:
        mesh = model.mesh
        if mesh.nodes.shape[1] != 2:
            raise ModelError("contacts with sizes need a flat sheet; leave sizes")
        self.model, self.points, self.sizes = model, points, sizes
        self._tensors = model.tensors
        self.corners, self.weights = corners, weights
        self._element = mesh.locate(points)[0]
        order = np.argsort(patches, kind="stable")
        own = np.split(order, np.unique(patches[order], return_index=True)[1][1:])
        self._middles = np.array([points[one].mean(axis=0) for one in own])
        self._half = max(float(np.linalg.norm(points[one] - points[one].mean(axis=0), axis=1).max()) for one in own)
        self._own, self._edge = own, float(np.sqrt(4 / np.sqrt(3) * mesh.measures[self._element].max()))
        self._middles = folded(self._middles, mesh.period)
        self._nodes, self._tree = tree(mesh.nodes, mesh.period), tree(self._middles, mesh.period)
        self._reach = 2 * self._half + _NEAR * self._edge  # m, from the middle of a patch
        corner = np.arange(mesh.elements.size)
        shape = (mesh.n_nodes, mesh.n_elem)
        self._elements_of = sp.csr_array((np.ones(corner.size), (mesh.elements.ravel(), corner // 3)), shape)
        self._alike: dict[bytes, Floats] = {}
        self._table: Table | None = None

    def table(self, slots: Ints) -> Table:
        """Contacts of each patch and near it, and what the mesh misses: what `closed` takes, of `slots` at least."""
        if self._table is None:
            own = np.full((len(self._own), max(map(len, self._own))), -1)
            for slot, points in enumerate(self._own):
                own[slot, : len(points)] = points
            around = self._tree.query_ball_point(self._middles, self._reach, return_length=True)
            shape = len(own), int(around.max()) * own.shape[1]  # of which only what is written takes memory
            missed = np.zeros((*shape, own.shape[1]), np.int16)  # a quarter of the memory, to 2e-5 of a peak
            self._table = own, np.full(len(own), -1), np.zeros(shape, int), missed, np.zeros(len(own))
        _, count, near, missed, unit = self._table
        for slot in slots[count[slots] < 0].tolist():
            points, values = self._missed(slot)
            count[slot], near[slot, : len(points)] = len(points), points
            unit[slot] = float(np.abs(values).max(initial=1e-300)) / np.iinfo(np.int16).max
            missed[slot, : len(points), : values.shape[1]] = np.rint(values / unit[slot])
        return self._table

    def _missed(self, slot: int) -> tuple[Ints, Floats]:
        """Contacts (n_near,) near a patch, and what the mesh misses there (n_near, n_own) of the patch's contacts."""
        mesh, own, middle = self.model.mesh, self._own[slot], self._middles[slot]
        even = self._even(self._element[own[0]])
        turn = np.linalg.inv(even).T
        inside = np.zeros(mesh.n_nodes, bool)
        inside[self._nodes.query_ball_point(middle, self._half + _AROUND * self._edge)] = True
        touched = np.unique(self._elements_of[inside].indices)
        count = inside[mesh.elements[touched]].sum(axis=1)
        part, cut = touched[count == 3], touched[count < 3]
        nodes, matrix = local_stiffness(mesh.gradients[part] @ even, mesh.measures[part], mesh.elements[part])
        held = np.zeros(mesh.n_nodes, bool)
        held[mesh.elements[cut]] = True
        held = held[nodes]
        row = np.full(mesh.n_nodes, -1)
        row[nodes] = np.arange(len(nodes))
        near = np.concatenate([self._own[k] for k in sorted(self._tree.query_ball_point(middle, self._reach))])
        places, points, contacts = (
            shortest(some - middle, mesh.period) @ turn
            for some in (mesh.nodes[nodes], self.points[near], self.points[own])
        )
        sides = self.sizes[own] @ turn
        exact = self._log_means(points, contacts, sides)
        resolved = (row[self.corners[near]] >= 0).all(axis=1)
        near, points, exact = near[resolved], points[resolved], exact[resolved]
        rim = row[mesh.boundary[(row[mesh.boundary] >= 0).all(axis=1)]]
        mirrored = self._mirrored(contacts, places[rim])
        beyond = [one for one in mirrored if (mesh.locate(middle + one @ even.T)[0] < 0).all()]
        load = np.zeros((len(nodes), len(own)))
        for corner, weight in zip(row[self.corners[own]].T, self.weights[own].T, strict=True):
            load[corner, np.arange(len(own))] += weight
        there = np.zeros((held.sum(), len(own)))
        for image in [contacts, *beyond]:
            there -= log_means(places[held], image, 1e-9 * sides) / (2 * np.pi)
            add_flux(load, rim, places[rim], image, np.zeros(2))
        for image in beyond:
            exact = exact + log_means(points, image, sides)
        free = ~held
        values = np.empty((len(nodes), len(own)))
        values[held] = there
        values[free] = np.linalg.solve(matrix[np.ix_(free, free)], load[free] - matrix[np.ix_(free, held)] @ there)
        meshed = np.einsum("pk,pko->po", self.weights[near], values[row[self.corners[near]]])
        return near, np.asarray((exact / (-2 * np.pi) - meshed) / self.model.conductivity[self._element[own]])

    def _log_means(self, points: Floats, contacts: Floats, sides: Floats) -> Floats:
        """`log_means`, computed once for patches among patches that lie alike, whichever comes first."""
        rounded = np.rint(np.vstack([points, contacts, sides.reshape(-1, 2)]) / _ALIKE) + 0.0
        if (known := self._alike.get(alike := rounded.tobytes())) is None:
            points, contacts, sides = np.split(_ALIKE * rounded, np.cumsum([len(points), len(contacts)]))
            known = log_means(points, contacts, sides.reshape(-1, 2, 2))
            if len(self._alike) < _MOST_ALIKE:
                self._alike[alike] = known
        return known

    def _even(self, element: int) -> Floats:
        """Directions (2, 2), as columns, of coordinates in which the sheet there conducts alike in all directions."""
        if self._tensors.ndim == 1:
            return np.eye(2)
        root = np.linalg.cholesky(self._tensors[element])
        return np.asarray(root / np.sqrt(np.linalg.det(root)))

    @staticmethod
    def _mirrored(sources: Floats, ends: Floats) -> list[Floats]:
        """Mirror images (n, 2) of contacts about the origin beyond the edges of the rim closest to it: of a corner, all
        three."""
        mirrors = list[tuple[Floats, Floats]]()
        for start, end in ends[np.argsort(np.linalg.norm(ends.mean(axis=1), axis=1))]:
            normal = np.array([end[1] - start[1], start[0] - end[0]]) / np.linalg.norm(end - start)
            if all(abs(normal @ other) < 0.5 for _, other in mirrors) and len(mirrors) < 2:
                mirrors.append((start, normal))
        images = [sources]
        for start, normal in mirrors:
            images += [image - 2 * ((image - start) @ normal)[:, None] * normal for image in images]
        return images[1:]
