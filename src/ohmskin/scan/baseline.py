"""The untouched skin: reference data and noise, learned from quiet frames."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ohmskin.errors import DataError, PatternError
from ohmskin.scan.frame import Floats, Frame
from ohmskin.scan.pairs import Ints
from ohmskin.scan.pattern import DrivePattern

_SHIFT = np.int64(1) << np.arange(48, -1, -16, dtype=np.int64)  # electrode numbers fit 15 bits


@dataclass(frozen=True)
class Difference:
    """Voltage changes of one frame against the untouched skin (paper, eq. 4).

    Args:
        pattern: The pattern driven.
        currents: (n_meas,) current behind each measurement (A).
        volts: (n_meas,) change of voltage at that current (V); NaN where it is not known.
    """

    pattern: DrivePattern
    currents: Floats
    volts: Floats


@dataclass(frozen=True)
class Baseline:
    """Reference transfer resistances of every measurement seen while nothing touched the skin.

    Dividing by the measured current makes data of a voltage source comparable between touched and untouched.

    Args:
        keys: (n,) sorted codes of the (source, sink, plus, minus) quadruples, electrodes of a pair in rising order.
        resistances: (n,) mean transfer resistances (ohm).
        noise: Standard deviation of a single voltage (V).
        frames: The number of quiet frames behind it.
    """

    keys: Ints
    resistances: Floats
    noise: float
    frames: int

    @classmethod
    def learn(cls, frames: Iterable[Frame]) -> "Baseline":
        """Learn from quiet frames, of one or several patterns.

        The noise is the scatter of repeated frames about their mean. A pattern seen once has no scatter; if no pattern
        is repeated, the noise is taken from the disagreement of reciprocal measurements, which must be equal.

        Raises:
            DataError: If there is no frame, or too few finite values to tell the noise.
        """
        by_pattern: dict[DrivePattern, list[Frame]] = defaultdict(list)
        for frame in frames:
            by_pattern[frame.pattern].append(frame)
        if not by_pattern:
            raise DataError("no quiet frames to learn the baseline from; scan the untouched skin first")
        keys, means, squares, freedom = [], [], 0.0, 0
        for pattern, group in by_pattern.items():
            which = pattern.measurements[:, 0]
            currents = np.stack([frame.currents[which] for frame in group])
            volts = np.where(np.isfinite(volts := np.stack([frame.voltages for frame in group])), volts, np.nan)
            known = np.isfinite(volts).sum(axis=0)
            with np.errstate(invalid="ignore", divide="ignore"):
                mean = np.nansum(volts * currents, axis=0) / np.nansum(np.where(np.isnan(volts), np.nan, currents**2), axis=0)
            codes, signs = _codes(pattern.quadruples)
            keys.append(codes)
            means.append(signs * mean)
            squares += float(np.nansum((volts - mean * currents) ** 2))
            freedom += int(np.maximum(known - 1, 0).sum())
        key, first = np.unique(np.concatenate(keys), return_index=True)
        resistances = np.concatenate(means)[first]
        count = sum(len(group) for group in by_pattern.values())
        baseline = cls(key, resistances, 0.0, count)
        if freedom > 0 and squares > 0:
            noise = float(np.sqrt(squares / freedom))
        else:
            noise = float(np.mean([baseline.reciprocity_error(group[0]) for group in by_pattern.values()]))
        return cls(key, resistances, noise, count)

    def reference(self, pattern: DrivePattern) -> Floats:
        """Untouched transfer resistances (n_meas,) of a pattern (ohm).

        Raises:
            PatternError: If one of its measurements was never seen while the skin was quiet.
        """
        codes, signs = _codes(pattern.quadruples)
        at = np.minimum(np.searchsorted(self.keys, codes), len(self.keys) - 1)
        if len(missing := np.flatnonzero(self.keys[at] != codes)):
            raise PatternError(
                f"no quiet reference for source, sink, plus, minus = {pattern.quadruples[missing[0]].tolist()}; "
                "calibrate with this pattern included"
            )
        return signs * self.resistances[at]

    def difference(self, frame: Frame) -> Difference:
        """The change of a frame's voltages against the untouched skin at the same currents."""
        currents = frame.currents[frame.pattern.measurements[:, 0]]
        volts = frame.voltages - currents * self.reference(frame.pattern)
        return Difference(frame.pattern, currents, np.where(np.isfinite(volts), volts, np.nan))

    def reciprocity_error(self, frame: Frame) -> float:
        """Noise (V) told from one frame: R(ab, cd) and R(cd, ab) must be equal, their difference is noise.

        Raises:
            DataError: If no measurement of the frame has its reciprocal in it.
        """
        quadruples = frame.pattern.quadruples
        current = frame.currents[frame.pattern.measurements[:, 0]]
        codes, signs = _codes(quadruples)
        mirrored, mirrored_signs = _codes(quadruples[:, [2, 3, 0, 1]])
        order = np.argsort(codes)
        at = np.minimum(np.searchsorted(codes[order], mirrored), len(codes) - 1)
        partner = order[at]
        paired = codes[partner] == mirrored
        known = np.isfinite(frame.voltages) & np.isfinite(current) & (current != 0)
        ohms = np.divide(frame.voltages, current, out=np.full(len(current), np.nan), where=known)
        errors = ((signs * ohms)[partner] - mirrored_signs * ohms)[paired] * current[paired]
        finite = errors[np.isfinite(errors)]
        if len(finite) < 4:
            raise DataError("the noise cannot be told from one quiet frame without reciprocal measurements; record at least two")
        return float(np.sqrt(np.mean(finite**2) / 2))


def _codes(quadruples: Ints) -> tuple[Ints, Ints]:
    """One number for each measurement whatever the direction of its two pairs, and the sign that the direction gives it."""
    a, b, c, d = quadruples.T
    forward = np.column_stack([np.minimum(a, b), np.maximum(a, b), np.minimum(c, d), np.maximum(c, d)])
    return forward @ _SHIFT, np.where((a < b) == (c < d), 1, -1)
