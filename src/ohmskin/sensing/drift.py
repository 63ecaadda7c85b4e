"""How the quiet skin drifts, followed from frame to frame beside the contacts that are fitted to each."""

from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.contacts import ContactFitter
from ohmskin.contacts.degraded import DOUBTED, Explained, risen

_FOLLOWED = 2.0  # s in which a change of contact impedances, or of what no contact explains, is followed to 1/e
_LEARNED = 0.1  # s between frames from which the latter is estimated
_DEGRADED = 0.1  # s in which what an electrode does whose contact has degraded is followed to 1/e


@dataclass(frozen=True, eq=False)
class Drift:
    """How the quiet skin has changed since its calibration.

    Args:
        change: Of two-terminal resistances (n_pairs,) (ohm).
        degraded_change: The part of it that degraded contacts cause (n_pairs,) (ohm).
        unlearned: Time since drift of single pairs was last estimated (s).
        degraded: Electrodes whose contacts degraded within the last second.
        doubted: Time for which contacts are doubted because of these (s).
    """

    change: Floats
    degraded_change: Floats
    unlearned: float = 0.0
    degraded: tuple[int, ...] = ()
    doubted: float = 0.0

    @classmethod
    def none(cls, n_pairs: int) -> "Drift":
        """That of a skin just calibrated."""
        return cls(*np.zeros((2, n_pairs)))

    def followed(self, fitter: ContactFitter, explained: Explained, quiet: bool, elapsed: float) -> "Drift":
        """The drift after one more frame. While nothing touches it is drawn towards what contact impedances explain;
        that of single pairs, and what degraded contacts do, is estimated always.

        Args:
            fitter: What fits contacts to data.
            explained: What was measured, less the drift so far, and what explains it.
            quiet: Whether nothing touches.
            elapsed: Time since the last frame (s).
        """
        lasting, usual, unlearned = self.degraded_change, self.change - self.degraded_change, self.unlearned + elapsed
        degraded, doubted = self.degraded, max(self.doubted - elapsed, 0.0)
        if (degradation := explained.degradation) is not None:
            lasting = lasting + _share(elapsed, _DEGRADED) * degradation.change
            degraded, doubted = degradation.electrodes, DOUBTED
        elif explained.doubtful:
            doubted = DOUBTED
        elif fitter.errors.contacts is not None and quiet:
            usual = usual + _share(elapsed, _FOLLOWED) * (fitter.errors.drift(explained.data, usual) - usual)
        if unlearned >= _LEARNED:
            if not quiet and fitter.errors.contacts is not None and _may_be_degraded(fitter, explained):
                doubted = DOUBTED
            else:
                usual = usual + _share(unlearned, _FOLLOWED) * _of_pairs(fitter, explained)
            unlearned = 0.0
        return Drift(usual + lasting, lasting, unlearned, degraded if doubted else (), doubted)


def _share(elapsed: float, time: float) -> float:
    """Share of a change that is followed in some time, if it is followed to 1/e in another."""
    return float(-np.expm1(-elapsed / time))


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
