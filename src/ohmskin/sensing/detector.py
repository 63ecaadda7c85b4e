"""Detection of faults: what no sheet can give is left out of a frame before anything is read from it.

Every scan is held against all resistive networks (`ohmskin.scan.coherence`), which needs no model of the sheet or of a
touch. Where it contradicts them all, the least is left out that makes the rest agree: a few values, an injection, an
electrode; an offset or hum on all voltages alike is taken off. If nothing helps, all data count less, by as much as
they contradict each other. An electrode that was left out is used again when its data agree with the others'. Wires
that are exchanged, or touch each other, contradict no network, but what they change is known (`ohmskin.sensing.wires`).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import exp, sqrt

import numpy as np
from scipy.special import chdtri

from ohmskin.arrays import Bools, Floats, changed
from ohmskin.scan import Difference, Frame, newest
from ohmskin.scan.coherence import Coherence, InstrumentErrors, NetworkData
from ohmskin.scan.smoothing import smoothing_factor
from ohmskin.sensing.confidence import common_change
from ohmskin.sensing.contradiction import Contradiction
from ohmskin.sensing.diagnosis import HELD, Cause, Diagnosis
from ohmskin.sensing.model import SkinModel
from ohmskin.sensing.remedies import Remedy, agrees, likeliest, limit, without_offset, without_spikes
from ohmskin.sensing.wires import WireFaults

_MODEL = 0.03  # share of a change by which an instrument may err
_STANDS_OUT = 5.0  # times another electrode's changes, by which those of an open one are larger
_NOT_ALIKE = 1.5  # times the noise that is left where an offset was taken off, which is not quite the same on all
_UNLIKE = 0.4  # share of the signal that no contacts explain, above which it is reported; real skins have up to a third
_STEADY = 0.02  # by which such a change must have changed for another number to be told
_COMMON = 0.04  # change of all voltages together, above which it is reported,
_ALIKE = 0.95  # if it is that share of the signal; presses beside none are a quarter of it at most
_SLOWLY = 0.3  # s over which that share is a mean: fingers that come and go are explained within some frames
_NOISY = 1.3  # times the quiet skin's noise, above which it is reported
_AGAIN = 0.1  # s after which a fault of wires is looked for again beside bad electrodes
_JUMPED = 4.0  # times the power of changes that no fault of wires explained, from which on one is looked for again
_MOST_BAD = 0.25  # share of the electrodes that may be left out
_SOUND_FRAMES, _SOUND, _SURELY = 5, 0.2, 50  # frames and s for which an electrode must agree to be used again; enough
_UNLUCKY = 0.999  # probability that a misfit is larger
_MEMORY = 40  # frames by which an offset is distinguished from hum
_EAGER, _PATIENCE = 5, 8  # frames in which a cause is looked for, and between two searches after these


class FaultDetector:
    """Finds what contradicts in scans, and leaves it out.

    Args:
        known: What is known of the quiet skin.
        window: Injections that are looked at together where one frame has fewer; 0: those of a frame.
    """

    def __init__(self, known: SkinModel, window: int = 0) -> None:
        self._known, self._window, self._n_elec = known, window, len(known.skin.electrodes)
        self._instrument = InstrumentErrors(known.white, known.gain, _MODEL)
        self._wires = WireFaults(known)
        self._most = int(_MOST_BAD * self._n_elec)
        # near pairs all over a large skin measure next to nothing twice, and a network of all of them takes seconds
        self._redundant = known.pairs.whole
        self._last: tuple[Difference, frozenset[int], tuple[float, int]] | None = None

    def examine(
        self,
        before: Diagnosis,
        frames: Sequence[Frame],
        scans: Sequence[Difference],
        elapsed: float,
        suspects: Sequence[int] = (),
        unexplained: float = 0.0,
        degraded: Sequence[int] = (),
    ) -> tuple[Diagnosis, tuple[Difference, ...]]:
        """What is known after one frame more, and its scans without what contradicts.

        Args:
            before: What was known.
            frames: The scans of the frame as measured.
            scans: Their changes against the quiet skin.
            elapsed: Time since the last frame (s).
            suspects: Electrodes whose data the reader does not believe.
            unexplained: Share of the data of the last frame that its contacts did not explain.
            degraded: Electrodes whose contacts have degraded.

        Returns:
            The diagnosis, and the scans: the very same objects where nothing contradicts.
        """
        power = self._wires.power(scans)
        again = int((before.time + elapsed) / _AGAIN) > int(before.time / _AGAIN)
        tried = power and (before.miswired or (before.bad and again) or power > _JUMPED * before.without_fault)
        wires = self._wires.found(scans, before.wires, thorough=not before.bad) if tried else None
        scans = scans if wires is None else [wires.repaired(scan, self._known.pairs) for scan in scans]
        now, looked, noise = before.time + elapsed, newest(scans, before.scans, self._window), self._instrument.noise
        silent, causes = self._currents(before, frames, scans, now)
        suspected = {Cause("open", (suspect,)) for suspect in suspects} | ({wires.cause} if wires else set())
        causes |= suspected | {Cause("degraded", (electrode,)) for electrode in degraded}
        unlike = before.unlike + smoothing_factor(elapsed, _SLOWLY) * (unexplained - before.unlike)
        causes |= {Cause("unlike")} if unlike > _UNLIKE else set()
        common = before.common
        if any(scan.known for scan in scans):
            factor, alike = common_change(self._known, scans)
            if alike > _ALIKE and abs(factor) > _COMMON:
                causes |= {Cause("common")}
                common = factor if abs(factor - common) > _STEADY else common  # words that change are hard to read
        lost = self._lost(frames)
        causes |= {Cause(kind) for kind, count in lost.items() if count}
        empty = not any(np.isfinite(scan.volts).any() for scan in scans)
        causes |= {Cause("nothing")} if empty else set()
        fits = [*(self._fit(scan, before.bad) for scan in scans), *before.fits][: len(looked)]
        squares, freedom = (sum(each) for each in zip(*fits, strict=True))
        remedy, error, unresolved, offsets, cleaned = None, noise, 0, before.offsets, tuple(scans)
        contradiction = Contradiction()
        if freedom and squares > limit(freedom) * freedom:
            remedy, error, contradiction = self._remedy(before, looked, len(scans))
            if remedy is None:
                unresolved = before.unresolved + 1
                error = max(error, *(noise * _at_most(*fit) for fit in fits[: len(scans)]))
                cleaned = tuple(scan.times(noise / error) for scan in scans)
                causes |= {Cause("noise")} if error > _NOISY * noise else set()
            else:
                causes.add(remedy.cause)
                repaired = _repaired(looked, remedy)
                cleaned = cleaned if remedy.cause.electrodes else repaired[: len(scans)]
        elif (
            self._redundant and Cause("offset") in before.recent_causes
        ):  # hum is nothing twice a period: not doubted then
            data, kept, _ = self._data(looked, before.bad)
            remedy = without_offset(data, kept, self._times(looked))
            cleaned = cleaned if remedy is None else _repaired(scans, remedy)
        if remedy is not None and remedy.off is not None:
            offsets = (*offsets, (now, float(remedy.off[0])))[-_MEMORY:]
            rest = max(remedy.fit.noise / noise, 1.0)
            cleaned = tuple(scan.times(1 / (_NOT_ALIKE * rest)) for scan in cleaned)
        blamed = {e for cause in causes if cause.spoils for e in cause.electrodes}
        blamed = {e for e in blamed if any(scan.pattern.uses([e]).any() for scan in scans)}
        blamed = blamed if len(blamed | before.bad.keys()) <= self._most else set()
        after = Diagnosis(
            findings=before.findings,
            bad=self._watched({**before.bad, **dict.fromkeys(blamed, (0, 0.0))}, scans, elapsed, blamed),
            time=now,
            occurrences=before.occurrences,
            silent=silent,
            offsets=offsets,
            error=max(error, before.error * exp(-elapsed / HELD)),
            fits=tuple(fits),
            scans=() if not self._window else looked if remedy is None or remedy.off is not None else repaired,
            unresolved=unresolved,
            contradiction=contradiction,
            wires=wires,
            without_fault=power if tried else min(power, before.without_fault),
            unlike=unlike,
            common=common,
            lost=lost,
            without_data=before.without_data + elapsed if empty else 0.0,
            recent=Diagnosis.recent_for(elapsed),
        ).with_causes(causes, noise, suspected)
        return after, self.without_bad(after, cleaned)

    def passed(self, before: Diagnosis, scans: Sequence[Difference], elapsed: float) -> Diagnosis:
        """What is known after one frame more that shows nothing new, and is not examined."""
        looked = newest(scans, before.scans, self._window) if self._window else ()
        return changed(before, time=before.time + elapsed, scans=looked)

    def without_bad(self, diagnosis: Diagnosis, scans: Sequence[Difference]) -> tuple[Difference, ...]:
        """Scans without what bad electrodes take part in."""
        if not diagnosis.bad:
            return tuple(scans)
        out = list(diagnosis.bad)
        return tuple(replace(s, volts=np.where(s.pattern.uses(out), np.nan, s.volts)) for s in scans)

    def _data(self, scans: Sequence[Difference], bad: Iterable[int]) -> tuple[NetworkData, Bools, Coherence]:
        """The data of scans, which of them are used, and how well these agree."""
        data = NetworkData(scans, self._n_elec, self._instrument)
        kept = data.without(bad)
        return data, kept, data.coherence(kept)

    def _times(self, scans: Sequence[Difference]) -> Floats:
        """When each voltage (n_meas,) of scans was converted, from the start of its scan (s)."""
        return np.concatenate([self._known.skin.cost.times(scan.pattern) for scan in scans])

    def _fit(self, scan: Difference, bad: Mapping[int, object]) -> tuple[float, int]:
        """Squared misfit of one scan, and its degrees of freedom; remembered, as a base scan is examined twice."""
        if not self._redundant:
            return 0.0, 0
        if self._last is None or self._last[0] is not scan or self._last[1] != bad.keys():
            fit = self._data([scan], bad)[2]
            self._last = scan, frozenset(bad), (fit.squares, fit.freedom)
        return self._last[2]

    def _remedy(
        self, before: Diagnosis, scans: Sequence[Difference], newest: int
    ) -> tuple[Remedy | None, float, Contradiction]:
        """What makes scans agree, unless a search has just failed; and by how much they differ (V), and how."""
        data, kept, whole = self._data(scans, before.bad)
        left = before.contradiction.after(data, kept, whole, newest)
        if before.unresolved >= _EAGER and before.unresolved % _PATIENCE:
            return None, whole.noise, left
        times, hum = self._times(scans), Cause("offset") in before.recent_causes
        remedy = without_offset(data, kept, times) if self._window or hum else None  # mostly it lasts
        if self._window and remedy is None:
            remedy = without_spikes(data, kept)
            if remedy is None and hum:  # a finger may have come since the older scans
                data, kept, _ = self._data(scans[:newest], before.bad)
                remedy = without_offset(data, kept, times[: len(kept)])
        elif remedy is None:
            remedy = likeliest(data, kept, whole, times, self._most - len(before.bad))
        return remedy, whole.noise, left if remedy is None else before.contradiction

    def _watched(
        self, bad: Mapping[int, tuple[int, float]], scans: Sequence[Difference], elapsed: float, blamed: set[int]
    ) -> dict[int, tuple[int, float]]:
        """The bad electrodes, less those whose data have agreed with the others' for long enough."""
        watched = {}
        for e, (frames, seconds) in bad.items():
            watched[e] = 0, 0.0
            if e not in blamed and not self._redundant:
                watched[e] = frames + 1, seconds + elapsed
            elif e not in blamed:
                data, kept, fit = self._data(scans, [other for other in bad if other != e])
                if (kept & data.known & data.uses(e)).any() and agrees(fit):
                    watched[e] = frames + 1, seconds + elapsed
        return {e: (n, s) for e, (n, s) in watched.items() if n < _SOUND_FRAMES or (s < _SOUND and n < _SURELY)}

    def _lost(self, frames: Sequence[Frame]) -> dict[str, int]:
        """How many voltages are missing, and how many are at the end of the converter's range."""
        lost = {"missing": 0, "clipped": 0}
        for frame in frames:
            flowing, sound, _, whole = self._known.soundness(frame)
            if not whole:
                missing = np.isnan(frame.voltages)
                lost["missing"] += int(missing.sum())
                lost["clipped"] += int((~missing & ~sound & flowing[frame.pattern.measurements[:, 0]]).sum())
        return lost

    def _currents(
        self, before: Diagnosis, frames: Sequence[Frame], scans: Sequence[Difference], now: float
    ) -> tuple[dict[int, float], set[Cause]]:
        """Since when (s) no current flows through electrodes, and what follows of that."""
        if not before.silent and all(self._known.soundness(frame).currents for frame in frames):
            return {}, set()
        alive, pairs = set[int](), set[tuple[int, int]]()
        for frame in frames:
            flowing = self._known.soundness(frame).flowing
            alive |= set(frame.pattern.injections[flowing].ravel().tolist())
            pairs |= {(a, b) for a, b in np.sort(frame.pattern.injections[~flowing], axis=1).tolist()}
        silent = {e: since for e, since in before.silent.items() if e not in alive}
        for e in {e for pair in pairs for e in pair} - alive:
            silent.setdefault(e, now)
        causes = set[Cause]()
        for pair in pairs:
            since = np.array([silent.get(e, np.inf) for e in pair])
            changes = _changes(scans, pair)
            if since[0] != since[1]:  # the one that has been silent for longer
                causes |= {Cause("open", (pair[int(np.argmin(since))],))} if now > since.min() else set()
            elif changes.max() > _STANDS_OUT * max(changes.min(), self._instrument.noise):
                causes.add(Cause("open", (pair[int(np.argmax(changes))],)))
            elif now > since[0]:  # not in one frame alone, which lacks that injection
                causes.add(Cause("current", pair))
        return silent, causes or ({Cause("currents")} if pairs else set())  # of one frame, perhaps


