"""From presses of known force to a curve: strength of a contact to newtons."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import isotonic_regression

from ohmskin.contacts import Contact
from ohmskin.errors import DataError
from ohmskin.scan import Difference
from ohmskin.skin import Calibration


@dataclass(frozen=True)
class PressSample:
    """A press of known force and its measured strength.

    Args:
        at: Where (m).
        force: Force (N).
        strength: `Contact.strength`, median over some cycles (m2); 0 where it was not detected.
        loading: Whether the force was rising; otherwise it was falling.
        contact: The contact found for it last; None where it was not detected.
        scans: What it changed, in each of those cycles.
        auxiliary: What the auxiliary channel read then (N or Pa), the median; NaN: nothing.
    """

    at: tuple[float, float]
    force: float
    strength: float
    loading: bool
    contact: Contact | None = None
    scans: tuple[Difference, ...] = field(default=(), repr=False, compare=False)
    auxiliary: float = np.nan


@dataclass(frozen=True)
class ForceCurve:
    """A monotone curve from strength to force, and its residual errors.

    Args:
        strengths: Rising (m2).
        forces: Rising (N).
        error: Root mean square error over the samples (N).
        hysteresis: Largest mean difference of strength between unloading and loading at a force, over the largest (1).
        scatter: Standard deviation of strength between places at one force, as a share; mean over the forces.
        missed: Samples that were not detected.
        flat: Forces (N) whose strength is not higher than that of the next lower force: the skin is saturated, or
            strength differs more between places. The curve gives the geometric mean of forces that are alike.
    """

    strengths: tuple[float, ...]
    forces: tuple[float, ...]
    error: float
    hysteresis: float
    scatter: float
    missed: int
    flat: tuple[float, ...]

    def put_into(self, calibration: Calibration) -> Calibration:
        """The same calibration with this curve."""
        points = replace(calibration, strengths=self.strengths, forces=self.forces)
        return replace(points, force_error=self.error, hysteresis=self.hysteresis)


def fit_auxiliary(samples: Sequence[PressSample], rest: float, calibration: Calibration) -> Calibration:
    """A calibration with the gain of the auxiliary channel by least squares; as it is where there is no such channel.

    Args:
        samples: Presses of known force.
        rest: Reading of the channel on the quiet skin (N or Pa).
        calibration: To put it into.
    """
    read = np.array([sample.auxiliary for sample in samples]) - rest
    force = np.array([sample.force for sample in samples])
    force, read = force[np.isfinite(read)], read[np.isfinite(read)]
    if len(read) < 2 or (gain := float(force @ read / (force @ force))) <= 0:
        return calibration
    error = float(np.sqrt(np.mean((read / (gain * force) - 1) ** 2)))
    return replace(calibration, auxiliary_gain=gain, auxiliary_error=min(error, 1.0))


def fit_force(samples: Sequence[PressSample]) -> ForceCurve:
    """Fit mean strengths at each force by isotonic regression; `Calibration.force` interpolates them by PCHIP.

    Args:
        samples: Known forces, with the measured strength of each.

    Raises:
        DataError: If fewer than two forces were detected.
    """
    felt = [sample for sample in samples if sample.strength > 0]
    levels = sorted({sample.force for sample in felt})
    if len(levels) < 2 or levels[0] <= 0:
        told = f"{len(felt)} of {len(samples)} presses were detected, at {len(levels)} forces"
        raise DataError(f"{told}; press harder, at two forces or more")
    strength, force = (np.array([getattr(sample, name) for sample in felt]) for name in ("strength", "force"))
    loading = np.array([sample.loading for sample in felt])
    groups = [strength[force == level] for level in levels]
    counts = np.array([len(group) for group in groups], float)
    monotone = isotonic_regression([float(group.mean()) for group in groups], weights=counts).x
    # where it does not rise, each of the forces may be: with the lowest of them most would be told far too small
    rises = np.diff(monotone, prepend=0.0) > 1e-6 * monotone
    alike, number = np.cumsum(rises) - 1, np.flatnonzero(rises)
    means = np.bincount(alike, counts * np.log(levels)) / np.bincount(alike, counts)
    strengths, forces = tuple(monotone[number].tolist()), tuple(np.exp(means).tolist())
    if len(strengths) < 2:
        span = f"{levels[0]:.3g} to {levels[-1]:.3g} N"
        raise DataError(f"strength does not rise with force over {span}; press at the places asked for")
    errors = Calibration(strengths=strengths, forces=forces).force(strength) - force
    ways = [(strength[(force == level) & ~loading], strength[(force == level) & loading]) for level in levels]
    gaps = [falling.mean() - rising.mean() for falling, rising in ways if len(falling) and len(rising)]
    spreads = [float(group.std(ddof=1) / group.mean()) for group in groups if len(group) > 1]
    error, scatter = float(np.sqrt(np.mean(errors**2))), float(np.mean(spreads)) if spreads else 0.0
    hysteresis = float(np.max(np.abs(gaps), initial=0.0)) / strengths[-1]
    flat = tuple(np.array(levels)[~rises].tolist())
    return ForceCurve(strengths, forces, error, hysteresis, scatter, len(samples) - len(felt), flat)
