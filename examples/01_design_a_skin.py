"""
Design a skin
=============

Map where a skin is sensitive: the summed sensitivity of one scan, for electrodes on the rim and inside.
Run it with ``python examples/01_design_a_skin.py [FOLDER]``.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import ohmskin as ohm
from ohmskin.plot.colours import AMOUNT
from ohmskin.sensing import drive_of


def modelled(skin: ohm.Skin, pattern: ohm.DrivePattern) -> tuple[ohm.TransferModel, np.ndarray]:
    """What a touch of 1 cm2 that raises conductivity by 10 % changes, root mean square over the scan (V at 1 mA)."""
    model = skin.transfer_model()
    change = 1e-3 * model.sensitivity(pattern) * 0.1 * model.conductivity * 1e-4 / model.mesh.measures
    return model, np.sqrt(np.mean(change**2, axis=0))


def main(folder: Path) -> Path:
    grid = ohm.Skin.load("paper")
    sheet = replace(grid.sheet, width=0.3)  # half as wide again
    wide = replace(grid, name="wide", sheet=sheet, electrode=replace(grid.electrode, columns=5, inset=0.01))
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    scans = [(grid, "12B"), (grid, "16I"), (wide, "20I")]
    parts = [(skin, name, *modelled(skin, drive_of(ohm.modes(skin)[name], skin).next([], 0))) for skin, name in scans]
    for axes, (skin, name, model, volts) in zip(figure.subplots(1, 3), parts, strict=True):
        raster = ohm.Raster(model.mesh, 200)
        extent = (0, 1e3 * skin.sheet.width, 0, 1e3 * skin.sheet.height)
        decibels = 20 * np.log10(raster(volts) / 1e-6)
        shown = axes.imshow(decibels, origin="lower", extent=extent, vmin=10, vmax=60, cmap=AMOUNT)
        axes.plot(*(1e3 * skin.electrodes.positions.T), "o", color="white", markeredgecolor="black", clip_on=False)
        axes.set(xlabel="x / mm", ylabel="y / mm", title=f"{skin.name}, {name}: median {np.median(volts) * 1e6:.1f} µV")
    figure.colorbar(shown, ax=figure.axes, label="change of voltage / dB above 1 µV", extend="both", shrink=0.8)
    path = folder / "01_sensitivity.png"
    figure.savefig(path, dpi=150)
    return path


if __name__ == "__main__":
    print(main(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())))
