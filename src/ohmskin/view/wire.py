"""The messages of the live page (docs/live-page.md): how a frame is packed, what a browser may ask for."""

import json
import math
import re
import struct
from collections.abc import Callable, Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ohmskin.arrays import as_plain
from ohmskin.errors import ViewError

LARGEST_COMMAND = 4096
"""Bytes a browser may send in one message."""

_SPEEDS = (0.01, 1000.0)  # seconds of a recording per second
_IDENTIFIER = re.compile(r"[A-Za-z0-9_-]{1,32}")
_PREFIX = struct.Struct("<cI")
_LENGTH = struct.Struct("<I")


class CommandError(ValueError):
    """A browser sent something that is not a command of this page."""


# --- the pipe between the loop and the page's process -----------------------------------------------------------------


def write_message(stream: IO[bytes], kind: bytes, payload: bytes) -> None:
    """Write one message: its kind (one byte), its length, its bytes."""
    stream.write(_PREFIX.pack(kind, len(payload)) + payload)
    stream.flush()


def read_message(stream: IO[bytes]) -> tuple[bytes, bytes] | None:
    """The kind and bytes of the next message; None once the other side has gone."""
    prefix = stream.read(_PREFIX.size)
    if len(prefix) < _PREFIX.size:
        return None
    kind, length = _PREFIX.unpack(prefix)
    payload = stream.read(length)
    return (kind, payload) if len(payload) == length else None


# --- to the browser ---------------------------------------------------------------------------------------------------


