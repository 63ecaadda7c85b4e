"""Sections of the report: faults, when adaptive drive gains, the lightest touch. Goals, tables and pictures."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ohmskin.arrays import Bools, Floats
from ohmskin.evaluate.figures.drawing import Drawn, draw_estimates, draw_sheet, panels
from ohmskin.evaluate.policies.adaptivity import WAYS
from ohmskin.evaluate.policies.interference import MODES, NONE, WIRE
from ohmskin.evaluate.policies.schemes import NAMES
from ohmskin.evaluate.policies.tracked import moving_errors
from ohmskin.evaluate.result import Outcome, Result
from ohmskin.evaluate.statistics import ConfidenceInterval, mean, median, ratio_of_means
from ohmskin.evaluate.verdict import Goal
from ohmskin.plot.colours import AMOUNT
from ohmskin.plot.report import Block, Table

FALSE, SOON, GONE = 5, 1.0, 3  # frames with a false contact, s, and frames that a fault, its name and a lift may take
LIGHT = 850.0  # Pa, of a light press
ROUNDS = "rotating/4", "rotating best/4"
_COLOURS = {"discs": "#0072b2", "pressed": "#d55e00"}


# --- faults and interference ------------------------------------------------------------------------------------------


def troubles(done: Outcome[Any]) -> dict[tuple[str, str], Result]:
    """Results by mode and trouble, those of all seeds, and of all electrodes, beside each other."""
    found: dict[tuple[str, str], list[Result]] = {}
    for _, task, result in done.of("trouble", "troubled/"):
        for k, trouble in enumerate(task.troubles):
            what = "an electrode opens" if trouble.startswith(WIRE) else trouble
            found.setdefault((task.mode, what), []).append({name: values[k : k + 1] for name, values in result.items()})
    return {key: {name: np.concatenate([r[name] for r in all_]) for name in all_[0]} for key, all_ in found.items()}


def trouble_goals(done: Outcome[Any]) -> Iterator[Goal]:
    """No false contacts, reported at once, as accurate as before, and recovered afterwards."""
    frames = {trouble: task.frames for _, task, _ in done.of("trouble", "troubled/") for trouble in task.troubles}
    for (mode, trouble), result in troubles(done).items():
        cases, wire = len(result["false"]), trouble == "an electrode opens"
        data = f"{cases} cases, {result['sound'].size} presses and slides"
        if trouble != NONE:
            most = ConfidenceInterval(*[float(result["false"].max())] * 3)
            text = f"Frames with a false contact in {mode}, the worst case: {trouble}"
            quiet = next(count for name, count in frames.items() if name == trouble or (wire and name.startswith(WIRE)))
            yield Goal("trouble", text, FALSE if wire else 0, True, most, "", f"{cases} x {quiet} frames", key=True)
            told = _exactly(result["named"] <= SOON)
            yield Goal("trouble", f"Reported within {SOON:g} s by {mode}: {trouble}", 1.0, False, told, "%", data)
        if wire:
            well = _exactly(result["well"] <= SOON)
            text = f"Recovered within {SOON:g} s of its end in {mode}: {trouble}"
            yield Goal("trouble", text, 1.0, False, well, "%", data)
            ours, theirs = (np.nan_to_num(result[name].ravel(), posinf=np.inf) for name in ("away", "sound"))
            ratio = median(ours / theirs)
            text = f"Error of a press in {mode} over that before, median: {trouble}"
            note = f"{np.isinf(ours).sum()} of {ours.size} presses not shown as one contact"
            note = f"{note}, {np.isinf(theirs).sum()} before"
            yield Goal("trouble", text, 1.5, True, ratio, "ratio", data, note)
        if wire or trouble == NONE:
            gone = _exactly(result["gone"] <= GONE)
            after = " after a fault that ended" if wire else ""
            text = f"Nothing is left {GONE} frames after a slide in {mode}{after}"
            yield Goal("trouble", text, 1.0, False, gone, "%", data)
    for mode in MODES:
        runs = [result for _, _, result in done.of("trouble", f"drifting/{mode}/")]
        if runs:
            right = _exactly(np.array([not (run["ghosts"][1] or run["lost"][1]) for run in runs]))
            task = next(task for _, task, _ in done.of("trouble", f"drifting/{mode}/"))
            text = f"No contact false or lost in {mode}, pairs drifting by {task.times:g} times the noise a minute"
            yield Goal("trouble", text, 1.0, False, right, "%", f"{len(runs)} seeds")
            without, within = np.array([run["away"] for run in runs]).T
            text = f"Error of a finger resting in that drift over that without, {mode}"
            yield Goal("trouble", text, 1.2, True, ratio_of_means(within, without), "ratio", f"{len(runs)} seeds")


def _exactly(right: Bools) -> ConfidenceInterval:
    """The share of cases that are right; of these cases, all that were asked for: there is nothing to infer."""
    return ConfidenceInterval(*[float(right.mean())] * 3)


def trouble_tables(done: Outcome[Any]) -> list[Block]:
    """All that was measured, by mode and trouble."""

    def millimetres(values: Floats) -> str:
        lost = np.isinf(values).sum()
        return f"{1e3 * np.median(values):.2f}" + (f" ({lost} of {values.size} not shown as one)" if lost else "")

    rows = [
        (
            mode, trouble, f"{int(r['false'].max())}", f"{r['named'].max():.2f}" if trouble != NONE else "",
            f"{r['well'].max():.2f}", *(millimetres(r[name].ravel()) for name in ("sound", "away", "after")),
            f"{np.mean(r['gone'] <= GONE):.0%}",
        )
        for (mode, trouble), r in troubles(done).items()
    ]  # fmt: skip
    drifting = [
        (task.mode, str(task.seed), *(f"{result[name][k]:.0f}" for k in (0, 1) for name in ("ghosts", "lost")),
         *(f"{1e3 * result['away'][k]:.2f}" for k in (0, 1)))
        for _, task, result in done.of("trouble", "drifting/")
    ]  # fmt: skip
    text = (
        "The loop itself (`Engine`) on the paper's virtual skin with its own instrument, calibrated as a user's is. "
        "A fault begins while nothing touches the skin, presses of 8 mm and 20 kPa are made, and the fault ends. "
        "*False*: largest number of quiet frames with a contact; *reported*: the longest time until it is reported; "
        "*recovered*: the longest time from its end until no electrode is left out. Errors of presses are "
        "medians in mm; one counts as lost unless each of its frames shows exactly one contact."
    )
    head = ("mode", "fault", "false", "reported / s", "recovered / s", "before", "during", "after")
    drift = (
        "*Drift*: each two-terminal resistance drifts by itself for a minute; a finger comes after half of it, rests, "
        "and leaves at its end. Frames with more contacts than fingers, or fewer, and mean errors in mm, without the "
        "drift and with it:"
    )
    columns = ("false without", "lost without", "false", "lost", "error without", "error")
    return [
        text,
        Table((*head, f"slides gone in {GONE} frames"), rows),
        drift,
        Table(("mode", "seed", *columns), drifting),
    ]


# --- when adaptive drive gains ---------------------------------------------------------------------------------------


def best_round(task: Any, result: Result) -> tuple[Floats, Floats, str]:
    """Mean errors of paths (n_seeds,) tracked with chosen injections, with the better fixed round, and its name (m)."""
    each = dict(zip(task.trackers, moving_errors(result)[1], strict=True))
    best = min(ROUNDS, key=lambda key: float(each[key].mean()))
    return each["16T/4"], each[best], best.partition("/")[0]


def gain_goals(done: Outcome[Any]) -> Iterator[Goal]:
    """Chosen injections against fixed ones, at rest and in tracking."""
    for _, task, result in done.of("gain", "frames/"):
        ours, theirs = result["away"]
        ratio = ratio_of_means(ours, theirs)
        contacts = "one contact" if task.contacts == 1 else f"{task.contacts} contacts"
        where = f"({NAMES[task.world]}, {task.decibels:g} dB, {task.injections} injections, {contacts})"
        text = f"Driven electrodes measured, fit: mean error of 16P over that of the best fixed set {where}"
        note = f"{1e3 * ours.mean():.2f} mm against {1e3 * theirs.mean():.2f} mm; 95 % below "
        note += f"{1e3 * np.quantile(ours, 0.95):.1f} against {1e3 * np.quantile(theirs, 0.95):.1f} mm"
        asked = task.injections == 28 and task.contacts == 1 and task.decibels in (40.0, 50.0)
        data = f"{task.seeds} seeds, {task.where} places"
        yield Goal("gain", text, 0.8 if asked else 1.0, True, ratio, "ratio", data, note, asked)
    for _, task, result in done.of("gain", "tracking/"):
        ours, theirs, name = best_round(task, result)
        where = f"({NAMES[task.world]}, {task.decibels:g} dB)"
        text = f"Tracked with 4 injections a frame: mean error of 16T over that of the better fixed round {where}"
        note = f"{1e3 * ours.mean():.2f} mm against {1e3 * theirs.mean():.2f} mm ({name})"
        ratio, asked = ratio_of_means(ours, theirs), task.decibels in (40.0, 50.0)
        yield Goal("gain", text, 0.7 if asked else 1.0, True, ratio, "ratio", f"{task.seeds} paths", note, asked)


def gain_picture(done: Outcome[Any]) -> list[Drawn]:
    """The ratio over noise, injections, number of contacts, and in tracking."""
    level = done.settings.levels[0]
    usual = {"decibels": level, "injections": 28, "contacts": 1}
    labels = {"decibels": "noise / dB", "injections": "injections", "contacts": "contacts"}
    canvas, (grid,) = panels(2.5, 1, 4, "", "error over that of fixed injections", sharey=True)
    for world, colour in _COLOURS.items():
        style: Any = {"color": colour, "markersize": 4.5}
        frames = [
            (task, ratio_of_means(*r["away"])) for _, task, r in done.of("gain", "frames/") if task.world == world
        ]
        for axes, (name, label) in zip(grid, labels.items(), strict=False):
            others = [other for other in usual if other != name]
            same = [each for each in frames if all(getattr(each[0], other) == usual[other] for other in others)]
            cells = sorted(((getattr(task, name), ratio) for task, ratio in same), key=lambda cell: cell[0])
            if cells:
                x, estimates = zip(*cells, strict=True)
                draw_estimates(axes, list(x), list(estimates), "o-", label=NAMES[world], **style)
                axes.set_xticks(x)
            axes.set_xlabel(label)
        tracked = sorted(
            (task.decibels, ratio_of_means(*best_round(task, result)[:2]))
            for _, task, result in done.of("gain", f"tracking/{world}/")
        )
        if tracked:
            x, estimates = zip(*tracked, strict=True)
            draw_estimates(grid[3], list(x), list(estimates), "P-", **style)
            grid[3].set_xticks(x)
    grid[3].set_xlabel("noise / dB")
    titles = ["28 injections, one contact", f"{level:g} dB, one contact", f"{level:g} dB, 28 injections"]
    for axes, title in zip(grid, [*titles, "tracking, 4 a frame"], strict=True):
        axes.axhline(1, color="0.6", linewidth=0.6)
        axes.set_title(title)
        axes.grid(axis="y")
    grid[0].legend(frameon=False)
    caption = (
        "When adaptive drive gains: the mean error with chosen injections over that with fixed ones, same reader, with "
        "95 % bootstrap intervals over seeds and places; below 1 it gains. Left to right: over noise, injections a "
        "frame, and contacts (16P against the best fixed set of as many), and a moving contact tracked (16T against "
        "the better of two fixed rounds)."
    )
    return [("gain", canvas, caption)]


# --- the lightest touch -----------------------------------------------------------------------------------------------


def sensitivity_picture(done: Outcome[Any]) -> list[Drawn]:
    """Maps of the lightest press that is detected."""
    ((_, task, result),) = done.of("sensitivity")
    canvas = Figure(figsize=(7.4, 2.9), layout="constrained")
    maps = canvas.subplots(1, len(WAYS))
    half = 100 / (task.side + 1)
    seen = np.median(np.nan_to_num(result["least"], posinf=1e6), axis=1)
    low, high = float(seen.min()), float(np.quantile(seen, 0.99))
    style = {"origin": "lower", "extent": (half, 200 - half, half, 200 - half), "cmap": AMOUNT, "norm": "log"}
    for axes, (key, reading), values in zip(maps, WAYS, seen, strict=True):
        image = axes.imshow(values.reshape(task.side, task.side), clim=(low, high), **style)
        draw_sheet(axes, left=axes is maps[0])
        axes.set_title(f"{key}, {reading.partition(',')[0]}: median {np.median(values):.0f} Pa")
    canvas.colorbar(image, ax=list(maps), label="lightest press detected / Pa", shrink=0.9)
    caption = (
        f"The lightest press of {1e3 * task.radius:g} mm that is detected where it is, on the contact-layer twin at "
        f"{task.decibels:g} dB, median of {task.seeds} noise seeds, over the sheet."
    )
    return [("sensitivity", canvas, caption)]


def sensitivity_tables(done: Outcome[Any]) -> list[Block]:
    """Quantiles over seeds and places."""
    ((_, task, result),) = done.of("sensitivity")
    rows = []
    for (key, reading), least in zip(WAYS, result["least"], strict=True):
        each = (f"{np.quantile(least, q, method='nearest'):.0f}" for q in (0.5, 0.9, 1.0))
        rows.append((key, reading, *each, f"{np.mean(least <= LIGHT):.1%}"))
    head = ("mode", "reader", "median / Pa", "90 % below / Pa", "worst / Pa", f"detected at {LIGHT:g} Pa")
    text = f"Presses of {1e3 * task.radius:g} mm at {task.side**2} places, {task.seeds} seeds each; found within 12 mm."
    return [text, Table(head, rows)]


def sensitivity_goals(done: Outcome[Any]) -> Iterator[Goal]:
    """A light press is detected."""
    for _, task, result in done.of("sensitivity"):
        felt = (result["least"][-1] <= LIGHT).astype(float)
        text = f"A press of {1e3 * task.radius:g} mm and {LIGHT:g} Pa detected by 16P (twin, {task.decibels:g} dB)"
        yield Goal("sensitivity", text, 0.9, False, mean(felt), "%", f"{task.seeds} seeds, {task.side**2} places")
