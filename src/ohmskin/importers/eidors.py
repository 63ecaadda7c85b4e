"""MATLAB files made with EIDORS (or by hand in its terms).

Drive and measurement come from the first of

- a struct with a ``stimulation`` array, whatever it is called and however deep it lies: ``fmdl``, ``img.fwd_model``,
  ``imdl.fwd_model``, or the array itself; each entry has ``stim_pattern`` (n_elec, 1) and ``meas_pattern`` (n, n_elec);
- ``stim_pattern`` (n_elec, n_inj) and ``meas_pattern`` (n, n_elec) as matrices, the same voltages for every injection;
- ``stim_meas_list`` (n, 4): stim+, stim-, meas+, meas-, from 1.

Data are a vector or matrix (n_meas, n_frames), or structs with a field ``meas``: the untouched state as ``vh`` (or
``v_h``,
``homg``, ``reference``), the others as ``vi`` (or ``v_i``, ``inhomg``, ``frames``). Rows are thinned by
``meas_select`` of the forward model where they are as many as it has entries.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from ohmskin.errors import DataError
from ohmskin.importers.matfile import entries, numbers
from ohmskin.importers.pattern import ImportedPattern, Parts, from_list, from_matrices
from ohmskin.scan import Frame

_QUIET = ("vh", "v_h", "homg", "reference")
_FRAMES = ("vi", "v_i", "inhomg", "frames")
_INSIDE = ("fwd_model", "stimulation", "inv_model")
_UNITS = {"amp": 1.0, "a": 1.0, "ampere": 1.0, "amperes": 1.0, "amps": 1.0, "ma": 1e-3, "ua": 1e-6}
_MOST_FRAMES = 2**16


def read(variables: dict[str, Any], name: str, driven: bool) -> Parts:
    """Quiet frames, frames, no skin, and notes.

    Args:
        variables: Of the file.
        name: What to call it in errors.
        driven: Whether to keep voltages at driven electrodes.

    Raises:
        DataError: If pattern or data are missing, do not fit each other or cannot be represented.
    """
    try:
        imported, select = pattern_of(variables, driven)
        quiet = _frames(variables, _QUIET, imported, select)
        frames = _frames(variables, _FRAMES, imported, select)
    except DataError as error:
        raise DataError(f"{name}: {error}") from error
    return quiet, frames, "", (*imported.notes, "the file does not describe the body: name a skin")


def pattern_of(variables: dict[str, Any], driven: bool) -> tuple[ImportedPattern, np.ndarray | None]:
    """The pattern that a file's variables hold, and which of its measurements (n,) are selected, if it says so."""
    for key, value in variables.items():
        found = (array for array in structs(value) if all("stim_pattern" in entry for entry in array))
        if stimulation := next(found, None):
            drives, measures = [], []
            for number, entry in enumerate(stimulation, 1):
                where = f"{key}, stimulation {number}"
                unit = _unit(entry.get("stimulation"), where)
                drives.append(unit * numbers(entry["stim_pattern"], f"{where}: stim_pattern").ravel())
                measures.append(numbers(entry.get("meas_pattern"), f"{where}: meas_pattern"))
            if len({len(drive) for drive in drives}) > 1:
                raise DataError(f"{key}: the stimulations have different numbers of electrodes")
            selected = (
                numbers(first["meas_select"], "meas_select").ravel() != 0
                for first, *_ in structs(value)
                if first.get("meas_select") is not None
            )
            return from_matrices(np.column_stack(drives), measures, driven), next(selected, None)
    if "stim_pattern" in variables and "meas_pattern" in variables:
        drive = numbers(variables["stim_pattern"], "stim_pattern")
        measure = numbers(variables["meas_pattern"], "meas_pattern")
        return from_matrices(drive, [measure] * drive.shape[1], driven), None
    if "stim_meas_list" in variables:
        quads = numbers(variables["stim_meas_list"], "stim_meas_list")
        if quads.min(initial=1) == 0:
            raise DataError("stim_meas_list names electrode 0, but EIDORS counts from 1; add 1 to all of its numbers")
        return from_list(quads - 1, np.ones(len(quads)), driven), None
    raise DataError(
        "no pattern found: need a struct with a stimulation array (stim_pattern, meas_pattern), the matrices "
        "stim_pattern and meas_pattern, stim_meas_list, or the variables of UEF or KTC2023; there are "
        + (", ".join(sorted(variables)[:12]) or "none")
    )


def structs(value: Any, depth: int = 0) -> Iterator[list[dict[str, Any]]]:
    """The struct array that a value is, and those inside its first entry, from the outside in."""
    if found := entries(value):
        yield found
        for inside in _INSIDE if depth < 4 else ():
            yield from structs(found[0].get(inside), depth + 1)


def _unit(value: Any, where: str) -> float:
    text = value if isinstance(value, str) and value else "Amp"
    if text.lower() not in _UNITS:
        raise DataError(f"{where}: stimulation is {text!r}; only currents can be imported ({', '.join(_UNITS)})")
    return _UNITS[text.lower()]


def _frames(
    variables: dict[str, Any], names: Iterable[str], imported: ImportedPattern, select: np.ndarray | None
) -> tuple[Frame, ...]:
    key = next((name for name in names if name in variables), None)
    if key is None:
        raise DataError(f"no data named {' or '.join(names)}; there are {', '.join(sorted(variables)[:12])}")
    structs = entries(variables[key])
    values = [numbers(entry.get("meas"), f"{key}.meas") for entry in structs] or [numbers(variables[key], key)]
    lengths = {imported.count} if select is None else {imported.count, len(select)}
    for rows, across in (block.shape for block in values if len(block) > 1):
        if rows not in lengths and across in lengths:
            turned = f"{key} is {rows} x {across}, with a row for each frame"
            raise DataError(f"{turned}; transpose it: a column for each, {across} x {rows}")
    columns = [column for block in values for column in (block.T if block.shape[0] > 1 else block)]
    if not columns:
        raise DataError(f"{key} has no frames; need at least one, a column for each")
    if len(columns) > _MOST_FRAMES:
        most = f"at most {_MOST_FRAMES} are read. Is it (n_frames, n_meas)? Transpose it"
        raise DataError(f"{key} has {len(columns)} frames; {most}")
    frames = []
    for number, column in enumerate(columns):
        if select is not None and len(column) == len(select) != imported.count:
            column = column[select]
        frames.append(imported.frame(column, key, number))
    return tuple(frames)
