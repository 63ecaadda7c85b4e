"""The report: one Markdown page with its pictures beside it."""

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import cast

import numpy as np

import ohmskin
from ohmskin.drive import complete_pattern
from ohmskin.evaluate import worlds
from ohmskin.evaluate.figures.painting import Picture
from ohmskin.evaluate.policies.comparison import Comparison
from ohmskin.evaluate.policies.detection import Detection
from ohmskin.evaluate.policies.follow import PERIOD
from ohmskin.evaluate.policies.goals import MET, MISSED, OPEN, Goal
from ohmskin.evaluate.policies.judge import NAMES, SETTLE, WITHIN, errors, moving_errors, pair_rates, robust_errors, static_errors
from ohmskin.evaluate.policies.lab import RADIUS
from ohmskin.evaluate.policies.moving import Moving
from ohmskin.evaluate.policies.pairs import PairLimits, Pairs, ideal_power
from ohmskin.evaluate.policies.schemes import INSTRUMENTS, TITLES, instrument_cost
from ohmskin.evaluate.policies.static import Static
from ohmskin.evaluate.statistics import mean
from ohmskin.evaluate.worlds import CONTACT_RADIUS, CONTACT_STRENGTH, CURRENT, WORLDS
from ohmskin.geometry.domain import Floats
from ohmskin.skin import Skin

_MISS = 30e-3  # metres; a contact placed further away counts as missed
HEADINGS = {
    "static": "Contacts at rest",
    "time": "The same in equal time",
    "moving": "Moving contacts",
    "pairs": "Two contacts or one",
    "detection": "New contacts",
    "quiet": "Nothing there",
    "robust": "With a flawed model, or a worn skin",
    "cost": "What choosing costs",
}


def write_report(done: Comparison, goals: Sequence[Goal], pictures: dict[str, Picture], path: Path) -> Path:
    """Write the report; returns its path."""
    tables: dict[str, Callable[[Comparison], str]] = {
        "static": _static,
        "time": _time,
        "moving": _moving,
        "pairs": _pairs,
        "detection": _detection,
        "robust": _robust,
        "cost": _cost,
    }
    parts = [_head(done, goals)]
    for section in done.results:
        parts.append(f"## {HEADINGS[section]}")
        if section in pictures:
            picture = pictures[section]
            parts.append(f"![{HEADINGS[section]}]({os.path.relpath(picture.path, path.parent)})\n\n*{picture.caption}*")
        if section in tables:
            parts.append(tables[section](done))
        parts.append(_goals([goal for goal in goals if goal.section == section]))
    path.write_text("\n\n".join(part for part in parts if part) + "\n", encoding="utf-8")
    return path


