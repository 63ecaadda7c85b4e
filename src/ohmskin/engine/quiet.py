"""Quiet frames: every pattern again and again, while nothing touches the skin; what was disturbed is measured again."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ohmskin.arrays import Bools, Floats
from ohmskin.device import Capabilities
from ohmskin.errors import DataError
from ohmskin.scan import DrivePattern, Frame, Quality, assess
from ohmskin.scan.quality import in_words
from ohmskin.scan.repeats import finite

MEASURED = 0.7
"""Share of a calibration's progress at which the quiet skin is measured."""

_REPORT_EVERY = 5.0  # s
_REPEATS = 40  # of each pattern, for the baseline
_JUDGED = 2048  # voltages of a piece: whether these agree takes the cube of what they tell of
_OUTLIER = 8.0  # robust standard deviations beyond which a value is a disturbance
_AGAIN = 3  # times that a disturbed frame is measured again, and that all are if something moved
_PARTS, _MOST, _MOVED = 4, 0.95, 5.0  # of the frames, whose medians may differ by so many times the noise at so many
_LEAST, _GAUSSIAN = 1e-4, 1.4826  # noise over the largest voltage, at least; standard deviation over median deviation
_SMALLEST = 0.01  # share of the changes from frame to frame that are smaller than a converter's step, at most
_LARGEST = 100.0  # A
_MOST_BAD = 0.25  # share of the electrodes that a skin can do without


class CalibrationReport:
    """The progress of a calibration of a slow device, every few seconds: what share is measured, and for how long yet.

    Args:
        report: Called with a sentence, the share (0 to 1) and the time that the rest will take at this pace (s).
    """

    def __init__(self, report: Callable[[str, float, float], object]) -> None:
        self._report, self._share = report, 1.0
        self._began = self._due = 0.0

    def __call__(self, progress: float) -> None:
        now, before, self._share = time.monotonic(), self._share, progress / MEASURED
        if self._share < before:  # it begins, or begins again because something moved
            self._began, self._due = now, now + _REPORT_EVERY
        elif now >= self._due and before < self._share < 1:
            self._due = now + _REPORT_EVERY
            left = (now - self._began) * (1 / self._share - 1)
            self._report(f"calibrating: {self._share:.0%} measured, about {left:.0f} s left", self._share, left)


class QuietFrames:
    """Measures the untouched skin.

    Args:
        patterns: What will be driven.
        able: What the device takes.
        scan: Scans a pattern.
        progress: Called with the share done, 0 to 1.
    """

    def __init__(
        self,
        patterns: Sequence[DrivePattern],
        able: Capabilities,
        scan: Callable[[DrivePattern], Frame],
        progress: Callable[[float], None],
    ) -> None:
        most = min(able.max_measurements, _JUDGED)
        self._pieces = [piece for each in patterns for piece in each.split(able.max_injections, most)]
        self._scan, self._progress = scan, progress
        self.notes: list[str] = []

    def measured(self) -> list[Frame]:
        """Frames of all patterns, in pieces that the device takes at once; `notes` say what was measured again.

        Raises:
            DataError: If the skin is not quiet, or no current flows or no voltage can be used.
        """
        for _ in range(_AGAIN):
            rounds = [self._round(number) for number in range(_REPEATS)]
            by_piece = [list(frames) for frames in zip(*rounds, strict=True)]
            for frames in by_piece:
                _check_sane(frames)
            moved = max((_moved(frames) for frames in by_piece), key=lambda one: one[0])
            if moved[0] < _MOVED:
                break
            self.notes = [f"the quiet voltages changed during the measurement, by {in_words(moved[1])}; measured again"]
        else:
            noise = in_words(moved[1] / moved[0])
            raise DataError(
                f"the skin is not quiet: its voltages change by {in_words(moved[1])}, their noise is {noise}; "
                "do not touch it, wait until it has settled, and calibrate again"
            )
        bad = assess([frame for frames in by_piece for frame in frames]).bad  # no disturbance, but an electrode
        disturbed = sum(self._repaired(frames, bad) for frames in by_piece)
        if disturbed:
            self.notes.append(f"{disturbed} of {_REPEATS * len(by_piece)} quiet frames had outliers; measured again")
        return [frame for frames in zip(*by_piece, strict=True) for frame in frames]

    def _round(self, number: int) -> list[Frame]:
        self._progress(number / _REPEATS)
        return [self._frame(piece) for piece in self._pieces]

    def _frame(self, piece: DrivePattern) -> Frame:
        frame = self._scan(piece)
        if frame.pattern != piece:  # such as of a damaged recording
            raise DataError("a quiet frame has another pattern than was asked for; calibrate or record again")
        return frame

    def _repaired(self, frames: list[Frame], bad: Sequence[int]) -> int:
        """Measures disturbed frames again, in place; what stays disturbed is left out. How many were."""
        count = 0
        for turn in range(_AGAIN + 1):
            outliers = _outliers(frames) & ~frames[0].pattern.uses(bad)
            disturbed = np.flatnonzero(outliers.any(axis=1)).tolist()
            count = count or len(disturbed)
            for k in disturbed:
                if turn < _AGAIN:
                    frames[k] = self._frame(frames[k].pattern)
                else:
                    frames[k] = replace(frames[k], voltages=np.where(outliers[k], np.nan, frames[k].voltages))
            if not disturbed:
                break
        return count


