"""Two fingers tracked with four injections a frame: true and estimated positions.

python docs/guide/tracking.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

import ohmskin as ohm
from ohmskin.sensing import drive_of

skin = ohm.Skin.load("paper")
device = ohm.VirtualSkin(skin, seed=0)
mode = ohm.modes(skin)["16T"]  # four injections a frame, contacts tracked on the data
(complete,) = drive_of(mode, skin).patterns  # all it may ever ask for
quiet = [device.scan(piece) for _ in range(20) for piece in complete.split(24)]
sensor = ohm.build(mode, ohm.SkinModel(skin, skin.transfer_model(), quiet))
state = sensor.start()

figure = Figure(figsize=(6.4, 6), layout="constrained")
axes = figure.subplots()
axes.plot(*(1e3 * skin.electrodes.positions.T), "s", color="0.6", label="electrodes")
for frame in range(150):
    angle = 0.02 * frame
    fingers = [(0.1 + 0.06 * np.cos(angle), 0.1 + 0.06 * np.sin(angle))]
    if frame >= 50:  # the second one lands while the first is tracked
        fingers.append((0.145 - 0.0002 * frame, 0.055))
    for number, at in enumerate(fingers, 1):
        device.press(number, *at, radius=8e-3, pressure=20e3)
        axes.plot(*(1e3 * np.array(at)), ".", color="0.2", markersize=3, zorder=3)
    state, percept = sensor.step(state, device.scan)
    for contact in percept.contacts:
        size, axis = np.linalg.eigh(np.array(contact.covariance))
        tilt = np.degrees(np.arctan2(axis[1, 1], axis[0, 1]))
        width, height = 2 * 2.45e3 * np.sqrt(size[::-1])  # 95 % of the probability
        place = (1e3 * contact.position[0], 1e3 * contact.position[1])
        axes.add_patch(
            Ellipse(place, width, height, angle=tilt, fill=False, color=f"C{contact.id % 10}", linewidth=0.8)
        )
axes.plot([], [], ".", color="0.2", markersize=3, label="where the fingers are")
axes.plot([], [], "o", color="0.4", fillstyle="none", label="95 % ellipses of the tracked contacts, a colour for each")
axes.set(xlim=(-5, 205), ylim=(-5, 205), xlabel="x / mm", ylabel="y / mm", aspect="equal")
figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize=8, columnspacing=1)
for contact in percept.contacts:
    x, y = contact.position
    print(f"contact {contact.id}: ({1e3 * x:.1f}, {1e3 * y:.1f}) mm, radius {1e3 * (contact.radius or 0):.0f} mm")
picture = Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "tracking.png"
figure.savefig(picture, dpi=100)
print(picture)
