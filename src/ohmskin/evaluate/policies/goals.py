"""The goals of the comparison, put into numbers: which data each one takes, and what it asks of them."""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.policies import robustness
from ohmskin.evaluate.policies.pairs import ALPHA, PairDiscrimination, ideal_power
from ohmskin.evaluate.policies.plan import OFF, POOR, TOLD, Settings
from ohmskin.evaluate.policies.robustness import best_round
from ohmskin.evaluate.policies.schemes import NAMES, scheme
from ohmskin.evaluate.policies.static import Static
from ohmskin.evaluate.policies.tracked import MISS, moving_errors
from ohmskin.evaluate.result import Outcome, Result
from ohmskin.evaluate.statistics import ConfidenceInterval, mean, median, ratio_of_means, share
from ohmskin.evaluate.verdict import Goal

QUIET = 100_000  # frames in which no contact is to be invented
WITHIN = 3  # frames in which a new contact is to be found
ASKED_PAIRS = {(50.0, 0.02): 0.75, (60.0, 0.012): 0.95}  # share of pairs at a noise level (dB) and distance (m)
OTHERS = ("nothing else is touched", "one other is tracked", "two others are tracked")
Done = Outcome[Settings]


def assess(done: Done) -> list[Goal]:
    """The goals that the results of `done` can decide."""
    goals = {
        "static": _static,
        "driven": _driven,
        "time": _time,
        "moving": _moving,
        "pairs": _pairs,
        "press": _press,
        "detection": _detection,
        "quiet": _quiet,
        "cost": _cost,
        "trouble": robustness.trouble_goals,
        "gain": robustness.gain_goals,
        "sensitivity": robustness.sensitivity_goals,
    }
    return [goal for section, find in goals.items() if section in done.results for goal in find(done)]


def static_errors(result: Result) -> Floats:
    """Mean error in a `result` over the places (n_schemes, n_readers, n_seeds) in metres."""
    return np.asarray(errors(result).mean(axis=-1))


def robust_errors(done: Done) -> dict[str, dict[tuple[str, str], Floats]]:
    """Errors in metres by flaw, and by scheme and reader: (n_seeds, n_places), or means of paths (n_seeds,)."""
    table: dict[str, dict[tuple[str, str], list[Floats]]] = {}
    for path, task, result in done.of("robust"):
        cells = table.setdefault(path.split("/")[1], {})
        if isinstance(task, Static):
            for (s, key), (e, reader) in product(enumerate(task.schemes), enumerate(task.readers)):
                cells.setdefault((key, reader), []).append(errors(result)[s, e])
        else:
            for key, means in zip(task.trackers, moving_errors(result)[1], strict=True):
                cells.setdefault((key, "moving"), []).append(means)
    return {name: {way: np.concatenate(values) for way, values in cells.items()} for name, cells in table.items()}


def pair_groups(done: Done) -> Iterator[tuple[str, PairDiscrimination, Result, Result, Floats]]:
    """Name, experiment, results and limits of each experiment with pairs, and the power of an ideal test (2, n_schemes,
    n_distances, n_where) with its injections: if contact impedances are known, and if not."""
    for name, task, result in done.of("pairs", "told/"):
        ((_, bounds, limits),) = done.of("pairs", name.replace("told/", "limit/"))
        rows = [bounds.schemes.index(key) for key in task.schemes]
        power = ideal_power(np.stack([limits[known][rows] for known in ("distance", "uncertain")]))
        yield name.removeprefix("told/"), task, result, limits, power


def _ratio(
    section: str, text: str, limit: float, ours: Floats, theirs: Floats, data: str, note: str, key: bool
) -> Goal:
    """The goal that one mean, over seeds or over seeds and places, is at most so many times another."""
    against = f"{1e3 * ours.mean():.2f} mm against {1e3 * theirs.mean():.2f} mm"
    ratio = ratio_of_means(ours, theirs)
    return Goal(section, text, limit, True, ratio, "ratio", data, note.replace("RATIO", against), key)


