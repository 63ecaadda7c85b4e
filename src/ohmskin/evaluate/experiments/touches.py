"""Figures 3 to 6 and Table I: what images of touches show."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ohmskin.arrays import Floats
from ohmskin.contacts import Contact
from ohmskin.errors import DataError
from ohmskin.evaluate.merit import Target, eidors_figures, figures_of_merit
from ohmskin.evaluate.methods import METHODS, Bench
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.setup import View
from ohmskin.evaluate.shapes import Shape
from ohmskin.evaluate.worlds import Contacts
from ohmskin.geometry import Raster

COLUMNS = ("AR", "PE", "RES", "SD", "RNG", "peak", "localisation")
EIDORS_COLUMNS = ("AR", "PE", "RES", "SD", "RNG")
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Touches(Bench):
    """Images and contacts of several cases (figures 3 and 4).

    Args:
        seeds: Number of noise seeds; the images are those of the first.
        cases: The contacts of each case.
        methods: Which methods.
    """

    seeds: int
    cases: tuple[Contacts, ...]
    methods: tuple[str, ...] = METHODS

    def run(self) -> Result:
        """Results: ``pixels`` (n_cases, n_methods, ny, nx), relative change; ``count`` (n_cases, n_methods, n_seeds),
        contacts found; ``error`` (same), mean distance in metres between true contacts and the contacts found that are
        matched to them, NaN where fewer are found than exist; ``place`` (n_cases, n_methods, n_seeds, 2), see
        `View.place`.
        """

        def measure(view: View, contacts: Contacts) -> dict[str, Any]:
            error = matched_error(view.contacts, contacts)
            return {"pixels": view.pixels, "count": len(view.contacts), "error": error, "place": view.place}

        found = self.read(self.methods, self.cases, self.seeds, measure)
        found = {name: np.ascontiguousarray(array.swapaxes(0, 1)) for name, array in found.items()}
        return found | {"pixels": found["pixels"][:, :, 0]}


def matched_error(found: Sequence[Contact], contacts: Contacts) -> float:
    """Mean distance (m) of the best one-to-one match from true contacts to found ones; NaN if too few are found."""
    if len(found) < len(contacts):
        return float("nan")
    distance = np.array([[np.hypot(*np.subtract(f.position, c.position)) for f in found] for c in contacts])
    return float(distance[linear_sum_assignment(distance)].mean())


@dataclass(frozen=True)
class Sections(Bench):
    """Horizontal cross-sections through the centre of one contact, for each method and seed (figure 5).

    Args:
        seeds: Number of noise seeds.
        contact: The contact.
        methods: Which methods.
    """

    seeds: int
    contact: Shape
    methods: tuple[str, ...] = METHODS

    def run(self) -> Result:
        """Results: ``x`` (nx,) in metres; ``profile`` (n_methods, n_seeds, nx), relative change; ``peak`` and ``width``
        (n_methods, n_seeds), the profile's largest value and its width at half of that (m); ``at`` (same), where (m).
        """
        x = self.setup("grid").raster.x

        def cut(view: View, _: Contacts) -> dict[str, Any]:
            profile = np.array([np.interp(self.contact.position[1], view.raster.y, line) for line in view.pixels.T])
            peak, at, width = peak_and_width(x, profile)
            return {"profile": profile, "peak": peak, "at": at, "width": width}

        found = self.read(self.methods, [(self.contact,)], self.seeds, cut)
        return {"x": x} | {name: array[:, 0] for name, array in found.items()}


def peak_and_width(x: Floats, profile: Floats) -> tuple[float, float, float]:
    """The largest value of a profile (n,), its place, and the full width at half of it, linear between samples.

    Where the profile stays above half up to an end of `x`, that end counts.
    """
    top, ends = int(np.argmax(profile)), []
    half = profile[top] / 2
    for at, value in ((x[top::-1], profile[top::-1]), (x[top:], profile[top:])):  # to the left, to the right
        below = np.flatnonzero(value[1:] < half)
        if below.size:
            k = int(below[0])
            ends.append(at[k] + (at[k + 1] - at[k]) * (value[k] - half) / (value[k] - value[k + 1]))
        else:
            ends.append(at[-1])
    return float(profile[top]), float(x[top]), float(ends[1] - ends[0])


@dataclass(frozen=True)
class Merits(Bench):
    """Figures of merit of one contact, for each method and seed (Table I).

    Args:
        seeds: Number of noise seeds.
        contact: The contact.
        methods: Which methods.
    """

    seeds: int
    contact: Shape
    methods: tuple[str, ...] = METHODS

    def run(self) -> Result:
        """Results: ``modern`` (n_methods, n_seeds, 7), the `COLUMNS` (PE as a distance and localisation in metres);
        ``vector`` (n_methods, n_seeds, 2), PE as a vector (m); ``eidors`` (n_methods, n_seeds, 5), the
        `EIDORS_COLUMNS`. NaN where an image has nothing positive. AR is relative to the disc's change times area; for a
        pressed contact, which has no such value, to its area.
        """
        strength = self.contact.area * (self.contact.strength if self.world == "discs" else 1.0)
        target = Target(self.contact.position, strength)

        def judge(view: View, _: Contacts) -> dict[str, Any]:
            low, high = view.mesh.nodes.min(axis=0), view.mesh.nodes.max(axis=0)
            x, y = 2 * (np.array(self.contact.position) - low) / (high - low) - 1
            try:
                (found,) = figures_of_merit(view.pixels, view.raster.x, view.raster.y, [target])
                theirs = astuple(eidors_figures(view.pixels, (x, y)))[: len(EIDORS_COLUMNS)]
            except DataError:
                sizes = {"modern": len(COLUMNS), "vector": 2, "eidors": len(EIDORS_COLUMNS)}
                return {name: np.full(n, np.nan) for name, n in sizes.items()}
            shape = (found.resolution, found.shape_deformation, found.ringing, found.peak)
            away = np.linalg.norm(view.place - self.contact.position)
            modern = (found.amplitude_response, found.distance, *shape, away)
            return {"modern": modern, "vector": found.position_error, "eidors": theirs}

        found = self.read(self.methods, [(self.contact,)], self.seeds, judge)
        return {name: array[:, 0] for name, array in found.items()}


@dataclass(frozen=True)
class PressedShapes:
    """Images of one contact each of several shapes, pressed on the contact-layer twin (figure 6).

    Args:
        decibels: Noise level (dB, see `worlds`).
        amplitude: Prior amplitude s (relative conductivity change).
        seeds: Number of noise seeds.
        contacts: The shapes.
        methods: Which methods.
    """

    decibels: float
    amplitude: float
    seeds: int
    contacts: tuple[Shape, ...]
    methods: tuple[str, ...] = ("16I", "16O", "16O fused")

    def run(self) -> Result:
        """Results: ``pixels`` (n_contacts, n_methods, ny, nx) of the first seed; ``truth`` (n_contacts, ny, nx),
        whether a pixel's centre is in the shape; ``overlap`` (n_contacts, n_methods, n_seeds), intersection over union
        of the shape and the pixels above half of the largest; ``blind`` (n_contacts,), the score of the best disc at
        the shape's centroid, which an image without any information on the shape could reach.
        """
        table = Bench("pressed", self.decibels, self.amplitude)
        raster = table.setup("grid").raster
        truth = np.array([mask(contact, raster) for contact in self.contacts])

        def measure(view: View, contacts: Contacts) -> dict[str, Any]:
            above = view.pixels >= np.nanmax(view.pixels) / 2
            inside = truth[self.contacts.index(contacts[0])]
            return {"pixels": view.pixels, "overlap": intersection_over_union(above, inside)}

        found = table.read(self.methods, [(contact,) for contact in self.contacts], self.seeds, measure)
        pixels, overlap = (np.ascontiguousarray(found[name].swapaxes(0, 1)) for name in ("pixels", "overlap"))
        blind = np.array([blind_overlap(contact, raster) for contact in self.contacts])
        return {"pixels": pixels[:, :, 0], "truth": truth, "overlap": overlap, "blind": blind}


def mask(contact: Shape, raster: Raster) -> Mask:
    """Which pixels (ny, nx) have their centre in the shape."""
    centres = np.stack(np.meshgrid(raster.x, raster.y), axis=-1)
    inside: Mask = contact.distance(centres.reshape(-1, 2)).reshape(centres.shape[:2]) <= 0
    return inside


def blind_overlap(contact: Shape, raster: Raster) -> float:
    """The best score, over all radii, of a disc at the shape's centroid: what an imager blind to shape could reach."""
    inside = mask(contact, raster)
    x, y = np.meshgrid(raster.x, raster.y)
    away = np.hypot(x - x[inside].mean(), y - y[inside].mean())
    return max(intersection_over_union(away <= radius, inside) for radius in np.unique(away[away < 2 * contact.radius]))


def intersection_over_union(a: Mask, b: Mask) -> float:
    """Pixels in both over pixels in either (0 to 1)."""
    return float((a & b).sum() / (a | b).sum())
