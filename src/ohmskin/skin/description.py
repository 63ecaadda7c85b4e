"""The description of one skin: what it is made of, how it is driven and measured, how its images are made.

It is a short TOML file with one table per field of `Skin`; every key may be left out where it has a default. Skins that
ship with ohmskin are named without a path: ``paper``, ``paper-rim16``, ``sleeve``, ``dome``, ``tank``, ``uef2017`` and
``ktc2023``.
"""

import os
import zlib
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from ohmskin.arrays import Floats
from ohmskin.drive import Candidates, candidate_pairs, candidate_pattern, pair_currents
from ohmskin.errors import SkinError, shown
from ohmskin.forward import ContactTable, TransferModel, VoltageSource
from ohmskin.forward.conductivity import cosines
from ohmskin.geometry import Chart, Domain, Electrodes, Mesh, electrode_points, kept_mesh
from ohmskin.scan import Cost, Pairs
from ohmskin.skin.auxiliary import Auxiliary
from ohmskin.skin.calibration import Calibration
from ohmskin.skin.checks import check_expense, check_names, check_table, number, read_text, read_toml
from ohmskin.skin.instrument import Converter, Excitation
from ohmskin.skin.layer import ContactLayer
from ohmskin.skin.layout import ElectrodeLayout
from ohmskin.skin.mode import Mode, modes_of
from ohmskin.skin.sheet import Sheet

_LIBRARY, _EXTENSION = Path(__file__).with_name("library"), ".toml"
_UNCALIBRATED, _LAYOUT, _SHEET, _LAYER = Calibration(), ElectrodeLayout(), Sheet(), ContactLayer()
_AUXILIARY, _EXCITATION, _CONVERTER = Auxiliary(), Excitation(), Converter()
_LARGEST_FILE = 2**20
_CHANGE, _LEAST_CONTACT = 0.2, 0.01  # share by which contact impedances change; of the sheet's resistance, the least
_CLOSEST = 0.02  # share of the edges of a mesh that its nodes are apart at an electrode
_FORMER = {"bipolar": "falls"}  # entries by the names that files written before 0.2 have, and digests keep


@dataclass(frozen=True)
class Imaging:
    """How images and contacts are made of the measurements; see `GaussNewton`, `Sensor` and `ContactFinder`.

    `contact_error` is the share of a contact's signal that a disc gets wrong; with less than 0.07 what patches do to it
    is taken for a second contact.
    """

    mesh_size: float = number(5.5e-3, 1e-6, 10, "m")
    amplitude: float = number(0.1, 1e-9, 1e9)
    model_error: float = number(0.02, 0, 1)
    contact_error: float = number(0.07, 0, 1)
    pairs: int = number(16, 1, 32640)
    fuse: bool = True
    bipolar: bool = False
    fraction: float = number(0.3, 0, 1)
    dip: float = number(0.2, 0, 1)