def _at_rest(
    section: str, text: str, limit: float, ran: Sequence[Any], *cells: tuple[str, str], key: bool, note: str = ""
) -> Goal:
    """The goal that the mean error of one scheme and reader is at most so many times that of another; its note says
    what means do not: medians, 95 % quantiles and misses of both."""
    task, result = ran
    each = [errors(result)[task.schemes.index(scheme), task.readers.index(reader)] for scheme, reader in cells]
    ours, theirs = (
        f"median {1e3 * np.median(away):.2f} mm, 95 % below {1e3 * np.quantile(away, 0.95):.1f} mm, "
        f"{100 * np.mean(away > MISS):.1f} % off by over {1e3 * MISS:.0f} mm"
        for away in each
    )
    data, note = f"{task.seeds} seeds, {len(result['truth'])} places", f"{note}RATIO; {ours}, against {theirs}"
    return _ratio(section, f"Static contact{text}", limit, each[0], each[1], data, note, key)


def _static(done: Done) -> Iterator[Goal]:
    paper = ("16O fused", "fit")
    for name, *ran in done.of("static"):
        (world, decibels), (task, result) = name.split("/"), ran
        where, main = f"({NAMES[world]}, {decibels} dB)", world == "discs" and task.decibels == done.settings.levels[0]
        for reader, (ours, theirs) in product(task.readers, (("16P", "best"), ("16P/16", "best/16"))):
            text = f", {scheme(ours).injections} injections chosen by position information, {reader}: mean error over"
            text, key = f"{text} that of the best fixed set {where}", main and reader == "fit"
            yield _at_rest("static", text, 1.0, ran, (ours, reader), (theirs, reader), key=key)
        text = f", 28 injections, fit: mean error of 16P over that of the paper's scheme {where}"
        yield _at_rest("static", text, 0.65, ran, ("16P", "fit"), paper, key=main)
        text = f", the paper's 28 injections: mean error of a fit over that of centroids {where}"
        yield _at_rest("static", text, 1.0, ran, paper, ("16O fused", "centroid"), key=False)
        if world == "discs":
            for other, limit, what in (("best", 1.0, "best fixed set"), ("16O fused", 0.6, "paper's scheme")):
                text = f"Position bound at 28 injections of 16P over that of the {what} ({decibels} dB)"
                note = "RATIO, mean over the places, of the patterns really driven"
                ours, theirs = (result["bound"][task.schemes.index(scheme)] for scheme in ("16P", other))
                data = f"{task.seeds} seeds, {len(result['truth'])} places"
                yield _ratio("static", text, limit, ours, theirs, data, note, main)


def driven_groups(done: Done) -> Iterator[tuple[str, float, str, Static, Result]]:
    """World, noise level, flaw, experiment and results, all draws of a flaw beside each other as seeds."""
    groups: dict[str, list[tuple[Static, Result]]] = {}
    for name, task, result in done.of("driven"):
        groups.setdefault(name.rpartition("/")[0], []).append((task, result))
    for name, ran in groups.items():
        world, decibels, flaw = name.split("/")
        merged = dict(ran[0][1])
        for key in ("estimate", "stated", "nees"):
            merged[key] = np.concatenate([result[key] for _, result in ran], axis=2)
        yield world, float(decibels), flaw, ran[0][0], merged


def _driven(done: Done) -> Iterator[Goal]:
    sound: dict[tuple[str, float], Floats] = {}
    for world, decibels, flaw, task, result in driven_groups(done):
        away, where = errors(result), f"{NAMES[world]}, {decibels:g} dB, flaw: {flaw}"
        seen = {key: away[task.schemes.index(key), task.readers.index("fit, driven")] for key in task.schemes}
        sound.setdefault((world, decibels), seen["16P"])
        data = f"{away.shape[2]} seeds, {len(result['truth'])} places, {task.corners} of them in the corners"
        asked = {
            ("discs", 40.0, "none"): (("16O fused", 1.6, False), ("16P", 1.3, False)),
            ("pressed", 50.0, "none"): (("16P", 1.1, False), ("16P", 1.0, True)),
            ("pressed", 50.0, "contact impedance x 1.2"): (("16P", 1.2, False),),
            ("pressed", 50.0, "contact impedance x 3"): (("16P", 2.0, False),),
        }
        for key, limit, corners in asked.get((world, decibels, flaw), ()):
            text = (
                f"Driven electrodes measured, fit: mean error of {key} in mm, {'corners' if corners else 'all places'}"
            )
            here = 1e3 * seen[key][:, -task.corners :] if corners else 1e3 * seen[key]
            yield Goal("driven", f"{text} ({where})", limit, True, mean(here), "mm", data)
        if flaw == "contact impedance x 1.2" or flaw in POOR:
            text = f"Driven electrodes measured, fit: mean error of 16P over that without them ({where})"
            without = away[task.schemes.index("16P"), task.readers.index("fit")]
            yield _ratio("driven", text, 1.05, seen["16P"], without, data, "RATIO", False)
        if flaw in (OFF, TOLD):
            text = f"Driven electrodes measured, fit: mean error of 16P over that on the sound skin ({where})"
            yield _ratio("driven", text, 1.1, seen["16P"], sound[world, decibels], data, "RATIO", flaw == TOLD)
        else:
            text = f"Driven electrodes measured, fit: mean error of 16P over that of the best fixed set of 28 ({where})"
            yield _ratio("driven", text, 1.0, seen["16P"], seen["best"], data, "RATIO", flaw == "none")


