"""Two electrodes are disconnected: the data show which, and the image is made without them.

python docs/guide/data_quality.py [FOLDER]
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import ohmskin as ohm
from ohmskin.plot import draw_image
from ohmskin.scan import Frame, assess


def main(picture: Path) -> list[str]:
    """Print the report, save a picture, and return the report's lines."""
    skin = ohm.Skin.load("paper")
    virtual = ohm.VirtualSkin(skin, seed=1)
    pattern = ohm.adjacent(skin.electrodes.rings)
    quiet = [virtual.scan(pattern) for _ in range(10)]
    virtual.press(1, 0.06, 0.13, radius=8e-3, pressure=20e3)
    touched = virtual.scan(pattern)

    random = np.random.default_rng(2)
    off = np.isin(pattern.quadruples, [4, 13]).any(axis=1)  # every measurement that electrodes 4 and 13 take part in

    def disconnected(frame: Frame) -> Frame:
        return replace(frame, voltages=np.where(off, random.normal(0, 0.05, len(off)), frame.voltages))

    quiet, touched = [disconnected(frame) for frame in quiet], disconnected(touched)
    quality = assess(quiet, [touched])
    print("\n".join(quality.report()))

    figure = Figure(figsize=(8.6, 3.7), layout="constrained")
    model = skin.transfer_model()
    for axes, judge, title in zip(figure.subplots(1, 2), (None, quality), ("as measured", "assessed"), strict=True):
        seen = ohm.perceive(ohm.SkinModel(skin, model, quiet, judge), touched)
        shown = draw_image(axes, model.mesh, seen.image.values, skin.electrodes, seen.detections)
        axes.plot(60, 130, "x", color="limegreen", markersize=10, markeredgewidth=2)
        axes.set_title(title, fontsize=10)
        figure.colorbar(shown, ax=axes, shrink=0.8, label="relative conductivity change")
    figure.savefig(picture, dpi=110)
    return quality.report()


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "data-quality.png")
