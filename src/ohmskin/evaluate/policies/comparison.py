"""Policies compared at equal noise and equal time, as a study, and its report."""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

import ohmskin
from ohmskin.arrays import Floats
from ohmskin.drive import complete_pattern
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.policies import goals, robustness
from ohmskin.evaluate.policies.figures import PAINTERS
from ohmskin.evaluate.policies.goals import WITHIN, Done
from ohmskin.evaluate.policies.pairs import ideal_power
from ohmskin.evaluate.policies.plan import Settings, plan
from ohmskin.evaluate.policies.presses import FOOT, KNOWN, LAYERS, WRONG
from ohmskin.evaluate.policies.schemes import NAMES, SCHEMES, instrument_cost
from ohmskin.evaluate.policies.tracked import MISS, SETTLE, moving_errors
from ohmskin.evaluate.setup import PERIOD, QUIET
from ohmskin.evaluate.statistics import mean
from ohmskin.evaluate.study import Study
from ohmskin.evaluate.verdict import MET, MISSED, OPEN, Goal
from ohmskin.evaluate.worlds import CURRENT, LAYOUTS, described
from ohmskin.plot.report import Block, ReportImage, ReportPicture, Section, Table
from ohmskin.skin import Skin

_TESTS = "ideal test", "ideal test, contacts uncertain"
_ERROR = "mean error / mm (95 %)"


def sections(done: Done, found: Sequence[Goal], pictures: Mapping[str, Sequence[ReportPicture]]) -> list[Section]:
    """The report: the goals, how it was done, and a section for each group of experiments."""
    report = _introduction(done, [goal for goal in found if goal.key])
    for section in done.results:
        title, tables = SECTIONS[section]
        shown = [ReportImage(title, picture) for picture in pictures[section]]
        report.append(Section(title, [*shown, *tables(done), *_goals([g for g in found if g.section == section])]))
    return report


def _introduction(done: Done, key: Sequence[Goal]) -> list[Section]:
    tally = ", ".join(f"{sum(g.verdict == v for g in key)} {v}" for v in (MET, MISSED, OPEN))
    what = (
        "What to measure next: fixed patterns, the best fixed set among them; the paper's scheme (16O fused: a base "
        "scan, then pairs by eq. 7, both used); choice by position information (16P); and tracking with a few "
        "injections per frame (16T), on virtual skins, with the same absolute noise for all. The sensors are those of "
        "the loop, made by name. Each choice of injections is held against the best fixed set of as many, with "
        "the same reader."
    )
    rule = (
        f"Of {len(key)} goal{'s' * (len(key) != 1)}: {tally}. "
        "A goal is **met** or **missed** if the whole 95 % interval says so, otherwise **undecided**. "
        "Intervals of means and ratios are bootstrap over noise seeds and places (paired), those of rates exact or "
        "bootstrap. They cover noise and places, not other skins."
    )
    radius = 1.5 * Skin.load(LAYOUTS["grid"]).imaging.mesh_size
    data = (
        "Data come from two models of a touched sheet on meshes unlike the estimator's (docs/reproduce.md): discs of "
        "raised conductivity with point electrodes, and the contact-layer twin. Noise is white, of one standard "
        "deviation for all, given in decibels below the largest voltage of the paper's base scan (12B), at "
        f"{1e3 * CURRENT:g} mA in every injection. The untouched reference is a mean of {QUIET} scans with that noise. "
        f"Fits expect contacts of about {1e3 * radius:.2g} mm radius; the twin's have 8 mm, the discs 10 mm."
    )
    readers = (
        "*Centroid*: that of the strongest region of the image (eq. 5, one-step Gauss-Newton) above the threshold "
        "gamma_0, which is learned from quiet scans. *Fit*: the strongest contact that explains the data "
        "significantly. Where a reader shows no contact, the middle of the sheet is used instead."
    )
    version = f"ohmskin {ohmskin.__version__}. Written by `ohmskin policies`"
    version = f"{version}; every number and verdict is computed from data."
    worlds = Table(("data", "contact", "largest 12B voltage", "noise"), described(done.settings.levels))
    modes = Table(("mode", "drive"), [(key, title) for key, (title, *_) in SCHEMES.items()])
    how = Section("How it was done", [data, worlds, modes, readers])
    return [Section("Policies compared", [version, what], "#"), Section("Goals", [rule, *_goals(key)]), how]


