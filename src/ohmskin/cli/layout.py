"""``ohmskin layout``: the bound on a contact's position error over a skin, and electrode layouts that lower it."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ohmskin.arrays import Floats, as_plain
from ohmskin.cli.options import SkinName, check_picture, check_writable, write_skin
from ohmskin.drive import (
    DRIVES,
    Candidates,
    ContactPrior,
    Drive,
    DriveSettings,
    Fixed,
    LayoutSearch,
    best_fixed,
    complete_pattern,
    part_of,
    position_bound,
)
from ohmskin.drive.bound import Scheme, spread_places
from ohmskin.drive.layout import check_count
from ohmskin.errors import DataError, OhmskinError, PatternError, SkinError
from ohmskin.evaluate.reached import reached_errors
from ohmskin.forward import ContactTable
from ohmskin.plot import ErrorMap, save_error_maps
from ohmskin.scan import DrivePattern, adjacent
from ohmskin.sensing import default_mode, drive_of, modes
from ohmskin.skin import Mode, Skin
from ohmskin.skin.files import write

_PLACES = 700
_BEST = "best"


def layout(
    *,
    skin: SkinName = "paper",
    mode: str = "",
    injections: int = 0,
    noise: str = "",
    radius: float = 8.0,
    optimise: int = 0,
    contacts: int = 40,
    output: Path = Path("layout.png"),
    json_file: Path | None = None,
    save: Path | None = None,
) -> None:
    """Map the Cramer-Rao bound on a contact's position error over the sheet, or find a layout with a lower one.

    No unbiased estimator has a smaller error than the bound. The errors of the mode's own reader at some places are
    printed for comparison.

    Args:
        mode: A mode such as 12B, 16I, 16O or 16P, or "best", the best fixed injections; the skin's default mode unless
            given.
        injections: Injections of a frame, those of the base scan included; the mode's number unless given, 28 with
            "best".
        noise: Noise of a voltage, such as 0.2mV, 50uV or 1e-4 (volts), or 50dB below the largest voltage of the skin's
            first mode. The noise of the skin unless given.
        radius: Radius of the contact (mm), which changes the conductivity by 50 %.
        optimise: Number of electrodes to place for the lowest worst bound; the new layout is compared with the old one.
        contacts: Number of simulated contacts to compare the mode's errors with the bound; 0: none.
        output: Picture to write.
        json_file: JSON file to write with all figures; none unless given.
        save: With --optimise, skin file to write; SKIN-optimised.toml in this folder unless given.
            One that is there is kept under another name.
    """
    check_picture(output)
    if save is not None and not optimise:
        raise OhmskinError("--save has no effect without --optimise, whose layout it keeps; add that")
    for path in (json_file, save):
        if path is not None:
            check_writable(path)
    described = Skin.load(skin)
    size = 1e-3 * radius
    shortest = float(np.ptp(np.reshape(described.domain.bounds, (2, 2)), axis=0).min())
    if not 0 < size < shortest / 4:
        raise SkinError(f"--radius {radius:g} mm; it must be below a quarter of the sheet's {1e3 * shortest:g} mm")
    if optimise:
        check_count(optimise, described.domain)
    if contacts < 0:
        raise OhmskinError(f"--contacts {contacts}; it must be 0 or more")
    volts = _volts(noise, described)
    found = [_judge(described, mode, injections, volts, size, contacts)]
    if optimise:
        used, count = found[0][1]["mode"], found[0][1]["injections"]
        current = float(np.median(described.pair_currents()))
        sheet = described.domain, described.conductivity_on, 0.75 * described.imaging.mesh_size
        search = LayoutSearch(*sheet, size, volts, count, current, described.chart.scale)
        electrode = described.electrode.moved_to(search.best(optimise).positions)
        imaging = replace(described.imaging, pairs=min(described.imaging.pairs, optimise * (optimise - 1) // 2))
        better = replace(described, name=f"{described.name}-{optimise}", electrode=electrode, imaging=imaging)
        possible = modes(better)
        name = used if used == _BEST else next((name for name in possible if name.endswith(used[-1])), "")
        fixed = name == _BEST or drive_of(possible[name], better).scans == 1
        found.append(_judge(better, name, injections if fixed else count, volts, size, contacts))
        target = save or Path(f"{described.name}-optimised.toml")
        write_skin(target, better)
    lines, layouts, maps = zip(*found, strict=True)
    print("\n".join(lines))
    print("No unbiased estimator has a smaller error than the bound. docs/modes.md has the errors of all modes.")
    if json_file is not None:
        write(json_file, json.dumps({"noise": volts, "radius": size, "layouts": layouts}, indent=1))
    save_error_maps(output, maps)
    print(f"picture: {output}" + (f"; skin: {target}" if optimise else ""))


def _judge(
    skin: Skin, mode: str, injections: int, noise: float, radius: float, contacts: int
) -> tuple[str, dict[str, Any], ErrorMap]:
    """What a skin can do, in lines, as figures and as a map."""
    electrodes, metres = skin.electrodes, skin.chart.scale
    complete = complete_pattern(electrodes)

    @cache
    def design() -> tuple[ContactTable, Candidates]:  # made when it is used: what cannot be is refused before
        usual = radius / float(np.median(metres(skin.mesh().centroids)))
        table = ContactTable(skin.transfer_model(), usual, pitch=0.45 * skin.imaging.mesh_size)
        return table, Candidates.at_currents(complete, len(electrodes), noise, skin.pair_currents())

    name, count, scheme, (read, drive, frames) = _scheme(skin, mode, injections, design)
    (table, _), currents = design(), skin.pair_currents()
    places = spread_places(table, _PLACES)
    errors = position_bound(table, places, scheme, noise, currents, ContactPrior.usual(radius), metres(places))
    title = f"{skin.name}: {'best fixed set' if name == _BEST else name}, {count} injections"
    mean, median, worst = float(errors.mean()), float(np.median(errors)), float(errors.max())
    x, y = 1e3 * places[int(np.argmax(errors))]
    line = (
        f"{title} ({1e3 * skin.cost.time(part_of(complete, np.zeros(count, np.int64))):.3g} ms)\n"
        f"  bound on the position error (Cramer-Rao): mean {1e3 * mean:.3g} mm, median {1e3 * median:.3g} mm, "
        f"worst {1e3 * worst:.3g} mm at ({x:.0f}, {y:.0f}) mm"
    )
    told = {"skin": skin.name, "mode": name, "injections": count, "mean": mean, "median": median, "worst": worst}
    arrays = {"electrodes": electrodes.positions, "places": places, "errors": errors}
    if contacts:
        some = np.linspace(0, len(places) - 1, min(contacts, len(places))).round().astype(int)
        reached = reached_errors(skin, read, drive, noise, radius, places[some], frames)
        line += f"\n  {_reached(read.reader, reached, errors[some])}"
        arrays |= {"reached_places": places[some], "reached": reached}
    return line, told | as_plain(arrays), ErrorMap(title, skin.domain, electrodes, places, errors)


def _reached(reader: str, errors: Floats, bound: Floats) -> str:
    """What the errors of simulated contacts are beside the bound at the same places, both in metres."""
    at, found = f"at {len(errors)} of these places, simulated with the same model:", errors[np.isfinite(errors)]
    missed = f"; {len(errors) - len(found)} not found" if len(found) < len(errors) else ""
    if not len(found):
        return f"{at} no contact is found (reader: {reader})"
    mean, median, worst = 1e3 * found.mean(), 1e3 * np.median(found), 1e3 * found.max()
    ours = f"error mean {mean:.3g} mm, median {median:.3g} mm, worst {worst:.3g} mm (reader: {reader}{missed})"
    return f"{at} {ours}; bound mean {1e3 * bound.mean():.3g} mm"


def _scheme(
    skin: Skin, mode: str, injections: int, design: Callable[[], tuple[ContactTable, Candidates]]
) -> tuple[str, int, Scheme, tuple[Mode, Drive, int]]:
    """The name, the injections of a frame, and what drives them; what reads, of which drive, how many frames."""
    if injections < 0:
        raise PatternError(f"--injections {injections}; it must be positive, or 0 for the mode's own number")
    choices = modes(skin)
    if mode == _BEST:
        count, (table, candidates) = injections or 28, design()
        chosen = part_of(candidates.pattern, best_fixed(table, candidates, count))
        return _BEST, count, chosen, (choices[default_mode(skin)], Fixed(chosen), 1)
    name = mode or default_mode(skin)
    if name not in choices:
        possible = ", ".join([*choices, _BEST])
        raise PatternError(f"mode {name!r} is not possible with skin {skin.name!r}; choose from {possible}")
    settings = DriveSettings(skin.electrodes, design, skin.imaging.pairs)
    drive = DRIVES[choices[name].drive](settings, 0)
    if drive.adjustable:  # of a contact that rests while frames add up to so many injections
        frames = -(-(injections or 28) // drive.injections)
        target = ContactPrior.usual(design()[0].radius).at

        def tracked(place: Any) -> list[DrivePattern]:
            return [drive.next(target(np.asarray(place)[None]), turn) for turn in range(frames)]

        return name, frames * drive.injections, tracked, (choices[name], drive, frames)
    if injections:
        drive = DRIVES[choices[name].drive](settings, injections)
    return name, drive.injections, drive, (choices[name], drive, 1)


def _volts(text: str, skin: Skin) -> float:
    """A noise level in volts."""
    if not text:
        return skin.noise
    found = re.fullmatch(r"([-+.\de]+)\s*(db|uv|mv|v|)", text.strip().lower())
    try:
        value = float(found[1]) if found else math.nan
    except ValueError:
        value = math.nan
    if found and found[2] == "db" and math.isfinite(value):
        base = adjacent([skin.electrodes.rings[0]])
        first = Candidates.at_currents(base, len(skin.electrodes), 1.0, skin.pair_currents())
        return float(np.abs(first.weights @ skin.transfer_model().pair_resistances).max()) * 10 ** (-value / 20)
    if not found or not (math.isfinite(value) and value > 0):
        raise DataError(f"--noise {text!r}; give volts such as 0.2mV, 50uV or 1e-4, or decibels such as 50dB")
    return value * {"uv": 1e-6, "mv": 1e-3}.get(found[2], 1.0)
