"""Presses of known places teach where contacts really are; press data are read whatever they are values of."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import ohmskin
from flawed import CURRENT, Flawed, flawed_skin, weaker_skin
from scipy.io import savemat

from ohmskin.arrays import Floats
from ohmskin.calibrate import judge_channels
from ohmskin.calibrate.positions import PositionReport, learn_positions, novelty, read_places, similarity
from ohmskin.drive import Fixed
from ohmskin.errors import DataError, SkinError
from ohmskin.importers import Recording, read_recording, resolved
from ohmskin.scan import Frame, adjacent, opposite
from ohmskin.sensing import SkinModel, build, recorded_mode
from ohmskin.sensing.identity import changed_since
from ohmskin.skin import Skin
from ohmskin.skin.positions import PositionMap
from ohmskin.skin.virtual import VirtualSkin

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


def physics(given: Flawed, learned: int) -> tuple[Skin, Floats, Floats]:
    """The skin with channels judged on its first presses, and where it sees all presses, with their changes."""
    judged = judge_channels(given.skin, given.quiet, given.frames[: max(learned, 60)])
    skin = replace(given.skin, calibration=judged.put_into(given.skin.calibration))
    return skin, *read_places(SkinModel(skin, skin.transfer_model(), given.quiet), given.frames)


def taught(given: Flawed, found: Floats, changes: Floats, count: int) -> PositionReport:
    """What the first presses teach."""
    return learn_positions(given.pattern, found[:count], changes[:count], given.positions[:count], 0.2)


def told(skin: Skin, given: Flawed, frames: list[Frame]) -> Floats:
    """Where recordings of a skin are said to be touched most; NaN where nowhere."""
    known = SkinModel(skin, skin.transfer_model(), given.quiet)
    sensor = build(recorded_mode(skin), known, Fixed(given.pattern))
    percepts = [sensor.step(sensor.start(), lambda _, frame=frame: frame)[1] for frame in frames]
    return np.array([one.detections[0].position if one.detections else (np.nan, np.nan) for one in percepts])


def test_known_presses_make_unseen_ones_better_the_more_the_better_and_few_no_worse() -> None:
    ratios: dict[int, list[float]] = {20: [], 100: [], 300: []}
    inside = []
    for seed in (31, 32):
        given = flawed_skin(seed, 400)
        skin, found, changes = physics(given, 300)
        unseen = slice(300, 400)
        before = np.linalg.norm(found[unseen] - given.positions[unseen], axis=1)
        for count, seen in ratios.items():
            report = taught(given, found, changes, count)
            learned = replace(skin, calibration=replace(skin.calibration, position_map=report.map.dump()))
            assert report.map.own
            after = told(learned, given, given.frames[unseen])  # the product itself, with what it was taught
            away = np.linalg.norm(after - given.positions[unseen], axis=1)
            seen.append(float(np.nanmean(away) / np.nanmean(before)))
            if count == 300:
                counts, errors = zip(*report.curve, strict=True)
                assert counts == (20, 50, 100)
                assert errors[-1] < errors[0]
                _, variances = report.map(found[unseen], np.nan_to_num(changes[unseen]))
                inside += (away**2 < 4.605 * variances).tolist()
    assert max(ratios[20]) <= 1.1
    assert np.mean(ratios[100]) <= 0.7
    assert np.mean(ratios[300]) <= 0.5
    assert 0.7 <= np.mean(inside) <= 0.97  # the flawed skin drifts, from presses learned from to unseen ones, too


def test_a_skin_with_a_weaker_layer_is_learned_from_a_hundred_presses_and_not_spoilt_by_twenty() -> None:
    given = weaker_skin(204, 200)
    judged = judge_channels(given.skin, given.quiet, given.frames[:100])
    skin = replace(given.skin, calibration=judged.put_into(given.skin.calibration))
    for described, count, most in ((given.skin, 20, 1.1), (skin, 100, 0.7)):  # too few to judge channels by; enough
        known = SkinModel(described, described.transfer_model(), given.quiet)
        found, changes = read_places(known, given.frames)
        report = taught(given, found, changes, count)
        places, variances = report.map(found[100:], np.nan_to_num(changes[100:]))
        before, after = (np.linalg.norm(one - given.positions[100:], axis=1) for one in (found[100:], places))
        assert after.mean() <= most * before.mean()
        assert np.mean(after**2 < 4.605 * variances) >= 0.75


def test_presses_in_a_robots_frame_register_it_and_leave_contacts_on_the_sheet() -> None:
    given = flawed_skin(34, 150)
    _, found, changes = physics(given, 150)
    there = 2.0 * given.positions @ TURN.T + [3.0, -1.0]
    report = learn_positions(given.pattern, found, changes, there, 0.2)
    assert not report.map.own
    assert "turned by 90" in report.report()[-1] or "turned by 89" in report.report()[-1]
    assert report.map.registration.scale == pytest.approx(2.0, rel=0.1)
    registered, _ = report.map.registered(found)
    on_sheet, variances = report.map(found)
    own = taught(given, found, changes, 150)
    assert np.mean(np.linalg.norm(registered - there, axis=1)) < 2 * np.mean(own.physics)
    assert np.linalg.norm(on_sheet - given.positions, axis=1).mean() < 1.05 * np.mean(own.physics)
    assert (variances > 0).all()


def test_errors_are_those_at_places_not_learned_from_however_often_each_was_pressed() -> None:
    """They had been a fifth of that: other frames of the same places had been learned from."""
    given = flawed_skin(37, 24 + 60, silent=0, strange=0)
    often = replace(given, frames=[*np.repeat(np.array(given.frames[:24], object), 6), *given.frames[24:]])
    rng = np.random.default_rng(0)
    often.frames[:144] = [
        replace(one, voltages=one.voltages + 1e-6 * rng.normal(size=208)) for one in often.frames[:144]
    ]
    places = np.vstack([np.repeat(given.positions[:24], 6, axis=0), given.positions[24:]])
    often = replace(often, positions=places)
    _, found, changes = physics(often, 144)
    report = taught(often, found, changes, 144)
    assert report.places == 24
    assert "mean error at places (24 are known) not learned from" in report.report()[0]
    reached, _ = report.map(found[144:], np.nan_to_num(changes[144:]))
    true = np.nanmean(np.linalg.norm(reached - places[144:], axis=1))
    assert 0.6 * true < report.mapped.mean() < 1.6 * true
    assert not any("no better" in line for line in report.report())


def test_places_of_other_rows_are_refused() -> None:
    given = flawed_skin(37, 60, silent=0, strange=0)
    _, found, changes = physics(given, 60)
    late = np.roll(given.positions, 1, axis=0)
    with pytest.raises(DataError, match=r"nothing to do with the presses: places scatter by .*its own press"):
        learn_positions(given.pattern, found, changes, late, 0.2)
    some = given.positions.copy()
    some[:6] = late[:6]
    report = learn_positions(given.pattern, found, changes, some, 0.2)
    assert report.contradicting.sum() >= 3
    assert any("far from where all others say" in line for line in report.report())


@pytest.mark.parametrize("count", [60, 200])
def test_a_few_wrong_places_are_told_and_teach_nothing(count: int) -> None:
    """One of five hundred had made unseen presses a third worse, a twentieth seven times as bad."""
    given = flawed_skin(31, count + 60)
    _, found, changes = physics(given, count)
    unseen = slice(count, count + 60)

    def missed(places: Floats) -> tuple[float, PositionReport]:
        report = learn_positions(given.pattern, found[:count], changes[:count], places, 0.2)
        there, _ = report.map(found[unseen], np.nan_to_num(changes[unseen]))
        return float(np.linalg.norm(there - given.positions[unseen], axis=1).mean()), report

    random = np.random.default_rng(0)
    some, wrong = given.positions[:count].copy(), random.choice(count, count // 20, replace=False)
    some[wrong] = (some[wrong] + [0.06, 0.08]) % 0.2
    usual, without = missed(given.positions[:count])
    spoilt, report = missed(some)
    assert not without.contradicting.any()
    assert set(np.flatnonzero(report.contradicting)) == set(wrong)
    assert spoilt < 1.15 * usual
    lines = report.report()
    assert f"(number {min(wrong) + 1}, " in next(line for line in lines if "far from where all others" in line)
    assert "no better" not in " ".join(lines)


def test_a_similarity_is_found_exactly_mirrored_or_not() -> None:
    random = np.random.default_rng(0)
    here, mirror = random.normal(size=(30, 2)), np.diag([1.0, -1.0])
    for linear in (0.7 * TURN, 1.3 * TURN @ mirror):
        one = similarity(here, here @ linear.T + [1.0, 2.0])
        np.testing.assert_allclose(one.linear, linear, atol=1e-12)
        np.testing.assert_allclose(one.shift, [1.0, 2.0], atol=1e-12)


def test_a_map_reads_back_as_it_was_and_damage_is_refused() -> None:
    given = flawed_skin(35, 80)
    _, found, changes = physics(given, 80)
    report = taught(given, found, changes, 80)
    text = report.map.dump()
    again = PositionMap.parse(text)
    for told in (None, np.nan_to_num(changes)):
        for one, other in zip(report.map(found, told), again(found, told), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-8)
    for damaged in (text[:-40], "AAAA" + text[4:], text[:200] + text[300:], "x", text[: len(text) // 2] + "!"):
        with pytest.raises(SkinError, match=r"position_map cannot be read: .*; learn it again"):
            replace(given.skin, calibration=replace(given.skin.calibration, position_map=damaged))


def test_noise_that_was_not_there_when_presses_taught_widens_the_ellipses() -> None:
    given = flawed_skin(36, 260, drift=0.0)
    skin, found, changes = physics(given, 60)
    report, unseen = taught(given, found, changes, 60), slice(60, 260)
    known, random = SkinModel(skin, skin.transfer_model(), given.quiet), np.random.default_rng(0)
    rest = np.mean([one.voltages for one in given.quiet], axis=0)
    usual = np.sqrt(np.mean((np.array([one.voltages for one in given.frames]) - rest) ** 2))
    noisy = [
        replace(one, voltages=one.voltages + 0.1 * usual * random.normal(size=208)) for one in given.frames[unseen]
    ]
    held, blind = [], []
    for frames in (given.frames[unseen], noisy):
        at, told = read_places(known, frames)
        places, variances = report.map(at, np.nan_to_num(told))
        squares = ((places - given.positions[unseen]) ** 2).sum(axis=1)
        held.append(np.mean(squares < 4.605 * variances))
        blind.append(np.mean(squares < 4.605 * replace(report.map, length=0.0)(at, np.nan_to_num(told))[1]))
    assert 0.82 <= min(held) <= max(held) <= 0.99
    assert blind[1] < 0.75


def test_false_alarms_come_at_their_rate_after_few_presses_too() -> None:
    random = np.random.default_rng(0)
    for count, middle in ((20, -1.5), (20, -0.3), (100, -1.5), (1000, -1.5)):
        limits, rates = np.transpose([novelty(one) for one in np.exp(random.normal(middle, 0.3, (400, count)))])
        over = [np.mean(np.exp(random.normal(middle, 0.3, 2000)) > limit) for limit in limits]
        assert np.mean(over) == pytest.approx(np.mean(rates), rel=0.2, abs=0.002)
        assert limits.max() <= 0.9


def table(given: Flawed, path: Path, header: str = "", scale: float = 1.0, unit: str = "") -> Path:
    """Press data as text, with the pattern beside it."""
    rows = [("", "", frame) for frame in given.quiet]
    rows += [(*(scale * place), frame) for place, frame in zip(given.positions, given.frames, strict=True)]
    lines = [f"x{unit},y{unit}," + ",".join(f"v{k}" for k in range(given.pattern.n_meas))]
    lines += [f"{x},{y}," + ",".join(map(repr, frame.voltages.tolist())) for x, y, frame in rows]
    path.write_text(f"# skin = paper-rim16\n# current = {CURRENT}\n{header}" + "\n".join(lines) + "\n")
    pattern = "\n".join(",".join(map(str, row)) for row in given.pattern.quadruples.tolist())
    path.with_suffix(".pattern.csv").write_text("source,sink,plus,minus\n" + pattern + "\n")
    return path


def test_learn_reads_press_data_writes_a_skin_and_a_picture(tmp_path: Path) -> None:
    given = flawed_skin(36, 120)
    file = table(given, tmp_path / "presses.csv", scale=1e3, unit="_mm")
    recording = read_recording(file)
    assert len(recording.quiet) == len(given.quiet)
    assert recording.positions is not None
    np.testing.assert_allclose(recording.positions, given.positions)
    np.testing.assert_array_equal(recording.frames[5].voltages, given.frames[5].voltages)
    out = tmp_path / "learned.toml"
    done = ohmskin("learn", str(file), "--output", str(out), "--picture", str(tmp_path / "learned.png"))
    assert "120 of 120 presses detected; mean error at presses not learned from: physics" in done.stdout
    assert (tmp_path / "learned.png").stat().st_size > 10_000
    skin = Skin.load(out)
    assert skin.calibration.judged is not None
    assert skin.calibration.positions_learned is not None
    again = ohmskin("image", str(file), "--skin", str(out), "--frame", "7", "--output", str(tmp_path / "seven.png"))
    x, y = (float(part) for part in again.stdout.split("(")[1].split(")")[0].split(","))
    assert np.hypot(*(1e-3 * np.array([x, y]) - given.positions[7])) < 5e-3
    for seed, told in ((36, False), (37, True)):  # another skin of the same design
        known = SkinModel(skin, skin.transfer_model(), flawed_skin(seed, 120).quiet)
        assert ["unlike those of the skin that was learned" in said for said in changed_since(known)] == [True] * told


def test_presses_without_places_teach_the_channels_alone(tmp_path: Path) -> None:
    given = flawed_skin(36, 120)
    file = table(replace(given, quiet=[], positions=np.full_like(given.positions, np.nan)), tmp_path / "presses.csv")
    done = ohmskin("learn", str(file), "--output", str(tmp_path / "learned.toml"))
    assert "# no row has a place or a force: all are taken for presses" in done.stderr
    assert "# no press has a place: no map is learned" in done.stderr
    found = Skin.load(tmp_path / "learned.toml").calibration
    judged = judge_channels(given.skin, given.quiet, given.frames)
    assert found.judged is not None
    assert found.positions_learned is None
    assert np.mean(found.judged.doubtful(judged.pattern) == judged.doubtful) > 0.9


def test_press_data_of_matlab_with_a_reference_of_each_press_lose_their_drift(tmp_path: Path) -> None:
    given = flawed_skin(37, 40)
    volts = np.array([frame.voltages for frame in given.frames])
    rest = np.mean([frame.voltages for frame in given.quiet], axis=0)
    drift = np.linspace(0, 0.1 * np.abs(rest).max(), 40)[:, None] * np.random.default_rng(1).normal(size=volts.shape[1])
    held = {"stim_meas_list": given.pattern.quadruples + 1, "positions": given.positions, "forces": np.arange(40.0)}
    savemat(tmp_path / "presses.mat", held | {"voltages": volts + drift, "reference": rest + drift})
    recording = read_recording(tmp_path / "presses.mat")
    one = [frame.voltages - np.mean([q.voltages for q in recording.quiet], axis=0) for frame in recording.frames]
    np.testing.assert_allclose(one, volts - rest, atol=1e-12)
    assert recording.forces is not None
    assert recording.forces[7] == 7
    assert recording.skin == ""


def test_magnitudes_differences_and_turned_voltages_are_made_voltages(tmp_path: Path) -> None:
    given = flawed_skin(38, 8, silent=0, strange=0, gain=0)
    model = given.skin.transfer_model()
    pattern = opposite(range(16))
    rest = model.voltages(pattern)
    assert 0.1 < (rest < 0).mean() < 0.9
    random = np.random.default_rng(2)
    frames = rest * (1 - 0.01 * np.abs(random.normal(size=(8, pattern.n_meas))))  # as of what conducts
    held = {"stim_meas_list": pattern.quadruples + 1, "positions": given.positions, "skin": "paper-rim16"}

    def read(name: str, **values: object) -> tuple[Floats, str]:
        savemat(tmp_path / f"{name}.mat", held | values)
        found = resolved(read_recording(tmp_path / f"{name}.mat"), model)
        assert found.values == "voltages"
        quiet = np.mean([frame.voltages for frame in found.quiet], axis=0)
        return np.array([frame.voltages - quiet for frame in found.frames]), " ".join(found.notes)

    for name, values, note in (
        ("plain", {"voltages": frames, "reference": rest[None]}, ""),
        ("magnitudes", {"voltages": np.abs(frames), "reference": np.abs(rest)[None]}, "signs are the model's"),
        ("differences", {"voltages": frames - rest, "values": "differences"}, "untouched skin is the model's"),
        ("less", {"voltages": rest - frames, "values": "differences"}, "less the pressed one"),
        ("turned", {"voltages": -frames, "reference": -rest[None]}, "opposite sign"),
    ):
        changes, notes = read(name, **values)
        np.testing.assert_allclose(changes, frames - rest, atol=1e-9)
        assert note in notes
    counts, notes = read("counts", voltages=1e5 * (frames - rest), values="differences")
    assert "strengths are relative" in notes
    assert np.corrcoef(counts.ravel(), (frames - rest).ravel())[0, 1] > 1 - 1e-9


@pytest.mark.parametrize("seed", [41, 42])
def test_what_press_data_leave_out_costs_little(seed: int) -> None:
    given = flawed_skin(seed, 120)
    model = given.skin.transfer_model()
    rest = np.mean([frame.voltages for frame in given.quiet], axis=0)
    offsets = np.random.default_rng(seed).normal(0, np.abs(rest).mean(), len(rest))

    def seen(frames: list[Frame], quiet: list[Frame], values: str = "voltages") -> float:
        found = resolved(Recording(quiet, frames, "", (), None, given.positions, None, values), model)
        places = judge_channels(given.skin, found.quiet, found.frames).places
        assert len(places) == len(given.positions)
        return float(np.linalg.norm(places - given.positions, axis=1).mean())

    def moved(frames: list[Frame], by: Floats, scale: float = 1.0) -> list[Frame]:
        return [replace(frame, voltages=scale * (frame.voltages + by)) for frame in frames]

    usual = seen(given.frames, given.quiet)
    assert usual < 4.5e-3
    middle = replace(given.quiet[0], voltages=np.median([frame.voltages for frame in given.frames], axis=0))
    for other in (
        seen(moved(given.frames, -rest), [], "differences"),
        seen(moved(given.frames, -rest, -3e4), [], "differences"),  # in counts, and the other way round
        seen(moved(given.frames, offsets), moved(given.quiet, offsets)),
        seen(given.frames, [middle]),
        seen(moved(given.frames, np.full(len(rest), 0.3)), moved(given.quiet, np.full(len(rest), 0.3))),
    ):
        assert other < 1.15 * usual


@pytest.mark.parametrize("values", ["differences", "magnitudes"])
def test_press_data_replay_as_the_voltages_that_they_mean(values: str, tmp_path: Path) -> None:
    given = flawed_skin(35, 40)
    frames = [[frame.voltages for frame in some] for some in (given.quiet, given.frames)]
    rest = np.mean(frames[0], axis=0)
    rows = [[np.abs(one) if values == "magnitudes" else one - rest for one in some] for some in frames]
    held = {"stim_meas_list": given.pattern.quadruples + 1, "positions": np.repeat(given.positions, 8, axis=0)}
    savemat(
        tmp_path / "a.mat",
        held | {"voltages": np.repeat(rows[1], 8, axis=0), "values": values, "skin": "paper-rim16"}
        | ({"reference": rows[0]} if values == "magnitudes" else {}),
    )  # fmt: skip
    done = ohmskin("replay", "a.mat", "--json", "--speed", "inf", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "one press a frame" in done.stderr
    touched = [bool(json.loads(line)["contacts"]) for line in done.stdout.splitlines() if '"contacts"' in line]
    assert np.mean(touched) > 0.5
    done = ohmskin("image", "a.mat", "--frame", "3", cwd=tmp_path)
    assert ("from repeats" in done.stderr) == (values == "magnitudes")  # noise that is assumed is not told as measured


def test_rows_without_a_place_and_with_no_force_are_what_they_look_like(tmp_path: Path) -> None:
    given = flawed_skin(36, 12)
    rest = [frame.voltages for frame in given.quiet[:10]]
    pressed = [frame.voltages for frame in given.frames]
    names = [f"v{k}" for k in range(208)]
    rows = [
        *([0, 0, 0, 20, *one] for one in rest[:5]),
        *([np.nan, np.nan, 0, 20, *one] for one in rest[5:]),
        *([x, y, 1, 20, *one] for (x, y), one in zip(given.positions[:8], pressed, strict=False)),
        [np.nan, np.nan, 1, 20, *pressed[8]],
        [given.positions[9][0], np.nan, 1, 20, *pressed[9]],
        [np.nan, np.nan, np.nan, 20, *pressed[10]],
    ]
    file = tmp_path / "presses.csv"
    np.savetxt(file, rows, delimiter=",", header=",".join(["x", "y", "force", "celsius", *names]), comments="")
    found = read_recording(file)
    assert (len(found.quiet), len(found.frames)) == (10, 11)
    assert found.positions is not None
    assert np.isfinite(found.positions).all(axis=1).tolist() == 8 * [True] + 3 * [False]
    notes = " ".join(found.notes)
    for words in (
        "3 rows without a place are presses",
        "5 rows with a force of 0 are of the untouched skin",
        "'celsius' are left out",
        "1 A is assumed",
    ):
        assert words in notes


def test_a_channel_of_noise_alone_makes_no_presses_of_quiet_rows_and_counts_keep_their_order(tmp_path: Path) -> None:
    given = flawed_skin(41, 20)
    rest, pressed = (np.array([frame.voltages for frame in some]) for some in (given.quiet, given.frames))
    count, random = len(rest), np.random.default_rng(0)
    noisy = np.vstack([rest, pressed])
    noisy[:, 5] += 30 * np.abs(pressed - rest[0]).mean() * random.standard_normal(len(noisy))
    counts = 512 + np.vstack([rest, pressed]) / np.abs(rest).max() * 200
    for values in (noisy, counts):
        rows = np.column_stack([np.vstack([np.full((count, 2), np.nan), given.positions]), values])
        names = ",".join(["x", "y", *(f"v{k}" for k in range(208))])
        np.savetxt(tmp_path / "presses.csv", rows, delimiter=",", header=names, comments="")
        found = read_recording(tmp_path / "presses.csv")
        assert (len(found.quiet), len(found.frames)) == (count, 20)
        np.testing.assert_array_equal(found.frames[0].pattern.quadruples, given.pattern.quadruples)
    voltages = resolved(found, given.skin.transfer_model())
    assert "offset of 51" in " ".join(voltages.notes)
    scaled = pressed / np.abs(rest).max() * 200
    np.testing.assert_allclose([frame.voltages for frame in voltages.frames], scaled, atol=8.0)


@pytest.mark.parametrize("force", [0.0, np.nan])
def test_untouched_rows_beside_light_presses_are_no_presses(force: float, tmp_path: Path) -> None:
    skin, pattern, random = Skin.load("paper-rim16"), adjacent([range(16)]), np.random.default_rng(0)
    virtual = VirtualSkin(skin, seed=0)
    rows = [[np.nan, np.nan, force, *virtual.scan(pattern).voltages] for _ in range(10)]
    for x, y in random.uniform(0.015, 0.185, (40, 2)):
        virtual.press(1, x, y, 7e-3, 15e3)
        rows.append([x, y, 3.0, *virtual.scan(pattern).voltages])
        virtual.press(1, x, y, 7e-3, 0.0)
    names = ",".join(["x", "y", "force", *(f"v{k}" for k in range(208))])
    np.savetxt(tmp_path / "presses.csv", rows, delimiter=",", header=names, comments="")
    found = read_recording(tmp_path / "presses.csv")
    assert (len(found.quiet), len(found.frames)) == (10, 40)


def test_press_data_that_cannot_be_are_refused_in_words(tmp_path: Path) -> None:
    given = flawed_skin(39, 3)
    for change, match in (
        ("# values = volts\n", "values = 'volts'; choose from voltages, magnitudes, differences"),
        ("# first = 2\n", "first = 2; electrodes are counted from 0 or 1"),
    ):
        with pytest.raises(DataError, match=match):
            read_recording(table(given, tmp_path / "presses.csv", header=change))
    file = tmp_path / "alone.csv"
    file.write_text("x,y,a,b,c\n0.1,0.1,1,2,3\n")
    with pytest.raises(DataError, match=r"3 values a frame and no pattern; .*Put a table"):
        read_recording(file)
    file.write_text("x,y,force,a,b,c\n,,0,1,2,3\n")
    with pytest.raises(DataError, match="has no press: no row has a place, or a force above 0"):
        read_recording(file)
    savemat(tmp_path / "p.mat", {"voltages": np.ones((5, 208)), "positions": np.ones((4, 2))})
    with pytest.raises(DataError, match=r"voltages have shape \(208, 5\) for 4 positions"):
        read_recording(tmp_path / "p.mat")
    with pytest.raises(DataError, match=r"3 presses were detected whose places are known, at 3 places; .*press 8"):
        learn_positions(given.pattern, given.positions, np.zeros((3, 208)), given.positions, 0.2)
