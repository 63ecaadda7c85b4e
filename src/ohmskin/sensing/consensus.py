"""The reader of recordings with a pattern of their own: contacts on which the image and a fit to the data agree.

An image of large targets that conduct much better or worse than the rest has side lobes that are as sharp as targets,
above all at the rim; a fit of discs takes targets of other shapes for several. Neither has the errors of the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, pi, sqrt

import numpy as np

from ohmskin.arrays import changed
from ohmskin.contacts import Contact, ContactFinder, ContactFitter
from ohmskin.inverse.estimators import Estimator
from ohmskin.scan import Difference
from ohmskin.sensing.confidence import fit_confidence
from ohmskin.sensing.model import SkinModel
from ohmskin.sensing.readers import Belief, DetectionReader, FitReader, Reader, centroid, fit

_FRACTION = 0.5  # of the fraction asked of a peak where the image alone shows contacts
_BELIEVED = 0.5  # confidence in a fit, below which the image alone shows them


@dataclass(frozen=True, eq=False)
class ConsensusReader(DetectionReader):
    """A `Reader` that finds contacts in the image of every frame where others are fitted to the data, too.

    Args:
        physics: Fits contacts, and makes the image.
        finder: Finds all on which both may agree; `detect` finds what the image alone shows.
    """

    physics: FitReader
    finder: ContactFinder

    @property
    def fitter(self) -> ContactFitter:
        """What fits contacts to data."""
        return self.physics.fitter

    def start(self, before: Belief | None = None) -> Belief:
        """The belief while nothing touches the skin."""
        return self.physics.start(before)

    def update(self, before: Belief, new: Sequence[Difference], recent: Sequence[Difference], elapsed: float) -> Belief:
        """The belief after one more frame, as for `Reader.update`."""
        fitted = self.physics.update(before, new, recent, elapsed)
        if fit_confidence(fitted.unexplained) < _BELIEVED:
            found = self.detect(fitted.estimate, recent)
        elif fitted.detections:
            seen = self.finder.find(fitted.image, self.estimator.cells)
            found = agreeing(self.fitter, fitted.detections, seen)
        else:
            found = ()
        followed = self.follow(before, fitted.estimate, found)
        return changed(fitted, detections=followed.detections, contacts=followed.contacts, tracks=followed.tracks)


def consensus(known: SkinModel, estimator: Estimator, threshold: float) -> Reader:
    """Contacts on which the image and a fit to the data agree, between the places of both."""
    imaging, alone = known.skin.imaging, centroid(known, estimator, threshold)
    finder = ContactFinder(threshold, _FRACTION * imaging.fraction, imaging.dip, imaging.bipolar)
    physics = fit(known, estimator, threshold)
    assert isinstance(alone, DetectionReader)
    assert isinstance(physics, FitReader)
    return ConsensusReader(estimator, alone.detect, alone.tracker, physics, finder)


def agreeing(fitter: ContactFitter, fitted: Sequence[Contact], seen: Sequence[Contact]) -> list[Contact]:
    """Those contacts of an image that overlap with fitted ones, moved half way to these.

    Args:
        fitter: What fitted these.
        fitted: Contacts fitted to the data; several may be one of another shape.
        seen: Contacts of the image.
    """
    found = []
    for contact in seen:
        there = [one for one in fitted if one.strength * contact.strength > 0 and _overlap(fitter, one, contact)]
        if there:
            away = fitter.table.offsets([one.position for one in there], contact.position)
            middle = np.average(away, axis=0, weights=[abs(one.strength) for one in there]) / 2
            x, y = fitter.onto(np.array([contact.position]) + middle)[0].tolist()
            found.append(changed(contact, position=(x, y)))
    return found


def _overlap(fitter: ContactFitter, one: Contact, other: Contact) -> bool:
    """Whether the middle of one of two contacts is in the other one."""
    radii = [contact.radius or sqrt(contact.extent / pi) for contact in (one, other)]
    return hypot(*fitter.table.offsets(one.position, other.position).tolist()) < max(radii)
