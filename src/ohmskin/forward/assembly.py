"""Linear finite elements of the sheet."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from ohmskin.geometry.domain import Floats
from ohmskin.geometry.mesh import Mesh


def stiffness(mesh: Mesh, conductivity: Floats) -> sp.csc_array:
    """The conductance matrix K (n_nodes, n_nodes) of the sheet, K_ij = sum_e sigma_e A_e grad(N_i) . grad(N_j) (siemens).

    Args:
        mesh: The sheet.
        conductivity: (n_elem,) sheet conductivity in siemens (per square).
    """
    local = np.einsum("eik,ejk->eij", mesh.gradients, mesh.gradients) * (conductivity * mesh.areas)[:, None, None]
    row = np.repeat(mesh.triangles, 3, axis=1).ravel()
    column = np.tile(mesh.triangles, 3).ravel()
    return sp.csc_array((local.ravel(), (row, column)), shape=(mesh.n_nodes, mesh.n_nodes))


def factorise(matrix: sp.csc_array) -> SuperLU:
    """Sparse factors of a symmetric positive definite matrix, ordered and pivoted for symmetry."""
    return splu(
        sp.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True, "Equil": False}
    )
