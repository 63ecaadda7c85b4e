"""Linear finite elements of sheets, surfaces and thick skins, and of the electrodes that touch them."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numba import njit
from numpy.typing import NDArray
from scipy.sparse.linalg import SuperLU, splu, spsolve_triangular

from ohmskin.arrays import Floats, Ints
from ohmskin.compiler import NotCompiled, loading
from ohmskin.errors import ModelError
from ohmskin.forward.cholesky import Elimination
from ohmskin.forward.quadrature import ElectrodeQuadrature, quadratures
from ohmskin.geometry import Electrodes, Mesh

_LARGEST = 20_000  # unknowns, up to which SuperLU takes less time than our own elimination takes to compile
_uncompiled = 0  # how many want nothing compiled


class Solver(Protocol):
    """A factorised matrix."""

    def solve(self, loads: Floats) -> Floats:
        """The unknowns (n,) or (n, k) under loads (n,) or (n, k); zero where an unknown is held."""

    def half_solve(self, loads: Floats) -> Floats:
        """W loads (n, k), with W^T W the inverse of the matrix."""

    def half_solve_transposed(self, white: Floats) -> Floats:
        """W^T white (n or n - 1, k)."""


@contextmanager
def uncompiled() -> Iterator[None]:
    """Meanwhile, small systems are solved by SuperLU if our own elimination was never compiled on this machine.

    Compiling takes ten seconds; SuperLU three to five times as long as what is compiled, and its last digits differ.
    """
    global _uncompiled
    _uncompiled += 1
    try:
        yield
    finally:
        _uncompiled -= 1


def stiffness(mesh: Mesh, conductivity: Floats, gradients: Floats | None = None) -> sp.csc_array:
    """The conductance matrix K (n_nodes, n_nodes) of the skin, K_ij = sum_e |e| grad(N_i) . sigma_e grad(N_j) (S).

    Args:
        mesh: Triangles or tetrahedra, in any space.
        conductivity: (n_elem,); of a sheet in siemens (per square), of a thick skin in siemens per metre.
        gradients: Of the shape functions, in coordinates in which the skin is isotropic; the mesh's unless given.
    """
    indptr, indices, slots = mesh.stencil
    gradients = mesh.gradients if gradients is None else gradients
    values = _filled(len(indices), slots, gradients, conductivity * mesh.measures)
    return sp.csc_array((values, indices, indptr), shape=(mesh.n_nodes, mesh.n_nodes))


@njit(cache=True, nogil=True)
def fill(slots: NDArray[np.int32], gradients: Floats, weights: Floats, values: Floats) -> None:
    """Add weights_e grad(N_i).grad(N_j) of every element to the entries of `slots`."""
    n_elem, corners, dim = gradients.shape
    for e in range(n_elem):
        for i in range(corners):
            for j in range(corners):
                product = 0.0
                for k in range(dim):
                    product += gradients[e, i, k] * gradients[e, j, k]
                values[slots[e, i, j]] += weights[e] * product


def local_stiffness(gradients: Floats, weights: Floats, elements: Ints) -> tuple[Ints, Floats]:
    """What elements (n,) add to the conductance matrix: the nodes (m,) concerned and the matrix (m, m) in siemens.

    Args:
        gradients: (n, dim + 1, d) of their shape functions, in coordinates in which the skin is isotropic (1/m).
        weights: (n,) conductivity times area or volume of each.
        elements: (n, dim + 1) nodes of each.
    """
    nodes, at = np.unique(elements, return_inverse=True)
    at, count = at.reshape(elements.shape).astype(np.int32), len(nodes)
    values = _filled(count**2, at[:, :, None] * count + at[:, None, :], gradients, weights)
    return nodes, values.reshape(count, count)


def _filled(count: int, slots: NDArray[np.int32], gradients: Floats, weights: Floats) -> Floats:
    """So many values after `fill`."""
    values, gradients = np.zeros(count), gradients.view()
    gradients.setflags(write=False)  # as those of a mesh are: of two types, and `fill` would be compiled twice
    fill(slots, gradients, weights, values)
    return values


class SuperLUElimination:
    """What stands in for `Elimination`, of a symmetric `matrix` (n, n), an unknown `without` held at zero."""

    def __init__(self, matrix: sp.csc_array, without: int) -> None:
        self._matrix, self._without = matrix, without

    def fits(self, matrix: sp.csc_array) -> bool:
        """Never: for a matrix of the same pattern, `Elimination` may have been compiled."""
        return False

    def factorise(self, values: Floats) -> Solver:
        """The factor of the matrix with these values (n_entries,), in the order of the pattern's own.

        Raises:
            ModelError: If the matrix is not positive definite.
        """
        matrix = sp.csc_array((values, self._matrix.indices, self._matrix.indptr), shape=self._matrix.shape)
        unknowns = np.arange(matrix.shape[0])
        free = unknowns[unknowns != self._without]
        try:
            return _SuperLUFactor(factorise(matrix[:, free][free]), free, len(unknowns))
        except RuntimeError as error:
            raise ModelError(f"the system is not positive definite: {error}; check the conductivities") from None


class _SuperLUFactor:
    """What stands in for `Factor`, of those of n unknowns that are `free`: P A P^T = L D L^T."""

    def __init__(self, factor: SuperLU, free: Ints, n: int) -> None:
        self._factor, self._free, self._n, self._order = factor, free, n, np.argsort(factor.perm_c)
        diagonal = factor.U.diagonal()
        if (factor.perm_r != factor.perm_c).any() or not (diagonal > 0).all():
            raise ModelError("the system is not positive definite; check the conductivities")
        self._root = np.sqrt(diagonal)[:, None]

    def solve(self, loads: Floats) -> Floats:
        unknowns = np.zeros(loads.shape)
        unknowns[self._free] = self._factor.solve(np.ascontiguousarray(loads[self._free]))
        return unknowns

    def half_solve(self, loads: Floats) -> Floats:
        ordered = np.asarray(loads, float)[self._free[self._order]]
        return np.asarray(spsolve_triangular(self._factor.L.tocsr(), ordered, unit_diagonal=True) / self._root)

    def half_solve_transposed(self, white: Floats) -> Floats:
        unknowns = np.zeros((self._n, white.shape[1]))
        upper = self._factor.L.T.tocsr()
        ordered = spsolve_triangular(upper, white / self._root, lower=False, unit_diagonal=True)
        unknowns[self._free[self._order]] = ordered
        return unknowns


def elimination(matrix: sp.csc_array, places: Floats, without: int = -1) -> Elimination | SuperLUElimination:
    """`Elimination`, or what stands in for it while nothing shall be compiled (`uncompiled`)."""
    if _uncompiled and matrix.shape[0] <= _LARGEST and not _is_compiled():
        return SuperLUElimination(matrix, without)
    return Elimination(matrix, places, without)


def _is_compiled() -> bool:
    """Whether `Elimination` was compiled on this machine."""
    try:
        with loading():
            Elimination(sp.eye_array(2, format="csc"), np.eye(2)).factorise(np.ones(2)).solve(np.eye(2))
    except NotCompiled:
        return False
    return True


@dataclass(frozen=True, eq=False)
class System:
    """The system of the complete electrode model (Somersalo, Cheney and Isaacson 1992), with point electrodes.

    Unknowns are the potentials of the nodes, then those of the area electrodes. An area electrode is a perfect
    conductor joined to the skin beneath it by a conductance of one over its contact impedance per area (per length on
    the rim); a point electrode is a node.

    Args:
        matrix: (n_unknowns, n_unknowns) in siemens; constants are its null space.
        terminals: (n_elec,) the unknown that is each electrode's potential.
        places: (n_unknowns, dim of space) where each unknown is (m).
    """

    matrix: sp.csc_array
    terminals: Ints
    places: Floats

    def elimination(
        self, known: "Elimination | SuperLUElimination | None" = None
    ) -> "Elimination | SuperLUElimination":
        """The order of elimination, with the first electrode grounded; `known`, if it is of the same pattern."""
        if known is not None and known.fits(self.matrix):
            return known
        return elimination(self.matrix, self.places, int(self.terminals[0]))

    def factorise(self) -> Solver:
        """The factor of the matrix, with the first electrode grounded."""
        return self.elimination().factorise(self.matrix.data)


def assemble(
    mesh: Mesh,
    electrodes: Electrodes,
    conductivity: Floats,
    touching: dict[int, ElectrodeQuadrature] | None = None,
    gradients: Floats | None = None,
) -> System:
    """The system of a skin and its electrodes; skin as in `stiffness`, contacts `touching` if known."""
    touching = quadratures(mesh, electrodes) if touching is None else touching
    points = [k for k in range(len(electrodes)) if k not in touching]
    terminals = np.empty(len(electrodes), np.int64)
    terminals[points] = mesh.nodes_at(electrodes.positions[points])
    terminals[list(touching)] = mesh.n_nodes + np.arange(len(touching))
    system = stiffness(mesh, conductivity, gradients)
    if not touching:
        return System(system, terminals, mesh.nodes)
    loads, totals = [], []
    for k, contact in touching.items():
        joint = contact.weights / electrodes.contact_impedances[k]
        weighted = sp.diags_array(joint) @ contact.at
        system = system + contact.at.T @ weighted
        loads.append(sp.csr_array(weighted.sum(axis=0)[None]))
        totals.append(joint.sum())
    load = sp.vstack(loads)
    places = np.vstack([mesh.nodes, electrodes.positions[list(touching)]])
    matrix = sp.block_array([[system, -load.T], [-load, sp.diags_array(totals)]], format="csc")
    return System(matrix, terminals, places)


def factorise(matrix: sp.csc_array) -> SuperLU:
    """Factors of a symmetric positive definite matrix whose unknowns have no places."""
    symmetric = {"SymmetricMode": True, "Equil": False}
    return splu(sp.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
