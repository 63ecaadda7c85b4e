"""Tracking in the loop, on the physics twin without a wire."""

import runpy
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin.device import Capabilities
from ohmskin.engine import Engine, State, Touch
from ohmskin.errors import PatternError
from ohmskin.scan import Frame
from ohmskin.skin import Skin, VirtualSkin

PLACES = [(0.05, 0.12), (0.1, 0.1), (0.03, 0.03), (0.17, 0.05), (0.16, 0.16), (0.155, 0.105)]


def open_engine(skin: Skin, *devices: DirectDevice, modes: tuple[str, ...] = ("16T",)) -> Engine:
    """An engine with some modes of its skin, tracking, that opens these devices in turn."""
    pending = iter(devices)
    engine = Engine(lambda: next(pending), skin)
    engine.modes = {name: mode for name, mode in engine.modes.items() if name in modes}
    engine.set_mode("16T")
    return engine


@pytest.fixture(scope="module")
def skin() -> Skin:
    return Skin.load("paper")


@pytest.fixture(scope="module")
def calibrated(skin: Skin) -> Iterator[Engine]:
    with open_engine(skin, DirectDevice(VirtualSkin(skin, seed=5)), modes=("16I", "16P", "16T")) as engine:
        engine.calibrate()
        yield engine


@pytest.fixture
def engine(calibrated: Engine) -> Iterator[Engine]:
    calibrated.set_mode("16T")
    yield calibrated
    for number, press in calibrated.device.virtual.presses.items():  # type: ignore[attr-defined]
        calibrated.press(number, press.position, press.radius, 0.0)
    calibrated.set_mode("16I")
    calibrated.set_mode("16T")


def run(engine: Engine, cycles: int) -> Touch:
    touch = None
    for _ in range(cycles):
        touch = engine.step()
    assert touch is not None
    return touch


def miss(touch: Touch, at: tuple[float, float]) -> float:
    return min((float(np.hypot(*np.subtract(c.position, at))) for c in touch.contacts), default=np.inf)


def test_every_place_is_found_in_three_frames_of_four_injections(engine: Engine) -> None:
    for at in PLACES:
        engine.press(1, at, 8e-3, 20e3)
        touch = run(engine, 3)
        assert len(touch.contacts) == 1, f"{at}: {touch.contacts}"
        touch = run(engine, 10)
        assert miss(touch, at) < 4e-3, at
        (contact,) = touch.contacts
        assert contact.covariance is not None
        assert contact.velocity is not None
        assert contact.radius is not None
        assert np.linalg.eigvalsh(contact.covariance)[0] > 0
        assert [frame.pattern.n_inj for frame in touch.percept.frames] == [4]
        engine.press(1, at, 8e-3, 0.0)
        assert not run(engine, 3).contacts


def test_nothing_is_felt_when_nothing_touches(engine: Engine) -> None:
    assert all(not engine.step().contacts for _ in range(800))  # type: ignore[union-attr]


def test_two_fingers_are_followed_and_keep_their_ids(engine: Engine) -> None:
    engine.press(1, (0.05, 0.05), 8e-3, 20e3)
    engine.press(2, (0.15, 0.15), 8e-3, 30e3)
    ids = {c.id for c in run(engine, 10).contacts}
    assert len(ids) == 2
    for step in range(25):
        engine.press(1, (0.05 + 1.5e-3 * step, 0.05), 8e-3, 20e3)
        touch = run(engine, 1)
        assert {c.id for c in touch.contacts} == ids
        assert step < 10 or miss(touch, (0.05 + 1.5e-3 * step, 0.05)) < 6e-3
        assert miss(touch, (0.15, 0.15)) < 4e-3


@pytest.mark.parametrize(
    ("corner", "other"),
    [((0.189, 0.008), (0.085, 0.027)), ((0.192, 0.008), (0.109, 0.037)), ((0.008, 0.008), (0.028, 0.055))],
)
def test_a_contact_in_a_corner_stays_one_when_another_comes(
    engine: Engine, corner: tuple[float, float], other: tuple[float, float]
) -> None:
    engine.press(0, corner, 8e-3, 20e3)
    run(engine, 30)
    engine.press(1, other, 8e-3, 20e3)
    run(engine, 3)
    touches = [run(engine, 1) for _ in range(40)]
    assert {len(touch.contacts) for touch in touches} == {2}
    assert max(max(miss(touch, corner), miss(touch, other)) for touch in touches) < 5e-3


def test_the_image_of_the_last_frames_peaks_at_the_contact(engine: Engine) -> None:
    engine.press(1, (0.07, 0.13), 8e-3, 20e3)
    touch = run(engine, 10)
    image, mesh = touch.percept.image, engine.known.model.mesh  # type: ignore[union-attr]
    peak = int(np.argmax(image.values))
    assert np.hypot(*(mesh.centroids[peak] - [0.07, 0.13])) < 12e-3
    assert image.values[peak] > 10 * image.noise_std(peak)[0]
    assert touch.percept.base_image is image
    assert engine.sensor.thresholds.final > 0  # type: ignore[union-attr]


def test_the_number_of_injections_can_be_changed_while_it_runs(engine: Engine) -> None:
    engine.press(1, (0.12, 0.06), 8e-3, 20e3)
    shared = engine.drive(engine.mode)
    for count in (2, 9, 4):
        engine.set_injections(count)
        touch = run(engine, 6)
        assert engine.injections == count
        assert touch.percept.frames[0].pattern.n_inj == count
        assert miss(touch, (0.12, 0.06)) < 6e-3
    assert shared.injections == 4  # what was there before stays as it was


