"""The description of one skin: what it is made of, how it is driven and measured, how its images are made.

It is a short TOML file with one table per dataclass below; every key may be left out where it has a default. Skins that
ship with ohmskin are named without a path: ``paper``, ``paper-rim16``, ``tank``, ``uef2017``, ``ktc2023``.
"""

import tomllib
import zlib
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from ohmskin.drive import (
    Candidates,
    InformedPolicy,
    Mode,
    PositionDrive,
    arranged,
    base_pattern,
    complete_pattern,
    modes,
    pair_currents,
)
from ohmskin.errors import GeometryError, SkinError
from ohmskin.forward import ContactTable, TransferModel, VoltageSource
from ohmskin.geometry import Disc, Domain, Electrodes, Mesh, Rectangle, mesh_domain
from ohmskin.geometry.domain import Floats
from ohmskin.scan import Cost
from ohmskin.skin.calibration import Calibration

_EXTENSION = ".toml"
_UNCALIBRATED = Calibration()
_LARGEST_FILE = 2**20


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
    """Where the electrodes are and of what kind.

    ``grid``: columns x rows with an inset; ``rim``: `count` round the rim; ``listed``: at `positions` [x, y] in metres, which are
    then numbered counterclockwise, those on the rim first.
    On the rim the first is at the share `start` of its length, counterclockwise from where it starts: 0.25 is 12 o'clock of a disc.
    """

    layout: str = _choice("grid", "grid", "rim", "listed")
    columns: int = _number(4, 2, 32)
    rows: int = _number(4, 2, 32)
    inset: float = _number(0.0, 0, 10, "m")
    count: int = _number(16, 4, 256)
    start: float = _number(0.0, 0, 0.999999)
    clockwise: bool = False
    radius: float = _number(3e-3, 1e-5, 1, "m")
    contact_resistivity: float = _number(1e-4, 1e-9, 1e3, "ohm m2")
    positions: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        given = self.positions  # TOML gives lists; a description must be hashable
        if isinstance(given, list | tuple):
            pairs = tuple(tuple(place) if isinstance(place, list) else place for place in given)
            object.__setattr__(self, "positions", pairs)


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
    calibration: Calibration = _UNCALIBRATED

    def __post_init__(self) -> None:
        for table in fields(self):
            if table.name != "name":
                _check(table.name, getattr(self, table.name))
        if self.electrode.layout == "grid" and self.sheet.shape != "rectangle":
            raise SkinError('electrode.layout is "grid" on a disc; use "rim", "listed", or a rectangular sheet')
        _check_listed(self.electrode, self.domain)
        if self.calibration.date and self.calibration.made_for != self.digest:
            raise SkinError(
                f"the calibration of {self.calibration.date} was made for another skin (sheet, electrodes, imaging have digest "
                f"{self.digest}, it is for {self.calibration.made_for or 'none'}); remove [calibration] and run `ohmskin calibrate`"
            )

    @classmethod
    def load(cls, source: str | Path) -> "Skin":
        """Read a skin from a TOML file, or one that ships with ohmskin by its name.

        Raises:
            SkinError: If there is no such file or skin, or its contents are not a valid description.
        """
        path = Path(source)
        if path.suffix == _EXTENSION or path.is_file():
            try:
                with path.open("rb") as file:
                    content = file.read(_LARGEST_FILE + 1)
                if len(content) > _LARGEST_FILE:
                    raise SkinError(
                        f"skin file {path} has more than {_LARGEST_FILE} bytes; a description takes less than two thousand"
                    )
                text = content.decode()
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
        except (ValueError, RecursionError) as error:  # TOMLDecodeError, a number of thousands of digits, brackets in brackets
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
                    tables[key] = kind(**{name: tuple(v) if isinstance(v, list) else v for name, v in value.items()})
                else:
                    raise SkinError(f"{key} is {value!r}; it must be a table [{key}]")
            if not isinstance(tables.get("name", ""), str):
                raise SkinError(f"name is {tables['name']!r}; it must be text")
            return cls(**tables)
        except SkinError as error:
            raise SkinError(f"{origin}: {error}") from None

    def dump(self) -> str:
        """This skin as TOML text; `Skin.parse` reads it back."""
        tables = asdict(self)
        if self.calibration == _UNCALIBRATED:
            del tables["calibration"]
        return tomli_w.dumps(tables)

    @property
    def digest(self) -> str:
        """Names what a calibration depends on: the sheet's shape, the electrodes' places and sizes, and how images are made."""
        parts: dict[str, Any] = {"sheet": self.sheet, "electrode": self.electrode, "imaging": self.imaging}
        changed = [
            f"{table}.{entry.name} = {value!r}"
            for table, values in parts.items()
            for entry in fields(values)
            # what a calibration finds out itself does not count; defaults neither, so that new entries change no old digest
            if entry.name not in ("conductivity", "contact_resistivity") and (value := getattr(values, entry.name)) != entry.default
        ]
        return f"{zlib.crc32(chr(10).join(changed).encode()):08x}"

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
        if e.layout == "listed":
            return arranged(self.domain, np.array(e.positions, float))
        return Electrodes.rim(self.domain, e.count, e.start, e.clockwise)

    @property
    def modes(self) -> dict[str, Mode]:
        """The drive modes this layout allows, the paper's best last."""
        tracking = InformedPolicy(self.electrodes, self.design)
        return modes(self.electrodes, self.imaging.pairs, self.imaging.fuse, _informed(self), tracking)

    @property
    def cost(self) -> Cost:
        """What a scan costs the instrument; it converts all voltages of an injection at once."""
        return Cost(self.converter.settle, self.converter.conversion)

    @property
    def source(self) -> VoltageSource | None:
        """The voltage source with all that is in its path; None where a current is driven."""
        e = self.excitation
        if e.source == "current":
            return None
        return VoltageSource(e.amplitude, e.resistance + 2 * e.multiplexer_resistance + self.converter.shunt)

    def pair_currents(self) -> Floats:
        """The current (n_pairs,) through each electrode pair of the untouched skin, as described (A)."""
        source, limit = self.source, self.excitation.current_limit
        if source is None:
            n_elec = len(self.electrodes)
            return np.full(n_elec * (n_elec - 1) // 2, min(self.excitation.amplitude, limit))
        return pair_currents(self.electrode_model(), source, limit)

    @property
    def noise(self) -> float:
        """Standard deviation of a voltage, the converter's steps included (V)."""
        step = 2 * self.converter.full_scale / 2**self.converter.bits
        return float(np.hypot(self.converter.noise, step / np.sqrt(12)))

    def design(self) -> tuple[ContactTable, Candidates]:
        """What drive design needs: the responses of contacts, and all injections with their currents and noise. Made once."""
        return _design(self)

    def mesh(self) -> Mesh:
        """The estimator's mesh, with a node at every electrode."""
        return mesh_domain(self.domain, self.imaging.mesh_size, self.electrodes.positions)

    def transfer_model(self) -> TransferModel:
        """The estimator's forward model of the untouched sheet, factorised; of the calibrated conductivity if there is one."""
        return TransferModel(self.mesh(), self.electrodes, self.calibration.conductivity or self.sheet.conductivity)

    def electrode_model(self) -> TransferModel:
        """The same with electrodes of their real size, which driven electrodes need to have a resistance."""
        discs = self.electrodes.with_discs(self.electrode.radius, self.electrode.contact_resistivity)
        return TransferModel(mesh_domain(self.domain, self.imaging.mesh_size), discs, self.sheet.conductivity)


@lru_cache(maxsize=8)
def _design(skin: Skin) -> tuple[ContactTable, Candidates]:
    size = skin.imaging.mesh_size
    table = ContactTable(skin.transfer_model(), radius=1.5 * size, pitch=0.7 * size)
    complete = complete_pattern(skin.electrodes)
    return table, Candidates.at_currents(complete, len(skin.electrodes), skin.noise, skin.pair_currents())


@lru_cache(maxsize=8)
def _informed(skin: Skin) -> PositionDrive:
    base = base_pattern(skin.electrodes).injections
    return PositionDrive(skin.electrodes, skin.design, skin.imaging.pairs, base)


def shipped_skins() -> list[str]:
    """Names of the skins that ship with ohmskin."""
    return sorted(entry.name.removesuffix(_EXTENSION) for entry in _library().iterdir() if entry.name.endswith(_EXTENSION))


def _library() -> Any:
    return resources.files("ohmskin.skin") / "library"


def _check_listed(electrode: ElectrodeLayout, domain: Domain) -> None:
    """Hold listed electrodes against the sheet, and against the layouts that do not take them."""
    if electrode.layout != "listed":
        if electrode.positions:
            raise SkinError(f'electrode.positions are given but the layout is "{electrode.layout}"; use layout = "listed"')
        return
    if len(electrode.positions) < 4:
        raise SkinError(f"electrode.positions lists {len(electrode.positions)} electrodes; need at least 4")
    depth = domain.depth(np.array(electrode.positions, float))
    if (depth < -1e-6).any():
        k = int(np.argmin(depth))
        raise SkinError(
            f"electrode.positions[{k}] is {list(electrode.positions[k])}, {-depth[k]:.3g} m off the sheet; move it onto it"
        )
    try:
        arranged(domain, np.array(electrode.positions, float))
    except GeometryError as error:
        raise SkinError(f"electrode.positions: {error}") from None


def _is_place(place: Any) -> bool:
    return (
        isinstance(place, tuple)
        and len(place) == 2
        and all(isinstance(x, int | float) and not isinstance(x, bool) and -1e3 < x < 1e3 for x in place)
    )


def _check(table: str, values: Any) -> None:
    """Hold each value against the type of its default and the range in its metadata."""
    for entry in fields(values):
        value, name = getattr(values, entry.name), f"{table}.{entry.name}"
        expected: Any = type(entry.default)
        if expected is tuple and "low" not in entry.metadata:
            if not (isinstance(value, tuple) and all(_is_place(place) for place in value)):
                raise SkinError(f"{name} must be a list of [x, y] in metres")
            continue
        if expected in (bool, str):
            if not isinstance(value, expected):
                raise SkinError(f"{name} is {value!r}; it must be {'true or false' if expected is bool else 'text'}")
            choices = entry.metadata.get("choices", (value,))
            if value not in choices:
                raise SkinError(f"{name} is {value!r}; choose from {', '.join(choices)}")
            continue
        low, high, unit = entry.metadata["low"], entry.metadata["high"], entry.metadata["unit"]
        if expected is tuple:  # of numbers
            good = isinstance(value, tuple) and all(isinstance(v, int | float) and low <= v <= high for v in value)
            if not good or any(isinstance(v, bool) for v in value):
                raise SkinError(f"{name} must be a list of numbers, each {low:g} to {high:g} {unit}".rstrip())
            continue
        if isinstance(value, bool) or not isinstance(value, int | float) or (expected is int and not isinstance(value, int)):
            raise SkinError(f"{name} is {value!r}; it must be {'a whole number' if expected is int else 'a number'}")
        if not low <= value <= high:  # false for nan, too
            raise SkinError(f"{name} is {value}; it must be {low:g} to {high:g} {unit}".rstrip())
