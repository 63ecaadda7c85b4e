"""Figures 3, 4 and 6: images."""

from collections.abc import Sequence
from typing import cast

import numpy as np
from matplotlib.figure import Figure

from ohmskin.evaluate.experiments import PressedShapes, Touches
from ohmskin.evaluate.figures.style import (
    NAMES,
    SIDE,
    WORLD_NAMES,
    draw_note,
    draw_outline,
    draw_pixels,
    draw_sheet,
    noise_text,
)
from ohmskin.evaluate.plan import SEVERAL, SINGLE
from ohmskin.evaluate.reproduction import Reproduction
from ohmskin.evaluate.shapes import SHAPES
from ohmskin.evaluate.statistics import median

_PANEL = 1.13  # inches


def single(done: Reproduction) -> list[tuple[str, Figure, str]]:
    """Fig. 3: one touch at several places, one picture per world."""
    return [
        _touches(
            done,
            "fig3",
            world,
            tuple(SINGLE),
            "Single touches at four places (rows)",
            "median distance between the true place and the centroid of the image above half its maximum",
        )
        for world in done.results["fig3"]
    ]


def several(done: Reproduction) -> list[tuple[str, Figure, str]]:
    """Fig. 4: two, three and four touches, one picture per world."""
    return [
        _touches(
            done,
            "fig4",
            world,
            tuple(f"{name} touches" for name in SEVERAL),
            "Two, three and four touches (rows)",
            "share of noise seeds in which exactly as many contacts are found as there are",
        )
        for world in done.results["fig4"]
    ]


def _touches(done: Reproduction, figure: str, world: str, names: Sequence[str], what: str, number: str) -> tuple[str, Figure, str]:
    result, task = done.results[figure][world], cast(Touches, done.experiments[figure][world])
    pixels = result["pixels"]
    rows, columns = pixels.shape[:2]
    limit = float(np.nanmax(np.abs(pixels)))
    canvas = Figure(figsize=(_PANEL * columns + 1.05, _PANEL * rows + 0.5), layout="constrained")
    canvas.get_layout_engine().set(h_pad=0.02, w_pad=0.02, hspace=0.02, wspace=0.02)  # type: ignore[union-attr, call-arg]
    grid = canvas.subplots(rows, columns, squeeze=False)
    for c, contacts in enumerate(task.cases):
        for m, key in enumerate(task.methods):
            axes = grid[c, m]
            shown = draw_pixels(axes, pixels[c, m], limit)
            draw_sheet(axes, key, m == 0, c == rows - 1)
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
        f"{what}, imaged by six drive methods (columns); data from the {WORLD_NAMES[world]}; {noise_text(done)}. "
        f"Images of the first "
        f"noise seed, one colour scale for all. Black outlines: true contacts (radius "
        f"{1e3 * task.cases[0][0].radius:.0f} mm); dots: "
        f"electrodes. Numbers: {number}, {task.seeds} seeds."
    )
    return f"{figure}-{world}", canvas, caption


def shapes(done: Reproduction) -> list[tuple[str, Figure, str]]:
    """Fig. 6: contact shapes."""
    result, task = done.results["fig6"]["pressed"], cast(PressedShapes, done.experiments["fig6"]["pressed"])
    pixels = result["pixels"]
    limit = float(np.nanmax(np.abs(pixels)))
    columns, rows = len(task.contacts), len(task.methods)
    canvas = Figure(figsize=(1.3 * columns + 1.05, 1.3 * rows + 0.5), layout="constrained")
    canvas.get_layout_engine().set(h_pad=0.02, w_pad=0.02, hspace=0.02, wspace=0.02)  # type: ignore[union-attr, call-arg]
    grid = canvas.subplots(rows, columns, squeeze=False)
    centres = (np.arange(pixels.shape[-1]) + 0.5) * SIDE / pixels.shape[-1]
    for c, contact in enumerate(task.contacts):
        for m, key in enumerate(task.methods):
            axes, image = grid[m, c], pixels[c, m]
            shown = draw_pixels(axes, image, limit)
            half = [float(np.nanmax(image)) / 2]
            axes.contour(centres, centres, image, levels=half, colors="black", linewidths=0.8, linestyles="dotted", zorder=4)
            draw_outline(axes, contact)
            draw_sheet(axes, key, c == 0, m == rows - 1)
            draw_note(axes, f"{median(result['overlap'][c, m]).value:.2f}")
            if c == 0:
                axes.set_ylabel(f"{NAMES[key]}\ny / mm", labelpad=1)
        grid[0, c].set_title(f"{SHAPES[c]} (best disc {result['blind'][c]:.2f})")
    canvas.colorbar(shown, ax=grid, label="relative change of conductivity", shrink=0.9, aspect=30, pad=0.01)
    caption = (
        f"Five contact shapes, {2e3 * task.contacts[0].radius:.0f} mm across, pressed with "
        f"{task.contacts[0].strength / 1e3:.0f} kPa on the "
        f"contact-layer twin, imaged by adjacent (16I) and adaptive drive; {noise_text(done)}. Images of the first "
        f"noise seed, one colour "
        "scale for all. Solid: true edge; dotted: half maximum; dots: electrodes. Numbers: intersection over union "
        "of the two outlines, "
        f"median over {task.seeds} seeds; in the titles the same score of the best disc at the shape's centroid, "
        f"which an imager blind to "
        "shape could reach."
    )
    return [("fig6", canvas, caption)]
