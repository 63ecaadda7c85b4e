"""Electrodes with an area, voltage drive, and thousands of presses a second.

python docs/guide/forward.py [FOLDER]
"""

import sys
import time
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.colors import CenteredNorm
from matplotlib.figure import Figure

from ohmskin.forward import FloatingPatches, TransferModel, drive_voltages
from ohmskin.geometry import Electrodes, Rectangle, mesh_domain
from ohmskin.plot.colours import AMOUNT, SIGNED
from ohmskin.scan import adjacent

sheet, conductivity = Rectangle(0.2, 0.2), 1.83e-3  # metres, siemens per square
points = Electrodes.grid(sheet)  # 12 on the rim, 4 inside
clamps = points.with_rim_segments(15e-3, 0.5, range(12)).with_discs(5e-3, 5e-3, [12, 14])  # 13 and 15 stay points
mpl.rcParams.update({"axes.titlesize": 10, "font.size": 9})
figure = Figure(figsize=(11.5, 3.7), layout="constrained")
left, middle, right = figure.subplots(1, 3)

# voltage drive: 5 V between electrodes 0 and 7, ground at 12, through 150 ohm each; all others carry no current
model = TransferModel(mesh_domain(sheet, 4e-3, clamps), clamps, conductivity)
volts = np.full((1, 16), np.nan)
volts[0, [0, 7, 12]] = 5.0, -5.0, 0.0
response = drive_voltages(model, volts, resistance=150.0)
currents, mesh = response.currents[0], model.mesh
potential = model.potentials @ currents + response.potentials[0, 0] - model.electrode_potentials[0] @ currents
shown = left.tricontourf(*1e3 * mesh.nodes.T, mesh.elements, potential, levels=24, cmap=SIGNED, norm=CenteredNorm())
left.plot(*1e3 * points.positions.T, "o", color="0.15", markersize=3, clip_on=False)
for k in (0, 7, 12):
    x, y = 1e3 * points.positions[k]
    left.annotate(
        f"{1e3 * currents[k]:+.2f} mA", (x, y), (6, 8 if y < 100 else -14), textcoords="offset points", fontsize=9
    )
left.set(title="potential, three electrodes at given volts", xlabel="x / mm", ylabel="y / mm", aspect="equal")
figure.colorbar(shown, ax=left, label="V", shrink=0.75)

# the resistance between two electrodes, driven and measured at the same two: on finer and finer meshes
sizes = np.array([16, 8, 4, 2, 1]) * 1e-3
for electrodes, name in (
    (points, "points"),
    (points.with_rim_segments(15e-3, 3.0, range(12)), "rim segments of 15 mm"),
):
    found = []
    for size in sizes:
        s = TransferModel(mesh_domain(sheet, size, electrodes), electrodes, conductivity).transfer_resistance
        found.append(s[1, 1] + s[7, 7] - 2 * s[1, 7])
    middle.semilogx(1e3 * sizes, found, "o-", label=name)
middle.set(title="resistance between electrodes 1 and 7", xlabel="edge length / mm", ylabel="ohm", ylim=(0, None))
middle.set_xticks(1e3 * sizes, [f"{1e3 * size:.0f}" for size in sizes])
middle.minorticks_off()
middle.legend(frameon=False)

# where a press is felt: 24 x 24 floating patches, pressed at 2,304 places
step = (np.arange(24) + 0.5) / 24 * 0.2
centres = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
inner = (np.stack(np.meshgrid(np.arange(4), np.arange(4)), axis=-1).reshape(-1, 2) - 1.5) * 1.9e-3
patches = FloatingPatches(model, (centres[:, None] + inner).reshape(-1, 2), np.repeat(np.arange(576), 16))
at = (np.arange(48) + 0.5) / 48 * 0.2
presses = [
    3.66e3 * 1.9e-3**2 * (np.hypot(*(patches.points - (x, y)).T) < 8e-3) for y in at for x in at
]  # siemens per point
patches.transfer_resistance(presses[0])  # the first call compiles
start = time.perf_counter()
pressed = [patches.transfer_resistance(press) for press in presses]
rate = len(presses) / (time.perf_counter() - start)
a, b, c, d = adjacent(points.rings).quadruples.T
change = np.array([s - model.transfer_resistance for s in pressed])
signal = np.linalg.norm(change[:, a, c] - change[:, a, d] - change[:, b, c] + change[:, b, d], axis=1)
shown = right.imshow(1e-3 * signal.reshape(48, 48), origin="lower", extent=(0, 200, 0, 200), cmap=AMOUNT)
right.set(title="signal of a press, adjacent drive at 1 mA", xlabel="x / mm", ylabel="y / mm")
figure.colorbar(shown, ax=right, label="V", shrink=0.75)
print(f"{rate:.0f} presses per second, on one factorisation")

picture = Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "forward.png"
figure.savefig(picture, dpi=100)
print(picture)
