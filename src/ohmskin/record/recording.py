"""Recordings: frames on disk, with the quiet ones that they are compared to."""

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ohmskin.errors import DataError
from ohmskin.scan import DrivePattern, Frame, adjacent
from ohmskin.scan.frame import Floats

_LARGEST_FILE = 64 * 2**20


@dataclass(frozen=True)
class Recording:
    """What a recording holds.

    Args:
        quiet: Frames of the untouched skin.
        frames: Frames to look at, in order.
        skin: The shipped skin description that fits the format.
    """

    quiet: tuple[Frame, ...]
    frames: tuple[Frame, ...]
    skin: str


def read_recording(path: str | Path) -> Recording:
    """Read a recording.

    So far one format is known, the tank measurements of the PyEIDORS project: a CSV file with a row for each adjacent
    measurement and the columns Re, Im of a reference frame and Re, Im of a frame with targets, in volts; the real parts
    are used. The current is read from the file name (``..._55uA_...``).

    Raises:
        DataError: If the file cannot be read or is not such a table.
    """
    path = Path(path)
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise DataError(f"{path} has {path.stat().st_size} bytes; recordings of this format have at most {_LARGEST_FILE}")
        with path.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.reader(file) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"cannot read recording {path}: {error}") from error
    table = _table(path, rows)
    pattern = _adjacent_pattern(path, len(table))
    microamperes = re.search(r"_([0-9.]+)uA_", path.name)
    current = float(microamperes[1]) * 1e-6 if microamperes else 1.0
    currents = np.full(pattern.n_inj, current)
    reference, target = (Frame(pattern, table[:, column], currents, time=0.0) for column in (0, 2))
    return Recording((reference,), (target,), skin="tank")


def _table(path: Path, rows: list[list[str]]) -> Floats:
    for number, row in enumerate(rows, 1):
        if len(row) != 4:
            raise DataError(f"{path}, row {number}: {len(row)} columns; expected 4 (Re, Im reference, Re, Im with targets, volts)")
    try:
        return np.array(rows, float).reshape(-1, 4)
    except ValueError as error:
        raise DataError(f"{path}: {error}; every entry must be a number in volts") from error


def _adjacent_pattern(path: Path, n_rows: int) -> DrivePattern:
    """Adjacent drive of n electrodes has n (n - 3) voltages; here each is V(k) - V(k + 1) for the current k + 1 -> k."""
    n_elec = round((3 + math.sqrt(9 + 4 * n_rows)) / 2)
    if n_elec < 4 or n_elec * (n_elec - 3) != n_rows:
        raise DataError(f"{path} has {n_rows} rows; adjacent data of n electrodes have n (n - 3), such as 208 for n = 16")
    pattern = adjacent([range(n_elec)])
    return DrivePattern(pattern.injections[:, ::-1], pattern.measurements)
