"""Touches that were there while the skin was calibrated: once they are lifted, the baseline has them and the skin not.

What a lift changes is minus what the press had changed, whatever its size: contacts fitted to the negated data are the
lifted ones. Where these explain several frames in a row better than contacts do, the baseline is corrected by what
they cause, and by what they leave, and is as good as one of the untouched skin.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ohmskin.arrays import Floats
from ohmskin.contacts import ContactFitter, Solution
from ohmskin.contacts.information import Information
from ohmskin.forward import TransferModel
from ohmskin.scan import Difference, newest
from ohmskin.sensing.model import SkinModel

_FRAMES, _INJECTIONS = 8, 100  # in a row at least
_PART = 0.7  # of the data, that one of them leaves at most
_UNEXPLAINED = 0.3  # share of the data that lifted touches leave at most


@dataclass(frozen=True, eq=False)
class Lifted:
    """Touches of the calibration that have been lifted.

    Args:
        positions: (n, 2) on the map of the skin (m).
        change: Of two-terminal resistances (n_pairs,) since the calibration (ohm).
    """

    positions: Floats
    change: Floats

    def refined(self, fitter: ContactFitter, scans: Sequence[Difference]) -> "Lifted":
        """The same with the change that `scans` of the whole skin show, unless something else touches it now."""
        data = fitter.information(*scans)[0]
        if data.unexplained(self.change) > _UNEXPLAINED:
            return self
        return replace(self, change=self.change + _shown(fitter, data.minus(self.change)))


@dataclass(frozen=True, eq=False)
class Suspicion:
    """How long lifted touches have explained the data better than contacts.

    Args:
        frames: In a row.
        scans: Of these, but for the first, within which the lift may have been.
        lifted: The touches, once they are sure.
    """

    frames: int = 0
    scans: tuple[Difference, ...] = ()
    lifted: Lifted | None = None

    def after(self, fitter: ContactFitter, new: Sequence[Difference]) -> "Suspicion":
        """The suspicion after one more frame, of these scans."""
        if _explained(fitter, new) is None:
            return Suspicion()
        scans = newest(new, self.scans, _INJECTIONS) if self.frames else ()
        enough = self.frames >= _FRAMES and sum(scan.pattern.n_inj for scan in scans) >= _INJECTIONS
        found = _explained(fitter, scans) if enough else None
        if found is None:
            return Suspicion(self.frames + 1, scans)
        touches, left = found
        return Suspicion(self.frames + 1, scans, Lifted(touches.params[:, :2], -touches.caused - left))


def _explained(fitter: ContactFitter, scans: Sequence[Difference]) -> tuple[Solution, Floats] | None:
    """The touches whose lift alone explains scans, and what it leaves (n_pairs,) (ohm); None if contacts, or neither,
    explain them better."""
    known = [scan for scan in scans if scan.known]
    if fitter.bipolar or not known:
        return None
    nominal, inflated = fitter.information(*(scan.negated for scan in known))
    scores = fitter.scores(nominal.marginalised_common())
    heights = fitter.heights(*scores)
    if heights.max() < max(fitter.bar, -heights.min()):
        return None
    one = fitter.added(inflated, *scores)  # which takes a hundredth of the time of the contacts of swapped wires
    if fitter.uncovered(nominal, tuple(fitter.covered(one.params))).unexplained(one.caused) > _PART:
        return None
    lifted = fitter.fit_information(nominal, inflated)
    left = nominal.minus(lifted.caused).marginalised_common()
    beside = fitter.uncovered(left, lifted.covered)
    contact = -fitter.heights(*fitter.scores(beside)).min() - fitter.model_error * nominal.norm(lifted.caused)
    if contact > fitter.bar or fitter.uncovered(nominal, lifted.covered).unexplained(lifted.caused) > _UNEXPLAINED:
        return None
    contacts = fitter.fit(*known)
    more, less = (fitter.price(one, len(one.covered)) for one in (contacts, lifted))
    return (lifted, _shown(fitter, nominal.minus(lifted.caused))) if less < more else None


def _shown(fitter: ContactFitter, data: Information) -> Floats:
    """The change (n_pairs,) that data show where nothing touches (ohm), that of contact impedances, too: touches on
    electrodes have changed these."""
    impedances = fitter.errors.drift(data)[0]
    return impedances + data.minus(impedances).marginalised_common().drift()


def corrected(known: SkinModel, sheet: TransferModel, lifted: Lifted) -> SkinModel:
    """The model of the skin as it is without the touches that were lifted.

    Args:
        known: As it was calibrated.
        sheet: As `known` was made from.
        lifted: The touches.
    """
    quiet = []
    for frame in known.quiet.frames:
        change = known.baseline.difference(frame).caused_by(lifted.change, known.pairs)
        gains = 1.0 if known.channels is None else known.channels.of(frame.pattern)[0]
        quiet.append(replace(frame, voltages=frame.voltages + gains * change))
    return SkinModel(known.skin, sheet, quiet, known.quality)
