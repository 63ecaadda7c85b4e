"""A layer of floating conductors that short a sheet where they are pressed on it.

Each patch is a conductor of one potential and no net current, joined to the sheet at its contacts by conductances g
that the pressure makes. With the potentials X that the electrodes cause at the contacts, G the potential at each for
1 A into each, and B the patch of each, currents J into the patches of potentials U follow from

    (G + 1/g) J + B U = X,    B^T J = 0,    and    R = R_0 - X^T J.

Under a hard press the current enters within tenths of a millimetre of a patch's edge, which no mesh of the whole sheet
resolves. So where contacts have an area, the mesh's G is corrected near each patch: by the logarithm's exact mean over
the area of a contact, with mirror images beyond the rim, less what the mesh makes of that logarithm round the patch.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from ohmskin.arrays import Bools, Floats, Ints
from ohmskin.errors import ModelError
from ohmskin.forward.near_field import NearField, Table
from ohmskin.forward.patch_kernel import closed, pressed
from ohmskin.forward.quadrature import Surface
from ohmskin.forward.transfer import TransferModel
from ohmskin.forward.update import LocalUpdate
from ohmskin.geometry import Mesh

_TOO_COARSE = "the mesh is too coarse for patches so hard pressed; use a finer one"


class FloatingPatches:
    """A skin with a layer of floating conductors. A press costs a dense solution in the contacts that it closes.

    Args:
        model: The untouched skin.
        points: (n_points, dim) middles of the contacts between patches and skin (m). Those off the mesh are left out,
            see `kept`.
        patches: (n_points,) number of the patch that each contact belongs to.
        sizes: (n_points, 2) sides of each contact along x and y, or (n_points, 2, 2) two sides of each as rows (m), on
            a flat sheet; points of the mesh unless given.

    Attributes:
        kept: (n_points,) which of the points lie on the mesh; in space, within a quarter of an edge of its surface.
        points, patches: Those points, and their patches.
        sizes: (n_points, 2, 2) their sides as rows (m).
        update: The local update it makes.

    Raises:
        ModelError: If shapes do not fit, no point lies on the mesh, or there are sizes on a skin that is not flat.
    """

    def __init__(
        self, model: TransferModel, points: ArrayLike, patches: ArrayLike, sizes: ArrayLike | None = None
    ) -> None:
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
        self._slots: Ints = np.unique(self.patches, return_inverse=True)[1]
        self._solved = np.zeros(int(self._slots.max()) + 1, bool)  # patches whose contacts' potentials are known
        corners = corners[self.kept]
        self.update = LocalUpdate(model, np.unique(corners))
        self._corners: Ints = np.searchsorted(self.update.nodes, corners)
        self._weights: Floats = np.ascontiguousarray(weights[self.kept])
        self._caused: Floats = np.einsum("pk,pke->pe", self._weights, self.update.caused[self._corners])
        self.sizes: Floats = _as_rows(0.0 if sizes is None else sizes, len(where))[self.kept]
        none = np.full((len(self._solved), 0), -1)
        missed, zero = np.empty((*none.shape, 0), np.int16), np.zeros(len(none))
        self._nothing_near: Table = none, zero.astype(int), none, missed, zero
        self._near: NearField | None = None
        if sizes is not None:
            self._near = NearField(model, self.points, self.patches, self.sizes, corners, self._weights)

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
        return self.linearised(conductance)[0]

    def linearised(self, conductance: ArrayLike, groups: Ints | None = None) -> tuple[Floats, Floats]:
        """The transfer resistances, and the voltage over each of n contacts that touch.

        Args:
            conductance: As of `transfer_resistance`.
            groups: (n_points,) of contacts that are solved for together; what each group does to others is taken to
                first order, and no part of the voltages. None: all together.

        Returns:
            (n_elec, n_elec) in ohms; (n, n_elec) for 1 A into each electrode (ohm). With u_i and u_j of these, the
            two-terminal resistance of a pair falls by (u_i - u_j)^2 for each siemens more at that contact.

        Raises:
            ModelError: As `transfer_resistance`.
        """
        joint = np.asarray(conductance, float)
        if joint.shape != (len(self.points),):
            raise ModelError(f"conductances have shape {joint.shape}; give ({len(self.points)},), one per point")
        if not (joint.min() >= 0 and joint.max() < np.inf):
            raise ModelError("a patch conductance is negative or not finite; give 0 where a patch does not touch")
        touching = np.flatnonzero(joint)
        if not len(touching):
            return self.model.transfer_resistance, np.empty((0, len(self.model.electrodes)))
        voltages, drop = np.empty((len(touching), self._caused.shape[1])), np.zeros((self._caused.shape[1],) * 2)
        group, flows = np.zeros(len(touching), int) if groups is None else groups[touching], list[tuple[Ints, Floats]]()
        for one in np.unique(group):
            own = touching[group == one]
            currents = self._currents(joint[own], own)
            voltages[group == one] = currents / joint[own, None]
            drop += self._caused[own].T @ currents
            if groups is None:
                continue
            nodes, at = np.unique(self._corners[own], return_inverse=True)
            into = np.zeros((len(nodes), currents.shape[1]))
            np.add.at(into, at.reshape(len(own), -1), self._weights[own][:, :, None] * currents[:, None])
            for others, flow in flows:
                drop -= 2 * into.T @ self.update.green_among(nodes, others) @ flow
            flows.append((nodes, into))
        return np.asarray(self.model.transfer_resistance - (drop + drop.T) / 2), voltages

    def _currents(self, conductance: Floats, touching: Ints) -> Floats:
        """Currents (n, n_elec) into contacts `touching` (n,) of some conductance (n,), for 1 A into each electrode."""
        system, load = closed(touching, conductance, *self._known(touching))
        try:
            factor = cho_factor(system.T, overwrite_a=True, check_finite=False)
        except np.linalg.LinAlgError:
            raise ModelError(_TOO_COARSE) from None
        n_elec = self._caused.shape[1]
        solved = cho_solve(factor, load, check_finite=False)
        direct, floating, member = solved[:, :n_elec], solved[:, n_elec:], load[:, n_elec:]
        return np.asarray(direct - floating @ np.linalg.solve(member.T @ floating, member.T @ direct))

    def _known(self, touching: Ints) -> tuple[Any, ...]:
        """What the kernels take of contacts that touch (n,), from their corners on."""
        slots = np.unique(self._slots[touching])
        new = slots[~self._solved[slots]]
        nodes = np.unique(self._corners[np.isin(self._slots, new)]) if len(new) else new  # of all contacts, at once
        green = self.update.green_of(nodes)
        self._solved[new] = True
        near = self._nothing_near if self._near is None else self._near.table(slots)
        return self._corners, self._weights, self._caused, green, self._slots, *near

    def prepare(self, patch: int) -> None:
        """Compute what a press on a patch needs, so that the first one there takes no longer than others.

        Args:
            patch: Its number, one of `patches`.
        """
        self._known(np.flatnonzero(self.patches == patch))

    def many(self, cases: Sequence[tuple[Ints, Floats]]) -> Floats:
        """(n, n_elec, n_elec) transfer resistances in ohms of n `cases`, several times faster than one by one.

        Args:
            cases: Of each the distinct numbers of the `points` that touch (m,), and their conductances (m,) (siemens).

        Raises:
            ModelError: If a conductance is not positive and finite.
        """
        first = np.cumsum([0, *(len(points) for points, _ in cases)])
        touching = np.concatenate([np.empty(0, np.int64), *(points for points, _ in cases)])
        joint = np.concatenate([np.empty(0), *(conductance for _, conductance in cases)])
        if not ((joint > 0) & (joint < np.inf)).all():
            raise ModelError(
                "a patch conductance is not positive or not finite; leave out where a patch does not touch"
            )
        out = np.empty((len(cases), *self.model.transfer_resistance.shape))
        untouched = self.model.transfer_resistance
        try:
            pressed(out, untouched, first, touching, joint, *self._known(touching))
        except np.linalg.LinAlgError:
            raise ModelError(_TOO_COARSE) from None
        return out


def _on_skin(mesh: Mesh, points: Floats) -> tuple[Ints, Floats, Bools]:
    """Nodes (n, k) and barycentric coordinates (n, k) of points on the skin, and which (n,) are on it."""
    if mesh.nodes.shape[1] == 2:
        element, weights = mesh.locate(points)
        return mesh.elements[element], weights, element >= 0
    nodes, weights, distance = Surface(mesh).project(points)
    corners = mesh.nodes[nodes]
    edge = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    return nodes, weights, distance <= edge / 4


def _as_rows(sizes: ArrayLike, count: int) -> Floats:
    """Two sides of contacts as rows (count, 2, 2), of lengths (count, 2) along x and y or of such rows."""
    given = np.asarray(sizes, float)
    if given.ndim < 3:
        given = np.broadcast_to(given, (count, 2))[:, :, None] * np.eye(2)
    if given.shape != (count, 2, 2):
        raise ModelError(f"sizes have shape {given.shape}; give ({count}, 2) or ({count}, 2, 2)")
    return given
