"""The learned reader: one contact, corrected by a map learned from presses; physics for all that is unlike those."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import changed
from ohmskin.contacts import Contact, ContactFitter, Solution
from ohmskin.contacts.information import Information
from ohmskin.contacts.refit import CLEAR
from ohmskin.errors import ModelError
from ohmskin.inverse.estimators import Estimator
from ohmskin.scan import Difference
from ohmskin.sensing.confidence import fit_confidence
from ohmskin.sensing.model import SkinModel
from ohmskin.sensing.places import Placement, placement_of
from ohmskin.sensing.readers import Belief, FitReader, estimated, fit
from ohmskin.tracking import Tracks


def one_contact(fitter: ContactFitter, scans: Sequence[Difference]) -> tuple[Information, Information, Solution]:
    """Information of scans, nominal and inflated by the model's error, and the one contact that explains most of it."""
    nominal, inflated = fitter.information(*scans)
    return nominal, inflated, fitter.added(inflated, *fitter.scores(inflated))


@dataclass(frozen=True, eq=False)
class LearnedReader:
    """A `Reader` that places one contact by a learned map, and fits contacts to data unlike those learned from.

    Args:
        physics: Reads outliers, and estimates drift while nothing touches.
        placement: The learned map.
    """

    physics: FitReader
    placement: Placement

    @property
    def estimator(self) -> Estimator:
        """What makes the image."""
        return self.physics.estimator

    @property
    def fitter(self) -> ContactFitter:
        """What fits contacts to outliers."""
        return self.physics.fitter

    def start(self, before: Belief | None = None) -> Belief:
        """The belief while nothing touches the skin."""
        return self.physics.start(before)

    def update(self, before: Belief, new: Sequence[Difference], recent: Sequence[Difference], elapsed: float) -> Belief:
        """The belief after one more frame, as for `Reader.update`; contacts are fitted to outliers."""
        pairs = self.physics.fitter.table.pairs
        cleaned = before.without_drift(recent, pairs)
        found = self.contact_of(cleaned)
        if found is None:
            belief = self.physics.update(before, new, recent, elapsed)
            return changed(belief, novel=before.novel + elapsed if belief.detections else 0.0)
        assert isinstance(before.tracks, Tracks)
        estimate = estimated(self.estimator, before.estimate, len(new), cleaned, elapsed)
        tracks, contacts = self.physics.tracker.update(before.tracks, [found])
        drift = before.drift and changed(before.drift, unlearned=before.drift.unlearned + elapsed)
        return Belief(estimate, (found,), contacts, tracks, drift, explains=True)

    def contact_of(self, scans: Sequence[Difference]) -> Contact | None:
        """The contact read from scans, without drift; None if they are outliers of those learned from, or if another
        contact, apart from it, explains most of the residual."""
        fitter = self.physics.fitter
        changes = self.placement.changes(scans)
        if changes is None:
            return None
        nominal, inflated, one = one_contact(fitter, scans)
        if one.cost > CLEAR * fitter.bar**2:  # or no second contact can explain most of it
            left = nominal.minus(one.caused).marginalised_flat(one.slopes)
            two = fitter.added(inflated, *fitter.scores(left), one.params)
            if fitter.are_apart(one, two, fitter.bar**2):
                return None
        physics = fitter.contact(one.params[0], one.covariances[0])
        (contact,) = self.placement.moved([physics], changes)
        x, y = fitter.onto(np.array([contact.position]))[0].tolist()
        sure = fit_confidence(nominal.unexplained(one.caused)) * contact.confidence
        return changed(contact, position=(x, y), confidence=sure, radius=None)  # no radius: it is where it is


def learned(known: SkinModel, estimator: Estimator, threshold: float) -> LearnedReader:
    """One contact, corrected by a map learned from presses, and fitted contacts for all else.

    Raises:
        ModelError: If the skin has learned nothing.
    """
    placement = placement_of(known)
    if placement is None:
        raise ModelError("this skin has no position map; learn one from presses: ohmskin learn PRESSES --skin SKIN")
    physics = fit(known, estimator, threshold)
    assert isinstance(physics, FitReader)
    return LearnedReader(physics, placement)
