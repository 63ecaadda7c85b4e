"""Local changes of a skin as exact updates of low rank: nothing is factorised again.

If the conductance matrix of the skin changes by a symmetric M at a few nodes only, then with the Green's matrix G of
the unchanged skin at these nodes and the potentials X that the electrodes cause there (Woodbury)

    R = R_0 - X^T M (I + G M)^-1 X,

exactly, at the cost of a dense system in these nodes, whatever the size of the mesh.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import ModelError
from ohmskin.forward.assembly import assemble, local_stiffness
from ohmskin.forward.quadrature import Surface
from ohmskin.forward.transfer import TransferModel
from ohmskin.geometry import Mesh

_BLOCK = 256  # columns solved at once


class LocalUpdate:
    """Transfer resistances of a skin that changes at some of its nodes.

    Args:
        model: The unchanged skin.
        nodes: (n,) nodes at which it may change; all unless given. Memory is 8 n^2 bytes.

    Attributes:
        nodes: (n,) the nodes, rising.
        green: (n, n) potential at each node for 1 A into each node and out of the first electrode (V).
        caused: (n, n_elec) potential at each node for 1 A into each electrode and out of the first, less its mean over
            the electrodes (V).

    Raises:
        ModelError: If `nodes` are not distinct nodes of the mesh.
    """

    def __init__(self, model: TransferModel, nodes: ArrayLike | None = None) -> None:
        mesh = model.mesh
        chosen = np.arange(mesh.n_nodes) if nodes is None else np.unique(np.asarray(nodes))
        if chosen.dtype.kind not in "iu" or not len(chosen) or chosen[0] < 0 or chosen[-1] >= mesh.n_nodes:
            raise ModelError(f"nodes to update must be integers within 0..{mesh.n_nodes - 1}, one at least")
        self.model, self.nodes = model, chosen.astype(np.int64)
        system = assemble(mesh, model.electrodes, model.conductivity, model.quadratures, model.gradients)
        count = system.matrix.shape[0]
        factor = system.factorise()
        self.green: Floats = np.empty((len(chosen), len(chosen)))
        for first in range(0, len(chosen), _BLOCK):
            block = self.nodes[first : first + _BLOCK]
            load = np.zeros((count, len(block)))
            load[block, np.arange(len(block))] = 1.0
            self.green[first : first + _BLOCK] = factor.solve(load)[self.nodes].T  # symmetric: rows are faster to write
        # for currents that sum to zero any multiple of ones may be taken off; this makes the result zero-mean as S is
        caused = model.potentials[self.nodes]
        self.caused: Floats = np.ascontiguousarray(caused - caused.mean(axis=1, keepdims=True))

    def transfer_resistance(self, nodes: Ints, change: Floats) -> Floats:
        """(n_elec, n_elec) transfer resistances in ohms, as `TransferModel.transfer_resistance`.

        Args:
            nodes: (m,) nodes that change, distinct and among `self.nodes`.
            change: (m, m) symmetric change of the conductance matrix there, with rows that sum to zero (siemens).

        Raises:
            ModelError: If nodes or the change are not like that, or the changed skin no longer conducts.
        """
        rows = np.searchsorted(self.nodes, nodes)
        if (rows >= len(self.nodes)).any() or (self.nodes[np.minimum(rows, len(self.nodes) - 1)] != nodes).any():
            raise ModelError("some nodes to change are not among those chosen for the update; choose them there")
        if change.shape != (len(rows), len(rows)) or len(np.unique(rows)) != len(rows):
            raise ModelError(f"change has shape {change.shape}; need ({len(rows)}, {len(rows)}) for distinct nodes")
        off = max(np.abs(change - change.T).max(initial=0.0), np.abs(change.sum(axis=0)).max(initial=0.0))
        if not off <= 1e-9 * np.abs(change).max(initial=0.0) < np.inf:
            raise ModelError("change must be finite and symmetric, with rows that sum to zero")
        return self.after(rows, change)

    def after(self, rows: Ints, change: Floats) -> Floats:
        """As `transfer_resistance`, unchecked: `rows` (m,) are places in `nodes`."""
        green, caused = self.green[np.ix_(rows, rows)], self.caused[rows]
        try:
            drop = caused.T @ change @ np.linalg.solve(np.eye(len(change)) + green @ change, caused)
        except np.linalg.LinAlgError:
            raise ModelError("the change leaves a part of the skin without conductance; change it less") from None
        return np.asarray(self.model.transfer_resistance - (drop + drop.T) / 2)

    def with_conductivity(self, elements: ArrayLike, conductivity: ArrayLike) -> Floats:
        """(n_elec, n_elec) transfer resistances in ohms when some elements (m,) get another conductivity (m,), siemens.

        Where the conductivity is a tensor, its directions stay. Costs a dense system in the elements' nodes.

        Raises:
            ModelError: If an element is named twice or not there, or a conductivity is not positive.
        """
        where, given = np.atleast_1d(np.asarray(elements)), np.atleast_1d(np.asarray(conductivity, float))
        mesh = self.model.mesh
        if where.ndim != 1 or where.dtype.kind not in "iu" or len(np.unique(where)) != len(where):
            raise ModelError("elements to change must be distinct integers (m,)")
        if len(where) and not (where.min() >= 0 and where.max() < mesh.n_elem):
            raise ModelError(f"elements {where.min()}..{where.max()} to change; there are {mesh.n_elem}")
        given = np.array(np.broadcast_to(given, where.shape)) if given.size == 1 else given
        if given.shape != where.shape or not (np.isfinite(given) & (given > 0)).all():
            raise ModelError(f"give one positive conductivity or ({len(where)},), one for each element to change")
        weights = (given - self.model.conductivity[where]) * mesh.measures[where]
        nodes, change = local_stiffness(self.model.gradients[where], weights, mesh.elements[where])
        return self.transfer_resistance(nodes, change)


class FloatingPatches:
    """A skin with a layer of floating conductors that are pressed on it and short it where they touch.

    Each patch is a conductor of one potential and no net current, joined to the skin at its points by conductances
    that the pressure makes. Any press is exact on the mesh of the model: electrodes and patches are the same thing to
    the skin, but electrodes stay and are factorised in, and patches come and go as an update of low rank.

    Args:
        model: The untouched skin.
        points: (n_points, dim) where the patches can touch it (m). Points off the mesh are left out, see `kept`.
        patches: (n_points,) number of the patch that each point belongs to.

    Attributes:
        kept: (n_points,) which of the points lie on the mesh; in space, within a quarter of an edge of its surface.
        points, patches: Those points and their patches.
        update: The local update it makes.

    Raises:
        ModelError: If shapes do not fit or no point lies on the mesh.
    """

    def __init__(self, model: TransferModel, points: ArrayLike, patches: ArrayLike) -> None:
        where, owner = np.asarray(points, float), np.asarray(patches)
        if owner.shape != (len(where),) or owner.dtype.kind not in "iu":
            given = f"patches have shape {owner.shape} and type {owner.dtype}"
            raise ModelError(f"{given}; need integers ({len(where)},), one per point")
        if where.ndim != 2 or where.shape[1] != model.mesh.nodes.shape[1]:
            raise ModelError(f"patch points have shape {where.shape}; this mesh needs (n, {model.mesh.nodes.shape[1]})")
        corners, weights, self.kept = _on_skin(model.mesh, where)
        if not self.kept.any():
            raise ModelError("no point of a patch lies on the mesh; give points in its coordinates (m)")
        self.points, self.patches = where[self.kept], owner[self.kept].astype(np.int64)
        corners = corners[self.kept]
        self.update = LocalUpdate(model, np.unique(corners))
        self._corners: Ints = np.searchsorted(self.update.nodes, corners)
        self._weights: Floats = np.ascontiguousarray(weights[self.kept])

    @property
    def model(self) -> TransferModel:
        """The untouched skin."""
        return self.update.model

    def transfer_resistance(self, conductance: ArrayLike) -> Floats:
        """(n_elec, n_elec) transfer resistances in ohms, as `TransferModel.transfer_resistance`.

        Args:
            conductance: (n_points,) between skin and patch at each of `points`, 0 where they do not touch (siemens).

        Raises:
            ModelError: If a conductance is negative or not finite, or there is not one for each point.
        """
        joint = np.asarray(conductance, float)
        if joint.shape != (len(self.points),):
            raise ModelError(f"conductances have shape {joint.shape}; give ({len(self.points)},), one per point")
        if not (joint.min() >= 0 and joint.max() < np.inf):
            raise ModelError("a patch conductance is negative or not finite; give 0 where a patch does not touch")
        touching = np.flatnonzero(joint)
        if not len(touching):
            return self.model.transfer_resistance
        corners, weights = self._corners[touching], self._weights[touching]
        return self.update.after(*patch_change(corners, weights, joint[touching], self.patches[touching]))


def _on_skin(mesh: Mesh, points: Floats) -> tuple[Ints, Floats, NDArray[np.bool_]]:
    """Nodes (n, k) and barycentric coordinates (n, k) of points on the skin, and which (n,) are on it."""
    if mesh.nodes.shape[1] == 2:
        element, weights = mesh.locate(points)
        return mesh.elements[element], weights, element >= 0
    nodes, weights, distance = Surface(mesh).project(points)
    corners = mesh.nodes[nodes]
    edge = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    return nodes, weights, distance <= edge / 4


def patch_change(corners: Ints, weights: Floats, joint: Floats, patches: Ints) -> tuple[Ints, Floats]:
    """What floating patches add to the conductance matrix: the nodes (m,) concerned and M (m, m) in siemens.

    M = sum over patches of A^T (diag(g) - g g^T / sum(g)) A, with A the interpolation to the points of the patch.

    Args:
        corners, weights: (n, k) nodes and barycentric coordinates of each touching point.
        joint: (n,) conductance of each (siemens).
        patches: (n,) the patch of each.
    """
    nodes, at = np.unique(corners, return_inverse=True)
    (numbers, owner), m = np.unique(patches, return_inverse=True), len(nodes)
    at, drawn = at.reshape(corners.shape), joint[:, None] * weights
    where, products = at[:, :, None] * m + at[:, None, :], drawn[:, :, None] * weights[:, None, :]
    alone = np.bincount(where.ravel(), products.ravel(), m * m).reshape(m, m)
    by_patch = np.bincount((owner[:, None] * m + at).ravel(), drawn.ravel(), len(numbers) * m).reshape(-1, m)
    return nodes, alone - by_patch.T @ (by_patch / np.bincount(owner, joint)[:, None])
