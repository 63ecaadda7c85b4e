"""The description of one skin: what it is made of, how it is driven and measured, how its images are made.

It is a short TOML file with one table per dataclass below; every key may be left out where it has a default. Skins that
ship with ohmskin are named without a path: ``paper``, ``paper-rim16``, ``tank``, ``uef2017``, ``ktc2023``.
"""

import tomllib
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any

import tomli_w

from ohmskin.drive import Mode, modes
from ohmskin.errors import SkinError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Disc, Domain, Electrodes, Mesh, Rectangle, mesh_domain

_EXTENSION = ".toml"


def _number(default: float, low: float, high: float, unit: str = "") -> Any:
    return field(default=default, metadata={"low": low, "high": high, "unit": unit})


def _choice(default: str, *choices: str) -> Any:
    return field(default=default, metadata={"choices": choices})


@dataclass(frozen=True)
class Sheet:
    """The conductive sheet. A rectangle has its lower left corner at the origin, a disc is centred there."""

    shape: str = _choice("rectangle", "rectangle", "disc")
    width: float = _number(0.2, 1e-3, 10, "m")
    height: float = _number(0.2, 1e-3, 10, "m")
    radius: float = _number(0.1, 1e-3, 10, "m")
    conductivity: float = _number(1.83e-3, 1e-9, 1e6, "S per square")


@dataclass(frozen=True)
class ElectrodeLayout:
    """Where the electrodes are (``grid``: columns x rows with an inset; ``rim``: `count` round the rim) and of what kind.

    On the rim the first is at the share `start` of its length, counterclockwise from where it starts: 0.25 is 12 o'clock of a disc.
    """

    layout: str = _choice("grid", "grid", "rim")
    columns: int = _number(4, 2, 32)
    rows: int = _number(4, 2, 32)
    inset: float = _number(0.0, 0, 10, "m")
    count: int = _number(16, 4, 256)
    start: float = _number(0.0, 0, 0.999999)
    clockwise: bool = False
    radius: float = _number(3e-3, 1e-5, 1, "m")
    contact_resistivity: float = _number(1e-4, 1e-9, 1e3, "ohm m2")


@dataclass(frozen=True)
class ContactLayer:
    """Floating conductive patches on foam that short the sheet where they are pressed on it.

    The conductance per area between patch and sheet is ``conductance * (pressure / pressure_scale) ** exponent``.
    """

    columns: int = _number(24, 1, 256)
    rows: int = _number(24, 1, 256)
    patch: float = _number(7.5e-3, 1e-5, 1, "m")
    conductance: float = _number(3.66e3, 1e-6, 1e9, "S/m2")
    pressure_scale: float = _number(20e3, 1, 1e9, "Pa")
    exponent: float = _number(0.95, 0.1, 3)
    foam_spread: float = _number(2e-3, 0, 1, "m")


@dataclass(frozen=True)
class Excitation:
    """The source that drives a pair of electrodes, and the multiplexers in its path."""

    source: str = _choice("voltage", "voltage", "current")
    amplitude: float = _number(5.0, 1e-9, 1e3, "V or A")
    resistance: float = _number(50.0, 0, 1e9, "ohm")
    multiplexer_resistance: float = _number(100.0, 0, 1e6, "ohm")
    current_limit: float = _number(20e-3, 1e-9, 1e3, "A")


@dataclass(frozen=True)
class Converter:
    """What digitises the voltages, all channels of an injection at once."""

    noise: float = _number(0.2e-3, 0, 1e3, "V")
    bits: int = _number(16, 4, 32)
    full_scale: float = _number(5.0, 1e-9, 1e4, "V")
    shunt: float = _number(100.0, 1e-6, 1e9, "ohm")
    settle: float = _number(100e-6, 0, 10, "s")
    conversion: float = _number(20e-6, 0, 10, "s")
    time_constant: float = _number(8e-6, 0, 10, "s")


@dataclass(frozen=True)
class Imaging:
    """How images and contacts are made of the measurements; see `GaussNewton`, `Mode` and `ContactFinder`."""

    mesh_size: float = _number(5.5e-3, 1e-6, 10, "m")
    amplitude: float = _number(0.1, 1e-9, 1e9)
    model_error: float = _number(0.02, 0, 1)
    pairs: int = _number(16, 1, 32640)
    fuse: bool = True
    falls: bool = False
    fraction: float = _number(0.3, 0, 1)
    dip: float = _number(0.2, 0, 1)


