"""Text tables: measurements in rows, frames in columns, separated by commas.

The plain form has a pattern, in the first columns or in a table beside it, with a header:

    source, sink, plus, minus, current        (electrodes from 0; current in amperes, 1 if the column is left out)

A table of data has a column per frame, with or without a header. Columns whose name begins with ``quiet`` or
``reference`` are of the untouched skin; without such names the first column is. Empty cells and ``nan`` are missing
values, ``inf`` clipped ones. Lines that begin with ``#`` may hold ``first = 1`` (electrodes are counted from 1),
``current = 5e-3`` (amperes, for all) and
``skin = NAME``.

The other form is the PyEIDORS tank's: four columns without a header, Re and Im of a reference and of a frame with
targets in volts, a row for each adjacent measurement; the real parts are used, the current is read from the file name
(``..._55uA_...``).
"""

import csv
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.errors import DataError, shown
from ohmskin.importers import presses
from ohmskin.importers.parts import Recording
from ohmskin.importers.pattern import ImportedPattern, Parts, from_list
from ohmskin.scan import DrivePattern, Frame, adjacent

_ELECTRODES = ("source", "sink", "plus", "minus")
_SETTINGS = ("first", "current", "skin", "values")
_MOST_COLUMNS = 2**14


@dataclass(frozen=True)
class _Table:
    """Cells of a text table, its header (empty if there is none), and its settings."""

    name: str
    header: tuple[str, ...]
    cells: Floats
    settings: dict[str, str]

    def column(self, name: str) -> Floats:
        return self.cells[:, self.header.index(name)]


def read(text: str, description: str | None, path: Path, pattern_path: Path | None, driven: bool) -> Recording:
    """The recording that a table holds.

    Args:
        text: The table.
        description: A table with its pattern, if that is apart.
        path: The table's file, for its name.
        pattern_path: The pattern's file.
        driven: Whether to keep voltages at driven electrodes.

    Raises:
        DataError: If a cell is not a number, rows differ in length, or data and pattern do not fit each other.
    """
    data = _parse(text, str(path))
    if presses.is_press_table(data.header):
        described = None if description is None else _parse(description, str(pattern_path))
        settings = {**(described.settings if described else {}), **data.settings}
        found = None if described is None else _pattern(replace(described, settings=settings), driven)
        return presses.read_table(data.header, data.cells, found, settings, str(path))
    if description is None and not set(_ELECTRODES) <= set(data.header):
        return Recording(*_pyeidors(data, path))
    pattern = _parse(description, str(pattern_path)) if description is not None else data
    settings = {**pattern.settings, **data.settings}
    if settings.get("values", presses.VALUES[0]) != presses.VALUES[0]:
        raise DataError(
            f"{path}: values = {shown(settings['values'])}; only tables of presses have others than voltages"
        )
    imported = _pattern(replace(pattern, settings=settings), driven)
    used = {*_ELECTRODES, "current"} if description is None else set()
    names = data.header or tuple(f"column {k + 1}" for k in range(data.cells.shape[1]))
    columns = [k for k, name in enumerate(names) if name not in used]
    is_quiet = {k: names[k].startswith(("quiet", "reference")) for k in columns}
    if not any(is_quiet.values()) and columns:
        is_quiet[columns[0]] = True
    if len(columns) < 2 or all(is_quiet.values()):
        raise DataError(f"{path} has {len(columns)} columns of data; need at least the untouched skin's and one more")
    frames = {k: imported.frame(data.cells[:, k], str(path), k) for k in columns}
    quiet, touched = (tuple(frame for k, frame in frames.items() if is_quiet[k] is still) for still in (True, False))
    return Recording(quiet, touched, settings.get("skin", ""), imported.notes)


