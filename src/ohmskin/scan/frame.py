"""Frames: what a device measured, with the pattern that was really driven."""

from dataclasses import dataclass
from enum import IntFlag

import numpy as np

from ohmskin.arrays import Floats, real
from ohmskin.errors import DataError
from ohmskin.scan.pattern import DrivePattern

_LARGEST = 1e100  # V or A, which may be squared


class FrameFlag(IntFlag):
    """Flags of a frame."""

    CLIPPED = 1  #: at least one voltage left the converter's range
    CURRENT_LIMIT = 2  #: an injection ran into the source's current limit
    FIRST = 4  #: the first frame since the device started
    OVERRUN = 8  #: the device could not keep its own timing


@dataclass(frozen=True, eq=False)
class Frame:
    """One scan of one drive pattern.

    Args:
        pattern: The pattern that was really driven.
        voltages: (n_meas,) measured voltages in volts; NaN where nothing was measured, +-inf where clipped or above
            1e100 V.
        currents: (n_inj,) measured injected currents in amperes.
        time: Time of the last sample on the device's clock (s); 0 where there is no clock, as in simulations.
        sequence: Number of the frame, counted by the device.
        flags: What the device reports in addition to the data.
        auxiliary: Reading of the device's auxiliary channel, such as the total force (N) or the air pressure under the
            skin (Pa); NaN if it is not known, None where there is no such channel.
        recorded: Of a replayed frame, when it was measured (s), however quickly it is replayed; None if measured now.

    Raises:
        DataError: If the shapes do not fit the pattern, or an array is complex.
    """

    pattern: DrivePattern
    voltages: Floats
    currents: Floats
    time: float = 0.0
    sequence: int = 0
    flags: FrameFlag = FrameFlag(0)
    recorded: float | None = None
    auxiliary: float | None = None

    def __post_init__(self) -> None:
        for name, count in (("voltages", self.pattern.n_meas), ("currents", self.pattern.n_inj)):
            given = real(getattr(self, name), f"frame {name} are", DataError)
            if given.shape != (count,):
                raise DataError(f"frame {name} have shape {given.shape}; the pattern driven needs ({count},)")
            if np.count_nonzero(beyond := np.abs(given) > _LARGEST):
                given = np.where(beyond, np.copysign(np.inf, given), given)
            object.__setattr__(self, name, given)

    @property
    def measurement_currents(self) -> Floats:
        """The current (n_meas,) behind each measurement (A)."""
        return self.currents[self.pattern.measurements[:, 0]]
