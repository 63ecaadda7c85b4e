"""Messages of the loop to its user, each once."""

from collections.abc import Callable, Sequence

from ohmskin.engine.auxiliary import AuxiliaryCheck
from ohmskin.errors import OhmskinError
from ohmskin.sensing import Cause, Finding, Percept, SkinModel
from ohmskin.sensing.identity import changed_since
from ohmskin.sensing.lifted import Lifted
from ohmskin.skin import Mode

SLOW = 0.1  # s a frame, from which on an estimator is too slow for the loop

_LIFTED = "what touched the skin during calibration was lifted, and is taken off the baseline; better calibrate again"
_DETECTED = (
    "a contact was detected before the calibration: if something touched the skin then, lift it and calibrate again"
)


class Notices:
    """Reports messages, and holds the current one.

    Args:
        report: Called with every sentence.

    Attributes:
        message: What is true now and worth knowing; empty if nothing is.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report, self.message = report, ""
        self._unread, self._faults, self._awaited, self._total = False, "", "", ""
        self._auxiliary = AuxiliaryCheck()
        self._slow: Mode | None = None
        self._found: list[Cause] = []

    def say(self, message: str) -> None:
        """Report a message that holds until the next one."""
        if message != self.message:
            self._report(message)
        self.message = message

    def calibrated(self, notes: Sequence[str], known: SkinModel, detected: bool, live: bool) -> None:
        """Report the outcome of a calibration: the `notes` of what was done, what remains to be doubted of what is
        `known`, and whether a contact was `detected` just before, which may have been there if the skin is `live`."""
        findings, detected = known.quality.findings if known.quality else [], detected and live
        standing = "; ".join([*findings, *changed_since(known, live)])
        for sentence in [*notes, *([standing] if standing else []), *([_DETECTED] if detected else [])]:
            self._report(sentence)
        self._faults, self._total, self._auxiliary = standing, "", AuxiliaryCheck()
        self.message = _DETECTED if detected else self._standing

    def lifted(self, touches: Lifted) -> None:
        """Report touches of the calibration that have been lifted, and were taken off; that there were some holds."""
        places = ", ".join(f"({1e3 * x:.0f}, {1e3 * y:.0f}) mm" for x, y in touches.positions)
        self._report(f"{_LIFTED}, at {places}")
        self._faults = self._faults if _LIFTED in self._faults else "; ".join(filter(None, (self._faults, _LIFTED)))
        self.message = self._standing

    def awaited(self, what: str, then: str = "") -> None:
        """Report what is waited for, which holds until it is empty, `then` with what comes of it."""
        if what or then:
            self._report(what or then)
        self._awaited = what
        self.message = self._standing

    def findings(self, findings: Sequence[Finding]) -> None:
        """Report faults of the data when they begin, and when none is left."""
        words = "; ".join(finding.words for finding in findings)
        causes = [finding.cause for finding in findings]
        if causes != self._found:
            self._report(words or "the data are valid again")
        if causes or self._found:
            self.message = words or self._standing
        self._found = causes

    @property
    def total_trusted(self) -> bool:
        """Whether forces may be brought to the total of the auxiliary channel."""
        return self._auxiliary.trusted

    def auxiliary(self, known: SkinModel, percept: Percept) -> None:
        """Report what is doubtful of the auxiliary channel, which holds while it is."""
        if (doubt := self._auxiliary.doubt(known, percept)) == self._total:
            return
        self._report(doubt or "the auxiliary channel is plausible again")
        self._total = doubt
        if not self._found:
            self.message = self._standing

    def unread(self, why: str) -> None:
        """Say why a frame cannot be read, such as by a rule that finds no parameter for its data; empty if it was."""
        if why:
            self.say(why)
        elif self._unread:
            self.message = ""
        self._unread = bool(why)

    def pace(self, mode: Mode, seconds: float, rate: float) -> None:
        """Say when an estimator is why the loop is slow, by the time that an image takes (s) and the loop's cycles per
        second, 0 while these are not known."""
        if mode != self._slow and seconds > SLOW and 0 < rate < 1 / SLOW:
            self._slow = mode
            self.say(
                f"estimator {mode.estimator} takes {seconds:.2g} s a frame on this machine: {1 / seconds:.2g} frames/s"
            )
        elif self._slow not in (None, mode):
            self._slow, self.message = None, ""

    @property
    def _standing(self) -> str:
        return "; ".join(part for part in (self._faults, self._total, self._awaited) if part)


def lost(error: OhmskinError) -> str:
    """The message for a lost device, to which the loop reconnects by itself."""
    why = str(error).removesuffix("; connect again")
    return f"device lost: {why} Reconnecting" if why.endswith("?") else f"device lost: {why}; reconnecting"
