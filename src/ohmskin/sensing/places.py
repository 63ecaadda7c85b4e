"""Where fitted contacts really are: what presses of known places taught, applied to what a sensor reports."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ohmskin.contacts import Contact
from ohmskin.scan import Difference
from ohmskin.sensing.model import SkinModel
from ohmskin.sensing.readers import Belief
from ohmskin.skin.positions import PositionMap


def placed(known: SkinModel, belief: Belief, scans: Sequence[Difference]) -> Belief:
    """A belief with its contacts at the places that the skin's position map tells; as it is if there is none.

    A single contact is placed by all that the scan says, if that is of the pattern learned; several by their places.
    Contacts that are not fitted stay where they are.
    """
    if known.positions is None:
        return belief
    detections, contacts = (_moved(known, known.positions, one, scans) for one in (belief.detections, belief.contacts))
    return replace(belief, detections=detections, contacts=contacts)


def _moved(
    known: SkinModel, learned: PositionMap, contacts: tuple[Contact, ...], scans: Sequence[Difference]
) -> tuple[Contact, ...]:
    if not contacts or any(contact.radius is None for contact in contacts):
        return contacts
    features = None
    if len(contacts) == 1 and np.array_equal(scans[-1].pattern.quadruples, learned.quadruples):
        features = learned.features(scans[-1].volts[None] / known.noise)
    places, variances = learned(np.array([contact.position for contact in contacts]), features)
    return tuple(
        replace(contact, position=(x, y), covariance=((variance, 0.0), (0.0, variance)))
        for contact, (x, y), variance in zip(contacts, places.tolist(), variances.tolist(), strict=True)
    )
