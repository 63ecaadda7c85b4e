"""The conductive sheet of a skin: its shape, flat or in space, and how it conducts."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.errors import GeometryError, SkinError
from ohmskin.geometry import Chart, Disc, FlatChart, MeshChart, Polygon, Rectangle, RevolutionChart
from ohmskin.geometry.files import joined_nodes
from ohmskin.geometry.holes import Hole, with_holes
from ohmskin.geometry.mesh import Mesh
from ohmskin.geometry.regions import read_triangles
from ohmskin.geometry.surface import check_outside, cut_off, grown, pieces
from ohmskin.geometry.wrap import Wrap
from ohmskin.skin.checks import check_table, choice, cutouts, number, numbers, places, rows, sibling_path
from ohmskin.skin.surface import surface_of, surface_text
from ohmskin.skin.urdf import link_mesh

_TURN = 2 * np.pi
_PROFILE = 60  # points of the profile of a cap
_MOST_CORNERS = 400
_SHAPES = (
    "rectangle", "disc", "polygon", "cylinder", "cone", "sphere", "ellipsoid", "capsule", "revolution", "mesh"
)  # fmt: skip


@dataclass(frozen=True)
class Sheet:
    """The conductive sheet.

    Flat: a ``rectangle`` has its lower left corner at the origin, a ``disc`` is centred there, a ``polygon`` has the
    corners [x, y] of `outline`. In space, about the z
    axis: a ``cylinder`` of `radius` from z = 0 to `height`, and a ``cone`` from `radius` to `top_radius`, of which
    there is the part `angle` of a turn about the direction of x, or all of it, a sleeve; a ``sphere``, the cap of a
    ball of `radius` about the origin down to `angle` from the positive z axis, and an ``ellipsoid``, the same, its pole
    at `height`; a ``capsule``, half a ball on a wall of `radius` and `height`; and ``revolution``, whatever `profile`
    [distance from the axis, z] says. Its map, where electrodes are placed and contacts reported, is `RevolutionChart`.

    A ``mesh`` is cut from the triangles of a `file` (STL, OBJ, ...; `scale` metres per unit of it) that lies beside the
    skin file, or of a `link` of a URDF file and its `visual`, which also say its scale and place: those of a named
    `region` of the file; of these, what is left where nx x + ny y + nz z >= d (m) for each [nx, ny, nz, d] of `cut`; of
    this, the piece at the place `seed` [x, y, z] (m), up to edges where it bends by more than `crease`. It is kept as
    `surface`, the same in text, so that a skin does not depend on the file; see `MeshChart`.

    `holes` are cut into a sheet of any shape: [x, y, radius] is round, a polygon has its corners [x, y], at places of
    the map (m); radii are metres on the skin.

    A sheet in space is sprayed on, alike everywhere, or, if `wrapped`, a flat one cut to its pattern and stretched
    over the surface. It keeps its volume, so that it conducts less where it is thinner; along a stretch by a factor its
    resistivity grows with the power `gauge_factor` - 2 of it, so that a strip's resistance grows with the power
    `gauge_factor`.
    """

    shape: str = choice("rectangle", *_SHAPES)
    width: float = number(0.2, 1e-3, 10, "m")
    height: float = number(0.2, 1e-3, 10, "m")
    radius: float = number(0.1, 1e-3, 10, "m")
    top_radius: float = number(0.05, 1e-3, 10, "m")
    angle: float = number(_TURN, 0.1, _TURN, "rad")
    outline: tuple[tuple[float, float], ...] = ()
    profile: tuple[tuple[float, float], ...] = ()
    holes: tuple[Hole, ...] = cutouts()
    file: str = ""
    link: str = ""
    visual: str = ""
    region: str = ""
    scale: float = number(1.0, 1e-6, 1e3, "m per unit")
    cut: tuple[tuple[float, ...], ...] = rows("[nx, ny, nz, d], a plane")
    seed: tuple[float, ...] = numbers(1e3, "m", low=-1e3)
    crease: float = number(0.6, 0.01, np.pi, "rad")
    surface: str = ""
    wrapped: bool = False
    gauge_factor: float = number(2.0, -100, 100)
    conductivity: float = number(1.83e-3, 1e-9, 1e6, "S per square")

    def __post_init__(self) -> None:
        for name in ("outline", "profile", "holes", "cut"):
            object.__setattr__(self, name, places(getattr(self, name)))

    def read(self, folder: Path) -> "Sheet":
        """The sheet with what is cut from its file, which lies in a folder, as its `surface`.

        Raises:
            SkinError: If the file cannot be read or lies elsewhere, or there is nothing left of it.
        """
        check_table("sheet", self)
        path = sibling_path(folder, self.file, "sheet.file", "skin file")
        try:
            surface = surface_text(self._cut_out(path, folder))
        except (GeometryError, SkinError) as error:
            raise SkinError(f"sheet: {error}") from None
        return replace(self, surface=surface, **{name: getattr(_WHOLE, name) for name in _OF_FILE})

    def _cut_out(self, path: Path, folder: Path) -> Mesh:
        """The triangles of the skin, of its file, in metres."""
        if self.link or self.visual or path.suffix.lower() == ".urdf":
            shown = link_mesh(path, self.link, self.visual, folder)
            nodes, triangles = read_triangles(shown.path, self.region)
            nodes = shown.placed(nodes * self.scale)
        else:
            nodes, triangles = read_triangles(path, self.region)
            nodes = nodes * self.scale
        if not np.isfinite(nodes[triangles]).all():
            wrong = int(np.flatnonzero(~np.isfinite(nodes[triangles]).all(axis=(1, 2)))[0])
            raise GeometryError(f"a corner of triangle {wrong} is not a finite number; mend the mesh")
        if (extent := float(np.ptp(nodes[triangles].reshape(-1, 3), axis=0).max())) > _MOST_EXTENT:
            large = f"the mesh is {extent:.4g} m large, {_MOST_EXTENT:g} m are allowed"
            raise GeometryError(f"{large}; give scale, which is 1e-3 if the file is in millimetres")
        nodes, triangles, *_ = joined_nodes(nodes, triangles)
        triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]  # of joined nodes, empty ones
        check_outside(nodes, triangles)
        for plane in self.cut:
            nodes, triangles = cut_off(nodes, triangles, plane)
        if self.seed:
            if len(self.seed) != 3:
                raise GeometryError(f"seed is {list(self.seed)}; it must be a place [x, y, z] in metres")
            nodes, triangles = grown(nodes, triangles, self.seed, self.crease)
        elif (count := int(pieces(nodes, triangles).max()) + 1) > 1:
            raise GeometryError(f"the rest are {count} separate pieces; choose one by seed, or cut off more")
        return Mesh(nodes, triangles)

    @property
    def chart(self) -> Chart:
        """The map of the sheet.

        Raises:
            SkinError: If there is no such sheet.
        """
        try:
            return _chart(self)
        except GeometryError as error:
            raise SkinError(f"sheet: {error}") from None

    def strained(self, places: Floats) -> Floats:
        """The conductivity at places (n, 2) of the map over that of the unstretched sheet.

        It is (n,) or, where the sheet conducts better in some directions than in others, (n, 2, 2).
        """
        if not self.wrapped or self.chart.flat:
            return np.ones(len(places))
        stretch = _wrap(self).log_stretch(places)
        thinner = np.exp(-np.trace(stretch, axis1=1, axis2=2))
        if self.gauge_factor == 2.0:
            return np.asarray(thinner)
        along, directions = np.linalg.eigh(stretch)
        less = np.exp((2.0 - self.gauge_factor) * along)
        return np.asarray(thinner[:, None, None] * (directions * less[:, None]) @ directions.transpose(0, 2, 1))


_MOST_EXTENT = 10.0  # m, of a mesh file
_WHOLE = Sheet()
_OF_FILE = ("file", "link", "visual", "region", "scale", "cut", "seed", "crease")  # how a surface is cut from a file


@lru_cache(maxsize=16)
def _wrap(sheet: Sheet) -> Wrap:
    return Wrap(sheet.chart)


@lru_cache(maxsize=64)
def _chart(sheet: Sheet) -> Chart:
    for shape, name in (("revolution", "profile"), ("polygon", "outline")):
        if (sheet.shape == shape) != bool(getattr(sheet, name)):
            raise GeometryError(f'entry {name} and shape = "{shape}" go together')
    if len(sheet.outline) > _MOST_CORNERS:
        raise GeometryError(f"an outline of {len(sheet.outline)} corners; {_MOST_CORNERS} are allowed")
    if any((sheet.file, sheet.link, sheet.visual, sheet.region, sheet.cut, sheet.seed)):
        raise GeometryError("a mesh file is read by Skin.load() or Sheet.read(), which keep it as surface")
    if (sheet.shape == "mesh") != bool(sheet.surface):
        raise GeometryError('a mesh file, or its surface, and shape = "mesh" go together')
    if sheet.shape == "mesh":
        return MeshChart(surface_of(sheet.surface), sheet.holes)
    if sheet.shape == "rectangle":
        return FlatChart(with_holes(Rectangle(sheet.width, sheet.height), sheet.holes))
    if sheet.shape == "disc":
        return FlatChart(with_holes(Disc(sheet.radius), sheet.holes))
    if sheet.shape == "polygon":
        return FlatChart(with_holes(Polygon(sheet.outline), sheet.holes))
    if sheet.shape == "revolution":
        return RevolutionChart(sheet.profile, sheet.angle, sheet.holes)
    if sheet.shape in ("sphere", "ellipsoid"):
        if sheet.angle > 0.9 * np.pi:
            raise GeometryError(f"a cap reaches {sheet.angle:.3g} rad from its pole; it may reach 2.8 rad, see angle")
        polar, top = np.linspace(0, sheet.angle, _PROFILE), sheet.radius if sheet.shape == "sphere" else sheet.height
        return RevolutionChart(np.column_stack([sheet.radius * np.sin(polar), top * np.cos(polar)]), holes=sheet.holes)
    if sheet.shape == "capsule":
        polar, wall = np.linspace(0, np.pi / 2, _PROFILE), np.linspace(sheet.height, 0, _PROFILE)[1:]
        half = np.column_stack([np.sin(polar), np.cos(polar)]) * sheet.radius + [0, sheet.height]
        profile = np.vstack([half, np.column_stack([np.full(len(wall), sheet.radius), wall])])
        return RevolutionChart(profile, holes=sheet.holes)
    top = sheet.radius if sheet.shape == "cylinder" else sheet.top_radius
    return RevolutionChart([(sheet.radius, 0.0), (top, sheet.height)], sheet.angle, sheet.holes)
