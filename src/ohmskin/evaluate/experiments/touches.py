"""Figures 3 and 4: images of one and of several touches, by all methods."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ohmskin.evaluate.methods import METHODS, PIXELS, bench
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.worlds import Contacts
from ohmskin.touch import Contact


@dataclass(frozen=True)
class Touches:
    """Images and contacts of several cases.

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
            for m, key in enumerate(self.methods):
                for seed in range(self.seeds):
                    view = table.see(key, contacts, seed)
                    if seed == 0:
                        pixels[c, m] = view.pixels
                    found = view.contacts
                    count[c, m, seed], place[c, m, seed] = len(found), view.place
                    error[c, m, seed] = matched_error(found, contacts)
        return {"pixels": pixels, "count": count, "error": error, "place": place}


def matched_error(found: list[Contact], contacts: Contacts) -> float:
    """Mean distance (m) of the best one-to-one match from true contacts to found ones; NaN if there are too few found."""
    if len(found) < len(contacts):
        return float("nan")
    distance = np.array([[np.hypot(*np.subtract(f.position, c.position)) for f in found] for c in contacts])
    return float(distance[linear_sum_assignment(distance)].mean())
