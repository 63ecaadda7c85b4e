"""Entries of a skin's description: defaults with the values that they may have, and the check of what is given."""

import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import field, fields
from functools import partial
from pathlib import Path
from typing import Any, get_origin

from ohmskin.errors import SkinError, shown
from ohmskin.geometry import Domain

_MOST_ON_RIM, _MOST_GIBIBYTES, _MOST_PATCHES, _MOST_UNDER = 3000, 4, 2**14, 2000
_TYPES = {bool: "true or false", str: "text", int: "a whole number", float: "a number"}
_PLACE = "[x, y] in metres"
_HOLE = "holes, each [x, y, radius] or its corners [[x, y], [x, y], [x, y], ...], in metres"


def read_text(path: Path, most: int, what: str) -> str:
    """The text of a file of at most so many bytes; `what` it is, for errors.

    Raises:
        SkinError: If it cannot be read, is larger, or is not UTF-8.
    """
    try:
        if path.is_fifo():
            raise OSError("it is a pipe, which may never end")
        with path.open("rb") as file:
            content = file.read(most + 1)
        if len(content) > most:
            raise SkinError(f"{what} {path} has more than {most} bytes; check that it is the right file")
        if not content.strip():
            raise SkinError(f"{what} {path} is empty; write it again, or take another")
        return content.decode("utf-8-sig")  # some editors begin with a byte order mark
    except (OSError, ValueError) as error:  # also a name with a null byte
        raise SkinError(f"cannot read {what} {path}: {error}") from error