def _time(done: Done) -> Iterator[Goal]:
    for instrument, *ran in done.of("time"):
        note = f"{int(ran[1]['injections'][ran[0].schemes.index('16P')])} injections; "
        for other, limit, what in (("best", 1.0, "best fixed set"), ("16O fused", 0.65, "paper's scheme")):
            text = f" in the time of the paper's scheme on a {instrument} instrument, fit: mean error of 16P over that"
            cells = ("16P", "fit"), (other, "fit")
            yield _at_rest("time", f"{text} of the {what}", limit, ran, *cells, key=False, note=note)


def _moving(done: Done) -> Iterator[Goal]:
    for world, task, result in done.of("moving"):
        framewise, _ = moving_errors(result)
        ours, fixed, _ = best_round(task, result)
        where = f"({NAMES[world]}, {task.decibels:g} dB)"
        data = f"{task.seeds} seeds, each a path of {task.frames} frames"
        text = (
            "Moving contact, tracked with 4 injections a frame: mean error of 16T over that of the better fixed round"
        )
        yield _ratio("moving", f"{text} {where}", 1.0, ours, fixed, data, "RATIO", world == "discs")
        for e, reader in enumerate(task.readers):
            text = "Moving contact, 4 injections of a fixed round a frame, tracked: mean error over that of 16I with 16"
            theirs = framewise[task.schemes.index("16I"), e]
            yield _ratio("moving", f"{text}, {reader} {where}", 1.0, fixed, theirs, data, "RATIO", False)


def _pairs(done: Done) -> Iterator[Goal]:
    for _, task, result, limits, power in pair_groups(done):
        right = result["right"].astype(float)
        row, any_choice = task.schemes.index("16P"), ideal_power(limits["any"])
        where, key = f"+{100 * task.strength:g} %, {task.decibels:g} dB", task.strength == 0.5
        for d, distance in enumerate(task.distances):
            if asked := ASKED_PAIRS.get((task.decibels, distance)):
                text = f"Two contacts of 6 mm radius {1e3 * distance:g} mm apart counted and placed by 16P ({where})"
                data = f"{right.shape[3]} seeds at {right.shape[2]} places"
                known, unknown = (f"{100 * rate:.0f} %" for rate in power[:, row, d].mean(axis=1))
                note = f"an ideal test would reach {known} with these injections"
                note = f"{note}, {unknown} if contact impedances may have changed by 20 %"
                note = f"{note}, at most {100 * any_choice[d].mean():.0f} % with any 28"
                rate = mean(right[row, d].T)
                yield Goal("pairs", text, asked, False, rate, "%", data, note, key)
        text, false = f"One contact counted as two by 16P ({where})", result["counted"] > 1
        data = f"{false.shape[1]} single contacts"
        rate = share(int(false[row].sum()), false.shape[1])
        yield Goal("pairs", text, ALPHA, True, rate, "%", data, "", key)


def forces(done: Done) -> tuple[Floats, Floats]:
    """Errors of forces as shares of the true ones, and over what is stated (2, n_layers, n_pressures, n_where)."""
    results = [result for _, _, result in done.of("press", "force/")]
    true = results[0]["true"][:, None]
    force, std = (np.concatenate([result[name] for result in results], axis=-1) for name in ("force", "std"))
    return force / true - 1, (force - true) / std


