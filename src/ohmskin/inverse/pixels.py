"""Images of square pixels: unknowns that stay the same whatever the mesh.

Eq. (5) of the paper on the triangles of a mesh believes other things on another mesh: its smallest eigenvalue falls
ninety-fold from 2,000 triangles to 200,000. On pixels the prior belongs to the skin, the mesh is only as fine as the
physics needs, and what an image costs does not depend on it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numba import njit
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import GeometryError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Mesh
from ohmskin.inverse.priors import Penalty

_SAMPLES = 4  # points along the side of a pixel that decide which pixels an element lies in


@dataclass(frozen=True, eq=False)
class Pixels:
    """The pixels that cover a flat mesh, row by row from the lowest y. Those off the mesh are left out.

    Args:
        x, y: Pixel centres (nx,), (ny,) in metres, of the whole grid.
        pitch: Side of a pixel (m).
        cells: (n_pixels,) number of each pixel in the grid (ny, nx), rising.
        shares: (n_elem, n_pixels) sparse, the share of each element that lies in each pixel; rows sum to one.
        measures: (n_pixels,) area of the mesh in each pixel (m2).
    """

    x: Floats
    y: Floats
    pitch: float
    cells: Ints
    shares: sp.csc_array
    measures: Floats
    period = 0.0

    @classmethod
    def over(cls, mesh: Mesh, count: int = 48) -> "Pixels":
        """The pixels over a flat mesh.

        Args:
            mesh: The mesh.
            count: Pixels along the longer side.

        Raises:
            GeometryError: If the mesh is a surface in space, or `count` is out of range.
        """
        if mesh.nodes.shape[1] != 2 or mesh.period:
            raise GeometryError("pixels need a flat mesh, not closed; make the image on the mesh's own elements")
        if not 2 <= count <= 1024:
            raise GeometryError(f"{count} pixels along the longer side; choose 2 to 1024")
        low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
        pitch = float((high - low).max() / count)
        nx, ny = (int(n) for n in np.maximum(1, np.ceil((high - low) / pitch - 1e-9)))
        corner = (low + high) / 2 - pitch * np.array([nx, ny]) / 2
        corners = mesh.nodes[mesh.elements]
        longest = float(np.sqrt(np.sum((corners - np.roll(corners, 1, axis=1)) ** 2, axis=2).max()))
        points = _middles(int(np.clip(np.ceil(np.log2(_SAMPLES * longest / pitch)), 0, 4)))
        entries = sample(mesh.nodes, mesh.elements, points, corner, pitch, nx, ny)
        shares = sp.csc_array(sp.csr_array(entries, shape=(mesh.n_elem, nx * ny)))
        areas = mesh.measures @ shares
        cells = np.flatnonzero(areas)
        shares, areas = (shares, areas) if len(cells) == nx * ny else (shares[:, cells], areas[cells])
        x, y = (corner[k] + pitch * (np.arange(n) + 0.5) for k, n in enumerate((nx, ny)))
        return cls(x, y, pitch, cells, shares, areas)

    def __len__(self) -> int:
        return len(self.cells)

    def __repr__(self) -> str:
        return f"Pixels({len(self)} of {self.pitch:.3g} m)"

    @cached_property
    def centroids(self) -> Floats:
        """Pixel centres (n_pixels, 2) in metres."""
        return np.column_stack([self.x[self.cells % len(self.x)], self.y[self.cells // len(self.x)]])

    @cached_property
    def neighbours(self) -> Ints:
        """The pixel (n_pixels, 4) to the left, right, below and above, -1 where there is none."""
        nx, ny = len(self.x), len(self.y)
        number = np.full((ny + 2, nx + 2), -1)
        row, column = self.cells // nx + 1, self.cells % nx + 1
        number[row, column] = np.arange(len(self.cells))
        return np.stack([number[row + dy, column + dx] for dy, dx in ((0, -1), (0, 1), (-1, 0), (1, 0))], axis=1)

    def closest_elements(self, points: ArrayLike, count: int = 3) -> Ints:
        """Numbers (n, count) of the pixels whose centres are closest to `points` (n, 2)."""
        return np.asarray(self._tree.query(np.asarray(points, float), k=count)[1], np.int64)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.centroids)

    @cached_property
    def penalty(self) -> Penalty:
        """The paper's eq. (5) for pixels: 4 on the diagonal, -1 for neighbours; pulled to zero at the rim."""
        n = len(self)
        row, column = np.repeat(np.arange(n), 4), self.neighbours.ravel()
        inside = column >= 0
        adjacency = sp.csc_array((np.ones(int(inside.sum())), (row[inside], column[inside])), shape=(n, n))
        matrix = sp.csc_array(4 * sp.eye_array(n) - adjacency)
        if n < len(self.x) * len(self.y):
            return Penalty(matrix, places=self.centroids)
        # of a whole rectangle the eigenvalues are known, and the mean of their inverses is the average variance
        shares = (np.pi * np.arange(1, len(axis) + 1) / (2 * len(axis) + 2) for axis in (self.x, self.y))
        across, along = (4 * np.sin(share) ** 2 for share in shares)
        variance = float(np.mean(1 / (across[:, None] + along)))
        return Penalty(matrix, mean_variance=variance, places=self.centroids)

    def sensitivity(self, model: TransferModel) -> Floats:
        """Change (n_pairs, n_pixels) of two-terminal resistances with each pixel's relative change (ohm).

        Args:
            model: The sheet, on the mesh that the pixels cover.
        """
        return model.grouped_sensitivity(sp.csc_array(sp.diags_array(model.conductivity) @ self.shares))


@njit(cache=True, nogil=True)
def sample(
    nodes: Floats, elements: Ints, points: Floats, corner: Floats, pitch: float, nx: int, ny: int
) -> tuple[Floats, Ints, Ints]:
    """The share of the barycentric `points` (n, 3) of each element that lies in each pixel, as compressed rows."""
    shares = np.empty(len(elements) * len(points))
    pixels = np.empty(len(elements) * len(points), np.int64)
    begin = np.zeros(len(elements) + 1, np.int64)
    count = 0
    for e in range(len(elements)):
        for k in range(len(points)):
            x = y = 0.0
            for c in range(3):
                x += points[k, c] * nodes[elements[e, c], 0]
                y += points[k, c] * nodes[elements[e, c], 1]
            column = min(max(int((x - corner[0]) / pitch), 0), nx - 1)
            pixel = min(max(int((y - corner[1]) / pitch), 0), ny - 1) * nx + column
            at = begin[e]
            while at < count and pixels[at] != pixel:
                at += 1
            if at == count:
                pixels[at], shares[at] = pixel, 0.0
                count += 1
            shares[at] += 1.0 / len(points)
        begin[e + 1] = count
    return shares[:count].copy(), pixels[:count].copy(), begin


def _middles(halvings: int) -> Floats:
    """Barycentric middles (4^halvings, 3) of the equal parts of a triangle whose sides are halved so many times."""
    triangles = np.eye(3)[None]
    for _ in range(halvings):
        a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return np.asarray(triangles.mean(axis=1))
