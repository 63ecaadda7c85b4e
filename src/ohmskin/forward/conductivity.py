"""Conductivity as given, checked: one value, one per element, or tensors."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, real
from ohmskin.errors import ModelError
from ohmskin.geometry import Domain, Mesh


def conductivity_of(mesh: Mesh, given: ArrayLike) -> tuple[Floats, Floats | None]:
    """Check what was given: one value, (n_elem,) values, one (dim, dim) tensor or (n_elem, dim, dim) tensors.

    Tensors are in the coordinates of the nodes; on a surface in space only their part tangential to it counts.

    Returns:
        (n_elem,) geometric mean of the principal conductivities; of a sheet in siemens (per square), of a thick skin in
            siemens per metre. For tensors also roots (n_elem, dim of space, dim): root root^T has determinant 1, and
            the mean times it is the tensor.

    Raises:
        ModelError: If a value is not positive, a tensor not symmetric positive definite, or the shape is wrong.
    """
    sigma: Any = real(given, "the conductivity is", ModelError).copy()
    n, dim = mesh.n_elem, mesh.nodes.shape[1]
    if sigma.shape == (dim, dim):
        sigma = np.array(np.broadcast_to(sigma, (n, dim, dim)))
    if sigma.ndim == 0:
        sigma = np.full(n, sigma)
    if sigma.shape == (n,):
        if len(bad := np.flatnonzero(~(np.isfinite(sigma) & (sigma > 0)))):
            one = f"conductivity of {mesh.noun} {bad[0]} is {sigma[bad[0]]}"
            raise ModelError(f"{one}; it must be positive ({_unit(mesh)})")
        return sigma, None
    if sigma.shape != (n, dim, dim):
        tensors = f"tensors ({dim}, {dim}) or ({n}, {dim}, {dim})"
        one_each = f"one value or ({n},), one per {mesh.noun}"
        raise ModelError(f"conductivity has shape {sigma.shape}; give {one_each}, or {tensors}")
    finite = np.isfinite(sigma).all(axis=(1, 2))
    scale = np.abs(np.where(finite[:, None, None], sigma, 0)).max(axis=(1, 2))
    symmetric = np.abs(sigma - sigma.transpose(0, 2, 1)).max(axis=(1, 2)) <= 1e-12 * scale
    edges = mesh.corners[:, 1:] - mesh.corners[:, :1]
    # orthonormal directions within each element, so that determinants there are those of the tangential part
    frames = np.linalg.qr(edges.transpose(0, 2, 1))[0]
    with np.errstate(invalid="ignore"):
        within = np.einsum("eda,edc,ecb->eab", frames, np.where(finite[:, None, None], sigma, -1), frames)
        principal, directions = np.linalg.eigh(within)
    if len(bad := np.flatnonzero(~(finite & symmetric & (principal[:, 0] > 0)))):
        tensor = f"conductivity tensor of {mesh.noun} {bad[0]} is {sigma[bad[0]].tolist()}"
        raise ModelError(f"{tensor}; it must be symmetric positive definite ({_unit(mesh)})")
    values = np.exp(np.log(principal).mean(axis=1))
    turned = frames @ directions
    roots = turned * np.sqrt(principal / values[:, None])[:, None]
    return values, roots @ turned.transpose(0, 2, 1) if dim == edges.shape[1] else roots  # symmetric: alike throughout


def _unit(mesh: Mesh) -> str:
    return "siemens per square" if mesh.dim == 2 else "siemens per metre"


def cosines(points: Floats, domain: Domain, coefficients: ArrayLike) -> Floats:
    """A smooth field on a flat sheet: products of cosines with 0, 1, 2, ... half waves along x and along y.

    Along x, round a closed band, the cosine and the sine of one wave, then those of two, and so on.

    Args:
        points: (n, 2) in metres.
        domain: The sheet.
        coefficients: (n_waves^2,) or (n_waves^2, k), those of one number of half waves along x beside each other, the
            constant first.

    Returns:
        (n,) or (n, k) values of the fields.
    """
    given = np.asarray(coefficients, float)
    x0, y0, x1, y1 = domain.bounds
    waves = np.pi * np.arange(round(len(given) ** 0.5))
    at = (points - np.array([x0, y0])) / np.array([x1 - x0, y1 - y0])
    x, y = (np.cos(np.outer(along, waves)) for along in at.T)
    if domain.period:
        turns = 2 * np.pi * np.outer(at[:, 0], (np.arange(len(waves)) + 1) // 2)
        x = np.where(np.arange(len(waves)) % 2, np.cos(turns), np.where(waves > 0, np.sin(turns), 1.0))
    return np.asarray((x[:, :, None] * y[:, None, :]).reshape(len(points), -1) @ given)