def _head(done: Comparison, goals: Sequence[Goal]) -> str:
    settings, key = done.settings, [goal for goal in goals if goal.key]
    tally = ", ".join(f"{sum(g.verdict == v for g in key)} {v}" for v in (MET, MISSED, OPEN))
    data = [
        (
            NAMES[world],
            f"{1e3 * CONTACT_RADIUS[world]:g} mm, "
            + (f"+{100 * CONTACT_STRENGTH[world]:g} %" if world == "discs" else f"{CONTACT_STRENGTH[world] / 1e3:g} kPa"),
            f"{1e3 * worlds.full_scale(world):.1f} mV",
            " / ".join(f"{1e6 * worlds.noise_volts(world, level):.0f} µV at {level:g} dB" for level in settings.levels),
        )
        for world in WORLDS
    ]
    return (
        f"# Policies compared\n\nohmskin {ohmskin.__version__}. Written by `ohmskin policies`; every number and verdict is "
        "computed from data.\n\nWhat to measure next: the paper's scheme (16O: a base scan, then pairs by eq. 7), choice by "
        "position information (16P) and tracking with a few injections per frame (16T), on virtual skins, with the same "
        f"absolute noise for all.\n\n## Goals\n\nOf {len(key)} goals: {tally}. A goal is **met** or **missed** if the whole 95 % "
        "interval says so, otherwise **undecided**. Intervals of means and ratios are bootstrap over noise seeds (paired), "
        f"those of rates exact or bootstrap. They speak of the noise, not of other places or other skins.\n\n{_goals(key)}\n\n## "
        "How it was done\n\nData come from two models of a touched sheet on meshes unlike the estimator's (docs/reproduce.md): "
        "discs of raised conductivity with point electrodes, and the contact-layer twin. Noise is white, of one standard "
        f"deviation for all: so many decibels below the largest voltage of the paper's base scan (12B), at {1e3 * CURRENT:g} mA "
        f"in every injection. The untouched reference is free of noise. Estimators expect a contact radius of {1e3 * RADIUS:g} "
        "mm, which neither world has.\n\n"
        + _table(("data", "contact", "largest 12B voltage", "noise"), data)
        + "\n\n"
        + _table(
            ("mode", "what it drives"), [*TITLES.items(), ("16T", "a few injections per frame, up to two exploring; tracking")]
        )
        + "\n\n*Centroid*: the paper's way, the part of the image (eq. 5, one-step Gauss-Newton) about its peak above half of it. "
        "*Fit*: "
        "the strongest contact that explains the data significantly; where none does, the middle of the sheet is taken for it, "
        "as for an image without a peak."
    )


def _goals(goals: Sequence[Goal]) -> str:
    if not goals:
        return ""
    rows = [(g.text, g.bound, g.found, f"**{g.verdict}**", g.margin, g.data, g.note) for g in goals]
    return _table(("goal", "asked", "measured (95 %)", "verdict", "off the bound by", "from", "note"), rows)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _mm(values: Floats, digits: int = 2) -> str:
    """Mean of values (n_seeds,) with its interval in millimetres."""
    m = mean(1e3 * values)
    return f"{m.value:.{digits}f} ({m.low:.{digits}f} to {m.high:.{digits}f})"


def _static(done: Comparison) -> str:
    parts = []
    for name, result in done.results["static"].items():
        world, decibels = name.split("/")
        task = cast(Static, done.experiments["static"][name])
        away, means = errors(result["estimate"], result["truth"]), static_errors(result)
        rows = []
        for s, key in enumerate(task.schemes):
            for e, estimator in enumerate(task.estimators):
                found = np.isfinite(result["estimate"][s, e, ..., 0])
                rows.append(
                    (
                        key.partition("/")[0],
                        str(result["injections"][s]),
                        estimator,
                        _mm(means[s, e]),
                        f"{1e3 * np.median(away[s, e]):.2f}",
                        f"{1e3 * np.quantile(away[s, e], 0.95):.1f}",
                        f"{100 * np.mean(away[s, e] > _MISS):.1f} %",
                        f"{100 * np.mean(~found):.1f} %",
                        f"{1e3 * result['bound'][s].mean():.2f}" if world == "discs" else "",
                    )
                )
        head = (
            "mode",
            "injections",
            "estimator",
            "mean error / mm (95 %)",
            "median / mm",
            "95 % below / mm",
            f"off by over {1e3 * _MISS:.0f} mm",
            "nothing found",
            "position bound / mm",
        )
        parts.append(f"### {NAMES[world].capitalize()}, {decibels} dB\n\n{_two_by_two(task, means)}\n\n{_table(head, rows)}")
    return "\n\n".join(parts)


def _two_by_two(task: Static, means: Floats) -> str:
    """Mean errors with 28 injections by who chooses and who estimates: what the pattern gains and what the estimator does."""
    rows = []
    for key, label in (("16O", "the paper's pattern"), ("16P", "by position information")):
        cells = [means[task.schemes.index(key), task.estimators.index(name)] for name in ("centroid", "fit")]
        rows.append((f"{label}, 28 injections", *(f"{_mm(cell)} mm" for cell in cells)))
    return _table(("", "centroid", "fit"), rows)


