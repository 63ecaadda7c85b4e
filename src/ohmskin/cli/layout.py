"""``ohmskin layout``: how well a skin can locate a contact, and where its electrodes had better be."""

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ohmskin.drive import (
    DRIVES,
    Candidates,
    ContactPrior,
    DriveSettings,
    LayoutSearch,
    best_fixed,
    complete_pattern,
    part_of,
    position_bound,
)
from ohmskin.drive.bound import Scheme, spread_places
from ohmskin.errors import DataError, PatternError, SkinError
from ohmskin.forward import ContactTable
from ohmskin.plot import ErrorMap, save_error_maps
from ohmskin.scan import DrivePattern, adjacent
from ohmskin.sensing import default_mode, drive_of, modes
from ohmskin.skin import Skin
from ohmskin.skin.layout import ElectrodeLayout

_PLACES = 700
_BEST = "best"


def layout(
    *,
    skin: str = "paper",
    mode: str = "",
    injections: int = 0,
    noise: str = "",
    radius: float = 8.0,
    optimise: int = 0,
    output: Path = Path("layout.png"),
    json_file: Path | None = None,
    save: Path | None = None,
) -> None:
    """Map the least error to which a contact's position can be told, over the sheet; or find a better electrode layout.

    Args:
        skin: A skin that ships with ohmskin or a .toml file.
        mode: What is driven: a mode such as 12B, 16I, 16O or 16P (as usual), or "best", the best fixed injections.
        injections: Of a frame; for adaptive modes the base scan included. As many as the mode has unless given; with
            "best" 28.
        noise: Of a voltage, such as 0.2mV, 50uV or 1e-4 (volts), or 50dB below the largest voltage of the skin's first
            mode. The skin's own unless given.
        radius: Of the contact, in millimetres. It changes the conductivity by a half.
        optimise: Find where so many electrodes should be for the smallest worst error, and compare.
        output: Where to put the picture.
        json_file: Where to put all figures, as JSON; nowhere unless given.
        save: With --optimise, where to put the skin that was found; SKIN-optimised.toml in this folder unless given.
    """
    described = Skin.load(skin)
    size = 1e-3 * radius
    shortest = float(np.ptp(np.reshape(described.domain.bounds, (2, 2)), axis=0).min())
    if not 0 < size < shortest / 4:
        raise SkinError(f"--radius {radius:g} mm; it must be below a quarter of the sheet's {1e3 * shortest:g} mm")
    volts = _volts(noise, described)
    found = [_Judged.of(described, mode, injections, volts, size)]
    if optimise:
        current = float(np.median(described.pair_currents()))
        sheet = described.domain, described.sheet.conductivity, 0.75 * described.imaging.mesh_size
        search = LayoutSearch(*sheet, size, volts, found[0].injections, current)
        places = tuple((round(float(x), 9), round(float(y), 9)) for x, y in search.best(optimise).positions)
        kept = described.electrode
        contacts: dict[str, Any] = {"radius": kept.radius, "contact_resistivity": kept.contact_resistivity}
        electrode = ElectrodeLayout("listed", positions=places, **contacts)
        imaging = replace(described.imaging, pairs=min(described.imaging.pairs, optimise * (optimise - 1) // 2))
        better = replace(described, name=f"{described.name}-{optimise}", electrode=electrode, imaging=imaging)
        same = found[0].name if found[0].name == _BEST else found[0].name[-1]
        possible = modes(better)
        name = same if same == _BEST else next((name for name in possible if name.endswith(same)), "")
        fixed = name == _BEST or drive_of(possible[name], better).scans == 1
        found.append(_Judged.of(better, name, injections if fixed else found[0].injections, volts, size))
        target = save or Path(f"{described.name}-optimised.toml")
        _write(target, better.dump())
    for judged in found:
        print(judged.line)
    if json_file is not None:
        _write(
            json_file,
            json.dumps({"noise": volts, "radius": size, "layouts": [judged.told for judged in found]}, indent=1),
        )
    save_error_maps(output, [judged.map for judged in found])
    print(f"picture: {output}" + (f"; skin: {target}" if optimise else ""))


@dataclass(frozen=True, eq=False)
class _Judged:
    """A skin and what it can do."""

    skin: Skin
    name: str
    injections: int
    map: ErrorMap

    @classmethod
    def of(cls, skin: Skin, mode: str, injections: int, noise: float, radius: float) -> "_Judged":
        table = ContactTable(skin.transfer_model(), radius, pitch=0.45 * skin.imaging.mesh_size)
        currents = skin.pair_currents()
        candidates = Candidates.at_currents(complete_pattern(skin.electrodes), len(skin.electrodes), noise, currents)
        name, count, scheme = _scheme(skin, mode, injections, table, candidates)
        places = spread_places(table, _PLACES)
        errors = position_bound(table, places, scheme, noise, currents)
        title = f"{skin.name}: {'best fixed set' if name == _BEST else name}, {count} injections"
        return cls(skin, name, count, ErrorMap(title, skin.domain, skin.electrodes, places, errors))

    @property
    def line(self) -> str:
        errors, worst = 1e3 * self.map.errors, 1e3 * self.map.places[int(np.argmax(self.map.errors))]
        frame = part_of(complete_pattern(self.skin.electrodes), np.zeros(self.injections, np.int64))
        return (
            f"{self.map.title} ({1e3 * self.skin.cost.time(frame):.3g} ms): "
            f"position error mean {errors.mean():.3g} mm, median {np.median(errors):.3g} mm, "
            f"worst {errors.max():.3g} mm at ({worst[0]:.0f}, {worst[1]:.0f}) mm"
        )

    @property
    def told(self) -> dict[str, Any]:
        errors = self.map.errors
        return {
            "skin": self.skin.name,
            "mode": self.name,
            "injections": self.injections,
            "mean": float(errors.mean()),
            "median": float(np.median(errors)),
            "worst": float(errors.max()),
            "electrodes": self.skin.electrodes.positions.tolist(),
            "places": self.map.places.tolist(),
            "errors": errors.tolist(),
        }


def _scheme(
    skin: Skin, mode: str, injections: int, table: ContactTable, candidates: Candidates
) -> tuple[str, int, Scheme]:
    """The name, the injections of a frame, and what drives them."""
    if injections < 0:
        raise PatternError(f"--injections {injections}; it must be positive, or 0 for the mode's own number")
    if mode == _BEST:
        count = injections or 28
        return _BEST, count, part_of(candidates.pattern, best_fixed(table, candidates, count))
    choices = modes(skin)
    name = mode or default_mode(skin)
    if name not in choices:
        possible = ", ".join([*choices, _BEST])
        raise PatternError(f"mode {name!r} is not possible with skin {skin.name!r}; choose from {possible}")
    settings = DriveSettings(skin.electrodes, lambda: (table, candidates), skin.imaging.pairs)
    drive = DRIVES[choices[name].drive](settings, 0)
    if drive.adjustable:  # of a contact that rests while frames add up to so many injections
        frames = -(-(injections or 28) // drive.injections)
        target = ContactPrior.usual(table.radius).at

        def tracked(place: Any) -> list[DrivePattern]:
            return [drive.next(target(np.asarray(place)[None]), turn) for turn in range(frames)]

        return name, frames * drive.injections, tracked
    if injections:
        drive = DRIVES[choices[name].drive](settings, injections)
    return name, drive.injections, drive


def _volts(text: str, skin: Skin) -> float:
    """A noise level in volts."""
    if not text:
        return skin.noise
    number, factor = text.strip(), 1.0
    decibels = number.lower().endswith("db")
    for unit, size in (("db", 1.0), ("uv", 1e-6), ("mv", 1e-3), ("v", 1.0)):
        if number.lower().endswith(unit):
            number, factor = number[: -len(unit)], size
            break
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if decibels and math.isfinite(value):
        base = adjacent([skin.electrodes.rings[0]])
        table = skin.pair_currents()
        first = Candidates.at_currents(base, len(skin.electrodes), 1.0, table)
        resistance = skin.transfer_model().pair_resistances
        return float(np.abs(first.weights @ resistance).max()) * 10 ** (-value / 20)
    if not (math.isfinite(value) and value > 0):
        raise DataError(f"--noise {text!r}; give volts such as 0.2mV, 50uV or 1e-4, or decibels such as 50dB")
    return value * factor


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DataError(f"cannot write {path}: {error}") from error