def _goals(goals: Sequence[Goal]) -> list[Block]:
    rows = [(g.text, g.bound, g.found, g.verdict, g.margin, g.data, g.note) for g in goals]
    head = ("goal", "required", "measured (95 %)", "verdict", "against the requirement", "from", "note")
    return [Table(head, rows)] if rows else []


def _mm(values: Floats) -> str:
    """Mean of values in metres with its interval, in millimetres; see `mean`."""
    m = mean(1e3 * values)
    return f"{m.value:.2f} ({m.low:.2f} to {m.high:.2f})"


def _percent(share: ArrayLike) -> str:
    return f"{100 * np.mean(np.asarray(share, float)):.1f} %"


def _static(done: Done) -> list[Block]:
    blocks: list[Block] = []
    head = ("mode", "injections", "estimator", _ERROR, "median / mm", "95 % below / mm")
    ends = (f"off by over {1e3 * MISS:.0f} mm", "nothing found", "position bound / mm")
    for name, task, result in done.of("static"):
        away, rows, each = errors(result), [], []
        for s, key in enumerate(task.schemes):
            bound = f"{1e3 * result['bound'][s].mean():.2f}" if task.world == "discs" else ""
            for e, reader in enumerate(task.readers):
                off, lost = away[s, e], ~np.isfinite(result["estimate"][s, e, ..., 0])
                row = (key.partition("/")[0], str(result["injections"][s]), reader, _mm(off))
                typical = (f"{1e3 * np.median(off):.2f}", f"{1e3 * np.quantile(off, 0.95):.1f}")
                rows.append((*row, *typical, _percent(off > MISS), _percent(lost), bound))
        labels = {"best": "best fixed set", "16O fused": "the paper's pattern", "16P": "by position information"}
        for key, label in labels.items():
            cells = [away[task.schemes.index(key), task.readers.index(reader)] for reader in ("centroid", "fit")]
            each.append((f"{label}, 28 injections", *(f"{_mm(cell)} mm" for cell in cells)))
        title = f"### {NAMES[task.world].capitalize()}, {name.split('/')[1]} dB"
        blocks += [title, Table(("", "centroid", "fit"), each), Table((*head, *ends), rows)]
    return blocks


def _driven(done: Done) -> list[Block]:
    rows = []
    for world, decibels, flaw, task, result in goals.driven_groups(done):
        for (s, key), (e, reader) in product(enumerate(task.schemes), enumerate(task.readers)):
            off = errors(result)[s, e]
            open_places, corners = off[:, : -task.corners], off[:, -task.corners :]
            row = (NAMES[world], f"{decibels:g}", flaw, key, reader, _mm(open_places), _mm(corners), _mm(off))
            inside = (_percent(result["nees"][s, e] < chi2.ppf(share, 2)) for share in (0.5, 0.9))
            squares = (result["stated"][s, e] ** 2, off**2)
            stated, true = (f"{1e3 * np.sqrt(np.nanmean(each)):.2f}" for each in squares)
            rows.append((*row, _percent(off > MISS), " / ".join(inside), f"{stated} / {true}"))
    text = (
        "*Driven*: source and sink of each injection are measured, too. Contact impedances are uncertain; "
        "those that differ do so since the calibration. *Self-calibrated*: places of electrodes and conductivity are "
        "estimated from the quiet scans. Discs have point electrodes, without contact impedance. "
        f"{task.corners} places lie in the corners, 10 to 18 mm from both sides. Mean errors in mm (95 %); how "
        "often the true place is within the 50 and 90 % ellipse; the root mean square of the error, stated and true, "
        "in mm:"
    )
    head = ("data", "dB", "flaw", "mode", "reader", "open places", "corners", "all", f"off by over {1e3 * MISS:.0f} mm")
    return [text, Table((*head, "within the 50 / 90 % ellipse", "stated / true"), rows)]


def _time(done: Done) -> list[Block]:
    skin, rows = Skin.load(LAYOUTS["grid"]), []
    one = next(complete_pattern(skin.electrodes).split(1))
    for instrument, task, result in done.of("time"):
        for key, count, away in zip(task.schemes, result["injections"], errors(result), strict=True):
            rows.append((instrument, key, str(count), *map(_mm, away)))
        taken = 1e6 * instrument_cost(instrument, skin).time(one)
        rows.append((instrument, f"one injection takes {taken:.0f} µs", "", "", ""))
    text = (
        "All schemes have the time that the paper's takes for its 28 injections: instruments with the times of the "
        "paper's skin that convert all voltages of an injection at once (parallel) or one by one (multiplexed; 12B "
        "measures 9 voltages of an injection, the others 13). Fixed patterns are repeated. Discs, "
        f"{task.decibels:g} dB."
    )
    head = ("instrument", "mode", "injections", *(f"{reader}: {_ERROR}" for reader in task.readers))
    return [text, Table(head, rows)]