def _at_most(squares: float, freedom: int) -> float:
    """Times by which the errors of data with that misfit may be larger than expected, given its degrees of freedom."""
    return max(1.0, sqrt(squares / chdtri(freedom, _UNLUCKY))) if freedom else 1.0


def _changes(scans: Sequence[Difference], pair: tuple[int, int]) -> Floats:
    """Root mean square change of voltages that each (2,) of two electrodes takes part in without the other (V)."""
    rms = np.zeros(2)
    for k, (one, other) in enumerate((pair, pair[::-1])):
        own = np.concatenate([scan.volts[scan.pattern.uses(one) & ~scan.pattern.uses(other)] for scan in scans])
        rms[k] = np.sqrt(np.nanmean(own**2)) if np.isfinite(own).any() else 0.0
    return rms


def _repaired(scans: Sequence[Difference], remedy: Remedy) -> tuple[Difference, ...]:
    """Scans less what contradicts in them, as far as the remedy goes."""
    repaired, start = [], 0
    off = np.zeros(len(remedy.kept)) if remedy.off is None else remedy.off
    for scan in scans:
        if start == len(remedy.kept):  # the remedy is of newer ones alone
            break
        own = slice(start, start := start + scan.pattern.n_meas)
        repaired.append(replace(scan, volts=np.where(remedy.kept[own], scan.volts - off[own], np.nan)))
    return tuple(repaired)
