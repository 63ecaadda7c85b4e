"""The pictures of the report, from results alone."""

from dataclasses import astuple
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, ScalarFormatter

from ohmskin.arrays import Floats
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.figures.drawing import Drawn, draw_estimates, draw_sheet, panels
from ohmskin.evaluate.policies import goals
from ohmskin.evaluate.policies.goals import OTHERS, WITHIN, Done
from ohmskin.evaluate.policies.pairs import ALPHA, ideal_power
from ohmskin.evaluate.policies.robustness import gain_picture, sensitivity_picture
from ohmskin.evaluate.policies.schemes import NAMES
from ohmskin.evaluate.policies.tracked import APART, NEAR, SETTLE, moving_errors
from ohmskin.evaluate.statistics import mean
from ohmskin.plot.colours import AMOUNT

COLOURS = {"12B": "#8c8c8c", "16I": "#0072b2", "best": "#e69f00", "16O fused": "#d55e00"}
COLOURS |= {"16P": "#00735c", "16T": "#a6267a", "rotating": "#cc79a7", "rotating best": "#56b4e9"}
_MARKERS = {"centroid": "o", "fit": "D"}  # a centroid's is not filled


def static(done: Done) -> list[Drawn]:
    """Errors by scheme and reader, and the bound over the sheet."""
    results = done.results["static"]
    worlds, levels = (list(dict.fromkeys(name.split("/")[part] for name in results)) for part in (0, 1))
    canvas = Figure(figsize=(7.4, 1.9 * len(levels) + 2.9), layout="constrained")
    upper, lower = cast(Any, canvas.subfigures(2, 1, height_ratios=[1.9 * len(levels), 2.9]))
    grid = upper.subplots(len(levels), len(worlds), squeeze=False, sharey=True, sharex=True)
    for name, task, result in done.of("static"):
        world, level = name.split("/")
        axes, away = grid[levels.index(level), worlds.index(world)], errors(result)
        for e, reader in enumerate(task.readers):
            for s, key in enumerate(task.schemes):
                _dot(axes, s + 0.22 * (e - 0.5), away[s, e], key, reader)
        if np.isfinite(result["bound"]).all():
            bound = 1e3 * result["bound"].mean(axis=(1, 2))
            axes.scatter(np.arange(len(bound)), bound, marker="_", s=160, color="0.35", linewidth=1)
        axes.set(title=f"{NAMES[world]}, {level} dB", yscale="log", ylim=(0.4, 100))
        axes.grid(axis="y")
        axes.set_yticks([0.5, 1, 2, 5, 10, 20, 50])
        axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.yaxis.set_minor_formatter(NullFormatter())
        labels = [f"{key.partition('/')[0]}\n{n}" for key, n in zip(task.schemes, result["injections"], strict=True)]
        axes.set_xticks(range(len(labels)), labels)
    for axes in grid[:, 0]:
        axes.set_ylabel("mean error / mm")
    axes = grid[0, 0]
    axes.plot([], [], "o", color="0.3", mfc="white", label="centroid of the image")
    axes.plot([], [], "D", color="0.3", label="fitted contact")
    axes.plot([], [], "_", color="0.35", markersize=11, label="position bound")
    upper.legend(*axes.get_legend_handles_labels(), frameon=False, loc="outside upper center", ncols=3)
    name, task, result = next(done.of("static", "discs/"))
    maps, shown = lower.subplots(1, 3), ("best", "16O fused", "16P")
    seen = [1e3 * result["bound"][task.schemes.index(key)].mean(axis=0)[: task.side**2] for key in shown]
    half, top = 100 / (task.side + 1), float(np.quantile(np.concatenate(seen), 0.97))
    style = {"origin": "lower", "extent": (half, 200 - half, half, 200 - half), "cmap": AMOUNT}
    for axes, key, values in zip(maps, shown, seen, strict=True):
        image = axes.imshow(values.reshape(task.side, task.side), vmin=0, vmax=top, **style)
        draw_sheet(axes, left=key == shown[0])
        axes.set_title(f"{key}: mean {values.mean():.1f}, worst {values.max():.1f}")
    lower.colorbar(image, ax=list(maps), label="position bound / mm", shrink=0.9)
    caption = (
        f"Static single contacts at {task.side**2} lattice and {task.random} random places, {task.seeds} noise seeds. "
        "Above: mean error by injections (mode and their number) and estimator, with 95 % bootstrap intervals over "
        "seeds and places; the bar is the position bound of the patterns driven, had the radius "
        f"been known within a factor of 1.5. Below: that bound over the lattice, {name.split('/')[1]} dB, discs."
    )
    return [("static", canvas, caption)]


