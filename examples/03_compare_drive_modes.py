"""
Compare drive methods
=====================

All drive methods of the paper on one touch under the same noise: images and figures of merit.
Run it with ``python examples/03_compare_drive_modes.py [FOLDER]``.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ohmskin import evaluate
from ohmskin.plot import draw_image
from ohmskin.skin import Skin


def main(folder: Path) -> Path:
    touch = evaluate.contact("discs", 0.05, 0.15)  # the paper's simulation: 10 mm, +50 %
    bench = evaluate.bench("discs", decibels=45, amplitude=0.1)
    target = evaluate.Target(touch.position, touch.strength * touch.area)
    views = {key: bench.simulate(key, (touch,), seed=0) for key in evaluate.METHODS}
    limit = max(float(view.image.values.max()) for view in views.values())

    figure = Figure(figsize=(12, 7), layout="constrained")
    for axes, (key, view) in zip(figure.subplots(2, 3).flat, views.items(), strict=True):
        method = evaluate.all_methods()[key]
        electrodes = Skin.load("paper-rim16" if method.layout == "rim" else "paper").electrodes
        shown = draw_image(axes, view.mesh, view.image.values, electrodes, limit=limit)
        merit = evaluate.figures_of_merit(view.pixels, view.raster.x, view.raster.y, [target])[0]
        off = 1e3 * np.linalg.norm(view.place - touch.position)
        line = f"SD {merit.shape_deformation:.2f}, RNG {merit.ringing:.2f}, seen {off:.1f} mm off"
        axes.set_title(f"{method.label}\n{line}", fontsize=9)
        print(f"{key:9s} {line}")
    figure.colorbar(shown, ax=figure.axes[:6], label="relative change of conductivity", shrink=0.6)
    path = folder / "03_drive_modes.png"
    figure.savefig(path, dpi=150)
    return path


if __name__ == "__main__":
    print(main(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())))
