"""The pictures of the report, from results alone."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, ScalarFormatter

from ohmskin.evaluate.figures.painting import Picture
from ohmskin.evaluate.figures.style import RC, draw_sheet
from ohmskin.evaluate.policies.comparison import Comparison
from ohmskin.evaluate.policies.detection import APART, NEAR, Detection
from ohmskin.evaluate.policies.judge import NAMES, SETTLE, WITHIN, moving_errors, pair_rates, robust_errors, static_errors
from ohmskin.evaluate.policies.moving import Moving
from ohmskin.evaluate.policies.pairs import ALPHA, PairLimits, Pairs, ideal_power
from ohmskin.evaluate.policies.static import Static
from ohmskin.evaluate.statistics import mean
from ohmskin.geometry.domain import Floats

_DPI = 160
COLOURS = {"12B": "#8c8c8c", "16I": "#0072b2", "16O": "#d55e00", "16P/16": "#56b498", "16P": "#00735c", "16T": "#a6267a"}
_MARKERS = {"centroid": "o", "fit": "D"}
_FILLED = {"centroid": False, "fit": True}

_OTHERS = ("nothing else touched", "one other followed", "two others followed")

Drawn = tuple[Figure, str]  # figure, caption


def draw(done: Comparison, folder: Path) -> dict[str, Picture]:
    """Draw a picture of each section that is there into a folder."""
    painters: dict[str, Callable[[Comparison], Drawn]] = {
        "static": static,
        "moving": moving,
        "pairs": pairs,
        "detection": detection,
        "robust": robust,
    }
    found = {}
    with rc_context(RC):
        for section, painter in painters.items():
            if section in done.results:
                canvas, caption = painter(done)
                FigureCanvasAgg(canvas)
                canvas.savefig(path := folder / f"{section}.png", dpi=_DPI)
                found[section] = Picture(section, path, caption)
    return found


def static(done: Comparison) -> Drawn:
    """Errors by scheme and estimator, and the bound over the sheet."""
    results = done.results["static"]
    worlds = list(dict.fromkeys(name.split("/")[0] for name in results))
    levels = list(dict.fromkeys(name.split("/")[1] for name in results))
    canvas = Figure(figsize=(7.4, 1.9 * len(levels) + 2.9), layout="constrained")
    upper, lower = cast(Any, canvas.subfigures(2, 1, height_ratios=[1.9 * len(levels), 2.9]))
    grid = upper.subplots(len(levels), len(worlds), squeeze=False, sharey=True, sharex=True)
    for row, level in zip(grid, levels, strict=True):
        for axes, world in zip(row, worlds, strict=True):
            task, result = cast(Static, done.experiments["static"][f"{world}/{level}"]), results[f"{world}/{level}"]
            means = static_errors(result)
            for e, estimator in enumerate(task.estimators):
                for s, key in enumerate(task.schemes):
                    _dot(axes, s + 0.22 * (e - 0.5), 1e3 * means[s, e], COLOURS[key], _MARKERS[estimator], _FILLED[estimator])
            if np.isfinite(result["bound"]).all():
                bound = 1e3 * result["bound"].mean(axis=(1, 2))
                axes.scatter(np.arange(len(bound)), bound, marker="_", s=160, color="0.35", linewidth=1)
            _millimetres(axes)
            axes.set(title=f"{NAMES[world]}, {level} dB", ylim=(0.4, 40))
            _log_ticks(axes)
            axes.set_xticks(
                range(len(task.schemes)), [f"{k}\n{n}" for k, n in zip(_short(task), result["injections"], strict=True)]
            )
    for axes in grid[:, 0]:
        axes.set_ylabel("mean error / mm")
    handles = [
        grid[0, 0].plot([], [], linestyle="", color="0.3", marker=_MARKERS[e], mfc="0.3" if _FILLED[e] else "white", label=label)[0]
        for e, label in (("centroid", "centroid of the image"), ("fit", "fitted contact"))
    ]
    handles.append(grid[0, 0].plot([], [], linestyle="", color="0.35", marker="_", markersize=11, label="position bound")[0])
    upper.legend(handles=handles, frameon=False, loc="outside upper center", ncols=3)
    name = next(name for name in results if name.startswith("discs/"))
    task, result = cast(Static, done.experiments["static"][name]), results[name]
    maps = lower.subplots(1, 3)
    shown = ("16I", "16O", "16P")
    seen = [1e3 * result["bound"][task.schemes.index(key)].mean(axis=0)[: task.side**2] for key in shown]
    top = float(np.quantile(np.concatenate(seen), 0.97))
    half = 100 / (task.side + 1)
    for axes, key, values in zip(maps, shown, seen, strict=True):
        image = axes.imshow(
            values.reshape(task.side, task.side),
            origin="lower",
            extent=(half, 200 - half, half, 200 - half),
            vmin=0,
            vmax=top,
            cmap="viridis_r",
        )
        draw_sheet(axes, "16I", left=key == shown[0])
        axes.set_title(f"{key}: mean {values.mean():.2f}, worst {values.max():.2f} mm")
    lower.colorbar(image, ax=list(maps), label="position bound / mm", shrink=0.9)
    caption = (
        f"Static single contacts at {task.side**2} lattice and {task.random} random places, {task.seeds} noise seeds. Above: "
        "mean error by injections (mode and their number) and estimator, with 95 % bootstrap intervals over seeds (mostly smaller "
        "than the marks); the bar is the position bound of the patterns driven, had the radius been known within a factor of 1.5. "
        f"Below: that bound over the lattice, {name.split('/')[1]} dB, discs."
    )
    return canvas, caption


def moving(done: Comparison) -> Drawn:
    """Errors on winding paths, and a path."""
    results = done.results["moving"]
    canvas = Figure(figsize=(7.4, 2.7), layout="constrained")
    grid = canvas.subplots(1, len(results) + 1, width_ratios=[*[1.1] * len(results), 1])
    for axes, (world, result) in zip(grid, results.items(), strict=False):
        task = cast(Moving, done.experiments["moving"][world])
        framewise, tracked = moving_errors(result)
        labels: list[str] = []
        for s, key in enumerate(task.schemes):
            for e, estimator in enumerate(task.estimators):
                _dot(axes, len(labels), 1e3 * framewise[s, e], COLOURS[key], _MARKERS[estimator], _FILLED[estimator])
                labels.append(f"{key.partition('/')[0]}\n{estimator}\n16")
        for t, count in enumerate(task.followers):
            _dot(axes, len(labels), 1e3 * tracked[t], COLOURS["16T"], "P", True)
            labels.append(f"16T\n\n{count}")
        axes.set_xticks(range(len(labels)), labels, fontsize=6)
        axes.set(ylim=(0, None), title=f"{NAMES[world]}, {task.decibels:g} dB", ylabel="mean error / mm")
        axes.grid(axis="y")
    task, result = cast(Moving, done.experiments["moving"]["discs"]), results["discs"]
    axes = grid[-1]
    draw_sheet(axes, "16I")
    axes.plot(*(1e3 * result["truth"][0].T), color="0.3", linewidth=1, label="path")
    places = 1e3 * result["framewise"][task.schemes.index("16I"), task.estimators.index("fit"), 0]
    axes.plot(*places.T, ".", color=COLOURS["16I"], markersize=2.5, label="16I, fit")
    axes.plot(*(1e3 * result["tracked"][task.followers.index(4), 0].T), color=COLOURS["16T"], linewidth=0.9, label="16T, 4")
    axes.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, 1.22), ncols=3, handlelength=1, columnspacing=0.8)
    caption = (
        f"A contact that moves at 0 to 3 mm per frame on winding paths, one path and noise for each of {task.seeds} seeds, "
        f"{task.frames} frames (the first {SETTLE} do not count). Left: mean error with 95 % bootstrap intervals, frame by frame "
        "with 16 injections (16I, 16P; centroid and fit) and tracked with the number of injections below 16T. Right: the first "
        "path, discs."
    )
    return canvas, caption


def pairs(done: Comparison) -> Drawn:
    """Success against distance."""
    experiments, results = done.experiments["pairs"], done.results["pairs"]
    names = [name.removeprefix("told/") for name in results if name.startswith("told/")]
    columns = list(dict.fromkeys(name.split("/")[0] for name in names))
    rows = list(dict.fromkeys(name.split("/")[1] for name in names))
    canvas = Figure(figsize=(7.4, 2.3 * len(rows) + 0.3), layout="constrained")
    grid = canvas.subplots(len(rows), len(columns), squeeze=False, sharex=True, sharey=True)
    for line, strength in zip(grid, rows, strict=True):
        for axes, decibels in zip(line, columns, strict=True):
            name = f"{decibels}/{strength}"
            task, limits = cast(Pairs, experiments[f"told/{name}"]), results[f"limit/{name}"]
            told, _ = pair_rates(results[f"told/{name}"])
            x = 1e3 * np.array(task.distances)
            bounds = cast(PairLimits, experiments[f"limit/{name}"])
            for s, key in enumerate(task.schemes):
                _curve(axes, x, 100 * told[s].mean(axis=1), COLOURS[key], key)
                ideal = 100 * ideal_power(limits["distance"][bounds.schemes.index(key)]).mean(axis=1)
                axes.plot(x, ideal, ":", color=COLOURS[key], linewidth=1.2, label=f"{key}, ideal test")
            any_choice = 100 * ideal_power(limits["any"]).mean(axis=1)
            axes.plot(x, any_choice, "-.", color="0.3", linewidth=0.9, label=f"ideal test, any {bounds.count}")
            axes.axhline(75, color="0.6", linewidth=0.6)
            axes.set(title=f"+{100 * float(strength):g} %, {decibels} dB", ylim=(0, 103), xticks=x)
            axes.grid()
    for axes in grid[-1]:
        axes.set_xlabel("distance / mm")
    for axes in grid[:, 0]:
        axes.set_ylabel("told apart / %")
    grid[-1, -1].legend(*grid[0, -1].get_legend_handles_labels(), frameon=False, loc="lower right")
    caption = (
        f"Two discs of 6 mm radius told from one, at most {100 * ALPHA:g} % of single contacts taken for two. {told.shape[3]} "
        f"noise seeds at each of {told.shape[2]} places, drawn at random. Solid: the test of two fitted discs against one, its "
        "threshold set on other single contacts; bands are 95 % bootstrap intervals over seeds. Dotted: the ideal test on the "
        "same injections, which knows both hypotheses in every number. Dash-dotted: an upper bound for it over every choice of "
        "28 injections."
    )
    return canvas, caption


def detection(done: Comparison) -> Drawn:
    """Share of new contacts found by frame."""
    results = done.results["detection"]
    worlds = list(dict.fromkeys(name.split("/")[0] for name in results))
    canvas = Figure(figsize=(7.4, 2.5), layout="constrained")
    grid = canvas.subplots(1, len(worlds), squeeze=False, sharey=True)[0]
    frames = np.arange(1, 16)
    lines = ("-", "--", ":")
    for axes, world in zip(grid, worlds, strict=True):
        for name in (name for name in results if name.startswith(f"{world}/")):
            task = cast(Detection, done.experiments["detection"][name])
            share = [100 * np.mean(results[name]["frames"] <= k) for k in frames]
            style = lines[task.others % len(lines)]
            axes.step(frames, share, style, where="mid", color=COLOURS["16T"], linewidth=1.3, label=_OTHERS[task.others])
        axes.axvline(WITHIN, color="0.6", linewidth=0.6)
        axes.axhline(99, color="0.6", linewidth=0.6)
        axes.set(xlabel="frames since it came", title=f"{NAMES[world]}, {task.decibels:g} dB", xticks=frames[::2])
        axes.grid()
    grid[0].set_ylabel("new contacts found / %")
    grid[0].legend(frameon=False, loc="lower right")
    caption = (
        f"How soon a new contact is found with {task.injections} injections per frame, while none, one or two others are "
        f"followed; {task.trials} trials each, with places at least 10 mm from the rim and "
        f"{1e3 * APART:.0f} mm from each other, and noise of their own. Found is a contact reported within {1e3 * NEAR:.0f} mm. "
        f"The lines mark {WITHIN} frames and 99 %."
    )
    return canvas, caption


def robust(done: Comparison) -> Drawn:
    """Errors with a flawed model or skin."""
    table = robust_errors(done)
    canvas = Figure(figsize=(7.4, 2.9), layout="constrained")
    axes = canvas.subplots()
    names = list(table)
    ways = list(next(iter(table.values())))
    for w, (key, estimator) in enumerate(ways):
        for n, name in enumerate(names):
            values = 1e3 * table[name][key, estimator]
            _dot(
                axes,
                n + 0.1 * (w - (len(ways) - 1) / 2),
                values,
                COLOURS[key],
                _MARKERS.get(estimator, "P"),
                estimator != "centroid",
            )
        axes.plot(
            [],
            [],
            linestyle="",
            marker=_MARKERS.get(estimator, "P"),
            color=COLOURS[key],
            mfc="white" if estimator == "centroid" else COLOURS[key],
            label=f"{key}, {estimator}",
        )
    axes.set_xticks(
        range(len(names)), [name.replace(" ", "\n", 1).replace(" since", "\nsince").replace(" and", "\nand") for name in names]
    )
    axes.set(ylabel="mean error / mm", ylim=(0, None))
    axes.grid(axis="y")
    axes.legend(frameon=False, ncols=4, loc="upper center", bbox_to_anchor=(0.5, 1.2))
    caption = (
        "Contact-layer twin with a flawed model or a worn skin: mean error of static contacts, frame by frame, and of moving "
        f"ones, tracked with 4 injections (16T). {done.settings.levels[-1]:g} dB; at least {done.settings.seeds} seeds in all, "
        f"random flaws drawn {done.settings.draws} times; 95 % bootstrap intervals over seeds."
    )
    return canvas, caption


def _short(task: Static) -> list[str]:
    return [key.partition("/")[0] for key in task.schemes]


def _dot(axes: Axes, x: float, values: Floats, colour: str, marker: str, filled: bool) -> None:
    """The mean of values (n_seeds,) and its interval."""
    m = mean(values)
    spread = [[m.value - m.low], [m.high - m.value]]
    face = colour if filled else "white"
    axes.errorbar(x, m.value, yerr=spread, fmt=marker, color=colour, mfc=face, markersize=4.5, capsize=2, linewidth=1)


def _curve(axes: Axes, x: Floats, rates: Floats, colour: str, label: str) -> None:
    """The mean over seeds of rates (n_x, n_seeds), and its interval."""
    found = [mean(row) for row in rates]
    axes.plot(x, [m.value for m in found], "o-", color=colour, markersize=3, linewidth=1.3, label=label)
    axes.fill_between(x, [m.low for m in found], [m.high for m in found], color=colour, alpha=0.18, linewidth=0)


def _millimetres(axes: Axes) -> None:
    axes.set_yscale("log")
    axes.grid(axis="y")


def _log_ticks(axes: Axes) -> None:
    axes.set_yticks([0.5, 1, 2, 5, 10, 20])
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())
