"""A conductivity image, drawn with its scale, electrodes and contacts."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.contacts import Contact
from ohmskin.errors import DataError
from ohmskin.geometry import Domain, Electrodes, Mesh, Raster
from ohmskin.inverse import Image
from ohmskin.plot.colours import SIGNED
from ohmskin.sensing import Percept

FORMATS = frozenset(FigureCanvasBase.filetypes)
"""Endings of the files that pictures can be saved to, without the dot."""

PIXELS = 256
_JUMP = 0.1  # of a rim's length, between places of a line that does not cross a seam
_PALE = 20.0  # standard deviations of noise that full colour is, where there is no contact


def draw_image(
    axes: Axes,
    mesh: Mesh,
    values: ArrayLike,
    electrodes: Electrodes,
    contacts: Sequence[Contact] = (),
    limit: float | None = None,
    labels: ArrayLike | None = None,
) -> AxesImage:
    """Draw an image (n_elem,) with electrodes (numbered from 0) and contacts; axes in millimetres.

    Args:
        axes: Where to draw.
        mesh: Mesh of the image.
        values: Image, in any unit.
        electrodes: Electrode layout.
        contacts: Contacts, drawn as circles of their extent.
        limit: Value of full colour; the largest magnitude of the image unless given.
        labels: Classes (n_elem,) to outline: higher conductivity (1) with a solid line, lower (-1) with a dashed one.

    Returns: The drawing, for a colour bar.
    """
    raster = Raster(mesh, PIXELS)
    pixels = raster(values)
    full = limit or float(np.nanmax(np.abs(pixels))) or 1.0
    half = raster.pitch / 2
    x, y = raster.x, raster.y
    edges = tuple(1e3 * edge for edge in (x[0] - half, x[-1] + half, y[0] - half, y[-1] + half))
    shown = axes.imshow(pixels, origin="lower", extent=edges, cmap=SIGNED, vmin=-full, vmax=full, interpolation="none")
    for sign, line in ((1, "solid"), (-1, "dashed")) if labels is not None else ():
        if (own := np.asarray(labels) == sign).any():
            axes.contour(1e3 * x, 1e3 * y, raster(own), [0.5], colors="0.1", linewidths=1.4, linestyles=line)
    axes.plot(*1e3 * electrodes.positions.T, "o", color="0.15", markersize=4, clip_on=False)
    middle = 0.5e3 * (mesh.nodes.min(axis=0) + mesh.nodes.max(axis=0))
    size = 1e3 * float(np.ptp(mesh.nodes, axis=0).max())
    for number, place in enumerate(1e3 * electrodes.positions):
        away = place - middle
        place = place + away / max(float(np.linalg.norm(away)), 1e-9) * 0.045 * size
        told = axes.annotate(str(number), place, ha="center", va="center", fontsize=7, annotation_clip=False)
        told.set_path_effects([withStroke(linewidth=1.6, foreground="white", alpha=0.8)])  # read over a contact, too
    for contact in contacts:
        centre = (1e3 * contact.position[0], 1e3 * contact.position[1])
        axes.add_patch(Circle(centre, 1e3 * np.sqrt(contact.extent / np.pi), fill=False, color="black", linewidth=1.2))
        axes.plot(*centre, "+", color="black", markersize=6)
    margin = 0.08 * size
    low, high = 1e3 * mesh.nodes.min(axis=0), 1e3 * mesh.nodes.max(axis=0)
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set(xlabel="x / mm", ylabel="y / mm")
    axes.set_aspect("equal")
    axes.spines[["top", "right"]].set_visible(False)
    return shown


def save_picture(
    path: str | Path,
    mesh: Mesh,
    values: ArrayLike,
    electrodes: Electrodes,
    contacts: Sequence[Contact] = (),
    title: str = "",
    limit: float | None = None,
    labels: ArrayLike | None = None,
) -> None:
    """Save an image of relative conductivity change (n_elem,) as a picture; the file's ending chooses the format.

    Args:
        path, title: The file, and what stands above the image.
        mesh, values, electrodes, contacts, limit, labels: As for `draw_image`.

    Raises:
        DataError: If the file cannot be written.
    """
    figure = Figure(figsize=(6.4, 5.2), layout="constrained")
    axes = figure.add_subplot()
    shown = draw_image(axes, mesh, values, electrodes, contacts, limit, labels)
    axes.set_title(title, fontsize=10, parse_math=False)
    figure.colorbar(shown, ax=axes, label="relative conductivity change", shrink=0.85)
    save_figure(figure, path)


def noise_of(image: Image) -> float:
    """Standard deviation of an image's noise, root mean square over its elements (1)."""
    return float(np.sqrt(np.mean(image.noise_std(np.arange(len(image.values))) ** 2)))


def full_scale(percept: Percept) -> float | None:
    """Value of full colour: the image's own with contacts (None), otherwise one at which noise stays pale."""
    return None if percept.detections else _PALE * noise_of(percept.image)


def save_figure(figure: Figure, path: str | Path, dpi: int = 150) -> None:
    """Save a figure; the file's ending chooses the format.

    Raises:
        DataError: If the file cannot be written.
    """
    try:
        figure.savefig(path, dpi=dpi)
    except (OSError, ValueError) as error:
        raise DataError(f"cannot write picture {path}: {error}") from error


def outline(domain: Domain) -> Floats:
    """The rims of a sheet, holes included, as one line (n, 2) in millimetres, broken by NaN between them."""
    lines = []
    for loop in (domain, *domain.holes):
        arcs = np.append(np.linspace(0, loop.perimeter, 400), loop.corners)
        line = loop.rim(np.unique(arcs))
        line[1:][np.linalg.norm(np.diff(line, axis=0), axis=1) > _JUMP * loop.perimeter] = np.nan  # across a seam
        lines += [line, np.full((1, 2), np.nan)]
    return 1e3 * np.vstack(lines)
