"""The MATLAB files of two public data sets from Kuopio, one file per state of the tank.

- UEF 2017 (Hauptmann et al., arXiv:1704.01178): ``CurrentPattern`` (n_elec, n_inj) in milliamperes, ``MeasPattern``
  (n_elec, n), a column per voltage, ``Uel`` (n, n_inj) in volts. ``datamat_1_0.mat`` is the homogeneous tank.
- Kuopio Tomography Challenge 2023 (Räsänen et al., doi:10.5281/zenodo.8252370): ``Inj`` (n_elec, n_inj), ``Mpat``
  (n_elec, n),
  ``Uel`` (n n_inj, 1), the voltages of one injection after the other. ``ref.mat`` is the homogeneous tank, with
  ``Injref``,
  ``Mpat``, ``Uelref``.

Currents are read as milliamperes in both. Electrode 1 is at 12 o'clock in both; UEF numbers clockwise, the challenge
counterclockwise (its organisers' mesh).
"""

import re
from pathlib import Path
from typing import Any

from ohmskin.arrays import Floats
from ohmskin.errors import DataError
from ohmskin.importers.matfile import numbers
from ohmskin.importers.pattern import ImportedPattern, Parts, from_matrices
from ohmskin.scan import Frame

_MILLIAMPERE = 1e-3
_DRIVES, _MEASURES, _VOLTAGES = ("CurrentPattern", "Injref", "Inj"), ("MeasPattern", "Mpat"), ("Uel", "Uelref")


def is_kuopio(variables: dict[str, Any]) -> bool:
    """Whether these are variables of one of the two data sets."""
    return any(name in variables for name in _VOLTAGES)


def usual_reference(path: Path, variables: dict[str, Any]) -> Path | None:
    """The homogeneous tank's file beside `path`; None if `path` is that file itself.

    Raises:
        DataError: If there is none.
    """
    if "CurrentPattern" in variables:
        series = re.fullmatch(r"(datamat_\d+_)\d+\.mat", path.name)
        names = [*([series[1] + "0.mat"] if series else []), "datamat_1_0.mat"]
    else:
        names = ["ref.mat"]
    if path.name in names:
        return None
    for name in names:
        if (beside := path.with_name(name)).is_file():
            return beside
    missing = f"{' or '.join(names)} is not beside it"
    raise DataError(f"{path} has no frame of the untouched tank, and {missing}; give reference=...")


def read(
    variables: dict[str, Any], at_rest: dict[str, Any] | None, name: str, reference_name: str, driven: bool
) -> Parts:
    """Quiet frames, frames, skin and notes.

    Args:
        variables: Of the file.
        at_rest: Of the homogeneous tank's file; None if the file is that one.
        name: What to call the file in errors.
        reference_name: And the other one.
        driven: Whether to keep voltages at driven electrodes.

    Raises:
        DataError: If variables are missing, do not fit each other or the reference, or cannot be represented.
    """
    patterns = variables if _has_pattern(variables) else at_rest or variables
    imported = _pattern(patterns, name, driven)
    frame = _frame(variables, imported, name)
    notes = imported.notes
    if at_rest is None:
        quiet, notes = frame, (*notes, "this is the untouched tank itself, without a change")
    else:
        own = _pattern(at_rest, reference_name, driven) if _has_pattern(at_rest) else imported
        if own.pattern != imported.pattern:
            raise DataError(f"{reference_name} has another pattern than {name}; give the reference of the same series")
        quiet = _frame(at_rest, imported, reference_name)
        notes = (*notes, f"compared to {reference_name}")
    kind = "CurrentPattern" in patterns, len(_first(patterns, _DRIVES, name))
    return (quiet,), (frame,), {(True, 16): "uef2017", (False, 32): "ktc2023"}.get(kind, ""), notes


def _has_pattern(variables: dict[str, Any]) -> bool:
    return all(any(name in variables for name in names) for names in (_DRIVES, _MEASURES))


def _first(variables: dict[str, Any], names: tuple[str, ...], file: str) -> Floats:
    """The first of the variables of these names that there is."""
    for name in names:
        if name in variables:
            return numbers(variables[name], f"{file}: {name}")
    raise DataError(f"{file} has no variable {' or '.join(names)}; it has {', '.join(sorted(variables)[:12])}")


def _pattern(variables: dict[str, Any], name: str, driven: bool) -> ImportedPattern:
    drive, measure = (_first(variables, names, name) for names in (_DRIVES, _MEASURES))
    if drive.shape[0] != measure.shape[0] or drive.shape[1] * measure.shape[1] > 2**20:
        raise DataError(
            f"{name}: currents are {drive.shape} and measurements {measure.shape}; both need a row per electrode, "
            "and a column per injection or voltage"
        )
    try:
        return from_matrices(_MILLIAMPERE * drive, [measure.T] * drive.shape[1], driven)
    except DataError as error:
        raise DataError(f"{name}: {error}") from error


def _frame(variables: dict[str, Any], imported: ImportedPattern, name: str) -> Frame:
    # both data sets run through the voltages of one injection first: columns of a matrix, or one long column
    return imported.frame(_first(variables, _VOLTAGES, name).ravel(order="F"), f"the voltages of {name}")
