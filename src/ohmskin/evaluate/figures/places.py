"""Figure 7: true and estimated places."""

from typing import cast

import numpy as np
from matplotlib.figure import Figure

from ohmskin.evaluate.experiments import MatchedLocalisation
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.figures.style import COLOURS, NAMES, WORLD_NAMES, draw_sheet
from ohmskin.evaluate.reproduction import Reproduction

_MAPPED = (("16I", "*", "#1f4fd8"), ("16O", "x", "#d62728"))  # with the marks and colours of the paper


def localisation(done: Reproduction) -> list[tuple[str, Figure, str]]:
    """Maps and distributions of the error."""
    results = done.results["fig7"]
    canvas = Figure(figsize=(7.4, 4.05 * len(results)), layout="constrained")
    grid = canvas.subplots(len(results), 2, squeeze=False, width_ratios=[1.4, 1])
    for (world, result), (chart, share) in zip(results.items(), grid, strict=True):
        task = cast(MatchedLocalisation, done.experiments["fig7"][world])
        draw_sheet(chart, "16I", size=6, colour="#2ca02c")
        truth = 1e3 * result["truth"]
        for key, marker, colour in _MAPPED:
            seen = 1e3 * result["estimate"][task.methods.index(key), 0]
            for line in np.stack([truth, seen], axis=1):
                chart.plot(*line.T, color=colour, linewidth=0.4, alpha=0.6)
            label = f"seen by {'adjacent' if key == '16I' else 'adaptive'} drive ({key})"
            chart.plot(*seen.T, marker, color=colour, markersize=4, label=label, linestyle="none", markeredgewidth=0.9)
        chart.plot(*truth.T, ".", color="black", markersize=3.5, label="true places")
        chart.plot([], [], "o", color="#2ca02c", markersize=5, label="electrodes")
        chart.set(xticks=range(0, 201, 50), yticks=range(0, 201, 50))
        chart.set_title(f"{WORLD_NAMES[world]}, noise {float(result['decibels']):g} dB")
        chart.legend(frameon=False, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.1), handletextpad=0.2)
        for m, key in enumerate(task.methods):
            every = np.sort(1e3 * errors(result)[m].ravel())
            label = f"{NAMES[key]}: {every.mean():.1f}, {np.median(every):.1f}, {np.quantile(every, 0.95):.1f}"
            share.plot(every, np.arange(1, len(every) + 1) / len(every), color=COLOURS[key], label=label, linewidth=1.3)
        share.set(xlabel="localisation error / mm", ylabel="share of touches with a smaller error", xlim=(0, 60), ylim=(0, 1))
        share.grid()
        share.legend(
            frameon=False,
            ncols=2,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.13),
            title="error / mm: mean, median, 95th percentile",
            columnspacing=1.0,
            handlelength=1.2,
        )
    caption = (
        f"{len(truth)} single touches. Left: true places and where adjacent (16I) and adaptive drive (16O) see them, "
        f"first noise seed. Right: "
        f"distribution of the error over all places and {task.seeds} noise seeds, six methods; the axis ends at 60 "
        f"mm. The noise level is the "
        f"one (in steps of {task.step:g} dB) at which the mean error of adjacent drive comes closest to the paper's "
        f"{1e3 * task.error:.2f} mm; "
        f"prior amplitude s = {task.amplitude:g}."
    )
    return [("fig7", canvas, caption)]