@dataclass(frozen=True)
class Skin:
    """One skin. Every table has the defaults of the paper's sensor."""

    name: str = "paper"
    sheet: Sheet = Sheet()
    electrode: ElectrodeLayout = ElectrodeLayout()
    contact_layer: ContactLayer = ContactLayer()
    excitation: Excitation = Excitation()
    converter: Converter = Converter()
    imaging: Imaging = Imaging()

    def __post_init__(self) -> None:
        for table in fields(self):
            if table.name != "name":
                _check(table.name, getattr(self, table.name))
        if self.electrode.layout == "grid" and self.sheet.shape != "rectangle":
            raise SkinError('electrode.layout is "grid" on a disc; use "rim", or a rectangular sheet')

    @classmethod
    def load(cls, source: str | Path) -> "Skin":
        """Read a skin from a TOML file, or one that ships with ohmskin by its name.

        Raises:
            SkinError: If there is no such file or skin, or its contents are not a valid description.
        """
        path = Path(source)
        if path.suffix == _EXTENSION or path.is_file():
            try:
                text = path.read_text(encoding="utf-8")
            except (OSError, UnicodeDecodeError) as error:
                raise SkinError(f"cannot read skin file {path}: {error}; shipped skins are {', '.join(shipped_skins())}") from error
            return cls.parse(text, str(path))
        if str(source) not in shipped_skins():
            raise SkinError(f"no skin named {str(source)!r}; give a .toml file or one of {', '.join(shipped_skins())}")
        return cls.parse((_library() / f"{source}{_EXTENSION}").read_text(encoding="utf-8"), str(source))

    @classmethod
    def parse(cls, text: str, origin: str = "skin description") -> "Skin":
        """Read a skin from TOML text; `origin` names it in errors.

        Raises:
            SkinError: If the text is not valid TOML, a key is unknown, or a value has the wrong type or is out of range.
        """
        try:
            data = tomllib.loads(text)
        except ValueError as error:  # TOMLDecodeError, or a number with thousands of digits
            raise SkinError(f"{origin} is not valid TOML: {error}") from error
        tables: dict[str, Any] = {}
        known = {entry.name: entry for entry in fields(cls)}
        try:
            for key, value in data.items():
                if key not in known:
                    raise SkinError(f"unknown entry {key!r}; choose from {', '.join(known)}")
                kind: Any = type(known[key].default)
                if kind is str:
                    tables[key] = value
                elif isinstance(value, dict):
                    names = [entry.name for entry in fields(kind)]
                    if unknown := [name for name in value if name not in names]:
                        raise SkinError(f"unknown entry {key}.{unknown[0]}; choose from {', '.join(names)}")
                    tables[key] = kind(**value)
                else:
                    raise SkinError(f"{key} is {value!r}; it must be a table [{key}]")
            if not isinstance(tables.get("name", ""), str):
                raise SkinError(f"name is {tables['name']!r}; it must be text")
            return cls(**tables)
        except SkinError as error:
            raise SkinError(f"{origin}: {error}") from None

    def dump(self) -> str:
        """This skin as TOML text; `Skin.parse` reads it back."""
        return tomli_w.dumps(asdict(self))

    @property
    def domain(self) -> Domain:
        """The shape of the sheet."""
        return Disc(self.sheet.radius) if self.sheet.shape == "disc" else Rectangle(self.sheet.width, self.sheet.height)

    @cached_property
    def electrodes(self) -> Electrodes:
        """The electrode layout."""
        e = self.electrode
        if e.layout == "grid":
            return Electrodes.grid(Rectangle(self.sheet.width, self.sheet.height), e.columns, e.rows, e.inset)
        return Electrodes.rim(self.domain, e.count, e.start, e.clockwise)

    @property
    def modes(self) -> dict[str, Mode]:
        """The drive modes this layout allows, best last."""
        return modes(self.electrodes, self.imaging.pairs, self.imaging.fuse)

    def mesh(self) -> Mesh:
        """The estimator's mesh, with a node at every electrode."""
        return mesh_domain(self.domain, self.imaging.mesh_size, self.electrodes.positions)

    def transfer_model(self) -> TransferModel:
        """The estimator's forward model of the untouched sheet, factorised."""
        return TransferModel(self.mesh(), self.electrodes, self.sheet.conductivity)


def shipped_skins() -> list[str]:
    """Names of the skins that ship with ohmskin."""
    return sorted(entry.name.removesuffix(_EXTENSION) for entry in _library().iterdir() if entry.name.endswith(_EXTENSION))


def _library() -> Any:
    return resources.files("ohmskin.skin") / "library"


def _check(table: str, values: Any) -> None:
    """Hold each value against the type of its default and the range in its metadata."""
    for entry in fields(values):
        value, name = getattr(values, entry.name), f"{table}.{entry.name}"
        expected: Any = type(entry.default)
        if expected in (bool, str):
            if not isinstance(value, expected):
                raise SkinError(f"{name} is {value!r}; it must be {'true or false' if expected is bool else 'text'}")
            choices = entry.metadata.get("choices", (value,))
            if value not in choices:
                raise SkinError(f"{name} is {value!r}; choose from {', '.join(choices)}")
            continue
        low, high, unit = entry.metadata["low"], entry.metadata["high"], entry.metadata["unit"]
        if isinstance(value, bool) or not isinstance(value, int | float) or (expected is int and not isinstance(value, int)):
            raise SkinError(f"{name} is {value!r}; it must be {'a whole number' if expected is int else 'a number'}")
        if not low <= value <= high:  # false for nan, too
            raise SkinError(f"{name} is {value}; it must be {low:g} to {high:g} {unit}".rstrip())
