"""The comparison of policies: its lab, its yardsticks, its verdicts and its report."""

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from ohmskin.cli import app
from ohmskin.drive import ContactPrior, complete_pattern, position_bound
from ohmskin.errors import OhmskinError
from ohmskin.evaluate import policies, worlds
from ohmskin.evaluate.cache import describe, key
from ohmskin.evaluate.policies import static as static_module
from ohmskin.evaluate.policies.comparison import Comparison
from ohmskin.evaluate.policies.detection import apart as far_apart
from ohmskin.evaluate.policies.goals import MET, MISSED, OPEN, Goal
from ohmskin.evaluate.policies.judge import QUIET, errors, pair_rates
from ohmskin.evaluate.policies.lab import RADIUS as EXPECTED
from ohmskin.evaluate.policies.lab import Flaw, lab, misplaced, waves
from ohmskin.evaluate.policies.likeness import Likeness
from ohmskin.evaluate.policies.moving import FASTEST, path
from ohmskin.evaluate.policies.pairs import (
    RADIUS,
    apart,
    best_of,
    ideal_power,
    one_or_two,
    pair_places,
    single_places,
    told,
    unlike_one,
)
from ohmskin.evaluate.policies.plan import FLAWS
from ohmskin.evaluate.policies.schemes import ESTIMATORS, INSTRUMENTS, instrument_cost, rounds, scheme, within
from ohmskin.evaluate.policies.static import RADIUS_FACTOR
from ohmskin.evaluate.shapes import disc
from ohmskin.evaluate.statistics import Estimate, mean, share
from ohmskin.evaluate.worlds import CURRENT, contact
from ohmskin.inverse.discs import effective_change
from ohmskin.skin import Skin

TINY = policies.Settings(
    seeds=2,
    side=2,
    random=1,
    levels=(50.0,),
    frames=14,
    fine=(50.0, 60.0),
    where=1,
    singles=4,
    trials=2,
    quiet=40,
    draws=1,
    timed=10,
)


# --- statistics and verdicts -----------------------------------------------------------------------------------------------


def test_shares_have_the_exact_interval() -> None:
    none = share(0, 100_000)
    assert (none.value, none.low) == (0.0, 0.0)
    assert none.high == pytest.approx(1 - 0.025 ** (1 / 100_000), rel=1e-9)  # then all frames stay quiet in 2.5 % of cases
    every = share(40, 40)
    assert (every.value, every.high) == (1.0, 1.0)
    assert every.low == pytest.approx(0.025 ** (1 / 40), rel=1e-9)
    some = share(3, 50)
    assert some.low < 0.06 < some.high


def test_the_interval_of_a_mean_holds_the_truth_about_as_often_as_it_says() -> None:
    random = np.random.default_rng(1)
    inside = [m.low <= 0 <= m.high for m in (mean(random.normal(size=25)) for _ in range(200))]
    assert 0.88 < np.mean(inside) < 0.99


@pytest.mark.parametrize(
    ("measured", "at_most", "verdict"),
    [
        ((0.5, 0.4, 0.6), True, MET),
        ((0.8, 0.7, 0.9), True, MISSED),
        ((0.64, 0.6, 0.7), True, OPEN),
        ((0.66, 0.6, 0.7), True, OPEN),
        ((0.5, 0.4, 0.6), False, MISSED),
        ((0.8, 0.7, 0.9), False, MET),
        ((0.66, 0.6, 0.7), False, OPEN),
        ((0.65, 0.65, 0.65), True, MET),
    ],
)
def test_a_goal_is_met_or_missed_only_by_the_whole_interval(measured, at_most, verdict) -> None:
    goal = Goal("static", "x", 0.65, at_most, Estimate(*measured), "ratio", "2 seeds")
    assert goal.verdict == verdict
    assert goal.margin == f"{100 * (measured[0] / 0.65 - 1):+.0f} %"
    assert goal.bound == ("≤ 0.65" if at_most else "≥ 0.65")


# --- the lab -----------------------------------------------------------------------------------------------------------------


