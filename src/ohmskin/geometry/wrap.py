"""A flat sheet wrapped on a surface: the flat shape from which that takes least, and how it is stretched there."""

import numpy as np
from scipy.sparse.linalg import splu

from ohmskin.arrays import Floats
from ohmskin.errors import GeometryError
from ohmskin.geometry.band import Band
from ohmskin.geometry.chart import Chart
from ohmskin.geometry.domain import Domain, Rectangle
from ohmskin.geometry.flatten import flat_patch, stiffness_matrix
from ohmskin.geometry.holes import Holed, without_holes
from ohmskin.geometry.mesh import Mesh
from ohmskin.geometry.meshing import mesh_domain
from ohmskin.geometry.periodic import folded
from ohmskin.geometry.raster import node_means

_POISSON = 0.5  # a sheet that keeps its volume
_FINE = 30  # edges along the root of the area
_SEAMS = 360  # places at which a sleeve with holes may be cut open
_ROUNDS, _STILL = 2000, 1e-7  # share of the size, by which nodes move at the end


class Wrap:
    """A flat elastic sheet that is wrapped on a skin's surface, cut so that this takes least energy.

    Holes of the skin's description are taken as cut out afterwards: they change no strain.

    Args:
        chart: The skin.
    """

    def __init__(self, chart: Chart) -> None:
        domain = without_holes(chart.domain)
        self._mesh = mesh_domain(cut_open(domain), float(np.sqrt(domain.area)) / _FINE)
        surface, self._period = self._mesh.mapped(chart.points), chart.domain.period
        self._values: Floats = node_stretches(self._mesh, surface, flattened(surface))

    def log_stretch(self, places: Floats) -> Floats:
        """Logarithm (n, 2, 2) of the stretch at places (n, 2) of the map, along its x and y; positive: it is longer."""
        element, weights = self._mesh.locate(folded(places, self._period))
        return np.asarray(np.einsum("nk,nkij->nij", weights, self._values[self._mesh.elements[element]]))


def cut_open(domain: Domain, seam: float = 0.0) -> Domain:
    """The domain itself; of a sleeve the rectangle that it is when it is cut open where x is `seam`, in no hole (m)."""
    if isinstance(sleeve := without_holes(domain), Band):
        sheet = Rectangle(sleeve.circumference, sleeve.height)
        if not isinstance(domain, Holed):
            return sheet
        ahead = (hole.polygon.vertices - [seam, 0.0] for hole in domain.cutouts)
        turns = domain.period * np.array([1.0, 0.0])
        return Holed(sheet, [corners - turns * np.floor(corners[:, 0].min() / domain.period) for corners in ahead])
    return domain


def seam_of(domain: Domain) -> float:
    """Where a sleeve is cut open (m): at x = 0 or, if a hole lies there, as far from holes as can be; 0 of others.

    Raises:
        GeometryError: If there are holes all round.
    """
    if not isinstance(domain, Holed) or not domain.period:
        return 0.0
    seams = domain.period * np.arange(_SEAMS) / _SEAMS
    middles, halves = (
        np.array([[low + high, high - low] for low, _, high, _ in (c.bounds for c in domain.cutouts)]).T / 2
    )
    turns = (seams[:, None] - middles) / domain.period
    room = (domain.period * np.abs(turns - np.rint(turns)) - halves).min(axis=1)
    best = 0 if room[0] > 0 else int(room.argmax())
    if room[best] <= 0:
        raise GeometryError("there is no straight line along this sleeve without a hole, to cut it open; close some")
    return float(seams[best])


def flattened(surface: Mesh) -> Floats:
    """Places (n_nodes, 2) of a surface's nodes on the flat elastic sheet that it takes least energy to wrap on it (m).

    The energy is that of a Hookean sheet, its strains measured from the surface. Begins with a map true to angles; then
    each triangle is turned as it lies, and all are joined, in turns (Liu et al. 2008, Computer Graphics Forum 27:1495,
    with the energy's part of the area beside).

    Raises:
        GeometryError: If the surface would fold over.
    """
    slopes = surface.gradients @ _axes(surface).transpose(0, 2, 1)  # (n_elem, 3, 2)
    weighted = surface.measures[:, None, None] * slopes
    joined = splu(stiffness_matrix(surface)[1:, 1:].tocsc())
    ratio = _POISSON / (1 - _POISSON)
    step, laid = 2 / (2 + 2 * ratio), flat_patch(surface).nodes
    size = float(np.sqrt(surface.measures.sum()))
    for _ in range(_ROUNDS):
        map_ = np.einsum("eki,ekj->eij", laid[surface.elements], slopes)
        angle = np.arctan2(map_[:, 1, 0] - map_[:, 0, 1], map_[:, 0, 0] + map_[:, 1, 1])
        cos, sin = np.cos(angle), np.sin(angle)
        turn = np.stack([cos, -sin, sin, cos], axis=1).reshape(-1, 2, 2)
        swollen = np.einsum("eij,eij->e", turn, map_) - 2
        pull = step * (map_ - turn + ratio * swollen[:, None, None] * turn)
        load = np.zeros_like(laid)
        np.add.at(load, surface.elements, np.einsum("ekj,eij->eki", weighted, pull))
        move = np.vstack([np.zeros((1, 2)), joined.solve(load[1:])])
        laid = laid - move
        if np.abs(move - move.mean(axis=0)).max() < _STILL * size:
            break
    flat = Mesh(laid, surface.elements)
    if flat.flipped:
        raise GeometryError("a flat sheet does not lie on this surface without folds; cut it into two skins")
    return laid


def node_stretches(mesh: Mesh, surface: Mesh, laid: Floats) -> Floats:
    """Logarithm (n_nodes, 2, 2) of the stretch of a sheet wrapped on a skin, along the x and y of its map.

    Args:
        mesh: The map.
        surface: The same triangles in space.
        laid: (n_nodes, 2) where the nodes are on the flat sheet (m).
    """
    axes = _axes(surface)
    backwards = np.einsum("eki,ekj->eij", laid[mesh.elements], surface.gradients @ axes.transpose(0, 2, 1))
    squares, directions = np.linalg.eigh(backwards.transpose(0, 2, 1) @ backwards)
    onto = np.einsum("eid,ekd,ekj->eij", axes, surface.corners, mesh.gradients)  # from the map's x and y
    left, _, right = np.linalg.svd(onto)
    directions = (left @ right).transpose(0, 2, 1) @ directions
    logarithms = -(directions * np.log(squares)[:, None] / 2) @ directions.transpose(0, 2, 1)
    return np.asarray((node_means(mesh) @ logarithms.reshape(-1, 4)).reshape(-1, 2, 2))


def _axes(surface: Mesh) -> Floats:
    """Two unit vectors (n_elem, 2, 3) along each triangle, at right angles."""
    ahead = surface.corners[:, 1:] - surface.corners[:, :1]
    x = ahead[:, 0] / np.linalg.norm(ahead[:, 0], axis=1, keepdims=True)
    across = ahead[:, 1] - np.sum(ahead[:, 1] * x, axis=1, keepdims=True) * x
    return np.stack([x, across / np.linalg.norm(across, axis=1, keepdims=True)], axis=1)
