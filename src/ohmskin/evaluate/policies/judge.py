"""The goals of the comparison, put into numbers: which data each one takes, and what it asks of them."""

from typing import cast

import numpy as np

from ohmskin.evaluate.policies.comparison import Comparison
from ohmskin.evaluate.policies.detection import Detection, Quiet
from ohmskin.evaluate.policies.goals import Goal
from ohmskin.evaluate.policies.moving import Moving
from ohmskin.evaluate.policies.pairs import ALPHA, Pairs, ideal_power, threshold
from ohmskin.evaluate.policies.static import Static
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.statistics import Estimate, mean, ratio_of_means, share
from ohmskin.geometry.domain import Floats

CENTRE = 0.1  # metres; the middle of the sheet, the best guess for a place when nothing is found
SETTLE = 10  # frames of a moving contact that do not count: it is found in them
QUIET = 100_000  # frames in which no contact is to be invented
WITHIN = 3  # frames in which a new contact is to be found
NAMES = {"discs": "discs", "pressed": "contact-layer twin"}
ASKED_PAIRS = {(50.0, 0.02), (60.0, 0.012)}  # dB, distance (m)


def judge(done: Comparison) -> list[Goal]:
    """The goals that the results at hand can decide."""
    judges = {
        "static": _static,
        "time": _time,
        "moving": _moving,
        "pairs": _pairs,
        "detection": _detection,
        "quiet": _quiet,
        "cost": _cost,
    }
    return [goal for section, judged in judges.items() if section in done.results for goal in judged(done)]


def errors(estimate: Floats, truth: Floats) -> Floats:
    """Distances in metres of estimates (..., 2) from the truth; where nothing was found, the sheet's middle is the estimate."""
    distance: Floats = np.linalg.norm(np.where(np.isfinite(estimate), estimate, CENTRE) - truth, axis=-1)
    return distance


def static_errors(result: Result) -> Floats:
    """Mean error over the places (n_schemes, n_estimators, n_seeds) in metres."""
    return np.asarray(errors(result["estimate"], result["truth"]).mean(axis=-1))


def moving_errors(result: Result) -> tuple[Floats, Floats]:
    """Mean errors over a path but its start (m): by frames (n_schemes, n_estimators, n_seeds), tracked (n_followers, n_seeds)."""
    framewise, tracked = (errors(result[name], result["truth"])[..., SETTLE:].mean(axis=-1) for name in ("framewise", "tracked"))
    return framewise, tracked


def pair_rates(result: Result) -> tuple[Floats, Floats]:
    """Pairs told apart (n_schemes, n_distances, n_where, n_seeds) and single contacts taken for two (n_schemes, n_check)."""
    cut = threshold(result["learn"])
    told = (result["statistic"] > cut[:, None, None, None]) & result["near"]
    return told.astype(float), (result["check"] > cut[:, None]).astype(float)


def robust_errors(done: Comparison) -> dict[str, dict[tuple[str, str], Floats]]:
    """Mean errors (n_seeds,) in metres by flaw, and by scheme and estimator."""
    table: dict[str, dict[tuple[str, str], list[Floats]]] = {}
    for path, result in done.results["robust"].items():
        kind, name, _ = path.split("/")
        cells = table.setdefault(name, {})
        if kind == "static":
            task = cast(Static, done.experiments["robust"][path])
            means = static_errors(result)
            for s, key in enumerate(task.schemes):
                for e, estimator in enumerate(task.estimators):
                    cells.setdefault((key, estimator), []).append(means[s, e])
        else:
            cells.setdefault(("16T", "moving"), []).append(moving_errors(result)[1][0])
    return {name: {way: np.concatenate(values) for way, values in cells.items()} for name, cells in table.items()}


def _mm(values: Floats) -> str:
    return f"{1e3 * values.mean():.2f} mm"


def _static(done: Comparison) -> list[Goal]:
    found = []
    asked = {"16P": (0.65, "28 injections and a fit"), "16P/16": (1.0, "16 injections and a fit")}
    for name, result in done.results["static"].items():
        world, decibels = name.split("/")
        task, mean_error = cast(Static, done.experiments["static"][name]), static_errors(result)
        key = world == "discs" and float(decibels) == done.settings.levels[0]
        row = {scheme: number for number, scheme in enumerate(task.schemes)}
        paper = mean_error[row["16O"], task.estimators.index("centroid")]
        data = f"{task.seeds} seeds, {len(result['truth'])} places"
        for scheme, (limit, text) in asked.items():
            mine = mean_error[row[scheme], task.estimators.index("fit")]
            text = f"Static contact, {text}: mean error over that of the paper's 28 ({NAMES[world]}, {decibels} dB)"
            note = f"{_mm(mine)} against {_mm(paper)}"
            found.append(Goal("static", text, limit, True, ratio_of_means(mine, paper), "ratio", data, note, key))
        if world == "discs":
            ours, theirs = (result["bound"][row[scheme]].mean(axis=-1) for scheme in ("16P", "16O"))
            text = f"Position bound at 28 injections over that of the paper's scheme ({decibels} dB)"
            note = f"{_mm(ours)} against {_mm(theirs)}, mean over the places, of the patterns really driven"
            found.append(Goal("static", text, 0.6, True, ratio_of_means(ours, theirs), "ratio", data, note, key))
    return found


def _time(done: Comparison) -> list[Goal]:
    found = []
    for instrument, result in done.results["time"].items():
        task, mean_error = cast(Static, done.experiments["time"][instrument]), static_errors(result)
        mine, paper = mean_error[task.schemes.index("16P"), 1], mean_error[task.schemes.index("16O"), 0]
        count = int(result["injections"][task.schemes.index("16P")])
        text = f"Static contact in the time of the paper's scheme on a {instrument} instrument: mean error over the paper's"
        note = f"{count} injections; {_mm(mine)} against {_mm(paper)}"
        data = f"{task.seeds} seeds, {len(result['truth'])} places"
        found.append(Goal("time", text, 0.65, True, ratio_of_means(mine, paper), "ratio", data, note, False))
    return found