def test_scans_repeat_with_their_seed_and_are_new_each_time_a_pattern_is_driven_again() -> None:
    room, pattern = lab("discs", 40), Skin.load("paper").modes["12B"].base
    contacts = (contact("discs", 0.07, 0.12),)
    scan = room.scan(contacts, 3)
    first, second = scan(pattern), scan(pattern)
    assert np.array_equal(room.scan(contacts, 3)(pattern).volts, first.volts)
    assert not np.array_equal(room.scan(contacts, 4)(pattern).volts, first.volts)
    change = worlds.touched("discs", "grid", contacts) - worlds.sheet("discs", "grid").untouched
    exact = worlds.voltages(change, pattern)
    noise = np.concatenate([first.volts - exact, second.volts - exact])
    assert np.std(noise) == pytest.approx(room.noise, rel=4 / np.sqrt(2 * len(noise)))
    assert abs(np.corrcoef(first.volts - exact, second.volts - exact)[0, 1]) < 4 / np.sqrt(len(exact))


def test_flaws_are_as_large_as_they_say() -> None:
    skin = Skin.load("paper")
    for draw in range(3):
        moved = misplaced(skin, 2e-3, np.random.default_rng(draw)).positions
        assert np.linalg.norm(moved - skin.electrodes.positions, axis=1) == pytest.approx(2e-3, rel=1e-9)
        assert (moved >= 0).all()
        assert (moved <= 0.2).all()
        rim = list(skin.electrodes.rings[0])
        on_rim = (np.minimum(moved, 0.2 - moved)[rim] < 1e-9).any(axis=1)
        assert on_rim.all()
    mesh = skin.mesh()
    field = waves(mesh, np.random.default_rng(0))
    assert np.average(field, weights=mesh.measures) == pytest.approx(0, abs=1e-12)
    assert np.average(field**2, weights=mesh.measures) == pytest.approx(1, rel=1e-12)
    uneven = lab("discs", 50, Flaw(uneven=0.05)).model.conductivity
    assert np.std(uneven) / np.mean(uneven) == pytest.approx(0.05, rel=0.1)


def test_wear_since_the_calibration_shows_on_a_quiet_skin_and_wear_before_it_does_not() -> None:
    pattern = Skin.load("paper").modes["16I"].base
    known, since = (lab("pressed", 120, Flaw(wear=3.0, since=after)) for after in (False, True))
    assert np.abs(known.scan((), 0)(pattern).volts).max() < 6 * known.noise
    assert np.abs(since.scan((), 0)(pattern).volts).max() > 20 * since.noise


def test_flaws_of_the_plan_cost_accuracy_but_not_the_contact() -> None:
    places = np.random.default_rng(2).uniform(0.03, 0.17, (6, 2))
    away = {}
    for name in ("none", "all three, x 3 throughout"):
        room = lab("pressed", 60, FLAWS[name])
        found = []
        for k, place in enumerate(places):
            image, data = scheme("16I").gather(room, room.scan((contact("pressed", *place),), k))
            found.append(np.linalg.norm(ESTIMATORS["one disc"](room, image, data) - place))
        away[name] = np.mean(found)
    assert away["none"] < away["all three, x 3 throughout"] < 8e-3


# --- schemes -----------------------------------------------------------------------------------------------------------------


def test_fixed_patterns_are_driven_over_and_over() -> None:
    base = Skin.load("paper").modes["12B"].base
    pieces = rounds(base, 28)
    assert [p.n_inj for p in pieces] == [12, 12, 4]
    assert np.array_equal(pieces[-1].injections, base.injections[:4])
    assert [p.n_inj for p in rounds(base, 12)] == [12]


