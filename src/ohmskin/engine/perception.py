"""From scans to contacts: one cycle of the adaptive loop, without its clock and its device's moods.

A cycle is the same in every mode: base scan, image, regions above gamma_0; an adaptive mode then lets eq. (7) choose
pairs for these regions and images once more; contacts are found in the last image.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ohmskin.drive import Mode
from ohmskin.errors import DataError
from ohmskin.forward import TransferModel
from ohmskin.inverse import GaussNewton, Image
from ohmskin.scan import Baseline, Difference, DrivePattern, Frame, Quality
from ohmskin.skin import Skin
from ohmskin.touch import Contact, ContactFinder, Region, find_regions, learn_threshold

Scan = Callable[[DrivePattern], Frame]

_LEAST_QUIET = 8  # images, below which a threshold learned from them would be luck
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
        frames: The base scan and, in adaptive modes, the optimal one.
        base: Image of the base scan.
        image: The final image; in fixed modes the base image itself.
        regions: Regions of the base image above gamma_0, strongest first.
        contacts: Contacts of the final image, not yet tracked.
    """

    frames: tuple[Frame, ...]
    base: Image
    image: Image
    regions: tuple[Region, ...]
    contacts: tuple[Contact, ...]


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

    def learn_thresholds(self, mode: Mode, scan: Scan, cycles: int = 40) -> None:
        """Learn gamma_0 of a mode from `cycles` quiet cycles; from predicted noise where `cycles` are too few to tell."""
        if cycles < _LEAST_QUIET:
            image = self.estimator.reconstruct(self._difference(scan(mode.base)))
            predicted = _SIGMAS * float(image.noise_std(np.arange(self.model.mesh.n_elem)).max())
            self.thresholds[mode.name] = Thresholds(predicted, predicted)
            return
        images = [self._look(mode, scan, threshold=np.inf)[1:3] for _ in range(cycles)]
        base, final = (learn_threshold([self._peak(pair[k]) for pair in images]) for k in (0, 1))
        self.thresholds[mode.name] = Thresholds(base, final)

    def see(self, mode: Mode, scan: Scan) -> Sight:
        """One cycle: scan as the mode asks, and say what is there."""
        thresholds = self.thresholds[mode.name]
        frames, base, image, regions = self._look(mode, scan, thresholds.base)
        imaging = self.skin.imaging
        finder = ContactFinder(thresholds.final, imaging.fraction, imaging.dip, imaging.falls)
        return Sight(frames, base, image, tuple(regions), tuple(finder.find(image, self.model.mesh)))

    def _look(self, mode: Mode, scan: Scan, threshold: float) -> tuple[tuple[Frame, ...], Image, Image, list[Region]]:
        mesh = self.model.mesh
        frame = scan(mode.base)
        difference = self._difference(frame)
        base = self.estimator.reconstruct(difference)
        strongest = float(base.values.max())
        regions = find_regions(base.values, mesh, max(threshold, self.skin.imaging.fraction * strongest), self.skin.imaging.dip)
        if mode.optimal is None:
            return (frame,), base, base, regions
        if regions:
            anchors = [region.anchors for region in regions]
        else:  # nothing stands out: look closer where the base image is highest, which finds touches too weak for gamma_0
            peak = mesh.centroids[int(np.argmax(base.values))]
            anchors = [mesh.centroids[mesh.closest_elements(peak[None], 3)[0]]]
        chosen = scan(mode.optimal.pattern(anchors))
        optimal = self._difference(chosen)
        image = self.estimator.reconstruct(*([difference, optimal] if mode.fuse else [optimal]))
        return (frame, chosen), base, image, regions

    def _difference(self, frame: Frame) -> Difference:
        if self.quality is None:
            return self.baseline.difference(frame)
        return self.quality.weigh(self.baseline.difference(self.quality.clean(frame)))

    def _peak(self, image: Image) -> float:
        return float(np.abs(image.values).max() if self.skin.imaging.falls else image.values.max())
