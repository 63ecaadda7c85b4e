"""How the quiet skin drifts, followed from frame to frame beside the contacts that are fitted to each.

The model of a contact errs by a few percent of what it explains, which is far more than a skin drifts in a minute. That
error stays the same while the contact rests: what changes meanwhile is drift.
"""

from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats, changed
from ohmskin.contacts import ContactFitter
from ohmskin.contacts.degraded import DOUBTED, Explained, rises_beside, sure_rise
from ohmskin.contacts.uneven import UnevenDrift
from ohmskin.scan.smoothing import smoothing_factor

_FOLLOWED = 2.0  # s in which a change of contact impedances, or of what no contact explains, is followed to 1/e
_LEARNED = 0.1  # s between frames from which what no contact explains is estimated
_RESTED = 1.0  # s of rest over which what seems to come beside contacts is averaged, before changes of it are followed
_MOVED = 0.1  # of the variance of noise, from which on what may be wrong with a change of contacts counts as a move
_DEGRADED = 0.1  # s in which what an electrode does whose contact has degraded is followed to 1/e


@dataclass(frozen=True, eq=False)
class ApproximationError:
    """What seems to come beside contacts in one frame, or in the mean of several.

    Args:
        caused: Change of two-terminal resistances by the contacts (n_pairs,) (ohm).
        change: That beside them, whatever they are exactly (n_pairs,) (ohm).
        fields: Relative change of conductivity in each smooth field (k,) (1).
        rises: By how many standard deviations each contact impedance rises (n_elec,).
        time: Over which this is the mean (s).
        risen: Whether one has risen while something touched, so that its contact may have degraded.
    """

    caused: Floats
    change: Floats
    fields: Floats
    rises: Floats
    time: float
    risen: bool = False

    @classmethod
    def of(cls, fitter: ContactFitter, explained: Explained, time: float) -> tuple["ApproximationError", Floats]:
        """That of one frame, and the error of each field (k,) (1)."""
        solution = explained.solution
        left = explained.data.minus(solution.caused).excluding(solution.slopes)
        likeliest, fields, errors = fitter.errors.drift(left)
        change = likeliest + left.minus(likeliest).marginalised_common().drift()
        rises = rises_beside(fitter, explained.data, solution.params)
        return cls(solution.caused, change, fields, rises, time), errors

    def averaged(self, newest: "ApproximationError") -> "ApproximationError":
        """The mean with that of a later frame."""
        time = self.time + newest.time
        share = newest.time / time
        return changed(
            self,
            caused=self.caused + share * (newest.caused - self.caused),
            change=self.change + share * (newest.change - self.change),
            fields=self.fields + share * (newest.fields - self.fields),
            rises=self.rises + share * (newest.rises - self.rises),
            time=time,
        )


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
        resting: What seemed to come beside the contacts when they came to rest; None: nothing touches.
    """

    change: Floats
    degraded_change: Floats
    uneven: UnevenDrift
    unlearned: float = 0.0
    degraded: tuple[int, ...] = ()
    doubted: float = 0.0
    resting: ApproximationError | None = None

    @classmethod
    def none(cls, fitter: ContactFitter) -> "Drift":
        """That of a skin just calibrated."""
        none = np.zeros(len(fitter.table.pairs))
        return cls(none, none, UnevenDrift.none(fitter.errors))

    def followed(self, fitter: ContactFitter, explained: Explained, quiet: bool, elapsed: float) -> "Drift":
        """The drift after one more frame. While something touches, what comes beside it is followed once it rests.

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
        elif quiet:
            likeliest, fields, errors = fitter.errors.drift(explained.data)
            usual = usual + smoothing_factor(elapsed, _FOLLOWED) * likeliest
            uneven = uneven.followed(fields, errors, smoothing_factor(_LEARNED, _FOLLOWED) / 2, elapsed)
        resting, degraded = None if quiet else self.resting, degraded if doubted else ()
        followed = Drift(usual + lasting, lasting, uneven, unlearned, degraded, doubted, resting)
        return followed._learned(fitter, explained, quiet) if unlearned >= _LEARNED else followed

    def _learned(self, fitter: ContactFitter, explained: Explained, quiet: bool) -> "Drift":
        """The drift with that of single pairs; beside contacts, with all that has changed since these came to rest."""
        elapsed, new = self.unlearned, smoothing_factor(self.unlearned, _FOLLOWED)
        if quiet:
            change = self.change + new * explained.data.marginalised_common().drift()
            return changed(self, change=change, unlearned=0.0)
        newest, errors = ApproximationError.of(fitter, explained, elapsed)
        resting, data = self.resting or newest, explained.data
        moved = fitter.model_error * data.norm(newest.caused - resting.caused)
        limit = sure_rise(fitter, data, newest.caused)
        risen = resting.risen or bool((newest.rises > resting.rises + limit).any())
        followed = changed(self, unlearned=0.0, doubted=DOUBTED if risen else self.doubted)
        if resting is newest or moved**2 > _MOVED * data.count or risen > resting.risen:
            return changed(followed, resting=changed(newest, risen=risen))
        if resting.time < _RESTED:
            return changed(followed, resting=resting.averaged(newest))
        change = self.change + new * (newest.change - resting.change)
        uneven = self.uneven.followed(newest.fields - resting.fields, errors, new / 2, elapsed)
        return changed(followed, change=change, uneven=uneven)
