"""Draws all pictures into a folder."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ohmskin.evaluate.figures import curves, images, places, sweeps
from ohmskin.evaluate.figures.style import RC
from ohmskin.evaluate.reproduction import Reproduction

_DPI = 200
Drawn = list[tuple[str, Figure, str]]  # file name, figure, caption

PAINTERS: dict[str, Callable[[Reproduction], Drawn]] = {
    "fig3": images.single,
    "fig4": images.several,
    "fig5": curves.sections,
    "table1": curves.merits,
    "fig6": images.shapes,
    "fig7": places.localisation,
    "fig8": curves.discrimination,
    "sweep": sweeps.sweep,
}


@dataclass(frozen=True)
class Picture:
    """A picture and the caption that makes it stand alone."""

    name: str
    path: Path
    caption: str


def draw(done: Reproduction, folder: Path) -> dict[str, list[Picture]]:
    """Draw all figures whose results are there into a folder; the pictures of each figure."""
    found: dict[str, list[Picture]] = {}
    with rc_context(RC):
        for figure in done.results:
            found[figure] = []
            for name, canvas, caption in PAINTERS[figure](done):
                path = folder / f"{name}.png"
                FigureCanvasAgg(canvas)
                canvas.savefig(path, dpi=_DPI)
                found[figure].append(Picture(name, path, caption))
    return found
