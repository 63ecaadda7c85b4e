"""Contradictions of data whose cause is not found: whether they are noise, or the same in every frame."""

from dataclasses import dataclass, field

import numpy as np

from ohmskin.arrays import Bools, Floats, Ints, changed
from ohmskin.contacts import Contact
from ohmskin.scan.coherence import Coherence, NetworkData
from ohmskin.sensing.confidence import fit_confidence

_FRAMES = 5.0  # over which correlations and shares are means
_SAME = 0.4  # correlation from which on a contradiction is the same in all frames; that of noise is 0 to 0.3
_LEAST = 10  # voltages measured again, from which on a correlation is judged
_UNSEEN = 3.0  # share of an error that is not seen, as some network explains it, over that which contradicts


@dataclass(frozen=True, eq=False)
class Contradiction:
    """What of the newest frames contradicts every network.

    Args:
        quadruples: (n,) numbers of the quadruples that were measured, ascending.
        residuals: (n,) newest misfit of each over its standard deviation.
        correlation: Mean correlation of the misfits of a frame with those before (1).
        share: Mean power of the misfits over that of the signal (1).
    """

    quadruples: Ints = field(default_factory=lambda: np.empty(0, np.int64), repr=False)
    residuals: Floats = field(default_factory=lambda: np.empty(0), repr=False)
    correlation: float = 0.0
    share: float = 0.0

    @property
    def systematic(self) -> bool:
        """Whether it is the same in all frames."""
        return self.correlation > _SAME

    def after(self, data: NetworkData, kept: Bools, fit: Coherence, newest: int) -> "Contradiction":
        """The contradiction after one frame more.

        Args:
            data: The newest scans.
            kept: (n_meas,) which of their data are used.
            fit: How well these agree.
            newest: How many of the scans are new.
        """
        new = kept & data.known & (data.scan < newest)
        numbers, residuals = data.quadruple_numbers[new], fit.residuals[new]
        _, here, before = np.intersect1d(numbers, self.quadruples, return_indices=True)
        one, other = residuals[here], self.residuals[before]
        correlation = self.correlation
        if len(here) >= _LEAST:
            correlation += (float(one @ other / np.sqrt((one @ one) * (other @ other))) - correlation) / _FRAMES
        share = fit.noise**2 / data.power(kept)
        quadruples, first = np.unique(np.concatenate([numbers, self.quadruples]), return_index=True)
        residuals = np.concatenate([residuals, self.residuals])[first]
        share = self.share + (share - self.share) / _FRAMES if self.share else share
        return Contradiction(quadruples, residuals, correlation, share)

    def doubted(self, contacts: tuple[Contact, ...]) -> tuple[Contact, ...]:
        """Contacts, believed the less the weaker they are beside an error that is the same in all frames: that may look
        like a contact, while noise does not."""
        if not self.systematic or not contacts:
            return contacts
        strengths = [abs(contact.strength) for contact in contacts]
        error = _UNSEEN * self.share * max(strengths) ** 2
        shares = [fit_confidence(error / max(strength**2, 1e-300)) for strength in strengths]
        return tuple(
            changed(one, confidence=share * one.confidence) for one, share in zip(contacts, shares, strict=True)
        )
