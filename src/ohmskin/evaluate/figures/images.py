"""Figures 3, 4 and 6: images."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Circle

from ohmskin.arrays import Floats
from ohmskin.evaluate.claims import Done
from ohmskin.evaluate.figures.drawing import NAMES, SIDE, Drawn, draw_sheet, noise_text
from ohmskin.evaluate.methods import all_methods
from ohmskin.evaluate.plan import SEVERAL, SINGLE
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.shapes import SHAPES, Shape
from ohmskin.evaluate.statistics import median
from ohmskin.evaluate.worlds import WORLD_NAMES, Contacts
from ohmskin.plot.colours import SIGNED

_NOTE: Any = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.0}


def single(done: Done) -> list[Drawn]:
    """Fig. 3: one touch at several places, one picture per world."""
    number = "median distance between the true place and the centroid of the image above half its maximum"
    return _touches(done, "fig3", tuple(SINGLE), "Single touches at four places", number)


def several(done: Done) -> list[Drawn]:
    """Fig. 4: two, three and four touches, one picture per world."""
    names, number = [f"{name} touches" for name in SEVERAL], "share of noise seeds in which as many contacts are found"
    return _touches(done, "fig4", names, "Two, three and four touches", number)


def _touches(done: Done, figure: str, names: Sequence[str], what: str, number: str) -> list[Drawn]:
    pictures = []
    for world, task, result in done.of(figure):
        cells = [
            [(key, there, _note(result, there, c, m)) for m, key in enumerate(task.methods)]
            for c, there in enumerate(task.cases)
        ]
        canvas = _images(1.13, result["pixels"], cells, names, [NAMES[key] for key in task.methods])
        caption = (
            f"{what} (rows), imaged by six drive methods (columns); data from the {WORLD_NAMES[world]}; "
            f"{noise_text(done.settings)}. Images of the first noise seed, one colour scale for all. Black outlines: "
            f"true contacts (radius {1e3 * task.cases[0][0].radius:.0f} mm); dots: electrodes. Numbers: {number}, "
            f"{task.seeds} seeds."
        )
        pictures.append((f"{figure}-{world}", canvas, caption))
    return pictures


def _note(result: Result, contacts: Contacts, c: int, m: int) -> str:
    if len(contacts) == 1:
        away = np.linalg.norm(result["place"][c, m] - contacts[0].position, axis=1)
        return f"{1e3 * median(away).value:.1f} mm"
    return f"{100 * np.mean(result['count'][c, m] == len(contacts)):.0f} %"


def shapes(done: Done) -> list[Drawn]:
    """Fig. 6: contact shapes."""
    ((_, task, result),) = done.of("fig6")
    cells = [
        [(key, (there,), f"{median(result['overlap'][c, m]).value:.2f}") for c, there in enumerate(task.contacts)]
        for m, key in enumerate(task.methods)
    ]
    titles = [f"{kind} (best disc {blind:.2f})" for kind, blind in zip(SHAPES, result["blind"], strict=True)]
    pixels, names = result["pixels"].swapaxes(0, 1), [NAMES[key] for key in task.methods]
    canvas, first = _images(1.3, pixels, cells, names, titles, half=True), task.contacts[0]
    caption = (
        f"Five contact shapes, {2e3 * first.radius:.0f} mm across, pressed with {first.strength / 1e3:.0f} kPa on the "
        f"contact-layer twin, imaged by adjacent (16I) and adaptive drive; {noise_text(done.settings)}. Images of the "
        "first noise seed, one colour scale for all. Solid: true edge; dotted: half maximum; dots: electrodes. "
        f"Numbers: intersection over union of the two outlines, median over {task.seeds} seeds; in the titles the same "
        "score of the best disc at the shape's centroid, which an imager blind to shape could reach."
    )
    return [("fig6", canvas, caption)]


def _images(
    panel: float,
    pixels: Floats,
    cells: Sequence[Sequence[tuple[str, Contacts, str]]],
    names: Sequence[str],
    titles: Sequence[str],
    half: bool = False,
) -> Figure:
    """Images (n_rows, n_columns, ny, nx), one colour scale for all, in square panels so many inches wide.

    Args:
        cells: Method, true contacts and a number for the corner, by row and column.
        names, titles: Of the rows and columns.
        half: Whether to outline half of the maximum, too.
    """
    rows, columns = pixels.shape[:2]
    layout = ConstrainedLayoutEngine(h_pad=0.02, w_pad=0.02, hspace=0.02, wspace=0.02)
    canvas = Figure(figsize=(panel * columns + 1.05, panel * rows + 0.5), layout=layout)
    grid, limit = canvas.subplots(rows, columns, squeeze=False), float(np.nanmax(np.abs(pixels)))
    look: Any = {"origin": "lower", "extent": (0, SIDE, 0, SIDE), "cmap": SIGNED, "interpolation": "bilinear"}
    centres = (np.arange(pixels.shape[-1]) + 0.5) * SIDE / pixels.shape[-1]
    dotted = {"colors": "black", "linewidths": 0.8, "linestyles": "dotted", "zorder": 4}
    for (row, column), axes in np.ndenumerate(grid):
        image, (key, contacts, note) = pixels[row, column], cells[row][column]
        shown = axes.imshow(image, norm=TwoSlopeNorm(0, -limit, limit), **look)
        if half:
            axes.contour(centres, centres, image, levels=[float(np.nanmax(image)) / 2], **dotted)
        for contact in contacts:
            _outline(axes, contact)
        draw_sheet(axes, all_methods()[key].layout, column == 0, row == rows - 1)
        axes.text(0.96, 0.95, note, transform=axes.transAxes, ha="right", va="top", fontsize=6.5, bbox=_NOTE, zorder=5)
        if row == 0:
            axes.set_title(titles[column])
        if column == 0:
            axes.set_ylabel(f"{names[row]}\ny / mm", labelpad=1)
    canvas.colorbar(shown, ax=grid, label="relative change of conductivity", shrink=0.9, aspect=30, pad=0.01)
    return canvas


def _outline(axes: Axes, contact: Shape) -> None:
    """The true edge of a contact."""
    if contact.kind == "disc":
        centre = (1e3 * contact.position[0], 1e3 * contact.position[1])
        axes.add_patch(Circle(centre, 1e3 * contact.radius, fill=False, color="black", linewidth=0.8, zorder=4))
        return
    fine = (np.arange(400) + 0.5) * SIDE / 400
    away = contact.distance(1e-3 * np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)).reshape(400, 400)
    axes.contour(fine, fine, away, levels=[0.0], colors="black", linewidths=0.8, zorder=4)
