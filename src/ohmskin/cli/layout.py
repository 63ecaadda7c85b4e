"""``ohmskin layout``: how well a skin can locate a contact, and where its electrodes had better be."""

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ohmskin.drive import (
    Candidates,
    ContactPrior,
    InformedPolicy,
    LayoutSearch,
    PositionDrive,
    base_pattern,
    best_fixed,
    complete_pattern,
    modes,
    part_of,
    position_bound,
)
from ohmskin.drive.bound import Scheme, spread_places
from ohmskin.errors import DataError, PatternError, SkinError
from ohmskin.forward import ContactTable
from ohmskin.geometry.domain import Floats
from ohmskin.plot import ErrorMap, save_error_maps
from ohmskin.scan import DrivePattern
from ohmskin.skin import Skin
from ohmskin.skin.description import ElectrodeLayout

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

    Parameters
    ----------
    skin
        A skin that ships with ohmskin or a .toml file.
    mode
        What is driven: a drive mode such as 12B, 16I, 16O or 16P, or "best", the best fixed set of injections. 16P unless given.
    injections
        Of a frame; for adaptive modes the base scan included. As many as the mode has unless given; with "best" 28.
    noise
        Of a voltage, such as 0.2mV, 50uV or 1e-4 (volts), or 50dB below the largest voltage of the skin's first mode. The
        skin's own unless given.
    radius
        Of the contact, in millimetres. It changes the conductivity by a half.
    optimise
        Find where so many electrodes should be for the smallest worst error, and compare.
    output
        Where to put the picture.
    json_file
        Where to put all figures, as JSON; nowhere unless given.
    save
        With --optimise, where to put the skin that was found; SKIN-optimised.toml in this folder unless given.
    """
    described = Skin.load(skin)
    size = 1e-3 * radius
    shortest = float(np.ptp(np.reshape(described.domain.bounds, (2, 2)), axis=0).min())
    if not 0 < size < shortest / 4:
        raise SkinError(f"--radius {radius:g} mm; it must be positive and below a quarter of the sheet's {1e3 * shortest:g} mm")
    volts = _volts(noise, described)
    found = [_Judged.of(described, mode, injections, volts, size)]
    if optimise:
        current = float(np.median(described.pair_currents()))
        search = LayoutSearch(
            described.domain,
            described.sheet.conductivity,
            0.75 * described.imaging.mesh_size,
            size,
            volts,
            found[0].injections,
            current,
        )
        places = tuple((round(float(x), 9), round(float(y), 9)) for x, y in search.best(optimise).positions)
        kept = described.electrode
        electrode = ElectrodeLayout("listed", radius=kept.radius, contact_resistivity=kept.contact_resistivity, positions=places)
        imaging = replace(described.imaging, pairs=min(described.imaging.pairs, optimise * (optimise - 1) // 2))
        better = replace(described, name=f"{described.name}-{optimise}", electrode=electrode, imaging=imaging)
        same = found[0].name if found[0].name == _BEST else found[0].name[-1]
        name = same if same == _BEST else next((name for name in better.modes if name.endswith(same)), "")
        fixed = name == _BEST or better.modes[name].optimal is None
        found.append(_Judged.of(better, name, injections if fixed else found[0].injections, volts, size))
        target = save or Path(f"{described.name}-optimised.toml")
        _write(target, better.dump())
    for judged in found:
        print(judged.line)
    if json_file is not None:
        _write(json_file, json.dumps({"noise": volts, "radius": size, "layouts": [judged.told for judged in found]}, indent=1))
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
            f"{self.map.title} ({1e3 * self.skin.cost.time(frame):.3g} ms): position error mean {errors.mean():.3g} mm, "
            f"median {np.median(errors):.3g} mm, worst {errors.max():.3g} mm at ({worst[0]:.0f}, {worst[1]:.0f}) mm"
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


def _scheme(skin: Skin, mode: str, injections: int, table: ContactTable, candidates: Candidates) -> tuple[str, int, Scheme]:
    """The name, the injections of a frame, and what drives them."""
    if injections < 0:
        raise PatternError(f"--injections {injections}; it must be positive, or 0 for the mode's own number")
    if mode == _BEST:
        count = injections or 28
        return _BEST, count, part_of(candidates.pattern, best_fixed(table, candidates, count))
    electrodes = skin.electrodes
    base, tracking = base_pattern(electrodes), InformedPolicy(electrodes, lambda: (table, candidates))

    def made(pairs: int) -> Any:
        drive = PositionDrive(electrodes, lambda: (table, candidates), pairs, base.injections)
        return modes(electrodes, pairs, True, drive, tracking)

    choices = made(skin.imaging.pairs)
    name = mode or f"{len(electrodes)}P"
    if name not in choices:
        raise PatternError(f"mode {name!r} is not possible with skin {skin.name!r}; choose from {', '.join([*choices, _BEST])}")
    chosen = choices[name]
    if chosen.policy is not None:  # of a contact that rests while frames add up to so many injections
        frames = -(-(injections or 28) // tracking.injections)
        target = ContactPrior.usual(table.radius).at

        def tracked(place: Any) -> list[DrivePattern]:
            return [tracking.next(target(np.asarray(place)[None]), turn) for turn in range(frames)]

        return name, frames * tracking.injections, tracked
    if chosen.optimal is None:
        if injections not in (0, chosen.base.n_inj):
            raise PatternError(f"mode {name} always has {chosen.base.n_inj} injections, not {injections}; leave --injections out")
        return name, chosen.base.n_inj, chosen
    if injections:
        if injections <= chosen.base.n_inj:
            raise PatternError(f"--injections {injections}; mode {name} has {chosen.base.n_inj} in its base scan, so give more")
        chosen = made(injections - chosen.base.n_inj)[name]
    assert chosen.optimal is not None
    return name, chosen.base.n_inj + chosen.optimal.pairs, chosen


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
        base = next(iter(skin.modes.values())).base
        table = skin.pair_currents()
        first = Candidates.at_currents(base, len(skin.electrodes), 1.0, table)
        resistance = _pair_resistances(skin)
        return float(np.abs(first.weights @ resistance).max()) * 10 ** (-value / 20)
    if not (math.isfinite(value) and value > 0):
        raise DataError(f"--noise {text!r}; give volts such as 0.2mV, 50uV or 1e-4, or decibels such as 50dB")
    return value * factor


def _pair_resistances(skin: Skin) -> Floats:
    """Two-terminal resistances (n_pairs,) of the untouched sheet; of point electrodes, so good for four-terminal data only."""
    s = skin.transfer_model().transfer_resistance
    i, j = np.triu_indices(len(s), k=1)
    resistances: Floats = s[i, i] + s[j, j] - 2 * s[i, j]
    return resistances


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DataError(f"cannot write {path}: {error}") from error
