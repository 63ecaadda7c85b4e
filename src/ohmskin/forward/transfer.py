"""The forward model: from conductivity to what any drive pattern measures, and how that changes."""

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, ReadOnly, fixed, lock, real
from ohmskin.errors import ModelError
from ohmskin.forward.assembly import SuperLUElimination, assemble
from ohmskin.forward.cholesky import Elimination
from ohmskin.forward.conductivity import conductivity_of
from ohmskin.forward.movement import pair_movement
from ohmskin.forward.quadrature import quadratures
from ohmskin.forward.sensitivity import fill_groups, fill_pairs
from ohmskin.geometry import Electrodes, Mesh
from ohmskin.scan import DrivePattern, Frame, Pairs, two_terminal

_BLOCK = 2048  # elements at a time, which keeps memory small


class TransferModel(ReadOnly):
    """Finite-element model of a skin with any electrodes (paper, section II-A), factorised once for all of them.

    Area electrodes follow the complete electrode model, point electrodes the paper. The skin may be a flat sheet, a
    curved surface in space or a thick body.

    Args:
        mesh: The skin; every point electrode must be at a node.
        electrodes: Electrode layout.
        conductivity: One value, (n_elem,) values, one symmetric tensor (dim, dim) or (n_elem, dim, dim) tensors in the
            coordinates of the nodes; of a sheet in siemens (per square), of a thick skin in siemens per metre.

    Attributes:
        conductivity: (n_elem,), of tensors the geometric mean of the principal conductivities.
        potentials: (n_nodes, n_elec) potential for 1 A into each electrode and out of the first (V).
        electrode_potentials: (n_elec, n_elec) potential of each electrode (rows), likewise (V).
        pairs: The pairs of electrodes whose two-terminal quantities it has; all unless made by `over`.
        quadratures: Where each area electrode touches the skin, by its number.
        gradients: (n_elem, dim + 1, d) of the shape functions (1/m), in coordinates in which the skin is isotropic.

    Raises:
        ModelError: If the conductivity is not positive (a tensor: positive definite), or has the wrong shape.
        GeometryError: If a point electrode is not at a mesh node or an area electrode not on the skin.
    """

    def __init__(self, mesh: Mesh, electrodes: Electrodes, conductivity: ArrayLike) -> None:
        self.mesh, self.electrodes, self.pairs = mesh, electrodes, Pairs.all(len(electrodes))
        self.conductivity, self._root = conductivity_of(mesh, conductivity)
        self.quadratures = quadratures(mesh, electrodes)
        self._elimination: Elimination | SuperLUElimination | None = None
        self._solve()

    def _solve(self) -> None:
        mesh, n_elec = self.mesh, len(self.electrodes)
        self.gradients = mesh.gradients if self._root is None else mesh.gradients @ self._root
        system = assemble(mesh, self.electrodes, self.conductivity, self.quadratures, self.gradients)
        self._elimination = system.elimination(self._elimination)
        load = np.zeros((system.matrix.shape[0], n_elec))
        load[system.terminals[1:], np.arange(1, n_elec)] = 1.0
        solution = self._elimination.factorise(system.matrix.data).solve(load)
        self.potentials: Floats = solution[: mesh.n_nodes]
        self.electrode_potentials: Floats = solution[system.terminals]
        lock(self)

    def __repr__(self) -> str:
        return f"TransferModel({self.mesh}, {len(self.electrodes)} electrodes)"

    def with_conductivity(self, conductivity: ArrayLike) -> "TransferModel":
        """The same skin with another `conductivity`, as for `TransferModel`; (n_elem,) values keep the directions of a
        sheet that has such.

        Raises:
            ModelError: If it is not positive, or has the wrong shape.
        """
        values, root = conductivity_of(self.mesh, conductivity)
        other = self._with(conductivity=values, _root=self._root if root is None else root)
        other._solve()
        return other

    def with_contact_impedances(self, values: ArrayLike) -> "TransferModel":
        """The same skin with other contact impedances.

        Arguments and errors as of `Electrodes.with_contact_impedances`.
        """
        other = self._with(electrodes=self.electrodes.with_contact_impedances(values))
        other._solve()
        return other

    def scaled(self, factor: float) -> "TransferModel":
        """The same model with all conductances multiplied by `factor`; costs no factorisation.

        Contact impedances are divided by `factor` too, and with them voltages; to keep them use `with_conductivity`.

        Raises:
            ModelError: If the factor is not positive.
        """
        if not (np.isfinite(factor) and factor > 0):
            raise ModelError(f"conductivity factor is {factor}; it must be positive")
        return self._with(
            conductivity=self.conductivity * factor,
            electrodes=self.electrodes.with_contact_impedances(self.electrodes.contact_impedances / factor),
            potentials=self.potentials / factor,
            electrode_potentials=self.electrode_potentials / factor,
        )

    def over(self, pairs: Pairs) -> "TransferModel":
        """The same model, with two-terminal quantities of these pairs of electrodes alone; costs nothing."""
        return self if pairs is self.pairs else self._with(pairs=pairs)

    def _with(self, **changed: Any) -> "TransferModel":
        """A copy with other attributes, without what was computed from them."""
        other, own = object.__new__(TransferModel), vars(TransferModel)
        kept = {name: value for name, value in vars(self).items() if not isinstance(own.get(name), cached_property)}
        vars(other).update(kept | changed)
        lock(other)
        return other

    @property
    def shorted(self) -> "TransferModel":
        """The same model with sensitivities to round spots that conduct far better than the sheet.

        On an isotropic
        sheet they are the same. On an anisotropic one the dipole of such a spot (an ellipse, after stretching the sheet
        to be isotropic) is proportional, along each direction, to the square root of the conductivity instead of the
        conductivity.
        """
        if self._root is None or self._root.shape[1:] != (2, 2):
            return self
        values, directions = np.linalg.eigh(self._root)
        fourth = (directions * np.sqrt(values)[:, None]) @ directions.swapaxes(1, 2)
        return self._with(gradients=self.mesh.gradients @ fourth)

    @property
    def tensors(self) -> Floats:
        """Conductivity (n_elem,), or (n_elem, dim, dim) if the skin conducts better in some directions."""
        if self._root is None:
            return self.conductivity
        return self.conductivity[:, None, None] * (self._root @ self._root.swapaxes(1, 2))

    @fixed
    def electrode_extents(self) -> Floats:
        """Extent of each electrode on the skin (n_elec,): m2 of a disc, m of a rim segment."""
        found = [self.quadratures[k].extent if k in self.quadratures else 0.0 for k in range(len(self.electrodes))]
        return np.array(found)

    @fixed
    def transfer_resistance(self) -> Floats:
        """S of eq. (3), (n_elec, n_elec) in ohms: zero-mean electrode potentials for zero-sum currents.

        With point electrodes the diagonal, the potential of a driven electrode, grows without bound as the mesh is
        refined; with area electrodes it is the true one, contact impedance included.
        """
        s = self.electrode_potentials
        s = s - s.mean(axis=0) - s.mean(axis=1, keepdims=True) + s.mean()
        return np.asarray((s + s.T) / 2)

    @fixed
    def pair_resistances(self) -> Floats:
        """Two-terminal resistance (n_pairs,) of each pair (ohm); of points good for four-terminal combinations only."""
        return two_terminal(self.transfer_resistance, self.pairs)

    def voltages(self, pattern: DrivePattern, currents: ArrayLike = 1.0) -> Floats:
        """Voltages (n_meas,) of a pattern (V).

        Args:
            pattern: What is driven and measured.
            currents: Injected currents, one value or (n_inj,) (A).

        Raises:
            PatternError: If the pattern names an electrode that is not there, or needs a pair that the model lacks.
            ModelError: If currents are not finite, or do not fit the pattern.
        """
        pattern.check(len(self.electrodes))
        a, b, c, d = pattern.quadruples.T
        s = self.transfer_resistance
        return np.asarray((s[a, c] - s[a, d] - s[b, c] + s[b, d]) * self._driven(pattern, currents))

    def simulate(
        self, pattern: DrivePattern, currents: ArrayLike = 1e-3, noise: float = 0.0, count: int = 1, seed: int = 0
    ) -> list[Frame]:
        """Frames as an instrument with white noise measures them; for a whole instrument see `VirtualSkin`.

        Args:
            pattern: What is driven and measured.
            currents: Injected currents, one value or (n_inj,) (A).
            noise: Standard deviation of a voltage (V).
            count: How many frames.
            seed: Of the noise.

        Raises:
            ModelError: If the noise is negative or not finite, or there is no frame to make.
        """
        if not (0 <= noise < np.inf and count >= 1):
            raise ModelError(
                f"noise {noise!r} V and {count!r} frames; the noise must be 0 or more, the count 1 or more"
            )
        volts, amperes = self.voltages(pattern, currents), np.broadcast_to(np.asarray(currents, float), pattern.n_inj)
        noises = noise * np.random.default_rng(seed).normal(size=(count, pattern.n_meas))
        return [Frame(pattern, volts + one, amperes.copy(), sequence=number) for number, one in enumerate(noises)]

    @fixed
    def pair_sensitivity(self) -> Floats:
        """dR_ij/dsigma (n_pairs, n_elem): two-terminal resistance of each pair against conductivity (ohm/S).

        Every sensitivity is a combination of these rows (`DrivePattern.combination`). Where the conductivity is a
        tensor, against its factor `conductivity`: the directions stay.
        """
        sensitivity = np.empty((len(self.pairs), self.mesh.n_elem))
        skin = self.mesh.elements, self.gradients, self.mesh.measures, self.potentials
        fill_pairs(*skin, self.pairs.ends, sensitivity)
        return sensitivity

    def grouped_sensitivity(self, shares: sp.csc_array) -> Floats:
        """`pair_sensitivity @ shares`, (n_pairs, n_groups) in ohms, without the memory of the former.

        Args:
            shares: (n_elem, n_groups) sparse, not negative: how a group's unknown changes each element's conductivity.

        Raises:
            ModelError: If a share is negative or not finite.
        """
        if not ((shares.data >= 0) & np.isfinite(shares.data)).all():
            raise ModelError("shares of elements in groups are finite numbers from 0 on")
        grouped = np.zeros((len(self.pairs), shares.shape[1]))
        columns, skin = sp.csc_array(shares), (self.mesh.elements, self.gradients, self.mesh.measures, self.potentials)
        fill_groups(
            *skin,
            columns.indptr.astype(np.int64),
            columns.indices.astype(np.int64),
            columns.data,
            self.pairs.ends,
            grouped,
        )
        return grouped

    def field_sensitivity(self, fields: Floats) -> Floats:
        """`pair_sensitivity @ fields`, (n_pairs, k) in ohms, of few `fields` (n_elem, k), likewise, to 1e-6."""
        n_elec, weights = len(self.electrodes), (fields * self.mesh.measures[:, None]).astype(np.float32)
        products = np.zeros((fields.shape[1], n_elec, n_elec))
        for start in range(0, self.mesh.n_elem, _BLOCK):
            at = slice(start, start + _BLOCK)
            slopes = np.einsum("ecd,ecn->edn", self.gradients[at], self.potentials[self.mesh.elements[at]])
            slopes = slopes.astype(np.float32)
            for own, weight in zip(products, weights[at].T, strict=True):
                own += (weight[:, None, None] * slopes).reshape(-1, n_elec).T @ slopes.reshape(-1, n_elec)
        each, (i, j) = np.diagonal(products, axis1=1, axis2=2), self.pairs.ends.T
        return np.asarray((2 * products[:, i, j] - each[:, i] - each[:, j]).T)

    @fixed
    def pair_contact_sensitivity(self) -> Floats:
        """dR_ij/dz_k (n_pairs, n_elec): two-terminal resistance of pairs against contact impedances (ohm / unit of z).

        The integral of the squared current density through each contact; zero for point electrodes.
        """
        sensitivity = np.zeros((len(self.pairs), len(self.electrodes)))
        for k, quadrature in self.quadratures.items():
            drop = self.electrode_potentials[k] - quadrature.at @ self.potentials
            density = drop / self.electrodes.contact_impedances[k]
            sensitivity[:, k] = two_terminal(density.T @ (quadrature.weights[:, None] * density), self.pairs)
        return sensitivity

    def pair_movement(self, layers: int = 2, slide: bool = False) -> Floats:
        """dR_ij/dx_k (n_pairs, n_elec, dim of space): two-terminal resistance of pairs against places (ohm/m).

        Exact for this mesh. Of points good for four-terminal combinations only.

        Args:
            layers: Number of layers of elements around an electrode that move with it. With 0 only its own nodes move,
                as in EIDORS' `jacobian_movement`, and coarse meshes have larger errors.
            slide: Whether the skin keeps its shape, so that an electrode on the rim moves along it only, and one at a
                corner not at all. Otherwise it moves the rim, or the surface of a body, too.

        Raises:
            ModelError: If `layers` is negative, two electrodes share nodes of the mesh, or are to slide on a surface in
                space.
        """
        return pair_movement(self.mesh, self.electrodes, self.quadratures, self.tensors, self.potentials, layers, slide)

    def sensitivity(self, pattern: DrivePattern, currents: ArrayLike = 1.0) -> Floats:
        """J of eq. (4): dV/dsigma (n_meas, n_elem) of a pattern (V/S); arguments and errors as for `voltages`."""
        rows: Floats = pattern.combination(self.pairs) @ self.pair_sensitivity
        return rows * self._driven(pattern, currents)[:, None]

    def contact_sensitivity(self, pattern: DrivePattern, currents: ArrayLike = 1.0) -> Floats:
        """dV/dz (n_meas, n_elec) of a pattern in V per ohm m2 (disc) or ohm m (rim).

        Arguments and errors as for `voltages`.
        """
        rows: Floats = pattern.combination(self.pairs) @ self.pair_contact_sensitivity
        return rows * self._driven(pattern, currents)[:, None]

    def movement_sensitivity(
        self, pattern: DrivePattern, currents: ArrayLike = 1.0, layers: int = 2, slide: bool = False
    ) -> Floats:
        """dV/dx (n_meas, n_elec, dim of space) of a pattern against electrodes' places (V/m).

        Arguments and errors as for `voltages`; `layers` and `slide` as for `pair_movement`.
        """
        pairs = self.pair_movement(layers, slide)
        rows = pattern.combination(self.pairs) @ pairs.reshape(len(pairs), -1)
        return np.asarray(rows * self._driven(pattern, currents)[:, None]).reshape(-1, *pairs.shape[1:])

    def tensor_sensitivity(self, pattern: DrivePattern, currents: ArrayLike = 1.0) -> Floats:
        """dV/dsigma_ab (n_meas, n_elem, dim, dim) of a pattern against the entries of the tensor (V/S), symmetric.

        A change T of the tensor of element e changes measurement m by the sum of result[m, e, a, b] T[a, b]. Arguments
        and errors as for `voltages`.
        """
        pattern.check(len(self.electrodes))
        a, b, c, d = pattern.quadruples.T
        field = np.einsum("ekd,ekl->led", self.mesh.gradients, self.potentials[self.mesh.elements])
        product = np.einsum("mea,meb->meab", field[a] - field[b], field[c] - field[d])
        symmetric = (product + product.swapaxes(2, 3)) / 2
        rows: Floats = -symmetric * (self.mesh.measures * self._driven(pattern, currents)[:, None])[:, :, None, None]
        return rows

    def current_density(self, source: int, sink: int, current: float = 1.0) -> Floats:
        """Current density (n_elem, dim), of a sheet in A/m, of a body in A/m2.

        Args:
            source, sink: Electrodes where the current enters and leaves.
            current: How large it is (A).

        Raises:
            PatternError: If an electrode is not there, or both are one.
        """
        DrivePattern(np.array([[source, sink]]), np.array([[0, source, sink]])).check(len(self.electrodes))
        potential = (self.potentials[:, source] - self.potentials[:, sink])[self.mesh.elements] * current
        field = np.einsum("ekd,ek->ed", self.gradients, potential)
        if self._root is not None:
            field = np.einsum("ecd,ed->ec", self._root, field)
        return np.asarray(-self.conductivity[:, None] * field)

    def _driven(self, pattern: DrivePattern, currents: ArrayLike) -> Floats:
        """The current (n_meas,) that flows during each measurement."""
        amperes = real(currents, "currents are", ModelError)
        if amperes.shape not in ((), (1,), (pattern.n_inj,)):
            raise ModelError(f"currents have shape {amperes.shape}; give one value or ({pattern.n_inj},)")
        if not np.isfinite(amperes).all():
            raise ModelError("a current is not finite; give 0 for no current (A)")
        given = np.broadcast_to(amperes, pattern.n_inj)
        return np.asarray(given[pattern.measurements[:, 0]])
