"""Two presses on the virtual skin, seen by every estimator.

python docs/guide/estimators.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import ohmskin as ohm
from ohmskin.inverse import AbsoluteGaussNewton, GaussNewton, Greit, Kalman, SparseBayes, TotalVariation
from ohmskin.plot import draw_image

PRESSES = [(0.06, 0.13), (0.14, 0.08)]  # metres

skin = ohm.Skin.load("paper")
device = ohm.VirtualSkin(skin, seed=0)
pattern = ohm.adjacent(skin.electrodes.rings)
quiet = [device.scan(pattern) for _ in range(20)]
baseline = ohm.Baseline.learn(quiet)
for number, (x, y) in enumerate(PRESSES):
    device.press(number, x, y, radius=0.012, pressure=20e3)
frames = [device.scan(pattern) for _ in range(5)]
frame, touched = frames[0], baseline.difference(frames[0])

model, noise = skin.transfer_model(), baseline.noise
about = {"amplitude": 0.1, "model_error": 0.02}  # what is expected of a touch, and of the model
images = {
    "Gauss-Newton": GaussNewton(model, noise, "matern", **about).reconstruct(touched),
    "Gauss-Newton, positive": GaussNewton(model, noise, "matern", positive=True, **about).reconstruct(touched),
    "iterated Gauss-Newton": AbsoluteGaussNewton(model, noise, "matern", baseline=baseline, **about).reconstruct(frame),
    "GREIT": Greit(model, noise, noise_figure=2.0).reconstruct(touched),
    "total variation, positive": TotalVariation(
        model, noise, amplitude=0.5, outline=0.01, model_error=0.02, positive=True
    ).reconstruct(touched),
    "sparse Bayes": SparseBayes(model, noise, amplitude=0.5, model_error=0.02).reconstruct(touched),
}

kalman = Kalman(model, noise, "matern", time_constant=1.0, period=0.05, **about)
belief = kalman.start()
for later in frames:
    belief = kalman.update(belief, baseline.difference(later))
images["Kalman, five scans"] = belief.image

fitter = ohm.ContactFitter(ohm.ContactTable(model, radius=0.01), noise, model_error=0.02)
contacts = fitter.contacts(fitter.fit(touched))  # no image: the contacts themselves
for contact in contacts:
    x, y = 1e3 * contact.position[0], 1e3 * contact.position[1]
    sx, sy = 1e3 * np.sqrt(np.diag(contact.covariance))
    print(f"contact at {x:.1f} +- {sx:.1f}, {y:.1f} +- {sy:.1f} mm, {1e6 * contact.strength:.0f} mm2 of conductivity")

figure = Figure(figsize=(14.5, 7.2), layout="constrained")
fitted = "contacts fitted"
images[fitted] = images["Gauss-Newton"]
for axes, (name, image) in zip(figure.subplots(2, 4).flat, images.items(), strict=True):
    draw_image(axes, model.mesh, image.values, model.electrodes, contacts if name == fitted else ())
    for x, y in PRESSES:
        axes.plot(1e3 * x, 1e3 * y, "+", color="black", markersize=12)
    axes.set_title(f"{name}: peak {image.values.max():.2f}", fontsize=10)
picture = Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "estimators.png"
figure.savefig(picture, dpi=100)
print(picture)