def _time(done: Comparison) -> str:
    skin = Skin.load(worlds.LAYOUTS["grid"])
    one = next(complete_pattern(skin.electrodes).split(1))
    rows = []
    for instrument in INSTRUMENTS:
        task, result = cast(Static, done.experiments["time"][instrument]), done.results["time"][instrument]
        means, cost = static_errors(result), instrument_cost(instrument, skin)
        for s, key in enumerate(task.schemes):
            rows.append((instrument, key, str(result["injections"][s]), *(_mm(means[s, e]) for e in range(len(task.estimators)))))
        rows.append((instrument, f"one injection takes {1e6 * cost.time(one):.0f} µs", "", "", ""))
    text = (
        "All schemes have the time that the paper's takes for its 28 injections: instruments with the times of the paper's skin "
        "that convert all voltages of an injection at once (parallel) or one by one (multiplexed; 12B measures 9 voltages of an "
        "injection, the others 13). Fixed patterns are driven over and over. Discs, "
        f"{cast(Static, done.experiments['time'][INSTRUMENTS[0]]).decibels:g} dB."
    )
    head = ("instrument", "mode", "injections", "centroid: mean error / mm (95 %)", "fit: mean error / mm (95 %)")
    return f"{text}\n\n{_table(head, rows)}"


def _moving(done: Comparison) -> str:
    rows = []
    for world, result in done.results["moving"].items():
        task = cast(Moving, done.experiments["moving"][world])
        framewise, tracked = moving_errors(result)
        for s, key in enumerate(task.schemes):
            for e, estimator in enumerate(task.estimators):
                rows.append((NAMES[world], key.partition("/")[0], "16", estimator, _mm(framewise[s, e]), "", ""))
        for t, count in enumerate(task.followers):
            claimed = 1e3 * np.sqrt(np.nanmean(result["std"][t, :, SETTLE:] ** 2))
            away = errors(result["tracked"][t], result["truth"])[:, SETTLE:]
            square = 1e3 * np.sqrt(np.mean(away**2))
            others = 100 * np.mean(result["count"][t, :, SETTLE:] != 1)
            claims = f"{claimed:.2f} claimed, {square:.2f} found"
            rows.append((NAMES[world], "16T", str(count), "tracking", _mm(tracked[t]), claims, f"{others:.1f} %"))
    text = (
        f"A frame is {1e3 * PERIOD:g} ms, within which the contact rests. The tracker states how sure it is: the root of the "
        "mean square of its stated error is set beside that of the true one."
    )
    head = (
        "data",
        "mode",
        "injections",
        "estimator",
        "mean error / mm (95 %)",
        "root mean square / mm",
        "frames with none or several",
    )
    return f"{text}\n\n{_table(head, rows)}"


