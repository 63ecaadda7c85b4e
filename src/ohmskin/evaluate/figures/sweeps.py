"""What depends on noise and prior amplitude."""

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator

from ohmskin.arrays import Floats
from ohmskin.evaluate import paper
from ohmskin.evaluate.claims import ADAPTIVE, FIGURES_OF_MERIT, LADDERS, Done, orders
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.figures.drawing import Drawn, draw_estimates
from ohmskin.evaluate.figures.style import COLOURS, MARKERS, draw_band
from ohmskin.evaluate.methods import METHODS
from ohmskin.evaluate.statistics import ratio_of_means
from ohmskin.evaluate.worlds import WORLD_NAMES, WORLDS

_LINES = ("-", "--", ":", "-.")
_NOISE = "noise / dB below the largest 12B voltage"


def sweep(done: Done) -> list[Drawn]:
    """Localisation over noise and prior amplitude, and where the orders of Table I hold."""
    return [_errors(done), _orders(done)]


def _errors(done: Done) -> Drawn:
    settings = done.settings
    noise = sorted(settings.noise)
    canvas = Figure(figsize=(7.4, 2.7 * len(WORLDS)), layout="constrained")
    grid = canvas.subplots(len(WORLDS), 2, squeeze=False)
    for world, (level, gain) in zip(WORLDS, grid, strict=True):
        means = {s: [_means(done, world, decibels, s) for decibels in noise] for s in settings.amplitude}
        first = np.stack(means[settings.amplitude[0]], axis=-1)  # (n_methods, n_seeds, n_levels)
        for m, key in enumerate(METHODS):
            draw_band(level, np.array(noise), 1e3 * first[m], key, marker=MARKERS[key], markersize=3)
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
                style = {"linestyle": line, "color": COLOURS[key], "label": f"{key}, s = {s:g}"}
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


def _means(done: Done, world: str, decibels: float, amplitude: float) -> Floats:
    means: Floats = errors(done.results["sweep"][f"localisation/{world}/{decibels:g}/{amplitude:g}"]).mean(axis=2)
    return means


def _orders(done: Done) -> Drawn:
    noise, amplitude = sorted(done.settings.noise), sorted(done.settings.amplitude)
    rows = [(world, keys) for world in WORLDS for keys in LADDERS]
    canvas = Figure(figsize=(7.4, (0.5 + 0.15 * len(amplitude)) * len(rows) + 0.6), layout="constrained")
    canvas.get_layout_engine().set(h_pad=0.09)  # type: ignore[union-attr, call-arg]
    grid = canvas.subplots(len(rows), len(FIGURES_OF_MERIT), squeeze=False, sharex=True, sharey=True)
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
        row[0].set_ylabel("s")
        chain = f"{WORLD_NAMES[world]}: {' → '.join(keys)}"
        text = row[0].annotate(chain, (0, 1.04), xycoords="axes fraction", fontsize=6.5, va="bottom", ha="left")
        text.set_in_layout(False)  # it may reach over the next panels
    for axes in grid[-1]:
        axes.set_xlabel("noise / dB")
    handles = [
        Patch(color="#2f7d5b", label="medians in the claimed order"),
        Patch(color="#e9e4e1", label="not in that order"),
    ]
    canvas.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    caption = (
        "Where the orders of Table I hold (upper left touch, modern definition): for each figure of merit (columns) "
        "and each chain of methods (rows), whether every method's median is better than the one before, at each noise "
        f"level and prior amplitude s; {10 * done.settings.seeds} noise seeds. A claim that fills its panel does not "
        "depend on these choices; one that does not, does."
    )
    return "sweep-orders", canvas, caption
