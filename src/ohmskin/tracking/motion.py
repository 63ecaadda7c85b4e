"""Motion: how contacts and the skin may change, and what is believed some time later with nothing measured since."""

from dataclasses import dataclass
from math import exp

import numpy as np

from ohmskin.arrays import changed
from ohmskin.contacts.fitter import ContactFitter
from ohmskin.inverse.modes import check_positive
from ohmskin.tracking.kernels import advanced
from ohmskin.tracking.state import TrackState

_LEAST_EFFECT = 0.1  # change of conductivity that even a light contact may gain in a moment


@dataclass(frozen=True)
class Motion:
    """Dynamics of contacts and of the skin. The defaults are for fingers on foam.

    Args:
        speed: Standard deviation of a contact's velocity, along each axis (m/s).
        velocity_time: Time over which a velocity is forgotten to 1/e (s).
        effect_walk: Relative change of an effect in a second, for its random walk (1/sqrt(s)).
        radius_time: Time over which a radius is forgotten (s).
        common_walk: Random walk of the common factor of all resistances in a second (1/sqrt(s)); temperature.
        drift_time: Time over which what no contact explains becomes part of the baseline (s).
        settling_time: The same for the rest of a lifted contact (s).
        creep_time: Time in which foam recovers from a press (s); until then a weak signal is not a contact. What foam
            keeps, like what is learned as drift, grows over `drift_time`.

    Raises:
        ModelError: If one is not positive.
    """

    speed: float = 0.3
    velocity_time: float = 0.3
    effect_walk: float = 2.0
    radius_time: float = 1.0
    common_walk: float = 5e-4
    drift_time: float = 5.0
    settling_time: float = 2.0
    creep_time: float = 30.0

    def __post_init__(self) -> None:
        check_positive(**vars(self))

    def kept(self, before: float, signal: float, elapsed: float) -> float:
        """What the skin keeps of contacts a time `elapsed` (s) after it kept `before`, if they cause a `signal` (1)."""
        if signal > before:
            return signal + (before - signal) * exp(-elapsed / self.drift_time)
        return max(signal, before * exp(-elapsed / self.creep_time))


def moved(state: TrackState, fitter: ContactFitter, motion: Motion, elapsed: float) -> TrackState:
    """The state some time later (s): contacts go on, ever more slowly, and are known less and less well."""
    common_drift = (state.common_drift[0], state.common_drift[1] + motion.common_walk**2 * elapsed)
    mean, covariance, radius = state.mean.copy(), state.covariance.copy(), fitter.table.radius
    if state.tracks:
        pressing = np.array([not track.lifted for track in state.tracks])
        scales = np.array([radius, motion.speed, motion.effect_walk, _LEAST_EFFECT * np.pi * radius**2])
        times = np.array([motion.velocity_time, motion.radius_time])
        advanced(mean, covariance, pressing, elapsed, times, scales, fitter.table.sheet)
    return changed(state, common_drift=common_drift, time=state.time + elapsed, mean=mean, covariance=covariance)
