"""Linear finite elements of sheets, surfaces and thick skins, and of the electrodes that touch them."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numba import njit
from numpy.typing import NDArray
from scipy.sparse.linalg import SuperLU, splu

from ohmskin.arrays import Floats, Ints
from ohmskin.forward.cholesky import Elimination, Factor
from ohmskin.forward.quadrature import ElectrodeQuadrature, quadratures
from ohmskin.geometry import Electrodes, Mesh


def stiffness(mesh: Mesh, conductivity: Floats) -> sp.csc_array:
    """The conductance matrix K (n_nodes, n_nodes) of the skin, K_ij = sum_e |e| grad(N_i) . sigma_e grad(N_j) (S).

    Args:
        mesh: Triangles or tetrahedra, in any space.
        conductivity: (n_elem,), or (n_elem, dim, dim) tensors in the coordinates of the nodes; of a sheet in siemens
            (per square), of a thick skin in siemens per metre.
    """
    stencil = mesh.stencil
    values = np.zeros(len(stencil.indices))
    if conductivity.ndim == 1:
        fill(stencil.slots, mesh.gradients, conductivity * mesh.measures, values)
    else:
        np.add.at(values, stencil.slots, local_stiffness(mesh, conductivity))
    return sp.csc_array((values, stencil.indices, stencil.indptr), shape=(mesh.n_nodes, mesh.n_nodes))


@njit(cache=True, nogil=True)
def fill(slots: NDArray[np.int32], gradients: Floats, weights: Floats, values: Floats) -> None:
    """Add weights_e grad(N_i).grad(N_j) of every element to the entries of `slots`. Twin of `local_stiffness`."""
    n_elem, corners, dim = gradients.shape
    for e in range(n_elem):
        for i in range(corners):
            for j in range(corners):
                product = 0.0
                for k in range(dim):
                    product += gradients[e, i, k] * gradients[e, j, k]
                values[slots[e, i, j]] += weights[e] * product


def local_stiffness(mesh: Mesh, conductivity: Floats, elements: Ints | slice = slice(None)) -> Floats:
    """The part (n, dim + 1, dim + 1) of each of given elements in the conductance matrix (siemens); see `stiffness`."""
    gradients = mesh.gradients[elements]
    tensors = conductivity if conductivity.ndim == 3 else conductivity[:, None, None] * np.eye(gradients.shape[2])
    flux = np.einsum("ecd,ejd->ejc", tensors, gradients)
    return np.asarray(np.einsum("eik,ejk->eij", gradients, flux) * mesh.measures[elements][:, None, None])


@dataclass(frozen=True, eq=False)
class System:
    """The system of the complete electrode model (Somersalo, Cheney and Isaacson 1992), with point electrodes.

    Unknowns are the potentials of the nodes, then those of the area electrodes. An area electrode is a perfect
    conductor joined to the skin beneath it by a conductance of one over its contact impedance per area (per length on
    the rim); a point electrode is a node.

    Args:
        matrix: (n_unknowns, n_unknowns) in siemens; constants are its null space.
        terminals: (n_elec,) the unknown that is each electrode's potential.
        quadratures: That of each area electrode, by its number.
        places: (n_unknowns, dim of space) where each unknown is (m).
    """

    matrix: sp.csc_array
    terminals: Ints
    quadratures: dict[int, ElectrodeQuadrature]
    places: Floats

    def elimination(self, known: Elimination | None = None) -> Elimination:
        """The order of elimination, with the first electrode grounded; `known`, if it is of the same pattern."""
        if known is not None and known.fits(self.matrix):
            return known
        return Elimination(self.matrix, self.places, int(self.terminals[0]))

    def factorise(self) -> Factor:
        """The factor of the matrix, with the first electrode grounded."""
        return self.elimination().factorise(self.matrix.data)


def assemble(
    mesh: Mesh, electrodes: Electrodes, conductivity: Floats, touching: dict[int, ElectrodeQuadrature] | None = None
) -> System:
    """The system of a skin and its electrodes; conductivity as in `stiffness`, contacts `touching` if known."""
    touching = quadratures(mesh, electrodes) if touching is None else touching
    points = [k for k in range(len(electrodes)) if k not in touching]
    terminals = np.empty(len(electrodes), np.int64)
    terminals[points] = mesh.nodes_at(electrodes.positions[points])
    terminals[list(touching)] = mesh.n_nodes + np.arange(len(touching))
    system = stiffness(mesh, conductivity)
    if not touching:
        return System(system, terminals, touching, mesh.nodes)
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
    return System(matrix, terminals, touching, places)


def factorise(matrix: sp.csc_array, places: Floats | None = None) -> Factor | SuperLU:
    """Factors of a symmetric positive definite matrix, much quicker with the `places` (n, dim) of its unknowns."""
    if places is not None:
        return Elimination(matrix, places).factorise(matrix.data)
    symmetric = {"SymmetricMode": True, "Equil": False}
    return splu(sp.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
