"""A sensor is a drive and a reader: one step measures what the drive asks for and reads what is there."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from typing import Protocol

from ohmskin.arrays import changed
from ohmskin.contacts import Contact, Solution, on_skin
from ohmskin.drive import Drive
from ohmskin.inverse import Image
from ohmskin.inverse.estimators import Estimate
from ohmskin.registry import Plugin, naming
from ohmskin.scan import Difference, DrivePattern, Frame, newest
from ohmskin.sensing.confidence import as_measured, image_misfit
from ohmskin.sensing.detector import FaultDetector
from ohmskin.sensing.diagnosis import HELD, UNLIKE, Cause, Diagnosis, Finding
from ohmskin.sensing.forces import Forces, Presses
from ohmskin.sensing.learned import LearnedReader
from ohmskin.sensing.lifted import Lifted, Suspicion
from ohmskin.sensing.locator import Locator, targets_of
from ohmskin.sensing.model import SkinModel
from ohmskin.sensing.places import placed, placement_of
from ohmskin.sensing.readers import Belief, DetectionReader, FilterReader, FitReader, Reader
from ohmskin.sensing.total import TotalForce

Scan = Callable[[DrivePattern], Frame]
"""Drives a pattern once and returns its frame, such as `Device.scan`."""

_EXAMINED = 8  # frames that show nothing new, of which one is examined
_NOVEL = Finding(
    Cause("novel"), "the data are outliers of the presses learned from: contacts are located by the physical model"
)
_LONGEST = 1.0  # s between two frames, beyond which nothing more is forgotten


@dataclass(frozen=True)
class Thresholds:
    """Thresholds gamma_0 (eq. 6) of relative conductivity change (1), as learned from quiet frames.

    Args:
        base: Of the base image.
        final: Of the final image.
    """

    base: float
    final: float


@dataclass(frozen=True, eq=False)
class Percept:
    """The frames of one step, and the belief after it.

    Args:
        frames: The scans.
        belief: The belief after it.
        base_estimate: The estimate after the base scan, with its image; None where a frame has one scan.
        diagnosis: Detected faults of the instrument.
        lifted: Touches of the calibration that have been lifted, once they are sure; `corrected` takes them off.
        total_force: Of all contacts by the auxiliary channel (N); None without a sound one, or where it reads nothing.
        without_total: The contacts with forces by the electrodes alone, not brought to the auxiliary channel's total.
    """

    frames: tuple[Frame, ...]
    belief: Belief
    base_estimate: Estimate | None = field(default=None, repr=False)
    diagnosis: Diagnosis = field(default=Diagnosis(), repr=False)
    lifted: Lifted | None = field(default=None, repr=False)
    total_force: float | None = None
    without_total: tuple[Contact, ...] = field(default=(), repr=False)

    @property
    def image(self) -> Image:
        """The image on the mesh, made when it is first asked for."""
        return self.belief.image.on_mesh

    @property
    def base_image(self) -> Image:
        """Image of the base scan, likewise; of frames with one scan the image."""
        return self.image if self.base_estimate is None else self.base_estimate.image.on_mesh

    @property
    def detections(self) -> tuple[Contact, ...]:
        """The contacts of this frame alone, strongest first."""
        return self.belief.detections

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """The contacts to report, with ids, strongest first."""
        return self.belief.contacts

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Faults of the data, and differences to the presses learned from."""
        return self.diagnosis.findings + ((_NOVEL,) if self.belief.novel > HELD else ())


@dataclass(frozen=True, eq=False)
class SensorState:
    """State of a sensor after a step.

    Args:
        belief: The belief.
        turn: Scans so far.
        recent: The newest scans, of drives whose frames have few injections.
        time: When the last frame was taken (s, on the device's clock); None before the first.
        diagnosis: Detected faults of the instrument.
        presses: State of the presses fitted to contacts.
        located: The contacts last searched in a base scan.
        suspicion: Of touches that were there during calibration, and have been lifted.
        uses_total: Whether forces are brought to the auxiliary channel's total; not while that is known to be faulty.
    """

    belief: Belief
    turn: int = 0
    recent: tuple[Difference, ...] = field(default=(), repr=False)
    time: float | None = None
    diagnosis: Diagnosis = field(default=Diagnosis(), repr=False)
    presses: Presses = field(default=Presses(), repr=False)
    located: Solution | None = field(default=None, repr=False)
    suspicion: Suspicion = field(default=Suspicion(), repr=False)
    uses_total: bool = True


@dataclass(frozen=True, eq=False)
class Measured:
    """The scans of one frame.

    Args:
        frames: As measured.
        scans: Their changes against the quiet skin, the base scan at its usual currents.
        base_estimate: The image of the base scan; None where there is one scan.
        read: What is believed after them, given what was before, where they have been read already.
        located: The contacts last searched in a base scan.
    """

    frames: tuple[Frame, ...]
    scans: tuple[Difference, ...]
    base_estimate: Estimate | None = None
    read: Callable[[Belief], Belief] | None = None
    located: Solution | None = None


