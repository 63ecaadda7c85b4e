"""Imported patterns: what others drove and measured, turned into a `DrivePattern`.

Others describe it by matrices, a column of currents per injection and a row of weights per measurement, or by a list.
Either can say more than our patterns can: currents of more than two electrodes, voltages other than differences.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import DataError, PatternError
from ohmskin.scan import DrivePattern, Frame

_TOLERANCE = 1e-6
_MOST_ELECTRODES = 1024
_MOST_MEASUREMENTS = 2**20


Parts = tuple[tuple[Frame, ...], tuple[Frame, ...], str, tuple[str, ...]]
"""Quiet frames, frames, the shipped skin that fits or nothing, and notes."""


@dataclass(frozen=True)
class ImportedPattern:
    """A drive pattern, and where its data are in a file.

    Args:
        pattern: The pattern.
        currents: (n_inj,) injected currents (A).
        rows: (n_meas,) place of each measurement in the file's order of data.
        gains: (n_meas,) what a value in the file is divided by to get volts (1).
        count: How many values a frame has in the file.
        notes: What was left out or assumed.
    """

    pattern: DrivePattern
    currents: Floats
    rows: Ints
    gains: Floats
    count: int
    notes: tuple[str, ...] = ()

    def frame(self, values: Floats, what: str, number: int = 0) -> Frame:
        """The frame of values (count,) in the file's order. Its number is its time, too, which the file does not have.

        Raises:
            DataError: If there are more or fewer values than the pattern has measurements.
        """
        if values.shape != (self.count,):
            raise DataError(f"{what} has {values.size} values; the pattern in the file has {self.count} measurements")
        with np.errstate(over="ignore"):  # infinite is clipped
            volts = values[self.rows] / self.gains
        return Frame(self.pattern, volts, self.currents, time=float(number), sequence=number)


def from_list(
    listed: Floats | Ints, currents: Floats, driven: bool, gains: Floats | None = None, injection: Ints | None = None
) -> ImportedPattern:
    """The pattern of a list of measurements in any order.

    Args:
        listed: (n, 4) source, sink, plus, minus electrode, from 0.
        currents: (n,) current of each (A).
        driven: Whether to keep voltages at driven electrodes.
        gains: (n,) what each value is divided by to get volts; 1 unless given.
        injection: (n,) number of the injection of each; those of the same source and sink are one unless given.

    Raises:
        DataError: If a pair has one electrode twice, currents of an injection differ or are zero, or none is left.
    """
    if listed.ndim != 2 or listed.shape[1] != 4 or not 0 < len(listed) <= _MOST_MEASUREMENTS:
        raise DataError(f"a pattern of shape {listed.shape}; need (n, 4) with n from 1 to {_MOST_MEASUREMENTS}")
    if not np.array_equal(listed, np.round(listed)):
        raise DataError("electrode numbers must be whole numbers: source, sink, plus, minus")
    if listed.min() < 0 or listed.max() >= _MOST_ELECTRODES:
        found = f"electrode numbers from {listed.min():g} to {listed.max():g}"
        raise DataError(f"{found}; they must be 0 to {_MOST_ELECTRODES - 1}")
    quadruples = listed.astype(np.int64)
    if len(bad := np.flatnonzero(~(np.isfinite(currents) & (currents != 0)))):
        raise DataError(f"measurement {bad[0]}: its current is {currents[bad[0]]} A; it must be finite and not zero")
    gains = np.ones(len(quadruples)) if gains is None else gains
    a, b, c, d = quadruples.T
    at_driven = (a == c) | (a == d) | (b == c) | (b == d)
    kept = np.flatnonzero(~at_driven | driven)
    left_out = (
        f"{int(at_driven.sum())} of {len(quadruples)} voltages were measured at a driven electrode and are left "
        "out: its contact enters, which a point-electrode model does not have (driven=True keeps them)"
    )
    if not len(kept):
        raise DataError("all voltages are of driven electrodes; a complete electrode model can use them (driven=True)")
    keys = quadruples[:, :2] if injection is None else injection[:, None]
    _, first, which = np.unique(keys[kept], axis=0, return_index=True, return_inverse=True)
    rank = np.empty(len(first), int)
    rank[np.argsort(first)] = np.arange(len(first))  # number injections in the order of the file
    which = rank[which.ravel()]
    order = np.argsort(which, kind="stable")
    amperes = currents[kept][np.sort(first)]
    if len(bad := np.flatnonzero(np.abs(currents[kept] - amperes[which]) > _TOLERANCE * np.abs(amperes[which]))):
        raise DataError(
            f"measurement {kept[bad[0]]}: the current of {currents[kept][bad[0]]:g} A differs from the same "
            "injection's before; record one current per injection"
        )
    try:
        measurements = np.column_stack([which, quadruples[kept, 2:]])[order]
        pattern = DrivePattern(quadruples[kept][np.sort(first), :2], measurements)
    except PatternError as error:
        raise DataError(f"the pattern in the file cannot be used: {error}") from error
    notes = (left_out,) if len(kept) < len(quadruples) else ()
    return ImportedPattern(pattern, amperes, kept[order], gains[kept[order]], len(quadruples), notes)


def from_matrices(drive: Floats, measure: Sequence[Floats], driven: bool) -> ImportedPattern:
    """The pattern of current and measurement matrices.

    Args:
        drive: (n_elec, n_inj) current into each electrode (A).
        measure: For each injection the weights (n, n_elec) that make its voltages of the electrode potentials.
        driven: Whether to keep voltages at driven electrodes.

    Raises:
        DataError: If a current pattern is not balanced or drives other than two electrodes, or a voltage is not the
            difference of two electrodes.
    """
    n_elec, n_inj = drive.shape
    if len(measure) != n_inj or n_elec > _MOST_ELECTRODES or sum(len(m) for m in measure) > _MOST_MEASUREMENTS:
        raise DataError(
            f"{n_inj} injections at {n_elec} electrodes, {len(measure)} lists of measurements; need as many lists as "
            f"injections, at most {_MOST_ELECTRODES} electrodes and {_MOST_MEASUREMENTS} measurements"
        )
    quadruples, currents, gains, injection = [], [], [], []
    for k, weights in enumerate(measure):
        source, sink, current = _pair(drive[:, k], f"injection {k + 1}", "current")
        if weights.ndim != 2 or weights.shape[1] != n_elec:
            raise DataError(f"the measurements of injection {k + 1} have shape {weights.shape}; need (n, {n_elec})")
        for j, row in enumerate(weights):
            plus, minus, gain = _pair(row, f"injection {k + 1}, measurement {j + 1}", "weight")
            quadruples.append((source, sink, plus, minus))
            currents.append(current)
            gains.append(gain)
            injection.append(k)
    listed = np.array(quadruples, np.int64).reshape(-1, 4)
    return from_list(listed, np.array(currents), driven, np.array(gains), np.array(injection))


def _pair(values: Floats, where: str, what: str) -> tuple[int, int, float]:
    """The electrodes with the positive and the negative entry, and the entry."""
    if not np.isfinite(values).all():
        raise DataError(f"{where}: a {what} is not finite")
    largest = float(np.abs(values).max(initial=0.0))
    used = np.flatnonzero(np.abs(values) > _TOLERANCE * largest)
    named = ", ".join(str(e + 1) for e in used[:8]) + (", ..." if len(used) > 8 else "")
    if len(used) == 2 and abs(values[used].sum()) <= _TOLERANCE * largest:
        plus = int(used[np.argmax(values[used])])
        return plus, int(used[np.argmin(values[used])]), float(values[plus])
    if what == "current" and len(used) and abs(values.sum()) > _TOLERANCE * largest * len(used):
        total = f"{where}: its currents add up to {values.sum():g}, not zero"
        raise DataError(f"{total}; the file is damaged or lacks an electrode")
    if what == "current":
        raise DataError(
            f"{where} drives {len(used)} electrodes ({named}) at once; ohmskin's patterns drive two, one against one. "
            "Trigonometric and other many-electrode currents cannot be imported"
        )
    raise DataError(
        f"{where} combines {len(used)} electrodes ({named}); ohmskin measures the difference of two. "
        "Potentials against ground must be subtracted from each other first"
    )