def _press(done: Done) -> Iterator[Goal]:
    for name, task, result in done.of("press", "felt/"):
        one = (result["counted"][task.schemes.index("16P")] == 1).astype(float)
        size = f"{1e3 * task.radius:g} mm, {task.pressure / 1e3:g} kPa"
        text = f"A {name.partition('/')[2]} press ({size}) detected as one contact by 16P (twin, {task.decibels:g} dB)"
        data = f"{task.seeds} seeds at {task.where} places"
        yield Goal("press", text, 0.9, False, mean(one.T), "%", data, "", True)
    off, _ = forces(done)
    tasks = [task for _, task, _ in done.of("press", "force/")]
    pressures = (
        f"{tasks[0].pressures[0] / 1e3:g} to {tasks[0].pressures[-1] / 1e3:g} kPa, twin, {tasks[0].decibels:g} dB"
    )
    frames = f"{tasks[0].frames} frames of 16P"
    data = f"{off[0, 0].size} presses, {len(tasks)} sets of known ones"
    for layer, limit, number in (("as it is", 0.15, 0), ("after ten known presses", 0.1, 2)):
        text = f"Force of a press, median error, layer {layer} ({frames}; {pressures})"
        alone = np.median(np.nan_to_num(np.abs(off[0, 0]), nan=np.inf))
        note = f"one frame alone {100 * alone:.0f} %" if number == 0 else ""
        yield Goal("press", text, limit, True, median(np.abs(off[1, number]).ravel()), "%", data, note, True)


def _detection(done: Done) -> Iterator[Goal]:
    for _, task, result in done.of("detection"):
        frames, away = result["frames"], result["error"]
        text = f"New contact found within {WITHIN} frames of {task.injections} injections while {OTHERS[task.others]}"
        text = f"{text} ({NAMES[task.world]}, {task.decibels:g} dB)"
        note = f"within 5 frames {100 * np.mean(frames <= 5):.1f} %, 10 frames {100 * np.mean(frames <= 10):.1f} %"
        note += f"; mean error then {1e3 * np.nanmean(away):.1f} mm" if np.isfinite(away).any() else ""
        rate = share(int(np.sum(frames <= WITHIN)), len(frames))
        yield Goal("detection", text, 0.99, False, rate, "%", f"{len(frames)} trials", note)


def _quiet(done: Done) -> Iterator[Goal]:
    for mode in ("16T", "16P"):
        runs = list(done.of("quiet", f"{mode}/"))
        births, frames = sum(int(result["births"]) for _, _, result in runs), sum(task.frames for _, task, _ in runs)
        rate = share(births, frames)
        # once all frames were run there is nothing to infer
        low, high = (rate.low, rate.high) if frames < QUIET else (rate.value, rate.value)
        task = runs[0][1]
        text = f"False contacts of {mode} in {QUIET} quiet frames ({NAMES[task.world]}, {task.decibels:g} dB)"
        shown = sum(int(result["frames"]) for _, _, result in runs)
        note = f"a rate below {rate.high:.1e} a frame, with 97.5 % confidence; {shown} frames showed one by themselves"
        estimate = ConfidenceInterval(QUIET * rate.value, QUIET * low, QUIET * high)
        yield Goal("quiet", text, 0.0, True, estimate, "", f"{frames} frames, {len(runs)} seeds", note)


def _cost(done: Done) -> Iterator[Goal]:
    ((_, _, result),) = done.of("cost")
    choose, update = (np.median(result[name], axis=1) for name in ("choose", "update"))
    each = result["choose"] / (result["choose"] + result["update"])  # (n_contacts + 1, n_frames)
    worst = each[int(np.argmax(choose / (choose + update)))]
    times = enumerate(zip(choose, update, strict=True))
    note = "; ".join(f"{n} contacts: {1e6 * c:.0f} of {1e6 * (c + u):.0f} µs" for n, (c, u) in times)
    drawn = np.random.default_rng(0).integers(0, len(worst), (2000, len(worst)))
    low, high = np.quantile(np.median(worst[drawn], axis=1), [0.025, 0.975])
    estimate = ConfidenceInterval(float(np.median(worst)), float(low), float(high))
    text = "Choosing the next pattern, as a share of the tracker's computing in a frame"
    data = f"median of {len(worst)} frames, the worst number of contacts"
    yield Goal("cost", text, 0.2, True, estimate, "%", data, note)
