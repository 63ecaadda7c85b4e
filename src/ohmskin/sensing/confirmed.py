"""The reader of others' recordings: contacts of the image that a fit to the data confirms.

An image of large targets that conduct much better or worse than the rest has side lobes that are as sharp as targets,
above all at the rim; a fit of discs takes targets of other shapes for several. Neither has the errors of the other.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, pi, sqrt

import numpy as np

from ohmskin.arrays import changed
from ohmskin.contacts import Contact, ContactFinder, ContactFitter
from ohmskin.inverse.estimators import Estimate, Estimator
from ohmskin.scan import Difference
from ohmskin.sensing.confidence import fit_confidence
from ohmskin.sensing.model import SkinModel
from ohmskin.sensing.readers import DetectionReader, Reader, fit
from ohmskin.tracking import Tracker

_FRACTION = 0.5  # of the fraction asked of a peak where the image alone shows contacts
_BELIEVED = 0.5  # confidence in a fit, below which the image alone shows them


def confirmed(known: SkinModel, estimator: Estimator, threshold: float) -> Reader:
    """Contacts of the image that a fit to the data confirms, between the places of both."""
    imaging, cells, tracker = known.skin.imaging, estimator.cells, Tracker(estimator.cells.period)
    alone = ContactFinder(threshold, imaging.fraction, imaging.dip, imaging.bipolar)
    more = replace(alone, fraction=_FRACTION * imaging.fraction)
    physics = fit(known, known.estimator("gauss-newton"), threshold)  # whose own image is never asked for

    def detect(estimate: Estimate, scans: Sequence[Difference]) -> Sequence[Contact]:
        seen = more.find(estimate.image, cells)
        if not seen:
            return seen
        fitted = physics.update(physics.start(), scans, scans, 0.0)
        if fit_confidence(fitted.unexplained) < _BELIEVED:
            return alone.find(estimate.image, cells)
        return confirmed_by(known.fitter, fitted.detections, seen)

    return DetectionReader(estimator, detect, tracker)


def confirmed_by(fitter: ContactFitter, fitted: Sequence[Contact], seen: Sequence[Contact]) -> list[Contact]:
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