def test_injections_out_of_range_or_in_another_mode_are_refused(engine: Engine) -> None:
    low, high = engine.injection_limits(engine.mode)
    assert (low, high) == (1, 24)  # one explores; the device takes 24
    for count in (0, 25):
        with pytest.raises(PatternError, match=f"{count} injections per frame; mode 16T takes 1 to 24"):
            engine.set_injections(count)
    engine.set_mode("16I")
    assert engine.injections is None
    with pytest.raises(PatternError, match="16I has no choice of injections; choose one of 16T"):
        engine.set_injections(4)


def test_the_frame_wise_mode_fits_contacts_to_the_data(engine: Engine) -> None:
    engine.set_mode("16P")
    errors = []
    for at in PLACES:
        engine.press(1, at, 8e-3, 20e3)
        touch = run(engine, 6)
        (contact,) = touch.contacts
        assert contact.covariance is not None
        errors.append(miss(touch, at))
        assert len(touch.percept.frames) == 2
    assert np.mean(errors) < 2e-3
    engine.press(1, PLACES[-1], 8e-3, 0.0)
    assert not run(engine, 6).contacts


def test_clipped_voltages_are_left_out_and_a_lost_device_is_felt_again(
    skin: Skin, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ohmskin.engine.engine._RETRY_AFTER", 0.0)
    virtual = VirtualSkin(skin, seed=3)
    device = DirectDevice(virtual)
    with open_engine(skin, device, DirectDevice(virtual)) as engine:
        engine.calibrate()
        device.blind = True
        engine.press(1, (0.08, 0.11), 8e-3, 20e3)
        assert miss(run(engine, 10), (0.08, 0.11)) < 5e-3
        device.blind = False
        device.gone = True
        assert engine.step() is None
        assert engine.state is State.LOST
        assert engine.step() is None
        assert miss(run(engine, 3), (0.08, 0.11)) < 5e-3
        engine.pause(True)
        assert engine.step() is None
        engine.pause(False)
        assert miss(run(engine, 2), (0.08, 0.11)) < 5e-3


def test_the_same_frames_give_the_same_contacts(skin: Skin) -> None:
    """What a recording holds is enough: the device's time counts, not the host's."""
    device = DirectDevice(VirtualSkin(skin, seed=4))
    frames: list[Frame] = []
    device.listen(frames.append)
    with open_engine(skin, device) as engine:
        engine.calibrate()
        first = []
        for k in range(25):
            if k == 8:
                engine.press(1, (0.13, 0.07), 8e-3, 20e3)
            first.append(run(engine, 1).contacts)
    again = DirectDevice(VirtualSkin(skin, seed=99))
    queue = iter(frames)

    def replayed(scanned: Frame) -> Frame:
        frame = next(queue)
        assert frame.pattern == scanned.pattern
        return frame

    again.spoil = replayed
    with open_engine(skin, again) as engine:
        engine.calibrate()
        assert [run(engine, 1).contacts for _ in range(25)] == first


def test_a_device_that_takes_little_at_once_limits_the_injections(skin: Skin) -> None:
    device = DirectDevice(VirtualSkin(skin, seed=1))
    device.capabilities = replace(device.capabilities, max_injections=6, max_measurements=60)
    assert isinstance(device.capabilities, Capabilities)
    with open_engine(skin, device) as engine:
        assert engine.injection_limits(engine.mode) == (1, 4)  # 13 voltages each


def test_the_guides_example_follows_both_fingers_and_its_page_shows_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    guide = Path(__file__).parents[1] / "docs" / "guide"
    script = guide / "tracking.py"
    assert script.read_text() in (guide / "tracking.md").read_text()
    monkeypatch.setattr("sys.argv", [str(script), str(tmp_path)])
    runpy.run_path(str(script), run_name="__main__")
    assert capsys.readouterr().out.count("contact ") == 2
    assert (tmp_path / "tracking.png").stat().st_size > 10_000


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("channels", [3, None])
def test_spikes_and_bursts_of_noise_make_hardly_a_contact_and_hide_none(
    skin: Skin, channels: int | None, seed: int
) -> None:
    device, random = DirectDevice(VirtualSkin(skin, seed)), np.random.default_rng(seed)

    def spoiled(frame: Frame) -> Frame:
        """Every twentieth frame, about: 5 mV on up to three channels, or five times the noise on all."""
        if random.random() > 0.05:
            return frame
        count = len(frame.voltages)
        which = np.arange(count) if channels is None else random.choice(count, random.integers(1, channels + 1))
        size = 5 * skin.converter.noise if channels is None else 5e-3
        voltages = frame.voltages.copy()
        voltages[which] += random.normal(0, size, len(which))
        return replace(frame, voltages=voltages)

    with open_engine(skin, device) as engine:
        engine.calibrate()
        device.spoil = spoiled
        assert sum(bool(run(engine, 1).contacts) for _ in range(1000)) <= 3
        for k, place in enumerate(PLACES):
            engine.press(k, place, 8e-3, 10e3)
            late = [miss(run(engine, 1), place) < 6e-3 for _ in range(4)].index(True)
            assert late < 3
