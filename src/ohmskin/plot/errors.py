"""Maps of the bound on a contact's position error, drawn over the sheet."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.tri import TriContourSet

from ohmskin.arrays import Floats
from ohmskin.geometry import Domain, Electrodes
from ohmskin.plot.colours import AMOUNT
from ohmskin.plot.picture import outline, save_figure

_LEVELS = 24


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """Bounds on the position error over a sheet.

    Args:
        title: What was measured, in a line.
        domain: The sheet.
        electrodes: Electrode layout.
        places: (n, 2) of contacts (m).
        errors: (n,) least root-mean-square position error (m).
    """

    title: str
    domain: Domain
    electrodes: Electrodes
    places: Floats
    errors: Floats


def draw_error_map(axes: Axes, shown: ErrorMap, limits: tuple[float, float] | None = None) -> TriContourSet:
    """Draw a map with its rim, its electrodes and its worst place; axes in millimetres.

    Args:
        axes: Where to draw.
        shown: The map.
        limits: Errors of the first and the last colour (m), on a scale of logarithms; those of the map unless given.

    Returns:
        What a colour bar can be made of.
    """
    low, high = limits or (float(shown.errors.min()), float(shown.errors.max()))
    levels = 1e3 * np.geomspace(low * (1 - 1e-3), high * (1 + 1e-3), _LEVELS)
    x, y = 1e3 * shown.places.T
    colours: TriContourSet = axes.tricontourf(x, y, 1e3 * shown.errors, levels=levels, cmap=AMOUNT, norm=LogNorm())
    axes.plot(*outline(shown.domain).T, color="0.15", linewidth=1)
    axes.plot(*1e3 * shown.electrodes.positions.T, "o", color="0.15", markersize=5, clip_on=False)
    worst = int(np.argmax(shown.errors))
    axes.plot(*1e3 * shown.places[worst], "x", color="0.15", markersize=8, markeredgewidth=2)
    mean, most = 1e3 * shown.errors.mean(), 1e3 * shown.errors[worst]
    axes.set_title(
        f"{shown.title}\nbound: mean {mean:.3g} mm, worst {most:.3g} mm (cross)", fontsize=10, parse_math=False
    )
    axes.set(xlabel="x / mm", ylabel="y / mm", aspect="equal")
    axes.spines[["top", "right"]].set_visible(False)
    return colours


def save_error_maps(path: str | Path, maps: Sequence[ErrorMap]) -> None:
    """Save maps side by side, in the same colours, as a picture at `path`, whose ending chooses the format.

    Raises:
        DataError: If the file cannot be written.
    """
    figure = Figure(figsize=(1.2 + 5.0 * len(maps), 4.9), layout="constrained")
    low, high = min(float(m.errors.min()) for m in maps), max(float(m.errors.max()) for m in maps)
    axes = np.atleast_1d(figure.subplots(1, len(maps)))
    for place, shown in zip(axes, maps, strict=True):
        colours = draw_error_map(place, shown, (low, high))
    ticks = [tick for tick in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100) if 1e3 * low <= tick <= 1e3 * high]
    bar = figure.colorbar(colours, ax=axes.tolist(), label="bound on the position error / mm", shrink=0.85, ticks=ticks)
    bar.ax.set_yticklabels([f"{tick:g}" for tick in ticks])
    save_figure(figure, path)