def check_usable(quality: Quality) -> None:
    """Raises DataError if too many electrodes are of no use."""
    if len(quality.bad) > _MOST_BAD * quality.n_elec:
        findings = "; ".join(quality.findings)
        raise DataError(f"{len(quality.bad)} of {quality.n_elec} electrodes cannot be used: {findings}")


def _check_sane(frames: Sequence[Frame]) -> None:
    """Raises DataError if most of these cannot be frames of a skin at all."""
    currents = np.stack([frame.currents for frame in frames])
    flowing = np.isfinite(currents) & (currents > 0) & (currents < _LARGEST)
    if np.median(flowing.any(axis=1)) < 1:
        shown = f"such as {currents.ravel()[0]:.3g} A"
        raise DataError(f"the device reports impossible currents, {shown}; check its excitation and its wires")
    volts = np.stack([frame.voltages for frame in frames])
    if np.median(np.isfinite(volts).any(axis=1)) < 1:
        kind = "clips" if np.isinf(volts).sum() > np.isnan(volts).sum() else "is missing"
        raise DataError(f"every voltage of a frame {kind}; check the device's range, cable and power")
    if not np.abs(finite(volts)[np.isfinite(volts)]).any():
        raise DataError("every voltage is 0 V; check the device's inputs and its excitation")


def _volts(frames: Sequence[Frame]) -> Floats:
    """Voltages (n_frames, n_meas) as if all were driven by the median currents; NaN where they are not known (V)."""
    volts = finite(np.stack([frame.voltages for frame in frames]))
    currents = finite(np.stack([frame.measurement_currents for frame in frames]))
    with np.errstate(divide="ignore", invalid="ignore"):
        like: Floats = volts / currents * _median(currents)
    return finite(like)


def _rounding(frames: Sequence[Frame]) -> float:
    """Standard deviation (V) of rounding by the converter, from the smallest changes; next to nothing without it."""
    changes = np.abs(np.diff(finite(np.stack([frame.voltages for frame in frames])), axis=0))
    changes = changes[changes > 0]
    return float(np.quantile(changes, _SMALLEST)) / np.sqrt(12) if changes.size else 0.0


def _noise(volts: Floats, least: float) -> Floats:
    """Noise (n_meas,) of repeated voltages (V), at least so much: what changes from frame to frame, spikes aside."""
    steps = _median(np.abs(np.diff(volts, axis=0))) * _GAUSSIAN / np.sqrt(2)
    known = steps[np.isfinite(steps)]
    floor = max(_LEAST * float(np.nanmax(np.abs(volts), initial=0.0)), float(np.median(known)) if known.size else 0.0)
    return np.asarray(np.fmax(steps, max(floor, least)))


def _moved(frames: Sequence[Frame]) -> tuple[float, float]:
    """By how much voltages moved while they were measured: over their noise, and in volts.

    That of all but one in twenty, of all electrodes but one: an electrode that drifts is assessed later. What is the
    same on all voltages is hum, or an offset, and no movement.
    """
    volts = _volts(frames)
    volts -= _median((volts - _median(volts)).T)[:, None]
    noise = _noise(volts, _rounding(frames))
    means = np.stack([_median(part) for part in np.array_split(volts, _PARTS)])
    way = np.where(np.isfinite(means).all(axis=0), np.ptp(means, axis=0), 0.0)
    electrodes = frames[0].pattern.quadruples
    rests = [(electrodes != e).all(axis=1) for e in np.unique(electrodes)]
    return min(
        (float(np.quantile(way[rest] / noise[rest], _MOST)), float(np.quantile(way[rest], _MOST)))
        for rest in rests
        if rest.any()
    )


def _outliers(frames: Sequence[Frame]) -> Bools:
    """Which voltages (n_frames, n_meas) are no noise, or are missing although most of their like are not."""
    volts = _volts(frames)
    missing = ~np.isfinite(volts)
    with np.errstate(invalid="ignore"):
        away = np.abs(volts - _median(volts))
        far = away > _OUTLIER * np.fmax(_noise(volts, _rounding(frames)), _GAUSSIAN * _median(away))
    return np.asarray(far | (missing & (missing.mean(axis=0) < 0.5)))


def _median(values: Floats) -> Floats:
    """Median (n,) of what is known of each column of (m, n); NaN where nothing is."""
    known = np.isfinite(values).any(axis=0)
    medians = np.full(values.shape[1], np.nan)
    medians[known] = np.nanmedian(values[:, known], axis=0)
    return medians
