"""Figure 7: true and estimated places."""

import numpy as np
from matplotlib.figure import Figure

from ohmskin.evaluate.claims import Done
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.figures.drawing import Drawn, draw_sheet
from ohmskin.evaluate.figures.style import COLOURS, NAMES
from ohmskin.evaluate.worlds import WORLD_NAMES

_MAPPED = (("16I", "*", "#1f4fd8"), ("16O", "x", "#d62728"))  # with the marks and colours of the paper


def localisation(done: Done) -> list[Drawn]:
    """Maps and distributions of the error."""
    results = done.results["fig7"]
    canvas = Figure(figsize=(7.4, 4.05 * len(results)), layout="constrained")
    grid = canvas.subplots(len(results), 2, squeeze=False, width_ratios=[1.4, 1])
    for (world, task, result), (chart, share) in zip(done.of("fig7"), grid, strict=True):
        draw_sheet(chart, size=6, colour="#2ca02c")
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
        share.set(xlabel="localisation error / mm", ylabel="share of touches with a smaller error")
        share.set(xlim=(0, 60), ylim=(0, 1))
        share.grid()
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.13), "ncols": 2, "frameon": False}
        title = "error / mm: mean, median, 95th percentile"
        share.legend(title=title, columnspacing=1.0, handlelength=1.2, **below)
    caption = (
        f"{len(truth)} single touches. Left: true places and where adjacent (16I) and adaptive drive (16O) see them, "
        f"first noise seed. Right: distribution of the error over all places and {task.seeds} noise seeds, six "
        f"methods; the axis ends at 60 mm. The noise level is the one (in steps of {task.step:g} dB) at which the mean "
        f"error of adjacent drive comes closest to the paper's {1e3 * task.error:.2f} mm; prior amplitude s = "
        f"{task.amplitude:g}."
    )
    return [("fig7", canvas, caption)]
