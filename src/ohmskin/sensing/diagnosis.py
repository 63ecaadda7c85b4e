"""Diagnosis: what is known to be wrong with the data and the wires they came over, in plain words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.contacts import Contact
from ohmskin.scan import Difference, Pairs
from ohmskin.scan.quality import in_words
from ohmskin.sensing.confidence import fit_confidence, scaled_confidence
from ohmskin.sensing.contradiction import Contradiction

MAINS = (50.0, 60.0)  # Hz
HELD = 0.5  # s for which what was reported or believed is held without new data
_CONFIRMED, _WITHIN = 3, 1.0  # times within s that something is detected before it is reported;
_AT_LEAST = 4  # frames, if these are longer
_BRIDGED = 0.5  # how far contacts are believed while electrodes touch each other: the bridge acts on these, too
_STEADY = 2.0  # mean of an offset over its scatter, from which on it is no hum


class Cause(NamedTuple):
    """The kind of a fault of the data, and its electrodes.

    Args: kind: ``open``, ``exchanged``, ``shorted``, ``degraded``, ``current``, ``currents``, ``unlike``, ``common``,
            ``nothing``, ``missing``, ``clipped``, ``spikes``, ``injection``, ``offset`` or ``noise``.
        electrodes: Those concerned.
    """

    kind: str
    electrodes: tuple[int, ...] = ()

    @property
    def spoils(self) -> bool:
        """Whether data are doubtful because of it; what loose contacts and common changes do is known, and followed."""
        return self.kind not in ("degraded", "common")


UNLIKE, _SPIKES = Cause("unlike"), Cause("spikes")


@dataclass(frozen=True)
class Finding:
    """A fault of the data.

    Args:
        cause: Its kind and electrodes.
        words: The same in plain words.
    """

    cause: Cause
    words: str


@dataclass(frozen=True, eq=False)
class WireFault:
    """A fault of wires.

    Args:
        cause: Its kind, ``exchanged`` or ``shorted``, and electrodes.
        change: (n_pairs,) what it changes of the two-terminal resistances (ohm).
    """

    cause: Cause
    change: Floats

    def repaired(self, scan: Difference, pairs: Pairs) -> Difference:
        """A scan without what a bridge does to the others; an exchange of two wires does nothing to these.

        Args:
            scan: What has changed.
            pairs: Of electrodes.
        """
        return scan.minus(self.change, pairs) if self.cause.kind == "shorted" else scan


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Detected faults of an instrument and its wires after a frame.

    Args:
        findings: The faults.
        bad: Electrodes that are left out; for each the number of frames and the time (s) for which it has agreed since.
        time: Since the start (s).
        occurrences: Recent times (s) of each cause, newest last.
        silent: Time (s) since which no current has flowed through driven electrodes.
        offsets: Times (s) of the newest frames with an offset, and the offset (V).
        error: Standard deviation of a voltage in the worst recent frame (V).
        fits: Squared misfit and degrees of freedom of each of the newest scans that were examined, newest first.
        scans: The newest scans as measured, newest first, if frames are parts of what an image needs.
        unresolved: Frames since the first contradiction whose cause is not found.
        contradiction: What of the newest frames contradicts, if its cause is not found.
        wires: Wires that are exchanged, or touch each other, in the newest frame.
        without_fault: Mean square of changes that no fault of wires explained (V2).
        unlike: Share of the data of recent frames that no contacts explain.
        common: By what share all voltages had changed together when that was last most of a change, within 0.02 (1).
        lost: How many voltages of the newest frame are missing, or clipped.
        without_data: Time since the last frame with any valid value (s).
        recent: For how long a cause is a recent one (s).
    """

    findings: tuple[Finding, ...] = ()
    bad: Mapping[int, tuple[int, float]] = field(default_factory=dict)
    time: float = 0.0
    occurrences: Mapping[Cause, tuple[float, ...]] = field(default_factory=dict, repr=False)
    silent: Mapping[int, float] = field(default_factory=dict, repr=False)
    offsets: tuple[tuple[float, float], ...] = field(default=(), repr=False)
    error: float = 0.0
    fits: tuple[tuple[float, int], ...] = field(default=(), repr=False)
    scans: tuple[Difference, ...] = field(default=(), repr=False)
    unresolved: int = 0
    contradiction: Contradiction = field(default=Contradiction(), repr=False)
    wires: WireFault | None = None
    without_fault: float = 0.0
    unlike: float = 0.0
    common: float = 0.0
    lost: Mapping[str, int] = field(default_factory=dict)
    without_data: float = 0.0
    recent: float = _WITHIN

    @staticmethod
    def recent_for(elapsed: float) -> float:
        """For how long a cause is a recent one (s).

        Args:
            elapsed: Time between frames (s).
        """
        return max(_WITHIN, _AT_LEAST * elapsed)

    @property
    def recent_causes(self) -> set[Cause]:
        """The causes of the last second, or of the last frames if these take longer."""
        return {cause for cause, times in self.occurrences.items() if self.time - times[-1] < self.recent}

    @property
    def miswired(self) -> bool:
        """Whether wires have been exchanged, or touched each other, recently."""
        return any(cause.kind in ("exchanged", "shorted") for cause in self.recent_causes)

    @property
    def troubled(self) -> bool:
        """Whether there was any fault recently."""
        return bool(self.findings or self.bad or self.recent_causes)

    def doubted(self, contacts: tuple[Contact, ...], before: Sequence[Contact]) -> tuple[Contact, ...]:
        """Contacts as far as they can be believed beside the faults.

        Args:
            contacts: Those of a frame.
            before: Those of the frame before.
        """
        if _SPIKES in self.recent_causes:  # one more may look like a light touch, for one frame
            contacts = tuple(one for one in contacts if one.id in {old.id for old in before})
        if UNLIKE in self.recent_causes:  # the frames before count, too, however well this one is explained
            contacts = scaled_confidence(contacts, fit_confidence(self.unlike))
        if self.wires is not None and self.wires.cause.kind == "shorted":
            contacts = scaled_confidence(contacts, _BRIDGED)
        return self.contradiction.doubted(contacts)

    def with_causes(self, causes: set[Cause], noise: float, confirmed: set[Cause]) -> "Diagnosis":
        """The same with the causes to report: seen several times recently, or reported before and seen recently.

        Args:
            causes: The faults of the newest frame.
            noise: Standard deviation of a voltage on the quiet skin (V).
            confirmed: Those of the causes that are reported at once.
        """
        occurrences = {
            one: at
            for one, times in self.occurrences.items()
            if (at := tuple(t for t in times if self.time - t < self.recent))
        }
        occurrences |= {cause: (*occurrences.get(cause, ())[1 - _CONFIRMED :], self.time) for cause in causes}
        before = {finding.cause for finding in self.findings} | confirmed
        recent_causes = {cause: times for cause, times in occurrences.items() if self.time - times[-1] < HELD}
        causes = {cause for cause, times in recent_causes.items() if len(times) >= _CONFIRMED or cause in before}
        findings = tuple(Finding(cause, self._words(cause, noise)) for cause in sorted(causes))
        return replace(self, occurrences=occurrences, findings=findings)

    def _words(self, cause: Cause, noise: float) -> str:
        """A cause in plain words."""
        electrodes = " and ".join(map(str, cause.electrodes))
        match cause.kind:
            case "open":
                many = f"electrodes {electrodes} are" if len(cause.electrodes) > 1 else f"electrode {electrodes} is"
                return f"{many} open, or a wire is loose; left out"
            case "exchanged":
                ends = cause.electrodes[::2], cause.electrodes[1::2]
                pairs = ", and of ".join(f"{a} and {b}" for a, b in zip(*ends, strict=True))
                return f"the wires of electrodes {pairs} are exchanged; left out"
            case "shorted":
                return f"electrodes {electrodes} touch each other, or their wires do; left out"
            case "degraded":
                return f"the contact of electrode {electrodes} has degraded; tighten it, or calibrate again"
            case "current":
                return f"no current flows between electrodes {electrodes}: one of them is open, or both; left out"
            case "currents":
                return "currents of some injections are implausible; left out"
            case "unlike":
                causes = "another skin, swapped wires, damage, or more contacts than six"
                return f"no contacts explain the change: {causes}; lift all, and calibrate again"
            case "common":
                causes = "temperature, or the instrument's current or gain; calibrate again"
                return f"all voltages have changed by {100 * self.common:+.0f} % together: {causes}"
            case "nothing":
                return "no voltage can be used; check the device's cable and power"
            case "missing":
                return f"{self.lost.get('missing') or 'some'} voltages of a frame are missing; left out"
            case "clipped":
                return f"{self.lost.get('clipped') or 'some'} voltages of a frame clip; left out"
            case "spikes":
                return "single values contradict all others; left out"
            case "injection":
                return "the current of an injection contradicts its voltages; left out"
            case "offset":
                return f"{_common(*np.array(self.offsets).T)} on all voltages; subtracted"
            case _:
                contradiction = (
                    f"the voltages contradict each other by {in_words(self.error)} ({in_words(noise)} at rest)"
                )
                if self.contradiction.systematic:
                    return f"{contradiction} in each frame alike: gains of channels have changed; calibrate again"
                return f"{contradiction}: interference, bad cables, or touches faster than a scan; all get less weight"


def _common(times: Floats, offsets: Floats) -> str:
    """What offsets (n,) (V) at some times (s) are: steady, or hum of the mains, if that explains most of them."""
    if abs(offsets.mean()) > _STEADY * offsets.std():
        return f"offset of {in_words(float(offsets.mean()))}"
    size = in_words(float(np.sqrt(2) * offsets.std()))
    left = {}
    for mains in MAINS:
        phase = 2 * np.pi * mains * times
        waves = np.column_stack([np.cos(phase), np.sin(phase)])
        rest = offsets - waves @ np.linalg.lstsq(waves, offsets, rcond=None)[0]
        left[mains] = float(rest @ rest / (offsets @ offsets))
    best = min(left, key=lambda mains: left[mains])
    return f"{best:.0f} Hz hum of {size}" if left[best] < 0.5 else f"interference of {size}"
