"""What was learned of a skin from presses, as a picture."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ohmskin.arrays import Floats
from ohmskin.calibrate.channels import ChannelJudgement
from ohmskin.calibrate.positions import PositionReport
from ohmskin.plot.colours import AMOUNT
from ohmskin.plot.picture import outline, save_figure
from ohmskin.skin import Skin

_MOST = 5.0  # times the usual error, up to which colours tell errors apart


def save_learned(
    path: Path,
    skin: Skin,
    channels: ChannelJudgement | None,
    positions: PositionReport | None,
    places: Floats | None,
) -> None:
    """Save how channels follow the model, and how far from the places pressed contacts are; what is None is left out.

    The file's ending chooses the format.

    Raises:
        DataError: If the file cannot be written.
    """
    known = positions is not None and places is not None
    curve = positions.curve if positions is not None else ()
    count = max((channels is not None) + known + bool(curve), 1)
    figure = Figure(figsize=(5.4 * count, 4.6), layout="constrained")
    panels = iter(figure.subplots(1, count, squeeze=False)[0])
    if channels is not None:
        _draw_channels(next(panels), channels)
    if positions is not None and places is not None:
        _draw_errors(next(panels), skin, positions, places)
    if positions is not None and curve:
        _draw_curve(next(panels), positions)
    save_figure(figure, path, dpi=130)


def _draw_channels(axes: Axes, found: ChannelJudgement) -> None:
    """Errors over the usual one, an injection a column; crosses on those that are the other way round."""
    gains, errors = found.channels.of(found.pattern)
    which = found.pattern.measurements[:, 0]
    row = np.arange(len(which)) - np.searchsorted(which, which)
    table = np.full((row.max() + 1, found.pattern.n_inj), np.nan)
    table[row, which] = np.where(np.abs(gains) > 0, errors / np.median(errors), np.inf)
    table[row[found.doubtful], which[found.doubtful]] = _MOST
    shown = axes.imshow(np.minimum(table, _MOST), origin="lower", aspect="auto", cmap=AMOUNT, vmin=0, vmax=_MOST)
    axes.figure.colorbar(shown, ax=axes, label="error over the usual one", extend="max")
    axes.plot(which[found.reversed], row[found.reversed], "x", color="#c51b22", markersize=6, label="other way round")
    if found.reversed.any():
        axes.legend(loc="upper right", fontsize=8)
    names = [f"{source}-{sink}" for source, sink in found.pattern.injections]
    step = max(len(names) // 16, 1)
    axes.set_xticks(range(0, len(names), step), names[::step], rotation=90, fontsize=7)
    axes.set(xlabel="injection", ylabel="measurement of the injection")
    before, after = 100 * found.unexplained_before, 100 * found.unexplained
    doubtful = f"{found.doubtful.sum()} of {len(errors)} channels carry little information"
    axes.set_title(f"{doubtful}\nunexplained: {before:.0f} %, weighed {after:.0f} %", fontsize=9)


def _draw_curve(axes: Axes, found: PositionReport) -> None:
    """Mean error at other presses by the number of those learned from."""
    known = np.isfinite(found.mapped)
    counts, errors = zip(*found.curve, (0.8 * known.sum(), float(found.mapped[known].mean())), strict=True)
    axes.semilogx(counts, 1e3 * np.array(errors), "o-", color="#00529b", label="map")
    if found.map.own:
        axes.axhline(1e3 * float(found.physics[known].mean()), color="0.4", linestyle="--", label="physics alone")
    axes.set_xticks(counts, [f"{count:.0f}" for count in counts])
    axes.minorticks_off()
    axes.set(xlabel="presses learned from", ylabel="mean error at others / mm", ylim=(0, None))
    axes.set_title(f"{100 * found.held:.0f} % within their 90 % ellipses", fontsize=9)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def _draw_errors(axes: Axes, skin: Skin, found: PositionReport, places: Floats) -> None:
    """Where each press of known place was, coloured by the error that the map leaves there."""
    known = np.isfinite(found.mapped)
    if found.map.own:
        axes.plot(*outline(skin.domain).T, color="0.4", linewidth=0.8)
        axes.plot(*1e3 * skin.electrodes.positions.T, "o", color="0.3", markersize=4, clip_on=False)
    errors = 1e3 * found.mapped[known]
    x, y = 1e3 * places[known].T
    shown = axes.scatter(x, y, s=14, c=errors, cmap=AMOUNT, vmin=0, vmax=float(np.quantile(errors, 0.95)))
    axes.figure.colorbar(shown, ax=axes, label="error at presses not learned from / mm", extend="max")
    axes.set(xlabel="x / mm", ylabel="y / mm", aspect="equal")
    physics = f"physics {1e3 * np.nanmean(found.physics):.2f} mm, " if found.map.own else ""
    similarity, mapped = 1e3 * np.nanmean(found.similarity), 1e3 * np.nanmean(found.mapped)
    axes.set_title(f"mean error: {physics}similarity {similarity:.2f} mm, map {mapped:.2f} mm", fontsize=9)
