"""The adaptive loop on the physics twin, without a wire."""

from collections.abc import Iterator
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from direct import DirectDevice
from numpy.testing import assert_allclose

from ohmskin.contacts import find_regions
from ohmskin.drive import TwoScans, part_of
from ohmskin.engine import Engine, State, Touch
from ohmskin.engine.health import HealthMonitor
from ohmskin.errors import DataError, DeviceError, DeviceLost, DeviceRefused, PatternError, ProtocolError
from ohmskin.scan import DrivePattern, Frame, adjacent
from ohmskin.skin import Skin, VirtualSkin

PLACES = [
    (0.05, 0.12),
    (0.1, 0.1),
    (0.03, 0.03),
    (0.17, 0.05),
    (0.08, 0.17),
    (0.12, 0.06),
    (0.16, 0.16),
    (0.03, 0.1),
    (0.1, 0.03),
    (0.155, 0.105),
]
BOUNDS = {"12B": 12e-3, "16I": 8e-3, "16O": 8e-3, "16P": 3e-3}  # about twice the mean error of docs/modes.md


@pytest.fixture(scope="module")
def skin() -> Skin:
    return Skin.load("paper")


@pytest.fixture(scope="module")
def calibrated(skin: Skin) -> Iterator[Engine]:
    device = DirectDevice(VirtualSkin(skin, seed=5))
    with Engine(lambda: device, skin) as engine:
        engine.calibrate()
        yield engine


@pytest.fixture
def engine(calibrated: Engine) -> Iterator[Engine]:
    calibrated.set_mode("16O")
    yield calibrated
    for number, press in calibrated.device.virtual.presses.items():  # type: ignore[attr-defined]
        calibrated.press(number, press.position, press.radius, 0.0)
    run(calibrated, 8)


def run(engine: Engine, cycles: int) -> Touch:
    touch = None
    for _ in range(cycles):
        touch = engine.step()
    assert touch is not None
    return touch


def miss(touch: Touch, at: tuple[float, float]) -> float:
    return min((float(np.hypot(*np.subtract(c.position, at))) for c in touch.contacts), default=np.inf)


@pytest.mark.parametrize("mode", BOUNDS)
def test_every_place_is_found_by_every_mode_and_by_nothing_else(engine: Engine, mode: str) -> None:
    engine.set_mode(mode)
    for at in PLACES:
        engine.press(1, at, 8e-3, 20e3)
        touch = run(engine, 10)
        assert miss(touch, at) < BOUNDS[mode], f"{mode} at {at}: {touch.contacts}"
        assert len(touch.contacts) == 1


def test_nothing_is_felt_when_nothing_touches(engine: Engine) -> None:
    assert all(not engine.step().contacts for _ in range(3000))  # type: ignore[union-attr]


def test_two_presses_are_two_contacts_with_ids_that_stay(engine: Engine) -> None:
    engine.press(1, (0.05, 0.05), 8e-3, 20e3)
    engine.press(2, (0.15, 0.15), 8e-3, 20e3)
    touch = run(engine, 10)
    assert miss(touch, (0.05, 0.05)) < BOUNDS["16O"]
    assert miss(touch, (0.15, 0.15)) < BOUNDS["16O"]
    ids = {c.id for c in touch.contacts}
    assert len(ids) == 2
    for step in range(20):
        engine.press(1, (0.05 + 1.5e-3 * step, 0.05), 8e-3, 20e3)
        touch = run(engine, 1)
        assert {c.id for c in touch.contacts} == ids
    assert miss(touch, (0.0785, 0.05)) < BOUNDS["16O"]


def test_a_harder_press_is_stronger_and_a_lifted_one_is_gone(engine: Engine) -> None:
    strengths = []
    for pressure in (5e3, 20e3, 50e3):
        engine.press(1, (0.08, 0.11), 8e-3, pressure)
        strengths.append(run(engine, 10).contacts[0].strength)
    assert strengths[0] < strengths[1] < strengths[2]
    engine.press(1, (0.08, 0.11), 8e-3, 0.0)
    assert not run(engine, 6).contacts


