"""Where a frame's injections should go: bounds of the drives, a tracker's choices, and a better layout.

python docs/guide/drive_design.py [FOLDER]
"""

import sys
import time
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from ohmskin.drive import (
    DRIVES,
    Candidates,
    DriveSettings,
    Target,
    TrackingDrive,
    complete_pattern,
    position_bound,
)
from ohmskin.drive.bound import spread_places
from ohmskin.forward import ContactTable
from ohmskin.plot import ErrorMap, draw_error_map
from ohmskin.scan import adjacent
from ohmskin.skin import Skin

skin = Skin.load("paper")
model, electrodes = skin.transfer_model(), skin.electrodes
table = ContactTable(model, radius=10e-3)
largest = np.abs(model.voltages(adjacent([electrodes.rings[0]]), 1e-3)).max()  # of 12B at 1 mA
noise = float(largest * 10 ** (-50 / 20))  # 50 dB below it
complete = complete_pattern(electrodes)
candidates = Candidates.at_currents(complete, 16, noise, 1e-3)
settings = DriveSettings(electrodes, lambda: (table, candidates))
schemes = {  # injections of all scans of a frame; 0: as many as the drive usually has
    "12B, 12 injections": DRIVES["rim"](settings, 0),
    "16I, 16": DRIVES["rings"](settings, 0),
    "opposite, 6": DRIVES["opposite"](settings, 0),
    "best fixed, 16": DRIVES["best"](settings, 16),
    "16P, 6 + 10": DRIVES["position"](settings, 16),
    "16O, 12 + 16": DRIVES["eq7"](settings, 0),
    "best fixed, 28": DRIVES["best"](settings, 28),
    "16P, 6 + 22": DRIVES["position"](settings, 28),
}
places = spread_places(table, 500)
errors = {name: position_bound(table, places, scheme, noise) for name, scheme in schemes.items()}
print("bound on the position error / mm  mean  median  rms   worst")
for name, found in errors.items():
    mm = 1e3 * found
    print(f"{name:<30}{mm.mean():7.2f}{np.median(mm):7.2f}{np.sqrt(np.mean(mm**2)):7.2f}{mm.max():7.2f}")

# the drive of a tracker: four injections a frame, two of them exploring
drive = TrackingDrive(electrodes, lambda: (table, candidates), injections=4)
contact = Target(np.array([0.06, 0.13]), np.diag([4e-3, 4e-3]) ** 2, effect=1.5e-4, radius=10e-3)
print("next:", *(f"{a}-{b}" for a, b in drive.next([contact], turn=0).injections))
start = time.perf_counter()
for turn in range(1000):
    drive.next([contact], turn)
print(f"choosing the next pattern takes {1e3 * (time.perf_counter() - start):.0f} us")

mpl.rcParams.update({"axes.titlesize": 10, "font.size": 9})
figure = Figure(figsize=(14.5, 4.4), layout="constrained")
axes = figure.subplots(1, 3)
limits = (min(float(errors[name].min()) for name in list(schemes)[5:]), float(errors["16O, 12 + 16"].max()))
for place, name in zip(axes, ("16O, 12 + 16", "16P, 6 + 22"), strict=False):
    shown = draw_error_map(place, ErrorMap(name, skin.domain, electrodes, places, errors[name]), limits)
bar = figure.colorbar(
    shown, ax=axes[:2].tolist(), label="bound on the position error / mm", ticks=[0.2, 0.5, 1, 2, 5], shrink=0.85
)
bar.ax.set_yticklabels(["0.2", "0.5", "1", "2", "5"])
x, y = 1e3 * electrodes.positions.T
axes[2].plot(x, y, "o", color="0.15", clip_on=False)
frames = [drive.next([contact], turn).injections for turn in range(4)]
for a, b in np.vstack([frame[1:] for frame in frames]):
    chosen = axes[2].plot(x[[a, b]], y[[a, b]], color="tab:blue", alpha=0.5)
for a, b in np.vstack([frame[:1] for frame in frames]):
    explored = axes[2].plot(x[[a, b]], y[[a, b]], color="tab:orange", linestyle=":")
axes[2].plot(*1e3 * contact.position, "x", color="black", markersize=9, markeredgewidth=2)
axes[2].set(title="four frames about a contact (cross)", xlabel="x / mm", ylabel="y / mm", aspect="equal")
axes[2].legend(
    [*chosen, *explored], ["for its position", "exploring"], loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2
)
picture = Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "drive_design.png"
figure.savefig(picture, dpi=100)
print(picture)