def moving(done: Done) -> list[Drawn]:
    """Errors on winding paths, and a path."""
    results = done.results["moving"]
    canvas, (grid,) = panels(2.7, 1, len(results) + 1, width_ratios=[*[1] * len(results), 1.1])
    for axes, (world, task, result) in zip(grid, done.of("moving"), strict=False):
        framewise, tracked = moving_errors(result)
        labels: list[str] = []
        for s, key in enumerate(task.schemes):
            for e, reader in enumerate(task.readers):
                _dot(axes, len(labels), framewise[s, e], key, reader, across=True)
                labels.append(f"{key.partition('/')[0]} {reader}, 16")
        for t, key in enumerate(task.trackers):
            _dot(axes, len(labels), tracked[t], key, across=True)
            labels.append(", ".join(key.split("/")))
        axes.set_yticks(range(len(labels)), labels if axes is grid[0] else [""] * len(labels))
        axes.set(title=f"{NAMES[world]}, {task.decibels:g} dB", xlabel="mean error / mm", xscale="log", xlim=(0.8, 60))
        axes.invert_yaxis()
        axes.set_xticks([1, 2, 5, 10, 20, 50])
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid()
    ((_, task, result),) = done.of("moving", "discs")
    axes = grid[-1]
    draw_sheet(axes)
    axes.plot(*(1e3 * result["truth"][0].T), color="0.3", linewidth=1, label="path")
    places = 1e3 * result["framewise"][task.schemes.index("16I"), task.readers.index("fit"), 0]
    axes.plot(*places.T, ".", color=COLOURS["16I"], markersize=2.5, label="16I, fit")
    followed = 1e3 * result["tracked"][task.trackers.index("16T/4"), 0]
    axes.plot(*followed.T, color=COLOURS["16T"], linewidth=0.9, label="16T, 4")
    axes.set_title("a path", pad=16)
    above = {"loc": "upper center", "bbox_to_anchor": (0.5, 1.13), "ncols": 3, "frameon": False}
    axes.legend(handlelength=1, columnspacing=0.8, **above)
    caption = (
        f"A contact that moves at 0 to 3 mm per frame on winding paths, one path and noise for each of {task.seeds} "
        f"seeds, {task.frames} frames (the first {SETTLE} do not count). Left: mean error with 95 % bootstrap "
        "intervals, frame by frame (centroid and fit) and tracked (16T and fixed rounds), each with its injections a "
        "frame. Right: the first path, discs."
    )
    return [("moving", canvas, caption)]


def pairs(done: Done) -> list[Drawn]:
    """Success against distance."""
    groups = list(goals.pair_groups(done))
    columns, rows = (list(dict.fromkeys(name.split("/")[part] for name, *_ in groups)) for part in (0, 1))
    sizes, labels = (len(rows), len(columns)), ("distance / mm", "distinguished / %")
    canvas, grid = panels(2.3 * len(rows) + 0.3, *sizes, *labels, sharex=True, sharey=True)
    for name, task, result, limits, power in groups:
        decibels, strength = name.split("/")
        axes, x = grid[rows.index(strength), columns.index(decibels)], 1e3 * np.array(task.distances)
        right = result["right"].astype(float)
        for s, key in enumerate(task.schemes):
            values, low, high = np.array([astuple(mean(rates)) for rates in 100 * right[s].mean(axis=1)]).T
            axes.plot(x, values, "o-", color=COLOURS[key], markersize=3, linewidth=1.3, label=key)
            axes.fill_between(x, low, high, color=COLOURS[key], alpha=0.18, linewidth=0)
            ideal = 100 * power[0, s].mean(axis=1)
            axes.plot(x, ideal, ":", color=COLOURS[key], linewidth=1.2, label=f"{key}, ideal test")
        any_choice = 100 * ideal_power(limits["any"]).mean(axis=1)
        axes.plot(x, any_choice, "-.", color="0.3", linewidth=0.9, label="ideal test, any 28")
        axes.axhline(75, color="0.6", linewidth=0.6)
        axes.set(title=f"+{100 * float(strength):g} %, {decibels} dB", ylim=(0, 103), xticks=x)
        axes.grid()
    grid[-1, -1].legend(*grid[0, -1].get_legend_handles_labels(), frameon=False, loc="lower right")
    caption = (
        f"Two discs of 6 mm radius, or one; ideal tests report {100 * ALPHA:g} % of single contacts as two. "
        f"{right.shape[3]} noise seeds at each of {right.shape[2]} places, drawn at random. Solid: contacts "
        "counted and placed by the fit; bands are 95 % bootstrap intervals over seeds. "
        "Dotted: the ideal test on the same injections, with all parameters of both hypotheses, and all contact "
        "impedances, known. Dash-dotted: an upper bound for it over every choice of 28 injections."
    )
    return [("pairs", canvas, caption)]


