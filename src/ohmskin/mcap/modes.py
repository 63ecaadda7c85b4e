"""The modes that a recording was made with: a JSON object in its metadata, an entry for each name."""

import json
from collections.abc import Mapping
from typing import Any

from ohmskin.errors import DataError

_LARGEST = 2**20  # bytes

Modes = Mapping[str, Mapping[str, Any]]
"""Name -> entries such as ``title``, ``drive``, ``reader``, ``estimator``, ``prior``, ``rule``, ``injections``."""


def encode_modes(modes: Modes) -> str:
    """The text of a recording's entry `modes`.

    Raises:
        DataError: If JSON cannot say it, or it is too long.
    """
    try:
        text = json.dumps({name: dict(entries) for name, entries in modes.items()}, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise DataError(f"a recording stores modes as JSON, which cannot represent these: {error}") from error
    if len(text) > _LARGEST:
        raise DataError(f"modes take {len(text)} bytes in a recording; at most {_LARGEST}")
    return text


def decode_modes(text: str) -> dict[str, dict[str, Any]]:
    """The inverse of `encode_modes`.

    Raises:
        DataError: If the text is not an object of objects, or too long.
    """
    try:
        modes = json.loads(text) if len(text) <= _LARGEST else None
    except (ValueError, RecursionError):
        modes = None
    if not isinstance(modes, dict) or not all(isinstance(entries, dict) for entries in modes.values()):
        raise DataError("its table of modes is not a JSON object of objects")
    return modes