@dataclass(frozen=True)
class Skin:
    """One skin. Every table has the defaults of the paper's sensor.

    Args:
        name: Its name, in recordings and on the page.
        sheet: The conductive sheet: its shape and size (m), and its conductivity (S).
        electrode: Places, shape and contact impedance of the electrodes.
        contact_layer: The patches and foam on the sheet.
        excitation: The source that drives a pair of electrodes, and the resistances (ohm) in its path.
        converter: The converter that digitises the voltages: noise, full scale (V), bits, times (s).
        auxiliary: The auxiliary channel, if there is one.
        imaging: How images and contacts are computed from the measurements.
        calibration: What `ohmskin calibrate` found; it holds for this sheet, these electrodes and imaging.
        modes: Modes of its own, in addition to those of `MODES`.

    Raises:
        SkinError: If an entry is out of range, or tables do not fit each other.
    """

    name: str = "paper"
    sheet: Sheet = _SHEET
    electrode: ElectrodeLayout = _LAYOUT
    contact_layer: ContactLayer = _LAYER
    excitation: Excitation = _EXCITATION
    converter: Converter = _CONVERTER
    auxiliary: Auxiliary = _AUXILIARY
    imaging: Imaging = Imaging()
    calibration: Calibration = _UNCALIBRATED
    modes: tuple[Mode, ...] = ()

    def __post_init__(self) -> None:
        for table in fields(self):
            if table.name not in ("name", "modes"):
                check_table(table.name, getattr(self, table.name))
        self.electrode.check(self.chart)
        if self.calibration != _UNCALIBRATED:
            self.calibration.check(self.domain, len(self.electrode.on(self.chart)))
        if self.calibration.date and self.calibration.made_for != self.digest:
            raise SkinError(
                f"the calibration of {self.calibration.date} was made for another skin (sheet, electrodes, imaging "
                f"have digest {self.digest}, it is for {self.calibration.made_for or 'none'}); "
                "remove [calibration] and run `ohmskin calibrate`"
            )

    @classmethod
    def load(cls, source: str | Path) -> "Skin":
        """Read a skin from its `source`, a TOML file, or one that ships with ohmskin by its name.

        Raises:
            SkinError: If there is no such file or skin, or its contents are not a valid description.
        """
        path = Path(source)
        if path.suffix == _EXTENSION or os.path.isfile(path):
            try:
                text = read_text(path, _LARGEST_FILE, "skin file")
            except SkinError as error:
                raise SkinError(f"{error}; shipped skins are {', '.join(shipped_skins())}") from error
            return cls.parse(text, str(path), path.parent)
        if str(source) not in shipped_skins():
            raise SkinError(f"no skin named {str(source)!r}; give a .toml file or one of {', '.join(shipped_skins())}")
        return cls.parse((_LIBRARY / f"{source}{_EXTENSION}").read_text(encoding="utf-8"), str(source))

    @classmethod
    def parse(cls, text: str, origin: str = "skin description", folder: Path | None = None) -> "Skin":
        """Read a skin from TOML text; `origin` names it in errors, `folder` is where a mesh file that it names lies.

        Raises:
            SkinError: If the text is not valid TOML, a key is unknown, or a value is of the wrong type or out of range.
        """
        data = read_toml(text, origin)
        tables: dict[str, Any] = {}
        known = {entry.name: entry for entry in fields(cls)}
        current = {old: new for new, old in _FORMER.items()}
        try:
            check_names(data, list(known))
            for key, value in data.items():
                kind: Any = type(known[key].default)
                if kind is str:
                    if not isinstance(value, str):
                        raise SkinError(f"{key} is {shown(value)}; it must be text")
                    tables[key] = value
                elif key == "modes":
                    tables[key] = modes_of(value)
                elif isinstance(value, dict):
                    value = {current.get(entry, entry): v for entry, v in value.items()}
                    names = [entry.name for entry in fields(kind)]
                    check_names(value, names, f"{key}.")
                    tables[key] = kind(**{name: tuple(v) if isinstance(v, list) else v for name, v in value.items()})
                else:
                    raise SkinError(f"{key} is {shown(value)}; it must be a table [{key}]")
            if folder is not None and tables.get("sheet", _SHEET).file:
                tables["sheet"] = tables["sheet"].read(folder)
            return cls(**tables)
        except SkinError as error:
            raise SkinError(f"{origin}: {error}") from None

    def dump(self) -> str:
        """This skin as TOML text; `Skin.parse` reads it back."""
        tables = asdict(self) | {"modes": {mode.name: mode.entries for mode in self.modes}}
        if not self.modes:
            del tables["modes"]
        if self.calibration == _UNCALIBRATED:
            del tables["calibration"]
        return tomli_w.dumps(tables)

    @property
    def digest(self) -> str:
        """Checksum of all that a calibration depends on: sheet, electrodes, and settings of imaging."""
        parts: dict[str, Any] = {"sheet": self.sheet, "electrode": self.electrode, "imaging": self.imaging}
        changed = [
            f"{table}.{_FORMER.get(entry.name, entry.name)} = {value!r}"
            for table, values in parts.items()
            for entry in fields(values)
            # what a calibration finds out itself does not count; defaults neither: new entries change no old digest
            if entry.name not in ("conductivity", "contact_resistivity")
            and (value := getattr(values, entry.name)) != entry.default
        ]
        return f"{zlib.crc32(chr(10).join(changed).encode()):08x}"

    @property
    def chart(self) -> Chart:
        """The sheet's map, and how it lies in space."""
        return self.sheet.chart

    @property
    def domain(self) -> Domain:
        """The outline of the map: of a flat sheet, its shape."""
        return self.chart.domain

    @cached_property
    def electrodes(self) -> Electrodes:
        """The electrodes, at their described places, or where a calibration found them."""
        described, found = self.electrode.on(self.chart), self.calibration.positions
        return described.mapped(lambda _: found) if found else described

    @property
    def pairs(self) -> Pairs:
        """The pairs of electrodes by which it is driven and measured."""
        return candidate_pairs(self.electrodes, self.domain.period)

    @property
    def discs(self) -> Electrodes:
        """The electrodes with their real size, on the map."""
        scale = self.chart.scale(self.electrodes.positions)
        return self.electrodes.with_discs(self.electrode.radius / scale, self.electrode.contact_resistivity / scale**2)

    @property
    def cost(self) -> Cost:
        """Time that a scan takes the instrument, which converts all voltages of an injection at once."""
        return Cost(self.converter.settle, self.converter.conversion)

    @property
    def source(self) -> VoltageSource | None:
        """The voltage source with all resistances in its path; None for a current source."""
        e = self.excitation
        if e.source == "current":
            return None
        return VoltageSource(e.amplitude, e.resistance + 2 * e.multiplexer_resistance + self.converter.shunt)

    def pair_currents(self) -> Floats:
        """The current (n_pairs,) through each electrode pair of the untouched skin, as described (A)."""
        source, limit = self.source, self.excitation.current_limit
        if source is None:
            return np.full(len(self.pairs), min(self.excitation.amplitude, limit))
        return pair_currents(self.electrode_model(), source, limit)

    @property
    def noise(self) -> float:
        """Standard deviation of a voltage, the converter's steps included (V)."""
        step = 2 * self.converter.full_scale / 2**self.converter.bits
        return float(np.hypot(self.converter.noise, step / np.sqrt(12)))

    def design(self, driven: bool = False) -> tuple[ContactTable, Candidates]:
        """Input of drive design: the responses of contacts, and all injections with currents and noise. Made once.

        `driven`: electrodes that carry the current are measured, too.
        """
        return _design(self, driven)

    def contact_change(self, impedance: Floats | float) -> Floats:
        """Standard deviation of unseen changes of contact impedances, `impedance`, one or (n_elec,) (ohm): a fifth, at
        least of 1 % of the sheet's resistance. Contacts of screws on a sprayed sheet change when it is pressed
        nearby."""
        return np.asarray(_CHANGE * np.maximum(impedance, _LEAST_CONTACT / self.sheet.conductivity))

    @property
    def calibrated_layer(self) -> ContactLayer:
        """The contact layer, as calibrated, if it is."""
        if not (found := self.calibration).layer_conductance:
            return self.contact_layer
        hysteresis = self.contact_layer.hysteresis if found.layer_hysteresis < 0 else found.layer_hysteresis
        told = replace(self.contact_layer, conductance=found.layer_conductance, exponent=found.layer_exponent)
        return replace(told, hysteresis=hysteresis)

    @property
    def calibrated_auxiliary(self) -> Auxiliary:
        """The auxiliary channel, as calibrated, if it is."""
        found = self.calibration
        if not found.auxiliary_gain:
            return self.auxiliary
        return replace(self.auxiliary, gain=found.auxiliary_gain, error=found.auxiliary_error)

    @property
    def tells_force(self) -> bool:
        """Whether contacts have forces: the skin was calibrated for that, or has an auxiliary channel."""
        return self.calibration.tells_force or bool(self.auxiliary.kind)

    def mesh(self) -> Mesh:
        """The estimator's mesh, with a node at every electrode."""
        return self.mesh_for(self.electrodes)

    def mesh_for(self, electrodes: Electrodes, size: float = 0.0) -> Mesh:
        """A mesh of the sheet with a node at every electrode, finer where discs are, see `electrode_points`.

        Args:
            electrodes: The electrodes, on the map.
            size: Length of edges (m); 0: the estimator's.

        Raises:
            SkinError: If meshing would take too much time or memory.
            GeometryError: If the sheet cannot be meshed with this size, or electrodes are outside it.
        """
        size = size or self.imaging.mesh_size
        check_expense(self.domain, len(candidate_pairs(electrodes, self.domain.period)), size)
        if not electrodes.are_areas.any():
            return _mesh(self.domain, size, electrodes.positions.tobytes())
        points = electrode_points(self.domain, electrodes, 1.05 * _CLOSEST * size)
        return _mesh(self.domain, size, points.tobytes(), _CLOSEST)

    def conductivity_on(self, mesh: Mesh) -> Floats:
        """The conductivity (n_elem,) of the untouched sheet on a mesh, as calibrated, if it is (S per square).

        Of a sheet that is stretched over a surface perhaps tensors (n_elem, 2, 2).
        """
        level, uneven = self.calibration.conductivity or self.sheet.conductivity, self.calibration.log_conductivity
        even = level * np.exp(cosines(mesh.centroids, self.domain, uneven or (0.0,)))
        return np.asarray((self.sheet.strained(mesh.centroids).T * even).T)

    def transfer_model(self) -> TransferModel:
        """The estimator's forward model of the untouched sheet, factorised; made once. Errors as of `mesh_for`."""
        return _transfer_model(self)

    def contact_table(self, model: TransferModel) -> ContactTable:
        """The responses of contacts of the usual size on a model of this skin; made once for each model."""
        return _contact_table(model, self.imaging.mesh_size)

    def electrode_model(self, finer: float = 1.0) -> TransferModel:
        """The same with electrodes of their real size: a driven point electrode has no defined resistance.

        `finer`: edges of its mesh over the estimator's.
        """
        return _electrode_model(self, finer)


