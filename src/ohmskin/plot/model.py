"""Meshes and fields of forward models: sheets, surfaces in space, the boundary of bodies, the lines current takes."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import CenteredNorm
from matplotlib.patheffects import withStroke
from matplotlib.tri import LinearTriInterpolator, Triangulation
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import DataError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Electrodes, Mesh
from ohmskin.geometry.raster import node_means
from ohmskin.plot.colours import AMOUNT, SIGNED

_DENSITY = 1.2  # of lines of current, as Matplotlib counts
_GRID = 120  # points along the longer side of the grid on which lines of current are followed


def draw_mesh(
    axes: Axes, mesh: Mesh, values: ArrayLike | None = None, electrodes: Electrodes | None = None, edges: bool = True
) -> ScalarMappable:
    """Draw a mesh, coloured by values by element (n_elem,) or by node (n_nodes,) if there are any; in millimetres.

    Values of both signs are coloured from zero, as on the live page.

    Args:
        axes: Where to draw; ``projection="3d"`` for meshes in space, of which a body shows its boundary.
        mesh: Triangles or tetrahedra.
        values: In any unit.
        electrodes: Drawn as dots with their numbers; those of facets by their edges.
        edges: Whether to draw the edges of elements.

    Returns:
        What a colour bar can be made of.

    Raises:
        DataError: If values fit neither elements nor nodes, or the axes are flat and the mesh is not.
    """
    in_space = mesh.nodes.shape[1] == 3
    if in_space != isinstance(axes, Axes3D):
        needed = 'subplot(projection="3d")' if in_space else "subplot()"
        raise DataError(f"a mesh in {mesh.nodes.shape[1]} dimensions needs other axes; make them with {needed}")
    shown, colours = _faces(mesh, None if values is None else np.asarray(values, float))
    style: dict[str, Any] = {
        "linewidths": 0.3 if edges else 0.0,
        "edgecolors": "0.35" if edges else "none" if in_space else "face",
    }
    corners = 1e3 * mesh.nodes[shown]
    if mesh.period:  # what lies across the seam is seen at both sides
        shifts = 1e3 * np.array([[-mesh.period, 0], [0, 0], [mesh.period, 0]])
        corners = (1e3 * mesh.corners + shifts[:, None, None]).reshape(-1, 3, 2)
        colours = None if colours is None else np.tile(colours, 3)
    signed = colours is not None and np.nanmin(colours) < 0 < np.nanmax(colours)
    style |= {"cmap": SIGNED, "norm": CenteredNorm()} if signed else {"cmap": AMOUNT}
    made: PolyCollection = (Poly3DCollection if in_space else PolyCollection)(corners, **style)
    if colours is None:
        made.set_facecolor("white" if edges else "0.9")
    else:
        made.set_array(colours)
    axes.add_collection(made)
    low, high = 1e3 * mesh.nodes.min(axis=0), 1e3 * mesh.nodes.max(axis=0)
    high[0] = 1e3 * mesh.period or high[0]
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x / mm", ylabel="y / mm")
    if isinstance(axes, Axes3D):
        axes.set(zlim=(low[2], high[2]), zlabel="z / mm")
        axes.set_box_aspect(np.maximum(high - low, 1e-3 * (high - low).max()))
    else:
        axes.set_aspect("equal")
    if electrodes is not None:
        _draw_electrodes(axes, mesh, electrodes)
    return made


def draw_current(axes: Axes, model: TransferModel, source: int, sink: int, current: float = 1e-3) -> ScalarMappable:
    """Draw the potential on a flat sheet and the lines along which current flows.

    Args:
        axes: Where to draw.
        model: The sheet.
        source, sink: The electrodes between which it flows.
        current: Current (A).

    Returns:
        What a colour bar of the potential (V) can be made of.

    Raises:
        DataError: If the model is not flat, or closed.
    """
    mesh = model.mesh
    if mesh.nodes.shape[1] != 2 or mesh.period:
        raise DataError("lines of current are drawn on flat sheets; draw_mesh draws potentials in space")
    density = model.current_density(source, sink, current)
    potential = current * (model.potentials[:, source] - model.potentials[:, sink])
    shown = draw_mesh(axes, mesh, potential, model.electrodes, edges=False)
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    step = float((high - low).max()) / _GRID
    x, y = (np.arange(low[k] + step / 2, high[k], step) for k in range(2))
    flat = Triangulation(mesh.nodes[:, 0], mesh.nodes[:, 1], mesh.elements)
    u, v = (LinearTriInterpolator(flat, node_means(mesh) @ part)(*np.meshgrid(x, y)) for part in density.T)
    axes.streamplot(1e3 * x, 1e3 * y, u, v, color="white", linewidth=0.7, arrowsize=0.7, density=_DENSITY)
    return shown


def _faces(mesh: Mesh, values: Floats | None) -> tuple[np.ndarray, Floats | None]:
    """The triangles to draw (n, 3), by nodes, and their values (n,)."""
    if mesh.dim == 2:
        shown, owner = mesh.elements, np.arange(mesh.n_elem)
    else:
        owner = np.nonzero(mesh.neighbours < 0)[0]
        shown = mesh.boundary
    if values is None:
        return shown, None
    if values.shape == (mesh.n_elem,):
        return shown, values[owner]
    if values.shape == (mesh.n_nodes,):
        return shown, values[shown].mean(axis=1)
    raise DataError(f"values have shape {values.shape}; give ({mesh.n_elem},) by element or ({mesh.n_nodes},) by node")


def _draw_electrodes(axes: Axes, mesh: Mesh, electrodes: Electrodes) -> None:
    style: dict[str, Any] = {"color": "crimson", "clip_on": False}
    for facets in electrodes.facets:
        for corners in 1e3 * mesh.nodes[facets]:
            axes.plot(*np.vstack([corners, corners[:1]]).T, linewidth=2.0, **style)
    for number, place in enumerate(1e3 * electrodes.positions):
        axes.plot(*place[:, None], "o", markersize=4, **style)
        where: Any = (*place, f" {number}")
        axes.text(*where, fontsize=8, color="crimson", path_effects=[withStroke(linewidth=2, foreground="white")])
