"""Sensors: any drive with any reader, any estimator; modes of a skin's own; parts that others register."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin import registry
from ohmskin.arrays import Floats, changed
from ohmskin.device import Feature
from ohmskin.device.demo import demo_finger
from ohmskin.drive import DRIVES, Drive, DriveSettings, Fixed, Target, part_of
from ohmskin.engine import Engine
from ohmskin.errors import ModelError, OhmskinError, PatternError, SkinError
from ohmskin.evaluate import worlds
from ohmskin.evaluate.setup import setup
from ohmskin.evaluate.shapes import disc
from ohmskin.inverse import PRIORS, RULES, graph_laplacian
from ohmskin.inverse.estimators import ESTIMATORS, EstimatorSettings
from ohmskin.scan import Baseline, Difference, DrivePattern, Frame, adjacent
from ohmskin.sensing import (
    DEFAULT,
    MODES,
    READERS,
    RECORDED,
    Sensor,
    SkinModel,
    build,
    default_mode,
    drive_of,
    mode_named,
    modes,
    perceive,
)
from ohmskin.sensing.model import kinds_of_noise
from ohmskin.sensing.quiet import QuietScans
from ohmskin.skin import Mode, Skin, VirtualSkin, shipped_skins
from ohmskin.tracking import TrackState

PAPER = Skin.load("paper")
PLACES = [(0.055, 0.12), (0.14, 0.05)]


@cache
def drive_named(name: str) -> Drive:
    return drive_of(Mode(name, name, "centroid"), PAPER)


@cache
def known(size: float = PAPER.imaging.mesh_size) -> SkinModel:
    """The quiet skin: a few frames of every pattern that some drive asks for; of less than eight of each, thresholds
    are predicted and not learned."""
    twin = VirtualSkin(PAPER, seed=11)
    patterns = {p: None for name in DRIVES for p in drive_named(name).patterns}
    skin = replace(PAPER, imaging=replace(PAPER.imaging, mesh_size=size))
    return SkinModel(skin, skin.transfer_model(), [twin.scan(p) for p in patterns for _ in range(3)])


@cache
def sensor(drive: str, reader: str) -> Sensor:
    return build(Mode("any", drive, reader), known(), drive_named(drive))


def misses(used: Sensor, places: list[tuple[float, float]], frames: int = 3) -> list[float]:
    """Distance (m) of the contact reported after so many frames of a press at each place."""
    twin, found = VirtualSkin(PAPER, seed=12), []
    for at in places:
        twin.press(0, *at, 8e-3, 20e3)
        state, percept = used.start(), None
        for _ in range(frames):
            state, percept = used.step(state, twin.scan)
        twin.press(0, *at, 8e-3, 0.0)
        assert percept is not None
        assert len(percept.contacts) == 1, f"{at}: {percept.contacts}"
        found.append(float(np.hypot(*np.subtract(percept.contacts[0].position, at))))
    return found


def quiet(used: Sensor, frames: int = 4) -> int:
    """Contacts reported on the untouched skin."""
    twin, state, count = VirtualSkin(PAPER, seed=13), used.start(), 0
    for _ in range(frames):
        state, percept = used.step(state, twin.scan)
        count += len(percept.contacts)
    return count


# --- any drive with any reader ----------------------------------------------------------------------------------------

BOUNDS = {"centroid": 12e-3, "fit": 4e-3, "tracked": 4e-3}  # of the rim alone, the centroid errs most


@pytest.mark.parametrize("reader", BOUNDS)  # `learned` needs a skin that has learned: test_learned_reader.py
@pytest.mark.parametrize("drive", DRIVES)
def test_any_drive_goes_with_any_reader(drive: str, reader: str) -> None:
    used = sensor(drive, reader)
    few = used.drive.injections < 12  # a frame shows little then, and several tell
    found = misses(used, PLACES[:1], 12 if few else 5 if reader == "tracked" else 3)
    assert max(found) < BOUNDS[reader], f"{1e3 * max(found):.1f} mm"
    assert quiet(used) == 0


def test_frames_far_apart_and_times_that_go_back_count_as_a_second() -> None:
    class Noting:
        """Notes how much time it is told has passed."""

        def update(self, before: Any, new: Any, recent: Any, elapsed: float) -> Any:
            passed.append(elapsed)
            return inner.update(before, new, recent, elapsed)

        def __getattr__(self, name: str) -> Any:
            return getattr(inner, name)

    used, twin, passed = build(Mode("any", "rim", "fit"), known(), drive_named("rim")), VirtualSkin(PAPER, seed=12), []
    inner, state = used.reader, used.start()
    used.reader = Noting()  # type: ignore[assignment]
    for now in (3.0, 3.25, 10.0, 9.0, 9.5):
        state, _ = used.step(state, lambda p, now=now: replace(twin.scan(p), time=now))  # type: ignore[misc]
    assert passed == [1.0, 0.25, 1.0, 1.0, 0.5]


def test_while_tracking_images_are_made_of_as_many_injections_as_an_optimal_scan_has() -> None:
    """Frames of a few injections each: they follow each other faster than fingers move."""
    used, twin = sensor("tracking", "tracked"), VirtualSkin(PAPER, seed=12)
    twin.press(0, *PLACES[0], 8e-3, 20e3)
    state = used.start()
    for _ in range(8):
        state, percept = used.step(state, twin.scan)
    tracks, estimator = state.belief.tracks, used.reader.estimator
    assert isinstance(tracks, TrackState)
    recent = [difference.undriven for difference in tracks.recent(PAPER.imaging.pairs)]
    assert sum(difference.pattern.n_inj for difference in recent) >= PAPER.imaging.pairs > recent[0].pattern.n_inj
    expected = estimator.update(estimator.start(), recent[:1], recent, 0.0).image.values
    np.testing.assert_allclose(percept.image.values, expected, rtol=1e-9, atol=1e-12)


def test_a_combination_without_sense_is_refused_in_words() -> None:
    bent = Skin.parse('[electrode]\nlayout = "rim"\ncount = 8\n')
    with pytest.raises(PatternError, match="drive 'rings' needs electrodes inside the sheet"):
        drive_of(Mode("mine", "rings", "fit"), bent)
    with pytest.raises(PatternError, match=r"5 injections a frame; the base scan alone has 12"):
        drive_of(Mode("mine", "eq7", "fit", injections=5), PAPER)
    with pytest.raises(PatternError, match=r"a fixed pattern has no choice of injections; it has 12"):
        drive_of(Mode("mine", "rim", "fit", injections=5), PAPER)
    with pytest.raises(PatternError, match="needs the responses of contacts"):
        DRIVES["best"](DriveSettings(PAPER.electrodes), 4)


# --- estimators, priors, rules ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_any_estimator_finds_a_press_and_none_on_quiet_frames(estimator: str) -> None:
    used = build(Mode("any", "rings", "centroid", estimator), known(9e-3))
    assert max(misses(used, PLACES[:1])) < 12e-3
    assert quiet(used, 3) == 0


@pytest.mark.parametrize("estimator", ["positive", "absolute"])
def test_estimators_with_a_quadratic_prior_take_any_rule(estimator: str) -> None:
    twin, pattern = VirtualSkin(PAPER, seed=12), adjacent(PAPER.electrodes.rings)
    twin.press(0, *PLACES[0], 8e-3, 20e3)
    change = known(9e-3).difference(twin.scan(pattern))
    images = []
    for rule in ("physical", "l-curve"):
        made = known(9e-3).estimator(estimator, "paper", rule)
        images.append(made.update(made.start(), [change], [change], 0.0).image.values)
    at = known(9e-3).model.mesh.centroids[images[1].argmax()]
    assert np.hypot(*(at - PLACES[0])) < 12e-3
    assert np.abs(images[1] - images[0]).max() > 0.02 * np.abs(images[0]).max()  # another amplitude


@pytest.mark.parametrize("estimator", ["kalman", "greit", "total-variation", "sparse-bayes", "absolute-variation"])
def test_estimators_without_a_parameter_for_a_rule_refuse_it_in_words(estimator: str) -> None:
    with pytest.raises(ModelError, match=f"{estimator}' does not support the rule 'l-curve'.*or use 'physical'"):
        known(9e-3).estimator(estimator, "paper", "l-curve")


@pytest.mark.parametrize("estimator", ["greit", "total-variation", "sparse-bayes", "absolute-variation"])
def test_estimators_with_a_prior_of_their_own_refuse_another_in_words(estimator: str) -> None:
    with pytest.raises(ModelError, match=f"{estimator}' has its own prior and cannot use 'laplacian'; .*leave it out"):
        known(9e-3).estimator(estimator, "laplacian")


@pytest.mark.parametrize("rule", RULES)
def test_any_rule_finds_a_press(rule: str) -> None:
    """Where the image is highest; the L-curve makes so much of noise that its threshold exceeds a press."""
    mode = RECORDED.using(rule=rule)
    at, twin, pattern = PLACES[0], VirtualSkin(PAPER, seed=12), adjacent(PAPER.electrodes.rings)
    twin.press(0, *at, 8e-3, 20e3)
    percept = perceive(known(), twin.scan(pattern), mode)
    centroids = known().model.mesh.centroids
    assert np.hypot(*(centroids[percept.image.values.argmax()] - at)) < 15e-3
    if rule != "l-curve":
        assert np.hypot(*np.subtract(percept.detections[0].position, at)) < 12e-3


@pytest.mark.parametrize("prior", [*PRIORS, "pixels"])
def test_any_prior_makes_an_image(prior: str) -> None:
    at, twin = PLACES[0], VirtualSkin(PAPER, seed=12)
    twin.press(0, *at, 8e-3, 20e3)
    used = build(RECORDED.using(prior=prior), known(), Fixed(adjacent(PAPER.electrodes.rings)))
    image = used.step(used.start(), twin.scan)[1].image.values
    mesh = used.known.model.mesh
    assert image.shape == (mesh.n_elem,)  # of pixels, too: what is shown, recorded and published is of the mesh
    assert np.hypot(*(mesh.centroids[image.argmax()] - at)) < 15e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"drive": "x"}, "no drive 'x'; choose from rim, rings, opposite, best, eq7, local, position, tracking"),
        ({"reader": "x"}, "no reader 'x'; choose from centroid, fit, consensus, tracked"),
        ({"estimator": "x"}, "no estimator 'x'; choose from gauss-newton, positive, kalman, greit"),
        ({"prior": "x"}, "no prior 'x'; choose from paper, laplacian, tikhonov, noser, matern"),
        ({"rule": "x"}, "no rule 'x'.*; choose from physical, noise figure, cross-validation"),
    ],
)
def test_an_unknown_name_lists_the_choices(change: dict, message: str) -> None:
    with pytest.raises((PatternError, ModelError), match=message):
        build(replace(mode_named(PAPER, "16O"), **change), known())


def test_the_kalman_filter_carries_its_belief_from_frame_to_frame() -> None:
    used, twin = build(Mode("any", "rotating", "centroid", "kalman"), known()), VirtualSkin(PAPER, seed=12)
    twin.press(0, *PLACES[0], 8e-3, 20e3)
    state, spread, peak = used.start(), [], []
    for _ in range(6):
        state, percept = used.step(state, twin.scan)
        belief = percept.belief.estimate
        spread.append(float(np.trace(belief.covariance)))  # type: ignore[attr-defined]
        peak.append(float(percept.image.values.max()))
    assert spread[1] < spread[0]  # the second frame adds to what the first one told
    assert peak[-1] > peak[0]
    fresh = used.step(used.start(), twin.scan)[1].belief.estimate
    assert np.trace(fresh.covariance) > 1.02 * spread[-1]  # type: ignore[attr-defined]


# --- modes ------------------------------------------------------------------------------------------------------------

MINE = '[modes.mine]\ndrive = "opposite"\nreader = "fit"\nprior = "matern"\ntitle = "My own"\n'


def test_a_skin_file_may_define_a_mode_of_its_own() -> None:
    skin = Skin.parse(MINE)
    mode = modes(skin)["mine"]
    assert mode == Mode("mine", "opposite", "fit", prior="matern", title="My own")
    assert Skin.parse(skin.dump()) == skin
    assert list(modes(skin))[-1] == "mine"
    twin, pattern = VirtualSkin(skin, seed=11), drive_of(mode, skin).next([], 0)
    used = build(mode, SkinModel(skin, skin.transfer_model(), [twin.scan(pattern) for _ in range(8)]))
    assert max(misses(used, PLACES[:1])) < BOUNDS["fit"]


def test_a_mode_of_its_own_may_replace_one_that_ships() -> None:
    skin = Skin.parse('[modes.16P]\ndrive = "rim"\nreader = "centroid"\n')
    assert modes(skin)["16P"].drive == "rim"
    assert mode_named(skin, "").name == "16P"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[modes.mine]\ndrive = "rim"\n', "modes.mine does not say its reader; add reader"),
        ('[modes.mine]\nreader = "fit"\n', "modes.mine does not say its drive; add drive"),
        ('[modes.mine]\ndrive = "rim"\nreader = "fit"\nspeed = 3\n', "unknown entry modes.mine.speed; choose from"),
        ('[modes.mine]\ndrive = "rim"\nreader = 3\n', "modes.mine.reader is 3; it must be text"),
        ('[modes.mine]\ndrive = "rim"\nreader = "fit"\nfuse = 1\n', "modes.mine.fuse is 1; it must be true or false"),
        (
            '[modes.mine]\ndrive = "rim"\nreader = "fit"\ninjections = -1\n',
            r"modes.mine.injections is -1; it must be 0",
        ),
        (
            '[modes.mine]\ndrive = "rim"\nreader = "fit"\ninjections = "4"\n',
            "modes.mine.injections is '4'; it must be a whole number",
        ),
        ("modes = 3\n", r"modes is 3; it must be tables \[modes.NAME\]"),
        ("[modes]\nmine = 3\n", r"modes.mine is 3; it must be a table \[modes.mine\]"),
    ],
)
def test_wrong_entries_of_a_mode_are_named(text: str, message: str) -> None:
    with pytest.raises(SkinError, match=message):
        Skin.parse(text)


@pytest.mark.parametrize("name", shipped_skins())
def test_every_shipped_skin_has_the_default_mode(name: str) -> None:
    skin = Skin.load(name)
    assert mode_named(skin, "").name == default_mode(skin)
    for mode in modes(skin).values():
        assert mode.title
        assert mode.summary.endswith(".")
        assert "{" not in mode.name + mode.summary
        drive_of(mode, skin).next([], 0).check(len(skin.electrodes))


# --- what others register ---------------------------------------------------------------------------------------------


def twice_the_noise(settings: EstimatorSettings):
    """Gauss-Newton that trusts the data half as much."""
    return ESTIMATORS["gauss-newton"](replace(settings, noise=2 * settings.noise))


def first_pairs(settings: DriveSettings, injections: int) -> Fixed:
    """Both rings, registered by another package."""
    return Fixed(adjacent(settings.electrodes.rings))


def only_centroids(known: SkinModel, estimator, threshold: float):
    """Centroids, registered by another package."""
    return READERS["centroid"](known, estimator, threshold)


def as_described(estimator, *differences, **settings):
    """The amplitude as it is, registered by another package."""
    return RULES["physical"](estimator, *differences, **settings)


def smooth_prior(model):
    """Smoothness, registered by another package."""
    return graph_laplacian


def test_a_package_that_cannot_be_loaded_is_told_and_hides_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = EntryPoint("broken", "no_such_package:estimator", "ohmskin.estimators")
    monkeypatch.setattr(registry, "entry_points", lambda group: [broken] if group == broken.group else [])
    why = r"estimator 'broken' \(no_such_package:estimator\) does not work: ModuleNotFoundError: .*; ask who made it"
    assert re.match(why, ESTIMATORS.title("broken"))
    assert {*ESTIMATORS} > {"broken", "kalman"}
    with pytest.raises(ModelError, match=why):
        ESTIMATORS["broken"]


def returns_none(*_):
    """None, by another package."""


def fails(*_):
    """A KeyError, by another package."""
    return {}["gain"]


def fails_late(settings, *_):
    """An estimator, a drive or a reader that fails when it is used, by another package."""
    drive = {"patterns": (adjacent([range(12)]),), "scans": 1, "injections": 12, "adjustable": False, "next": fails}
    reader = {"cells": PAPER.transfer_model().mesh, "estimator": None, "start": fails, "update": fails}
    return SimpleNamespace(**drive, **reader, with_injections=fails)


@pytest.mark.parametrize(("noun", "table"), [("drive", DRIVES), ("reader", READERS), ("estimator", ESTIMATORS)])
@pytest.mark.parametrize(
    ("made", "why"),
    [
        ("returns_none", "returned None, which is no "),
        ("fails", r"does not work: KeyError: 'gain' \(test_sensing.py:"),
        ("fails_late", r"does not work: KeyError: 'gain' \(test_sensing.py:"),
        ("PLACES", r"is \[\(.*\)\], which is no function"),
    ],
)
def test_a_package_that_fails_is_named(
    monkeypatch: pytest.MonkeyPatch, noun: str, table: registry.Registry[Any], made: str, why: str
) -> None:
    entry = EntryPoint(made, f"{__name__}:{made}", table.group)
    monkeypatch.setattr(registry, "entry_points", lambda group: [entry] if group == table.group else [])
    with pytest.raises(OhmskinError, match=rf"^{noun} '{made}' \({__name__}:{made}\) {why}"):
        build(replace(Mode("any", "rim", "centroid"), **{noun: made}), known())


def test_a_package_is_named_whose_code_raises_outside_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint("theirs", f"{__name__}:fails_late", ESTIMATORS.group)
    monkeypatch.setattr(registry, "entry_points", lambda group: [entry] if group == ESTIMATORS.group else [])
    monkeypatch.setattr(registry, "_CALLED", {})
    late = ESTIMATORS["theirs"](None)
    with pytest.raises(ModelError, match=r"estimator 'theirs' .*KeyError: 'gain'"), registry.naming(whoever=True):
        late.start()
    with pytest.raises(ZeroDivisionError), registry.naming():
        1 / 0  # noqa: B018


def test_a_name_that_two_things_have_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint("kalman", f"{__name__}:twice_the_noise", ESTIMATORS.group)
    monkeypatch.setattr(registry, "entry_points", lambda group: [entry] if group == ESTIMATORS.group else [])
    with pytest.raises(ModelError, match=r"'kalman' is ambiguous: ohmskin's own and .*; uninstall one"):
        ESTIMATORS["kalman"]
    assert "greit" in ESTIMATORS
    assert [*ESTIMATORS].count("kalman") == 1


def test_other_packages_add_theirs_by_entry_points(monkeypatch: pytest.MonkeyPatch) -> None:
    offered = {
        "ohmskin.drives": "first_pairs",
        "ohmskin.readers": "only_centroids",
        "ohmskin.estimators": "twice_the_noise",
        "ohmskin.priors": "smooth_prior",
        "ohmskin.rules": "as_described",
    }

    def entry_points(group: str) -> list[EntryPoint]:
        return [EntryPoint("theirs", f"{__name__}:{offered[group]}", group)] if group in offered else []

    monkeypatch.setattr(registry, "entry_points", entry_points)
    for table, title in (
        (DRIVES, "Both rings"),
        (READERS, "Centroids"),
        (ESTIMATORS, "Gauss-Newton"),
        (PRIORS, "Smooth"),
        (RULES, "The amplitude as it is"),
    ):
        assert "theirs" in table
        assert list(table)[-1] == "theirs"
        assert table.title("theirs").startswith(title)
    used = build(Mode("mine", "theirs", "theirs", "theirs", "theirs"), known())
    assert max(misses(used, PLACES[:1], 4)) < 15e-3
    used = build(Mode("ruled", "theirs", "theirs", "gauss-newton", "theirs", "theirs"), known())
    assert max(misses(used, PLACES[:1], 4)) < 15e-3
    with pytest.raises(PatternError, match=r"no drive 'x'; choose from .*, theirs"):
        DRIVES["x"]


# --- one step ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("drive", "reader"), [("eq7", "centroid"), ("position", "fit"), ("tracking", "tracked")])
def test_the_same_state_and_frames_give_the_same_percept(drive: str, reader: str) -> None:
    used, twin, frames = sensor(drive, reader), VirtualSkin(PAPER, seed=12), []
    twin.press(0, *PLACES[0], 8e-3, 20e3)
    state = used.start()
    for _ in range(8):
        state, _ = used.step(state, twin.scan)

    def scan(pattern: DrivePattern) -> Frame:
        frames.append(twin.scan(pattern))
        return frames[-1]

    after, first = used.step(state, scan)
    used.step(after, twin.scan)  # another step between leaves nothing behind
    replayed = iter(list(frames))
    again, second = used.step(state, lambda _: next(replayed))
    assert first.contacts == second.contacts
    assert first.detections == second.detections
    assert (after.turn, after.time) == (again.turn, again.time)
    np.testing.assert_array_equal(first.image.values, second.image.values)


@pytest.mark.parametrize("scan_with_a_hole", [0, 1])
def test_a_missing_channel_is_no_reason_to_change_method(scan_with_a_hole: int) -> None:
    """Read with one voltage missing, compiled or not: the same frames, the same image, the same contacts."""
    used, twin = sensor("eq7", "centroid"), VirtualSkin(PAPER, seed=12)
    assert used.implementation is not None
    plain = used.with_drive(used.drive)
    plain.implementation = None
    twin.press(0, *PLACES[0], 8e-3, 20e3)
    frames: list[Frame] = []

    def scan(pattern: DrivePattern) -> Frame:
        frame = twin.scan(pattern)
        if len(frames) == scan_with_a_hole:
            frame = replace(frame, voltages=np.where(np.arange(pattern.n_meas) == 17, np.nan, frame.voltages))
        frames.append(frame)
        return frame

    _, quick = used.step(used.start(), scan)
    assert len(frames) == 2  # none was measured twice
    replayed = iter(frames)
    _, slow = plain.step(plain.start(), lambda _: next(replayed))
    for a, b in ((quick.image, slow.image), (quick.base_image, slow.base_image)):
        np.testing.assert_allclose(a.values, b.values, rtol=0, atol=1e-4 * np.abs(b.values).max())
    (found,), (expected,) = quick.detections, slow.detections
    np.testing.assert_allclose(found.position, expected.position, atol=1e-5)
    whole = used.step(used.start(), lambda pattern: twin.scan(pattern))[1]
    np.testing.assert_allclose(found.position, whole.detections[0].position, atol=2e-3)


@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_quiet_frames_are_learned_from_although_the_first_of_them_is_lost(lost: float) -> None:
    twin, pattern = VirtualSkin(PAPER, seed=2), adjacent(PAPER.electrodes.rings)
    sound = [twin.scan(pattern) for _ in range(5)]
    spoilt = [replace(sound[0], voltages=np.full(pattern.n_meas, lost)), *sound]
    found, expected = (SkinModel(PAPER, known().model, quiet) for quiet in (spoilt, sound))
    assert found.noise == pytest.approx(expected.noise, rel=1e-9)
    np.testing.assert_allclose(found.difference(sound[0]).volts, expected.difference(sound[0]).volts, atol=1e-12)


def test_a_pattern_that_was_not_seen_quiet_is_refused() -> None:
    some = adjacent([PAPER.electrodes.rings[0]])
    twin = VirtualSkin(PAPER, seed=11)
    little = SkinModel(PAPER, PAPER.transfer_model(), [twin.scan(some) for _ in range(2)])
    assert little.quiet.scan(some, 1).pattern == some
    with pytest.raises(PatternError, match=r"no quiet reference for source, sink, plus, minus = .*; calibrate with"):
        little.quiet.scan(adjacent(PAPER.electrodes.rings), 0)
    with pytest.raises(PatternError, match="no quiet reference"):
        build(mode_named(PAPER, "16I"), little)
    with pytest.raises(PatternError, match="no quiet reference"):
        perceive(little, twin.scan(adjacent(PAPER.electrodes.rings)))


def test_the_default_mode_has_the_least_measured_error_of_those_that_ship() -> None:
    """As a geometric mean over the worlds of docs/modes.json, which the page docs/modes.md shows."""
    rows = json.loads((Path(__file__).parents[1] / "docs" / "modes.json").read_text())["rows"]
    drives = {"rim": "rim", "rings": "rings", "eq7": "eq7", "position": "position", "tracking": "tracking"}
    errors = {}
    for mode in MODES:
        reading = f"{mode.reader}, driven" if mode.driven else mode.reader
        own = [r["mean"] for r in rows if (r["drive"], r["reader"]) == (drives[mode.drive], reading)]
        assert len(own) == len({(r["world"], r["decibels"]) for r in rows})
        errors[mode.name] = float(np.exp(np.mean(np.log(own))))
    assert min(errors, key=lambda name: errors[name]) == DEFAULT
    assert default_mode(Skin.load("paper")) in (Path(__file__).parents[1] / "docs" / "modes.md").read_text()


@pytest.mark.parametrize("gain", [0.0, 2e-3])
def test_white_noise_and_errors_of_measured_currents_are_told_apart(gain: float) -> None:
    """Five seeds: the noise of a voltage, and the share by which all voltages of an injection err together."""
    skin = Skin.load("paper")
    pattern, sigma, repeats = adjacent(skin.electrodes.rings), 1e-4, 40
    quiet = skin.transfer_model().voltages(pattern, 1e-3)
    found = []
    for seed in range(5):
        random, frames = np.random.default_rng(seed), []
        for k in range(repeats):
            shares = (1 + gain * random.standard_normal(pattern.n_inj))[pattern.measurements[:, 0]]
            volts = quiet * shares + sigma * random.standard_normal(pattern.n_meas)
            frames.append(Frame(pattern, volts, np.full(pattern.n_inj, 1e-3), 0.01 * k))
        found.append(kinds_of_noise(Baseline.learn(frames), frames))
    white, share = np.mean(found, axis=0)
    # of a difference, which has the reference's own share of the noise
    assert white == pytest.approx(sigma * np.sqrt(1 + 1 / repeats), rel=0.02)
    assert share == pytest.approx(gain * np.sqrt(1 + 1 / repeats), rel=0.05, abs=1e-4)


CORNERS = [(0.012, 0.014), (0.187, 0.016), (0.013, 0.183), (0.184, 0.188)]


@pytest.mark.parametrize("mode", ["16P", "16T"])
def test_a_press_in_a_corner_is_placed_by_the_electrodes_that_carry_the_current(mode: str) -> None:
    """Fifteen frames each: without them the errors are 2 to 17 mm (docs/modes.md)."""
    device = DirectDevice(VirtualSkin(PAPER, seed=5))
    with Engine(lambda: device, PAPER, mode) as engine:
        engine.calibrate()
        assert engine.known is not None
        assert engine.known.quiet.driven is not None
        for at in CORNERS:
            engine.press(1, at, 8e-3, 20e3)
            touch = [engine.step() for _ in range(15)][-1]
            assert touch is not None
            assert all(frame.pattern.driven.any() for frame in touch.percept.frames)
            (contact,) = touch.contacts
            assert np.hypot(*np.subtract(contact.position, at)) < 3e-3
            engine.press(1, at, 8e-3, 0.0)
            assert not [engine.step() for _ in range(15)][-1].contacts  # type: ignore[union-attr]
        assert all(not engine.step().contacts for _ in range(200))  # type: ignore[union-attr]


def test_a_device_that_cannot_measure_driven_electrodes_does_without() -> None:
    device = DirectDevice(VirtualSkin(PAPER, seed=5))
    device.capabilities = replace(device.capabilities, features=Feature.VIRTUAL)
    with Engine(lambda: device, PAPER) as engine:
        engine.calibrate()
        engine.press(1, PLACES[0], 8e-3, 20e3)
        touch = [engine.step() for _ in range(8)][-1]
        assert touch is not None
        assert not any(frame.pattern.driven.any() for frame in touch.percept.frames)
        assert np.hypot(*np.subtract(touch.contacts[0].position, PLACES[0])) < 3e-3


@pytest.mark.parametrize("change", [0.9, 1.2])
def test_a_change_of_all_contact_impedances_moves_no_contact(change: float) -> None:
    """At 50 dB, 3.5 ohm when calibrated. Not yet at a fifth less.

    Of forty quiet frames two or three show a contact then, fifteen without driven electrodes.
    """
    noise = worlds.noise_volts("pressed", 50)

    def scanner(resistance: np.ndarray, seed: int) -> Callable[[DrivePattern], Frame]:
        random = np.random.default_rng(seed)

        def scan(pattern: DrivePattern) -> Frame:
            volts = worlds.voltages(resistance, pattern) + noise * random.standard_normal(pattern.n_meas)
            return Frame(pattern, volts, np.full(pattern.n_inj, worlds.CURRENT), 0.0)

        return scan

    mode = Mode("driven", "best", "fit", injections=28, driven=True)
    calm = scanner(worlds.sheet("pressed", "grid").untouched, 1)
    (pattern,) = drive_of(mode, PAPER).patterns
    sensor = build(mode, SkinModel(PAPER, PAPER.transfer_model(), [calm(pattern) for _ in range(40)]))
    errors = []
    for seed, at in enumerate([*PLACES, *CORNERS[:2]]):
        pressed = worlds.touched("pressed", "grid", (worlds.contact("pressed", *at),), change)
        _, percept = sensor.step(sensor.start(), scanner(pressed, seed))
        assert len(percept.detections) == 1
        errors.append(np.hypot(*np.subtract(percept.detections[0].position, at)))
    assert np.mean(errors) < 2e-3
    changed = worlds.sheet("pressed", "grid", change).untouched
    assert not any(sensor.step(sensor.start(), scanner(changed, 100 + k))[1].detections for k in range(20))


def test_quiet_scans_take_what_a_pattern_drives_twice_from_two_repeats() -> None:
    one = adjacent([range(8)])
    quiet = QuietScans([Frame(one, np.full(one.n_meas, float(k)), np.ones(one.n_inj), 0.0) for k in range(10)])
    twice = part_of(one, np.array([2, 2]))
    volts = quiet.scan(twice, 1).voltages.reshape(2, -1)
    assert volts[0, 0] == 1.0
    assert volts[1, 0] not in (volts[0, 0], 0.0)


@pytest.mark.parametrize("place", [(0.0637, 0.1440), (0.1359, 0.1232), (0.1306, 0.1361), (0.0349, 0.0871)])
def test_a_hard_press_is_one_contact_over_an_electrode_too(place: tuple[float, float]) -> None:
    """Under it a response, singular at electrodes, says far too much of the electrode's own resistance.

    Of the 24 places of docs/policies.md, three that had failed and one that had not; one at the rim may still be two.
    """
    where = setup("pressed", 50.0)
    (contact,) = where.simulate(modes(where.skin)["16P"], (disc(*place, 25e-3, 20e3),), 0).contacts
    np.testing.assert_allclose(contact.position, place, atol=2.5e-3)
    assert contact.radius > 20e-3


def test_of_more_contacts_than_are_looked_for_none_is_sure() -> None:
    mode, twin = modes(PAPER)["16P"], VirtualSkin(PAPER, seed=5)
    patterns = drive_of(mode, PAPER).patterns
    sensor = build(mode, SkinModel(PAPER, PAPER.transfer_model(), [twin.scan(p) for _ in range(20) for p in patterns]))
    places = [(x, y) for y in (0.03, 0.1, 0.17) for x in (0.03, 0.1, 0.17)]

    def confidences(count: int) -> list[float]:
        """Those of each contact of the last of a dozen frames."""
        state = sensor.start()
        for number, (x, y) in enumerate(places):
            twin.press(number, x, y, 6e-3, 25e3 if number < count else 0.0)
        for _ in range(12):
            state, percept = sensor.step(state, twin.scan)
        return [contact.confidence for contact in percept.contacts]

    assert confidences(6) == [1.0] * 6
    assert max(confidences(8), default=0.0) == 0.0


def test_data_that_are_not_of_the_skin_make_no_contact_that_is_sure() -> None:
    skin, pattern = Skin.load("paper-rim16"), adjacent([range(16)])
    virtual, random = VirtualSkin(skin, seed=3), np.random.default_rng(4)
    quiet = [virtual.scan(pattern) for _ in range(10)]
    known = SkinModel(skin, skin.transfer_model(), quiet)
    for trial in range(8):
        place = random.uniform(0.03, 0.17, 2)
        virtual.press(1, *place, radius=8e-3, pressure=20e3)
        frame = virtual.scan(pattern)
        virtual.press(1, *place, radius=8e-3, pressure=0.0)
        seen = perceive(known, frame)
        assert seen.belief.unexplained < 0.1
        assert seen.detections[0].confidence > 0.95
        changed = frame.voltages - quiet[0].voltages
        other = (
            random.permutation(changed) if trial % 2 else 0.02 * quiet[0].voltages * random.normal(size=len(changed))
        )
        strange = perceive(known, replace(frame, voltages=quiet[0].voltages + other))
        assert all(contact.confidence <= 0.5 for contact in strange.detections)
        assert not strange.detections or strange.belief.unexplained > 0.3


@pytest.mark.parametrize("drive", ["rim", "rings", "eq7"])  # the last one compiled
def test_live_images_of_a_press_on_another_skin_show_no_sure_contact(drive: str) -> None:
    """One whose electrodes are in another order: no current or voltage contradicts another one."""
    used, twin, random = sensor(drive, "centroid"), VirtualSkin(PAPER, seed=14), np.random.default_rng(5)

    def exchanged(pattern: DrivePattern, change: Floats) -> Frame:
        frame, (a, b, c, d) = twin.scan(pattern), pattern.quadruples.T
        caused = change[a, c] - change[a, d] - change[b, c] + change[b, d]
        return replace(frame, voltages=frame.voltages + frame.measurement_currents * caused)

    shown = sure = 0
    for trial in range(8):
        place, order = random.uniform(0.03, 0.17, 2), random.permutation(16) if trial else np.arange(16)
        contacts = (worlds.contact("pressed", *place),)
        change = (worlds.touched("pressed", "grid", contacts) - worlds.touched("pressed", "grid", ()))[order][:, order]
        state = used.start()
        for _ in range(5):
            state, percept = used.step(state, lambda pattern, change=change: exchanged(pattern, change))
            seen = (*percept.detections, *percept.contacts)
            shown += trial > 0 and len(seen)
            assert all((one.confidence <= 0.5) == (trial > 0) for one in seen)
        sure += trial == 0 and len(percept.contacts)
    assert shown
    assert sure == 1


@pytest.mark.parametrize("seed", [0, 3])
def test_a_finger_that_moves_within_its_frames_degrades_no_electrode(seed: int) -> None:
    """By up to 5 mm a frame: what the contact's model errs by beside it had been taken for a risen impedance."""
    mode, twin = modes(PAPER)["16P"], VirtualSkin(PAPER, seed)
    patterns = drive_of(mode, PAPER).patterns
    sensor = build(mode, SkinModel(PAPER, PAPER.transfer_model(), [twin.scan(p) for _ in range(50) for p in patterns]))
    now = 0.0

    def scan(pattern: DrivePattern) -> Frame:
        nonlocal now
        now += 0.025
        (x, y), radius, pressure = demo_finger(PAPER.domain, 165.4 + 2 * now)
        twin.press(0, x, y, radius, pressure)
        return replace(twin.scan(pattern), time=now)

    state = sensor.start()
    for _ in range(40):
        state, percept = sensor.step(state, scan)
        assert percept.findings == ()


