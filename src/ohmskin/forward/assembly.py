"""Linear finite elements of sheets, surfaces and thick skins, and of the electrodes that touch them."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from ohmskin.forward.contact import Contact, contacts
from ohmskin.geometry import Electrodes, Mesh
from ohmskin.geometry.domain import Floats
from ohmskin.geometry.mesh import Ints


def stiffness(mesh: Mesh, conductivity: Floats) -> sp.csc_array:
    """The conductance matrix K (n_nodes, n_nodes) of the skin, K_ij = sum_e |e| grad(N_i) . sigma_e grad(N_j) (siemens).

    Args:
        mesh: Triangles or tetrahedra, in any space.
        conductivity: (n_elem,), or (n_elem, dim, dim) tensors in the coordinates of the nodes; of a sheet in siemens (per square),
            of a thick skin in siemens per metre.
    """
    local = local_stiffness(mesh, conductivity)
    corners = mesh.elements.shape[1]
    row = np.repeat(mesh.elements, corners, axis=1).ravel()
    column = np.tile(mesh.elements, corners).ravel()
    return sp.csc_array((local.ravel(), (row, column)), shape=(mesh.n_nodes, mesh.n_nodes))


def local_stiffness(mesh: Mesh, conductivity: Floats, elements: Ints | slice = slice(None)) -> Floats:
    """The part (n, dim + 1, dim + 1) of each of some elements in the conductance matrix (siemens); arguments as `stiffness`."""
    gradients = mesh.gradients[elements]
    tensors = conductivity if conductivity.ndim == 3 else conductivity[:, None, None] * np.eye(gradients.shape[2])
    flux = np.einsum("ecd,ejd->ejc", tensors, gradients)
    local: Floats = np.einsum("eik,ejk->eij", gradients, flux) * mesh.measures[elements][:, None, None]
    return local


@dataclass(frozen=True, eq=False)
class System:
    """The symmetric system of the complete electrode model (Somersalo, Cheney and Isaacson 1992), mixed with point electrodes.

    Unknowns are the potentials of the nodes, then those of the area electrodes. An area electrode is a perfect conductor joined to
    the skin beneath it by a conductance of one over its contact impedance per area (per length on the rim); a point electrode
    is a node.

    Args:
        matrix: (n_unknowns, n_unknowns) in siemens; constants are its null space.
        terminals: (n_elec,) the unknown that is each electrode's potential.
        contacts: The contact of each area electrode, by its number.
    """

    matrix: sp.csc_array
    terminals: Ints
    contacts: dict[int, Contact]


def assemble(mesh: Mesh, electrodes: Electrodes, conductivity: Floats, touching: dict[int, Contact] | None = None) -> System:
    """The system of a skin and its electrodes; conductivity as in `stiffness`. Contacts that are known save their quadrature."""
    touching = contacts(mesh, electrodes) if touching is None else touching
    points = [k for k in range(len(electrodes)) if k not in touching]
    terminals = np.empty(len(electrodes), np.int64)
    terminals[points] = mesh.nodes_at(electrodes.positions[points])
    terminals[list(touching)] = mesh.n_nodes + np.arange(len(touching))
    system = stiffness(mesh, conductivity)
    if not touching:
        return System(system, terminals, touching)
    loads, totals = [], []
    for k, contact in touching.items():
        joint = contact.weights / electrodes.contact_impedances[k]
        weighted = sp.diags_array(joint) @ contact.at
        system = system + contact.at.T @ weighted
        loads.append(sp.csr_array(weighted.sum(axis=0)[None]))
        totals.append(joint.sum())
    load = sp.vstack(loads)
    return System(sp.block_array([[system, -load.T], [-load, sp.diags_array(totals)]], format="csc"), terminals, touching)


def factorise(matrix: sp.csc_array) -> SuperLU:
    """Sparse factors of a symmetric positive definite matrix, ordered and pivoted for symmetry."""
    return splu(
        sp.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True, "Equil": False}
    )
