"""Contacts found in an image: the places where it is pressed."""

from dataclasses import dataclass
from math import erf, sqrt

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.contacts.regions import find_regions, middle
from ohmskin.errors import ModelError
from ohmskin.geometry import Cells
from ohmskin.inverse import Image


@dataclass(frozen=True)
class Contact:
    """One place where the skin is touched.

    Args:
        position: (x, y) in metres, on the skin's map (`Chart`), as velocity and covariance are; (x, y, z) in an image
            of a surface in space.
        extent: Area where the image exceeds half its peak (m2).
        strength: Integral of the relative conductivity change over that area (m2); negative where conductivity fell.
        confidence: Probability that the peak exceeds the detection threshold, given the noise (0 to 1).
        peak: Largest relative conductivity change (1).
        id: Stays the same from frame to frame while the contact lasts; -1 before tracking.
        covariance: ((xx, xy), (xy, yy)) of the position (m2); None where it is not known, as of an image's contacts.
        velocity: (x, y) in metres per second; None where contacts are not followed by `ContactFilter`.
        radius: Of the disc that explains the data best (m); None likewise.
        force: Force of the press (N); None where the skin is not calibrated for force, or the force is not known yet.
        force_std: Standard deviation of the force (N); None likewise.
        pressure: Its greatest (Pa); None likewise, or where the calibration cannot separate pressure from area.
        area: Force over pressure (m2); None likewise.
    """

    position: tuple[float, float]
    extent: float
    strength: float
    confidence: float
    peak: float
    id: int = -1
    covariance: tuple[tuple[float, float], tuple[float, float]] | None = None
    velocity: tuple[float, float] | None = None
    radius: float | None = None
    force: float | None = None
    force_std: float | None = None
    pressure: float | None = None
    area: float | None = None


@dataclass(frozen=True)
class ContactFinder:
    """Finds contacts in images.

    Args:
        threshold: Smallest peak of a contact, relative conductivity change (gamma_0).
        fraction: Smallest peak of a contact as a share of the strongest; excludes the side lobes of a strong contact.
        dip: Depth of the saddle, as a share of the lower peak, beyond which two peaks are two contacts.
        bipolar: Whether places where conductivity falls count as contacts, too.
    """

    threshold: float
    fraction: float = 0.3
    dip: float = 0.2
    bipolar: bool = False

    def find(self, image: Image, cells: Cells) -> list[Contact]:
        """The contacts of an image made of `cells`, strongest peak first.

        Raises:
            ModelError: If the image has not as many values as there are cells, or some are no finite numbers.
        """
        if (count := len(cells.measures)) != image.values.size:
            raise ModelError(f"an image has {image.values.size} values; its estimator must give {count}, one per cell")
        if bad := np.count_nonzero(~np.isfinite(image.values)):
            raise ModelError(f"{bad} of {count} values of an image are not finite; its estimator must give numbers")
        cut = self.cut(image)
        contacts = []
        for sign in (1, -1) if self.bipolar else (1,):
            contrast, values = sign * image.contrast, sign * image.values
            # flooded from half the cut, so that the extent at half the peak is not cut short
            for region in find_regions(contrast, cells, cut / 2, self.dip):
                if region.peak <= cut:
                    continue
                core = region.elements[contrast[region.elements] > region.peak / 2]
                mass = values[core] * cells.measures[core]
                std = max(float(image.contrast_std(region.peak_element)[0]), 1e-300)
                contacts.append(
                    Contact(
                        position=tuple(middle(cells, core, mass).tolist()),
                        extent=float(cells.measures[core].sum()),
                        strength=sign * float(mass.sum()),
                        confidence=0.5 * (1 + erf((region.peak - self.threshold) / (sqrt(2) * std))),
                        peak=sign * float(values[region.peak_element]),
                    )
                )
        return sorted(contacts, key=lambda contact: -abs(contact.peak))

    def cut(self, image: Image) -> float:
        """The least contrast at the peak of a contact in an `image` (1)."""
        return max(self.threshold, self.fraction * self.highest(image))

    def highest(self, image: Image) -> float:
        """The highest contrast of an `image` that could be a contact's (1)."""
        return float(np.abs(image.contrast).max() if self.bipolar else image.contrast.max())


def learn_threshold(peaks: ArrayLike, margin: float = 6.0) -> float:
    """gamma_0 of eq. (6): mean and `margin` standard deviations of `peaks`, the highest value of each quiet image."""
    peaks = np.asarray(peaks, float)
    return float(peaks.mean() + margin * peaks.std())
