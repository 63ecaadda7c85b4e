"""Images on a regular grid of pixels, for pictures and for figures of merit."""

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import GeometryError
from ohmskin.geometry.mesh import Mesh


class Raster:
    """Square pixels over a flat mesh. Row 0 is at the bottom (smallest y); values belong to pixel centres.

    Args:
        mesh: The mesh whose element images are drawn.
        pixels: Number of pixels along the longer side.

    Attributes:
        x, y: Pixel centres (nx,), (ny,) in metres.
        pitch: Side of a pixel (m).
        inside: Which pixel centres (ny, nx) lie on the mesh.
        weights: Sparse matrix (ny * nx, n_elem) from element values to pixel values.

    Raises:
        GeometryError: If the mesh is a surface in space or `pixels` is out of range.
    """

    def __init__(self, mesh: Mesh, pixels: int = 64) -> None:
        if mesh.nodes.shape[1] != 2:
            raise GeometryError("a raster needs a flat mesh")
        if not 2 <= pixels <= 4096:
            raise GeometryError(f"{pixels} pixels along the longer side; choose 2 to 4096")
        low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
        self.pitch = float((high - low).max() / pixels)
        nx, ny = np.maximum(1, np.ceil((high - low) / self.pitch - 1e-9)).astype(int)
        first = (low + high) / 2 - self.pitch * np.array([nx - 1, ny - 1]) / 2
        self.x: Floats = first[0] + self.pitch * np.arange(nx)
        self.y: Floats = first[1] + self.pitch * np.arange(ny)
        centres = np.stack(np.meshgrid(self.x, self.y), axis=-1).reshape(-1, 2)
        element, barycentric = mesh.locate(centres)
        inside = element >= 0
        self.inside = inside.reshape(ny, nx)
        from_nodes = mesh.weighted(mesh.elements[element], barycentric * inside[:, None])
        from_nodes.eliminate_zeros()
        self.weights = sp.csr_array(from_nodes @ node_means(mesh))

    def __call__(self, values: ArrayLike) -> Floats:
        """Pixel values (ny, nx) of an element image (n_elem,): linear between nodes, NaN off the mesh.

        Raises:
            GeometryError: If it has not a value for each element.
        """
        image, n_elem = np.asarray(values, float), self.weights.shape[1]
        if image.shape != (n_elem,):
            raise GeometryError(f"an image of shape {image.shape}; this mesh has ({n_elem},) elements")
        pixels = (self.weights @ image).reshape(self.inside.shape)
        return np.where(self.inside, pixels, np.nan)


def node_means(mesh: Mesh) -> sp.csr_array:
    """Area-weighted means of element values at the nodes: a sparse matrix (n_nodes, n_elem)."""
    sums = mesh.weighted(mesh.elements, np.repeat(mesh.measures[:, None], 3, axis=1)).T
    return sp.csr_array(sp.diags_array(1 / sums.sum(axis=1)) @ sums)
