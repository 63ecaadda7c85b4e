"""Discs and what they do to the data: sensitivity integrals over discs anywhere on a sheet."""

from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ohmskin.forward import TransferModel
from ohmskin.geometry import Mesh
from ohmskin.geometry.domain import Floats

_STEPS = 4  # subdivisions of a triangle's edges


@dataclass(frozen=True)
class Discs:
    """Sample points of a mesh, fine enough to say how much of each triangle a disc covers. Discs in space are balls.

    Args:
        mesh: The mesh.
        points: (n_points, dim of space) in metres.
        sizes: (n_points,) area each stands for (m2; volume in space, m3).
        element: (n_points,) the triangle each lies in.
        edge: Width over which the edge of a disc is softened, the distance of neighbouring points (m).
    """

    mesh: Mesh
    points: Floats
    sizes: Floats
    element: np.ndarray
    edge: float
    _tree: cKDTree = field(repr=False)

    @classmethod
    def on(cls, mesh: Mesh) -> "Discs":
        """Sample points on a mesh: a centred lattice in each triangle."""
        cells = mesh.elements
        corners = cells.shape[1]
        lattice = np.array([c for c in product(range(_STEPS), repeat=corners) if sum(c) == _STEPS - 1])
        weights = (lattice + 1 / corners) / _STEPS
        points = np.einsum("qc,ecd->eqd", weights, mesh.nodes[cells]).reshape(-1, mesh.nodes.shape[1])
        sizes = np.repeat(mesh.measures / len(weights), len(weights))
        edge = float(np.median(sizes)) ** (1 / (corners - 1))
        return cls(mesh, points, sizes, np.repeat(np.arange(mesh.n_elem), len(weights)), edge, cKDTree(points))

    def cover(self, position: Floats, radius: float) -> tuple[np.ndarray, Floats]:
        """Which triangles (n,) a disc covers, and by how much: (dim + 2, n) areas, their derivatives by position, and by radius."""
        near = np.asarray(self._tree.query_ball_point(position, radius + self.edge), dtype=int)
        if not len(near):
            return near, np.zeros((len(position) + 2, 0))
        offset = self.points[near] - position
        distance = np.linalg.norm(offset, axis=1)
        depth = np.clip((radius - distance) / self.edge, -1.0, 1.0)
        share = 0.5 * (1 + np.sin(0.5 * np.pi * depth))
        slope = 0.25 * np.pi * np.cos(0.5 * np.pi * depth) / self.edge
        direction = offset / np.maximum(distance, 1e-300)[:, None]
        rows = np.vstack([share, (slope[:, None] * direction).T, slope]) * self.sizes[near]
        elements, which = np.unique(self.element[near], return_inverse=True)
        return elements, np.stack([np.bincount(which, row, len(elements)) for row in rows])

    def tangent(self, position: Floats) -> Floats:
        """Projector (dim of space, dim of space) onto the sheet at a position: a contact on a curved surface moves along it."""
        if self.mesh.dim == len(position):
            return np.eye(len(position))
        corners = self.mesh.nodes[self.mesh.elements[self.element[self._tree.query(position)[1]]]]
        axes = np.linalg.qr((corners[1:] - corners[0]).T)[0]
        return np.asarray(axes @ axes.T)

    def onto(self, position: Floats) -> Floats:
        """The position itself, or the closest sample point where it is off the sheet."""
        distance, point = self._tree.query(position)
        return position if distance < 1.5 * self.edge else self.points[point]


class DiscResponse:
    """What discs do to the resistances of all electrode pairs, to first order in what the sheet's current does elsewhere.

    A disc of conductivity ratio rho disturbs a field that varies slowly over it as 2 (rho - 1) / (rho + 1) times its area does
    to first order (in the plane, exactly, whatever the field: every multipole has the same factor; 3 (rho - 1) / (rho + 2) for
    a ball in a uniform field). What is left out is the disc's influence on itself by way of the rim, and on other discs.

    Args:
        model: The untouched sheet.
    """

    def __init__(self, model: TransferModel) -> None:
        self.model = model
        self.discs = Discs.on(model.mesh)
        self.dim = model.mesh.dim
        self._density: Floats = model.pair_sensitivity * (model.conductivity / model.mesh.measures)  # ohms per square metre

    def __call__(self, position: Floats, radius: float, log_ratio: float) -> tuple[Floats, Floats]:
        """Change of pair resistances (n_pairs,) in ohms; derivatives (n_pairs, dim + 2) by position, log radius, log ratio."""
        elements, cover = self.discs.cover(position, radius)
        unit = self.integral(elements, cover.T)
        factor, slope = effective_change(log_ratio, self.dim)
        moves = unit[:, 1:-1] @ self.discs.tangent(position)
        derivatives = np.column_stack([factor * moves, factor * radius * unit[:, -1], slope * unit[:, 0]])
        return factor * unit[:, 0], derivatives

    def integral(self, elements: np.ndarray, areas: Floats) -> Floats:
        """Integrals (n_pairs, ...) of the relative sensitivity over parts (n, ...) of some triangles (n,), in ohms."""
        return np.asarray(self._density[:, elements] @ areas)

    def image(self, positions: Floats, radii: Floats, strengths: Floats) -> Floats:
        """Relative conductivity change (n_elem,) of discs; where they overlap their changes add up."""
        values = np.zeros(self.model.mesh.n_elem)
        for position, radius, strength in zip(positions, radii, strengths, strict=True):
            elements, cover = self.discs.cover(position, radius)
            values[elements] += strength * cover[0] / self.model.mesh.measures[elements]
        return values

    def at_triangles(self, radius: float) -> Floats:
        """Responses (n_pairs, n_elem) of discs of one radius about each triangle, per effective change."""
        columns = np.empty((len(self._density), self.model.mesh.n_elem))
        for k, centre in enumerate(self.model.mesh.centroids):
            elements, cover = self.discs.cover(centre, radius)
            columns[:, k] = self.integral(elements, cover[0])
        return columns


def effective_change(log_ratio: ArrayLike, dim: int = 2) -> tuple[Floats, Floats]:
    """dim (rho - 1) / (rho + dim - 1) of a conductivity ratio rho, given as its logarithm, and the derivative by the logarithm."""
    ratio = np.exp(np.asarray(log_ratio, float))
    return dim * (ratio - 1) / (ratio + dim - 1), dim**2 * ratio / (ratio + dim - 1) ** 2
