"""One press on the virtual skin: what six rules choose for the prior amplitude, and why.

python docs/guide/regularisation.py [FOLDER]
"""

import sys
from pathlib import Path

from matplotlib.figure import Figure

import ohmskin as ohm
from ohmskin.inverse import RULES, GaussNewton, choose
from ohmskin.plot import draw_image

skin = ohm.Skin.load("paper")
device = ohm.VirtualSkin(skin, seed=0)
pattern = ohm.adjacent(skin.electrodes.rings)
baseline = ohm.Baseline.learn([device.scan(pattern) for _ in range(20)])
device.press(1, x=0.06, y=0.13, radius=0.012, pressure=20e3)
touched = baseline.difference(device.scan(pattern))

model = skin.transfer_model()
estimator = GaussNewton(model, baseline.noise, "matern", amplitude=0.1, model_error=0.02)
figure = Figure(figsize=(15, 7.2), layout="constrained")
curves, pictures = figure.subplots(2, len(RULES), height_ratios=[1.4, 1])
for rule, curve, shown in zip(RULES, curves, pictures, strict=True):
    choice = choose(rule, estimator, touched)
    if rule == "l-curve":
        curve.loglog(choice.residuals, choice.norms)
        at = int(abs(choice.amplitudes - choice.amplitude).argmin())
        curve.plot(choice.residuals[at], choice.norms[at], "o", color="black")
        curve.set(xlabel="residual / V", ylabel="norm of the image")
    else:
        values = choice.curve - choice.curve.min() + 1 if rule == "evidence" else choice.curve
        curve.loglog(choice.amplitudes, values)
        curve.axvline(choice.amplitude, color="black", linewidth=1)
        curve.set(xlabel="prior amplitude")
        curve.set_ylabel(choice.meaning.partition(";")[0], fontsize=8)
    curve.set_title(f"{rule}: {choice.amplitude:.3g}", fontsize=10)
    image = estimator.with_amplitude(choice.amplitude).reconstruct(touched)
    draw_image(shown, model.mesh, image.values, model.electrodes)
    shown.plot(60, 130, "+", color="black", markersize=12)
    print(f"{rule}: {choice.amplitude:.3g} ({choice.meaning})")
picture = Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "regularisation.png"
figure.savefig(picture, dpi=100)
print(picture)