@pytest.mark.parametrize(("key", "count"), [("12B", 12), ("16I", 16), ("16O", 28), ("16P", 28), ("16P/16", 16), ("12B/30", 30)])
def test_schemes_drive_as_many_injections_as_they_say(key: str, count: int) -> None:
    room = lab("discs", 60)
    each = scheme(key)
    _, data = each.gather(room, room.scan((contact("discs", 0.06, 0.13),), 0))
    assert sum(d.pattern.n_inj for d in data) == each.injections == count


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_in_equal_time_no_scheme_takes_longer_than_the_papers_nor_could_take_one_injection_more(instrument: str) -> None:
    room = lab("discs", 60)
    cost = instrument_cost(instrument, room.skin)
    one = cost.time(next(complete_pattern(room.electrodes).split(1)))
    converter = room.skin.converter
    assert one == pytest.approx(converter.settle + (1 if instrument == "parallel" else 13) * converter.conversion)
    scan, taken = room.scan((contact("discs", 0.06, 0.13),), 0), {}
    for name in ("12B", "16I", "16O", "16P"):
        _, data = within(name, instrument, room).gather(room, scan)
        taken[name] = sum(cost.time(d.pattern) for d in data)
    for name in ("12B", "16I", "16P"):
        assert taken["16O"] - one < taken[name] <= taken["16O"] * (1 + 1e-9)


def test_mistakes_in_schemes_instruments_and_counts_are_told_with_the_choices() -> None:
    room = lab("discs", 60)
    for wrong in ("16X", "16P/many", ""):
        with pytest.raises(OhmskinError, match="choose from 12B, 16I, 16O, 16P"):
            scheme(wrong)
    with pytest.raises(OhmskinError, match="choose from parallel, multiplexed"):
        within("16I", "slow", room)
    with pytest.raises(OhmskinError, match="no mode '17X'"):
        room.mode("17X", 3)
    with pytest.raises(OhmskinError, match="seeds is 0"):
        policies.Settings(seeds=0)
    with pytest.raises(OhmskinError, match="no section 'fig3'; choose from static"):
        policies.plan(TINY, ("fig3",))


# --- yardsticks --------------------------------------------------------------------------------------------------------------


def test_the_position_bound_is_that_of_drive_design() -> None:
    room, place = lab("discs", 50), np.array([0.07, 0.12])
    _, data = scheme("16I").gather(room, room.scan((contact("discs", *place),), 0))
    mine = static_module.position_bound(room, data, place)
    effect = float(effective_change(np.log1p(0.5))[0]) * np.pi * 0.01**2
    loose = ContactPrior(effect, 0.01, position=1e3, effect_spread=1e6, radius_spread=float(np.log(RADIUS_FACTOR)))
    theirs = position_bound(room.table, place[None], room.mode("16I", 16).base, room.noise, CURRENT, loose)
    assert mine == pytest.approx(theirs[0], rel=1e-6)


def test_no_unbiased_fit_beats_the_position_bound_and_a_good_one_comes_close() -> None:
    room, place = lab("discs", 55), np.array([0.075, 0.11])
    contacts = (contact("discs", *place),)
    seen = []
    for seed in range(60):
        image, data = scheme("16I").gather(room, room.scan(contacts, seed))
        seen.append(ESTIMATORS["one disc"](room, image, data))
    spread = float(np.sqrt(np.var(seen, axis=0).sum()))
    bound = static_module.position_bound(room, data, place)
    assert 0.75 * bound < spread < 1.35 * bound


def test_discs_are_fitted_where_they_are() -> None:
    room = lab("discs", 60)
    rows = complete_pattern(room.electrodes).combination(16).toarray() * CURRENT / room.noise
    truth = np.array([[0.070, 0.120, np.log(4e-5), np.log(EXPECTED)], [0.090, 0.131, np.log(6e-5), np.log(EXPECTED)]])
    found = room.table(truth[:, :2], EXPECTED)
    data = rows @ (np.exp(truth[:, 2]) @ found.values)
    likeness = Likeness(room.table, rows, data)
    one = likeness.one()
    two = likeness.two(one)
    assert two.cost < 1e-3 < one.cost
    order = np.argsort(two.positions[:, 0])
    assert two.params[order] == pytest.approx(truth, abs=1e-3)
    single = Likeness(room.table, rows, rows @ (np.exp(truth[0, 2]) * found.values[0])).one()
    assert single.params[0] == pytest.approx(truth[0], abs=1e-3)


