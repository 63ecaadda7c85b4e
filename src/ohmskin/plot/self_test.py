"""The self-test as a picture: the skin with its electrodes, and what was measured against the model."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ohmskin.calibrate import SelfTest
from ohmskin.errors import DataError
from ohmskin.scan import all_pairs
from ohmskin.skin import Skin

_GOOD, _BAD = "#1b7837", "#c51b22"


def save_self_test(path: Path, result: SelfTest, skin: Skin) -> None:
    """Save the picture of a self-test; the file's ending chooses the format.

    Raises:
        DataError: If the file cannot be written.
    """
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    sheet, pairs = figure.subplots(1, 2, width_ratios=[1, 1.25])
    x, y = 1e3 * skin.electrodes.positions.T
    (x0, y0, x1, y1), turn = skin.domain.bounds, np.linspace(0, 2 * np.pi, 200)
    if skin.sheet.shape == "disc":
        sheet.plot(1e3 * skin.sheet.radius * np.cos(turn), 1e3 * skin.sheet.radius * np.sin(turn), color="0.6")
    else:
        sheet.plot(1e3 * np.array([x0, x1, x1, x0, x0]), 1e3 * np.array([y0, y0, y1, y1, y0]), color="0.6")
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
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise DataError(f"cannot write picture {path}: {error}") from error
