"""Figures 5 and 8 and the picture of Table I: curves and dots."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ohmskin.evaluate import paper
from ohmskin.evaluate.claims import DECIDED_BY, Done
from ohmskin.evaluate.experiments.discrimination import RADIUS
from ohmskin.evaluate.experiments.touches import COLUMNS
from ohmskin.evaluate.figures.drawing import SIDE, Drawn
from ohmskin.evaluate.figures.style import COLOURS, MARKERS, NAMES, draw_band, draw_medians, noise_text
from ohmskin.evaluate.resolution import ALPHA, HALF, limits
from ohmskin.evaluate.worlds import WORLD_NAMES, WORLDS


def sections(done: Done) -> list[Drawn]:
    """Fig. 5: profiles, their peaks and widths."""
    results = done.results["fig5"]
    canvas = Figure(figsize=(7.4, 2.3 * len(results)), layout="constrained")
    grid = canvas.subplots(len(results), 3, squeeze=False, width_ratios=[2.1, 1, 1])
    for (world, task, result), (profiles, peaks, widths) in zip(done.of("fig5"), grid, strict=True):
        centre, radius = 1e3 * task.contact.position[0], 1e3 * task.contact.radius
        profiles.axvspan(centre - radius, centre + radius, color="0.9", linewidth=0)
        profiles.axhline(0, color="0.5", linewidth=0.5)
        for m, key in enumerate(task.methods):
            draw_band(profiles, 1e3 * result["x"], result["profile"][m], key)
        profiles.set(xlabel="x / mm", ylabel="relative change of conductivity")
        profiles.set(xlim=(0, SIDE), title=WORLD_NAMES[world])
        draw_medians(peaks, result["peak"], task.methods)
        draw_medians(widths, result["width"], task.methods, 1e3)
        widths.axvline(2 * radius, color="0.4", linewidth=0.8, linestyle="--")
        peaks.set(xlabel="peak", xlim=(0, None))
        widths.set(xlabel="full width at half maximum / mm", xlim=(0, None), yticklabels=[])
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
    results = done.results["table1"]
    shown = (("AR", 1.0, "AR"), ("PE", 1e3, "|PE| / mm"), ("RES", 1.0, "SR"), ("SD", 1.0, "SD"), ("RNG", 1.0, "RNG"))
    canvas = Figure(figsize=(7.4, 1.75 * len(results)), layout="constrained")
    grid = canvas.subplots(len(results), len(shown), squeeze=False, sharey=True)
    for (world, task, result), row in zip(done.of("table1"), grid, strict=True):
        for axes, (name, scale, label) in zip(row, shown, strict=True):
            draw_medians(axes, result["modern"][..., COLUMNS.index(name)], task.methods, scale)
            axes.set(xlabel=label, xlim=(0, None))
        row[0].set_title(WORLD_NAMES[world], loc="left")
    caption = (
        f"Figures of merit of the upper left touch (Table I), modern definition; {noise_text(done.settings)}. Medians "
        f"over {task.seeds} noise seeds with 95 % bootstrap intervals (some smaller than the mark). AR is 1 for a "
        "perfect image of a disc; on the twin it is relative to the contact's area. PE, SR, SD and RNG are better the "
        "smaller they are."
    )
    return [("table1", canvas, caption)]


def discrimination(done: Done) -> list[Drawn]:
    """Fig. 8: success rates over distance."""
    levels = list(dict.fromkeys((done.settings.noise[0], done.settings.fine_noise)))
    canvas = Figure(figsize=(7.4, 2.6 * len(WORLDS) + 0.3), layout="constrained")
    grid = canvas.subplots(len(WORLDS), len(levels), squeeze=False, sharex=True, sharey=True)
    lines: dict[str, Any] = dict(zip(DECIDED_BY, (":", "-"), strict=True))
    for world, row in zip(WORLDS, grid, strict=True):
        for level, axes in zip(levels, row, strict=True):
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
            axes.set_title(f"{WORLD_NAMES[world]}, {level:g} dB")
            axes.set(xlim=(0, 62), ylim=(-0.03, 1.03))
            axes.grid()
    for axes in grid[:, 0]:
        axes.set_ylabel("two contacts told apart (share)")
    for axes in grid[-1]:
        axes.set_xlabel("distance between the contacts / mm")
    handles = [Line2D([], [], color=COLOURS[k], marker=MARKERS[k], markersize=3, label=NAMES[k]) for k in task.methods]
    handles += [Line2D([], [], color="0.3", linestyle=lines[how], label=by) for how, by in DECIDED_BY.items()]
    theirs = "paper: 17 mm (16I), 12 mm (16O)"
    handles.append(Line2D([], [], color="0.3", linestyle="--", linewidth=0.8, label=theirs))
    canvas.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, columnspacing=1.2)
    caption = (
        f"Two contacts of radius {1e3 * RADIUS:.0f} mm at falling distances, in {len(areas)} areas, {task.seeds} noise "
        "seeds each: share of trials in which they are told apart, by the dip between two peaks of the image (dotted) "
        f"and by a test of two fitted contacts against one (solid; at most {100 * ALPHA:.0f} % of single contacts "
        "taken for two). Either must put each contact closer to its true place than half the distance. Grey line: half "
        f"of the trials. Prior amplitude s = {task.amplitude:g}."
    )
    return [("fig8", canvas, caption)]
