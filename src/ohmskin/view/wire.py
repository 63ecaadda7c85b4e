"""The messages of the live page (docs/live-page.md): how a frame is packed, what a browser may ask for."""

import json
import math
import re
import struct
from collections.abc import Mapping
from typing import IO, Any

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
        for part, names in (
            (setup, "version skin device"),
            (setup["skin"], "name"),
            (setup["raster"], "x0 y0 pitch nx ny"),
            *((mode, "name title available") for mode in setup["modes"]),
            *((choice, "name title") for choices in (setup.get("choices") or {}).values() for choice in choices),
            *((electrode, "x y") for electrode in setup["skin"]["electrodes"]),
        ):
            if missing := [name for name in names.split() if name not in part]:
                raise KeyError(f"without {', '.join(missing)}")
        if setup["press"] is not None:
            for name in ("radius", "pressure"):
                low, high, usual = setup["press"][name]
                if not low <= usual <= high:
                    raise ViewError(f"setup press {name} is {setup['press'][name]}; need [min, max, default]")
        if setup.get("recording") is not None and not 0 <= setup["recording"]["length"] < math.inf:
            raise ViewError(f"setup recording is {setup['recording']}; need a length of 0 s or more")
        plain = json.loads(to_json({"type": "setup", "unit": "mS", **setup}))
    except (KeyError, TypeError, ValueError) as wrong:
        what = f"the setup of the live page is incomplete or malformed ({wrong!r})"
        raise ViewError(f"{what}; docs/live-page.md lists it") from wrong
    if kind not in ("rectangle", "disc", "band", "polygon"):
        raise ViewError(f"domain kind {kind!r}; the live page draws 'rectangle', 'disc', 'band' and 'polygon'")
    return dict(plain)


def pack_frame(header: Mapping[str, Any], *images: NDArray, dtype: str = "<f4") -> bytes:
    """One frame as the browser gets it: header length, JSON header, images (ny, nx) such as base and final one."""
    text = to_json(header).encode()
    text += b" " * (-len(text) % 4)  # the browser maps the arrays in place, which needs multiples of 4
    return b"".join([_LENGTH.pack(len(text)), text, *(image.astype(dtype).tobytes() for image in images)])


def to_json(value: object) -> str:
    """Strict JSON: NumPy values become plain ones, numbers that are not finite become null."""
    try:
        return json.dumps(value, separators=(",", ":"), allow_nan=False, default=as_plain)
    except ValueError:  # rare (a latency before the first frame), so that finite messages are not walked through
        return json.dumps(as_plain(value), separators=(",", ":"), allow_nan=False)


# --- from the browser -------------------------------------------------------------------------------------------------

_COMMANDS: dict[str, tuple[str, ...]] = {
    "press": ("id", "x", "y", "radius", "pressure"),
    "push": ("id", "x", "y", "radius", "force"),
    "lift": ("id",),
    "lift_all": (),
    "mode": ("mode",),
    "estimator": ("estimator", "prior", "rule"),
    "injections": ("count",),
    "calibrate": (),
    "begin": (),
    "weigh": ("force",),
    "save": (),
    "pause": ("paused",),
    "demo": ("on",),
    "seek": ("position",),
    "step": ("cycles",),
    "speed": ("speed",),
    "loop": ("on",),
    "ack": ("sequence",),
}
_MOST_FORCE = 1e4  # N
_OF_RECORDINGS = ("seek", "step", "speed", "loop")
_OF_SKINS = ("begin", "weigh", "save")


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
    if kind in _OF_RECORDINGS and setup.get("recording") is None:
        raise CommandError("this device is not a recording; only a recording has a place, a speed and an end")
    if kind in _OF_SKINS and setup.get("recording") is not None:
        raise CommandError("this device is a recording; only a skin can be calibrated")
    return {"type": kind} | {name: _checked(name, message[name], setup) for name in fields}


def _checked(name: str, value: object, setup: Mapping[str, Any]) -> object:
    """The value of a field, if it is one that the page may send."""
    match name:
        case "id" if not (isinstance(value, str) and _IDENTIFIER.fullmatch(value)):
            raise CommandError(f"{name} must be 1 to 32 letters, digits, '-' or '_'")
        case "paused" | "on" if not isinstance(value, bool):
            raise CommandError(f"{name} must be true or false")
        case "cycles" if type(value) is not int or value not in (-1, 1):
            raise CommandError(f"{name} must be 1 or -1")
        case "sequence":
            return _whole(name, value, 0, 2**53 - 1)
        case "count":
            limits = [mode["injections"] for mode in setup["modes"] if mode.get("injections")]
            if not limits:
                raise CommandError("no mode of this skin has a choice of injections")
            return _whole(name, value, min(limit[0] for limit in limits), max(limit[1] for limit in limits))
        case "mode":
            return _one_of(name, value, [mode for mode in setup["modes"] if mode["available"]])
        case "estimator" | "prior" | "rule":
            return _one_of(name, value, (setup.get("choices") or {}).get(name, []))
        case "x" | "y":
            return _within(name, value, *_box(setup)[name])
        case "radius" | "pressure":
            if setup["press"] is None:
                raise CommandError("this device is not virtual; press it with a finger")
            return _within(name, value, *setup["press"][name][:2])
        case "force":
            return _within(name, value, 0.0, _MOST_FORCE)
        case "position":
            return _within(name, value, 0.0, setup["recording"]["length"])
        case "speed" if value is not None:
            return _within(name, value, *_SPEEDS, ", or null for as fast as it can")
    return value


def _one_of(name: str, value: object, entries: list[dict[str, Any]]) -> object:
    if not entries:
        raise CommandError(f"there is no choice of {name}")
    if value not in (choices := [str(entry["name"]) for entry in entries]):
        raise CommandError(f"{name} must be one of {', '.join(choices)}")
    return value


def _whole(name: str, value: object, low: int, high: int) -> int:
    if type(value) is not int or not low <= value <= high:
        raise CommandError(f"{name} must be an integer from {low} to {high}")
    return value


def _within(name: str, value: object, low: float, high: float, other: str = "") -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise CommandError(f"{name} must be a number{other}")
    slack = 1e-9 * max(abs(low), abs(high))  # a slider's end is not exactly the number that was sent to it
    if not low - slack <= value <= high + slack:  # also false for NaN
        raise CommandError(f"{name} must be from {low:g} to {high:g}{other}")
    return min(max(float(value), low), high)


def _box(setup: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """The least and the largest x and y of the skin."""
    domain = setup["skin"]["domain"]
    if domain["kind"] == "disc":
        return dict.fromkeys("xy", (-domain["radius"], domain["radius"]))
    if outline := domain.get("outline"):
        return {axis: (min(along), max(along)) for axis, along in zip("xy", zip(*outline, strict=True), strict=True)}
    return {"x": (0.0, domain["width"]), "y": (0.0, domain["height"])}