def _parse(text: str, name: str) -> _Table:
    settings = {}
    lines = []
    for line in text.splitlines():
        if line.strip() and not line.strip().startswith("#"):
            lines.append(line)
        elif setting := re.fullmatch(r"#\s*(\w+)\s*([=:])\s*(.*)", line.strip()):
            key, sign, value = setting[1].lower(), setting[2], setting[3].split()
            if key in _SETTINGS and len(value) != 1:
                raise DataError(
                    f"{name}: {shown(line.strip())} sets {key} to no single value; write such as # first = 1"
                )
            if key in _SETTINGS:
                settings[key] = value[0]
            elif sign == "=" and len(value) == 1:
                raise DataError(f"{name}: unknown setting {shown(key)}; choose from {', '.join(_SETTINGS)}")
    try:
        rows = [[cell.strip() for cell in row] for row in csv.reader(lines) if row]
    except csv.Error as error:
        raise DataError(f"{name}: {error}") from error
    if not rows:
        raise DataError(f"{name} is empty; a recording has a row per measurement")
    if ";" in rows[0][0]:
        told = f"{name}: the columns are separated by ';'"
        raise DataError(f"{told}; separate them by commas, and write numbers with a point")
    header: tuple[str, ...] = ()
    if not _is_number(rows[0][0]):
        header = tuple(cell.lower() for cell in rows.pop(0))
        if len(set(header)) < len(header):
            raise DataError(f"{name}: two columns have the same name; the header is {', '.join(header[:12])}")
    width = len(header) or len(rows[0])
    if not rows or width > _MOST_COLUMNS:
        size = f"{name} has {len(rows)} rows of {width} columns"
        raise DataError(f"{size}; need at least one row and at most {_MOST_COLUMNS} columns")
    for number, row in enumerate(rows, 1 + bool(header)):
        if len(row) != width:
            raise DataError(f"{name}, row {number}: {len(row)} columns; the first row has {width}")
    try:
        cells = np.array([[float(cell) if cell else math.nan for cell in row] for row in rows])
    except ValueError as error:
        places = ((i, k, cell) for i, row in enumerate(rows, 1 + bool(header)) for k, cell in enumerate(row, 1))
        number, column, cell = next(place for place in places if not _is_number(place[2]))
        where = f"{name}, row {number}, column {column} is {shown(cell)}"
        raise DataError(f"{where}; every entry must be a number") from error
    return _Table(name, header, cells, settings)


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return True


def _pattern(pattern: _Table, driven: bool) -> ImportedPattern:
    if missing := [name for name in _ELECTRODES if name not in pattern.header]:
        raise DataError(f"{pattern.name} lacks the column {missing[0]}; its header must name {', '.join(_ELECTRODES)}")
    quads = np.column_stack([pattern.column(name) for name in _ELECTRODES])
    try:
        first = int(pattern.settings.get("first", "0"))
        current = float(pattern.settings.get("current", "1"))
    except ValueError as error:
        raise DataError(f"{pattern.name}: {shown(str(error))} in its settings (first = 1, current = 5e-3)") from error
    if first not in (0, 1):
        raise DataError(f"{pattern.name}: first = {first}; electrodes are counted from 0 or 1")
    currents = pattern.column("current") if "current" in pattern.header else np.full(len(quads), current)
    told = "current" in pattern.header or "current" in pattern.settings
    try:
        imported = from_list(quads - first, currents, driven)
    except DataError as error:
        raise DataError(f"{pattern.name}: {error}") from error
    return imported if told else replace(imported, notes=(*imported.notes, "no current in the file: 1 A is assumed"))


def _pyeidors(data: _Table, path: Path) -> Parts:
    if data.header or data.cells.shape[1] != 4:
        raise DataError(
            f"{path}: {data.cells.shape[1]} columns and no pattern. Either name the columns {', '.join(_ELECTRODES)}, "
            f"put a table with them into {path.stem}.pattern.csv, or give 4 columns without a header (Re, Im of a "
            "reference, Re, Im of a frame)"
        )
    pattern = _adjacent_pattern(path, len(data.cells))
    microamperes = re.search(r"_(\d+(?:\.\d+)?)uA_", path.name)
    current = float(microamperes[1]) * 1e-6 if microamperes else 1.0
    if current == 0:
        raise DataError(f"{path} was recorded with no current, by its name; name the current, such as 55uA")
    currents = np.full(pattern.n_inj, current)
    reference, target = (Frame(pattern, data.cells[:, column], currents, time=0.0) for column in (0, 2))
    notes = () if microamperes else ("no current in the file's name (..._55uA_...): 1 A is assumed",)
    if np.any(data.cells[:, [1, 3]] != 0):
        notes = (*notes, "imaginary parts are left out: contacts are found from real ones")
    return (reference,), (target,), data.settings.get("skin", "tank"), notes


def _adjacent_pattern(path: Path, n_rows: int) -> DrivePattern:
    """Adjacent drive of n electrodes has n (n - 3) voltages; each is V(k) - V(k + 1) for the current k + 1 -> k."""
    n_elec = round((3 + math.sqrt(9 + 4 * n_rows)) / 2)
    if n_elec < 4 or n_elec * (n_elec - 3) != n_rows:
        raise DataError(f"{path} has {n_rows} rows; adjacent data of n electrodes have n (n - 3), such as 208 of 16")
    pattern = adjacent([range(n_elec)])
    return DrivePattern(pattern.injections[:, ::-1], pattern.measurements)
