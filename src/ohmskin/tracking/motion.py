"""Motion: how contacts and the skin may change, and what is believed some time later with nothing measured since."""

from dataclasses import dataclass

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
        memory: Time over which a velocity is forgotten to 1/e (s).
        pressing: Relative change of an effect in a second, for its random walk (1/sqrt(s)).
        widening: Time over which a radius is forgotten (s).
        warming: Random walk of the common factor of all resistances in a second (1/sqrt(s)); temperature.
        drifting: Time over which what no contact explains becomes part of the baseline (s).
        settling: Time over which what is left of a lifted contact does (s).
        creeping: Time in which foam recovers from a press (s); until then, next to nothing beside it is no contact.

    Raises:
        ModelError: If one is not positive.
    """

    speed: float = 0.3
    memory: float = 0.3
    pressing: float = 2.0
    widening: float = 1.0
    warming: float = 5e-4
    drifting: float = 5.0
    settling: float = 2.0
    creeping: float = 30.0

    def __post_init__(self) -> None:
        check_positive(**vars(self))


def moved(state: TrackState, fitter: ContactFitter, motion: Motion, elapsed: float) -> TrackState:
    """The state some time later (s): contacts go on, ever more slowly, and are known less and less well."""
    common_drift = (state.common_drift[0], state.common_drift[1] + motion.warming**2 * elapsed)
    state = changed(state, common_drift=common_drift, time=state.time + elapsed)
    if not state.tracks:
        return state
    mean, covariance, radius = state.mean.copy(), state.covariance.copy(), fitter.table.radius
    pressing = np.array([not track.lifted for track in state.tracks])
    scales = np.array([radius, motion.speed, motion.pressing, _LEAST_EFFECT * np.pi * radius**2])
    times = np.array([motion.memory, motion.widening])
    advanced(mean, covariance, pressing, elapsed, times, scales, fitter.table.sheet)
    return changed(state, mean=mean, covariance=covariance)