class Implementation(Protocol):
    """Measures and reads frames in another way, with the same outcome."""

    def measure(self, scan: Scan) -> Measured | tuple[Frame, ...]:
        """A frame measured and read; the scans made so far if it cannot read these data."""


class Sensor:
    """A drive and a reader. State in, state out; the same frames give the same contacts.

    Args:
        known: What is known of the quiet skin.
        drive: Chooses what to measure.
        reader: Estimates contacts.
        locator: Gives a drive of two scans the contacts that the first scan showed.
        thresholds: gamma_0, as learned.
        fuse: Whether the reader gets all scans of a frame, or the last one alone.
        window: Injections that a reader gets at least, scans of earlier frames included; 0: those of the frame alone.
        forces: Estimates the forces of contacts; None: the skin is not calibrated for that.

    Attributes:
        seconds: Time that its images of one frame take on this machine, as measured when it was made (s); 0: unknown.
        plugins: Parts of other packages.
    """

    def __init__(
        self,
        known: SkinModel,
        drive: Drive,
        reader: Reader,
        locator: Locator,
        thresholds: Thresholds,
        fuse: bool = True,
        window: int = 0,
        forces: Forces | None = None,
    ) -> None:
        self.known, self.drive, self.reader, self.locator = known, drive, reader, locator
        self.thresholds, self.fuse, self.window, self.forces = thresholds, fuse, window, forces
        self.detector, self.total = FaultDetector(known, window), TotalForce(known)
        self._placement, self._chart = placement_of(known), known.skin.chart
        self.fitter = reader.fitter if isinstance(reader, FilterReader | FitReader | LearnedReader) else None
        self.implementation: Implementation | None = None
        self.seconds, self.plugins = 0.0, tuple[Plugin, ...]()

    def with_drive(self, drive: Drive) -> "Sensor":
        """The same sensor with another `drive`, its own with other injections a frame; its state stays valid."""
        other = copy(self)
        other.drive = drive
        return other

    def start(self, before: Belief | None = None) -> SensorState:
        """The state while nothing touches the skin; ids and drift that the same reader estimated `before` are kept."""
        return SensorState(self.reader.start(before))

    def step(self, state: SensorState, scan: Scan) -> tuple[SensorState, Percept]:
        """Measure once what the drive chooses, and estimate contacts.

        Args:
            state: The state after the last step; begin with `start`.
            scan: Scans a pattern.

        A frame without any valid value changes nothing; after 0.5 s of such frames there are no contacts. While values
        have spikes, a contact is reported only if two frames show it.

        Raises:
            OhmskinError: If parts of other packages fail; the message names them.
        """
        with naming(*self.plugins):
            return self._stepped(state, scan)

    def _stepped(self, state: SensorState, scan: Scan) -> tuple[SensorState, Percept]:
        measured = self._measure(state, scan)
        last = measured.frames[-1]
        now = last.time if last.recorded is None else last.recorded
        elapsed = _LONGEST if state.time is None or not 0 <= now - state.time <= _LONGEST else now - state.time
        quick = all(self.known.soundness(frame).whole for frame in measured.frames) and not self._doubts(state)
        found = None if not quick else self._read(state, measured, measured.scans, state.diagnosis, elapsed)
        suspicion = Suspicion()
        if found is not None and not self._surprises(state.belief, found[0]):
            diagnosis = self.detector.passed(state.diagnosis, measured.scans, elapsed)
            scans, judged = measured.scans, True
        else:
            given, judged = (state.diagnosis, measured.frames, measured.scans, elapsed, state.belief.suspects), False
            diagnosis, scans = self.detector.examine(*given, state.belief.unexplained, state.belief.degraded)
            if state.suspicion.frames:
                suspicion = self._suspected(state, scans, diagnosis)
            if not suspicion.frames:
                if found is None or scans != measured.scans:
                    found = self._read(state, measured, scans, diagnosis, elapsed)
                more = len(found[0].detections) > len(state.belief.detections)
                if more or (self._unsure(found[0]) and self._every(state)):
                    suspicion = self._suspected(state, scans, diagnosis)
            if suspicion.frames:
                found = self.reader.start(state.belief), self._recent(state, scans, diagnosis)
        assert found is not None
        belief, recent = found
        if belief.detections and belief is not state.belief and isinstance(self.reader, DetectionReader):  # unjudged
            data = [*as_measured(scans, measured.scans), *recent[len(scans) if self.fuse else 1 :]]
            belief = belief.with_image_misfit(state.belief.unexplained if judged else image_misfit(self.known, data))
        if any(cause.spoils for cause in diagnosis.recent_causes):
            belief = belief.with_drift_of(state.belief)
        presses, contacts = state.presses, on_skin(belief.contacts, self._chart)
        if self.forces is not None and any(scan.known for scan in scans):
            undrifted = belief.without_drift(scans, self.known.pairs)
            presses, contacts = self.forces.update(presses, contacts, undrifted, elapsed)
        alone, total = contacts, self.total.known_total(measured.frames) if state.uses_total else None
        contacts = self.total(contacts, measured.frames) if state.uses_total else contacts
        turn, recent = state.turn + len(measured.frames), recent if self.window else ()
        known = turn, recent, now, diagnosis, presses, measured.located, suspicion, state.uses_total
        after = SensorState(belief, *known)
        believed = changed(belief, contacts=diagnosis.doubted(contacts, state.belief.contacts))
        reported = placed(self._placement, believed, scans, self.known.pairs)
        lifted = suspicion.lifted and self._remeasured(suspicion.lifted, diagnosis, scan)
        return after, Percept(measured.frames, reported, measured.base_estimate, diagnosis, lifted, total, alone)

    def _doubts(self, state: SensorState) -> bool:
        """Whether the next frame is examined whatever it shows, not only if it shows something new."""
        belief = state.belief
        troubled = state.diagnosis.troubled or state.suspicion.frames or belief.suspects or belief.degraded
        return bool(self._every(state) or troubled or self._unsure(belief))

    def _every(self, state: SensorState) -> bool:
        """Whether this is one of the frames that are examined whatever they show."""
        return state.turn // self.drive.scans % _EXAMINED == 0

    def _unsure(self, belief: Belief) -> bool:
        """Whether contacts may be what a fault looks like: they explain the data less well than they do usually."""
        return not belief.explains and self.implementation is None

    def _surprises(self, before: Belief, belief: Belief) -> bool:
        """Whether a frame shows anything new, which is to be doubted."""
        return len(belief.detections) > len(before.detections) or self._unsure(belief)

    def _read(
        self,
        state: SensorState,
        measured: Measured,
        scans: tuple[Difference, ...],
        diagnosis: Diagnosis,
        elapsed: float,
    ) -> tuple[Belief, tuple[Difference, ...]]:
        """What is believed after scans, and the newest scans that it is read from."""
        new, recent = scans if self.fuse else scans[-1:], self._recent(state, scans, diagnosis)
        if not any(scan.known for scan in new):
            return state.belief if diagnosis.without_data < HELD else self.reader.start(state.belief), recent
        if measured.read is not None and scans == measured.scans:
            return measured.read(state.belief), recent
        return self.reader.update(state.belief, new, recent, elapsed), recent

    def _recent(
        self, state: SensorState, scans: tuple[Difference, ...], diagnosis: Diagnosis
    ) -> tuple[Difference, ...]:
        """The newest scans that a frame is read from."""
        new = scans if self.fuse else scans[-1:]
        return tuple(newest(new, self.detector.without_bad(diagnosis, state.recent), self.window))

    def _suspected(self, state: SensorState, scans: tuple[Difference, ...], diagnosis: Diagnosis) -> Suspicion:
        """Whether touches that were there during calibration may have been lifted; none where data are spoilt."""
        if self.fitter is None or _spoilt(diagnosis):
            return Suspicion()
        return state.suspicion.after(self.fitter, scans)

    def _remeasured(self, lifted: Lifted, diagnosis: Diagnosis, scan: Scan) -> Lifted:
        """Lifted touches with what they leave wherever a drive may look that has measured a part of it so far."""
        if self.fitter is None or not self.drive.adjustable:
            return lifted
        frames = [scan(part) for part in self.drive.patterns[0].split(self.drive.injections)]
        diagnosis, scans = self.detector.examine(diagnosis, frames, [self.known.difference(one) for one in frames], 0.0)
        return lifted if _spoilt(diagnosis) else lifted.refined(self.fitter, scans)

    def _measure(self, state: SensorState, scan: Scan) -> Measured:
        if self.implementation is None or state.diagnosis.bad:
            return self.measure(state, scan)
        found = self.implementation.measure(scan)
        if isinstance(found, Measured):
            return found
        scanned = iter(found)  # whatever would be chosen now: frames name their own patterns
        return self.measure(state, lambda pattern: next(scanned, None) or scan(pattern))

    def measure(self, state: SensorState, scan: Scan) -> Measured:
        """The scans of one frame, each chosen from the data so far.

        Args:
            state: After the last step.
            scan: Drives a pattern once.
        """
        frames, scans = list[Frame](), list[Difference]()
        base_estimate: Estimate | None = None
        located = state.located
        targets = [*targets_of(state.belief.contacts), *state.belief.search_targets]
        for number in range(self.drive.scans):
            frames.append(scan(self.drive.next(targets, state.turn + number)))
            scans.append(self.known.difference(frames[-1]))
            if number + 1 < self.drive.scans:
                scans[-1] = self.known.at_usual_currents(scans[-1])
                sound = tuple(scans)
                if self._doubts(state):
                    _, sound = self.detector.examine(state.diagnosis, frames, scans, 0.0)
                if any(scan.known for scan in sound):
                    base_estimate = self.locator.estimate(sound)
                    targets, located = self.locator.targets(sound, base_estimate, state.belief, located)
        return Measured(tuple(frames), tuple(scans), base_estimate, located=located)


def _spoilt(diagnosis: Diagnosis) -> bool:
    """Whether data have faults; that no contacts explain them is none."""
    return any(cause.spoils for cause in diagnosis.recent_causes - {UNLIKE})