def check_setup(setup: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of `setup` with its type and every part that page and server rely on.

    Raises:
        ViewError: If a part is missing or cannot be written as JSON.
    """
    try:
        kind = setup["skin"]["domain"]["kind"]
        _box(setup)
        _require(setup, "version", "skin", "device")
        _require(setup["skin"], "name")
        _require(setup["raster"], "x0", "y0", "pitch", "nx", "ny")
        for mode in setup["modes"]:
            _require(mode, "name", "title", "available")
        for choices in (setup.get("choices") or {}).values():
            for choice in choices:
                _require(choice, "name", "title")
        for electrode in setup["skin"]["electrodes"]:
            _require(electrode, "x", "y")
        if setup["press"] is not None:
            for name in ("radius", "pressure"):
                low, high, usual = setup["press"][name]
                if not low <= usual <= high:
                    raise ViewError(f"setup press {name} is {setup['press'][name]}; need [least, largest, usual]")
        if setup.get("recording") is not None and not 0 <= setup["recording"]["length"] < math.inf:
            raise ViewError(f"setup recording is {setup['recording']}; need a length of 0 s or more")
        plain = json.loads(to_json({"type": "setup", "unit": "mS", **setup}))
    except (KeyError, TypeError, ValueError) as wrong:
        what = f"the setup of the live page is incomplete or malformed ({wrong!r})"
        raise ViewError(f"{what}; docs/live-page.md lists it") from wrong
    if kind not in ("rectangle", "disc"):
        raise ViewError(f"domain kind {kind!r}; the live page draws 'rectangle' and 'disc'")
    return dict(plain)


def _require(part: Mapping[str, Any], *names: str) -> None:
    if missing := [name for name in names if name not in part]:
        raise KeyError(f"without {', '.join(missing)}")


def pack_frame(header: Mapping[str, Any], base: NDArray, image: NDArray) -> bytes:
    """One frame as the browser gets it: header length, JSON header, base and image (ny, nx) as `<f4`."""
    text = to_json(header).encode()
    text += b" " * (-len(text) % 4)  # the browser maps the arrays in place, which needs multiples of 4
    return b"".join([_LENGTH.pack(len(text)), text, base.astype("<f4").tobytes(), image.astype("<f4").tobytes()])


def to_json(value: object) -> str:
    """Strict JSON: NumPy values become plain ones, numbers that are not finite become null."""
    try:
        return json.dumps(value, separators=(",", ":"), allow_nan=False, default=_plain)
    except ValueError:  # rare (a latency before the first frame), so that finite messages are not walked through
        return json.dumps(as_plain(value), separators=(",", ":"), allow_nan=False)


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not JSON")


# --- from the browser -------------------------------------------------------------------------------------------------


def read_command(text: str, setup: Mapping[str, Any]) -> dict[str, Any]:
    """The command that a browser sent, checked field by field against `setup`.

    Raises:
        CommandError: If it is not JSON, not a command of this page, or out of range.
    """
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise CommandError("not JSON") from None
    if not isinstance(message, dict):
        raise CommandError("not a JSON object")
    kind = message.get("type")
    fields = _COMMANDS.get(kind) if isinstance(kind, str) else None
    if fields is None:
        raise CommandError(f"type must be one of {', '.join(_COMMANDS)}")
    if set(message) != {"type", *fields}:
        raise CommandError(f"{kind} needs exactly these fields: {', '.join(fields) or 'none'}")
    return {"type": kind} | {name: check(name, message[name], setup) for name, check in fields.items()}


def _identifier(name: str, value: object, setup: Mapping[str, Any]) -> str:
    if not (isinstance(value, str) and _IDENTIFIER.fullmatch(value)):
        raise CommandError(f"{name} must be 1 to 32 letters, digits, '-' or '_'")
    return value


def _flag(name: str, value: object, setup: Mapping[str, Any]) -> bool:
    if not isinstance(value, bool):
        raise CommandError(f"{name} must be true or false")
    return value


def _count(name: str, value: object, setup: Mapping[str, Any]) -> int:
    return _whole(name, value, 0, 2**53 - 1)


def _budget(name: str, value: object, setup: Mapping[str, Any]) -> int:
    limits = [mode["injections"] for mode in setup["modes"] if mode.get("injections")]
    if not limits:
        raise CommandError("no mode of this skin has a choice of injections")
    low, high = min(limit[0] for limit in limits), max(limit[1] for limit in limits)
    return _whole(name, value, low, high)


def _mode(name: str, value: object, setup: Mapping[str, Any]) -> str:
    choices = [str(mode["name"]) for mode in setup["modes"] if mode["available"]]
    if not isinstance(value, str) or value not in choices:
        raise CommandError(f"{name} must be one of {', '.join(choices)}")
    return value


def _choice(name: str, value: object, setup: Mapping[str, Any]) -> str:
    choices = [str(entry["name"]) for entry in (setup.get("choices") or {}).get(name, [])]
    if not isinstance(value, str) or value not in choices:
        if not choices:
            raise CommandError(f"there is no choice of {name}")
        raise CommandError(f"{name} must be one of {', '.join(choices)}")
    return value


def _place(name: str, value: object, setup: Mapping[str, Any]) -> float:
    x_min, y_min, x_max, y_max = _box(setup)
    return _within(name, value, *((x_min, x_max) if name == "x" else (y_min, y_max)))


def _press_setting(name: str, value: object, setup: Mapping[str, Any]) -> float:
    if setup["press"] is None:
        raise CommandError("this device is not virtual; press it with a finger")
    low, high, _ = setup["press"][name]
    return _within(name, value, low, high)


def _recorded(name: str, value: object, setup: Mapping[str, Any]) -> object:
    """What only a recording can do, whatever the value."""
    if setup.get("recording") is None:
        raise CommandError("this device is not a recording; only a recording has a place, a speed and an end")
    return value


def _position(name: str, value: object, setup: Mapping[str, Any]) -> float:
    _recorded(name, value, setup)
    return _within(name, value, 0.0, setup["recording"]["length"])


def _step(name: str, value: object, setup: Mapping[str, Any]) -> int:
    _recorded(name, value, setup)
    if not isinstance(value, int) or isinstance(value, bool) or value not in (-1, 1):
        raise CommandError(f"{name} must be 1 or -1")
    return value


def _speed(name: str, value: object, setup: Mapping[str, Any]) -> float | None:
    _recorded(name, value, setup)
    if value is None:
        return None
    try:
        return _within(name, value, *_SPEEDS)
    except CommandError as refusal:
        raise CommandError(f"{refusal}, or null for as fast as it can") from None


def _loop(name: str, value: object, setup: Mapping[str, Any]) -> bool:
    return _flag(name, _recorded(name, value, setup), setup)


def _whole(name: str, value: object, low: int, high: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise CommandError(f"{name} must be an integer from {low} to {high}")
    return value


def _within(name: str, value: object, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise CommandError(f"{name} must be a number")
    slack = 1e-9 * max(abs(low), abs(high))  # a slider's end is not exactly the number that was sent to it
    if not low - slack <= value <= high + slack:  # also false for NaN
        raise CommandError(f"{name} must be from {low:g} to {high:g}")
    return min(max(float(value), low), high)


def _box(setup: Mapping[str, Any]) -> tuple[float, float, float, float]:
    domain = setup["skin"]["domain"]
    if domain["kind"] == "disc":
        return (-domain["radius"], -domain["radius"], domain["radius"], domain["radius"])
    return (0.0, 0.0, domain["width"], domain["height"])


_COMMANDS: dict[str, dict[str, Callable[[str, object, Mapping[str, Any]], object]]] = {
    "press": {"id": _identifier, "x": _place, "y": _place, "radius": _press_setting, "pressure": _press_setting},
    "lift": {"id": _identifier},
    "lift_all": {},
    "mode": {"mode": _mode},
    "estimator": {"estimator": _choice, "prior": _choice, "rule": _choice},
    "injections": {"count": _budget},
    "calibrate": {},
    "pause": {"paused": _flag},
    "demo": {"on": _flag},
    "seek": {"position": _position},
    "step": {"cycles": _step},
    "speed": {"speed": _speed},
    "loop": {"on": _loop},
    "ack": {"sequence": _count},
}
