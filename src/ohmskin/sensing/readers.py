"""Readers: what is there, from what was measured. A belief in, the next one out.

Other packages add theirs with an entry point of the group ``ohmskin.readers``: a function of a `SkinModel`, an
`Estimator` and a threshold that returns a `Reader`, its documentation's first line the title.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import itemgetter
from typing import Protocol, runtime_checkable

import numpy as np

from ohmskin.arrays import Floats, changed
from ohmskin.contacts import Contact, ContactFinder, ContactFitter, Solution
from ohmskin.contacts.degraded import Explained, strong, with_degraded
from ohmskin.contacts.information import Information
from ohmskin.contacts.solution import nothing
from ohmskin.drive import Target
from ohmskin.inverse import Image
from ohmskin.inverse.estimators import Estimate, Estimator, FrameWise, LazyEstimate
from ohmskin.scan import Difference, Pairs
from ohmskin.scan.pairs import in_series
from ohmskin.sensing.confidence import fit_confidence, image_confidence, scaled_confidence
from ohmskin.sensing.drift import Drift
from ohmskin.sensing.model import SkinModel
from ohmskin.tracking import ContactFilter, Tracker, Tracks, TrackState

_AFRESH = 0.5  # s between frames in which contacts are looked for afresh, lest a wrong place be kept
_DRIFT = 0.25  # share of the signal that contacts leave, beyond which it is drift,
_SURE = 2.0  # if noise does not explain what is beyond (deviations),
_LITTLE = 10.0  # and all is little (squared size over noise)
_MEAN = 12  # frames of few injections, over which a mean of what contacts leave doubts them, too


@dataclass(frozen=True, eq=False)
class Belief:
    """The belief after a frame: contacts, image, and other estimates of the skin.

    Args:
        estimate: Of the image.
        detections: The contacts of this frame alone, strongest first.
        contacts: The contacts to report: confirmed by several frames, with ids.
        tracks: State of the tracker.
        drift: Of the quiet skin, if the reader estimates it.
        suspects: Electrodes that alone showed a contact that others should have shown, too.
        unexplained: Share of the data that neither the contacts nor the image explain.
        novel: Time for which contacts have been located by the physical model because the data are outliers of those
            learned from (s).
        solution: The contacts fitted to the frame, if the reader fits them.
        searched: Time since contacts were last searched anew (s).
        explains: Whether contacts, if there are any, explain the data as well as usual.
        search_targets: Other places where a contact may be, for the drive to measure next.
    """

    estimate: Estimate
    detections: tuple[Contact, ...] = ()
    contacts: tuple[Contact, ...] = ()
    tracks: Tracks | TrackState = field(default=Tracks(), repr=False)
    drift: Drift | None = field(default=None, repr=False)
    suspects: tuple[int, ...] = ()
    unexplained: float = 0.0
    novel: float = 0.0
    solution: Solution | None = field(default=None, repr=False)
    searched: float = 0.0
    explains: bool = False
    search_targets: tuple[Target, ...] = ()

    @property
    def degraded(self) -> tuple[int, ...]:
        """Electrodes whose contacts degraded within the last second."""
        if isinstance(self.tracks, TrackState):
            return self.tracks.degraded
        return () if self.drift is None else self.drift.degraded

    @property
    def image(self) -> Image:
        """The image, made when it is first asked for."""
        return self.estimate.image

    def without_drift(self, scans: Sequence[Difference], pairs: Pairs) -> list[Difference]:
        """Scans without the drift of the quiet skin.

        Args:
            scans: As measured.
            pairs: Pairs of electrodes whose drift it is.
        """
        drift = None if self.drift is None else self.drift.change
        drift = self.tracks.drift if isinstance(self.tracks, TrackState) else drift
        return [scan if drift is None else scan.minus(drift, pairs) for scan in scans]

    def with_image_misfit(self, misfit: float) -> "Belief":
        """The same for contacts in an image that leaves a share `misfit` of the data unexplained (1)."""
        detections, contacts = (
            scaled_confidence(some, image_confidence(misfit)) for some in (self.detections, self.contacts)
        )
        return changed(self, detections=detections, contacts=contacts, unexplained=misfit)

    def with_drift_of(self, before: "Belief") -> "Belief":
        """The same with the drift of another belief, `before`: drift is not estimated from doubtful data."""
        tracks = self.tracks
        if isinstance(tracks, TrackState) and isinstance(before.tracks, TrackState):
            known = before.tracks
            tracks = changed(
                tracks,
                drift=known.drift,
                degraded_errors=known.degraded_errors,
                degraded=known.degraded,
                doubted=known.doubted,
                common_drift=known.common_drift,
            )
        return changed(self, tracks=tracks, drift=before.drift)


@runtime_checkable
class Reader(Protocol):
    """Estimates contacts and an image from the scans of a frame.

    Attributes:
        estimator: Estimator of the image.
    """

    @property
    def estimator(self) -> Estimator: ...

    def start(self, before: Belief | None = None) -> Belief:
        """The belief while nothing touches the skin; ids and drift that the same reader estimated `before` are kept."""
        ...

    def update(self, before: Belief, new: Sequence[Difference], recent: Sequence[Difference], elapsed: float) -> Belief:
        """The belief after one more frame; arguments as for `Estimator.update`.

        Raises:
            DataError: If no finite datum is left.
        """
        ...


def undriven(scans: Sequence[Difference]) -> list[Difference]:
    """What images are made of: contact impedances, which change, are no part of it."""
    return [scan.undriven for scan in scans]


def _steady(drift: Floats, pairs: Pairs, scans: Sequence[Difference]) -> list[Difference]:
    return undriven([scan.minus(drift, pairs) for scan in scans])


def estimated(
    estimator: Estimator,
    before: Estimate,
    count: int,
    recent: Sequence[Difference],
    elapsed: float,
    ready: Callable[[Sequence[Difference]], list[Difference]] = undriven,
) -> Estimate:
    """The estimate after one more frame. One without memory makes its scans ready when its image is first asked for.

    Args:
        estimator: Estimator of the image.
        before: The last estimate.
        count: Scans of the frame, the first of the recent ones.
        recent: As for `Estimator.update`.
        elapsed: Time since the last frame (s).
        ready: Makes of scans what images are made of.
    """
    if isinstance(estimator, FrameWise) and recent:
        return LazyEstimate(lambda: estimator.estimator.reconstruct(*ready(recent)))
    scans = ready(recent)
    return estimator.update(before, scans[:count], scans, elapsed)


@dataclass(frozen=True, eq=False)
class DetectionReader:
    """A `Reader` that finds contacts in the image of every frame, and tracks them by nearest neighbours.

    Args:
        estimator: Estimator of the image.
        detect: Finds contacts, given the estimate and the recent scans.
        tracker: Follows them.
    """

    estimator: Estimator
    detect: Callable[[Estimate, Sequence[Difference]], Sequence[Contact]]
    tracker: Tracker

    def start(self, before: Belief | None = None) -> Belief:
        """The belief while nothing touches the skin."""
        return Belief(self.estimator.start(), tracks=Tracks() if before is None else before.tracks)

    def update(self, before: Belief, new: Sequence[Difference], recent: Sequence[Difference], elapsed: float) -> Belief:
        """The belief after one more frame."""
        estimate = self.estimator.update(before.estimate, undriven(new), undriven(recent), elapsed)
        return self.follow(before, estimate, self.detect(estimate, recent))

    def follow(self, before: Belief, estimate: Estimate, found: Sequence[Contact]) -> Belief:
        """The belief after a frame.

        Args:
            before: The belief after the last frame.
            estimate: The image of this frame.
            found: The contacts of this frame.
        """
        assert isinstance(before.tracks, Tracks)
        tracks, contacts = self.tracker.update(before.tracks, found)
        return Belief(estimate, tuple(found), contacts, tracks, explains=not found)


@dataclass(frozen=True, eq=False)
class FitReader:
    """A `Reader` that fits contacts to every frame, and tracks them by nearest neighbours.

    Args:
        estimator: Estimator of the image.
        fitter: What fits contacts to data; base scans are looked at likewise.
        tracker: Follows them.
    """

    estimator: Estimator
    fitter: ContactFitter
    tracker: Tracker

    def start(self, before: Belief | None = None) -> Belief:
        """The belief while nothing touches the skin."""
        if before is None:
            return Belief(self.estimator.start())
        return Belief(self.estimator.start(), tracks=before.tracks, drift=before.drift)

    def update(self, before: Belief, new: Sequence[Difference], recent: Sequence[Difference], elapsed: float) -> Belief:
        """The belief after one more frame. Contact impedances are estimated while nothing touches; other drift always,
        together with the contacts."""
        assert isinstance(before.tracks, Tracks)
        pairs = self.fitter.table.pairs
        drift = before.drift or Drift.none(self.fitter)
        ready = undriven if before.drift is None else partial(_steady, drift.change, pairs)
        estimate = estimated(self.estimator, before.estimate, len(new), recent, elapsed, ready)
        fitter, searched = self.fitter.drifting(drift.uneven.size), before.searched + elapsed
        known, searched = (before.solution, searched) if searched < _AFRESH else (None, 0.0)
        explained, unexplained = self._explained(fitter, recent, drift, known)
        newly = fit_confidence(unexplained) < 1 == fit_confidence(before.unexplained)
        if newly and len(new) > 1 and np.isfinite(new[-1].volts).any():
            last = self._explained(fitter, new[-1:], drift, known)  # what came or went within the frame is in it
            explained, unexplained = min((explained, unexplained), last, key=itemgetter(1))
        solution = explained.solution
        poor = self.fitter.poor(explained.data, solution.cost)
        if poor and len(solution.params) == fitter.most:
            unexplained = 1.0  # there are more than are looked for, so that any of these may be wrong
        found = scaled_confidence(self.fitter.contacts(solution), fit_confidence(unexplained))
        drift = drift.followed(fitter, explained, not found, elapsed)
        tracks, contacts = self.tracker.update(before.tracks, found)
        belief = Belief(estimate, found, contacts, tracks, drift, unexplained=unexplained)
        return changed(belief, solution=solution, searched=searched, explains=not found or not poor)

    def _explained(
        self, fitter: ContactFitter, scans: Sequence[Difference], drift: Drift, known: Solution | None
    ) -> tuple[Explained, float]:
        """Scans explained by contacts, and the share of them that is not; where there are more contacts than are
        `known`, or they are doubted, explained by worse contacts of electrodes, too."""
        data = fitter.information(*scans, drift=drift.change)
        found = fitter.fit_information(*data, before=known)
        explained, more = Explained(found, data[0]), len(found.params) > (0 if known is None else len(known.params))
        if more or (drift.doubted and len(found.params)):
            before = (found if known is None else known).params
            explained = with_degraded(fitter, data, found, before[strong(fitter, before)])
        solution, nominal = explained.solution, explained.data
        if solution.covered:
            nominal = nominal.excluding(in_series(solution.covered, fitter.table.pairs))
        if solution.shapes is not None and solution.shapes.size:
            nominal = nominal.marginalised(solution.shapes)
        signal, left = nominal.signals(solution.caused)
        unexplained = nominal.share_unexplained(signal, left)
        if self._is_drift(nominal, solution, signal, left):
            solution, unexplained = nothing(len(solution.caused)), 0.0
        return changed(explained, solution=solution, data=nominal), unexplained

    @staticmethod
    def _is_drift(nominal: Information, solution: Solution, signal: float, left: float) -> bool:
        """Whether contacts leave a large part of a small change, so that it is rather drift.

        Of the signal beyond noise, `signal` is all, `left` what they leave.
        """
        sure = left > _DRIFT * signal + _SURE * np.sqrt(2 * nominal.count)
        return bool(len(solution.params)) and sure and signal < _LITTLE * nominal.count


@dataclass(frozen=True, eq=False)
class FilterReader:
    """A `Reader` that tracks contacts by a filter on the data.

    Args:
        estimator: Makes the image, from the newest frames without drift.
        filter: The filter.
        injections: Least number of injections for an image: fingers move little between frames.
    """

    estimator: Estimator
    filter: ContactFilter
    injections: int

    @property
    def fitter(self) -> ContactFitter:
        """What fits contacts to data."""
        return self.filter.fitter

    def start(self, before: Belief | None = None) -> Belief:
        """The belief while nothing touches the skin; the estimate of its drift is kept."""
        if before is None:
            return Belief(self.estimator.start(), tracks=self.filter.start())
        assert isinstance(before.tracks, TrackState)
        return Belief(self.estimator.start(), tracks=self.filter.lifted(before.tracks))

    def update(self, before: Belief, new: Sequence[Difference], recent: Sequence[Difference], elapsed: float) -> Belief:
        """The belief after one more frame; its scans are processed one after the other."""
        state = before.tracks
        assert isinstance(state, TrackState)
        suspected = set(state.suspects)
        for number, scan in enumerate(new):
            state = self.filter.update(state, scan, 0.0 if number else elapsed)
        explains, unexplained = self.filter.explains(state), state.unexplained
        if not explains and len(state.pressing) >= self.fitter.most:
            unexplained = 1.0  # there are more than are looked for, so that any of these may be wrong
        mean = before.unexplained + (unexplained - before.unexplained) / min(state.turn, _MEAN)
        contacts = scaled_confidence(state.contacts, fit_confidence(max(unexplained, mean)))
        suspects = tuple(suspected & set(state.suspects))  # twice in a row: several at once contradict one, too
        recent = state.recent(self.injections)
        estimate = estimated(self.estimator, before.estimate, len(new), recent, elapsed)
        belief = Belief(estimate, contacts, contacts, state, suspects=suspects, unexplained=mean)
        if state.possible >= 0:
            place = Target.possible(self.fitter.places[state.possible], self.fitter.table.radius)
            belief = changed(belief, search_targets=(place,))
        return changed(belief, explains=explains)


def centroid(known: SkinModel, estimator: Estimator, threshold: float) -> Reader:
    """Centroids of the image's regions, as in the paper."""
    imaging = known.skin.imaging
    finder = ContactFinder(threshold, imaging.fraction, imaging.dip, imaging.bipolar)
    cells = estimator.cells
    return DetectionReader(estimator, lambda estimate, _: finder.find(estimate.image, cells), Tracker(cells.period))


def fit(known: SkinModel, estimator: Estimator, threshold: float) -> Reader:
    """Contacts fitted to the data of each frame."""
    return FitReader(estimator, known.fitter, Tracker(known.model.mesh.period))


def tracked(known: SkinModel, estimator: Estimator, threshold: float) -> Reader:
    """Contacts tracked from frame to frame on the data."""
    follow = ContactFilter(known.fitter, repeats=known.baseline.repeats)
    return FilterReader(estimator, follow, known.skin.imaging.pairs)
