"""Priors: what is believed about an image before anything is measured, as the matrix R that a reconstruction penalises.

A prior is a function from a mesh to a sparse symmetric positive definite matrix (n_elem, n_elem); the penalty is x^T R x.
"""

import scipy.sparse as sp

from ohmskin.geometry import Mesh


def paper_laplacian(mesh: Mesh) -> sp.csc_array:
    """Eq. (5) of the paper: d + 1 = 3 on the diagonal, -1 for triangles that share an edge.

    Triangles at the rim have fewer neighbours but the same diagonal, so the matrix is positive definite and the image is
    pulled to zero at the rim.
    """
    return sp.csc_array(3 * sp.eye_array(mesh.n_elem) - mesh.adjacency)
