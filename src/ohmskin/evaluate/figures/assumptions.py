"""Table I, Fig. 7 and Fig. 8 under each assumption, as one picture."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from ohmskin.evaluate import paper
from ohmskin.evaluate.assumed import MERITS, Assumed, assumed
from ohmskin.evaluate.claims import ADAPTIVE, Done
from ohmskin.evaluate.figures.curves import COLOURS, MARKERS
from ohmskin.evaluate.figures.drawing import Drawn, draw_estimates, panels
from ohmskin.evaluate.worlds import WORLD_NAMES, WORLDS

_SHADES = ("#e9e4e1", "#b9d3c6", "#74a98f", "#2f7d5b")  # for none to three of the steps of Table I
_FAR = 70.0  # mm; where contacts that were never distinguished are drawn


def assumptions(done: Done) -> list[Drawn]:
    """Steps of Table I, ratio of Fig. 7 and distances of Fig. 8, a row for each assumption."""
    found = assumed(done)
    titles = list(dict.fromkeys(one.title for one in found))
    height = 1.1 + (0.5 + 0.19 * len(titles)) * len(WORLDS)
    canvas, grid = panels(height, len(WORLDS), 3, width_ratios=[1.1, 1, 1], sharey=True)
    for world, (steps, gain, apart) in zip(WORLDS, grid, strict=True):
        mine = [(titles.index(one.title) + 0.5, one) for one in found if one.world == world]
        _draw_steps(steps, mine, len(titles))
        steps.set(yticks=np.arange(len(titles)) + 0.5, ylim=(len(titles), 0), title=f"{WORLD_NAMES[world]}\n")
        steps.set_yticklabels(titles, fontsize=6.5)
        _draw_gain(gain, mine)
        _draw_distances(apart, mine)
        for axes in (gain, apart):
            axes.grid()
    handles = [Patch(color=shade, label=f"{count} of 3 steps") for count, shade in enumerate(_SHADES)]
    handles += [
        gain.plot([], [], MARKERS[key], color=COLOURS[key], markersize=4, label=key)[0] for key in ("16I", *ADAPTIVE)
    ]
    canvas.legend(handles=handles, loc="outside lower center", ncols=7, frameon=False, columnspacing=1)
    seeds = max(done.settings.seeds // 4, 2)
    caption = (
        "One assumption at a time is other than in the figures. Left: how many of the three steps of Table I (12B to "
        f"16B to 16I to 16O or 16O fused) are confirmed improvements of each figure of merit, {10 * seeds} noise "
        "seeds. Middle: how many times smaller the mean localisation error of adaptive drive is, with 95 % bootstrap "
        f"intervals over {seeds} noise seeds, at the noise at which the error of adjacent drive comes closest to the "
        "paper's 13.0 mm (dashed: the paper's ratio). Right: from which distance on the dip distinguishes two "
        f"contacts, at {done.settings.fine_noise:g} dB (dashed: the paper's)."
    )
    return [("assumptions", canvas, caption)]


def _draw_steps(axes: Axes, mine: list[tuple[float, Assumed]], rows: int) -> None:
    wide = len(MERITS)
    cells = np.full((rows, wide * len(ADAPTIVE)), np.nan)
    for at, one in mine:
        first = wide * ADAPTIVE.index(one.best)
        cells[int(at), first : first + wide] = list(one.steps.values())
    axes.pcolormesh(cells, cmap=ListedColormap(list(_SHADES)), vmin=-0.5, vmax=3.5, edgecolors="white", linewidth=1)
    axes.set(xticks=np.arange(cells.shape[1]) + 0.5)
    axes.set_xticklabels(MERITS * len(ADAPTIVE), fontsize=5.5)
    axes.tick_params(length=0)
    axes.axvline(wide, color="white", linewidth=4)
    for k, best in enumerate(ADAPTIVE):
        axes.text(wide * (k + 0.5), -0.15, best, ha="center", va="bottom", fontsize=7)


def _draw_gain(axes: Axes, mine: list[tuple[float, Assumed]]) -> None:
    for at, one in mine:
        shifted = at + (0.16 if one.best == ADAPTIVE[1] else -0.16)
        style = dict[str, Any](color=COLOURS[one.best], markersize=3.5)
        draw_estimates(axes, [shifted], [one.ratio], MARKERS[one.best], across=True, **style)
    axes.axvline(paper.RATIO, color="0.4", linewidth=0.8, linestyle="--")
    axes.axvline(1, color="0.6", linewidth=0.5)
    axes.set(xlabel="error, 16I over 16O", xscale="log", xticks=[0.5, 1, paper.RATIO, 2], xlim=(0.35, 3))
    axes.set_xticklabels(["0.5", "1", f"{paper.RATIO:.2f}", "2"])
    axes.minorticks_off()


def _draw_distances(axes: Axes, mine: list[tuple[float, Assumed]]) -> None:
    for at, one in mine:
        shift = 0.16 if one.best == ADAPTIVE[1] else -0.16
        for key, distance, up in zip(("16I", one.best), one.distances, (0.0, shift), strict=True):
            style = dict[str, Any](color=COLOURS[key], markersize=3.5, clip_on=False)
            axes.plot(min(1e3 * distance, _FAR), at + up, MARKERS[key], **style)
    for key, distance in paper.DISCRIMINATION.items():
        axes.axvline(1e3 * distance, color=COLOURS[key], linewidth=0.8, linestyle="--")
    axes.set(xlabel="two distinguished from / mm", xlim=(0, _FAR), xticks=[15, 30, 40, 50, 60, _FAR])
    axes.set_xticklabels(["12, 17", "30", "40", "50", "60", "no"])
