"""From scans to contacts: one cycle of the adaptive loop, without its clock and its device's moods.

A cycle is the same in every mode: base scan, image, regions above gamma_0; an adaptive mode then lets eq. (7) choose
pairs for these regions and images once more; contacts are found in the last image, in ``P`` modes in the data themselves.
Where it can, a `FastCycle` does the same in about a quarter of the time; frames with gaps it leaves to the plain way.

A mode whose choice is a policy tracks instead: one scan of few injections a cycle, chosen by what is believed of the contacts,
which it then corrects (`ContactFilter`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from ohmskin.cycle import FastCycle
from ohmskin.drive import Mode, OptimalDrive, Policy, PositionDrive, Target
from ohmskin.errors import DataError
from ohmskin.forward import ContactTable, TransferModel
from ohmskin.geometry.domain import Floats
from ohmskin.inverse import GaussNewton, Image
from ohmskin.scan import Baseline, Difference, DrivePattern, Frame, Quality
from ohmskin.skin import Skin
from ohmskin.touch import Contact, ContactFilter, ContactFinder, Explainer, Scene, find_regions, learn_threshold
from ohmskin.touch.likelihood import gain_directions

Scan = Callable[[DrivePattern], Frame]

_LEAST_QUIET = 8  # images, below which a threshold learned from them would be luck
_CONTACT_ERROR = 0.05  # share of its signal that a disc gets wrong of a contact; up to 0.04 on the contact-layer twin
_SIGMAS = 5.0  # height of a threshold above the largest predicted noise, where it cannot be learned


@dataclass(frozen=True)
class Thresholds:
    """gamma_0 (eq. 6) of one mode, relative conductivity change: for the base image and for the final one."""

    base: float
    final: float


@dataclass(frozen=True)
class Sight:
    """What one cycle measured and saw.

    Args:
        frames: The base scan and, in adaptive modes, the optimal one; in tracking modes the one scan.
        draw: Makes the images, base and final.
        contacts: Contacts; in tracking modes already tracked.
    """

    frames: tuple[Frame, ...]
    draw: Callable[[], tuple[Image, Image]] = field(repr=False)
    contacts: tuple[Contact, ...]

    @cached_property
    def _images(self) -> tuple[Image, Image]:
        return self.draw()

    @property
    def base(self) -> Image:
        """Image of the base scan; in tracking modes the final one."""
        return self._images[0]

    @property
    def image(self) -> Image:
        """The final image; in fixed modes the base image itself. In tracking modes it is made when it is first asked for."""
        return self._images[1]


class Perception:
    """All that is learned of a quiet skin, ready to see in any mode.

    Args:
        skin: Its description.
        model: Forward model of the untouched sheet as described; its conductivity is scaled to the quiet frames.
        quiet: Frames of the untouched skin, of every pattern that will be driven.
        quality: Which electrodes to leave out or to count less, by `ohmskin.scan.assess`; all count alike unless given.

    Attributes:
        baseline: Reference data and noise.
        model: The model, scaled.
        thresholds: gamma_0 by mode name; a mode must be here before it can `see`.
    """

    def __init__(self, skin: Skin, model: TransferModel, quiet: Sequence[Frame], quality: Quality | None = None) -> None:
        self.skin, self.quality = skin, quality
        if quality is not None:
            quiet = [quality.clean(frame) for frame in quiet]
        self.baseline = Baseline.learn(quiet)
        pattern = quiet[0].pattern
        measured, modelled = self.baseline.reference(pattern), model.voltages(pattern)
        known = np.isfinite(measured)
        if not known.any():
            raise DataError("no quiet voltage is known; check the device, or which electrodes were left out")
        modelled, measured = modelled[known], measured[known]
        self.model = model.scaled(float(modelled @ modelled / (modelled @ measured)))
        # noise-free recordings exist; a ten-thousandth of the largest voltage keeps the problem well posed
        floor = 1e-4 * float(np.nanmax(np.abs(np.where(np.isfinite(quiet[0].voltages), quiet[0].voltages, np.nan))))
        imaging = skin.imaging
        self.estimator = GaussNewton(
            self.model, max(self.baseline.difference_noise, floor), amplitude=imaging.amplitude, model_error=imaging.model_error
        )
        self.thresholds: dict[str, Thresholds] = {}
        self._cycles: dict[str, FastCycle] = {}
        self._usual = {  # currents (A) of the pairs driven
            tuple(pair): current
            for frame in quiet
            for pair, current in zip(frame.pattern.injections.tolist(), frame.currents, strict=True)
            if np.isfinite(current) and current != 0
        }
        self._white, self._gain = _kinds_of_noise(self.baseline, quiet)

    def learn_thresholds(self, mode: Mode, scan: Scan, cycles: int = 40) -> None:
        """Learn gamma_0 of a mode from `cycles` quiet cycles; from predicted noise where `cycles` are too few to tell.

        In tracking modes it is only shown: whether there is a contact is tested on the data.
        """
        policy = mode.policy
        if policy or isinstance(mode.optimal, PositionDrive):
            _ = self.filter  # made now, not in the first cycle
        if policy:
            middle = self.model.mesh.centroids[:, :2].mean(axis=0)
            policy.next([Target(middle, 1e-6 * np.eye(2), 1e-4, self.skin.imaging.mesh_size)], 0)  # makes its tables, likewise
        if policy or cycles < _LEAST_QUIET:
            image = self.estimator.reconstruct(self._difference(scan(policy.next((), 0) if policy else mode.base)))
            predicted = _SIGMAS * float(image.noise_std(np.arange(self.model.mesh.n_elem)).max())
            self.thresholds[mode.name] = Thresholds(predicted, predicted)
        else:
            images = [self._look(mode, scan, threshold=np.inf)[1:3] for _ in range(cycles)]
            base, final = (learn_threshold([self._peak(pair[k]) for pair in images]) for k in (0, 1))
            self.thresholds[mode.name] = Thresholds(base, final)
        self._cycles.pop(mode.name, None)
        if (cycle := self._compiled(mode)) is not None:
            self._cycles[mode.name] = cycle

    @cached_property
    def filter(self) -> ContactFilter:
        """What follows contacts; made when it is first needed, in a second or so."""
        size = self.skin.imaging.mesh_size
        table = ContactTable(self.model, radius=1.5 * size, pitch=0.7 * size)
        floor = self.estimator.noise / max(self.baseline.difference_noise, 1e-300)  # above one on recordings without noise
        explainer = Explainer(table, self._white * max(floor, 1.0), _CONTACT_ERROR, falls=self.skin.imaging.falls)
        return ContactFilter(explainer, repeats=self.baseline.repeats, gain=self._gain)

    def see(self, mode: Mode, scan: Scan) -> Sight:
        """One cycle of a mode that does not track: scan as the mode asks, and say what is there."""
        if (cycle := self._cycles.get(mode.name)) and cycle.mode is mode:
            return self._see_quickly(cycle, mode, scan)
        return self._see_plainly(mode, scan)

    def _see_plainly(self, mode: Mode, scan: Scan) -> Sight:
        thresholds = self.thresholds[mode.name]
        frames, base, image, differences = self._look(mode, scan, thresholds.base)
        if isinstance(mode.optimal, PositionDrive):
            explainer = self.filter.explainer
            unsure = [gain_directions(d, d.currents * self.baseline.reference(d.pattern), self._gain) for d in differences]
            contacts = explainer.contacts(explainer.fit(*differences, unsure=block_diag(*unsure)))
        else:
            imaging = self.skin.imaging
            finder = ContactFinder(thresholds.final, imaging.fraction, imaging.dip, imaging.falls)
            contacts = tuple(finder.find(image, self.model.mesh))
        return Sight(frames, lambda: (base, image), contacts)

    def _see_quickly(self, cycle: FastCycle, mode: Mode, scan: Scan) -> Sight:
        frames: list[Frame] = []

        def checked(pattern: DrivePattern) -> tuple[Floats, Floats]:
            frame = scan(pattern)
            frames.append(frame)
            if frame.pattern != pattern:  # a recording has what was driven then
                raise DataError("another pattern was driven than was asked for")
            return frame.voltages, frame.currents

        try:
            chosen = cycle.look(*checked(mode.base))
            contacts = cycle.see(*checked(cycle.pattern(chosen)))
        except DataError:  # that, or a voltage or current is missing
            scanned = iter(frames)  # whatever would be chosen now: frames tell their own patterns
            return self._see_plainly(mode, lambda pattern: next(scanned, None) or scan(pattern))

        def drawn(values: Floats, *used: Frame) -> Image:
            return Image(values, lambda cells: self.estimator.reconstruct(*map(self._difference, used)).noise_std(cells))

        images = (
            drawn(cycle.base_image.astype(float), frames[0]),
            drawn(cycle.image.astype(float), *frames[0 if mode.fuse else 1 :]),
        )
        return Sight(tuple(frames), lambda: images, tuple(contacts))

    def _compiled(self, mode: Mode) -> FastCycle | None:
        """The cycle of an adaptive mode, compiled; None where it does not apply."""
        imaging, thresholds = self.skin.imaging, self.thresholds[mode.name]
        if not isinstance(mode.optimal, OptimalDrive) or self.quality is not None or imaging.falls:
            return None
        if not isinstance(self.estimator, GaussNewton) or self.estimator.positive or self.model.mesh.nodes.shape[1] != 2:
            return None
        gammas = thresholds.base, thresholds.final
        try:
            currents = np.array([self._usual[tuple(pair)] for pair in mode.base.injections.tolist()])
            return FastCycle(self.estimator, mode, gammas, currents, self.baseline, imaging.fraction, imaging.dip)
        except (DataError, KeyError):  # not all of it was seen while the skin was quiet
            return None

    def track(self, policy: Policy, scan: Scan, scene: Scene, elapsed: Callable[[Frame], float]) -> tuple[Scene, Sight]:
        """One cycle of a tracking mode: scan what the policy asks for, and say what is there.

        Args:
            policy: Chooses the injections.
            scan: Scans.
            scene: What is believed; start with ``filter.start()``.
            elapsed: Tells the time from the frame before to this one (s).
        """
        frame = scan(policy.next(scene.targets, scene.turn))
        difference = self._difference(frame)
        reference = difference.currents * self.baseline.reference(frame.pattern)
        scene = self.filter.update(scene, difference, elapsed(frame), reference)
        recent = scene.recent(self.skin.imaging.pairs)

        def draw() -> tuple[Image, Image]:
            """From as many injections as an optimal scan has: frames follow each other faster than fingers move."""
            image = self.estimator.reconstruct(*recent)
            return image, image

        return scene, Sight((frame,), draw, scene.contacts)

    def _look(self, mode: Mode, scan: Scan, threshold: float) -> tuple[tuple[Frame, ...], Image, Image, tuple[Difference, ...]]:
        mesh = self.model.mesh
        frame = scan(mode.base)
        difference = self._difference(frame)
        base = self.estimator.reconstruct(difference)
        strongest = float(base.values.max())
        regions = find_regions(base.values, mesh, max(threshold, self.skin.imaging.fraction * strongest), self.skin.imaging.dip)
        if mode.optimal is None:
            return (frame,), base, base, (difference,)
        if regions:
            anchors = [region.anchors for region in regions]
        else:  # nothing stands out: look closer where the base image is highest, which finds touches too weak for gamma_0
            peak = mesh.centroids[int(np.argmax(base.values))]
            anchors = [mesh.centroids[mesh.closest_elements(peak[None], 3)[0]]]
        chosen = scan(mode.optimal.pattern(anchors))
        optimal = self._difference(chosen)
        used = (difference, optimal) if mode.fuse else (optimal,)
        return (frame, chosen), base, self.estimator.reconstruct(*used), used

    def _difference(self, frame: Frame) -> Difference:
        if self.quality is None:
            return self.baseline.difference(frame)
        return self.quality.weigh(self.baseline.difference(self.quality.clean(frame)))

    def _peak(self, image: Image) -> float:
        return float(np.abs(image.values).max() if self.skin.imaging.falls else image.values.max())


def _kinds_of_noise(baseline: Baseline, quiet: Sequence[Frame]) -> tuple[float, float]:
    """White noise of a difference (V), and the relative error of a measured current that all voltages of an injection share (1)."""
    count, white, along, squares, injections = 0, 0.0, 0.0, 0.0, 0
    for frame in quiet if baseline.repeats > 1 else ():
        difference = baseline.difference(frame)
        reference = difference.currents * baseline.reference(frame.pattern)
        known = np.isfinite(difference.volts) & np.isfinite(reference)
        which = frame.pattern.measurements[known, 0]
        u, r = reference[known], difference.volts[known]
        uu, ur, rr = (np.bincount(which, product, frame.pattern.n_inj) for product in (u * u, u * r, r * r))
        used = (np.bincount(which, minlength=frame.pattern.n_inj) > 1) & (uu > 0)
        share = ur[used] ** 2 / uu[used]
        count += int(np.bincount(which, minlength=frame.pattern.n_inj)[used].sum())
        white, along = white + float((rr[used] - share).sum()), along + float(share.sum())
        squares, injections = squares + float(uu[used].sum()), injections + int(used.sum())
    if count <= injections or white <= 0:
        return baseline.difference_noise, 0.0
    bias = (1 + 1 / baseline.repeats) / (
        1 - 1 / baseline.repeats
    )  # the quiet frames' own mean is taken off; a later frame's is not
    variance = white / (count - injections)
    gain = max(along / injections - variance, 0.0) / (squares / injections)
    return float(np.sqrt(variance * bias)), float(np.sqrt(gain * bias))
