"""Targets of a real tank: read others' data, check them, image them, and measure the errors.

python docs/guide/import_tank.py DATA [FOLDER]
"""

import csv
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import ohmskin as ohm
from ohmskin.plot import draw_image
from ohmskin.scan import assess


def main(data: Path, picture: Path) -> float:
    """Print a table of errors, save a picture, and return the mean error in millimetres."""
    skin = ohm.Skin.load("uef2017")
    model = skin.transfer_model()
    with (data / "targets.csv").open() as file:
        targets = list(csv.DictReader(file))
    figure = Figure(figsize=(11, 3.1), layout="constrained")
    panels = figure.subplots(1, 4)
    errors = []
    print("case  target      truth / mm        found / mm        error / mm")
    for axes, case in zip(panels, ("1_1", "1_2", "2_1", "3_1"), strict=True):
        recording = ohm.read_recording(data / f"datamat_{case}.mat")
        frame = recording.frames[0]
        known = ohm.SkinModel(skin, model, recording.quiet, assess(recording.quiet, recording.frames))
        seen = ohm.perceive(known, frame)
        draw_image(axes, model.mesh, seen.image.values, skin.electrodes, seen.detections)
        axes.set(ylabel="y / mm" if case == "1_1" else "")
        axes.set_title(f"case {case.replace('_', '.')}", fontsize=10)
        for target in (t for t in targets if t["case"] == case):
            place = np.array([float(target["x_mm"]), float(target["y_mm"])])
            sign = 1 if target["type"] == "conductive" else -1
            found = [1e3 * np.array(contact.position) for contact in seen.detections if contact.strength * sign > 0]
            nearest = min(found, key=lambda x, p=place: float(np.linalg.norm(x - p)))
            errors.append(float(np.linalg.norm(nearest - place)))
            axes.plot(*place, "x", color="limegreen", markersize=9, markeredgewidth=2)
            there, here = (f"{x:6.1f} {y:6.1f}" for x, y in (place, nearest))
            print(f"{case}   {target['type']:10}  {there}     {here}     {errors[-1]:6.1f}")
    print(f"mean error {np.mean(errors):.1f} mm, in a tank of 280 mm")
    figure.savefig(picture, dpi=110)
    return float(np.mean(errors))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else ".") / "import-tank.png")
