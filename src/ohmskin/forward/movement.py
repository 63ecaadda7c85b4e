"""How two-terminal resistances change when electrodes move, exactly as the finite elements have it.

An electrode moves with the nodes that it touches and with a few layers of elements about it, which makes the result
that of the sheet rather than that of the singular fields at the electrode. With a displacement theta of the nodes, u_i
the potentials and q_i = sigma grad u_i, the derivative of the form a(u_i, u_j) is the sum over elements of
|e| (div theta q_i . grad u_j - D theta (grad u_i q_j + grad u_j q_i)), and that of a resistance is minus this.
Cf. Gomez-Laberge and Adler, Physiol. Meas. 29 (2008) S89, where single nodes move.
"""

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import ModelError
from ohmskin.forward.quadrature import ElectrodeQuadrature
from ohmskin.geometry import Electrodes, Mesh
from ohmskin.geometry.mesh import normals
from ohmskin.scan import n_pairs, two_terminal

_BEND = 0.1  # squared sine of half the angle between facets from which on they meet at an edge that nodes cannot pass


def pair_movement(
    mesh: Mesh,
    electrodes: Electrodes,
    touching: dict[int, ElectrodeQuadrature],
    tensors: Floats,
    potentials: Floats,
    layers: int,
    slide: bool,
) -> Floats:
    """dR_ij / dx_k (n_pairs, n_elec, dim of space) (ohm/m); skin, contacts, conductivity and potentials of a model.

    `layers` and `slide` as in `TransferModel.pair_movement`.
    """
    n_elec, dim = electrodes.positions.shape
    if not (isinstance(layers, int) and layers >= 0):
        raise ModelError(f"{layers!r} layers of elements move with an electrode; give 0, 1, 2, ...")
    if slide and dim > mesh.dim:
        raise ModelError("electrodes slide on flat sheets and on bodies; on a surface in space give slide=False")
    own = [np.unique(touching[k].at.indices) if k in touching else mesh.nodes_at(electrodes.positions[[k]])
           for k in range(n_elec)]  # fmt: skip
    taken = np.bincount(np.concatenate(own), minlength=mesh.n_nodes)
    found = np.empty((n_pairs(n_elec), n_elec, dim))
    for k, nodes in enumerate(own):
        if (taken[nodes] > 1).any():
            raise ModelError(f"electrode {k} shares nodes of the mesh with another one; refine the mesh between them")
        moved = nodes
        for _ in range(layers):
            moved = np.unique(mesh.elements[np.isin(mesh.elements, moved).any(axis=1)])
        moved = np.union1d(moved[taken[moved] == 0], nodes)
        ways = np.tile(np.eye(dim), (len(moved), 1, 1))
        if slide:
            centre = int(np.linalg.norm(mesh.nodes[nodes] - electrodes.positions[k], axis=1).argmin())
            ways = _along(mesh, moved)
            ways = ways @ ways[np.searchsorted(moved, nodes[centre])]
        form = _form(mesh, moved, ways, tensors, potentials)
        found[:, k] = np.column_stack([two_terminal(-one) for one in form])
    return found


def _along(mesh: Mesh, nodes: Ints) -> Floats:
    """Projections (n, dim, dim) on the ways in which nodes can move that leave the rim, or surface, as it is."""
    facets = mesh.boundary[np.isin(mesh.boundary, nodes).any(axis=1)]
    flat = mesh.dim == 2
    across = np.diff(mesh.nodes[facets], axis=1)[:, 0, ::-1] * [1, -1] if flat else normals(mesh.nodes, facets)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    ways = np.tile(np.eye(mesh.dim), (len(nodes), 1, 1))
    for at in np.flatnonzero(np.isin(nodes, facets)):
        here = across[(facets == nodes[at]).any(axis=1)]
        values, vectors = np.linalg.eigh(here.T @ here / len(here))
        free = vectors[:, values < _BEND]
        ways[at] = free @ free.T
    return ways


def _form(mesh: Mesh, moved: Ints, ways: Floats, tensors: Floats, potentials: Floats) -> Floats:
    """Derivative (dim, n_elec, n_elec) of the form of the potentials when nodes move by `ways` (n, dim, dim)."""
    chosen = np.flatnonzero(np.isin(mesh.elements, moved).any(axis=1))
    elements, gradients = mesh.elements[chosen], mesh.gradients[chosen]
    at = np.searchsorted(moved, elements).clip(max=len(moved) - 1)
    shift = np.where((moved[at] == elements)[..., None, None], ways[at], 0.0)
    bend = np.einsum("enac,enb->ecab", shift, gradients)  # of each way c, d theta_a / d x_b
    field = np.einsum("enb,eni->ebi", gradients, potentials[elements])
    sigma = tensors[chosen]
    flow = sigma[:, None, None] * field if sigma.ndim == 1 else sigma @ field
    flow *= mesh.measures[chosen, None, None]
    turned = np.einsum("ecab,eai->cebi", bend, field)
    turned -= np.einsum("ecaa->ce", bend)[:, :, None, None] * field / 2
    half = np.einsum("cebi,ebj->cij", turned, flow, optimize=True)
    return np.asarray(-half - half.swapaxes(1, 2))
