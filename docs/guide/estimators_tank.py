"""Real measurements: targets in the saline tank of the University of Eastern Finland (Hauptmann et al. 2017), in three
images each.

    python docs/guide/estimators_tank.py [FOLDER] [DATA]

DATA is the folder of datamat_1_0.mat and so on (arXiv:1704.01178); ../shared/data/uef2017 beside the repository unless
given.
"""

import csv
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

import ohmskin as ohm
from ohmskin.inverse import AbsoluteGaussNewton, GaussNewton
from ohmskin.plot import draw_image

data = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(__file__).resolve().parents[3] / "shared" / "data" / "uef2017"
with (data / "targets.csv").open() as file:
    targets = list(csv.DictReader(file))
skin = ohm.Skin.load("uef2017")
model = skin.transfer_model()

cases = ("1_1", "2_1", "3_1")
figure = Figure(figsize=(11, 11), layout="constrained")
grid = figure.subplots(3, len(cases))
for column, case in enumerate(cases):
    recording = ohm.read_recording(data / f"datamat_{case}.mat")
    baseline, frame = ohm.Baseline.learn(recording.quiet), recording.frames[0]
    change = baseline.difference(frame)
    noise = 0.02 * float(np.sqrt(np.nanmean(change.volts**2)))  # one frame has no noise estimate; targets are far above
    iterated = AbsoluteGaussNewton(model, noise, "matern", baseline=baseline)
    variation = AbsoluteGaussNewton(model, noise, outline=0.02, baseline=baseline, rounds=25)
    images = {
        "one step": GaussNewton(model, noise, "matern", amplitude=0.5).reconstruct(change),
        "iterated": iterated.reconstruct(frame),
        "iterated, total variation": variation.reconstruct(frame),
    }
    for axes, (name, image) in zip(grid[:, column], images.items(), strict=True):
        draw_image(axes, model.mesh, image.values, model.electrodes)
        axes.set_title(f"{name}: lowest {image.values.min():.2f}", fontsize=10)
        for target in targets:
            if target["case"] == case:  # outlines from photographs, good to a few millimetres
                place, radius = (
                    (float(target["x_mm"]), float(target["y_mm"])),
                    np.sqrt(float(target["area_mm2"]) / np.pi),
                )
                axes.add_patch(Circle(place, radius, fill=False, color="green", linewidth=1.5))
picture = Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "estimators_tank.png"
figure.savefig(picture, dpi=80)
print(picture)
