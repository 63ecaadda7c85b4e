"""Where a base scan shows contacts, for the drive that measures there next."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats, Ints, changed
from ohmskin.contacts import Contact, ContactFinder, ContactFitter, Solution, find_regions
from ohmskin.contacts.information import Information
from ohmskin.contacts.refit import CLEAR
from ohmskin.drive import Target
from ohmskin.geometry import Cells
from ohmskin.inverse import GaussNewton, Image
from ohmskin.inverse.estimators import Estimate, LazyEstimate
from ohmskin.scan import Difference
from ohmskin.sensing.readers import Belief, undriven

_MORE = 1.5  # times what was left of a base scan's data, from which on they may show more contacts


@dataclass(frozen=True, eq=False)
class Locator:
    """Tells roughly where a base scan shows contacts: the regions of its image (eq. 6), or what is fitted to it.

    Args:
        estimator: Makes the image.
        finder: Threshold gamma_0, least share of the highest region, and dip between two.
        fitter: Fits contacts to the scan; None: they are estimated from the image.
    """

    estimator: GaussNewton
    finder: ContactFinder
    fitter: ContactFitter | None = None

    def estimate(self, scans: Sequence[Difference]) -> Estimate:
        """The image of scans."""
        return LazyEstimate(lambda: self.estimator.reconstruct(*undriven(scans)))

    def targets(
        self, scans: Sequence[Difference], base_estimate: Estimate, before: Belief, located: Solution | None = None
    ) -> tuple[list[Target], Solution | None]:
        """The contacts, strongest first; the likeliest place where there seems to be none, which finds weak ones.

        Those that were fitted to the last frame are taken as they were while they still explain the scans, or where
        nothing explained them; whether more have come is estimated from all scans.

        Args:
            scans: Of the frame, so far.
            base_estimate: Their image.
            before: The belief after the last frame.
            located: What was searched in base scans last.

        Returns:
            The contacts, and what has been searched.
        """
        if self.fitter is None:
            return self._regions(base_estimate.image), None
        known = before.solution
        if known is not None and before.detections and (known.poor or self._still(scans, before, known)):
            return targets_of(before.detections), located
        nominal, inflated = self.fitter.information(*scans)
        last = None if known is None else self.fitter.refitted(nominal, inflated, known, search=False)
        if last is not None:
            solution = last[0]
        else:
            solution = located = self._searched(nominal, inflated, located if before.searched else None)
        if found := targets_of(self.fitter.contacts(solution)):
            return found, located
        height = self.fitter.heights(*self.fitter.scores(nominal))
        return [Target.possible(self.fitter.places[int(np.argmax(height))], self.fitter.table.radius)], located

    def _searched(self, nominal: Information, inflated: Information, before: Solution | None) -> Solution:
        """Contacts searched in data, or those from `before` fitted to data that show no more: where contacts explain
        these only in part, as on a skin that drifts, a search takes long, for what is about the same."""
        assert self.fitter is not None
        if before and len(before.params):
            beside = self.fitter.uncovered(inflated.marginalised_common(), before.covered)
            found = self.fitter.refine(beside, before.params, *self.fitter.prior(before.params))
            left = nominal.minus(found.caused).white_residual.constant
            if left < _MORE * before.poor:
                return changed(found, covered=before.covered, poor=min(left, before.poor))
        found = self.fitter.fit_information(nominal, inflated)
        return changed(found, poor=nominal.minus(found.caused).white_residual.constant)

    def _still(self, scans: Sequence[Difference], before: Belief, known: Solution) -> bool:
        """Whether contacts leave no more of scans than one that is followed may, with no step of a fit."""
        assert self.fitter is not None
        drift, pairs = 0.0 if before.drift is None else before.drift.change, self.fitter.table.pairs
        changes = known.caused + drift
        seen = undriven(scans)
        left = [scan.volts - scan.caused_by(changes, pairs) for scan in seen]
        squares = sum(float(scan.volts @ scan.volts) for scan in seen)
        usual = self.fitter.usual_squares(squares, sum(map(len, left)))
        return sum(float(rest @ rest) for rest in left) <= CLEAR * usual

    def _regions(self, image: Image) -> list[Target]:
        cells, finder, values = self.estimator.cells, self.finder, image.values
        threshold = max(finder.threshold, finder.fraction * float(values.max()))
        regions = find_regions(values, cells, threshold, finder.dip)
        if not regions:
            peak = cells.centroids[int(np.argmax(values))]
            return [self._target(peak, 0.0, cells.centroids[cells.closest_elements(peak[None], 3)[0]], cells)]
        found = []
        for region in regions:
            effect = float(values[region.elements] @ cells.measures[region.elements])
            found.append(self._target(region.centroid, effect, region.anchors, cells, region.elements))
        return found

    @staticmethod
    def _target(place: Floats, effect: float, anchors: Floats, cells: Cells, elements: Ints | None = None) -> Target:
        radius = 0.0 if elements is None else float(np.sqrt(cells.measures[elements].sum() / np.pi))
        return Target(place, radius**2 * np.eye(2), effect, radius, anchors)


def targets_of(contacts: Sequence[Contact]) -> list[Target]:
    """Contacts as a drive wants them; one without a covariance is known as well as it is large."""
    targets = []
    for c in contacts:
        square = c.extent / np.pi if c.radius is None else c.radius**2
        covariance = square * np.eye(2) if c.covariance is None else np.array(c.covariance)
        targets.append(Target(np.array(c.position), covariance, c.strength, float(np.sqrt(square))))
    return targets
