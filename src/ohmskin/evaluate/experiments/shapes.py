"""Figure 6: contacts of several shapes, pressed on the contact-layer twin."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ohmskin.evaluate.methods import PIXELS, bench
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.shapes import Shape
from ohmskin.geometry import Raster

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class PressedShapes:
    """Images of one contact each of several shapes."""

    decibels: float
    amplitude: float
    seeds: int
    contacts: tuple[Shape, ...]
    methods: tuple[str, ...] = ("16I", "16O", "16O+")

    def run(self) -> Result:
        """Results: ``pixels`` (n_contacts, n_methods, ny, nx) of the first seed; ``truth`` (n_contacts, ny, nx), whether a
        pixel's centre is in the shape; ``overlap`` (n_contacts, n_methods, n_seeds), intersection over union of the shape
        and the pixels above half of the largest; ``blind`` (n_contacts,), the score
        of the best disc at the shape's centroid, which an imager blind to shape could reach.
        """
        table = bench("pressed", self.decibels, self.amplitude)
        shape = (len(self.contacts), len(self.methods))
        pixels, overlap = np.empty((*shape, PIXELS, PIXELS)), np.empty((*shape, self.seeds))
        truth, blind = np.empty((len(self.contacts), PIXELS, PIXELS), bool), np.empty(len(self.contacts))
        for c, contact in enumerate(self.contacts):
            for m, key in enumerate(self.methods):
                for seed in range(self.seeds):
                    view = table.see(key, (contact,), seed)
                    if m == 0 and seed == 0:
                        truth[c], blind[c] = mask(contact, view.raster), blind_overlap(contact, view.raster)
                    if seed == 0:
                        pixels[c, m] = view.pixels
                    overlap[c, m, seed] = intersection_over_union(view.pixels >= np.nanmax(view.pixels) / 2, truth[c])
        return {"pixels": pixels, "truth": truth, "overlap": overlap, "blind": blind}


def mask(contact: Shape, raster: Raster) -> Mask:
    """Which pixels (ny, nx) have their centre in the shape."""
    centres = np.stack(np.meshgrid(raster.x, raster.y), axis=-1)
    inside: Mask = contact.distance(centres.reshape(-1, 2)).reshape(centres.shape[:2]) <= 0
    return inside


def blind_overlap(contact: Shape, raster: Raster) -> float:
    """The best score of a disc, over all radii, at the centroid of the shape: what an imager blind to shape could reach."""
    inside = mask(contact, raster)
    x, y = np.meshgrid(raster.x, raster.y)
    away = np.hypot(x - x[inside].mean(), y - y[inside].mean())
    return max(intersection_over_union(away <= radius, inside) for radius in np.unique(away[away < 2 * contact.radius]))


def intersection_over_union(a: Mask, b: Mask) -> float:
    """Pixels in both over pixels in either (0 to 1)."""
    return float((a & b).sum() / (a | b).sum())