def test_a_base_scan_that_shows_no_more_is_not_searched_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor a sheet that drifts, which contacts explain only in part: each frame had taken tens of milliseconds."""
    device = DirectDevice(VirtualSkin(Skin.load("paper"), seed=4))
    with Engine(lambda: device, Skin.load("paper"), "16P") as engine:
        engine.calibrate()
        assert engine.sensor is not None
        locator, pattern, known = engine.sensor.locator, engine.sensor.drive.patterns[0], engine.sensor.known

        def drifted() -> list[Difference]:
            frame = device.scan(pattern)
            wave = 4e-3 * np.cos(np.arange(pattern.n_meas))
            return [known.difference(replace(frame, voltages=(1 + wave) * frame.voltages))]

        def placed(targets: list[Target]) -> Floats:
            return np.array(sorted(tuple(one.position) for one in targets))

        scans, start = drifted(), engine.sensor.start().belief
        belief = changed(start, searched=0.1)
        targets, located = locator.targets(scans, locator.estimate(scans), start)
        assert located is not None
        assert len(located.params)
        assert located.poor > 3 * scans[0].volts.size  # in part alone
        with monkeypatch.context() as patch:
            patch.setattr(locator.fitter, "fit_information", lambda *_: pytest.fail("searched again"))
            for _ in range(5):
                again, located = locator.targets(drifted(), locator.estimate(scans), belief, located)
                assert np.linalg.norm(placed(again) - placed(targets), axis=1).max() < 1e-2  # as large as a contact is
        device.virtual.press(0, 0.05, 0.16, 8e-3, 20e3)
        more, found = locator.targets(drifted(), locator.estimate(scans), belief, located)
        assert found is not located
        assert np.linalg.norm(placed(more) - [0.05, 0.16], axis=1).min() < 5e-3