def test_slopes_of_the_fitted_discs_against_differences() -> None:
    room = lab("discs", 60)
    rows = room.mode("16I", 16).base.combination(16).toarray() * CURRENT / room.noise
    likeness = Likeness(room.table, rows, np.zeros(len(rows)))
    at = np.array([[0.07, 0.12, np.log(4e-5), np.log(7e-3)], [0.1, 0.05, np.log(6e-5), np.log(9e-3)]])
    slopes = likeness._linearise(at)[1]
    for k in range(at.size):
        step = np.zeros(at.size)
        step[k] = 1e-6
        high, low = (likeness._linearise(at + sign * step.reshape(at.shape))[0] for sign in (1, -1))
        assert (low - high) / 2e-6 == pytest.approx(slopes[:, k], rel=1e-4, abs=1e-5 * np.abs(slopes[:, k]).max())


def test_the_power_of_the_ideal_test_against_simulation() -> None:
    random = np.random.default_rng(0)
    distance = 2.5
    null, other = random.normal(0, 1, 200_000), random.normal(distance, 1, 200_000)
    cut = np.quantile(null, 0.99)
    assert float(ideal_power(np.array(distance))) == pytest.approx(np.mean(other > cut), abs=0.01)
    assert float(ideal_power(np.array(0.0))) == pytest.approx(0.01, rel=1e-9)


def test_no_choice_of_injections_sees_more_than_the_bound_over_all_choices() -> None:
    room = lab("discs", 60)
    complete, truth = complete_pattern(room.electrodes), apart(np.array([0.08, 0.11, 0.4]), 0.015)
    effect = 4e-5
    change = effect * room.table(truth, RADIUS).values.sum(axis=0)
    rows = complete.combination(16).toarray() * CURRENT / room.noise
    left = unlike_one(room.table, rows, change, truth, effect)
    bound, random = best_of(complete, left, 28), np.random.default_rng(0)
    greedy = np.argsort(np.bincount(complete.measurements[:, 0], left**2))[-28:]
    for chosen in [greedy, *(random.choice(complete.n_inj, 28, replace=False) for _ in range(8))]:
        some = np.isin(complete.measurements[:, 0], chosen)
        seen = unlike_one(room.table, rows[some], change, truth, effect)
        assert float(seen @ seen) <= bound * (1 + 1e-6)
    assert bound < float(left @ left)
    worse = effect * 2 * room.table(truth.mean(axis=0), RADIUS).values[0]
    assert float(left @ left) < float(np.sum((rows @ (change - worse)) ** 2))  # the best single disc beats one in the middle


def test_two_contacts_well_apart_are_told_from_one() -> None:
    room, spot = lab("discs", 60), np.array([0.09, 0.1, 0.5])
    pair = tuple(disc(*place, RADIUS, 0.5) for place in apart(spot, 0.03))
    far, places = one_or_two(room, scheme("16I").gather(room, room.scan(pair, 0))[1])
    single = (disc(*spot[:2], np.sqrt(2) * RADIUS, 0.5),)
    near, _ = one_or_two(room, scheme("16I").gather(room, room.scan(single, 0))[1])
    assert near < 25 < far
    assert told(places, apart(spot, 0.03))
    assert not told(places[:1], apart(spot, 0.03))
    assert not told(np.full((2, 2), 0.1), apart(spot, 0.03))


def test_places_and_paths_keep_off_the_rim() -> None:
    electrodes = Skin.load("paper").electrodes.positions
    for spot in pair_places(5, 0.03, electrodes):
        ends = apart(spot, 0.03)
        line = np.linspace(ends[0], ends[1], 50)
        assert np.linalg.norm(electrodes - line[:, None], axis=2).min() > 10e-3
        assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(0.03)
        assert (ends >= 0.015).all()
        assert (ends <= 0.185).all()
    for place in single_places(50, 0, electrodes):
        assert np.linalg.norm(electrodes - place, axis=1).min() > 10e-3
    for seed in range(4):
        places = path(seed, 200)
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        assert steps.max() <= FASTEST * (1 + 1e-9)
        assert steps.max() > 0.9 * FASTEST
        assert steps.min() < 0.05 * FASTEST
        assert (places >= 0.015).all()
        assert (places <= 0.185).all()
    places = far_apart(np.random.default_rng(0), 3)
    assert min(np.linalg.norm(places[i] - places[j]) for i in range(3) for j in range(i)) > 0.05


