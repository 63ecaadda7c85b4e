"""What all pictures have in common."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.image import AxesImage
from matplotlib.patches import Circle

from ohmskin.evaluate.methods import METHODS, all_methods
from ohmskin.evaluate.reproduction import Reproduction
from ohmskin.evaluate.shapes import Shape
from ohmskin.evaluate.statistics import median
from ohmskin.evaluate.worlds import LAYOUTS
from ohmskin.geometry.domain import Floats
from ohmskin.skin import Skin

WORLD_NAMES = {"discs": "discs of raised conductivity", "pressed": "contact-layer twin"}
COLOURS = {"12B": "#8c8c8c", "16B": "#e69f00", "16I": "#0072b2", "local": "#009e73", "16O": "#d55e00", "16O+": "#a6267a"}
MARKERS = {"12B": "v", "16B": "^", "16I": "s", "local": "D", "16O": "o", "16O+": "P"}
NAMES = {key: "local [14]" if key == "local" else key for key in METHODS}
SIDE = 200.0  # millimetres, of the paper's sheet
_MAP = "RdBu_r"  # as in ohmskin.plot: red conducts better, white is unchanged

RC: Any = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "grid.linewidth": 0.3,
    "grid.color": "0.85",
    "axes.axisbelow": True,
    "figure.facecolor": "white",
}


def noise_text(done: Reproduction) -> str:
    """The noise level and prior amplitude of the figures, for captions."""
    level, amplitude = done.settings.noise[0], done.settings.amplitude[0]
    return f"noise {level:g} dB below the largest 12B voltage, prior amplitude s = {amplitude:g}"


def electrodes(key: str) -> Floats:
    """Electrode positions (2, n_elec) of a method in millimetres."""
    return np.asarray(1e3 * Skin.load(LAYOUTS[all_methods()[key].layout]).electrodes.positions.T)


def draw_sheet(axes: Axes, key: str, left: bool = True, bottom: bool = True, size: float = 1.8, colour: str = "0.2") -> None:
    """Axes of a sheet in millimetres, with the electrodes of a method."""
    axes.plot(*electrodes(key), "o", color=colour, markersize=size, clip_on=False, zorder=3)
    axes.set(xlim=(0, SIDE), ylim=(0, SIDE), xticks=[0, 100, 200], yticks=[0, 100, 200], aspect="equal")
    axes.spines[["top", "right"]].set_visible(True)
    axes.tick_params(length=2, labelleft=left, labelbottom=bottom)
    if left:
        axes.set_ylabel("y / mm", labelpad=1)
    if bottom:
        axes.set_xlabel("x / mm", labelpad=1)


def draw_pixels(axes: Axes, pixels: Floats, limit: float) -> AxesImage:
    """An image (ny, nx) whose full colour is `limit`; returns what a colour bar can be made of."""
    norm = TwoSlopeNorm(0, -limit, limit)
    return axes.imshow(pixels, origin="lower", extent=(0, SIDE, 0, SIDE), cmap=_MAP, norm=norm, interpolation="bilinear")


def draw_outline(axes: Axes, contact: Shape) -> None:
    """The true edge of a contact."""
    if contact.kind == "disc":
        centre = (1e3 * contact.position[0], 1e3 * contact.position[1])
        axes.add_patch(Circle(centre, 1e3 * contact.radius, fill=False, color="black", linewidth=0.8, zorder=4))
        return
    fine = (np.arange(400) + 0.5) * SIDE / 400
    away = contact.distance(1e-3 * np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)).reshape(400, 400)
    axes.contour(fine, fine, away, levels=[0.0], colors="black", linewidths=0.8, zorder=4)


def draw_note(axes: Axes, text: str) -> None:
    """A number in the upper right corner."""
    box = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.0}
    axes.text(0.96, 0.95, text, transform=axes.transAxes, ha="right", va="top", fontsize=6.5, bbox=box, zorder=5)


def draw_band(axes: Axes, x: Floats, values: Floats, key: str, **more: Any) -> None:
    """Median over seeds (n_seeds, n) as a line, the middle half as a band."""
    low, middle, high = np.nanquantile(values, [0.25, 0.5, 0.75], axis=0)
    axes.fill_between(x, low, high, color=COLOURS[key], alpha=0.15, linewidth=0)
    axes.plot(x, middle, color=COLOURS[key], label=NAMES[key], linewidth=1.3, **more)


def draw_medians(axes: Axes, values: Floats, keys: Sequence[str], scale: float = 1.0) -> None:
    """Medians of values (n_methods, n_seeds) with 95 % intervals, one method per line."""
    for row, key in enumerate(keys):
        m = median(values[row])
        spread = [[scale * (m.value - m.low)], [scale * (m.high - m.value)]]
        axes.errorbar(
            scale * m.value, row, xerr=spread, fmt=MARKERS[key], color=COLOURS[key], markersize=4, capsize=2.5, linewidth=1
        )
    axes.set(yticks=range(len(keys)), yticklabels=[NAMES[k] for k in keys], ylim=(len(keys) - 0.5, -0.5))
    axes.grid(axis="x")
