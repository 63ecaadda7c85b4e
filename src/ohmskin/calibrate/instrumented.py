"""Presses that something else measures, such as a load cell under a finger: samples are taken while both hold still."""

import csv
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.calibrate.force import PressSample
from ohmskin.contacts import Contact
from ohmskin.errors import DataError
from ohmskin.scan import Difference

_STEADY = 0.05  # share by which a force may change within the cycles of a sample
_LEAST = 0.1  # N, below which a load cell tells of nothing
_ANOTHER, _ELSEWHERE = 0.2, 0.015  # share of force or m of place by which the next sample must differ
_EASED = 0.95  # of the greatest force so far, below which a press has eased off
_OLD = 0.2  # s, after which a reading counts no more


class LoadCell:
    """The newest force measured by another instrument; set from any thread.

    Attributes:
        trouble: Why its newest message has no force, in words; empty if it has one.
        lost: Why it has gone for good, likewise.
    """

    def __init__(self) -> None:
        self._lock, self._newest = threading.Lock(), (np.nan, -np.inf)
        self.trouble, self.lost = "", ""

    def update(self, force: float) -> None:
        """Store a reading, `force` (N); its sign is ignored."""
        with self._lock:
            self._newest, self.trouble = (abs(force), time.monotonic()), ""

    def fail(self, why: str, lost: bool = False) -> None:
        """Store `why` there is no reading, and whether the cell is `lost` for good."""
        self.trouble, self.lost = why, why if lost else self.lost

    @property
    def force(self) -> float:
        """Force (N); NaN without a recent one."""
        with self._lock:
            force, at = self._newest
        return force if time.monotonic() - at < _OLD else float("nan")


@dataclass(frozen=True)
class _Cycle:
    contact: Contact
    scans: tuple[Difference, ...]
    force: float
    auxiliary: float


class ForceSampler:
    """Takes a sample of every press that is steady for some cycles, at any place; see `PressGuide`.

    Args:
        count: Samples wanted.
        settle: First cycles of a steady press that are not used.
        cycles: Cycles that a sample is made of.

    Attributes:
        count: Samples wanted.
        samples: The samples so far.
        peaks: For each sample the greatest force before it fell to this force (N); 0 where it was rising.
    """

    def __init__(self, count: int, settle: int = 6, cycles: int = 10) -> None:
        self.count, self._cycles = count, cycles
        self.samples, self.peaks = list[PressSample](), list[float]()
        self._seen: deque[_Cycle] = deque(maxlen=settle + cycles)
        self._began, self._greatest = (0.0, 0.0), 0.0  # of the present press

    @property
    def done(self) -> bool:
        """Whether there are enough samples."""
        return len(self.samples) >= self.count

    def add(
        self, contacts: Sequence[Contact], scans: Sequence[Difference], force: float, auxiliary: float = np.nan
    ) -> bool:
        """Add one cycle.

        Args:
            contacts: All of the cycle; only a cycle with exactly one is used.
            scans: What was measured, (n_scans,) changes against the quiet skin.
            force: Reading of the load cell at that moment (N); below 0.1, or not finite, it measures no press.
            auxiliary: What the auxiliary channel read (N or Pa); NaN: there is none.

        Returns:
            Whether a sample was taken.
        """
        if len(contacts) != 1 or not _LEAST <= force < np.inf:
            self._seen.clear()
            return False
        (contact,) = contacts
        if not self._seen or contact.id != self._seen[-1].contact.id:
            self._seen.clear()
            self._began, self._greatest = contact.position, 0.0
        self._greatest = max(self._greatest, force)
        self._seen.append(_Cycle(contact, tuple(scans), force, auxiliary))
        forces = np.array([cycle.force for cycle in self._seen])
        if len(forces) < (self._seen.maxlen or 0) or np.ptp(forces) > _STEADY * forces.mean() or not self._new(forces):
            return False
        counted = list(self._seen)[-self._cycles :]
        mean = float(np.mean([cycle.force for cycle in counted]))
        strength = float(np.median([abs(cycle.contact.strength) for cycle in counted]))
        measured = tuple(scan for cycle in counted for scan in cycle.scans)
        auxiliary_median = float(np.median([cycle.auxiliary for cycle in counted]))
        rising = mean > _EASED * self._greatest
        self.samples.append(PressSample(self._began, mean, strength, rising, contact, measured, auxiliary_median))
        self.peaks.append(0.0 if rising else self._greatest)
        return True

    def _new(self, forces: Floats) -> bool:
        """Whether this press is another one than that of the last sample."""
        if not self.samples or self.samples[-1].contact is None:
            return True
        last, contact = self.samples[-1], self._seen[-1].contact
        moved = np.hypot(*np.subtract(contact.position, self.samples[-1].contact.position))
        changed = abs(float(forces.mean()) / last.force - 1) > _ANOTHER
        return bool(changed or moved > _ELSEWHERE or contact.id != self.samples[-1].contact.id)


def read_table(path: Path, columns: Sequence[str]) -> Floats:
    """Columns (n_rows, n_columns) of a table with a header; other columns of it are ignored.

    Args:
        path: A .csv file.
        columns: Names of the columns, in the order wanted.

    Raises:
        DataError: If it cannot be read, a column is missing, or an entry is not a number.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            header = [name.strip() for name in next(csv.reader(file), [])]
            rows = list(csv.DictReader(file, header))
    except (OSError, UnicodeError, csv.Error) as error:
        raise DataError(f"cannot read {path}: {error}") from error
    if missing := [name for name in columns if name not in header]:
        raise DataError(f"{path} has no column {missing[0]}; it needs {', '.join(columns)}")
    try:
        table = [[float(row[name]) for name in columns] for row in rows]
    except (ValueError, TypeError) as error:
        raise DataError(f"{path}: {error}; every row needs numbers for {', '.join(columns)}") from error
    found = np.array(table, float).reshape(-1, len(columns))
    if not len(found) or not np.isfinite(found).all():
        raise DataError(f"{path} has no rows, or numbers that are not finite")
    return found
