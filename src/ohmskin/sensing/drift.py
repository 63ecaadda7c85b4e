"""How the quiet skin drifts, followed from frame to frame beside the contacts that are fitted to each."""

from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.contacts import ContactFitter
from ohmskin.contacts.degraded import DOUBTED, Explained, risen
from ohmskin.contacts.uneven import UnevenDrift
from ohmskin.scan.smoothing import smoothing_factor

_FOLLOWED = 2.0  # s in which a change of contact impedances, or of what no contact explains, is followed to 1/e
_LEARNED = 0.1  # s between frames from which the latter is estimated
_DEGRADED = 0.1  # s in which what an electrode does whose contact has degraded is followed to 1/e


@dataclass(frozen=True, eq=False)
class Drift:
    """How the quiet skin has changed since its calibration.

    Args:
        change: Of two-terminal resistances (n_pairs,) (ohm).
        degraded_change: The part of it that degraded contacts cause (n_pairs,) (ohm).
        uneven: How unevenly the sheet drifts.
        unlearned: Time since drift of single pairs was last estimated (s).
        degraded: Electrodes whose contacts degraded within the last second.
        doubted: Time for which contacts are doubted because of these (s).
    """

    change: Floats
    degraded_change: Floats
    uneven: UnevenDrift
    unlearned: float = 0.0
    degraded: tuple[int, ...] = ()
    doubted: float = 0.0

    @classmethod
    def none(cls, fitter: ContactFitter) -> "Drift":
        """That of a skin just calibrated."""
        none = np.zeros(len(fitter.table.pairs))
        return cls(none, none, UnevenDrift.none(fitter.errors))

    def followed(self, fitter: ContactFitter, explained: Explained, quiet: bool, elapsed: float) -> "Drift":
        """The drift after one more frame. What contact impedances and smooth fields do is estimated while nothing
        touches; that of single pairs, and what degraded contacts do, always.

        Args:
            fitter: What fits contacts to data.
            explained: What was measured, less the drift so far, and what explains it.
            quiet: Whether nothing touches.
            elapsed: Time since the last frame (s).
        """
        lasting, usual, unlearned = self.degraded_change, self.change - self.degraded_change, self.unlearned + elapsed
        uneven, degraded, doubted = self.uneven, self.degraded, max(self.doubted - elapsed, 0.0)
        if (degradation := explained.degradation) is not None:
            lasting = lasting + smoothing_factor(elapsed, _DEGRADED) * degradation.change
            degraded, doubted = degradation.electrodes, DOUBTED
        elif explained.doubtful:
            doubted = DOUBTED
        elif fitter.errors.contacts is not None and quiet:
            likeliest, fields, errors = fitter.errors.drift(explained.data)
            usual = usual + smoothing_factor(elapsed, _FOLLOWED) * likeliest
            uneven = uneven.followed(fields, errors, smoothing_factor(_LEARNED, _FOLLOWED) / 2, elapsed)
        if unlearned >= _LEARNED:
            if not quiet and fitter.errors.contacts is not None and _may_be_degraded(fitter, explained):
                doubted = DOUBTED
            else:
                usual = usual + smoothing_factor(unlearned, _FOLLOWED) * _of_pairs(fitter, explained)
            unlearned = 0.0
        return Drift(usual + lasting, lasting, uneven, unlearned, degraded if doubted else (), doubted)


def _may_be_degraded(fitter: ContactFitter, explained: Explained) -> bool:
    return bool(risen(fitter, explained.data, explained.solution, fitter.model_error).any())


def _of_pairs(fitter: ContactFitter, explained: Explained) -> Floats:
    """Change (n_pairs,) of two-terminal resistances that neither contacts nor degraded electrodes cause, nor what is
    wrong with the contacts' model (ohm)."""
    data, solution = explained.data, explained.solution
    left = data.marginalised_common()
    if not len(solution.params):
        return left.drift()
    left = left.minus(solution.caused).marginalised_flat(solution.slopes)
    return left.drift() / (1 + (fitter.model_error * data.norm(solution.caused)) ** 2 / data.count)
