"""A body: several patches of skin on one robot, as a short TOML file says (docs/guide/several-skins.md)."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from scipy.spatial.transform import Rotation

from ohmskin.body.robot import Robot
from ohmskin.client.contacts import MOST_PATCHES, Patch
from ohmskin.device.registry import scheme_of
from ohmskin.errors import OhmskinError, SkinError
from ohmskin.sensing import mode_named
from ohmskin.skin import Skin, shipped_skins
from ohmskin.skin.checks import check_names, is_number, read_text, read_toml, sibling_path

_LARGEST_FILE = 2**20
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")
_LINK = re.compile(r"[^\s\x00-\x1f]{1,128}")
_FARTHEST = 100.0  # m
_RESERVED = ("joints", "links", "image", "health", "device", "asked", "answered")  # shared memory BODY.NAME


@dataclass(frozen=True)
class PlacedSkin:
    """One patch: its place, its skin and its device.

    Args:
        patch: Name, link and pose.
        skin: Its description.
        device: Address of its device.
        mode: Its mode; the skin's default unless given.
    """

    patch: Patch
    skin: Skin
    device: str
    mode: str


@dataclass(frozen=True)
class Body:
    """All patches of a robot.

    Args:
        name: What clients call it.
        patches: Its patches.
        robot: From its URDF file; None if it names none.
    """

    name: str
    patches: tuple[PlacedSkin, ...]
    robot: Robot | None = None

    @classmethod
    def load(cls, path: str | Path) -> "Body":
        """Read a body from its TOML file at `path`. Skins and the URDF file are read from its folder only.

        Raises:
            SkinError: If it cannot be read, an entry is unknown, missing or out of range, a link is not in the URDF, a
                patch has a reserved name, or a device's address cannot work.
        """
        path = Path(path)
        text = read_text(path, _LARGEST_FILE, "body file")
        data = read_toml(text, str(path))
        try:
            return _body(data, path.parent)
        except SkinError as error:
            raise SkinError(f"{path}: {error}") from None


def axes(roll: float, pitch: float, yaw: float) -> tuple[tuple[float, float, float], ...]:
    """A sheet's x, y and normal after turns about the fixed axes x, y and z (rad), in this order, as URDF has them."""
    return tuple(map(tuple, Rotation.from_euler("xyz", (roll, pitch, yaw)).as_matrix().T.tolist()))


def _body(data: Mapping[str, Any], folder: Path) -> Body:
    check_names(data, ("name", "urdf", "joints", "patch"))
    name, entries = _text(data, "name", "body", _NAME), data.get("patch", [])
    tables = isinstance(entries, list) and all(isinstance(entry, dict) for entry in entries)
    if not tables or not 1 <= len(entries) <= MOST_PATCHES:
        raise SkinError(f"there must be 1 to {MOST_PATCHES} tables [[patch]]")
    joints = data.get("joints", {})
    if not isinstance(joints, dict) or (joints and "urdf" not in data):
        raise SkinError(f"joints is {joints!r}; it must be a table of positions of the joints of a URDF file")
    robot = Robot.load(sibling_path(folder, data["urdf"], "urdf", "body file"), joints) if "urdf" in data else None
    links = None if robot is None else tuple(robot.links)
    skins: dict[str, Skin] = {}
    patches = tuple(_placed(entry, number, folder, links, skins) for number, entry in enumerate(entries, start=1))
    names = [placed.patch.name for placed in patches]
    if twice := next((n for n in names if names.count(n) > 1), None):
        raise SkinError(f"two patches are called {twice!r}; give each its own name")
    ports = [_serial_port(placed.device) for placed in patches if placed.device.startswith("serial:")]
    if shared := next((port for port in ports if ports.count(port) > 1), None):
        raise SkinError(f"two patches have the serial port {shared!r}; give each the port of its own device")
    return Body(name, patches, robot)


