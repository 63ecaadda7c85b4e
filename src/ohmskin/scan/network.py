"""What any sheet must obey: a resistive network with one terminal per electrode, whatever its shape.

Every measurement of such a network is a combination of the two-terminal resistances of its electrode pairs
(`DrivePattern.combination`). A pattern with more measurements than these combinations span measures something twice:
reciprocal pairs R(ab, cd) = R(cd, ab), loops of voltages that must add up to nothing, currents that add up to another
injection. What is left of the data after the best such network is a reciprocity error in this wide sense; it needs no
model of the sheet.
"""

from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Bools, Floats
from ohmskin.errors import DataError
from ohmskin.scan.pattern import DrivePattern

_MOST_ENTRIES = 2**26  # of a matrix: all pairs of 128 electrodes


@dataclass(frozen=True)
class GoodnessOfFit:
    """How far data are from any network.

    Args:
        squares: Sum of the squared residuals (V2).
        freedom: Number of measurements less the number of combinations they span, over all columns of data; 0 where
            nothing was measured twice.
    """

    squares: float
    freedom: int

    @property
    def rms(self) -> float:
        """Standard deviation of one voltage about the network (V); NaN where nothing was measured twice."""
        return float(np.sqrt(self.squares / self.freedom)) if self.freedom > 0 else float("nan")


class NetworkFit:
    """Fits the network to data of one pattern, with any of its measurements left out.

    Args:
        pattern: The pattern driven.
        currents: (n_meas,) current behind each measurement (A).
        volts: (n_meas,) or (n_meas, n_frames) data (V); NaN where they are not known.

    Raises:
        DataError: If the pattern is too large to judge.
    """

    def __init__(self, pattern: DrivePattern, currents: Floats, volts: Floats) -> None:
        self.pattern = pattern
        volts = volts.reshape(pattern.n_meas, -1)
        self.known = np.isfinite(volts).all(axis=1) & np.isfinite(currents)
        rows = pattern.combination(pattern.last + 1)
        used = np.unique(rows.indices)  # pairs that nothing measures only take memory
        if (entries := len(used) * max(pattern.n_meas, len(used))) > _MOST_ENTRIES:
            size = (
                f"{pattern.n_meas} measurements of {len(used)} electrode pairs take {entries / 2**27:.1f} GiB to judge"
            )
            raise DataError(f"{size}; allowed are {_MOST_ENTRIES / 2**27}: measure with fewer electrodes")
        self._rows = rows[:, used].toarray() * np.where(self.known, currents, 0.0)[:, None]
        self._rows /= max(float(np.abs(self._rows).max(initial=0.0)), 1e-300)  # currents of microamperes square badly
        self._volts = np.where(self.known[:, None], volts, 0.0)
        self._known_misfits: dict[bytes, GoodnessOfFit] = {}

    def without(self, electrodes: list[int]) -> Bools:
        """Whether each measurement (n_meas,) is known and uses none of `electrodes`."""
        return self.known & ~self.pattern.uses(electrodes)

    def with_only(self, electrode: int) -> Bools:
        """Whether each measurement (n_meas,) is known and uses `electrode`."""
        return self.known & self.pattern.uses(electrode)

    def residuals(self, kept: Bools) -> Floats:
        """Residuals of the network that fits the `kept` measurements best, (n_meas, n_frames) in volts; NaN for the
        others."""
        rows = self._rows[kept]
        left = np.full(self._volts.shape, np.nan)
        left[kept] = self._volts[kept] - rows @ np.linalg.lstsq(rows, self._volts[kept], rcond=1e-10)[0]
        return left

    def misfit(self, kept: Bools) -> GoodnessOfFit:
        """The misfit of the `kept` measurements (n_meas,). Fast: no residual is computed, and results are cached."""
        if (key := kept.tobytes()) in self._known_misfits:
            return self._known_misfits[key]
        rows, volts = self._rows[kept], self._volts[kept]
        values, vectors = np.linalg.eigh(rows.T @ rows)
        spanned = values > 1e-10 * max(float(values[-1]), 1e-300)
        explained = vectors[:, spanned].T @ (rows.T @ volts)
        squares = float((volts**2).sum() - (explained**2 / values[spanned][:, None]).sum())
        floor = 1e-13 * float((volts**2).sum())  # what rounding leaves
        found = self._known_misfits[key] = GoodnessOfFit(
            max(squares, floor), volts.shape[1] * int(kept.sum() - spanned.sum())
        )
        return found


def reciprocity_residuals(pattern: DrivePattern, currents: Floats, volts: Floats) -> Floats:
    """Residual (n_meas,) of each measurement about the best network (V); NaN where it is not known.

    For adjacent drive and measurement it is half the difference of each reciprocal pair.

    Args:
        pattern: The pattern driven.
        currents: (n_inj,) injected currents (A).
        volts: (n_meas,) voltages (V).

    Raises:
        DataError: If the pattern is too large to judge.
    """
    fit = NetworkFit(pattern, currents[pattern.measurements[:, 0]], volts)
    return fit.residuals(fit.known)[:, 0]