# --- verdicts from results ---------------------------------------------------------------------------------------------------


def comparison(section: str, results: dict, settings: policies.Settings = TINY) -> Comparison:
    """Made-up results in the place of those that the plan would have given."""
    experiments = policies.plan(settings, (section,))
    return Comparison(settings, experiments, {section: {name: results[name] for name in experiments[section]}})


def test_static_goals_take_the_right_rows_and_count_what_is_not_found() -> None:
    task = policies.plan(TINY, ("static",))["static"]["discs/50"]
    n = (len(task.schemes), len(task.estimators), 2, 5)
    truth = np.zeros((5, 2))
    estimate, bound = np.zeros((*n, 2)), np.ones((n[0], *n[2:]))
    for s in range(n[0]):
        for e in range(n[1]):
            estimate[s, e, ..., 0] = 1e-3 * (10 * s + e + 1)
    row = {scheme: k for k, scheme in enumerate(task.schemes)}
    bound[row["16P"]] = 0.5
    result = {"truth": truth, "estimate": estimate, "bound": bound, "injections": np.array([12, 16, 28, 16, 28])}
    goals = policies.judge(comparison("static", {"discs/50": result, "pressed/50": result}))
    paper = 10 * row["16O"] + 1
    values = {g.limit: g.measured.value for g in goals if "discs" in g.text or "bound" in g.text}
    assert values[0.65] == pytest.approx((10 * row["16P"] + 2) / paper)
    assert values[1.0] == pytest.approx((10 * row["16P/16"] + 2) / paper)
    assert values[0.6] == pytest.approx(0.5)
    assert sum(g.key for g in goals) == 3
    lost = np.full((1, 2), np.nan)
    assert errors(lost, np.array([[0.1, 0.04]])) == pytest.approx(0.06)  # the sheet's middle is taken for it


def test_pairs_need_the_statistic_and_the_places_and_false_twos_come_from_other_singles() -> None:
    statistic = np.full((1, 1, 1, 4), 10.0)
    near = np.array([True, True, False, True]).reshape(1, 1, 1, 4)
    statistic[..., 3] = 1.0
    learn, check = np.linspace(0, 5, 200)[None], np.concatenate([np.full(99, 0.0), [6.0]])[None]
    right, false = pair_rates({"statistic": statistic, "near": near, "learn": learn, "check": check})
    assert right.ravel().tolist() == [1, 1, 0, 0]
    assert false.mean() == pytest.approx(0.01)


def test_detection_counts_three_frames_and_quiet_frames_count_births() -> None:
    settings = policies.Settings(trials=10, quiet=200_000)
    frames = np.array([1, 2, 3, 3, 4, 9, np.inf, 1, 1, 1.0])
    result = {"frames": frames, "error": np.full(10, 1e-3), "ready": np.ones(10, bool), "ghosts": np.zeros(10, int)}
    names = policies.plan(settings, ("detection",))["detection"]
    goals = policies.judge(comparison("detection", dict.fromkeys(names, result), settings))
    assert {g.measured.value for g in goals} == {0.7}
    names = policies.plan(settings, ("quiet",))["quiet"]
    quiet = {name: {"births": np.array(0), "frames": np.array(0)} for name in names}
    assert [g.verdict for g in policies.judge(comparison("quiet", quiet, settings))] == [MET]
    quiet[next(iter(names))] = {"births": np.array(1), "frames": np.array(3)}
    assert [g.verdict for g in policies.judge(comparison("quiet", quiet, settings))] == [MISSED]
    few = {name: {"births": np.array(0), "frames": np.array(0)} for name in policies.plan(TINY, ("quiet",))["quiet"]}
    assert [g.verdict for g in policies.judge(comparison("quiet", few))] == [OPEN]  # too few frames to tell
    assert sum(task.frames for task in names.values()) >= QUIET


