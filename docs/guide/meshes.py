"""One forward model on a polygon with a hole, on a robot's link, and in a thick soft skin.

python docs/guide/meshes.py [FOLDER]
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.colors import CenteredNorm, LogNorm
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ohmskin.forward import TransferModel
from ohmskin.geometry import Electrodes, Polygon, Rectangle, mesh_domain, mesh_graded, thicken
from ohmskin.plot.colours import AMOUNT, SIGNED

mpl.rcParams.update({"axes.titlesize": 10, "font.size": 9})
figure = Figure(figsize=(11.5, 3.7), layout="constrained")

# a palm with a hole for a screw: 12 clamps on the rim, meshed finer where they are (gmsh)
turn = 2 * np.pi * np.arange(32) / 32
hole = np.column_stack([0.05 + 0.015 * np.cos(turn), 0.06 + 0.015 * np.sin(turn)])
palm = Polygon([[0, 0], [0.13, 0], [0.13, 0.06], [0.09, 0.06], [0.09, 0.13], [0, 0.13]], holes=[hole])
clamps = Electrodes.rim(palm, 12, start=0.02).with_rim_segments(8e-3, 1.0)
model = TransferModel(mesh_graded(palm, 8e-3, clamps), clamps, 1.83e-3)
axes = figure.add_subplot(1, 3, 1)
density = np.linalg.norm(model.current_density(4, 10), axis=1)
shown = axes.tripcolor(*1e3 * model.mesh.nodes.T, model.mesh.elements, density, norm=LogNorm(1, 100), cmap=AMOUNT)
axes.triplot(*1e3 * model.mesh.nodes.T, model.mesh.elements, color="0.3", linewidth=0.15)
axes.set(
    title=f"polygon with a hole, {model.mesh.n_elem:,} triangles", xlabel="x / mm", ylabel="y / mm", aspect="equal"
)
figure.colorbar(shown, ax=axes, label="current density per ampere / 1/m", shrink=0.7)

# the same sheet as in the plane, laid round three quarters of a link of 45 mm radius
radius, sheet = 0.045, Rectangle(0.21, 0.15)


def laid(points: np.ndarray) -> np.ndarray:
    return np.column_stack(
        [radius * np.sin(points[:, 0] / radius), -radius * np.cos(points[:, 0] / radius), points[:, 1]]
    )


grid = Electrodes.grid(sheet).with_discs(4e-3, 1e-3)
flat = mesh_domain(sheet, 5e-3, grid)
link = TransferModel(flat.mapped(laid), grid.mapped(laid), 1.83e-3)
axes = figure.add_subplot(1, 3, 2, projection="3d")
density = np.linalg.norm(link.current_density(1, 7), axis=1)
faces = Poly3DCollection(
    1e3 * link.mesh.nodes[link.mesh.elements], array=density, norm=LogNorm(1, 100), cmap=AMOUNT, linewidth=0
)
axes.add_collection3d(faces)
axes.set(
    xlim=(-50, 50),
    ylim=(-50, 50),
    zlim=(0, 150),
    title=f"a link, {link.mesh.n_elem:,} triangles",
    box_aspect=(1, 1, 1.5),
)
axes.set(xticks=[], yticks=[], zticks=[0, 50, 100, 150])
axes.view_init(20, -60)
bent, straight = link.transfer_resistance, TransferModel(flat, grid, 1.83e-3).transfer_resistance
print(f"bent or flat, the same within {np.abs(bent - straight).max() / straight.max():.1e}")

# a thick soft skin: tetrahedra, layers that thicken downwards; electrodes on its upper face
body = thicken(mesh_domain(sheet, 5e-3, grid), 0.03, layers=[0.08, 0.12, 0.2, 0.25, 0.35])
top = grid.mapped(lambda points: np.column_stack([points, np.zeros(len(points))]))
inner = top.with_points(range(12))  # discs at edges of a body would be ambiguous
thick = TransferModel(body, inner, 0.061)  # siemens per metre
axes = figure.add_subplot(1, 3, 3)
x, z = np.meshgrid(np.linspace(0, 0.21, 300), np.linspace(-0.03, 0, 60))
rows, inside = body.interpolation(np.column_stack([x.ravel(), np.full(x.size, 0.05), z.ravel()]))
cut = np.full(x.size, np.nan)
cut[inside] = rows @ (thick.potentials[:, 12] - thick.potentials[:, 13])
shown = axes.contourf(1e3 * x, 1e3 * z, cut.reshape(x.shape), levels=24, cmap=SIGNED, norm=CenteredNorm())
axes.set(title=f"cut through a thick skin, {body.n_elem:,} tetrahedra", xlabel="x / mm", ylabel="z / mm")
figure.colorbar(shown, ax=axes, label="potential of 1 A / V")

picture = Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "meshes.png"
figure.savefig(picture, dpi=100)
print(picture)
