"""Quiet frames once more: what a scan of the untouched skin gives, without asking the device."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from ohmskin.errors import PatternError
from ohmskin.scan import DrivePattern, Frame

_APART = 3  # repeats between one and the next from which a pattern takes what it drives several times


class QuietScans:
    """Scans of the untouched skin, put together from frames that were measured.

    Args:
        frames: Quiet frames of one or several patterns, repeated.

    Attributes:
        auxiliary: What the auxiliary channel read in each frame, where there is one.
        repeats: How often the least repeated of the patterns was measured.
        patterns: What was driven.
    """

    def __init__(self, frames: Sequence[Frame]) -> None:
        self._by_pattern: dict[DrivePattern, list[Frame]] = {}
        for frame in frames:
            self._by_pattern.setdefault(frame.pattern, []).append(frame)
        self.patterns = tuple(self._by_pattern)
        self.auxiliary = [frame.auxiliary for frame in frames if frame.auxiliary is not None]
        self.repeats = min(len(repeated) for repeated in self._by_pattern.values())
        self._home = {  # where each voltage was measured
            tuple(quadruple): (pattern, row)
            for pattern in self._by_pattern
            for row, quadruple in enumerate(pattern.quadruples.tolist())
        }

    @property
    def rest(self) -> float:
        """What the auxiliary channel read on the mean; NaN where it read nothing."""
        known = np.array(self.auxiliary)[np.isfinite(self.auxiliary)]
        return float(known.mean()) if len(known) else np.nan

    @property
    def frames(self) -> list[Frame]:
        """All frames."""
        return [frame for repeated in self._by_pattern.values() for frame in repeated]

    @property
    def driven(self) -> DrivePattern | None:
        """The largest pattern with voltages of driven electrodes, if there is one."""
        found = [pattern for pattern in self._by_pattern if pattern.driven.any()]
        return max(found, key=lambda pattern: pattern.n_inj, default=None)

    def scan(self, pattern: DrivePattern, number: int) -> Frame:
        """The frame of a pattern in repeat `number`.

        What it drives several times comes from other repeats each time, so that noise averages out as it would.

        Raises:
            PatternError: If one of its voltages was not measured while the skin was quiet.
        """
        if pattern in self._by_pattern:
            return self._by_pattern[pattern][number]
        volts, currents, time = np.empty(pattern.n_meas), np.empty(pattern.n_inj), 0.0
        seen = Counter[tuple[int, ...]]()
        for k, quadruple in enumerate(pattern.quadruples.tolist()):
            if tuple(quadruple) not in self._home:
                raise PatternError(
                    f"no quiet reference for source, sink, plus, minus = {quadruple}; calibrate with this pattern"
                )
            home, row = self._home[tuple(quadruple)]
            frame = self._by_pattern[home][(number + _APART * seen[tuple(quadruple)]) % self.repeats]
            seen[tuple(quadruple)] += 1
            volts[k], time = frame.voltages[row], max(time, frame.time)
            currents[pattern.measurements[k, 0]] = frame.currents[home.measurements[row, 0]]
        return Frame(pattern, volts, currents, time)
