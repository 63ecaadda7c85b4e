"""Soundness of a frame: which of its values can be, judged by the currents of the quiet skin."""

from typing import NamedTuple

import numpy as np
from numba import njit

from ohmskin.arrays import Bools, Floats, Ints

_FLOWING = 10.0  # times the quiet skin's current, beyond which, or below whose inverse, a current cannot be


class Soundness(NamedTuple):
    """Which values of a frame can be.

    Args:
        flowing: (n_inj,) whether the current of each injection can be.
        sound: (n_meas,) whether each voltage can be.
        currents, whole: Whether all currents, and all voltages, can be.
    """

    flowing: Bools
    sound: Bools
    currents: bool
    whole: bool


@njit(cache=True, nogil=True)
def judged(
    currents: Floats, voltages: Floats, injections: Ints, which: Ints, usual: Floats
) -> tuple[Bools, Bools, bool, bool, int]:
    """The fields of `Soundness`, and how many of the sound voltages are as large as any, to the last bit.

    Args:
        currents: (n_inj,) of the frame (A).
        voltages: (n_meas,) of the frame (V).
        injections: (n_inj, 2) source and sink of each.
        which: (n_meas,) the number of the injection behind each measurement.
        usual: (n_elec, n_elec) currents of pairs on the quiet skin (A); NaN where they are not known.
    """
    flowing, sound = np.empty(len(currents), np.bool_), np.empty(len(voltages), np.bool_)
    for k in range(len(currents)):
        share = currents[k] / usual[injections[k, 0], injections[k, 1]]
        flowing[k] = np.isfinite(currents[k]) and currents[k] != 0 and not (share < 1 / _FLOWING or share > _FLOWING)
    largest, alike = -1.0, 0
    for m in range(len(voltages)):
        sound[m] = np.isfinite(voltages[m]) and flowing[which[m]]
        size = abs(voltages[m]) if sound[m] else -1.0
        if size > largest:
            largest, alike = size, 1
        elif sound[m] and size == largest:
            alike += 1
    return flowing, sound, bool(flowing.all()), bool(sound.all()), alike
