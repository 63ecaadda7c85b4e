"""Figures 5, 7 and 8, the picture of Table I, and what depends on noise and prior amplitude: curves and dots."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator

from ohmskin.arrays import Floats
from ohmskin.evaluate import paper
from ohmskin.evaluate.claims import ADAPTIVE, DECIDED_BY, FIGURES_OF_MERIT, LADDERS, Done, orders
from ohmskin.evaluate.experiments.discrimination import RADIUS
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.experiments.touches import COLUMNS
from ohmskin.evaluate.figures.drawing import NAMES, SIDE, Drawn, draw_estimates, draw_sheet, noise_text, panels
from ohmskin.evaluate.methods import METHODS
from ohmskin.evaluate.resolution import ALPHA, HALF, limits
from ohmskin.evaluate.statistics import median, ratio_of_means
from ohmskin.evaluate.worlds import WORLD_NAMES, WORLDS

COLOURS = dict(zip(METHODS, ("#8c8c8c", "#e69f00", "#0072b2", "#009e73", "#d55e00", "#a6267a"), strict=True))
MARKERS = dict(zip(METHODS, "v^sDoP", strict=True))
_MAPPED = (("16I", "*", "#1f4fd8"), ("16O", "x", "#d62728"))  # with the marks and colours of the paper
_LINES = ("-", "--", ":", "-.")
_NOISE = "noise / dB below the largest 12B voltage"


def sections(done: Done) -> list[Drawn]:
    """Fig. 5: profiles, their peaks and widths."""
    results = done.results["fig5"]
    canvas, grid = panels(2.3 * len(results), len(results), 3, width_ratios=[2.1, 1, 1])
    for (world, task, result), (profiles, peaks, widths) in zip(done.of("fig5"), grid, strict=True):
        centre, radius = 1e3 * task.contact.position[0], 1e3 * task.contact.radius
        profiles.axvspan(centre - radius, centre + radius, color="0.9", linewidth=0)
        profiles.axhline(0, color="0.5", linewidth=0.5)
        for m, key in enumerate(task.methods):
            _band(profiles, 1e3 * result["x"], result["profile"][m], key)
        profiles.set(xlabel="x / mm", ylabel="relative change of conductivity")
        profiles.set(xlim=(0, SIDE), title=WORLD_NAMES[world])
        _medians(peaks, result["peak"], task.methods)
        _medians(widths, result["width"], task.methods, 1e3)
        widths.axvline(2 * radius, color="0.4", linewidth=0.8, linestyle="--")
        peaks.set(xlabel="peak", xlim=(0, None))
        widths.set(xlabel="width / mm", xlim=(0, None), yticklabels=[])
    grid[0, 0].legend(frameon=False, ncols=2)
    caption = (
        f"Cross-sections of the images through the upper left touch, along y = {1e3 * task.contact.position[1]:.0f} "
        f"mm; {noise_text(done.settings)}. Left: median (line) and middle half (band) over {task.seeds} noise seeds; "
        "grey: true extent of the contact. Middle and right: peak of the section and its width at half of that, "
        "medians with 95 % bootstrap intervals (some smaller than the mark); dashed: true diameter."
    )
    return [("fig5", canvas, caption)]


def merits(done: Done) -> list[Drawn]:
    """Table I as a picture."""
    shown = (("AR", 1.0, "AR"), ("PE", 1e3, "|PE| / mm"), ("RES", 1.0, "RES"), ("SD", 1.0, "SD"), ("RNG", 1.0, "RNG"))
    canvas, grid = panels(1.75 * len(done.results["table1"]), len(done.results["table1"]), len(shown), sharey=True)
    for (world, task, result), row in zip(done.of("table1"), grid, strict=True):
        for axes, (name, scale, label) in zip(row, shown, strict=True):
            _medians(axes, result["modern"][..., COLUMNS.index(name)], task.methods, scale)
            axes.set(xlabel=label, xlim=(0, None))
        row[0].set_title(WORLD_NAMES[world], loc="left")
    caption = (
        f"Figures of merit of the upper left touch (Table I), modern definition; {noise_text(done.settings)}. Medians "
        f"over {task.seeds} noise seeds with 95 % bootstrap intervals (some smaller than the mark). AR is 1 for a "
        "perfect image of a disc; on the twin it is relative to the contact's area. PE, RES, SD and RNG are better the "
        "smaller they are."
    )
    return [("table1", canvas, caption)]


def discrimination(done: Done) -> list[Drawn]:
    """Fig. 8: success rates over distance."""
    levels = list(dict.fromkeys((done.settings.noise[0], done.settings.fine_noise)))
    labels = "distance between the contacts / mm", "two contacts distinguished (share)"
    canvas, grid = panels(2.6 * len(WORLDS) + 0.3, len(WORLDS), len(levels), *labels, sharex=True, sharey=True)
    lines: dict[str, Any] = dict(zip(DECIDED_BY, (":", "-"), strict=True))
    for (world, level), axes in zip(product(WORLDS, levels), grid.flat, strict=True):
        areas = list(done.of("fig8", f"{world}/{level:g}/"))
        task = areas[0][1]
        for how, line in lines.items():
            found = limits(task.distances, [result for _, _, result in areas], how)
            for m, key in enumerate(task.methods):
                style = {"marker": MARKERS[key], "markersize": 2.5, "linewidth": 1.2, "color": COLOURS[key]}
                axes.plot(1e3 * np.array(task.distances), found.rate[m], line, **style)
        for key, distance in paper.DISCRIMINATION.items():
            axes.axvline(1e3 * distance, color=COLOURS[key], linewidth=0.8, linestyle="--")
        axes.axhline(HALF, color="0.6", linewidth=0.5)
        axes.set(xlim=(0, 62), ylim=(-0.03, 1.03), title=f"{WORLD_NAMES[world]}, {level:g} dB")
        axes.grid()
    handles = [Line2D([], [], color=COLOURS[k], marker=MARKERS[k], markersize=3, label=NAMES[k]) for k in task.methods]
    handles += [Line2D([], [], color="0.3", linestyle=lines[how], label=by) for how, by in DECIDED_BY.items()]
    theirs = "paper: 17 mm (16I), 12 mm (16O)"
    handles.append(Line2D([], [], color="0.3", linestyle="--", linewidth=0.8, label=theirs))
    canvas.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, columnspacing=1.2)
    caption = (
        f"Two contacts of radius {1e3 * RADIUS:.0f} mm at falling distances, in {len(areas)} areas, {task.seeds} noise "
        "seeds each: share of trials in which they are distinguished, by the dip between two peaks of the image "
        f"(dotted) and by a test of two fitted contacts against one (solid; at most {100 * ALPHA:.0f} % of single "
        "contacts taken for two). Either must put each contact closer to its true place than half the distance. Grey "
        f"line: half of the trials. Prior amplitude s = {task.amplitude:g}."
    )
    return [("fig8", canvas, caption)]


def localisation(done: Done) -> list[Drawn]:
    """Maps and distributions of the error."""
    results = done.results["fig7"]
    canvas, grid = panels(4.05 * len(results), len(results), 2, width_ratios=[1.4, 1])
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


def sweep(done: Done) -> list[Drawn]:
    """Localisation over noise and prior amplitude, and where the orders of Table I hold."""
    return [_noise(done), _orders(done)]


def _noise(done: Done) -> Drawn:
    settings, results = done.settings, done.results["sweep"]
    noise = sorted(settings.noise)
    canvas, grid = panels(2.7 * len(WORLDS), len(WORLDS), 2)
    for world, (level, gain) in zip(WORLDS, grid, strict=True):
        means = {
            s: [errors(results[f"localisation/{world}/{decibels:g}/{s:g}"]).mean(axis=2) for decibels in noise]
            for s in settings.amplitude
        }
        first = np.stack(means[settings.amplitude[0]], axis=-1)  # (n_methods, n_seeds, n_levels)
        for m, key in enumerate(METHODS):
            _band(level, np.array(noise), 1e3 * first[m], key, marker=MARKERS[key], markersize=3)
        level.set(xlabel=_NOISE, ylabel="mean localisation error / mm", yscale="log", xticks=noise)
        ticks = [t for t in (1, 2, 3, 5, 10, 20, 30, 50, 100) if level.get_ylim()[0] <= t <= level.get_ylim()[1]]
        level.yaxis.set_major_locator(FixedLocator(ticks))
        level.yaxis.set_minor_locator(NullLocator())
        level.set_yticklabels([str(t) for t in ticks])
        level.yaxis.set_minor_formatter(NullFormatter())
        level.set_title(f"{WORLD_NAMES[world]}, s = {settings.amplitude[0]:g}")
        for s, line in zip(settings.amplitude, _LINES * len(settings.amplitude), strict=False):
            for key in ADAPTIVE:
                ratios = [ratio_of_means(mean[METHODS.index("16I")], mean[METHODS.index(key)]) for mean in means[s]]
                style: Any = {"linestyle": line, "color": COLOURS[key], "label": f"{key}, s = {s:g}"}
                draw_estimates(gain, noise, ratios, "", **style)
        gain.axhline(paper.RATIO, color="0.4", linewidth=0.8, linestyle="--")
        gain.axhline(1, color="0.6", linewidth=0.5)
        gain.text(noise[-1], paper.RATIO, f"paper {paper.RATIO:.2f}", ha="right", va="bottom", fontsize=6.5)
        gain.set(xlabel=_NOISE, ylabel="error of 16I over error of 16O", xticks=noise)
        for axes in (level, gain):
            axes.grid()
    for axes in grid[0]:
        axes.legend(frameon=False, ncols=2)
    caption = (
        f"Localisation of single touches at {settings.side**2} places over noise and prior amplitude s. Left: mean "
        f"error of six methods; lines and bands are the median and the middle half over {settings.seeds} noise seeds. "
        "Right: how many times smaller the error of adaptive drive is than that of adjacent drive, ratio of means with "
        "95 % bootstrap intervals."
    )
    return "sweep", canvas, caption


def _orders(done: Done) -> Drawn:
    noise, amplitude = sorted(done.settings.noise), sorted(done.settings.amplitude)
    rows = [(world, keys) for world in WORLDS for keys in LADDERS]
    height, sizes = (0.5 + 0.15 * len(amplitude)) * len(rows) + 0.6, (len(rows), len(FIGURES_OF_MERIT))
    canvas, grid = panels(height, *sizes, "noise / dB", "s", sharex=True, sharey=True)
    canvas.get_layout_engine().set(h_pad=0.09)  # type: ignore[union-attr, call-arg]
    colours = ListedColormap(["#e9e4e1", "#2f7d5b"])
    for number, ((world, keys), row) in enumerate(zip(rows, grid, strict=True)):
        for axes, (name, label, _, lower) in zip(row, FIGURES_OF_MERIT, strict=True):
            holds = orders(done, world, name, keys, lower)
            cells = np.array([[float(holds[decibels, s]) for decibels in noise] for s in amplitude])
            axes.pcolormesh(cells, cmap=colours, vmin=0, vmax=1, edgecolors="white", linewidth=1.5)
            axes.set(xticks=np.arange(len(noise)) + 0.5, yticks=np.arange(len(amplitude)) + 0.5)
            axes.set(xticklabels=[f"{d:g}" for d in noise], yticklabels=[f"{s:g}" for s in amplitude])
            axes.tick_params(length=0, labelsize=6)
            axes.spines[:].set_visible(False)
            if number == 0:
                axes.set_title(label, pad=14)
        chain = f"{WORLD_NAMES[world]}: {' → '.join(keys)}"
        text = row[0].annotate(chain, (0, 1.04), xycoords="axes fraction", fontsize=6.5, va="bottom", ha="left")
        text.set_in_layout(False)  # it may reach over the next panels
    shades = {"#2f7d5b": "medians in the claimed order", "#e9e4e1": "not in that order"}
    handles = [Patch(color=shade, label=text) for shade, text in shades.items()]
    canvas.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    caption = (
        "Where the orders of Table I hold (upper left touch, modern definition): for each figure of merit (columns) "
        "and each chain of methods (rows), whether every method's median is better than the one before, at each noise "
        f"level and prior amplitude s; {10 * done.settings.seeds} noise seeds. A claim that fills its panel does not "
        "depend on these choices; one that does not, does."
    )
    return "sweep-orders", canvas, caption


def _band(axes: Axes, x: Floats, values: Floats, key: str, **more: Any) -> None:
    """Median over seeds (n_seeds, n) as a line, the middle half as a band."""
    low, middle, high = np.nanquantile(values, [0.25, 0.5, 0.75], axis=0)
    axes.fill_between(x, low, high, color=COLOURS[key], alpha=0.15, linewidth=0)
    axes.plot(x, middle, color=COLOURS[key], label=NAMES[key], linewidth=1.3, **more)


def _medians(axes: Axes, values: Floats, keys: Sequence[str], scale: float = 1.0) -> None:
    """Medians of values (n_methods, n_seeds) with 95 % intervals, one method per line."""
    for row, key in enumerate(keys):
        style: Any = {"color": COLOURS[key], "markersize": 4, "capsize": 2.5}
        draw_estimates(axes, [row], [median(scale * values[row])], MARKERS[key], across=True, **style)
    axes.set(yticks=range(len(keys)), yticklabels=[NAMES[k] for k in keys], ylim=(len(keys) - 0.5, -0.5))
    axes.grid(axis="x")
