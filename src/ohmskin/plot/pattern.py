"""The cutting pattern of a skin: laid flat, to scale, with its electrodes, its seam, and what wrapping it stretches."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.tri import Triangulation

from ohmskin.arrays import Floats
from ohmskin.errors import DataError, GeometryError
from ohmskin.geometry import Domain, Mesh, mesh_domain
from ohmskin.geometry.periodic import folded
from ohmskin.geometry.surface import closed_walks
from ohmskin.geometry.wrap import cut_open, flattened, node_stretches, seam_of
from ohmskin.plot.colours import SIGNED
from ohmskin.skin import Skin

_FINE = 60  # edges along the root of the area
_DEVELOPABLE = 3e-3  # stretch below which a skin is called so
_MARGIN, _FOOT, _NARROWEST, _LARGEST = 12.0, 26.0, 130.0, 5000.0  # mm
_BAR = 100.0  # mm
_PER_INCH = 25.4  # mm


@dataclass(frozen=True, eq=False)
class Pattern:
    """A skin laid flat.

    Args:
        mesh: Triangles of the flat material (m).
        stretch: Metres on the skin for a metre of the material, the least and the most at each node (n_nodes, 2).
        electrodes: Numbers and places (2,) on the material (m); those on a seam are there twice, half on either side.
        radius: Of an electrode (m).
        seam: The two edges (n, 2) of a sleeve that are joined (m); none of other skins.
    """

    mesh: Mesh
    stretch: Floats
    electrodes: tuple[tuple[int, Floats], ...]
    radius: float
    seam: tuple[Floats, ...]

    @classmethod
    def of(cls, skin: Skin) -> "Pattern":
        """The pattern of a skin: what it takes least to wrap.

        A sleeve is cut open where x = 0, or past the holes there; a surface that is developable unrolls exactly.

        Raises:
            GeometryError: If holes leave no place to cut a sleeve open.
        """
        chart, domain, shift = skin.chart, skin.domain, np.array([seam_of(skin.domain), 0.0])
        places = folded(skin.electrodes.positions - shift, domain.period)
        on_seam = np.flatnonzero(places[:, 0] < 1e-9) if domain.period else np.zeros(0, int)
        places = np.vstack([places, places[on_seam] + [domain.period, 0]])
        mesh = _meshed(cut_open(domain, shift[0]), places)
        stretch, laid = np.ones((mesh.n_nodes, 2)), mesh
        if not chart.flat:
            surface = mesh.mapped(lambda nodes: chart.points(nodes + shift))
            unrolled = flattened(surface)
            stretch = np.exp(np.linalg.eigvalsh(node_stretches(mesh, surface, unrolled)))
            unrolled = unrolled * np.sqrt(domain.area / surface.measures.sum())  # triangles are chords
            z, map_ = (nodes - nodes.mean(axis=0) for nodes in (unrolled, mesh.nodes))
            turn = np.conj(z @ [1, 1j]) @ (map_ @ [1, 1j])
            turned = (z @ [1, 1j]) * turn / abs(turn)  # as the map lies
            laid = Mesh(np.column_stack([turned.real, turned.imag]), mesh.elements)
        numbers = [*range(len(skin.electrodes)), *on_seam]
        at = laid.nodes[mesh.nodes_at(places)]
        seam = []
        for x in (0.0, domain.period) if domain.period else ():
            edge = np.flatnonzero(np.abs(mesh.nodes[:, 0] - x) < 1e-9)
            seam.append(laid.nodes[edge[np.argsort(mesh.nodes[edge, 1])]])
        electrodes = tuple((int(n), place) for n, place in zip(numbers, at, strict=True))
        return cls(laid, stretch, electrodes, skin.electrode.radius, tuple(seam))

    @property
    def developable(self) -> bool:
        """Whether it lies on the skin without being stretched, to a third of a per cent."""
        return bool(np.abs(self.stretch - 1).max() < _DEVELOPABLE)

    def __str__(self) -> str:
        width, height = 1e3 * np.ptp(self.mesh.nodes, axis=0)
        size = f"{width:.1f} x {height:.1f} mm"
        if self.developable:
            return f"{size}, developable: it lies on the skin without being stretched"
        lengths, areas = (
            f"{100 * (found.min() - 1):+.1f} % to {100 * (found.max() - 1):+.1f} %"
            for found in (self.stretch, self.stretch.prod(axis=1))
        )
        return f"{size}, not developable: wrapping changes its lengths by {lengths}, areas (in colours) by {areas}"


def _meshed(domain: Domain, places: Floats) -> Mesh:
    """A fine mesh with nodes at places (n, 2); finer still where it would not follow the rims of holes."""
    size = float(np.sqrt(domain.area)) / _FINE
    for finer in (1.0, 1.5):
        try:
            return mesh_domain(domain, size / finer, places, closest=0.02)
        except GeometryError:
            continue
    return mesh_domain(domain, size / 2, places, closest=0.02)


def save_pattern(path: Path, pattern: Pattern, name: str) -> None:
    """Draw a pattern 1:1, as SVG or PDF, or as a picture.

    Raises:
        DataError: If it is too large to be drawn, or cannot be written.
    """
    low, high = 1e3 * pattern.mesh.nodes.min(axis=0), 1e3 * pattern.mesh.nodes.max(axis=0)
    left, right, bottom, top = low[0] - _MARGIN, high[0] + _MARGIN, low[1] - _MARGIN - _FOOT, high[1] + _MARGIN
    right = max(right, left + _NARROWEST)
    if max(right - left, top - bottom) > _LARGEST:
        raise DataError(f"a pattern of {right - left:.0f} x {top - bottom:.0f} mm is too large; make it in parts")
    figure = Figure(((right - left) / _PER_INCH, (top - bottom) / _PER_INCH), dpi=200)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(left, right), ylim=(bottom, top))
    axes.set_axis_off()
    nodes, halo = 1e3 * pattern.mesh.nodes, [withStroke(linewidth=2.5, foreground="white")]
    if not pattern.developable:
        about = Triangulation(nodes[:, 0], nodes[:, 1], pattern.mesh.elements)
        per_cent = 100 * (pattern.stretch.prod(axis=1) - 1)
        most = float(np.abs(per_cent).max())
        axes.tripcolor(about, per_cent, cmap=SIGNED, vmin=-1.6 * most, vmax=1.6 * most, shading="gouraud")
        lines = axes.tricontour(about, per_cent, 9, colors="0.45", linewidths=0.4)
        axes.clabel(lines, fmt=lambda value: f"{value:+.3g} %", fontsize=6)
    for walk in closed_walks(pattern.mesh.boundary):
        axes.plot(*nodes[walk].T, "k-", linewidth=0.7, solid_joinstyle="miter", gid="outline")
    for number, edge in enumerate(pattern.seam):
        axes.plot(*1e3 * edge.T, color="tab:blue", linewidth=1.6, linestyle=(0, (6, 3)), gid=f"seam-{number}")
        middle, step = 1e3 * edge[len(edge) // 2], edge[-1] - edge[0]
        upwards = float(np.degrees(np.arctan2(step[1], step[0])) + 90) % 180 - 90  # read from the foot or the right
        side = np.array([-step[1], step[0]]) / np.linalg.norm(step) * (4 if number == 0 else -4)
        style: dict[str, Any] = {"ha": "center", "va": "center", "rotation": upwards, "color": "tab:blue"}
        u, v = middle + side
        axes.text(u, v, "seam: join both dashed edges", fontsize=7, **style)
    for number, place in pattern.electrodes:
        round_ = np.linspace(0, 2 * np.pi, 73)
        circle = 1e3 * (place + pattern.radius * np.column_stack([np.cos(round_), np.sin(round_)]))
        axes.plot(*circle.T, color="crimson", linewidth=0.6, gid=f"electrode-{number}")
        axes.plot(*(1e3 * place[:, None]), "+", color="crimson", markersize=4, markeredgewidth=0.4)
        u, v = 1e3 * (place + 0.8 * pattern.radius)
        axes.text(u, v, str(number), color="crimson", fontsize=8, path_effects=halo)
    x, y = left + _MARGIN, bottom + 16
    axes.plot([x, x + _BAR], [y, y], "k-", linewidth=1, gid="scale-bar", solid_capstyle="butt")
    axes.text(x, y + 1.5, f"{_BAR:g} mm: measure it on the print, which must be at 100 %", fontsize=7)
    notes = str(pattern).replace(", ", "\n", 1).replace(": wrapping", ":\nwrapping")
    axes.text(x, y - 2, f"{name}, seen from outside, {notes}", fontsize=7, va="top")
    try:
        figure.savefig(path)
    except OSError as error:
        raise DataError(f"cannot write {path}: {error}; choose another place") from error
