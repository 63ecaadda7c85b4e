"""Where fitted contacts really are: what presses of known places taught, applied to what a sensor reports."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ohmskin.arrays import Floats, Ints, WeakCache
from ohmskin.contacts import Contact
from ohmskin.scan import Difference, DrivePattern, Pairs
from ohmskin.scan.baseline import codes_of
from ohmskin.sensing.model import SkinModel
from ohmskin.sensing.readers import Belief
from ohmskin.skin.positions import PositionMap

_ENOUGH = 0.6  # share of the channels learned from that must be measured for the changes to determine places


@dataclass(frozen=True, eq=False)
class Placement:
    """Places contacts by a position map.

    Args:
        map: What was learned.
        noise: Standard deviation of a change (V).
    """

    map: PositionMap
    noise: float
    _found: WeakCache[DrivePattern, tuple[Ints, Ints, Floats]] = field(
        default_factory=WeakCache, init=False, repr=False
    )

    def changes(self, scans: Sequence[Difference]) -> Floats | None:
        """Changes (n_meas,) of the channels learned from, in units of their error, whatever was driven.

        Missing channels are put in as the others have them (`PositionMap.completed`); None if too many are missing, or
        if they are unlike all that was learned from.
        """
        changes = np.full(len(self.map.quadruples), np.nan)
        for scan in scans:
            there, here, signs = self._channels(scan.pattern)
            values = signs * scan.volts[here] / self.noise
            measured = np.isfinite(values)
            changes[there[measured]] = values[measured]
        unknown = np.isnan(changes)
        changes[unknown] = 0.0
        missing = unknown & self.map.taught
        if missing.any():
            if missing.mean() > 1 - _ENOUGH:
                return None
            changes = self.map.completed(changes, missing)
        return changes if self.map.distances(changes[None])[0] <= self.map.limit else None

    def moved(self, contacts: Sequence[Contact], changes: Floats | None) -> tuple[Contact, ...]:
        """Contacts where the map puts them; of a single one by the changes, too, if they are known."""
        if not contacts or any(contact.radius is None for contact in contacts):
            return tuple(contacts)
        features = changes[None] if changes is not None and len(contacts) == 1 else None
        places, variances = self.map(np.array([contact.position for contact in contacts]), features)
        return tuple(
            replace(contact, position=(x, y), covariance=((variance, 0.0), (0.0, variance)))
            for contact, (x, y), variance in zip(contacts, places.tolist(), variances.tolist(), strict=True)
        )

    def _channels(self, pattern: DrivePattern) -> tuple[Ints, Ints, Floats]:
        """Which of the channels learned from a pattern measures, by which of its measurements, and their signs."""
        if (found := self._found.get(pattern)) is None:
            codes, signs = codes_of(self.map.quadruples.astype(np.int64))
            others, own = codes_of(pattern.quadruples)
            there, here = np.nonzero(codes[:, None] == others)
            found = self._found[pattern] = there, here, (signs[there] * own[here]).astype(float)
        return found


def placement_of(known: SkinModel) -> Placement | None:
    """What a skin has learned of places from presses; None if nothing."""
    return None if known.positions is None else Placement(known.positions, known.noise)


def placed(placement: Placement | None, belief: Belief, scans: Sequence[Difference], pairs: Pairs) -> Belief:
    """A belief with its contacts at the places of a position map; as it is if there is none.

    A single contact is placed by all data of scans, if these are like what was learned from; several by their places.
    Contacts that are not fitted stay where they are.
    """
    if placement is None or not belief.detections or belief.detections[0].radius is None:
        return belief
    changes = placement.changes(belief.without_drift(scans, pairs)) if len(belief.detections) == 1 else None
    detections, contacts = (placement.moved(one, changes) for one in (belief.detections, belief.contacts))
    return replace(belief, detections=detections, contacts=contacts)
