"""The forward model: from conductivity to what any drive pattern measures, and how that changes."""

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.errors import ModelError
from ohmskin.forward.assembly import factorise, stiffness
from ohmskin.geometry import Electrodes, Mesh
from ohmskin.geometry.domain import Floats
from ohmskin.scan import DrivePattern, all_pairs


class TransferModel:
    """Finite-element model of a sheet with point electrodes (paper, section II-A), factorised once for all electrodes.

    Args:
        mesh: The sheet; every electrode must be at a node.
        electrodes: Electrode layout.
        conductivity: Sheet conductivity in siemens (per square), one value or (n_elem,).

    Attributes:
        potentials: (n_nodes, n_elec) potential for 1 A into each electrode and out of the first (V).

    Raises:
        ModelError: If the conductivity is not positive and finite, or has the wrong shape.
        GeometryError: If an electrode is not at a mesh node.
    """

    def __init__(self, mesh: Mesh, electrodes: Electrodes, conductivity: ArrayLike) -> None:
        sigma = np.array(np.broadcast_to(np.asarray(conductivity, float), mesh.n_elem)) if np.ndim(conductivity) == 0 else None
        if sigma is None:
            sigma = np.array(conductivity, float)
        if sigma.shape != (mesh.n_elem,):
            raise ModelError(f"conductivity has shape {sigma.shape}; give one value or ({mesh.n_elem},), one per triangle")
        if len(bad := np.flatnonzero(~(np.isfinite(sigma) & (sigma > 0)))):
            raise ModelError(f"conductivity of triangle {bad[0]} is {sigma[bad[0]]}; it must be positive (siemens per square)")
        self.mesh, self.electrodes, self.conductivity = mesh, electrodes, sigma
        nodes = mesh.nodes_at(electrodes.positions)
        ground, driven = nodes[0], nodes[1:]
        free = np.delete(np.arange(mesh.n_nodes), ground)
        load = np.zeros((mesh.n_nodes, len(driven)))
        load[driven, np.arange(len(driven))] = 1.0
        solution = factorise(stiffness(mesh, sigma)[free][:, free]).solve(load[free])
        self.potentials: Floats = np.zeros((mesh.n_nodes, len(nodes)))
        self.potentials[free, 1:] = solution
        self._nodes = nodes

    @cached_property
    def transfer_resistance(self) -> Floats:
        """S of eq. (3), (n_elec, n_elec) in ohms: zero-mean electrode potentials for zero-sum currents.

        With point electrodes the diagonal, the potential of a driven electrode, grows without bound as the mesh is refined.
        """
        s: Floats = self.potentials[self._nodes]
        s = s - s.mean(axis=0) - s.mean(axis=1, keepdims=True) + s.mean()
        symmetric: Floats = (s + s.T) / 2
        return symmetric

    def voltages(self, pattern: DrivePattern, currents: ArrayLike = 1.0) -> Floats:
        """Voltages (n_meas,) of a pattern (V) at given injected currents, one value or (n_inj,) in amperes."""
        pattern.check(len(self.electrodes))
        a, b, c, d = pattern.quadruples.T
        s = self.transfer_resistance
        driven = np.broadcast_to(np.asarray(currents, float), pattern.n_inj)[pattern.measurements[:, 0]]
        voltages: Floats = (s[a, c] - s[a, d] - s[b, c] + s[b, d]) * driven
        return voltages

    @cached_property
    def pair_sensitivity(self) -> Floats:
        """dR_ij/dsigma (n_pairs, n_elem): two-terminal resistance of each electrode pair against conductivity (ohm/siemens).

        Every sensitivity is a combination of these rows (`DrivePattern.combination`).
        """
        field = np.einsum("ekd,ekl->led", self.mesh.gradients, self.potentials[self.mesh.triangles])
        i, j = all_pairs(len(self.electrodes)).T
        sensitivity = np.empty((len(i), self.mesh.n_elem))
        for first in range(len(self.electrodes) - 1):
            rows = np.flatnonzero(i == first)
            difference = field[first] - field[j[rows]]
            sensitivity[rows] = -np.einsum("ped,ped->pe", difference, difference) * self.mesh.areas
        return sensitivity

    def sensitivity(self, pattern: DrivePattern, currents: ArrayLike = 1.0) -> Floats:
        """dV/dsigma (n_meas, n_elem) of a pattern (V/siemens) at given injected currents (A). J of eq. (4), with that sign."""
        driven = np.broadcast_to(np.asarray(currents, float), pattern.n_inj)[pattern.measurements[:, 0]]
        rows: Floats = (pattern.combination(len(self.electrodes)) @ self.pair_sensitivity) * driven[:, None]
        return rows

    def current_density(self, source: int, sink: int, current: float = 1.0) -> Floats:
        """Sheet current density (n_elem, dim) in A/m for a current from electrode `source` to electrode `sink` (A)."""
        DrivePattern(np.array([[source, sink]]), np.array([[0, source, sink]])).check(len(self.electrodes))
        potential = (self.potentials[:, source] - self.potentials[:, sink])[self.mesh.triangles] * current
        density: Floats = -self.conductivity[:, None] * np.einsum("ekd,ek->ed", self.mesh.gradients, potential)
        return density

    def scaled(self, factor: float) -> "TransferModel":
        """The same model with all conductivities multiplied by `factor`; costs no factorisation."""
        if not (np.isfinite(factor) and factor > 0):
            raise ModelError(f"conductivity factor is {factor}; it must be positive")
        other = object.__new__(TransferModel)
        other.mesh, other.electrodes, other._nodes = self.mesh, self.electrodes, self._nodes
        other.conductivity = self.conductivity * factor
        other.potentials = self.potentials / factor
        return other
