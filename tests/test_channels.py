"""Channels are judged from presses without labels, and what is judged is used."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flawed import Flawed, flawed_skin

from ohmskin.arrays import Floats
from ohmskin.calibrate import judge_channels
from ohmskin.drive import Fixed
from ohmskin.errors import DataError, SkinError
from ohmskin.scan import Channels, Difference, adjacent
from ohmskin.sensing import RECORDED, SkinModel, build
from ohmskin.skin import Skin, VirtualSkin


def places(given: Flawed, skin: Skin, reader: str, count: int) -> Floats:
    """Where the strongest contact of each frame is; NaN where there is none."""
    known = SkinModel(skin, skin.transfer_model(), given.quiet)
    sensor = build(replace(RECORDED, reader=reader), known, Fixed(given.pattern))
    found = np.full((count, 2), np.nan)
    for k, frame in enumerate(given.frames[:count]):
        detections = sensor.step(sensor.start(), lambda _, frame=frame: frame)[1].detections
        if detections:
            found[k] = max(detections, key=lambda contact: abs(contact.strength)).position
    return found


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_presses_without_labels_make_a_flawed_skin_twice_as_good(seed: int) -> None:
    given = flawed_skin(seed, 150)
    judged = judge_channels(given.skin, given.quiet, given.frames)
    injections = given.pattern.injections[given.silent]
    for source, sink in injections:
        assert any(line.startswith(f"injection {source} to {sink}:") for line in judged.report())
    told = [line for line in judged.report() if line.startswith("injection")]
    assert len(told) <= len(injections) + 1
    assert judged.unexplained < 0.3 * judged.unexplained_before
    better = replace(given.skin, calibration=judged.put_into(given.skin.calibration))
    for reader in ("centroid", "fit"):
        before, after = (
            np.linalg.norm(places(given, skin, reader, 40) - given.positions[:40], axis=1)
            for skin in (given.skin, better)
        )
        assert np.isnan(after).sum() <= np.isnan(before).sum()
        assert np.nanmean(after) < 0.5 * np.nanmean(before)


@pytest.mark.parametrize("seed", [6, 16, 26])
def test_channels_the_other_way_round_are_told(seed: int) -> None:
    given = flawed_skin(seed, 120, silent=0, strange=0)
    turned = np.random.default_rng(1).random(given.pattern.n_meas) < 0.1
    frames = [
        replace(frame, voltages=np.where(turned, 2 * given.quiet[0].voltages - frame.voltages, frame.voltages))
        for frame in given.frames
    ]
    judged = judge_channels(given.skin, given.quiet, frames)
    sure = judged.channels.errors < 1.0
    assert sure.mean() > 0.6
    assert np.mean(judged.reversed[sure] == turned[sure]) >= 0.97


def test_all_of_them_turned_are_as_good() -> None:
    given = flawed_skin(7, 60)
    quiet = np.mean([frame.voltages for frame in given.quiet], axis=0)
    frames = [replace(frame, voltages=2 * quiet - frame.voltages) for frame in given.frames]
    one, other = (judge_channels(given.skin, given.quiet, some) for some in (given.frames, frames))
    np.testing.assert_allclose(other.channels.gains, -one.channels.gains, atol=1e-6)
    np.testing.assert_allclose(other.places, one.places)


def test_channels_of_a_sound_skin_stay_as_they_are() -> None:
    skin, pattern = Skin.load("paper-rim16"), adjacent([range(16)])
    virtual, random = VirtualSkin(skin, seed=2), np.random.default_rng(3)
    quiet, frames = [virtual.scan(pattern) for _ in range(10)], []
    for place in random.uniform(0.02, 0.18, (40, 2)):
        virtual.press(1, *place, radius=8e-3, pressure=20e3)
        frames.append(virtual.scan(pattern))
        virtual.press(1, *place, radius=8e-3, pressure=0.0)
    judged = judge_channels(skin, quiet, frames)
    assert not judged.reversed.any()
    assert judged.doubtful.mean() < 0.1
    assert judged.unexplained < 0.1


@pytest.mark.parametrize("value", [np.nan, 0.0])
def test_channels_that_were_never_measured_are_left_out_later_too(value: float) -> None:
    """They had counted as sound, and moved what a map had learned without them, once they were there."""
    given = flawed_skin(25, 60, silent=0, strange=0)
    never = np.arange(208) < 40
    quiet, frames = (
        [replace(frame, voltages=np.where(never, value, frame.voltages)) for frame in some]
        for some in (given.quiet, given.frames)
    )
    judged = judge_channels(given.skin, quiet, frames)
    assert judged.doubtful[never].all()
    assert judged.doubtful[~never].mean() < 0.1
    skin = replace(given.skin, calibration=judged.put_into(given.skin.calibration))
    known = SkinModel(skin, skin.transfer_model(), given.quiet)
    both = [known.difference(one).volts for one in (frames[0], given.frames[0])]
    np.testing.assert_array_equal(*both)


def test_a_judgement_is_kept_with_the_skin(tmp_path: Path) -> None:
    given = flawed_skin(8, 60)
    skin = replace(
        given.skin, calibration=judge_channels(given.skin, given.quiet, given.frames).put_into(given.skin.calibration)
    )
    (tmp_path / "judged.toml").write_text(skin.dump())
    again = Skin.load(tmp_path / "judged.toml")
    assert again.calibration.channels == skin.calibration.channels
    frame = given.frames[0]
    one, other = (SkinModel(s, s.transfer_model(), given.quiet).difference(frame) for s in (skin, again))
    np.testing.assert_array_equal(one.volts, other.volts)
    with pytest.raises(SkinError, match="as many of each"):
        replace(skin.calibration, channel_gains=(1.0,))


def test_small_changes_count_as_they_are_and_gains_go_into_the_currents() -> None:
    pattern = adjacent([range(6)])
    random = np.random.default_rng(0)
    gains, errors = random.uniform(-2, 2, pattern.n_meas), random.uniform(0.1, 0.5, pattern.n_meas)
    turned = pattern.quadruples[:, [1, 0, 3, 2]]  # the same channels, both pairs turned round
    channels = Channels(turned, gains, errors)
    small = Difference(pattern, np.full(pattern.n_meas, 1e-3), 1e-6 * random.standard_normal(pattern.n_meas))
    weighed = channels.weigh(small, 1e-5)
    np.testing.assert_array_equal(weighed.volts, small.volts)
    np.testing.assert_allclose(weighed.currents, gains * 1e-3)
    large = channels.weigh(small.times(1e6), 1e-5)
    assert np.corrcoef(np.log(large.currents / gains), np.log(errors))[0, 1] < -0.99


def test_too_few_presses_are_refused() -> None:
    given = flawed_skin(9, 20)
    with pytest.raises(DataError, match=r"\d+ of 20 frames .* at 30 places or more"):
        judge_channels(given.skin, given.quiet, given.frames)
    with pytest.raises(DataError, match="need finite gains"):
        Channels(np.array([[0, 1, 2, 3]]), np.array([np.nan]), np.ones(1))
