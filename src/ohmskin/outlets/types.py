"""ROS 2 message types from their definitions: what is in them, and the hash that names a type to others (RIHS01).

The hash is the SHA-256 of a JSON text that lists the fields of a type and of all types in it (REP 2016). Two sides
only talk if their hashes agree, so that a definition that differs in one name is noticed.
"""

import hashlib
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass

from ohmskin.errors import PublishError

_PRIMITIVES = (
    *("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"),
    *("float32", "float64", "long_double", "char", "wchar", "bool", "byte", "string"),
)
_NUMBERS = {name: number for number, name in enumerate(_PRIMITIVES, start=2)}
_NESTED, _ARRAY, _SEQUENCE = 1, 48, 144  # added to a type's number
_FIELD = re.compile(r"([A-Za-z0-9_/]+)(\[(\d*)\])?\s+([a-z][a-z0-9_]*)$")


@dataclass(frozen=True)
class Field:
    """A field of a message: its name, its type (``float64`` or ``package/msg/Name``), and how many there are.

    `count` is None for a single one, 0 for a sequence, else the length of an array.
    """

    name: str
    type: str
    count: int | None = None


Types = dict[str, tuple[Field, ...]]
"""The fields of each message type."""


def read_types(name: str, definition: str) -> Types:
    """The types that a definition tells of: its own, called `name`, and those behind lines of ``===`` and ``MSG:``.

    Raises:
        PublishError: If a line is neither a field nor a comment nor a constant.
    """
    types: Types = {}
    for part in re.split(r"={80}\n", definition):
        head, _, rest = part.partition("\n")
        own = _full(head.removeprefix("MSG: ").strip()) if head.startswith("MSG: ") else name
        fields = []
        for line in (rest if head.startswith("MSG: ") else part).splitlines():
            text = line.partition("#")[0].strip()
            if not text or "=" in text:
                continue
            found = _FIELD.match(text)
            if not found:
                raise PublishError(f"the definition of {own} has a line {line!r}, which is no field")
            kind = found[1] if found[1] in _NUMBERS else _full(found[1], own)
            fields.append(Field(found[4], kind, int(found[3] or 0) if found[2] else None))
        types[own] = tuple(fields)
    return types


def parts_of(name: str, types: Types) -> list[str]:
    """The names of all types in a type, not its own, sorted.

    Raises:
        PublishError: If one of them is not known.
    """
    found: set[str] = set()
    ahead = [name]
    while ahead:
        own = ahead.pop()
        if own not in types:
            raise PublishError(f"type {name} has a {own} in it, which is not defined")
        fresh = {field.type for field in types[own] if field.type not in _NUMBERS} - found
        found |= fresh
        ahead += fresh
    return sorted(found)


def rihs01(name: str, types: Types) -> str:
    """The hash of a type."""

    def described(own: str) -> dict[str, object]:
        fields = []
        for field in types[own]:
            number = _NUMBERS.get(field.type, _NESTED)
            number += 0 if field.count is None else _ARRAY if field.count else _SEQUENCE
            nested = "" if field.type in _NUMBERS else field.type
            kind = {"type_id": number, "capacity": field.count or 0, "string_capacity": 0, "nested_type_name": nested}
            fields.append({"name": field.name, "type": kind})
        return {"type_name": own, "fields": fields}

    parts = [described(own) for own in parts_of(name, types)]
    text = json.dumps({"type_description": described(name), "referenced_type_descriptions": parts})
    return f"RIHS01_{hashlib.sha256(text.encode()).hexdigest()}"


def joined(name: str, texts: dict[str, str], types: Types) -> str:
    """The definition of a type and all types in it, from a text for each."""
    parts = [texts[name], *(f"MSG: {_short(own)}\n{texts[own]}" for own in parts_of(name, types))]
    return ("=" * 80 + "\n").join(parts)


def split(name: str, definition: str) -> Iterable[tuple[str, str]]:
    """Name and text of each type that a definition tells of; `joined` is the inverse."""
    for part in re.split(r"={80}\n", definition):
        head, _, rest = part.partition("\n")
        yield (_full(head.removeprefix("MSG: ").strip()), rest) if head.startswith("MSG: ") else (name, part)


def dds_name(name: str) -> str:
    """How DDS calls a type: ``sensor_msgs::msg::dds_::Image_``."""
    package, _, own = name.split("/")
    return f"{package}::msg::dds_::{own}_"


def _full(name: str, inside: str = "") -> str:
    """``std_msgs/Header`` as ``std_msgs/msg/Header``; a name without a package is of the package that it is in."""
    if "/" not in name:
        name = f"{inside.partition('/')[0]}/{name}"
    return name if "/msg/" in name else name.replace("/", "/msg/")


def _short(name: str) -> str:
    return name.replace("/msg/", "/")
