"""Press data: the values of many presses of known places, a row for each.

A text table has a header: ``x`` and ``y`` (metres; or ``x_mm``, ``y_mm``), perhaps ``force`` (N), and a column for each
value of a frame, in the order of the pattern. A MATLAB file has ``voltages`` (n_presses, n_values) and ``positions``
(n_presses, 2) in metres, perhaps ``forces`` (n_presses,), and ``reference`` of the untouched skin, (n_frames,
n_values), or a row for each press, from before it. Rows without a place (empty, or not a number) are of the untouched
skin, and so are those whose force is 0 where others have one; unless they have a force or differ as presses do. Where
no row has either, all are presses.

The pattern is in the MATLAB file, as EIDORS has it, or in a table beside the text (`ohmskin.importers.table`); without
one it is adjacent drive, voltages between neighbours in the order of the electrodes' numbers, those of driven ones
among them or not. Lines of a table that begin with ``#`` may hold ``first``, ``current`` and ``skin`` as elsewhere, and
``values``: ``voltages``, ``magnitudes`` (of rectified voltages), or ``differences`` (against the untouched skin, which
is not recorded); a MATLAB file may have texts ``skin`` and ``values``.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ohmskin.arrays import Bools, Floats
from ohmskin.errors import DataError, shown
from ohmskin.forward import TransferModel
from ohmskin.importers.eidors import pattern_of
from ohmskin.importers.matfile import numbers
from ohmskin.importers.orders import likeliest
from ohmskin.importers.parts import Recording
from ohmskin.importers.pattern import ImportedPattern, from_list
from ohmskin.scan import Frame

VALUES = ("voltages", "magnitudes", "differences")
_COLUMN = re.compile(r"(?:pos(?:ition)?_?|p)?([xyz])(?:_?pos(?:ition)?)?(?:[ _]*[\[(]?(mm|cm|m)[\])]?)?")
_FORCE = re.compile(r"(?:force|load|fz?|normal_force)(?:[ _]*[\[(]?n[\])]?)?")
_ASIDE = {"index", "id", "time", "timestamp", "t", "sample", "frame", "press", "trial", "label", "depth", ""}
_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_WIDEST = 2.0  # span of the presses (m) beyond which places without a unit are millimetres
_NAMES = {  # of the arrays of a MATLAB file, in small letters, the documented one first
    "voltages": ("voltages", "voltage", "v", "measurements", "data"),
    "positions": ("positions", "position", "pos", "xy", "locations", "places", "labels", "targets"),
    "forces": ("forces", "force", "f", "fz", "loads"),
    "reference": ("reference", "references", "baseline", "homogeneous", "vref", "v0", "rest", "quiet"),
}
_MOST_QUIET = 40
_WEAK, _STRONG, _USUAL = 1e-3, 0.3, 0.02  # share of the quiet voltages that differences have: least, most, taken
_ALIKE = 0.9  # share of the columns that are named alike, from which on others hold no values
_NAMED = 8  # of them at most
_FEW, _COMPONENTS = 8, 15  # principal components of presses' changes by which a row is held to be one: least, most
_AS_PRESSES = 0.4  # share of a usual press's change from which on a row is of one, too
_UNTOLD = 0.02  # share of a usual change that is taken for noise where nothing tells it
_LEAST_SPREAD = 0.05  # over their size, of voltages, below which an offset is none of its own
_OFFSET = 0.1  # times what is left without one, below which the quiet voltages have a common offset
_MIXED = 0.1  # share of the quiet voltages that is negative on the model, from which all positive ones are rectified


def is_press_table(header: tuple[str, ...]) -> bool:
    """Whether a table with such a header holds presses."""
    return {"x", "y"} <= set(_places_in(header))


def is_press_file(variables: Mapping[str, Any]) -> bool:
    """Whether a MATLAB file with such variables holds presses."""
    return {"voltages", "positions"} <= set(_arrays_in(variables))


def _places_in(header: tuple[str, ...]) -> dict[str, tuple[int, str]]:
    """Column and unit of each coordinate that a header names."""
    found = ((k, _COLUMN.fullmatch(name)) for k, name in enumerate(header))
    return {match[1]: (k, match[2] or "") for k, match in reversed([*found]) if match}


def _arrays_in(variables: Mapping[str, Any]) -> dict[str, str]:
    """The names that a file has for our arrays; documented ones count before others."""
    small = {name.lower(): name for name in reversed([*variables])}
    told = ((ours, [small[one] for one in names if one in small]) for ours, names in _NAMES.items())
    return {ours: names[0] for ours, names in told if names}


def read_table(
    header: tuple[str, ...], cells: Floats, pattern: ImportedPattern | None, settings: Mapping[str, str], name: str
) -> Recording:
    """The presses of a table: its header and cells (n_rows, n_columns), its pattern if there is one, its settings.

    Raises:
        DataError: If the values do not fit the pattern, or there is no press.
    """
    known = _places_in(header)
    force = [k for k, column in enumerate(header) if _FORCE.fullmatch(column)]
    aside = [k for k, column in enumerate(header) if column in _ASIDE]
    used = {*(k for k, _ in known.values()), *force[:1], *aside}
    columns = [k for k in range(len(header)) if k not in used]
    kinds = {k: re.sub(r"\d+", "0", header[k]) for k in columns}
    (usual, count), *_ = Counter(kinds.values()).most_common() or [("", 0)]
    if count > _ALIKE * len(columns):  # v0, v1, ...: what is named otherwise is no value
        aside += [k for k in columns if kinds[k] != usual]
    values = cells[:, [k for k in columns if k not in aside]]
    places, notes = _in_metres(np.column_stack([cells[:, known[axis][0]] for axis in "xy"]), known["x"][1])
    left_out = [shown(header[k]) for k in [*aside, *(k for axis, (k, _) in known.items() if axis == "z")]]
    more = f" and {len(left_out) - _NAMED} more" if len(left_out) > _NAMED else ""
    notes += (f"columns {', '.join(left_out[:_NAMED])}{more} are left out",) if left_out else ()
    forces = cells[:, force[0]] if force else None
    found = _recording(values, places, forces, values[:0], pattern, settings, name)
    return replace(found, notes=(*notes, *found.notes))


def _in_metres(places: Floats, unit: str) -> tuple[Floats, tuple[str, ...]]:
    """Places (n, 2) in metres; what is wider than skins are is taken for millimetres where no unit is given."""
    known = places[np.isfinite(places).all(axis=1)]
    if not unit and len(known) and max(np.ptp(known, axis=0)) > _WIDEST:
        wide = f"places span {max(np.ptp(known, axis=0)):g}"
        return 1e-3 * places, (f"{wide} without a unit: interpreted as millimetres",)
    return _METRES[unit or "m"] * places, ()


def read_variables(variables: Mapping[str, Any], name: str, driven: bool) -> Recording:
    """The presses of a MATLAB file.

    Raises:
        DataError: If arrays do not fit each other or the pattern, or there is no press.
    """
    named = _arrays_in(variables)
    given = {ours: numbers(variables[theirs], theirs) for ours, theirs in named.items()}
    voltages, places = given["voltages"], given["positions"]
    places = places if places.shape[1:] in ((2,), (3,)) else places.T
    if places.ndim != 2 or places.shape[1] not in (2, 3):
        raise DataError(f"{name}: positions have shape {places.shape}; need (n_presses, 2), in metres")
    square = voltages.shape == (len(places),) * 2
    voltages = voltages if len(voltages) == len(places) else voltages.T
    if len(voltages) != len(places):
        raise DataError(f"{name}: voltages have shape {voltages.shape} for {len(places)} positions; a row for each")
    forces, quiet = None, np.empty((0, voltages.shape[1]))
    if "forces" in given:
        forces = given["forces"].ravel()
        if len(forces) != len(places):
            raise DataError(f"{name}: {len(forces)} forces for {len(places)} positions; one for each")
    if "reference" in given:
        quiet = given["reference"]
        quiet = quiet.T if quiet.shape[1] != voltages.shape[1] else quiet
        if quiet.shape[1] != voltages.shape[1]:
            raise DataError(f"{name}: reference has shape {quiet.shape}; need (n, {voltages.shape[1]})")
    if len(quiet) == len(voltages) > 1:  # from before each press: drift is taken off
        steps = np.diff(quiet, axis=0)[:_MOST_QUIET] / np.sqrt(2)
        voltages, quiet = voltages - quiet + quiet.mean(axis=0), quiet.mean(axis=0) + steps - steps.mean(axis=0)
    pattern = None
    if any(key in variables for key in ("stim_pattern", "stim_meas_list", "stimulation", "fmdl")):
        pattern, _ = pattern_of(dict(variables), driven)
    settings = {key: str(value) for key, value in variables.items() if key in ("skin", "values")}
    places, notes = _in_metres(places[:, :2], "")
    notes += ("as many values as presses: a row of voltages is interpreted as a press",) if square else ()
    notes += tuple(f"{theirs!r} is interpreted as {ours}" for ours, theirs in named.items() if ours != theirs)
    found = _recording(voltages, places, forces, quiet, pattern, settings, name)
    return replace(found, notes=(*notes, *found.notes))


def _recording(
    values: Floats,
    places: Floats,
    forces: Floats | None,
    quiet: Floats,
    pattern: ImportedPattern | None,
    settings: Mapping[str, str],
    name: str,
) -> Recording:
    kind, skin = settings.get("values", VALUES[0]), settings.get("skin", "")
    if kind not in VALUES:
        raise DataError(f"{name}: values = {shown(kind)}; choose from {', '.join(VALUES)}")
    pressed, notes = _pressed(values, places, forces, quiet)
    if not pressed.any():
        raise DataError(f"{name} has no press: no row has a place, or a force above 0")
    values, places, quiet = values[pressed], places[pressed], np.vstack([quiet, values[~pressed]])
    forces = None if forces is None else forces[pressed]
    if pattern is None:
        values, quiet, pattern, more = _adjacent(values, quiet, settings, name)
        notes += more
    if kind == "differences":
        quiet = quiet[:0]
    elif not len(quiet):
        quiet = _median(values)[None]
        notes = (*notes, "no frame of the untouched skin: the median over the presses is used")
    rest = tuple(pattern.frame(row, name, k) for k, row in enumerate(quiet[:_MOST_QUIET]))
    frames = tuple(pattern.frame(row, name, k) for k, row in enumerate(values))
    return Recording(rest, frames, skin, (*pattern.notes, *notes), None, places, forces, kind)


def _pressed(values: Floats, places: Floats, forces: Floats | None, quiet: Floats) -> tuple[Bools, tuple[str, ...]]:
    """(n,) whether a row of values (n, n_values) is of a press, and notes; places (n, 2) and forces (n,) as given,
    `quiet` (n_quiet, n_values) what is known of the untouched skin beside them."""
    placed, notes = np.isfinite(places).all(axis=1), list[str]()
    forces = np.full(len(values), np.nan) if forces is None else forces
    if not (placed | np.isfinite(forces)).any():
        return np.ones(len(values), bool), ("no row has a place or a force: all are taken for presses",)
    resting = (forces == 0) & bool((forces > 0).any())
    sure = (forces > 0) | (placed & ~resting)
    if sure.any() and not sure.all():
        rest = _median(quiet if len(quiet) else values[~sure])
        changes = np.nan_to_num(values - rest)
        usual = np.sqrt((changes[sure] ** 2).mean(axis=0))  # each channel by its own: one may be noise alone
        changes = changes / np.where(usual > 0, usual, np.inf)
        if (most := int(sure.sum()) // 2) >= _FEW:  # most of noise is in no component of these
            changes = changes @ np.linalg.svd(changes[sure], full_matrices=False)[2][: min(most, _COMPONENTS)].T
        change = np.linalg.norm(changes, axis=1)
        sure |= change > _AS_PRESSES * np.median(change[sure])
    if lost := int((sure & ~placed).sum()):
        notes.append(f"{lost} rows without a place are presses: by their force, or by how much they differ")
    if rested := int((~sure & placed).sum()):
        notes.append(f"{rested} rows with a force of 0 are of the untouched skin")
    return sure, tuple(notes)


def _median(values: Floats) -> Floats:
    """Of each column (n,) of values; NaN where none is known."""
    known = np.isfinite(values).any(axis=0)
    return np.where(known, np.nanmedian(np.where(known, values, 0.0), axis=0), np.nan)


def _adjacent(
    values: Floats, quiet: Floats, settings: Mapping[str, str], name: str
) -> tuple[Floats, Floats, ImportedPattern, tuple[str, ...]]:
    """Values and quiet ones as voltages of adjacent drive, in the order that they seem to be in."""
    order, doubt = likeliest(quiet if len(quiet) else values)
    if doubt and len(quiet):  # counts round the middle of a scale, or other offsets
        by_changes = likeliest(values - _median(quiet))
        order, doubt = (order, doubt) if by_changes[1] else by_changes
    count = values.shape[1]
    if order is None:
        told = f"{name} has {count} values a frame and no pattern; adjacent drive of n electrodes has n (n - 3)"
        where = "Put a table with the columns source, sink, plus, minus beside it, or stim_meas_list into a MATLAB file"
        raise DataError(f"{told} to n^2. {where}")
    try:
        current = float(settings.get("current", "1"))
    except ValueError as error:
        raise DataError(f"{name}: {shown(str(error))} in its settings (current = 5e-3)") from error
    kept = from_list(order.quadruples, np.full(len(order.quadruples), current), False)
    n_elec = int(order.quadruples.max()) + 1
    notes = f"no pattern in the file: adjacent drive of {n_elec} electrodes, {order.words}", *([doubt] if doubt else [])
    if "current" not in settings:
        notes += ("no current is given: 1 A is assumed",)
    return order.volts(values), order.volts(quiet), kept, notes


def resolved(recording: Recording, model: TransferModel) -> Recording:
    """A recording as voltages: signs or the untouched skin, if its file lacks them, are taken from the model.

    Rectified voltages take the model's signs, and so do values that are all positive where the model's are not;
    voltages that are all inverted get their sign back; an offset of all, as of counts round the middle of a scale, is
    taken off; differences are added to the model's quiet voltages. Notes list it.

    Args:
        recording: As read; `values` states what it contains.
        model: Of the untouched skin.
    """
    pattern = recording.frames[0].pattern
    at_rest = model.voltages(pattern) * recording.frames[0].measurement_currents
    kind, quiet, frames, notes = recording.values, recording.quiet, recording.frames, list(recording.notes)
    if kind == "differences":
        changes = np.array([frame.voltages for frame in frames])
        finite = changes[np.isfinite(changes)]
        share = float(np.sqrt(np.mean(finite**2)) / np.sqrt(np.mean(at_rest**2))) if len(finite) else 0.0
        scale = 1.0 if _WEAK < share < _STRONG or not share else _USUAL / share
        notes.append("differences alone: the untouched skin is the model's, and offsets are not checked")
        if scale != 1:
            notes.append(
                f"the differences were scaled by {scale:.3g}, as their unit is not volts: strengths are relative"
            )
        if np.nansum(changes * at_rest) > 0:  # a press conducts, so that the same current takes less power
            notes.append("their sign is not that of a press: interpreted as the untouched skin less the pressed one")
            scale = -scale
        quiet = (Frame(pattern, at_rest, frames[0].currents),)
        frames = tuple(replace(frame, voltages=at_rest + scale * frame.voltages) for frame in frames)
        quiet = _with_noise(quiet, frames, notes)
        return replace(recording, quiet=quiet, frames=frames, values=VALUES[0], notes=tuple(notes))
    measured = np.ma.masked_invalid([frame.voltages for frame in quiet]).mean(axis=0).filled(np.nan)
    known = np.isfinite(measured)
    x, y = at_rest[known], measured[known]
    (slope, offset, left), (_, _, of_sizes) = (_line(one, y) for one in (x, np.abs(x)))
    mixed = (x < 0).mean() > _MIXED < (x > 0).mean()
    signs = np.ones(len(measured))
    if kind == "magnitudes" or bool((y >= 0).all() and mixed and of_sizes < left):
        signs = np.where(at_rest < 0, -1.0, 1.0)
        notes.append("magnitudes: their signs are the model's")
    else:
        if left < _OFFSET * (1 - float(x @ y) ** 2 / max(float(x @ x) * float(y @ y), 1e-300)):
            notes.append(f"all voltages have an offset of {offset:.3g}: it was taken off")
            quiet, frames = (
                tuple(replace(one, voltages=one.voltages - offset) for one in some) for some in (quiet, frames)
            )
        if slope < 0:
            signs = -signs
            notes.append("all voltages have the opposite sign of the model's: inverted")
    if (signs < 0).any():
        quiet, frames = (tuple(replace(one, voltages=signs * one.voltages) for one in some) for some in (quiet, frames))
    if recording.positions is not None:
        quiet = _with_noise(quiet, frames, notes)
    return replace(recording, quiet=quiet, frames=frames, values=VALUES[0], notes=tuple(notes))


def _line(x: Floats, y: Floats) -> tuple[float, float, float]:
    """Slope and offset of the line that fits y (n,) best, and the share of its squares that this leaves."""
    usual = np.sqrt(np.mean(x**2)) if len(x) else 0.0
    design = np.stack([x, np.full(len(x), usual)], axis=1)
    found = np.linalg.lstsq(design, y, rcond=_LEAST_SPREAD)[0]
    left = ((y - design @ found) ** 2).sum() / max(float(y @ y), 1e-300)
    return float(found[0]), float(usual * found[1]), float(left)


def _with_noise(quiet: Sequence[Frame], frames: Sequence[Frame], notes: list[str]) -> Sequence[Frame]:
    """Quiet frames that noise can be estimated from: not one alone, as errors that repeat at rest are no noise."""
    if len(quiet) > 1:
        return quiet
    (rest,) = quiet
    changes = np.array([frame.voltages for frame in frames]) - rest.voltages
    noise = _UNTOLD * float(np.sqrt(np.mean(changes[np.isfinite(changes)] ** 2)))
    notes.append(f"one quiet frame does not determine the noise: {_UNTOLD:.0%} of a usual change is assumed")
    shift = noise / np.sqrt(2) * np.where(np.arange(changes.shape[1]) % 2, 1.0, -1.0)
    return tuple(replace(rest, voltages=rest.voltages + sign * shift) for sign in (1.0, -1.0))