def _placed(
    entry: Mapping[str, Any], number: int, folder: Path, links: tuple[str, ...] | None, skins: dict[str, Skin]
) -> PlacedSkin:
    where = f"patch {entry.get('name', number)!r}: "
    try:
        check_names(entry, ("name", "link", "device", "skin", "mode", "position", "rotation"))
        name, link = _text(entry, "name", None, _NAME), _text(entry, "link", None, _LINK)
        if name in _RESERVED:
            raise SkinError(f"name is {name!r}; it must be none of {', '.join(_RESERVED)}, which the body uses itself")
        if links is not None and link not in links:
            raise SkinError(f"link {link!r} is not in the URDF file; it has {', '.join(links[:20])}")
        x, y, z = _numbers(entry, "position", 3, _FARTHEST)
        turns = _numbers(entry, "rotation", 3, 2 * pi)
        source = _text(entry, "skin", "paper", _LINK)
        if source not in skins:
            skins[source] = _skin(folder, source)
        device = _device(folder, _text(entry, "device", "virtual:", _LINK))
        mode = _text(entry, "mode", "", re.compile(r"\w{0,32}"))
        mode_named(skins[source], mode)
        patch = Patch(name, link, (x, y, z), axes(*turns), skins[source].tells_force)
        return PlacedSkin(patch, skins[source], device, mode)
    except OhmskinError as error:
        raise SkinError(f"{where}{error}") from None


def _skin(folder: Path, source: str) -> Skin:
    if source.endswith(".toml"):
        return Skin.load(sibling_path(folder, source, "skin", "body file"))
    if source not in shipped_skins():  # not even if there is such a file somewhere
        raise SkinError(f"no skin named {source!r}; give a .toml file beside it or one of {', '.join(shipped_skins())}")
    return Skin.load(source)


def _device(folder: Path, address: str) -> str:
    """The address, if it can work when its device is there; a recording is a file that the body file names."""
    kind, _, rest = address.partition(":")
    if kind == "virtual" and rest:
        raise SkinError(f"device is {address!r}; a virtual one is 'virtual:', and `skin` names its skin")
    if kind == "virtual":
        return "virtual:"
    if kind == "replay":
        name, mark, settings = rest.partition("?")
        return f"replay:{sibling_path(folder, name, 'device', 'body file')}{mark}{settings}"
    if scheme_of(address) in ("tcp", "serial") and not _complete(address):
        raise SkinError(f"device is {address!r}; it must be like tcp://HOST:PORT or serial:///dev/ttyACM0?baud=921600")
    return address


def _complete(address: str) -> bool:
    """Whether an address of a wire has all that opening it needs, and nothing else."""
    try:
        parts = urlsplit(address)
        if parts.scheme == "tcp":
            return bool(parts.hostname and parts.port) and not parts.query
    except ValueError:
        return False
    return bool(_serial_port(address)) and re.fullmatch(r"(baud=[1-9]\d{0,8})?", parts.query, re.ASCII) is not None


def _serial_port(address: str) -> str:
    parts = urlsplit(address)
    return parts.netloc + parts.path


def _text(data: Mapping[str, Any], name: str, default: str | None, allowed: re.Pattern[str]) -> str:
    value = data.get(name, default)
    if value is None:
        raise SkinError(f"{name} is missing")
    if not isinstance(value, str) or not allowed.fullmatch(value):
        rule = "letters, digits and '_', a letter first, 32 at most" if allowed is _NAME else "text without blanks"
        raise SkinError(f"{name} is {value!r}; it must be {rule}")
    return value


def _numbers(data: Mapping[str, Any], name: str, count: int, most: float) -> list[float]:
    values = data.get(name, [0.0] * count)
    good = isinstance(values, list) and len(values) == count and all(is_number(value) for value in values)
    if not good or not all(abs(value) <= most for value in values):  # false for nan, too
        raise SkinError(f"{name} is {values!r}; it must be {count} numbers from {-most:g} to {most:g}")
    return [float(value) for value in values]
