"""Figure 5: cross-sections of the images through a touch."""

from dataclasses import dataclass

import numpy as np

from ohmskin.evaluate.methods import METHODS, PIXELS, bench
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.shapes import Shape
from ohmskin.geometry.domain import Floats


@dataclass(frozen=True)
class Sections:
    """Horizontal cross-sections through the centre of one contact, for each method and seed."""

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
        for m, key in enumerate(self.methods):
            for seed in range(self.seeds):
                view = table.see(key, (self.contact,), seed)
                x, y, pixels = view.raster.x, view.raster.y, view.pixels
                profile[m, seed] = [np.interp(self.contact.position[1], y, column) for column in pixels.T]
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
