"""Figures 3 to 6 and Table I: what images of touches show."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ohmskin.arrays import Floats
from ohmskin.contacts import Contact
from ohmskin.errors import DataError
from ohmskin.evaluate.merit import Target, eidors_figures, figures_of_merit
from ohmskin.evaluate.methods import METHODS, bench
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.setup import PIXELS
from ohmskin.evaluate.shapes import Shape
from ohmskin.evaluate.worlds import Contacts
from ohmskin.geometry import Raster

COLUMNS = ("AR", "PE", "RES", "SD", "RNG", "peak", "localisation")
EIDORS_COLUMNS = ("AR", "PE", "RES", "SD", "RNG")
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Touches:
    """Images and contacts of several cases (figures 3 and 4).

    Args:
        world: One of `worlds.WORLDS`.
        decibels: Noise level (dB).
        amplitude: Prior amplitude (1).
        seeds: Number of noise seeds; the images are those of the first.
        cases: The contacts of each case.
        methods: Which methods.
    """

    world: str
    decibels: float
    amplitude: float
    seeds: int
    cases: tuple[Contacts, ...]
    methods: tuple[str, ...] = METHODS

    def run(self) -> Result:
        """Results: ``pixels`` (n_cases, n_methods, ny, nx), relative change; ``count`` (n_cases, n_methods, n_seeds),
        contacts found; ``error`` (same), mean distance in metres between true contacts and the contacts found that are
        matched to them, NaN where fewer are found than there are; ``place`` (n_cases, n_methods, n_seeds, 2), see
        `View.place`.
        """
        shape = (len(self.cases), len(self.methods), self.seeds)
        pixels = np.empty((*shape[:2], PIXELS, PIXELS))
        count, error, place = np.zeros(shape, np.int64), np.full(shape, np.nan), np.full((*shape, 2), np.nan)
        table = bench(self.world, self.decibels, self.amplitude)
        for c, contacts in enumerate(self.cases):
            for m, seed, seen in table.see_all(self.methods, contacts, self.seeds):
                if seed == 0:
                    pixels[c, m] = seen.pixels
                found = seen.contacts
                count[c, m, seed], place[c, m, seed] = len(found), seen.place
                error[c, m, seed] = matched_error(found, contacts)
        return {"pixels": pixels, "count": count, "error": error, "place": place}


def matched_error(found: Sequence[Contact], contacts: Contacts) -> float:
    """Mean distance (m) of the best one-to-one match from true contacts to found ones; NaN if there are too few
    found."""
    if len(found) < len(contacts):
        return float("nan")
    distance = np.array([[np.hypot(*np.subtract(f.position, c.position)) for f in found] for c in contacts])
    return float(distance[linear_sum_assignment(distance)].mean())


@dataclass(frozen=True)
class Sections:
    """Horizontal cross-sections through the centre of one contact, for each method and seed (figure 5)."""

    world: str
    decibels: float
    amplitude: float
    seeds: int
    contact: Shape
    methods: tuple[str, ...] = METHODS

    def run(self) -> Result:
        """Results: ``x`` (nx,) in metres; ``profile`` (n_methods, n_seeds, nx), relative change; ``peak`` and ``width``
        (n_methods, n_seeds), the profile's largest value and its width at half of that (m); ``at`` (same), where (m).
        """
        table = bench(self.world, self.decibels, self.amplitude)
        profile = np.empty((len(self.methods), self.seeds, PIXELS))
        peak, width, at = (np.empty(profile.shape[:2]) for _ in range(3))
        for m, seed, seen in table.see_all(self.methods, (self.contact,), self.seeds):
            x, y = seen.raster.x, seen.raster.y
            profile[m, seed] = [np.interp(self.contact.position[1], y, column) for column in seen.pixels.T]
            peak[m, seed], at[m, seed], width[m, seed] = peak_and_width(x, profile[m, seed])
        return {"x": x, "profile": profile, "peak": peak, "at": at, "width": width}


def peak_and_width(x: Floats, profile: Floats) -> tuple[float, float, float]:
    """The largest value of a profile (n,), its place, and the full width at half of it, linear between samples.

    Where the profile stays above half up to an end of `x`, that end counts.
    """
    top = int(np.argmax(profile))
    half = profile[top] / 2
    left, right = x[0], x[-1]
    for k in range(top, 0, -1):
        if profile[k - 1] < half:
            left = x[k] - (x[k] - x[k - 1]) * (profile[k] - half) / (profile[k] - profile[k - 1])
            break
    for k in range(top, len(x) - 1):
        if profile[k + 1] < half:
            right = x[k] + (x[k + 1] - x[k]) * (profile[k] - half) / (profile[k] - profile[k + 1])
            break
    return float(profile[top]), float(x[top]), float(right - left)


@dataclass(frozen=True)
class Merits:
    """Figures of merit of one contact, for each method and seed (Table I)."""

    world: str
    decibels: float
    amplitude: float
    seeds: int
    contact: Shape
    methods: tuple[str, ...] = METHODS

    def run(self) -> Result:
        """Results: ``modern`` (n_methods, n_seeds, 7), the `COLUMNS` (PE as a distance and localisation in metres);
        ``vector`` (n_methods, n_seeds, 2), PE as a vector (m); ``eidors`` (n_methods, n_seeds, 5), the
        `EIDORS_COLUMNS`. NaN where an image has nothing positive. AR is relative to the disc's change times area; a
        pressed contact has no such number, its area stands for it.
        """
        table = bench(self.world, self.decibels, self.amplitude)
        shape = (len(self.methods), self.seeds)
        modern, vector, eidors = (np.full((*shape, n), np.nan) for n in (len(COLUMNS), 2, len(EIDORS_COLUMNS)))
        strength = self.contact.area * (self.contact.strength if self.world == "discs" else 1.0)
        target = Target(self.contact.position, strength)
        for m, seed, seen in table.see_all(self.methods, (self.contact,), self.seeds):
            low, high = seen.mesh.nodes.min(axis=0), seen.mesh.nodes.max(axis=0)
            x, y = 2 * (np.array(self.contact.position) - low) / (high - low) - 1
            try:
                found = figures_of_merit(seen.pixels, seen.raster.x, seen.raster.y, [target])[0]
                theirs = eidors_figures(seen.pixels, (x, y))
            except DataError:
                continue
            away = np.linalg.norm(seen.place - self.contact.position)
            shape_of = (found.resolution, found.shape_deformation, found.ringing, found.peak)
            modern[m, seed] = (found.amplitude_response, found.distance, *shape_of, away)
            vector[m, seed], eidors[m, seed] = found.position_error, astuple(theirs)
        return {"modern": modern, "vector": vector, "eidors": eidors}


@dataclass(frozen=True)
class PressedShapes:
    """Images of one contact each of several shapes, pressed on the contact-layer twin (figure 6)."""

    decibels: float
    amplitude: float
    seeds: int
    contacts: tuple[Shape, ...]
    methods: tuple[str, ...] = ("16I", "16O", "16O fused")

    def run(self) -> Result:
        """Results: ``pixels`` (n_contacts, n_methods, ny, nx) of the first seed; ``truth`` (n_contacts, ny, nx),
        whether a pixel's centre is in the shape; ``overlap`` (n_contacts, n_methods, n_seeds), intersection over union
        of the shape and the pixels above half of the largest; ``blind`` (n_contacts,), the score
        of the best disc at the shape's centroid, which an imager blind to shape could reach.
        """
        table = bench("pressed", self.decibels, self.amplitude)
        shape = (len(self.contacts), len(self.methods))
        pixels, overlap = np.empty((*shape, PIXELS, PIXELS)), np.empty((*shape, self.seeds))
        truth, blind = np.empty((len(self.contacts), PIXELS, PIXELS), bool), np.empty(len(self.contacts))
        for c, contact in enumerate(self.contacts):
            for m, seed, seen in table.see_all(self.methods, (contact,), self.seeds):
                if seed == 0:
                    pixels[c, m] = seen.pixels
                    truth[c], blind[c] = mask(contact, seen.raster), blind_overlap(contact, seen.raster)
                overlap[c, m, seed] = intersection_over_union(seen.pixels >= np.nanmax(seen.pixels) / 2, truth[c])
        return {"pixels": pixels, "truth": truth, "overlap": overlap, "blind": blind}


def mask(contact: Shape, raster: Raster) -> Mask:
    """Which pixels (ny, nx) have their centre in the shape."""
    centres = np.stack(np.meshgrid(raster.x, raster.y), axis=-1)
    inside: Mask = contact.distance(centres.reshape(-1, 2)).reshape(centres.shape[:2]) <= 0
    return inside


def blind_overlap(contact: Shape, raster: Raster) -> float:
    """The best score of a disc, over all radii, at the centroid of the shape: what an imager blind to shape could
    reach."""
    inside = mask(contact, raster)
    x, y = np.meshgrid(raster.x, raster.y)
    away = np.hypot(x - x[inside].mean(), y - y[inside].mean())
    return max(intersection_over_union(away <= radius, inside) for radius in np.unique(away[away < 2 * contact.radius]))


def intersection_over_union(a: Mask, b: Mask) -> float:
    """Pixels in both over pixels in either (0 to 1)."""
    return float((a & b).sum() / (a | b).sum())
