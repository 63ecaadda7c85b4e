"""Figures 3, 4 and 6: images."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from ohmskin.evaluate.claims import Done
from ohmskin.evaluate.figures.drawing import SIDE, Drawn, draw_sheet
from ohmskin.evaluate.figures.style import NAMES, draw_note, draw_outline, draw_pixels, noise_text
from ohmskin.evaluate.methods import all_methods
from ohmskin.evaluate.plan import SEVERAL, SINGLE
from ohmskin.evaluate.shapes import SHAPES
from ohmskin.evaluate.statistics import median
from ohmskin.evaluate.worlds import WORLD_NAMES

_PANEL = 1.13  # inches


def single(done: Done) -> list[Drawn]:
    """Fig. 3: one touch at several places, one picture per world."""
    number = "median distance between the true place and the centroid of the image above half its maximum"
    return [
        _touches(done, "fig3", w, tuple(SINGLE), "Single touches at four places", number) for w in done.results["fig3"]
    ]


def several(done: Done) -> list[Drawn]:
    """Fig. 4: two, three and four touches, one picture per world."""
    names, number = (
        tuple(f"{name} touches" for name in SEVERAL),
        "share of noise seeds in which as many contacts are found",
    )
    return [_touches(done, "fig4", w, names, "Two, three and four touches", number) for w in done.results["fig4"]]


def _touches(done: Done, figure: str, world: str, names: Sequence[str], what: str, number: str) -> Drawn:
    ((_, task, result),) = done.of(figure, world)
    pixels = result["pixels"]
    rows, columns = pixels.shape[:2]
    limit = float(np.nanmax(np.abs(pixels)))
    canvas, grid = _grid(rows, columns, _PANEL)
    for c, contacts in enumerate(task.cases):
        for m, key in enumerate(task.methods):
            axes = grid[c, m]
            shown = draw_pixels(axes, pixels[c, m], limit)
            draw_sheet(axes, all_methods()[key].layout, m == 0, c == rows - 1)
            for contact in contacts:
                draw_outline(axes, contact)
            if c == 0:
                axes.set_title(NAMES[key])
            if len(contacts) == 1:
                away = np.linalg.norm(result["place"][c, m] - contacts[0].position, axis=1)
                draw_note(axes, f"{1e3 * median(away).value:.1f} mm")
            else:
                draw_note(axes, f"{100 * np.mean(result['count'][c, m] == len(contacts)):.0f} %")
        grid[c, 0].set_ylabel(f"{names[c]}\ny / mm", labelpad=1)
    canvas.colorbar(shown, ax=grid, label="relative change of conductivity", shrink=0.9, aspect=30, pad=0.01)
    caption = (
        f"{what} (rows), imaged by six drive methods (columns); data from the {WORLD_NAMES[world]}; "
        f"{noise_text(done.settings)}. Images of the first noise seed, one colour scale for all. Black outlines: true "
        f"contacts (radius {1e3 * task.cases[0][0].radius:.0f} mm); dots: electrodes. Numbers: {number}, {task.seeds} "
        "seeds."
    )
    return f"{figure}-{world}", canvas, caption


def shapes(done: Done) -> list[Drawn]:
    """Fig. 6: contact shapes."""
    ((_, task, result),) = done.of("fig6")
    pixels = result["pixels"]
    limit = float(np.nanmax(np.abs(pixels)))
    columns, rows = len(task.contacts), len(task.methods)
    canvas, grid = _grid(rows, columns, 1.3)
    centres = (np.arange(pixels.shape[-1]) + 0.5) * SIDE / pixels.shape[-1]
    dotted = {"colors": "black", "linewidths": 0.8, "linestyles": "dotted", "zorder": 4}
    for c, contact in enumerate(task.contacts):
        for m, key in enumerate(task.methods):
            axes, image = grid[m, c], pixels[c, m]
            shown = draw_pixels(axes, image, limit)
            axes.contour(centres, centres, image, levels=[float(np.nanmax(image)) / 2], **dotted)
            draw_outline(axes, contact)
            draw_sheet(axes, all_methods()[key].layout, c == 0, m == rows - 1)
            draw_note(axes, f"{median(result['overlap'][c, m]).value:.2f}")
            if c == 0:
                axes.set_ylabel(f"{NAMES[key]}\ny / mm", labelpad=1)
        grid[0, c].set_title(f"{SHAPES[c]} (best disc {result['blind'][c]:.2f})")
    canvas.colorbar(shown, ax=grid, label="relative change of conductivity", shrink=0.9, aspect=30, pad=0.01)
    first = task.contacts[0]
    caption = (
        f"Five contact shapes, {2e3 * first.radius:.0f} mm across, pressed with {first.strength / 1e3:.0f} kPa on the "
        f"contact-layer twin, imaged by adjacent (16I) and adaptive drive; {noise_text(done.settings)}. Images of the "
        "first noise seed, one colour scale for all. Solid: true edge; dotted: half maximum; dots: electrodes. "
        f"Numbers: intersection over union of the two outlines, median over {task.seeds} seeds; in the titles the same "
        "score of the best disc at the shape's centroid, which an imager blind to shape could reach."
    )
    return [("fig6", canvas, caption)]


def _grid(rows: int, columns: int, panel: float) -> tuple[Figure, Any]:
    """A figure of square panels, so many inches wide, with room for a colour bar."""
    layout = ConstrainedLayoutEngine(h_pad=0.02, w_pad=0.02, hspace=0.02, wspace=0.02)
    canvas = Figure(figsize=(panel * columns + 1.05, panel * rows + 0.5), layout=layout)
    return canvas, canvas.subplots(rows, columns, squeeze=False)