def test_the_adaptive_cycle_drives_what_eq_7_chose_for_its_regions(engine: Engine) -> None:
    engine.press(1, (0.06, 0.14), 8e-3, 20e3)
    touch = run(engine, 5)
    base, optimal = touch.percept.frames
    drive = engine.drive(touch.mode)
    assert isinstance(drive, TwoScans)
    assert engine.sensor is not None
    image, imaging = touch.percept.base_image.values, engine.skin.imaging
    threshold = max(engine.sensor.thresholds.base, imaging.fraction * image.max())
    regions = find_regions(image, engine.sensor.known.model.mesh, threshold, imaging.dip)
    assert base.pattern == drive.base
    assert optimal.pattern == drive.second.pattern([region.anchors for region in regions])


def take_part(engine: Engine, frame: Frame) -> Frame:
    """The frame with its injections in another order, which is another pattern."""
    per_pair = frame.pattern.n_meas // frame.pattern.n_inj
    turned = np.arange(frame.pattern.n_meas).reshape(-1, per_pair)[::-1].ravel()
    pattern = engine.drive(engine.mode).patterns[-1]
    pairs = [pattern.injections.tolist().index(pair) for pair in frame.pattern.injections[::-1].tolist()]
    return Frame(part_of(pattern, np.array(pairs)), frame.voltages[turned], frame.currents[::-1], frame.time)


def test_a_mode_that_is_not_there_leaves_no_device_open(skin: Skin) -> None:
    device = DirectDevice(VirtualSkin(skin, seed=3))
    with pytest.raises(PatternError, match="choose from"):
        Engine(lambda: device, skin, "99X")
    with pytest.raises(DeviceError, match="closed"):
        device.scan(adjacent([skin.electrodes.rings[0]]))


def test_adaptive_modes_see_through_the_compiled_cycle_what_the_plain_way_sees(engine: Engine) -> None:
    engine.press(1, (0.06, 0.14), 8e-3, 20e3)
    percept, sensor = run(engine, 5).percept, engine.sensor
    assert sensor is not None
    assert sensor.implementation is not None
    plain = copy(sensor)
    plain.implementation = None
    seen = []
    for one in (sensor, plain):
        frames = iter(percept.frames)
        seen.append(one.step(one.start(), lambda _: next(frames))[1])  # noqa: B023  used at once
    quick, slow = seen
    assert_allclose(quick.image.values, percept.image.values, rtol=0, atol=0)
    assert_allclose(quick.image.values, slow.image.values, rtol=0, atol=1e-4 * slow.image.values.max())
    assert_allclose(quick.base_image.values, slow.base_image.values, rtol=0, atol=1e-4 * slow.base_image.values.max())
    ((one,), (other,)) = quick.detections, slow.detections
    assert np.hypot(*np.subtract(one.position, other.position)) < 1e-5


def test_a_gap_in_the_second_scan_does_not_ask_for_a_third(engine: Engine) -> None:
    engine.press(1, (0.06, 0.14), 8e-3, 20e3)
    (base, second), sensor = run(engine, 5).percept.frames, engine.sensor
    assert sensor is not None
    gap = replace(second, voltages=np.where(np.arange(len(second.voltages)) == 3, np.nan, second.voltages))
    other = take_part(engine, second)  # what eq. (7) would not have chosen
    for last in (gap, other):
        frames = iter((base, last))
        _, percept = sensor.step(sensor.start(), lambda _: next(frames))  # noqa: B023  used at once
        assert percept.frames == (base, last)
        assert len(percept.detections) == 1