def _pairs(done: Comparison) -> str:
    rows = []
    for name, result in done.results["pairs"].items():
        what, _, where = name.partition("/")
        if what != "told":
            continue
        task, limits = cast(Pairs, done.experiments["pairs"][name]), done.results["pairs"][f"limit/{where}"]
        bounds = cast(PairLimits, done.experiments["pairs"][f"limit/{where}"])
        told, false = pair_rates(result)
        for s, key in enumerate(task.schemes):
            ideal = ideal_power(limits["distance"][bounds.schemes.index(key)])
            own, own_false = (result["counted"][s] == 2) & result["near"][s], result["counted_single"][s] > 1
            rows.append((f"+{100 * task.strength:g} %, {task.decibels:g} dB", key, "test", *_rates(told[s]), _share(false[s])))
            rows.append(("", "", "fit's own count", *_rates(own), _share(own_false)))
            rows.append(("", "", "ideal test", *(f"{100 * each.mean():.0f}" for each in ideal), "1 %"))
        worst = ideal_power(limits["any"])
        rows.append(("", f"any {bounds.count}", "ideal test, at most", *(f"{100 * each.mean():.0f}" for each in worst), "1 %"))
        complete = ideal_power(limits["all"])
        rows.append(("", "all 120", "ideal test", *(f"{100 * each.mean():.0f}" for each in complete), "1 %"))
    text = (
        "Share of pairs told apart in per cent, by distance; a pair counts if both contacts are also placed closer to their own "
        "true place than half their distance. The test compares two fitted discs with one fitted disc; its threshold comes from "
        "single contacts, of the size of one of the two or with the area of both. *Fit's own count* is what the product does by "
        "itself. The ideal test is Neyman and Pearson's between the pair and the single disc, of any place, size and strength, "
        "that looks most like it, both known in every number: no test that takes each single disc for two in at most 1 % of "
        "cases does better. It is given for the injections driven, for every choice of 28 different ones (an upper bound), and "
        "for all 120; contacts act linearly in it. No contact lies closer than 11 mm to an electrode: a disc over a point "
        "electrode, whose field is singular, looks like nothing else, and one such single contact would set the threshold for "
        "all."
    )
    distances = cast(Pairs, done.experiments["pairs"][next(n for n in done.results["pairs"] if n.startswith("told/"))]).distances
    head = ("discs", "mode", "decided by", *(f"{1e3 * d:g} mm" for d in distances), "false twos")
    return f"{text}\n\n{_table(head, rows)}"


def _rates(told: Floats) -> list[str]:
    return [f"{100 * row.mean():.0f}" for row in told]


def _share(false: Floats) -> str:
    return f"{100 * np.mean(false):.2g} %"


def _detection(done: Comparison) -> str:
    rows = []
    for name, result in done.results["detection"].items():
        task, frames = cast(Detection, done.experiments["detection"][name]), result["frames"]
        late = [f"{100 * np.mean(frames <= k):.1f} %" for k in (1, WITHIN, 5, 10)]
        found = np.isfinite(frames)
        rows.append(
            (
                NAMES[task.world],
                str(task.others),
                *late,
                f"{1e3 * np.mean(result['error'][found]):.1f}" if found.any() else "",
                f"{100 * np.mean(result['ready']):.1f} %",
                f"{100 * np.mean(result['ghosts'] > 0):.1f} %",
            )
        )
    head = (
        "data",
        "others followed",
        "found in the 1st frame",
        f"within {WITHIN}",
        "within 5",
        "within 10",
        "error then / mm",
        "all others were known",
        "one too many was reported before",
    )
    return _table(head, rows)


def _robust(done: Comparison) -> str:
    table = robust_errors(done)
    ways = list(next(iter(table.values())))
    rows = [(name, *(_mm(cells[way]) for way in ways)) for name, cells in table.items()]
    text = (
        "What the estimator believes is wrong, one thing at a time and together: the electrodes' contact impedance is three "
        "times as high as usual, throughout or only since the calibration; each electrode is 2 mm (1 % of the side) from where "
        "it is believed to be, in a random direction; the believed conductivity is uneven by 5 % (a smooth random field; a "
        "common factor is calibrated away). Policies choose by the wrong model, too. Mean errors in mm (95 %):"
    )
    return f"{text}\n\n{_table(('flaw', *(f'{key}, {estimator}' for key, estimator in ways)), rows)}"


def _cost(done: Comparison) -> str:
    result = done.results["cost"]["tracker"]
    rows = []
    for n, (choose, update) in enumerate(zip(result["choose"], result["update"], strict=True)):
        share = np.median(choose / (choose + update))
        rows.append((str(n), f"{1e6 * np.median(choose):.0f}", f"{1e6 * np.median(update):.0f}", f"{100 * share:.1f} %"))
    return "Processor time on the machine of this run, medians.\n\n" + _table(
        ("contacts", "choosing / µs", "updating / µs", "share of choosing"), rows
    )
