"""An image in three classes: what conducts better, what conducts worse, and background; none without evidence."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

from ohmskin.arrays import Shorts
from ohmskin.contacts.regions import find_regions
from ohmskin.errors import DataError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Cells
from ohmskin.inverse import GaussNewton, Image
from ohmskin.inverse.modes import pair_system
from ohmskin.scan import Difference

CLASSES = {1: "conductive", -1: "resistive"}
"""Names of the classes, by the sign of their change of conductivity."""

_MODEL = 0.03  # share of the data's power that a class which is not there explains at most, as the model is linear;
# of ten recordings of tanks 0.0001 to 0.008, and one that is there 0.09 to 0.96
_PRIOR, _AMPLITUDE, _ERROR = "matern", 0.5, 0.15  # of the images that tell: strong contrasts, roughly modelled


@dataclass(frozen=True)
class Evidence:
    """Evidence for a class: the increase of the residual without it.

    Args:
        unexplained: Share of the data's power that is no longer explained if the class is excluded (1).
        needed: Share that the class must explain to be reported (1): more than noise at the stated rate, and more than
            the errors of a linear model.
        undecided: Whether the class may be there, although the data can do without it: something has changed, and
            either class alone explains it, such as where all data of an electrode are missing.
    """

    unexplained: float
    needed: float
    undecided: bool = False

    @property
    def significant(self) -> bool:
        """Whether the class is there."""
        return self.unexplained > self.needed


@dataclass(frozen=True, eq=False)
class Segments:
    """An image in classes.

    Args:
        labels: (n_cells,) 1 where it conducts better, -1 where worse, 0 in the background.
        evidence: For each class by its label.
        rate: False alarms: share of data of the background alone in which noise is taken for a class, at most (1).
    """

    labels: Shorts
    evidence: dict[int, Evidence]
    rate: float

    def areas(self, cells: Cells) -> dict[str, float]:
        """Area (m2) of each class by name, 0 of one that is not there, in an image made of `cells`."""
        return {name: float(cells.measures[self.labels == sign].sum()) for sign, name in CLASSES.items()}


def evidence(
    model: TransferModel, noise: float, scans: Sequence[Difference], freedom: int = 60, rate: float = 0.01
) -> dict[int, Evidence]:
    """Evidence for a class of higher (1) and one of lower conductivity (-1).

    For each, the data are explained by an image without it (nowhere above, or nowhere below the background) and by one
    that may have it. With noise alone, the difference is an F variable at most.

    Args:
        model: The untouched sheet, scaled to the quiet data.
        noise: Standard deviation of a difference of voltages (V).
        scans: Changes against the quiet skin.
        freedom: Degrees of freedom with which the noise is known.
        rate: Rate of false alarms (1), above 0 and below 1.

    Raises:
        DataError: If the rate is not within 0 and 1, or no finite datum is left.
        ModelError: If the noise is not positive.
    """
    if not 0 < rate < 1 or freedom < 1:
        raise DataError(f"rate of false alarms {rate:g}, freedom {freedom}; use a rate within 0 and 1, and 1 or more")
    scans = [scan.undriven for scan in scans]
    system = pair_system(model.pairs, *scans)
    power = float(system.volts @ system.volts)
    if power == 0:
        return {sign: Evidence(0.0, 1.0) for sign in CLASSES}
    free, risen = (
        GaussNewton(model, noise, _PRIOR, amplitude=_AMPLITUDE, model_error=_ERROR, positive=positive)
        for positive in (False, True)
    )
    by_change = system.rows @ (model.pair_sensitivity * model.conductivity)

    def left(image: Image, sign: int = 1) -> float:
        """With the best factor that is not negative: any may be."""
        caused = sign * (by_change @ image.values)
        along = max(float(caused @ system.volts), 0.0)
        return power - along**2 / max(float(caused @ caused), 1e-300)

    degrees = int(np.linalg.matrix_rank(system.rows))
    by_noise = degrees * float(fdtri(degrees, freedom, 1 - rate / len(CLASSES))) * noise**2
    least = left(free.reconstruct(*scans))
    turned = [replace(scan, volts=-scan.volts) for scan in scans]
    without = {1: left(risen.reconstruct(*turned), -1), -1: left(risen.reconstruct(*scans))}
    needed = min(float(by_noise) / power + _MODEL, 1.0)
    lost = {sign: (one - least) / power for sign, one in without.items()}
    undecided = max(lost.values()) <= needed < 1 - least / power
    return {sign: Evidence(one, needed, undecided) for sign, one in lost.items()}


def segments(
    image: Image, cells: Cells, found: dict[int, Evidence], rate: float = 0.01, fraction: float = 0.3, dip: float = 0.2
) -> Segments:
    """An image of `cells` in the classes for which there is evidence.

    Each class consists of the regions around its peaks where the image exceeds half of the peak.

    Args:
        image, cells: The image and its cells.
        found: The evidence.
        rate: Rate of false alarms of the evidence (1).
        fraction, dip: Least peak as a share of the highest of the class, and saddle between two (`ContactFinder`).
    """
    labels = np.zeros(len(image.values), np.int32)
    for sign in (sign for sign, one in found.items() if one.significant):
        contrast = sign * image.contrast
        top = float(contrast.max())
        for region in find_regions(contrast, cells, fraction * top / 2, dip) if top > 0 else ():
            if region.peak > fraction * top:
                labels[region.elements[contrast[region.elements] > region.peak / 2]] = sign
    return Segments(labels, found, rate)
