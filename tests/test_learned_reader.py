"""The learned reader: one contact, corrected by a map learned from presses, physics for all that is unlike those."""

from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from flawed import Flawed, flawed_skin

from ohmskin.arrays import Floats
from ohmskin.calibrate import judge_channels, learn_positions, read_places
from ohmskin.drive import Fixed
from ohmskin.errors import ModelError
from ohmskin.scan import DrivePattern, Frame
from ohmskin.sensing import Diagnosis, Percept, Sensor, SkinModel, build, mode_named, modes
from ohmskin.skin import Skin

TAUGHT, PRESSES = 150, 230


@cache
def learned() -> tuple[Flawed, Skin]:
    """A flawed skin, and its description with what was learned from its first presses."""
    given = flawed_skin(61, PRESSES)
    judged = judge_channels(given.skin, given.quiet, given.frames[:TAUGHT])
    skin = replace(given.skin, calibration=judged.put_into(given.skin.calibration))
    known = SkinModel(skin, skin.transfer_model(), given.quiet)
    found, changes = read_places(known, given.frames[:TAUGHT])
    report = learn_positions(given.pattern, found, changes, given.positions[:TAUGHT], 0.2)
    return given, replace(skin, calibration=replace(skin.calibration, position_map=report.map.dump()))


@cache
def sensor(name: str) -> Sensor:
    given, skin = learned()
    known = SkinModel(skin, skin.transfer_model(), given.quiet)
    return build(mode_named(skin, name), known, Fixed(given.pattern))


def seen(used: Sensor, frame: Frame) -> Percept:
    return used.step(used.start(), lambda _: frame)[1]


def errors(used: Sensor, frames: list[Frame], places: Floats) -> tuple[Floats, list[Percept]]:
    """How far the strongest contact of each frame is from its place (m); infinite without one."""
    percepts = [seen(used, frame) for frame in frames]
    at = [one.detections[0].position if one.detections else (np.inf, np.inf) for one in percepts]
    return np.linalg.norm(np.array(at) - places, axis=1), percepts


def test_the_mode_is_there_once_presses_have_taught() -> None:
    given, skin = learned()
    assert "16L" in modes(skin)
    assert "16L" not in modes(given.skin)
    known = SkinModel(given.skin, given.skin.transfer_model(), given.quiet)
    with pytest.raises(ModelError, match="no position map; learn one from presses"):
        build(replace(modes(skin)["16L"], name="mine"), known)


def test_unseen_presses_are_where_they_are_with_missing_channels_and_in_another_order_too() -> None:
    given, skin = learned()
    unseen, places = given.frames[TAUGHT:], given.positions[TAUGHT:]
    plain = replace(skin, calibration=replace(skin.calibration, position_map=""))
    known = SkinModel(plain, plain.transfer_model(), given.quiet)
    physics = np.linalg.norm(read_places(known, unseen)[0] - places, axis=1)
    whole, percepts = errors(sensor("16L"), unseen, places)
    assert np.mean(whole) < 0.75 * np.mean(physics)
    assert np.mean([one.belief.novel == 0 for one in percepts]) > 0.9  # told by what was learned
    inside = [
        away**2 < 4.605 * np.trace(one.detections[0].covariance) / 2 for away, one in zip(whole, percepts, strict=True)
    ]
    assert np.mean(inside) > 0.7  # of a recording that drifts, at its end
    random = np.random.default_rng(0)
    holes = [replace(one, voltages=np.where(random.random(208) < 0.1, np.nan, one.voltages)) for one in unseen[:40]]
    assert np.mean(errors(sensor("16L"), holes, places[:40])[0]) < 1.3 * np.mean(whole[:40])
    pattern = given.pattern
    turned = DrivePattern(
        pattern.injections,
        pattern.measurements[::-1][np.argsort(pattern.measurements[::-1, 0], kind="stable")][:, [0, 2, 1]],
    )
    at = [int(np.flatnonzero((pattern.quadruples == row[[0, 1, 3, 2]]).all(axis=1))[0]) for row in turned.quadruples]
    other = [Frame(turned, -one.voltages[at], one.currents, time=one.time) for one in unseen[:20]]
    np.testing.assert_allclose(errors(sensor("16L"), other, places[:20])[0], whole[:20], atol=2e-5)


def test_two_presses_and_data_not_of_the_skin_are_left_to_physics_and_told_in_words() -> None:
    given, _ = learned()
    rest = np.mean([one.voltages for one in given.quiet], axis=0)
    used = sensor("16L")
    first, second = given.frames[TAUGHT : TAUGHT + 40], given.frames[TAUGHT + 40 :]
    far = np.linalg.norm(given.positions[TAUGHT : TAUGHT + 40] - given.positions[TAUGHT + 40 :], axis=1) > 50e-3
    both = [replace(a, voltages=a.voltages + b.voltages - rest) for a, b in zip(first, second, strict=True)]
    pairs = [seen(used, one) for one, apart in zip(both, far, strict=True) if apart]
    assert np.mean([len(one.detections) == 2 for one in pairs]) > 0.5
    assert all(one.belief.novel > 0 for one in pairs if len(one.detections) == 2)
    state, told = used.start(), set()
    frames = [one for one, apart in zip(both, far, strict=True) if apart]
    pair = next(one for one, percept in zip(frames, pairs, strict=True) if len(percept.detections) == 2)
    for k in range(8):
        state, percept = used.step(state, lambda _, k=k: replace(pair, time=0.1 * k))
        told |= {finding.words for finding in percept.findings}
    assert any("outliers of the presses" in words for words in told)
    random = np.random.default_rng(1)
    for frame in first[:10]:
        strange = replace(frame, voltages=rest + random.permutation(frame.voltages - rest))
        assert all(contact.confidence <= 0.5 for contact in seen(used, strange).detections)


def _at(frame: Frame, time: float, _: DrivePattern) -> Frame:
    return replace(frame, time=time)


def test_frames_like_those_learned_from_are_examined_for_faults_in_their_turn_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given, _ = learned()
    used = sensor("16L")
    examine, examined = used.detector.examine, list[Diagnosis]()

    def counted(before: Diagnosis, *others: Any) -> Any:
        examined.append(before)
        return examine(before, *others)

    monkeypatch.setattr(used.detector, "examine", counted)
    state, contacts = used.start(), 0
    for k, frame in enumerate(given.frames[:48]):  # before it drifts
        state, percept = used.step(state, partial(_at, frame, 0.03 * k))
        contacts += percept.belief.novel == 0 and bool(percept.detections)
    assert contacts > 40
    assert 6 <= len(examined) <= 20  # one in eight, and those that are outliers
