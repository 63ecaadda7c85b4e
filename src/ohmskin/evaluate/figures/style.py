"""What the pictures of the reproduction have in common."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.image import AxesImage
from matplotlib.patches import Circle

from ohmskin.arrays import Floats
from ohmskin.evaluate.figures.drawing import SIDE
from ohmskin.evaluate.methods import METHODS
from ohmskin.evaluate.plan import Settings
from ohmskin.evaluate.shapes import Shape
from ohmskin.evaluate.statistics import median

COLOURS = dict(zip(METHODS, ("#8c8c8c", "#e69f00", "#0072b2", "#009e73", "#d55e00", "#a6267a"), strict=True))
MARKERS = dict(zip(METHODS, "v^sDoP", strict=True))
NAMES = {key: "local [14]" if key == "local" else key for key in METHODS}
_MAP = "RdBu_r"  # as in ohmskin.plot: red conducts better, white is unchanged


def noise_text(settings: Settings) -> str:
    """The noise level and prior amplitude of the figures, for captions."""
    level, amplitude = settings.noise[0], settings.amplitude[0]
    return f"noise {level:g} dB below the largest 12B voltage, prior amplitude s = {amplitude:g}"


def draw_pixels(axes: Axes, pixels: Floats, limit: float) -> AxesImage:
    """An image (ny, nx) whose full colour is `limit`; returns what a colour bar can be made of."""
    norm, extent = TwoSlopeNorm(0, -limit, limit), (0, SIDE, 0, SIDE)
    return axes.imshow(pixels, origin="lower", extent=extent, cmap=_MAP, norm=norm, interpolation="bilinear")


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
        m = median(scale * values[row])
        style: Any = {"color": COLOURS[key], "markersize": 4, "capsize": 2.5, "linewidth": 1}
        axes.errorbar(m.value, row, xerr=[[m.value - m.low], [m.high - m.value]], fmt=MARKERS[key], **style)
    axes.set(yticks=range(len(keys)), yticklabels=[NAMES[k] for k in keys], ylim=(len(keys) - 0.5, -0.5))
    axes.grid(axis="x")
