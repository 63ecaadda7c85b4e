"""Recordings: frames on disk, with the quiet ones that they are compared to."""

import os
from dataclasses import replace
from pathlib import Path

from ohmskin.errors import DataError
from ohmskin.importers import eidors, kuopio, presses, table
from ohmskin.importers.matfile import is_mat, load_variables
from ohmskin.importers.parts import Recording
from ohmskin.mcap.messages import Role
from ohmskin.mcap.reader import RecordingReader, is_recording

_LARGEST_FILE = 64 * 2**20
_FOREIGN = {
    b"PK\3\4": "a ZIP archive, such as .npz or .xlsx",
    b"\x93NUMPY": "an array of NumPy (.npy)",
    b"\0\0\0\0": "binary, such as of MATLAB 4",
}


def read_recording(
    path: str | Path, *, reference: str | Path | None = None, pattern: str | Path | None = None, driven: bool = False
) -> Recording:
    """Read a recording. Its contents decide on its format:

    - our own, in MCAP (`ohmskin.mcap.reader`), whose frames are read from the file when they are asked for;
    - MATLAB files of the University of Eastern Finland (UEF 2017; variables CurrentPattern, MeasPattern, Uel) and of
      the Kuopio Tomography Challenge 2023 (Inj, Mpat, Uel, Uelref), each a file per state of the tank
      (`ohmskin.importers.kuopio`);
    - MATLAB files made with EIDORS: a stimulation struct or plain matrices, and data (`ohmskin.importers.eidors`);
    - text tables with a pattern, beside them or in the same file (`ohmskin.importers.table`);
    - the text tables of the PyEIDORS tank: four columns, adjacent measurements;
    - press data, a row for each press of known place, in a text table or a MATLAB file (`ohmskin.importers.presses`).

    Args:
        path: The file.
        reference: A file of the same kind with the untouched skin, for formats that keep it apart; the usual name
            beside `path` unless given.
        pattern: A table of electrodes, for tables without one; ``NAME.pattern.csv`` beside ``NAME.csv`` unless given.
        driven: Keep voltages measured at a driven electrode. They need a complete electrode model, or are left out.

    Raises:
        DataError: If a file cannot be read, is damaged, or has content that cannot be represented here.
    """
    path = Path(path)
    if is_recording(path):
        if reference is not None or pattern is not None:
            raise DataError(f"{path} holds its own patterns and quiet frames; leave reference and pattern out")
        reader = RecordingReader(path)
        return Recording(reader.select(Role.QUIET), reader.select(*set(Role) - {Role.QUIET}), "", reader.notes, reader)
    content = content_of(path)
    if is_mat(content[:8]):
        if pattern is not None:
            raise DataError(f"{path} is a MATLAB file, which holds its own pattern; leave pattern={str(pattern)!r} out")
        variables, notes = load_variables(content, str(path))
        if presses.is_press_file(variables):
            found = presses.read_variables(variables, str(path), driven)
            return replace(found, notes=(*found.notes, *notes))
        if kuopio.is_kuopio(variables):
            other = Path(reference) if reference is not None else kuopio.usual_reference(path, variables)
            at_rest, more = load_variables(content_of(other), str(other)) if other is not None else (None, ())
            quiet, frames, skin, own = kuopio.read(variables, at_rest, str(path), str(other), driven)
            return Recording(quiet, frames, skin, (*own, *notes, *more))
        if reference is not None:
            raise DataError(f"{path} holds its own reference; leave reference={str(reference)!r} out")
        quiet, frames, skin, own = eidors.read(variables, str(path), driven)
        return Recording(quiet, frames, skin, (*own, *notes))
    if reference is not None:
        out = f"leave reference={str(reference)!r} out"
        raise DataError(f"{path} is a text table, which holds its own reference column; {out}")
    beside = path.with_name(path.stem + ".pattern.csv")
    other = Path(pattern) if pattern is not None else beside if os.path.isfile(beside) else None
    description = _text(content_of(other), other) if other is not None else None
    return table.read(_text(content, path), description, path, other, driven)


def content_of(path: Path) -> bytes:
    """All bytes of a file, unless it is too large."""
    try:
        if path.is_fifo():
            raise OSError("it is a pipe, which may never end")
        if path.stat().st_size > _LARGEST_FILE:
            raise DataError(f"{path} has {path.stat().st_size} bytes; others' recordings have at most {_LARGEST_FILE}")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise error if isinstance(error, DataError) else DataError(f"cannot read recording {path}: {error}") from error


def _text(content: bytes, path: Path) -> str:
    for head, what in _FOREIGN.items():
        if content.startswith(head):
            raise DataError(f"{path} is {what}, which is not read; save it as a table (.csv), or for MATLAB with '-v7'")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"cannot read recording {path}: {error}; it is neither a MATLAB file nor text") from error
