"""Meshes that are finer at the electrodes, by gmsh (extra ``mesh``): of flat domains and of surfaces in space."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import GeometryError
from ohmskin.geometry.domain import Domain
from ohmskin.geometry.electrodes import ElectrodeKind, Electrodes
from ohmskin.geometry.extra import optional
from ohmskin.geometry.mesh import Mesh, used_nodes
from ohmskin.geometry.meshing import key_points, rim_loops

_FEWEST = 8  # edges along an electrode
_CREASE = np.pi / 4  # angle between triangles from which an edge of a surface is kept


def mesh_graded(
    domain: Domain, size: float, electrodes: Electrodes, fine: float | None = None, growth: float = 0.25
) -> Mesh:
    """A triangle mesh of a flat domain that is finer at the electrodes.

    Points and centres of discs are nodes, so are ends of rim segments; edges follow discs that do not reach the rim.

    Args:
        domain: What to mesh.
        size: Edge length far from electrodes (m).
        electrodes: Where to refine.
        fine: Edge at electrodes (m); an eighth of the extent unless given, at most `size`; of `size` for points.
        growth: By how much edges lengthen per length away from electrodes (1), 0.01 to 1.

    Raises:
        GeometryError: If gmsh is not installed, a size is not positive or above half of the domain, `growth` is not
            within 0.01 to 1, or an electrode lies outside the domain.
    """
    x0, y0, x1, y1 = domain.bounds
    sizes = _Sizes(size, electrodes, fine, growth, min(x1 - x0, y1 - y0))
    keys = key_points(domain, electrodes)
    depth = domain.depth(keys)
    tolerance = 1e-9 * domain.perimeter
    if len(outside := np.flatnonzero(depth < -tolerance)):
        raise GeometryError(f"electrode at {keys[outside[0]]} lies outside the domain {domain}; move it inside")
    with _gmsh() as gmsh:
        rims = rim_loops(domain, keys, tolerance, sizes.divide)
        loops = [gmsh.model.geo.addCurveLoop(_closed(gmsh, rim)) for rim in rims]
        surface = gmsh.model.geo.addPlaneSurface(loops)
        points = [gmsh.model.geo.addPoint(x, y, 0.0) for x, y in keys[depth >= tolerance]]
        lines: list[int] = []
        for kind, centre, radius in zip(electrodes.kinds, electrodes.positions, electrodes.extents, strict=True):
            if kind == ElectrodeKind.DISC and domain.depth(centre[None])[0] > radius + sizes.at(centre[None])[0]:
                count = max(4 * _FEWEST, int(np.ceil(2 * np.pi * radius / sizes.at(centre[None])[0])))
                angle = 2 * np.pi * np.arange(count) / count
                lines += _closed(gmsh, centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
        gmsh.model.geo.synchronize()
        gmsh.model.mesh.embed(0, points, 2, surface)
        gmsh.model.mesh.embed(1, lines, 2, surface)
        sizes.set(gmsh)
        gmsh.model.mesh.generate(2)
        nodes, elements = _triangles(gmsh)
    return Mesh(nodes[:, :2], elements)


def mesh_surface(
    surface: Mesh, size: float, electrodes: Electrodes, fine: float | None = None, growth: float = 0.25
) -> Mesh:
    """A surface in space meshed anew, finer at the electrodes, which are exactly at nodes.

    Args:
        surface: Triangles in space, such as a robot's link read from STL (`read_mesh`).
        size: Edge length far from electrodes (m).
        electrodes: Where to refine; within a thousandth of the surface's extent of it.
        fine: Edge at electrodes (m); an eighth of an area electrode's extent, or of `size` for points, unless given.
        growth: By how much edges lengthen per length away from electrodes (1), 0.01 to 1.

    Raises:
        GeometryError: If gmsh is missing or cannot mesh the surface, a size is out of range, or an electrode is off it.
    """
    if surface.nodes.shape[1] != 3 or surface.dim != 2:
        raise GeometryError("mesh_surface() meshes triangles in space anew; for a flat domain use mesh_graded()")
    if electrodes.positions.shape[1] != 3:
        raise GeometryError("electrodes of a surface in space need three coordinates; move them with mapped()")
    sizes = _Sizes(size, electrodes, fine, growth, float(np.ptp(surface.nodes, axis=0).max()))
    with _gmsh() as gmsh:
        tag = gmsh.model.addDiscreteEntity(2)
        gmsh.model.mesh.addNodes(2, tag, np.arange(1, surface.n_nodes + 1), surface.nodes.ravel())
        gmsh.model.mesh.addElementsByType(tag, 2, [], (surface.elements + 1).ravel())
        try:
            gmsh.model.mesh.removeDuplicateNodes()
            gmsh.model.mesh.classifySurfaces(_CREASE, True, True, np.pi)
            gmsh.model.mesh.createGeometry()
            faces = [face for _, face in gmsh.model.getEntities(2)]
            for k, position in enumerate(electrodes.positions):
                away = [np.linalg.norm(gmsh.model.getClosestPoint(2, face, position)[0] - position) for face in faces]
                if min(away) > 1e-3 * sizes.extent:
                    raise GeometryError(f"electrode {k} at {position} is {min(away):.2g} m off the surface; move it")
                point = gmsh.model.geo.addPoint(*position)
                gmsh.model.geo.synchronize()
                gmsh.model.mesh.embed(0, [point], 2, faces[int(np.argmin(away))])
            sizes.set(gmsh)
            gmsh.model.mesh.generate(2)
        except GeometryError:
            raise
        except Exception as error:  # gmsh raises Exception itself
            advice = "repair it, or move electrodes off its creases"
            raise GeometryError(f"gmsh cannot mesh this surface: {error}; {advice}") from error
        nodes, elements = _triangles(gmsh)
    return Mesh(nodes, elements)


class _Sizes:
    """Edge lengths that grow from the electrodes outwards."""

    def __init__(self, size: float, electrodes: Electrodes, fine: float | None, growth: float, extent: float) -> None:
        for name, value in (("size", size), ("fine", size if fine is None else fine)):
            if not (np.isfinite(value) and 1e-5 * extent <= value <= extent / 2):
                raise GeometryError(f"mesh {name} {value!r} m; it must be {1e-5 * extent:.3g} to {extent / 2:.3g} m")
        if not 0.01 <= growth <= 1:
            raise GeometryError(f"mesh growth is {growth!r}; it must be 0.01 to 1")
        self.size, self.growth, self.extent = size, growth, extent
        # of an area electrode its edge: that is where current crowds
        on_rim = np.array([kind == ElectrodeKind.RIM for kind in electrodes.kinds])
        self.reach: Floats = np.where(on_rim, electrodes.extents / 2, electrodes.extents)
        wide = np.where(self.reach > 0, 2 * self.reach, size)
        self.fine: Floats = np.minimum(size, wide / _FEWEST if fine is None else np.full(len(electrodes), fine))
        self.centres = electrodes.positions
        self._tree = cKDTree(self.centres)

    def at(self, points: Floats) -> Floats:
        """Edge length (n,) at points (n, dim)."""
        count = min(4, len(self.centres))
        distance, nearest = self._tree.query(points, k=count)
        beyond = np.maximum(0.0, distance - self.reach[nearest])
        return np.asarray(np.minimum(self.size, (self.fine[nearest] + self.growth * beyond).min(axis=1)))

    def divide(self, loop: Domain, start: float, end: float) -> Floats:
        """Arc lengths (n,) of points along a rim from `start` until before `end`, an edge length apart (m)."""
        # the integral of 1 / size along the arc counts edges; at equal shares of it lie the points
        fine = np.linspace(start, end, max(16, int(np.ceil(4 * (end - start) / self.fine.min()))) + 1)
        density = 1 / self.at(loop.rim((fine[1:] + fine[:-1]) / 2))
        edges = np.concatenate([[0.0], np.cumsum(density * np.diff(fine))])
        count = max(1, round(float(edges[-1])))
        return np.asarray(np.interp(edges[-1] * np.arange(count) / count, edges, fine))

    def set(self, gmsh: Any) -> None:
        """Tell gmsh."""
        for option in ("MeshSizeFromPoints", "MeshSizeExtendFromBoundary", "MeshSizeFromCurvature"):
            gmsh.option.setNumber(f"Mesh.{option}", 0)
        dim = self.centres.shape[1]
        gmsh.model.mesh.setSizeCallback(lambda _d, _t, x, y, z, _l: float(self.at(np.array([[x, y, z][:dim]]))[0]))


def _keep_broken_pipes_harmless() -> None:
    """gmsh lets a broken pipe end the whole process; Python had it raise BrokenPipeError, and so it shall stay."""
    if hasattr(signal, "SIGPIPE") and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGPIPE, signal.getsignal(signal.SIGPIPE))


@contextmanager
def _gmsh() -> Iterator[Any]:
    """gmsh with a model of its own, quiet; one that is in use already stays as it is."""
    gmsh = optional("gmsh")
    running = bool(gmsh.isInitialized())
    if not running:
        gmsh.initialize(interruptible=False, readConfigFiles=False)
        _keep_broken_pipes_harmless()
    before = gmsh.model.getCurrent() if running else ""
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("ohmskin")
    try:
        yield gmsh
    finally:
        gmsh.model.mesh.removeSizeCallback()
        gmsh.model.remove()
        if running:
            gmsh.model.setCurrent(before)
        else:
            gmsh.finalize()


def _closed(gmsh: Any, points: ArrayLike) -> list[int]:
    """Lines of one edge each through points and back."""
    tags = [gmsh.model.geo.addPoint(x, y, 0.0) for x, y in np.asarray(points)]
    lines = [gmsh.model.geo.addLine(a, b) for a, b in zip(tags, tags[1:] + tags[:1], strict=True)]
    for line in lines:
        gmsh.model.geo.mesh.setTransfiniteCurve(line, 2)
    return lines


def _triangles(gmsh: Any) -> tuple[Floats, Ints]:
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    corners = gmsh.model.mesh.getElementsByType(2)[1].astype(np.int64).reshape(-1, 3)
    place = np.full(int(tags.max()) + 1, -1, np.int64)
    place[tags.astype(np.int64)] = np.arange(len(tags))
    return used_nodes(coordinates.reshape(-1, 3), place[corners])
