"""Presses on electrodes: a contact there is where it is anywhere else."""

from dataclasses import replace

import numpy as np
import pytest

from ohmskin.arrays import Floats
from ohmskin.sensing import SkinModel, build, default_mode, drive_of, modes
from ohmskin.skin import Press, Skin, VirtualSkin

SEEDS = (0, 1, 2)
NOISE = 0.8e-3  # V, 50 dB below the largest voltage of the paper's base scan
REACH = 8e-3  # m on the skin, from the middle of an electrode


def errors(skin: Skin, seed: int, per_electrode: int = 4, reach: float = REACH) -> Floats:
    """Errors (n,) (m) of presses of 8 mm and 15 kPa within `reach` of electrodes inside a skin, in its default mode.

    NaN where there is not one contact.
    """
    twin, mode, random = VirtualSkin(skin, seed=seed), modes(skin)[default_mode(skin)], np.random.default_rng(seed)
    quiet = [twin.scan(pattern) for pattern in drive_of(mode, skin).patterns for _ in range(10)]
    sensor, found = build(mode, SkinModel(skin, skin.transfer_model(), quiet)), []
    for electrode in np.repeat(skin.electrodes.positions[len(skin.electrodes.rings[0]) :], per_electrode, axis=0):
        angle, scale = random.uniform(0, 2 * np.pi), float(skin.chart.scale([electrode])[0])
        away = reach / scale * np.sqrt(random.uniform()) * np.array([np.cos(angle), np.sin(angle)])
        place = electrode + away
        twin.reset(seed, [Press((float(place[0]), float(place[1])), 8e-3, 15e3)])
        state = sensor.start()
        for _ in range(4):
            state, percept = sensor.step(state, twin.scan)
        points = skin.chart.points([place, *(contact.position for contact in percept.contacts)])
        found.append(float(np.linalg.norm(points[1] - points[0])) if len(points) == 2 else np.nan)
    return np.array(found)


@pytest.mark.parametrize(("name", "mean"), [("paper", 0.8e-3), ("dome", 1.25e-3)])
def test_a_press_on_an_inner_electrode_is_located_about_as_well_as_beside_it(name: str, mean: float) -> None:
    """With points in place of electrodes of real size, means of 1.3 and 1.5 mm, and errors of up to 6 mm."""
    skin = Skin.load(name)
    skin = replace(skin, converter=replace(skin.converter, noise=NOISE))
    found = np.concatenate([errors(skin, seed) for seed in SEEDS])
    assert np.isnan(found).sum() <= 1  # of 48 and 72
    assert np.nanmean(found) < mean
    assert np.nanmax(found) < 5e-3


def test_a_press_right_on_an_inner_electrode_is_one_contact() -> None:
    """Of these 72, 16 had not been one. Of 288 (twelve seeds), 2 are not, and 1 or 2 are more than 4 mm off."""
    dome = Skin.load("dome")
    dome = replace(dome, converter=replace(dome.converter, noise=NOISE))
    found = np.concatenate([errors(dome, seed, reach=2e-3) for seed in SEEDS])
    assert np.isnan(found).sum() <= 2
    assert np.nanquantile(found, 0.95) < 3e-3
    assert np.nanmax(found) < 7e-3


@pytest.mark.parametrize("others", [(), ((0.03, 0.1),)])
def test_a_press_that_comes_on_an_inner_electrode_is_tracked_as_one_from_its_first_frame(
    others: tuple[tuple[float, float], ...],
) -> None:
    """Of such presses 31 of 48 had come as two contacts, for up to nine frames, and 14 of 72 beside another one."""
    skin, random, more = Skin.load("paper"), np.random.default_rng(7), 0
    beside = [Press(place, 8e-3, 15e3) for place in others]
    for seed in SEEDS[:2]:
        twin, mode = VirtualSkin(skin, seed=seed, contacts=4), modes(skin)["16T"]
        quiet = [twin.scan(pattern) for pattern in drive_of(mode, skin).patterns for _ in range(10)]
        sensor = build(mode, SkinModel(skin, skin.transfer_model(), quiet))
        for electrode in np.repeat(skin.electrodes.positions[len(skin.electrodes.rings[0]) :], 4, axis=0):
            x, y = (electrode + random.uniform(-3e-3, 3e-3, 2)).tolist()
            twin.reset(seed, beside)
            state = sensor.start()
            for _ in range(16):
                state, _ = sensor.step(state, twin.scan)
            twin.press(9, x, y, 8e-3, 20e3)
            counts = []
            for _ in range(8):
                state, percept = sensor.step(state, twin.scan)
                counts.append(len(percept.contacts) - len(beside))
            assert counts[-1] == 1
            more += max(counts) > 1
    assert more <= 3  # of 32
