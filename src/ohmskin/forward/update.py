"""Local changes of a skin as exact updates of low rank: nothing is factorised again.

If the conductance matrix of the skin changes by a symmetric M at a few nodes only, then with the Green's matrix G of
the unchanged skin at these nodes and the potentials X that the electrodes cause there (Woodbury)

    R = R_0 - X^T M (I + G M)^-1 X,

exactly, at the cost of a dense system in these nodes, whatever the size of the mesh.
"""

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import ModelError
from ohmskin.forward.assembly import assemble, local_stiffness
from ohmskin.forward.transfer import TransferModel

_BLOCK = 256  # columns solved at once


class LocalUpdate:
    """Transfer resistances of a skin that changes at some of its nodes.

    Args:
        model: The unchanged skin.
        nodes: (n,) nodes at which it may change; all unless given. Memory is 8 n^2 bytes if all do.

    Attributes:
        nodes: (n,) the nodes, rising.
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
        self._factor, self._size = system.factorise(), system.matrix.shape[0]
        self._green: Floats = np.empty((len(chosen), len(chosen)))  # row by row, when a node is first asked for
        self._known = np.zeros(len(chosen), bool)
        # for currents that sum to zero any multiple of ones may be taken off; this makes the result zero-mean as S is
        caused = model.potentials[self.nodes]
        self.caused: Floats = np.ascontiguousarray(caused - caused.mean(axis=1, keepdims=True))

    @property
    def green(self) -> Floats:
        """(n, n) potential at each node for 1 A into each node and out of the first electrode (V)."""
        self._solve(np.arange(len(self.nodes)))
        return self._green

    def green_among(self, rows: Ints, columns: Ints) -> Floats:
        """(m, k) of `green`, at `rows` (m,) and `columns` (k,) of it."""
        return self.green_of(rows)[np.ix_(rows, columns)]

    def green_of(self, rows: Ints) -> Floats:
        """(n, n) whose `rows` (m,) are those of `green`; others may not be computed yet."""
        self._solve(rows)
        return self._green

    def _solve(self, rows: Ints) -> None:
        missing = rows[~self._known[rows]]
        for first in range(0, len(missing), _BLOCK):
            block = missing[first : first + _BLOCK]
            load = np.zeros((self._size, len(block)))
            load[self.nodes[block], np.arange(len(block))] = 1.0
            solved = self._factor.solve(load)[self.nodes].T  # symmetric: rows are faster to write, and from rows
            self._green[block] = np.ascontiguousarray(solved)
            self._known[block] = True

    def transfer_resistance(self, nodes: Ints, change: Floats) -> Floats:
        """(n_elec, n_elec) transfer resistances in ohms, as `TransferModel.transfer_resistance`.

        Args:
            nodes: (m,) nodes that change, distinct and among `self.nodes`.
            change: (m, m) symmetric change of the conductance matrix there, with rows that sum to zero (siemens).

        Raises:
            ModelError: If nodes or the change do not have these properties, or the changed skin no longer conducts.
        """
        rows = np.searchsorted(self.nodes, nodes)
        if (rows >= len(self.nodes)).any() or (self.nodes[np.minimum(rows, len(self.nodes) - 1)] != nodes).any():
            raise ModelError("some nodes to change are not among those chosen for the update; choose them there")
        if change.shape != (len(rows), len(rows)) or len(np.unique(rows)) != len(rows):
            raise ModelError(f"change has shape {change.shape}; need ({len(rows)}, {len(rows)}) for distinct nodes")
        off = max(np.abs(change - change.T).max(initial=0.0), np.abs(change.sum(axis=0)).max(initial=0.0))
        if not off <= 1e-9 * np.abs(change).max(initial=0.0) < np.inf:
            raise ModelError("change must be finite and symmetric, with rows that sum to zero")
        green, caused = self.green_among(rows, rows), self.caused[rows]
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
