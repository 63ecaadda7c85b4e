"""A calibration to newtons and a self-test as pictures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ohmskin.calibrate import ForceCurve, PressSample, SelfTest
from ohmskin.geometry import Raster
from ohmskin.plot.colours import SIGNED
from ohmskin.plot.picture import outline, save_figure
from ohmskin.scan import all_pairs
from ohmskin.skin import Calibration, Skin

_UP, _DOWN = "#2166ac", "#d6604d"
_LONGER = 5
_GOOD, _BAD = "#1b7837", "#c51b22"


def save_calibration(path: Path, skin: Skin, samples: Sequence[PressSample], curve: ForceCurve | None) -> None:
    """Save the sheet as it was found, and the curve to newtons, if any, loading and unloading, and what is left over.

    The file's ending chooses the format.

    Raises:
        DataError: If the file cannot be written.
    """
    figure = Figure(figsize=(15, 4.6) if curve else (5.6, 4.6), layout="constrained")
    first, *others = figure.subplots(1, 3 if curve else 1, squeeze=False)[0]
    _draw_sheet(first, skin)
    if curve:
        _draw_curve(others[0], others[1], samples, curve)
    save_figure(figure, path, dpi=130)


def _draw_sheet(axes: Axes, skin: Skin) -> None:
    """Conductivity against its mean, and how electrodes are displaced, `_LONGER` times as far."""
    raster = Raster(skin.mesh(), 80)
    values = skin.transfer_model().conductivity
    change = 100 * raster(values / values.mean() - 1)
    x0, y0, x1, y1 = (1e3 * bound for bound in skin.domain.bounds)
    most = max(float(np.nanmax(np.abs(change))), 1.0)
    shown = axes.imshow(change, origin="lower", extent=(x0, x1, y0, y1), cmap=SIGNED, vmin=-most, vmax=most)
    label = "conductivity against its mean / %"
    axes.figure.colorbar(shown, cax=axes.inset_axes((1.03, 0.0, 0.04, 1.0)), label=label)
    axes.plot(*outline(skin.domain).T, color="0.4", linewidth=0.8)
    described = 1e3 * skin.electrode.on(skin.chart).positions
    moved = 1e3 * skin.electrodes.positions - described
    axes.plot(*described.T, "o", color="0.3", markersize=4, clip_on=False)
    there = described + _LONGER * moved
    axes.plot(*np.stack([described, there]).transpose(2, 0, 1), color="black", linewidth=1.5, clip_on=False)
    axes.set(xlabel="x / mm", ylabel="y / mm", aspect="equal", xlim=(x0 - 8, x1 + 8), ylim=(y0 - 8, y1 + 8))
    farthest = float(np.linalg.norm(moved, axis=1).max())
    title = f"electrodes off by up to {farthest:.2g} mm (lines: {_LONGER} times)"
    if skin.calibration.unexplained:
        before, after = (f"{100 * share:.2g} %" for share in skin.calibration.unexplained)
        title += f"\nunexplained: {before} as described, {after} as found"
    axes.set_title(title, fontsize=9)


def _draw_curve(left: Axes, right: Axes, samples: Sequence[PressSample], curve: ForceCurve) -> None:
    calibration = Calibration(strengths=curve.strengths, forces=curve.forces)
    line = np.linspace(0, 1.05 * max(sample.strength for sample in samples), 300)
    left.plot(1e6 * line, calibration.force(line), color="0.3", linewidth=1.2, label="calibration")
    left.plot(1e6 * np.array(curve.strengths), curve.forces, "s", color="0.3", markersize=4)
    for loading, colour, marker, label in ((True, _UP, "^", "loading"), (False, _DOWN, "v", "unloading")):
        own = [sample for sample in samples if sample.loading == loading and sample.strength > 0]
        strengths, forces = np.array([s.strength for s in own]), np.array([s.force for s in own])
        left.plot(1e6 * strengths, forces, marker, color=colour, markersize=5, alpha=0.7, label=label)
        left_over = calibration.force(strengths) - forces
        right.plot(forces, left_over, marker, color=colour, markersize=5, alpha=0.7, label=label)
    left.set(xlabel="strength / mm2", ylabel="force / N", xlim=(0, None), ylim=(0, None))
    left.set_title(f"hysteresis {100 * curve.hysteresis:.2g} % of full strength", fontsize=9)
    right.axhline(0, color="0.6", linewidth=0.8)
    right.set(xlabel="force / N", ylabel="calibrated less true force / N", xlim=(0, None))
    right.set_title(f"error {curve.error:.2g} N rms; {100 * curve.scatter:.2g} % scatter between places", fontsize=9)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=8)


def save_self_test(path: Path, result: SelfTest, skin: Skin) -> None:
    """Save the skin with its electrodes, and what was measured against the model; the file's ending chooses the format.

    Raises:
        DataError: If the file cannot be written.
    """
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    sheet, pairs = figure.subplots(1, 2, width_ratios=[1, 1.25])
    x, y = 1e3 * skin.electrodes.positions.T
    x0, y0, x1, y1 = skin.domain.bounds
    sheet.plot(*outline(skin.domain).T, color="0.6")
    bad = {e for finding in result.findings for e in finding.electrodes}
    for finding in result.findings:
        if len(finding.electrodes) == 2:
            two = list(finding.electrodes)
            sheet.plot(x[two], y[two], color=_BAD, linestyle="--", linewidth=1.4, zorder=1)
    for number, at in enumerate(zip(x, y, strict=True)):
        kinds = ", ".join(finding.kind for finding in result.findings if number in finding.electrodes)
        colour = _BAD if number in bad else _GOOD
        sheet.plot(*at, "o", markersize=15, color=colour, clip_on=False, zorder=2)
        sheet.text(*at, str(number), color="white", ha="center", va="center", fontsize=8, zorder=3)
        if kinds:
            sheet.annotate(kinds, at, (0, -17), textcoords="offset points", ha="center", fontsize=8, color=_BAD)
    margin = 90 * (x1 - x0)
    sheet.set(xlim=(1e3 * x0 - margin, 1e3 * x1 + margin), ylim=(1e3 * y0 - margin, 1e3 * y1 + margin))
    sheet.set(xlabel="x / mm", ylabel="y / mm", aspect="equal")
    words = [str(finding) for finding in result.findings] or ["all electrodes are in order"]
    sheet.set_title("\n".join([*words[:4], *([f"and {len(words) - 4} more"] if len(words) > 4 else [])]), fontsize=9)
    sheet.spines[["top", "right"]].set_visible(False)

    found, series = result.diagnosis, result.diagnosis.series
    ends = all_pairs(len(x))
    suspect = np.isin(ends, list(bad)).any(axis=1)
    for chosen, colour, label in ((~suspect, _GOOD, "electrodes in order"), (suspect, _BAD, "with one that is not")):
        pairs.plot(found.modelled[chosen], found.pair_resistances[chosen], ".", color=colour, markersize=5, label=label)
    known = found.modelled[np.isfinite(found.modelled)]
    if len(known):
        line = [0.0, 1.05 * float(known.max())]
        pairs.plot(line, line, color="0.6", linewidth=0.8, zorder=0)
        pairs.legend(frameon=False, fontsize=8)
    pairs.set(xlabel="modelled with these findings / ohm", ylabel="measured between two electrodes / ohm")
    spread = np.nanmax(series) - np.nanmin(series) if np.isfinite(series).any() else float("nan")
    pairs.set_title(f"misfit {100 * found.misfit:.2g} %, contacts within {spread:.3g} ohm of each other", fontsize=9)
    pairs.spines[["top", "right"]].set_visible(False)
    save_figure(figure, path, dpi=130)