def _moving(done: Done) -> list[Block]:
    rows = []
    for world, task, result in done.of("moving"):
        framewise, tracked = moving_errors(result)
        for s, key in enumerate(task.schemes):
            for e, reader in enumerate(task.readers):
                rows.append((NAMES[world], key.partition("/")[0], "16", reader, _mm(framewise[s, e]), "", ""))
        for t, key in enumerate(task.trackers):
            claimed = 1e3 * np.sqrt(np.nanmean(result["std"][t, :, SETTLE:] ** 2))
            square = 1e3 * np.sqrt(np.mean(errors(result, "tracked")[t, :, SETTLE:] ** 2))
            claims = f"{claimed:.2f} stated, {square:.2f} true"
            others = _percent(result["count"][t, :, SETTLE:] != 1)
            rows.append((NAMES[world], *key.split("/"), "tracking", _mm(tracked[t]), claims, others))
    text = (
        f"A frame is {1e3 * PERIOD:g} ms, within which the contact rests. The root mean square of the "
        "tracker's stated error is given with that of the true one."
    )
    head = ("data", "mode", "injections", "estimator", _ERROR, "root mean square / mm", "frames with none or several")
    return [text, Table(head, rows)]


def _pairs(done: Done) -> list[Block]:
    rows = []
    for _, task, result, limits, power in goals.pair_groups(done):
        for s, key in enumerate(task.schemes):
            where = f"+{100 * task.strength:g} %, {task.decibels:g} dB"
            false = f"{100 * np.mean(result['counted'][s] > 1):.2g} %"
            rows.append((where, key, "fit", result["right"][s], false))
            rows += [("", "", test, rates[s], "1 %") for test, rates in zip(_TESTS, power, strict=True)]
        rows.append(("", "any 28", "ideal test, at most", ideal_power(limits["any"]), "1 %"))
        rows.append(("", "all 120", "ideal test", ideal_power(limits["all"]), "1 %"))
    text = (
        "Share of pairs distinguished in per cent, by distance; a pair counts if both contacts are also placed closer "
        "to their own true place than half their distance. *Fit*: what the product counts and places by itself "
        "(`ContactFitter.split`). The ideal test is Neyman and "
        "Pearson's between the pair and the single disc, of any place, size and strength, that resembles it most, "
        "all parameters of both known: no test that reports at most 1 % of single discs as two is better. "
        "It is given for the injections driven, contact impedances known or, as the fit allows for, changed by 20 % "
        "since the calibration; for every choice of 28 different ones (an upper bound), and for all "
        "120; contacts act linearly in it. Electrodes that carry the current are measured, too. No contact lies "
        "closer than 11 mm to an electrode: a disc over a point "
        "electrode, whose field is singular, resembles nothing else."
    )
    head = ("discs", "mode", "decided by", *(f"{1e3 * d:g} mm" for d in task.distances), "false twos")
    cells = [(*row, *(f"{100 * rate.mean():.0f}" for rate in rates), false) for *row, rates, false in rows]
    return [text, Table(head, cells)]


