"""The auxiliary channel: what one sensor beside the electrodes feels of all contacts together."""

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite, sqrt

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.contacts import Contact
from ohmskin.scan import Frame
from ohmskin.sensing.model import SkinModel

_SHARES = 0.5  # how surely strengths alone determine the shares of contacts in a force
_APART = 5.0  # standard deviations by which a total may differ from that of the contacts


class TotalForce:
    """Brings the forces of contacts to the total that the auxiliary channel measures.

    Args:
        known: What is known of the skin; its quiet frames have what the channel reads at rest.
    """

    def __init__(self, known: SkinModel) -> None:
        self._channel = known.skin.calibrated_auxiliary
        self._present, self._rest = bool(self._channel.kind), known.quiet.rest
        self._rest_variance = self._channel.noise**2 / max(len(known.quiet.auxiliary), 1)

    def total(self, frames: Sequence[Frame]) -> tuple[float, float]:
        """The total force on the skin that frames measure, and its variance (N, N2); NaN where they do not."""
        reading, variance = self._mean([frame.auxiliary for frame in frames])
        force = (reading - self._rest) / self._channel.gain
        off = (variance + self._rest_variance) / self._channel.gain**2
        return force, off + (self._channel.error * force) ** 2

    def known_total(self, frames: Sequence[Frame]) -> float | None:
        """The total force on the skin that frames measure (N); None where they do not, or there is no such channel."""
        total = self.total(frames)[0] if self._present else float("nan")
        return total if isfinite(total) else None

    def __call__(self, contacts: tuple[Contact, ...], frames: Sequence[Frame]) -> tuple[Contact, ...]:
        """Contacts with forces that add up to the total, each changed the more the less sure it was (a Kalman update).

        Contacts of unknown force share what is left of the total by their strengths. A total that the contacts
        cannot have is of something that is no contact yet, or beside the skin: then they stay as they are. So they do
        where it is not known, or surely negative.
        """
        if not (self._present and contacts):
            return contacts
        total, variance = self.total(frames)
        if not total >= -_APART * sqrt(variance):  # or it is NaN
            return contacts
        forces, stds = _known_forces(contacts, total, sqrt(variance))
        gain = stds**2 / (variance + float(stds @ stds))
        if abs(total - forces.sum()) > _APART * sqrt(variance + float(stds @ stds)):
            return contacts
        after = np.maximum(forces + gain * (total - forces.sum()), 0.0)
        left = np.sqrt(np.maximum(stds**2 * (1 - gain), 0.0))
        return tuple(
            replace(
                contact,
                force=float(force),
                force_std=float(std),
                pressure=None if contact.pressure is None else contact.pressure * float(force / max(before, 1e-12)),
            )
            for contact, before, force, std in zip(contacts, forces, after, left, strict=True)
        )

    def _mean(self, readings: Sequence[float | None]) -> tuple[float, float]:
        """Of those that are known, and its variance."""
        finite = [one for one in readings if one is not None and isfinite(one)]
        if not finite:
            return float("nan"), 0.0
        return float(np.mean(finite)), self._channel.noise**2 / len(finite)


def _known_forces(contacts: Sequence[Contact], total: float, least: float) -> tuple[Floats, Floats]:
    """Forces (n,) of contacts and their standard deviations (N), these at least so large where they are not known: then
    they share by their strengths what is left of the total."""
    forces = np.array([np.nan if contact.force is None else contact.force for contact in contacts])
    stds = np.array([contact.force_std or least for contact in contacts])
    if (unknown := np.isnan(forces)).any():
        strengths = np.abs([contact.strength for contact in contacts])[unknown]
        left = max(total - float(forces[~unknown].sum()), 0.0)
        forces[unknown] = left * strengths / max(float(strengths.sum()), 1e-300)
        stds[unknown] = np.maximum((_SHARES if unknown.sum() > 1 else 1.0) * forces[unknown], least)
    return forces, stds
