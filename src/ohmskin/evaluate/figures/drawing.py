"""What all pictures have in common: how they look, how they are drawn and saved."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ohmskin.arrays import Floats
from ohmskin.evaluate.methods import METHODS
from ohmskin.evaluate.plan import Settings
from ohmskin.evaluate.result import Outcome
from ohmskin.evaluate.statistics import ConfidenceInterval
from ohmskin.evaluate.worlds import LAYOUTS
from ohmskin.plot.report import ReportPicture
from ohmskin.skin import Skin

Drawn = tuple[str, Figure, str]  # file name, figure, caption
SIDE = 200.0  # millimetres, of the paper's sheet
NAMES = {key: "local [14]" if key == "local" else key for key in METHODS}

RC: Any = dict.fromkeys(("font.size", "axes.titlesize", "axes.labelsize"), 8)
RC |= dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 7)
RC |= dict.fromkeys(("axes.linewidth", "xtick.major.width", "ytick.major.width"), 0.6)
RC |= {"axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True, "figure.facecolor": "white"}
RC |= {"grid.linewidth": 0.3, "grid.color": "0.85"}


def save_pictures(
    done: Outcome[Any], painters: Mapping[str, Callable[[Outcome[Any]], Sequence[Drawn]]], folder: Path, dpi: int
) -> dict[str, list[ReportPicture]]:
    """Draw the pictures of all groups whose results are there into a folder; the pictures of each group."""
    found: dict[str, list[ReportPicture]] = {}
    with rc_context(RC):
        for group in done.results:
            found[group] = []
            for name, canvas, caption in painters[group](done) if group in painters else ():
                FigureCanvasAgg(canvas)
                canvas.savefig(path := folder / f"{name}.png", dpi=dpi)
                found[group].append(ReportPicture(name, path, caption))
    return found


def panels(height: float, rows: int, columns: int, x: str = "", y: str = "", **options: Any) -> tuple[Figure, Any]:
    """A figure (height in inches) and its axes (rows, columns); labels below the last row and at the first column."""
    canvas = Figure(figsize=(7.4, height), layout="constrained")
    grid = canvas.subplots(rows, columns, squeeze=False, **options)
    for axes in grid[-1]:
        axes.set_xlabel(x)
    for axes in grid[:, 0]:
        axes.set_ylabel(y)
    return canvas, grid


def draw_estimates(
    axes: Axes, at: Sequence[float], found: Sequence[ConfidenceInterval], fmt: str, across: bool = False, **style: Any
) -> None:
    """Values at x with their intervals as error bars; or `across`, at y."""
    values, low, high = np.array([astuple(each) for each in found]).T
    bars = [values - low, high - values]
    placed: Any = {"x": values, "y": at, "xerr": bars} if across else {"x": at, "y": values, "yerr": bars}
    axes.errorbar(**placed, fmt=fmt, **{"linewidth": 1, "capsize": 2} | style)


def draw_sheet(
    axes: Axes, layout: str = "grid", left: bool = True, bottom: bool = True, size: float = 1.8, colour: str = "0.2"
) -> None:
    """Axes of a sheet in millimetres, with the electrodes of a layout."""
    electrodes: Floats = 1e3 * Skin.load(LAYOUTS[layout]).electrodes.positions.T
    axes.plot(*electrodes, "o", color=colour, markersize=size, clip_on=False, zorder=3)
    axes.set(xlim=(0, SIDE), ylim=(0, SIDE), xticks=[0, 100, 200], yticks=[0, 100, 200], aspect="equal")
    axes.spines[["top", "right"]].set_visible(True)
    axes.tick_params(length=2, labelleft=left, labelbottom=bottom)
    if left:
        axes.set_ylabel("y / mm", labelpad=1)
    if bottom:
        axes.set_xlabel("x / mm", labelpad=1)


def noise_text(settings: Settings) -> str:
    """The noise level and prior amplitude of the figures, for captions."""
    level, amplitude = settings.noise[0], settings.amplitude[0]
    return f"noise {level:g} dB below the largest 12B voltage, prior amplitude s = {amplitude:g}"