def _press(done: Done) -> list[Block]:
    felt, rows = [], []
    for name, task, result in done.of("press", "felt/"):
        for key, counted, away in zip(task.schemes, result["counted"], result["away"], strict=True):
            size = f"{name.partition('/')[2]}: {1e3 * task.radius:g} mm, {task.pressure / 1e3:g} kPa"
            shares = (_percent(counted == 0), _percent(counted == 1), _percent(counted > 1))
            felt.append((size, key, *shares, f"{1e3 * np.nanmedian(away):.2f}" if np.isfinite(away).any() else ""))
    off, sure = goals.forces(done)
    tasks = [task for _, task, _ in done.of("press", "force/")]
    for n, frames in enumerate((1, tasks[0].frames)):
        for f, layer in enumerate(LAYERS):
            if np.isfinite(off[n, f]).any():
                each = (f"{100 * np.median(np.nan_to_num(np.abs(one), nan=np.inf)):.0f}" for one in off[n, f])
                lost = np.nan_to_num(np.abs(off[n, f]), nan=np.inf)  # presses not felt at all
                whole = (f"{100 * np.median(lost):.0f}", _percent(np.abs(sure[n, f]) < 1))
                rows.append((layer, str(frames), *each, *whole))
    layers = np.array([result["layer"] for _, _, result in done.of("press", "force/")])
    text = (
        "Below, place, radius and pressure of a press of 8 mm on the twin are fitted together (`PressFitter`), on a "
        "mesh that the twin does not have; force is the integral of the pressure. Errors in per cent, medians, by "
        "pressure; and how often the true force is within one standard deviation of what is stated (68 % if that is "
        "right). "
        f"*Described wrongly*: with {WRONG[0]:g} times the layer's conductance and an exponent {-WRONG[1]:g} too "
        "small. "
        f"Ten known presses of a foot of {1e3 * FOOT:g} mm, {KNOWN[0] / 1e3:g} to {KNOWN[-1] / 1e3:g} kPa, gave "
        f"{layers[:, 0].min():.2f} to {layers[:, 0].max():.2f} times the true conductance and exponents of "
        f"{layers[:, 1].min():.2f} to {layers[:, 1].max():.2f}, by draw."
    )
    ends = tuple(f"{pressure / 1e3:g} kPa" for pressure in tasks[0].pressures)
    return [
        "Fits with driven electrodes measured.",
        Table(("press", "mode", "nothing detected", "one contact", "several", "median error / mm"), felt),
        text,
        Table(("layer", "frames", *ends, "all", "within one deviation"), rows),
    ]


def _detection(done: Done) -> list[Block]:
    rows = []
    for _, task, result in done.of("detection"):
        frames, found = result["frames"], np.isfinite(result["frames"])
        late = [_percent(frames <= k) for k in (1, WITHIN, 5, 10)]
        away = f"{1e3 * np.mean(result['error'][found]):.1f}" if found.any() else ""
        ends = (away, _percent(result["ready"]), _percent(result["ghosts"] > 0))
        rows.append((NAMES[task.world], str(task.others), *late, *ends))
    head = ("data", "others tracked", "found in the 1st frame", f"within {WITHIN}", "within 5", "within 10")
    ends = ("error then / mm", "all others were tracked", "a false contact was reported before")
    return [Table((*head, *ends), rows)]


def _robust(done: Done) -> list[Block]:
    table = goals.robust_errors(done)
    ways = list(next(iter(table.values())))
    rows = [(name, *(_mm(cells[way]) for way in ways)) for name, cells in table.items()]
    text = (
        "The estimator's assumptions are wrong, one at a time and together: the electrodes' contact impedance is "
        "three times as high as usual, throughout or only since the calibration; each electrode is 2 mm (1 % of the "
        "side) from its assumed place, in a random direction; the assumed conductivity is uneven by 5 % (a "
        "smooth random field; a common factor is calibrated away). Policies choose with the wrong model, too. Mean "
        "errors in mm (95 %):"
    )
    return [text, Table(("flaw", *(f"{key}, {reader}" for key, reader in ways)), rows)]


def _cost(done: Done) -> list[Block]:
    ((_, _, result),) = done.of("cost")
    rows = []
    for n, (choose, update) in enumerate(zip(result["choose"], result["update"], strict=True)):
        times = [f"{1e6 * np.median(values):.0f}" for values in (choose, update)]
        rows.append((str(n), *times, _percent(np.median(choose / (choose + update)))))
    head = ("contacts", "choosing / µs", "updating / µs", "share of choosing")
    return ["Processor time on the machine of this run, medians.", Table(head, rows)]


SECTIONS = {
    "static": ("Contacts at rest", _static),
    "driven": ("Driven electrodes, and the corners", _driven),
    "time": ("The same in equal time", _time),
    "gain": ("When adaptive drive gains", lambda done: []),
    "moving": ("Moving contacts", _moving),
    "pairs": ("Two contacts or one", _pairs),
    "press": ("Light presses, hard presses, and force", _press),
    "sensitivity": ("The lightest touch", robustness.sensitivity_tables),
    "detection": ("New contacts", _detection),
    "quiet": ("False contacts in quiet frames", lambda done: []),
    "trouble": ("Faults and interference", robustness.trouble_tables),
    "robust": ("With a flawed model, or a worn skin", _robust),
    "cost": ("What choosing costs", _cost),
}
REPORTS = "report.html", "report.md"
POLICIES = Study(Settings, plan, goals.assess, PAINTERS, sections, REPORTS, "goals", 160, ("cost",), Goal.record)
compare = POLICIES.run