def test_the_full_plan_is_as_thorough_as_was_asked() -> None:
    full = policies.plan(policies.Settings())
    assert set(full) == set(policies.SECTIONS)
    for section in ("static", "time", "moving", "pairs"):
        assert all(task.seeds >= 20 for task in full[section].values() if hasattr(task, "seeds"))
    assert all(task.side == 9 and task.random > 0 for task in full["static"].values())
    told_apart = [t for t in full["pairs"].values() if isinstance(t, policies.Pairs)]
    assert {(t.decibels, round(1e3 * d)) for t in told_apart for d in t.distances} >= {(50.0, 20), (60.0, 12)}
    assert sum(task.frames for task in full["quiet"].values()) >= 100_000
    assert all(0.025 ** (1 / task.trials) > 0.99 for task in full["detection"].values())  # enough for the goal to be met at all
    for name in FLAWS:  # seeds of different draws are different seeds
        mine = [t for path, t in full["robust"].items() if path.split("/")[:2] == ["static", name]]
        assert len({seed for t in mine for seed in range(t.first, t.first + t.seeds)}) == sum(t.seeds for t in mine) >= 20
    tasks = [task for group in full.values() for task in group.values()]
    assert len({key(task) for task in tasks}) == len(tasks)
    json.dumps([describe(task) for task in tasks])


# --- the report --------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every section once, with little data; warnings are errors."""
    folder = tmp_path_factory.mktemp("policies")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("ohmskin.evaluate.policies.plan"), "FLAWS", {name: FLAWS[name] for name in list(FLAWS)[:2]})
        assert policies.compare(folder, TINY, jobs=1) == folder / "report.md"
    return folder


def test_the_report_has_every_section_picture_and_goal(report: Path) -> None:
    text = (report / "report.md").read_text(encoding="utf-8")
    for heading in ("Goals", "Contacts at rest", "Moving contacts", "Two contacts or one", "New contacts", "What choosing costs"):
        assert f"## {heading}" in text
    pictures = sorted(path.name for path in (report / "figures").glob("*.png"))
    assert pictures == ["detection.png", "moving.png", "pairs.png", "robust.png", "static.png"]
    assert all(f"(figures/{name})" in text for name in pictures)
    assert str(report) not in text
    assert "nan" not in text
    for line in text.splitlines():
        if line.startswith("|"):
            assert line.endswith("|")
    goals = json.loads((report / "goals.json").read_text())["goals"]
    assert {goal["verdict"] for goal in goals} <= {MET, MISSED, OPEN}
    assert {goal["section"] for goal in goals} == set(policies.SECTIONS) - {"robust"}
    assert all(goal["text"] in text and goal["data"] for goal in goals)
    assert {path.stem for path in (report / "data").glob("*.json")} == set(policies.SECTIONS)


def test_a_second_run_takes_results_from_the_cache_but_times_anew(report: Path, tmp_path: Path) -> None:
    seen: list[tuple[str, bool]] = []
    policies.compare(
        tmp_path,
        TINY,
        ("static", "cost"),
        report / "cache",
        jobs=1,
        progress=lambda section, task, cached: seen.append((section, cached)),
    )
    assert seen == [("static", True), ("static", True), ("cost", False)]
    before, after = (json.loads((f / "data" / "static.json").read_text())["experiments"] for f in (report, tmp_path))
    assert before == after


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--only", "fig9"], "choose from static"),
        (["--seeds", "0"], "seeds is 0"),
        (["--only", "quiet", "--jobs", "0"], "--jobs is 0"),
        (["--out", "FILE"], "--out"),
    ],
)
def test_a_mistake_is_told_in_one_line(options, message, tmp_path, monkeypatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OhmskinError, match=message) as mistake:
        app(["policies", *(option.replace("FILE", str(tmp_path / "file")) for option in options)])
    assert "\n" not in str(mistake.value)


def test_the_command_runs_and_says_where_the_report_is(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "ohmskin",
        "policies",
        "--quick",
        "--seeds",
        "2",
        "--only",
        "cost",
        "--jobs",
        "1",
        "--out",
        "new",
    ]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "report: new/report.md" in done.stdout
    assert "Choosing the next pattern" in (tmp_path / "new" / "report.md").read_text(encoding="utf-8")
