"""Figures of merit of images on pixels, after Adler et al. 2009 ("GREIT"), fit for any domain and any number of
targets.

`figures_of_merit` is the modern definition. It works in the image's own coordinates, on pixel centres, without a mask
other than the domain itself. `eidors_figures` computes what EIDORS computes, which the paper used: see there what
differs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import DataError

_QUARTER = 0.25  # share of the largest value above which a pixel belongs to the target's image


@dataclass(frozen=True)
class Target:
    """The true contact of an image, at `position` (m), with a `strength` of relative change times area (m2)."""

    position: tuple[float, float]
    strength: float


@dataclass(frozen=True)
class Merit:
    """Figures of merit of one target's image q, the pixels at or above a quarter of the largest in the target's cell.

    Args:
        amplitude_response: AR, integral of the image over the cell, divided by the target's strength (1).
        position_error: PE as a vector, centroid of q minus the target's position (x, y) in metres.
        resolution: RES (the paper's SR), square root of q's area over the domain's (1).
        shape_deformation: SD, share of q outside the circle of q's area about q's centroid (0 to 1).
        ringing: RNG, integral of the negative values outside that circle over the integral inside it, positive (1).
        peak: Largest value.
        area: Area of q (m2).
    """

    amplitude_response: float
    position_error: tuple[float, float]
    resolution: float
    shape_deformation: float
    ringing: float
    peak: float
    area: float

    @property
    def distance(self) -> float:
        """Length of the position error (m)."""
        return float(np.hypot(*self.position_error))


def figures_of_merit(pixels: ArrayLike, x: ArrayLike, y: ArrayLike, targets: Sequence[Target]) -> list[Merit]:
    """Figures of merit of an image for each of its targets.

    Every pixel belongs to the cell of the target closest to its centre (pixels equally close to several count to the
    first); with one target the cell is the whole domain, and the definitions are those of Adler et al. 2009, section 3.

    Args:
        pixels: (ny, nx) image, conductivity raised by contacts being positive; NaN off the domain.
        x: (nx,) pixel centres in metres, evenly spaced, in either direction.
        y: (ny,) pixel centres in metres, likewise.
        targets: The true contacts.

    Raises:
        DataError: If shapes do not fit, pixels are infinite or not evenly spaced, there is no target, one has no place
            or no strength, or a target's cell has no positive pixel.
    """
    image, x, y = np.asarray(pixels, float), np.asarray(x, float), np.asarray(y, float)
    if image.shape != (len(y), len(x)) or min(image.shape) < 2:
        text = f"the image has shape {image.shape}; its {len(y)} x {len(x)} pixel centres"
        raise DataError(f"{text} need that shape, 2 x 2 or more")
    if not targets:
        raise DataError("no target to compare the image with; give at least one")
    for target in targets:
        if not np.isfinite([*target.position, target.strength]).all() or target.strength == 0:
            raise DataError(f"{target}: place and strength must be finite, and the strength not 0")
    if np.isinf(image).any():
        raise DataError("the image has infinite pixels; those off the domain are NaN")
    pixel = _spacing(x) * _spacing(y)
    inside = np.isfinite(image)
    px, py = (grid[inside] for grid in np.meshgrid(x, y))
    values = image[inside]
    centres = np.array([target.position for target in targets])
    owner = np.argmin((px[:, None] - centres[:, 0]) ** 2 + (py[:, None] - centres[:, 1]) ** 2, axis=1)
    cells = ((target, owner == number) for number, target in enumerate(targets))
    return [_merit(values[own], px[own], py[own], target, pixel, len(values)) for target, own in cells]


def _spacing(centres: Floats) -> float:
    """Distance of evenly spaced pixel centres (m)."""
    steps = np.diff(centres)
    if not (steps[0] and np.abs(steps / steps[0] - 1).max() < 1e-3):
        raise DataError(f"pixel centres from {centres[0]:g} to {centres[-1]:g} m are not evenly spaced")
    return float(abs(steps.mean()))


def _merit(values: Floats, x: Floats, y: Floats, target: Target, pixel: float, in_domain: int) -> Merit:
    peak = float(values.max(initial=-np.inf))
    if not peak > 0:
        where = f"about the target at {target.position}"
        raise DataError(f"nothing positive in the image {where}; there is no figure of merit")
    q = values >= _QUARTER * peak
    count = int(q.sum())
    cx, cy = float(x[q].mean()), float(y[q].mean())
    circle = (x - cx) ** 2 + (y - cy) ** 2 <= count * pixel / np.pi
    within = float(values[circle].sum())
    return Merit(
        amplitude_response=float(values.sum()) * pixel / target.strength,
        position_error=(cx - target.position[0], cy - target.position[1]),
        resolution=float(np.sqrt(count / in_domain)),
        shape_deformation=float(np.mean(~circle[q])),
        ringing=float(-values[~circle & (values < 0)].sum() / within) if within > 0 else np.inf,
        peak=peak,
        area=count * pixel,
    )


@dataclass(frozen=True)
class EidorsMerit:
    """What EIDORS' ``eval_GREIT_fig_merit`` returns, in its own units.

    Args:
        amplitude_response: AR.
        position_error: PE.
        resolution: RES.
        shape_deformation: SD.
        ringing: RNG.
        region_amplitude_response: AR in q.
    """

    amplitude_response: float
    position_error: float
    resolution: float
    shape_deformation: float
    ringing: float
    region_amplitude_response: float


def eidors_figures(
    pixels: ArrayLike, target: tuple[float, float], bounds: tuple[float, float, float, float] = (-1.0, -1.0, 1.0, 1.0)
) -> EidorsMerit:
    """The figures of merit exactly as EIDORS 3.11 computes them, for comparison with published tables.

    AR is the plain sum of all pixels, and of those of q. PE is a difference of two distances from the mesh's origin,
    wherever that is in the mesh, so that it has a sign and does not depend on tangential errors. Pixels are taken to
    lie on a lattice that spans the domain from edge to edge. The search for q excludes pixels outside a circle of
    squared radius 1.1, 17.3 % of a square of 64 x 64 pixels. RNG counts the negative pixels outside q, against the sum
    over q.

    Args:
        pixels: (n, n) image; NaN off the domain.
        target: Position in the coordinates of the mesh.
        bounds: Least x and y, then largest x and y, of the mesh; unless given, -1 to 1 from edge to edge of the sheet.

    Raises:
        DataError: If the image is not square (EIDORS confuses x and y of oblong ones) or has nothing positive, or the
            bounds are none.
    """
    image = np.asarray(pixels, float)
    if image.ndim != 2 or image.shape[0] != image.shape[1] or len(image) < 2:
        raise DataError(f"the image has shape {image.shape}; the figures of EIDORS are defined for square ones only")
    x0, y0, x1, y1 = bounds
    if not (np.isfinite(bounds).all() and x0 < x1 and y0 < y1):
        raise DataError(f"bounds {tuple(bounds)} of the mesh; give least x and y, then largest x and y")
    domain = np.isfinite(image)
    image = np.where(domain, image, 0.0)
    x, y = np.meshgrid(*[np.linspace(-1, 1, len(image))] * 2)
    search = x**2 + y**2 < 1.1
    largest = float(image[search].max())
    if not largest > 0:
        raise DataError("nothing positive in the image; there is no figure of merit")
    q = search & (image >= _QUARTER * largest) & domain
    count = int(q.sum())
    x, y = x0 + (x1 - x0) * (x + 1) / 2, y0 + (y1 - y0) * (y + 1) / 2
    cx, cy = x[q].mean(), y[q].mean()
    circle = (x - cx) ** 2 + (y - cy) ** 2 < (x1 - x0) * (y1 - y0) / image.size * count / np.pi
    return EidorsMerit(
        amplitude_response=float(image.sum()),
        position_error=float(np.hypot(*target) - np.hypot(cx, cy)),
        resolution=float(np.sqrt(count / domain.sum())),
        shape_deformation=float((q & ~circle).sum() / count),
        ringing=float(-image[(image < 0) & ~q].sum() / image[q].sum()),
        region_amplitude_response=float(image[q].sum()),
    )
