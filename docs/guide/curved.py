"""A sleeve feels two fingers, on its map and on the arm.

python docs/guide/curved.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import ohmskin as ohm
from ohmskin.client.contacts import Patch
from ohmskin.contacts import in_frame
from ohmskin.plot import draw_mesh

skin = ohm.Skin.load("sleeve")
chart = skin.chart  # the map: a closed band, x round the arm, y along it
with ohm.Engine(lambda: ohm.connect("virtual:", skin=skin, seed=1), skin) as engine:
    engine.calibrate()
    for number, point in enumerate([(0.045, 0.0, 0.05), (0.0, -0.045, 0.1)]):  # on the arm, in its frame (m)
        (place,), _ = chart.project(point)
        engine.press(number, at=tuple(place.tolist()), radius=8e-3, pressure=20e3)
    touches = [engine.step() for _ in range(12)]
touch = touches[-1]
assert touch is not None

felt = in_frame(touch.contacts, chart, Patch(frame="forearm"))
for contact in felt:
    print("felt at", *np.round(contact.position, 3), "m, normal", *np.round(contact.normal, 2))

mesh, image = skin.mesh(), touch.percept.image
figure = Figure(figsize=(10, 4.2), layout="constrained")
axes = figure.add_subplot(1, 2, 1)
draw_mesh(axes, mesh, image.values, skin.electrodes, edges=False)
for contact in touch.contacts:
    axes.plot(*1e3 * np.array(contact.position), "k+", markersize=14)
axes.set_title("on the map, whose left and right sides are one", pad=12)
axes = figure.add_subplot(1, 2, 2, projection="3d")
shown = draw_mesh(axes, mesh.mapped(chart.points), image.values, edges=False)
for contact in felt:
    arrow = np.array(contact.position) + np.outer([0.03, 0.002], contact.normal)
    axes.plot(*1e3 * arrow.T, "k", linewidth=2)
axes.set(title="on the arm, with normals", xticks=[-40, 0, 40], yticks=[-40, 0, 40])
axes.tick_params(labelsize=8, pad=0)
axes.view_init(25, -35)
axes.set_box_aspect((90, 90, 142), zoom=0.8)  # mm, with room for the labels
figure.colorbar(shown, ax=figure.axes, label="relative change of conductivity", shrink=0.8)

target = Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "curved.png"
figure.savefig(target, dpi=110)
print(f"wrote {target}")
