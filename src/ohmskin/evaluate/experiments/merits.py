"""Table I: figures of merit of one touch."""

from dataclasses import dataclass

import numpy as np

from ohmskin.errors import DataError
from ohmskin.evaluate.merit import Target, eidors_figures, figures_of_merit
from ohmskin.evaluate.methods import METHODS, bench
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.shapes import Shape

COLUMNS = ("AR", "PE", "RES", "SD", "RNG", "peak", "localisation")
EIDORS_COLUMNS = ("AR", "PE", "RES", "SD", "RNG")


@dataclass(frozen=True)
class Merits:
    """Figures of merit of one contact, for each method and seed."""

    world: str
    decibels: float
    amplitude: float
    seeds: int
    contact: Shape
    methods: tuple[str, ...] = METHODS

    def run(self) -> Result:
        """Results: ``modern`` (n_methods, n_seeds, 7), the `COLUMNS` (PE as a distance and localisation in metres);
        ``vector`` (n_methods, n_seeds, 2), PE as a vector (m); ``eidors`` (n_methods, n_seeds, 5), the `EIDORS_COLUMNS`.
        NaN where an image has nothing positive. AR is relative to the disc's change times area; a pressed contact has no
        such number, its area stands for it.
        """
        table = bench(self.world, self.decibels, self.amplitude)
        shape = (len(self.methods), self.seeds)
        modern, vector, eidors = (np.full((*shape, n), np.nan) for n in (len(COLUMNS), 2, len(EIDORS_COLUMNS)))
        strength = self.contact.area * (self.contact.strength if self.world == "discs" else 1.0)
        target = Target(self.contact.position, strength)
        for m, key in enumerate(self.methods):
            for seed in range(self.seeds):
                view = table.see(key, (self.contact,), seed)
                low, high = view.mesh.nodes.min(axis=0), view.mesh.nodes.max(axis=0)
                x, y = 2 * (np.array(self.contact.position) - low) / (high - low) - 1
                try:
                    found = figures_of_merit(view.pixels, view.raster.x, view.raster.y, [target])[0]
                    theirs = eidors_figures(view.pixels, (x, y))
                except DataError:
                    continue
                away = float(np.linalg.norm(view.place - self.contact.position))
                modern[m, seed] = (
                    found.amplitude_response,
                    found.distance,
                    found.resolution,
                    found.shape_deformation,
                    found.ringing,
                    found.peak,
                    away,
                )
                vector[m, seed] = found.position_error
                eidors[m, seed] = (
                    theirs.amplitude_response,
                    theirs.position_error,
                    theirs.resolution,
                    theirs.shape_deformation,
                    theirs.ringing,
                )
        return {"modern": modern, "vector": vector, "eidors": eidors}
