"""A calibration to newtons as a picture: the curve, loading and unloading, and what is left over."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ohmskin.calibrate import ForceCurve, PressSample
from ohmskin.errors import DataError
from ohmskin.skin import Calibration

_UP, _DOWN = "#2166ac", "#d6604d"


def save_calibration(path: Path, samples: Sequence[PressSample], curve: ForceCurve) -> None:
    """Save the picture of a fitted curve; the file's ending chooses the format.

    Raises:
        DataError: If the file cannot be written.
    """
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
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
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise DataError(f"cannot write picture {path}: {error}") from error