def read_toml(text: str, origin: str) -> dict[str, Any]:
    """The entries of a TOML text.

    Raises:
        SkinError: If it is not valid TOML; `origin` names it.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also a number of thousands of digits, brackets in brackets
        raise SkinError(f"{origin} is not valid TOML: {error}") from error


def check_names(given: Iterable[str], names: Sequence[str], table: str = "") -> None:
    """Raise SkinError for an entry of a `table` that is none of `names`."""
    if unknown := [name for name in given if name not in names]:
        entry = f"{table}{unknown[0]}" if table else repr(unknown[0])
        raise SkinError(f"unknown entry {entry}; choose from {', '.join(names)}")


def number(default: float, low: float, high: float, unit: str = "") -> Any:
    """A number within low..high; whole if its default is."""
    return field(default=default, metadata={"low": low, "high": high, "unit": unit})


def numbers(high: float, unit: str = "", low: float = 0.0) -> Any:
    """A list of numbers within low..high, empty unless given."""
    return field(default=(), metadata={"low": low, "high": high, "unit": unit})


def choice(default: str, *choices: str) -> Any:
    """One of several words."""
    return field(default=default, metadata={"choices": choices})


def rows(row: str) -> Any:
    """A list of such rows of numbers, [x, y] unless given; empty unless given."""
    return field(default=(), metadata={"row": row})


def cutouts() -> Any:
    """A list of holes, round ones or polygons; empty unless given."""
    return field(default=(), metadata={"row": _HOLE})


def is_hole(given: Any) -> bool:
    """Whether a value says where a hole is: [x, y, radius], or at least three corners [x, y]."""
    if not isinstance(given, tuple) or len(given) < 3:
        return False
    return all(_is_row(2, corner) for corner in given) or _is_row(3, given)


def sibling_path(folder: Path, name: Any, what: str, other: str) -> Path:
    """A file that another file names: it must lie in that one's folder.

    Raises:
        SkinError: If it is no name or does not lie there.
    """
    if not isinstance(name, str):
        raise SkinError(f"{what} is {name!r}; it must be the name of a file")
    try:
        path = (folder / name).resolve()
    except (OSError, ValueError) as error:  # also a null byte
        raise SkinError(f"{what} {shown(name)} is not a file name: {error}") from None
    if not path.is_relative_to(folder.resolve()):
        raise SkinError(f"{what} {name!r} lies outside the folder of the {other}; put it beside that")
    return path


def check_table(table: str, values: Any) -> None:
    """Hold each value of a dataclass against its type and the range or the choices in its metadata.

    Raises:
        SkinError: If one is not like that; it names the entry.
    """
    for entry in fields(values):
        value, name, bounds = getattr(values, entry.name), f"{table}.{entry.name}", entry.metadata
        expected: Any = get_origin(entry.type) or entry.type
        if expected is tuple:
            row = bounds.get("row", _PLACE)
            fits: Any = partial(_is_row, row.count(",", 0, row.index("]")) + 1)
            what = row
            if "low" in bounds:
                fits, what = partial(_within, bounds), f"numbers, each {_range(bounds)}"
            elif row == _HOLE:
                fits = is_hole
            if not (isinstance(value, tuple) and all(map(fits, value))):
                raise SkinError(f"{name} must be a list of {what}")
        elif not (is_number(value) if expected is float else type(value) is expected):
            raise SkinError(f"{name} is {shown(value)}; it must be {_TYPES[expected]}")
        elif value not in (choices := bounds.get("choices", (value,))):
            raise SkinError(f"{name} is {shown(value)}; choose from {', '.join(choices)}")
        elif "low" in bounds and not _within(bounds, value):
            raise SkinError(f"{name} is {shown(value)}; it must be {_range(bounds)}")


def _within(bounds: Any, value: Any) -> bool:
    return is_number(value) and bool(bounds["low"] <= value <= bounds["high"])  # false for nan, too


def _range(bounds: Any) -> str:
    return f"{bounds['low']:g} to {bounds['high']:g} {bounds['unit']}".rstrip()


def check_expense(domain: Domain, pairs: int, size: float) -> None:
    """Raise SkinError if a model with edges of `size` (m) would take too long or too much memory, and how much."""
    rim, triangles = domain.perimeter / size, 2.31 * domain.area / size**2
    if 4 * rim > triangles and rim > _MOST_ON_RIM:  # Delaunay's method takes the square of points on parallel lines
        long = f"a strip with edges of {size:.3g} m has {rim:.0f} nodes on its rim, {_MOST_ON_RIM} are allowed"
        raise SkinError(f"{long}: meshing takes about {1e-6 * rim**2:.0f} s; shorten it, or raise imaging.mesh_size")
    if (gibibytes := 8 * pairs * triangles / 2**30) > _MOST_GIBIBYTES:
        many = f"the electrodes make {pairs} pairs, whose sensitivities on {triangles:.0f} triangles"
        advice = "choose fewer electrodes, or raise imaging.mesh_size"
        raise SkinError(f"{many} take about {gibibytes:.1f} GiB; allowed are {_MOST_GIBIBYTES}: {advice}")


def check_patches(patches: int, nodes: float) -> None:
    """Raise SkinError if so many patches, or the `nodes` of the mesh under each, take a virtual skin too long."""
    if nodes > _MOST_UNDER:
        wide = f"a patch of the contact layer covers {nodes:.0f} nodes of the virtual skin's mesh"
        raise SkinError(f"{wide}; allowed are {_MOST_UNDER}: lower contact_layer.patch, or raise imaging.mesh_size")
    if patches > _MOST_PATCHES:
        long = f"a contact layer of {patches} patches takes the virtual skin about {1e-3 * patches:.0f} s to set up"
        raise SkinError(f"{long}; allowed are {_MOST_PATCHES}: raise contact_layer.patch, or lower columns and rows")


def is_number(value: Any) -> bool:
    """Whether a value of a TOML file is a number, which true and false are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def places(given: Any) -> Any:
    """Places as they are kept: TOML gives lists, and a description must be hashable."""
    if not isinstance(given, list | tuple):
        return given
    return tuple(places(place) for place in given)


def _is_row(count: int, row: Any) -> bool:
    return isinstance(row, tuple) and len(row) == count and all(is_number(x) and -1e3 < x < 1e3 for x in row)
