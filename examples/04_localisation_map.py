"""
Map the localisation error
==========================

How well adjacent and adaptive drive localise touches over the sheet: medians over noise seeds.
Run it with ``python examples/04_localisation_map.py [FOLDER]``.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ohmskin import evaluate
from ohmskin.plot.colours import AMOUNT


def main(folder: Path) -> Path:
    keys, side = ("16I", "16O fused"), 7
    result = evaluate.Localisation("pressed", decibels=30, amplitude=0.1, seeds=8, side=side, methods=keys).run()
    error = 1e3 * evaluate.errors(result)  # (n_methods, n_seeds, n_places)
    median = np.median(error, axis=1)

    half = 100 / (side + 1)  # each place stands for the square about it (mm)
    reach = (half, 200 - half, half, 200 - half)
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    for axes, key, values in zip(figure.subplots(1, 2), keys, median, strict=True):
        shown = axes.imshow(
            values.reshape(side, side), origin="lower", extent=reach, vmin=0, vmax=median.max(), cmap=AMOUNT
        )
        axes.plot(*(1e3 * result["truth"].T), ".", color="0.3", markersize=3)
        axes.set(xlabel="x / mm", ylabel="y / mm", title=f"{key}: median over the sheet {np.median(values):.1f} mm")
    figure.colorbar(shown, ax=figure.axes, label="median localisation error / mm")
    for key, values in zip(keys, error, strict=True):
        last = np.quantile(values, 0.95)
        print(f"{key:9s} mean {values.mean():.1f} mm, median {np.median(values):.1f} mm, 95 % below {last:.1f} mm")
    path = folder / "04_localisation.png"
    figure.savefig(path, dpi=150)
    return path


if __name__ == "__main__":
    print(main(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())))