def _moving(done: Comparison) -> list[Goal]:
    found = []
    for world, result in done.results["moving"].items():
        task = cast(Moving, done.experiments["moving"][world])
        framewise, tracked = moving_errors(result)
        ours = tracked[task.followers.index(4)]
        for e, estimator in enumerate(task.estimators):
            theirs = framewise[task.schemes.index("16I"), e]
            text = (
                f"Moving contact, 4 injections a frame and tracking: mean error over that of 16I with 16, "
                f"{estimator} ({NAMES[world]}, {task.decibels:g} dB)"
            )
            data = f"{task.seeds} seeds, each a path of {task.frames} frames"
            note = f"{_mm(ours)} against {_mm(theirs)}"
            found.append(Goal("moving", text, 1.0, True, ratio_of_means(ours, theirs), "ratio", data, note, world == "discs"))
    return found


def _pairs(done: Comparison) -> list[Goal]:
    found = []
    for name, result in done.results["pairs"].items():
        what, decibels, strength = name.split("/")
        if what != "told":
            continue
        task = cast(Pairs, done.experiments["pairs"][name])
        told, false = pair_rates(result)
        row = task.schemes.index("16P")
        limits = done.results["pairs"][f"limit/{decibels}/{strength}"]
        ideal, any_choice = ideal_power(limits["distance"][task.schemes.index("16P")]), ideal_power(limits["any"])
        where = f"+{100 * task.strength:g} %, {decibels} dB"
        for d, distance in enumerate(task.distances):
            if (task.decibels, distance) not in ASKED_PAIRS:
                continue
            text = f"Two contacts of 6 mm radius {1e3 * distance:g} mm apart told from one ({where})"
            data = f"{told.shape[3]} seeds at {told.shape[2]} places"
            note = (
                f"an ideal test would reach {100 * ideal[d].mean():.0f} % with these injections, "
                f"at most {100 * any_choice[d].mean():.0f} % with any 28"
            )
            rate = mean(told[row, d].mean(axis=0))
            found.append(Goal("pairs", text, 0.75, False, rate, "%", data, note, task.strength == 0.5))
        text = f"One contact taken for two by the same test ({where})"
        data = f"{false.shape[1]} single contacts; the threshold is set on {result['learn'].shape[1]} others"
        rate = share(int(false[row].sum()), false.shape[1])
        found.append(Goal("pairs", text, ALPHA, True, rate, "%", data, "", task.strength == 0.5))
    return found


def _detection(done: Comparison) -> list[Goal]:
    found = []
    others = ("nothing else is touched", "one other is followed", "two others are followed")
    for name, result in done.results["detection"].items():
        task, frames = cast(Detection, done.experiments["detection"][name]), result["frames"]
        text = f"New contact found within {WITHIN} frames of {task.injections} injections while {others[task.others]}"
        late = f"within 5 frames {100 * np.mean(frames <= 5):.1f} %, 10 frames {100 * np.mean(frames <= 10):.1f} %"
        late += f"; mean error then {1e3 * np.nanmean(result['error']):.1f} mm" if np.isfinite(result["error"]).any() else ""
        rate = share(int(np.sum(frames <= WITHIN)), len(frames))
        text = f"{text} ({NAMES[task.world]}, {task.decibels:g} dB)"
        found.append(Goal("detection", text, 0.99, False, rate, "%", f"{len(frames)} trials", late))
    return found


def _quiet(done: Comparison) -> list[Goal]:
    found = []
    for world in dict.fromkeys(name.split("/")[0] for name in done.results["quiet"]):
        names = [name for name in done.results["quiet"] if name.startswith(f"{world}/")]
        tasks = [cast(Quiet, done.experiments["quiet"][name]) for name in names]
        births, frames = sum(int(done.results["quiet"][n]["births"]) for n in names), sum(t.frames for t in tasks)
        text = f"Contacts invented in {QUIET} quiet frames ({tasks[0].decibels:g} dB)"
        rate = share(births, frames)
        ends = (rate.low, rate.high) if frames < QUIET else (rate.value, rate.value)  # all frames were run: nothing to infer
        note = f"a rate below {rate.high:.1e} a frame, with 97.5 % confidence"
        estimate = Estimate(QUIET * rate.value, QUIET * ends[0], QUIET * ends[1])
        found.append(Goal("quiet", text, 0.0, True, estimate, "", f"{frames} frames, {len(tasks)} seeds", note))
    return found


def _cost(done: Comparison) -> list[Goal]:
    result = done.results["cost"]["tracker"]
    choose, update = (np.median(result[name], axis=1) for name in ("choose", "update"))
    each = result["choose"] / (result["choose"] + result["update"])  # (n_contacts + 1, n_frames)
    worst = int(np.argmax(choose / (choose + update)))
    text = "Choosing the next pattern, as a share of the tracker's computing in a frame"
    note = "; ".join(
        f"{n} contacts: {1e6 * c:.0f} of {1e6 * (c + u):.0f} µs" for n, (c, u) in enumerate(zip(choose, update, strict=True))
    )
    drawn = np.random.default_rng(0).integers(0, each.shape[1], (2000, each.shape[1]))
    low, high = np.quantile(np.median(each[worst][drawn], axis=1), [0.025, 0.975])
    estimate = Estimate(float(np.median(each[worst])), float(low), float(high))
    return [Goal("cost", text, 0.2, True, estimate, "%", f"median of {each.shape[1]} frames, the worst number of contacts", note)]
