"""One press on the virtual skin, imaged under every prior.

python docs/guide/priors.py [FOLDER]
"""

import sys
from pathlib import Path

from matplotlib.figure import Figure

import ohmskin as ohm
from ohmskin.inverse import PRIORS, GaussNewton
from ohmskin.plot import draw_image

skin = ohm.Skin.load("paper")
device = ohm.VirtualSkin(skin, seed=0)
pattern = ohm.adjacent(skin.electrodes.rings)  # 12 electrodes on the rim, 4 inside: 16 injections
baseline = ohm.Baseline.learn([device.scan(pattern) for _ in range(20)])
device.press(1, x=0.06, y=0.13, radius=0.012, pressure=20e3)
touched = baseline.difference(device.scan(pattern))

model = skin.transfer_model()
images = {}
for name in PRIORS:
    estimator = GaussNewton(model, baseline.noise, prior=name, amplitude=0.1, model_error=0.02)
    images[name] = estimator.reconstruct(touched)
positive = GaussNewton(model, baseline.noise, prior="matern", amplitude=0.1, model_error=0.02, positive=True)
images["matern, positive"] = positive.reconstruct(touched)

figure = Figure(figsize=(11, 7.2), layout="constrained")
for axes, (name, image) in zip(figure.subplots(2, 3).flat, images.items(), strict=True):
    draw_image(axes, model.mesh, image.values, model.electrodes)
    axes.plot(60, 130, "+", color="black", markersize=12)  # where it is pressed
    axes.set_title(f"{name}: peak {image.values.max():.2f}", fontsize=10)
picture = Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "priors.png"
figure.savefig(picture, dpi=100)
print(picture)
