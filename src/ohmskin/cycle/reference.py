"""The plain twin of the compiled cycle: the textbook formulas in float64, written with the parts of the other packages."""

from math import erf

import numpy as np

from ohmskin.cycle.cycle import FastCycle, Measured
from ohmskin.drive import OptimalDrive, part_of
from ohmskin.geometry.domain import Floats
from ohmskin.geometry.mesh import Ints
from ohmskin.touch import Contact
from ohmskin.touch.regions import label_peaks


class ReferenceCycle:
    """Sees what a `FastCycle` sees, slowly: every image from the dense normal equations of its scan or scans.

    Args:
        fast: The cycle to do again; without a baseline, so that its data are changes of voltage.
    """

    def __init__(self, fast: FastCycle) -> None:
        assert isinstance(fast.mode.optimal, OptimalDrive)
        self.fast, self.estimator, self.cells, self.optimal = fast, fast.estimator, fast.estimator.cells, fast.mode.optimal
        self.base_image: Floats = np.zeros(len(self.cells.measures))
        self.image: Floats = np.zeros(len(self.cells.measures))
        self._base: tuple[Floats, Floats] = (np.zeros((0, 0)), np.zeros(0))
        self.chosen: Ints = np.zeros(0, np.int64)

    def look(self, volts: Floats, currents: Floats) -> Ints:
        """As `FastCycle.look`."""
        pattern = self.fast.mode.base
        usual = self.fast._tables.base_currents
        which = pattern.measurements[:, 0]
        n_elec = len(self.estimator.model.electrodes)
        rows = pattern.combination(n_elec) @ self.estimator.modes.mixing * usual[which, None]
        self._base = rows, volts * (usual / currents)[which]
        self.base_image, _ = self._solve(*self._base)
        peak = int(np.argmax(self.base_image))
        threshold = max(self.fast.thresholds[0], self.fast.fraction * self.base_image[peak])
        labels = label_peaks(self.base_image, self.cells.neighbours, threshold, self.fast.dip)
        middles = [self._middle(self.base_image, labels == r)[0] for r in range(int(labels.max(initial=-1)) + 1)]
        centres = self.cells.centroids
        away = [np.sum((centres - middle) ** 2, axis=1) for middle in middles or [centres[peak]]]
        pattern = self.optimal.pattern([centres[np.argsort(d, kind="stable")[:3]] for d in away])
        pairs = self.optimal.complete.injections
        self.chosen = np.array([int(np.flatnonzero((pairs == pair).all(axis=1))[0]) for pair in pattern.injections])
        return self.chosen

    def see(self, volts: Floats, currents: Floats, chosen: Ints | None = None) -> list[Contact]:
        """As `FastCycle.see`."""
        pattern = part_of(self.optimal.complete, self.chosen if chosen is None else chosen)
        n_elec = len(self.estimator.model.electrodes)
        rows = pattern.combination(n_elec) @ self.estimator.modes.mixing * currents[pattern.measurements[:, 0], None]
        if self.fast.mode.fuse:
            rows, volts = np.vstack([self._base[0], rows]), np.concatenate([self._base[1], volts])
        self.image, covariance = self._solve(rows, volts)
        gamma, highest = self.fast.thresholds[1], float(self.image.max())
        cut = max(gamma, self.fast.fraction * highest)
        if highest <= cut:
            return []
        labels = label_peaks(self.image, self.cells.neighbours, cut / 2, self.fast.dip)
        found = []
        for r in range(int(labels.max()) + 1):
            peak_pixel = int(np.argmax(np.where(labels == r, self.image, -np.inf)))
            peak = float(self.image[peak_pixel])
            if peak <= cut:
                continue
            core = (labels == r) & (self.image > peak / 2)
            middle, mass = self._middle(self.image, core)
            response = rows @ np.linalg.solve(covariance, self.estimator.modes.modes[:, peak_pixel])
            std = self.estimator.noise * float(np.linalg.norm(response))
            sure = 0.5 * (1 + erf((peak - gamma) / (np.sqrt(2) * std)))
            found.append(Contact((float(middle[0]), float(middle[1])), float(self.cells.measures[core].sum()), mass, sure, peak))
        return found

    def frame(self, base: Measured, second: Measured) -> list[Contact]:
        """A whole cycle of known data."""
        self.look(*base)
        return self.see(*second)

    def _solve(self, rows: Floats, volts: Floats) -> tuple[Floats, Floats]:
        noise2 = self.estimator.noise**2 + self.estimator.model_error**2 * np.mean(volts**2)
        normal = rows.T @ rows + noise2 / self.estimator.amplitude**2 * np.eye(rows.shape[1])
        return np.linalg.solve(normal, rows.T @ volts) @ self.estimator.modes.modes, normal

    def _middle(self, image: Floats, core: Ints) -> tuple[Floats, float]:
        mass = np.where(core, image * self.cells.measures, 0.0)
        return mass @ self.cells.centroids / mass.sum(), float(mass.sum())