def detection(done: Done) -> list[Drawn]:
    """Share of new contacts found by frame."""
    worlds = list(dict.fromkeys(name.split("/")[0] for name in done.results["detection"]))
    canvas, (grid,) = panels(2.5, 1, len(worlds), "frames since it came", "new contacts found / %", sharey=True)
    frames, lines = np.arange(1, 16), ("-", "--", ":")
    for axes, world in zip(grid, worlds, strict=True):
        for _, task, result in done.of("detection", f"{world}/"):
            share = [100 * np.mean(result["frames"] <= k) for k in frames]
            style = {"where": "mid", "color": COLOURS["16T"], "linewidth": 1.3, "label": OTHERS[task.others]}
            axes.step(frames, share, lines[task.others % len(lines)], **style)
        axes.axvline(WITHIN, color="0.6", linewidth=0.6)
        axes.axhline(99, color="0.6", linewidth=0.6)
        axes.set(title=f"{NAMES[world]}, {task.decibels:g} dB", xticks=frames[::2])
        axes.grid()
    grid[0].legend(frameon=False, loc="lower right")
    caption = (
        f"How soon a new contact is found with {task.injections} injections per frame, while none, one or two others "
        f"are tracked; {task.trials} trials each, with places at least 10 mm from the rim and {1e3 * APART:.0f} mm "
        f"from each other, and noise of their own. Found is a contact reported within {1e3 * NEAR:.0f} mm. The lines "
        f"mark {WITHIN} frames and 99 %."
    )
    return [("detection", canvas, caption)]


def robust(done: Done) -> list[Drawn]:
    """Errors with a flawed model or skin."""
    table = goals.robust_errors(done)
    canvas, ((axes,),) = panels(2.9, 1, 1, y="mean error / mm")
    ways = list(next(iter(table.values())))
    for w, (key, reader) in enumerate(ways):
        for n, cells in enumerate(table.values()):
            label = f"{key}, {reader}" if n == 0 else None
            _dot(axes, n + 0.1 * (w - (len(ways) - 1) / 2), cells[key, reader], key, reader, label)
    names = [name.replace(" ", "\n", 1).replace(" since", "\nsince").replace(" and", "\nand") for name in table]
    axes.set_xticks(range(len(names)), names)
    axes.set(ylim=(0, None))
    axes.grid(axis="y")
    axes.legend(frameon=False, ncols=4, loc="upper center", bbox_to_anchor=(0.5, 1.2))
    caption = (
        "Contact-layer twin with a flawed model or a worn skin: mean error of static contacts, frame by frame, and of "
        f"moving ones, tracked with 4 injections (16T, and a fixed round). {done.settings.levels[-1]:g} dB; at least "
        f"{done.settings.seeds} seeds in all, random flaws drawn {done.settings.draws} times; 95 % bootstrap intervals "
        "over seeds and places."
    )
    return [("robust", canvas, caption)]


PAINTERS = {"static": static, "moving": moving, "pairs": pairs, "detection": detection, "robust": robust}
PAINTERS |= {"gain": gain_picture, "sensitivity": sensitivity_picture}


def _dot(
    axes: Axes, at: float, values: Floats, key: str, reader: str = "", label: str | None = None, across: bool = False
) -> None:
    """The mean of values in metres and its interval, in millimetres; see `mean`."""
    colour = COLOURS[key.partition("/")[0]]
    style = {"color": colour, "mfc": "white" if reader == "centroid" else colour, "markersize": 4.5, "label": label}
    draw_estimates(axes, [at], [mean(1e3 * values)], _MARKERS.get(reader, "P"), across, **style)
