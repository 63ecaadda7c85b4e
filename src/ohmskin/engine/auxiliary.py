"""Whether the auxiliary channel can be what it says: one that is silent, stuck, or unlike the contacts is told."""

from collections.abc import Sequence
from itertools import pairwise
from math import hypot, isfinite, sqrt

from ohmskin.sensing import Percept, SkinModel
from ohmskin.sensing.total import TotalForce

_FRAMES, _SECONDS = 10, 1.0  # for which something must be so
_SAME = 20  # frames with one reading, of a channel whose noise seldom repeats one
_SURE = 5.0  # standard deviations of the total
_APART = 0.5  # share of the total by which contacts are unlike it; and a factor of two standard deviations of theirs
_LASTS = ("negative", "apart")  # kinds that only contacts refute
_CHECK = "check its wire"
_SILENT = f"the auxiliary channel reads nothing, and forces are without it; {_CHECK}"
_NO_REST = f"the auxiliary channel read nothing at rest and is not used; {_CHECK}, then measure the quiet skin again"


class AuxiliaryCheck:
    """What is doubtful of the auxiliary channel, frame by frame."""

    def __init__(self) -> None:
        self._kind, self._since, self._frames, self._same, self._last = "", 0.0, 0, 0, float("nan")
        self._told = ("", "")

    @property
    def trusted(self) -> bool:
        """Whether forces may be brought to the total; `TotalForce` itself leaves out what is negative or missing."""
        return self._told[0] not in ("stuck", "apart")

    def doubt(self, known: SkinModel, percept: Percept) -> str:
        """What is doubtful after a frame, in words; empty if nothing is, or there is no such channel."""
        if not known.skin.auxiliary.kind:
            return ""
        found = self._suspicion(known, percept)
        if found is None and self._kind == "apart":  # it counts on with the next contact, so that taps tell it, too
            return self._told[1]
        kind, words = found or self._told
        now = percept.frames[-1].time
        if kind != self._kind or now < self._since:
            self._kind, self._since, self._frames = kind, now, 0
        self._frames += 1
        if kind != self._told[0] and self._frames >= _FRAMES and now - self._since >= _SECONDS:
            self._told = kind, words
        return self._told[1]

    def _suspicion(self, known: SkinModel, percept: Percept) -> tuple[str, str] | None:
        """Kind and words of what seems wrong, both empty if the channel agrees with contacts; None: nobody knows."""
        reading, unit = percept.frames[-1].auxiliary, "N" if known.skin.auxiliary.kind == "force" else "Pa"
        if not isfinite(known.quiet.rest):
            return "rest", _NO_REST
        if reading is None or not isfinite(reading):
            return "silent", _SILENT
        self._same, self._last = self._same + 1 if reading == self._last else 0, reading
        if self._same >= _SAME and _seldom_repeats(known.quiet.auxiliary):
            stuck = f"the auxiliary channel has stuck at {reading:.4g} {unit}"
            return "stuck", f"{stuck}, and forces are without it; {_CHECK}"
        total, variance = TotalForce(known).total(percept.frames)
        if total < -_SURE * sqrt(variance):
            why = "its sign or wire is wrong, or it has drifted: measure the quiet skin again"
            return "negative", f"the auxiliary channel shows {total:.3g} N, and forces are without it; {why}"
        unknown = None if self._told[0] in _LASTS or self._kind == "apart" else ("", "")
        forces = [contact.force for contact in percept.without_total if contact.force is not None]
        if not percept.contacts or not forces or len(forces) < len(percept.without_total):
            return unknown
        force, std = sum(forces), hypot(*(contact.force_std or 0.0 for contact in percept.without_total))
        if abs(total - force) <= max(_SURE * sqrt(variance), _APART * total):
            return "", ""
        if max(total, force) * force**2 < (force + std) ** 2 * min(total, force):
            return unknown
        why = f"forces are without it; {_CHECK}, the unit and auxiliary.gain, and whether anything else presses"
        return "apart", f"the auxiliary channel shows {total:.3g} N, the contacts {force:.3g} N, and {why}"


def _seldom_repeats(readings: Sequence[float]) -> bool:
    """Whether less than half of the readings are as the one before."""
    pairs = list(pairwise(readings))
    return sum(one == other for one, other in pairs) < len(pairs) / 2
