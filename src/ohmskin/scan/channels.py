"""Channels: how far each measurement follows the model of the skin, as many presses showed."""

from dataclasses import dataclass, field, replace

import numpy as np

from ohmskin.arrays import Bools, Floats, Ints, WeakCache
from ohmskin.errors import DataError
from ohmskin.scan.baseline import Difference, codes_of
from ohmskin.scan.frame import Frame
from ohmskin.scan.pattern import DrivePattern

_SILENT, _DOUBTFUL = 0.1, 3.0  # gain below which a channel tells nothing; times the usual error from which, little


@dataclass(frozen=True, eq=False)
class Channels:
    """Gains and errors of channels against the model of a skin; see `ohmskin.calibrate.judge_channels`.

    Args:
        quadruples: (n, 4) source, sink, plus, minus of each channel.
        gains: (n,) change measured over change modelled (1); negative where a channel is inverted.
        errors: (n,) standard deviation of the residual, as a share of the usual modelled change of a channel (1).

    Raises:
        DataError: If shapes differ, or an error is not positive.
    """

    quadruples: Ints
    gains: Floats
    errors: Floats
    _known: WeakCache[DrivePattern, tuple[Floats, Floats]] = field(default_factory=WeakCache, init=False, repr=False)

    def __post_init__(self) -> None:
        shapes = [np.shape(one) for one in (self.quadruples, self.gains, self.errors)]
        if shapes != [(len(self.gains), 4), (len(self.gains),), (len(self.gains),)] or not len(self.gains):
            raise DataError(f"channels have shapes {shapes}; need (n, 4), (n,) and (n,), at least one")
        if not (np.isfinite(self.gains).all() and (self.errors > 0).all()):
            raise DataError("channels need finite gains and errors above 0")

    def of(self, pattern: DrivePattern) -> tuple[Floats, Floats]:
        """Gains and errors (n_meas,) of a pattern's channels; those never judged have gain 1 and a usual error."""
        if (known := self._known.get(pattern)) is None:
            at, _, judged = self.find(pattern)
            known = self._known[pattern] = (
                np.where(judged, self.gains[at], 1.0),
                np.where(judged, self.errors[at], float(np.median(self.errors))),
            )
        return known

    def find(self, pattern: DrivePattern) -> tuple[Ints, Ints, Bools]:
        """Which channel (n_meas,) each measurement of a `pattern` is, its sign against that, and whether it is one."""
        (codes, signs), (wanted, turned) = codes_of(self.quadruples), codes_of(pattern.quadruples)
        order = np.argsort(codes)
        at = order[np.minimum(np.searchsorted(codes, wanted, sorter=order), len(codes) - 1)]
        return at, signs[at] * turned, codes[at] == wanted

    def doubtful(self, pattern: DrivePattern) -> Bools:
        """(n_meas,) whether a channel of a `pattern` has no or little information, so that it is left out."""
        gains, errors = self.of(pattern)
        return np.asarray((np.abs(gains) < _SILENT) | (errors > _DOUBTFUL * np.median(self.errors)))

    def clean(self, frame: Frame) -> Frame:
        """The frame without the values of doubtful channels (NaN)."""
        return replace(frame, voltages=np.where(self.doubtful(frame.pattern), np.nan, frame.voltages))

    def weigh(self, difference: Difference, noise: float) -> Difference:
        """The difference as if the model held: gains put into the currents, and all errors as large as the noise (V).

        The error of a channel beyond its noise grows with the change: small changes keep their weight; for large ones
        the channels that follow the model best have the largest weight. As in `Quality.weigh`, a lower weight means
            less current.
        """
        gains, errors = self.of(difference.pattern)
        known = np.isfinite(difference.volts) & np.isfinite(difference.currents)
        if not known.any():
            return difference
        precision = errors[known] ** -2.0
        size = precision @ difference.volts[known] ** 2 / precision.sum()
        weights = noise / np.sqrt(noise**2 + errors**2 * max(float(size) - noise**2, 0.0))
        weighed = difference.times(weights)
        return replace(weighed, currents=weighed.currents * gains)
