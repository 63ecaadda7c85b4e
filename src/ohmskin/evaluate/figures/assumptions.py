"""Table I, Fig. 7 and Fig. 8 under each assumption, as one picture."""

from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from ohmskin.evaluate import paper
from ohmskin.evaluate.assumed import MERITS, assumed
from ohmskin.evaluate.claims import ADAPTIVE, Done
from ohmskin.evaluate.figures.curves import COLOURS, MARKERS
from ohmskin.evaluate.figures.drawing import Drawn, panels
from ohmskin.evaluate.verdict import NO, OPEN, YES
from ohmskin.evaluate.worlds import WORLD_NAMES, WORLDS

_SHADES = {NO: "#e9e4e1", OPEN: "#9cc4b2", YES: "#2f7d5b"}
_FAR = 70.0  # mm; where a contact that was never told apart is drawn


def assumptions(done: Done) -> list[Drawn]:
    """Orders of Table I, ratio of Fig. 7 and distances of Fig. 8, a row for each assumption."""
    found = assumed(done)
    names = list(dict.fromkeys(one.name for one in found))
    rows = {name: row for row, name in enumerate(names)}
    canvas, grid = panels(1.0 + 0.21 * len(names) * len(WORLDS), len(WORLDS), 3, width_ratios=[1, 1.2, 1], sharey=True)
    for world, (orders, gain, apart) in zip(WORLDS, grid, strict=True):
        mine = [one for one in found if one.world == world]
        cells = np.full((len(names), len(MERITS) * len(ADAPTIVE)), np.nan)
        for one in mine:
            first = len(MERITS) * ADAPTIVE.index(one.best)
            cells[rows[one.name], first : first + len(MERITS)] = [list(_SHADES).index(v) for v in one.orders.values()]
            style: Any = {"color": COLOURS[one.best], "markersize": 4, "linewidth": 1, "capsize": 2}
            at = rows[one.name] + 0.5 + (0.14 if one.best == ADAPTIVE[1] else -0.14)
            ratio = one.ratio
            bars = [[ratio.value - ratio.low], [ratio.high - ratio.value]]
            gain.errorbar(ratio.value, at, xerr=bars, fmt=MARKERS[one.best], **style)
            for key, distance in zip(("16I", one.best), one.distances, strict=True):
                marked: Any = {"color": COLOURS[key], "markersize": 4, "clip_on": False}
                apart.plot(
                    min(1e3 * distance, _FAR), at if key != "16I" else rows[one.name] + 0.5, MARKERS[key], **marked
                )
        orders.pcolormesh(cells, cmap=ListedColormap(list(_SHADES.values())), vmin=0, vmax=2, edgecolors="white")
        ticks = [f"{key}\n{best.removeprefix('16O').strip()}" for best in ADAPTIVE for key in MERITS]
        orders.set(xticks=np.arange(len(ticks)) + 0.5, yticks=np.arange(len(names)) + 0.5)
        orders.set_xticklabels(ticks, fontsize=5.5)
        orders.set_yticklabels(
            [one.title for one in mine if one.best == ADAPTIVE[0]]
            if len(mine) == 2 * len(names)
            else [next(o.title for o in found if o.name == name) for name in names]
        )
        orders.set(ylim=(len(names), 0), title=WORLD_NAMES[world])
        orders.tick_params(length=0)
        gain.axvline(paper.RATIO, color="0.4", linewidth=0.8, linestyle="--")
        gain.axvline(1, color="0.6", linewidth=0.5)
        gain.set(xlabel="error of 16I over error of 16O", xscale="log", xticks=[0.5, 1, paper.RATIO, 2], xlim=(0.4, 3))
        gain.set_xticklabels(["0.5", "1", f"{paper.RATIO:.2f}", "2"])
        gain.minorticks_off()
        for key, distance in paper.DISCRIMINATION.items():
            apart.axvline(1e3 * distance, color=COLOURS[key], linewidth=0.8, linestyle="--")
        apart.set(xlabel="two contacts distinguished from / mm", xlim=(0, _FAR), xticks=[12, 17, 30, 40, 50, 60, _FAR])
        apart.set_xticklabels(["12", "17", "30", "40", "50", "60", "no"])
        for axes in (gain, apart):
            axes.grid()
    handles = [Patch(color=shade, label=f"order {verdict}") for verdict, shade in _SHADES.items()]
    handles += [
        gain.plot([], [], MARKERS[key], color=COLOURS[key], markersize=4, label=key)[0] for key in ("16I", *ADAPTIVE)
    ]
    canvas.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    seeds = max(done.settings.seeds // 4, 2)
    caption = (
        "One assumption at a time is other than in the figures. Left: whether the medians of a figure of merit improve "
        f"from 12B over 16B and 16I to 16O (or to 16O fused), {10 * seeds} noise seeds. Middle: how many times smaller "
        f"the localisation error of adaptive drive is, with 95 % bootstrap intervals over {seeds} noise seeds, at the "
        "noise at which the mean error of adjacent drive is the paper's 13.0 mm (dashed: the paper's ratio). Right: "
        f"from which distance on the dip distinguishes two contacts, at {done.settings.fine_noise:g} dB (dashed: the "
        "paper's)."
    )
    return [("assumptions", canvas, caption)]
