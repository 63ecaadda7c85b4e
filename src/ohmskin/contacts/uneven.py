"""Uneven drift: temperature and humidity change the conductivity of a sheet smoothly, as no touch does."""

from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.contacts.information import Errors
from ohmskin.forward import TransferModel
from ohmskin.forward.conductivity import cosines
from ohmskin.geometry import Domain
from ohmskin.scan.smoothing import smoothing_factor

_WAVES = 4  # half waves along each side, 0 to 3
_SEEN = 0.2  # s over which what quiet frames show is averaged
_SURE = 3.0  # standard deviations that it must exceed


def field_changes(model: TransferModel, domain: Domain) -> Floats:
    """Change of two-terminal resistances (n_pairs, k) with smooth fields of the logarithm of conductivity, a relative
    change by one in those of one half wave, less in others (ohm).

    Args:
        model: Of the untouched sheet.
        domain: The sheet.
    """
    waves = np.hypot(*np.indices((_WAVES, _WAVES))).ravel()
    fields = cosines(model.mesh.centroids, domain, np.eye(len(waves))[:, 1:] / waves[1:])
    return model.field_sensitivity(model.conductivity[:, None] * fields)


@dataclass(frozen=True, eq=False)
class UnevenDrift:
    """What quiet frames have shown lately of a sheet's uneven drift, beside what had been followed of it.

    Args:
        fields: Mean of the relative change of conductivity in each smooth field (k,) (1).
        variance: Of the noise in it (k,).
    """

    fields: Floats
    variance: Floats

    @classmethod
    def none(cls, errors: Errors) -> "UnevenDrift":
        """That of a skin just calibrated."""
        return cls(*np.zeros((2, 0 if errors.fields is None else errors.fields.shape[1])))

    @property
    def size(self) -> float:
        """How large it surely is, a relative change of conductivity (1)."""
        surely = self.fields**2 - _SURE**2 * self.variance
        return float(np.sqrt(np.clip(surely, 0.0, None).sum()))

    def followed(self, fields: Floats, errors: Floats, learned: float, elapsed: float) -> "UnevenDrift":
        """The same after one more frame on which nothing touches.

        Args:
            fields: What it shows of each field beside the drift so far (k,) (1).
            errors: Standard deviation of each (k,).
            learned: Variance of that in the drift so far, as a share of that in one frame (1).
            elapsed: Time since the last frame (s).
        """
        new = smoothing_factor(elapsed, _SEEN)
        kept = (1 - new) ** 2
        variance = kept * self.variance + (new**2 + (1 - kept) * learned) * errors**2
        return UnevenDrift(self.fields + new * (fields - self.fields), variance)