def test_a_calibration_that_fails_leaves_the_one_before(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    before = engine.known
    with monkeypatch.context() as patch:
        patch.setattr(
            engine.device, "spoil", lambda frame: replace(frame, voltages=np.full_like(frame.voltages, np.nan))
        )
        with pytest.raises(DataError):
            engine.calibrate()
    assert (engine.state, engine.known) == (State.RUNNING, before)
    run(engine, 1)


def test_a_calibration_under_a_finger_says_that_it_was_there(engine: Engine) -> None:
    """A contact that rests is quiet, too: it vanished without a word, and came where it was lifted."""
    engine.press(1, (0.06, 0.13), 8e-3, 20e3)
    assert run(engine, 12).contacts
    engine.calibrate()
    assert "a contact was detected before the calibration" in engine.message
    engine.press(1, (0.06, 0.13), 8e-3, 0.0)
    run(engine, 1)
    engine.forget()
    engine.calibrate()
    assert "detected" not in engine.message


def test_clipped_voltages_are_left_out_and_told_once(skin: Skin) -> None:
    device, told = DirectDevice(VirtualSkin(skin, seed=3)), []
    with Engine(lambda: device, skin, report=told.append) as engine:
        engine.calibrate()
        device.blind = True
        engine.press(1, (0.08, 0.11), 8e-3, 20e3)
        assert miss(run(engine, 8), (0.08, 0.11)) < BOUNDS["16P"]
        assert "voltages of a frame clip; left out" in engine.message
        device.blind = False
        while engine.message:
            run(engine, 1)
    assert [line for line in told if "voltages" in line] == [told[-2]]
    assert told[-1] == "the data are valid again"


def test_an_unknown_mode_lists_the_choices(engine: Engine) -> None:
    with pytest.raises(PatternError, match="12B, 16I, 16O, 16P, 16T"):
        engine.set_mode("17X")


def test_a_pause_stops_and_resumes(engine: Engine) -> None:
    engine.pause(True)
    assert engine.step() is None
    assert engine.state is State.PAUSED
    engine.pause(False)
    assert engine.step() is not None


def test_a_press_off_the_sheet_is_refused(engine: Engine) -> None:
    with pytest.raises((DeviceRefused, ValueError), match="off the sheet"):
        engine.press(1, (0.3, 0.1), 8e-3, 20e3)


def test_a_skin_with_other_electrodes_is_refused(skin: Skin) -> None:
    other = Skin.parse('name = "other"\n[electrode]\nlayout = "rim"\ncount = 12\n')
    with pytest.raises(DeviceError, match=r"16 electrodes.*'other' has 12"):
        Engine(lambda: DirectDevice(VirtualSkin(skin, 0)), other)


def test_a_lost_device_is_found_again_and_felt_again(skin: Skin, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ohmskin.engine.engine._RETRY_AFTER", 0.0)
    virtual = VirtualSkin(skin, seed=7)
    opened: list[DirectDevice] = []
    refusals = iter([False, True, True, False])
    told: list[str] = []

    def open_device() -> DirectDevice:
        if next(refusals):
            raise DeviceLost("nobody there")
        opened.append(DirectDevice(virtual))
        return opened[-1]

    with Engine(open_device, skin, report=told.append) as engine:
        engine.calibrate()
        engine.press(1, (0.1, 0.07), 8e-3, 20e3)
        assert miss(run(engine, 5), (0.1, 0.07)) < BOUNDS["16P"]
        opened[0].gone = True
        assert engine.step() is None
        assert engine.state is State.LOST
        engine.press(1, (0.1, 0.07), 8e-3, 20e3)  # not an error while the device is away
        assert engine.step() is None  # still away
        assert "nobody there" in engine.message
        assert engine.step() is None
        assert engine.step() is None  # back, seen from the next cycle on
        assert engine.state is State.RUNNING
        assert miss(run(engine, 5), (0.1, 0.07)) < BOUNDS["16P"]  # the old baseline still holds
    assert len(opened) == 2
    assert any("plug was pulled" in line for line in told)
    assert told[-1] == "device is back"


@pytest.mark.parametrize("error", [ProtocolError("another digest"), DeviceRefused("on fire")])
def test_a_reply_that_makes_no_sense_ends_a_connection_and_no_loop(
    skin: Skin, monkeypatch: pytest.MonkeyPatch, error: DeviceError
) -> None:
    monkeypatch.setattr("ohmskin.engine.engine._RETRY_AFTER", 0.0)
    told: list[str] = []
    devices = [DirectDevice(VirtualSkin(skin, seed=1)) for _ in range(3)]
    pending = iter(devices)

    def odd(*_: object) -> Frame:
        raise error

    def open_device() -> DirectDevice:
        if len(told) and (device := next(pending)) is devices[1]:
            raise error
        return device if len(told) else devices[0]

    with Engine(open_device, skin, "12B", told.append) as engine:
        engine.calibrate()
        told.append("calibrated")
        next(pending)
        devices[0].spoil = odd
        assert engine.step() is None
        assert engine.state is State.LOST
        assert told[-1] == f"device lost: {error}; reconnecting"
        assert engine.step() is None
        assert engine.message == f"device lost: {error}; reconnecting"
        assert engine.step() is None
        assert told[-1] == "device is back"
        run(engine, 1)


def test_a_device_that_takes_less_than_before_is_not_used_and_one_that_takes_longer_neither(
    skin: Skin, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ohmskin.engine.engine._RETRY_AFTER", 0.0)
    first, small, slow, lame, sound = (DirectDevice(VirtualSkin(skin, seed=1)) for _ in range(5))
    small.capabilities = replace(small.capabilities, max_injections=1)
    slow.capabilities = replace(slow.capabilities, settle_time=60.0)
    lame.capabilities = replace(lame.capabilities, settle_time=0.5)
    with Engine(lambda: lame, skin, "12B"):
        pass  # slow, but as ever
    pending, told = iter([first, small, slow, lame, sound]), []
    with Engine(lambda: next(pending), skin, "12B", told.append) as engine:
        engine.calibrate()
        first.gone = True
        engine.step()
        for words in (
            "takes smaller patterns than the previous one",
            "takes 720 s to scan the rim; allowed are 0.5 s",
            "takes 6 s to scan the rim; allowed are 0.5 s",
        ):
            assert engine.step() is None
            assert words in told[-1]
        engine.step()
        assert told[-1] == "device is back"
        run(engine, 1)


def test_quiet_frames_of_another_pattern_are_refused(skin: Skin) -> None:
    device = DirectDevice(VirtualSkin(skin, seed=1))
    device.spoil = lambda _: device.virtual.scan(adjacent([range(12)]))
    with (
        Engine(lambda: device, skin, "16O") as engine,
        pytest.raises(DataError, match="another pattern than was asked"),
    ):
        engine.calibrate()


def test_another_device_in_its_place_is_calibrated(skin: Skin, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ohmskin.engine.engine._RETRY_AFTER", 0.0)
    devices = [DirectDevice(VirtualSkin(skin, seed=k), serial=k) for k in (1, 2)]
    told: list[str] = []
    pending = iter(devices)
    with Engine(lambda: next(pending), skin, report=told.append) as engine:
        shares: list[float] = []
        engine.calibrate(shares.append)
        before, first = engine.known, len(shares)
        devices[0].gone = True
        engine.step()
        engine.step()
        assert engine.state is State.RUNNING
        assert engine.known is not before
    assert shares[first:] == shares[:first]  # progress is told as it was of the first
    assert any("another device" in line for line in told)


def test_another_device_that_cannot_be_calibrated_is_tried_again_and_not_taken_for_the_first(
    skin: Skin, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ohmskin.engine.engine._RETRY_AFTER", 0.0)
    first, silent, sound = (DirectDevice(VirtualSkin(skin, seed=k), serial=k) for k in (1, 2, 2))
    silent.spoil = lambda frame: _unseen(frame.pattern)
    pending = iter([first, silent, sound])
    with Engine(lambda: next(pending), skin) as engine:
        engine.calibrate()
        before = engine.known
        first.gone = True
        engine.step()
        engine.step()
        assert engine.state is State.LOST
        assert "every voltage of a frame is missing" in engine.message
        engine.step()
        assert engine.state is State.RUNNING
        assert engine.known is not None
        assert engine.known is not before


def _unseen(pattern: DrivePattern) -> Frame:
    return Frame(pattern, np.full(pattern.n_meas, np.nan), np.full(pattern.n_inj, 1e-3), 0.0)


def test_a_device_lost_while_calibrating_keeps_what_was_known(calibrated: Engine) -> None:
    before = calibrated.known
    calibrated.device.gone = True  # type: ignore[attr-defined]
    with pytest.raises(DeviceLost):
        calibrated.calibrate()
    calibrated.device.gone = False  # type: ignore[attr-defined]
    assert calibrated.known is before
    assert calibrated.state is State.LOST


def test_health_counts_and_times_cycles() -> None:
    monitor = HealthMonitor()
    for k in range(201):
        now = 100 + k * 0.01
        monitor.waited(0.004)
        health = monitor.cycle(now, sampled=now - (0.002 if k % 10 else 0.005), dropped=3, noise=1e-4)
    assert health.rate == pytest.approx(100, rel=0.02)
    assert health.waiting == pytest.approx(0.4, rel=0.03)
    assert health.latency_p50 == pytest.approx(0.002)
    assert health.latency_p99 == pytest.approx(0.005)
    assert (health.dropped, health.noise) == (3, 1e-4)


def test_device_time_is_tied_to_the_fastest_answer() -> None:
    monitor = HealthMonitor()
    assert monitor.arrived(host=50.0, device=10.0) == 50.0
    assert monitor.arrived(host=50.999, device=11.0) == pytest.approx(50.999)
    assert monitor.arrived(host=52.5, device=12.0) == pytest.approx(51.999)