@lru_cache(maxsize=8)  # skins that differ in what was calibrated have the same one
def _mesh(domain: Domain, size: float, points: bytes, closest: float = 0.1) -> Mesh:
    return kept_mesh(domain, size, np.frombuffer(points).reshape(-1, 2), closest)


@lru_cache(maxsize=8)
def _transfer_model(skin: Skin) -> TransferModel:
    mesh = skin.mesh()
    return TransferModel(mesh, skin.electrodes, skin.conductivity_on(mesh)).over(skin.pairs)


@lru_cache(maxsize=8)
def _electrode_model(skin: Skin, finer: float) -> TransferModel:
    mesh = skin.mesh_for(skin.discs, finer * skin.imaging.mesh_size)
    return TransferModel(mesh, skin.discs, skin.conductivity_on(mesh)).over(skin.pairs)


@lru_cache(maxsize=8)
def _contact_table(model: TransferModel, mesh_size: float) -> ContactTable:
    return ContactTable.kept(model, 1.5 * mesh_size, 0.7 * mesh_size)


@lru_cache(maxsize=8)
def _design(skin: Skin, driven: bool) -> tuple[ContactTable, Candidates]:
    candidates = candidate_pattern(skin.electrodes, skin.domain.period)
    contacts = float(skin.contact_change(skin.electrode.contact_impedance)) if driven else None
    currents = skin.pair_currents()
    table = skin.contact_table(skin.electrode_model())
    return table, Candidates.at_currents(candidates, skin.pairs, skin.noise, currents, contacts)


def shipped_skins() -> list[str]:
    """Names of the skins that ship with ohmskin."""
    return sorted(path.stem for path in _LIBRARY.glob(f"*{_EXTENSION}"))
