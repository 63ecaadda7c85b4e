"""Calibration takes nothing for quiet that is not: what is disturbed is measured again, what cannot be is refused."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin.drive import base_pattern
from ohmskin.engine import Engine
from ohmskin.engine.quiet import MEASURED, CalibrationReport, QuietFrames
from ohmskin.errors import DataError
from ohmskin.scan import Baseline, DrivePattern, Frame
from ohmskin.skin import Fault, Skin, VirtualSkin

AT, RADIUS, PRESSURE = (0.07, 0.11), 6e-3, 20e3
Spoil = Callable[[Frame], Frame]


class SpoiltDevice(DirectDevice):
    """A virtual skin whose frames are spoilt, and that may be pressed while it is measured."""

    def __init__(self, *faults: Fault, spoil: Spoil = lambda frame: frame) -> None:
        super().__init__(VirtualSkin(Skin.load("paper"), 3, faults, contacts=4))
        self.spoil, self.count = spoil, 0
        self.pressed: Callable[[int], bool] | None = lambda count: False

    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        self.count += 1
        if self.pressed is not None:
            self.virtual.press(0, 0.1, 0.1, 8e-3, 20e3 if self.pressed(self.count) else 0.0)
        return super()._scan(pattern, timeout)


def quiet_of(device: SpoiltDevice) -> tuple[QuietFrames, list[Frame]]:
    pattern = base_pattern(device.virtual.skin.electrodes).with_driven
    quiet = QuietFrames([pattern], device.capabilities, device.scan, lambda _: None)
    return quiet, quiet.measured()


def spread(frame: Frame, change: float) -> Frame:
    return replace(frame, voltages=frame.voltages + change)


def test_a_quiet_skin_is_measured_once() -> None:
    device = SpoiltDevice()
    quiet, frames = quiet_of(device)
    assert (len(frames), device.count, quiet.notes) == (40, 40, [])


def test_how_far_the_calibration_of_a_slow_device_is_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """After some seconds, in a share and in seconds at this pace; from the start again where something moved."""
    now, told = 0.0, list[tuple[str, float, float]]()
    monkeypatch.setattr("ohmskin.engine.quiet.time", SimpleNamespace(monotonic=lambda: now))
    report = CalibrationReport(lambda *words: told.append(words))
    for turn in range(2):
        for number in range(40):
            now = 200.0 * turn + 4.0 * number
            report(MEASURED * number / 40)
    report(MEASURED)
    report(1.0)
    assert len(told) == 2 * 19
    assert told[0][0] == told[19][0] == "calibrating: 5% measured, about 152 s left"
    assert told[0][1:] == pytest.approx((0.05, 152.0))
    assert told[18][1:] == pytest.approx((0.95, 8.0))


def test_frames_with_spikes_are_measured_again_and_leave_the_noise_as_it_is() -> None:
    sound = Baseline.learn(quiet_of(SpoiltDevice())[1])
    random = np.random.default_rng(0)

    def spoil(frame: Frame) -> Frame:
        volts = frame.voltages.copy()
        if random.random() < 0.3:
            volts[random.integers(len(volts))] += 0.05
        return replace(frame, voltages=volts)

    device = SpoiltDevice(spoil=spoil)
    quiet, frames = quiet_of(device)
    learned = Baseline.learn(frames)
    assert learned.noise == pytest.approx(sound.noise, rel=0.1)
    np.testing.assert_allclose(learned.resistances, sound.resistances, atol=1.0)
    assert "of 40 quiet frames had outliers; measured again" in quiet.notes[0]
    assert 44 < device.count < 90


@pytest.mark.parametrize("step", [0.6e-3, 1.2e-3, 2.44e-3, 4.9e-3])
def test_a_coarse_converter_is_quiet_and_a_finger_on_it_is_not(step: float) -> None:
    """Most of its values do not change from frame to frame, and some by a step, with a noise of 0.2 mV."""
    device = SpoiltDevice(spoil=lambda frame: replace(frame, voltages=step * np.round(frame.voltages / step)))
    for _ in range(3):
        quiet, frames = quiet_of(device)
        assert (len(frames), quiet.notes) == (40, [])
    device.pressed = lambda count: count % 20 < 10
    with pytest.raises(DataError, match="the skin is not quiet"):
        quiet_of(device)


@pytest.mark.parametrize("volts", [np.nan, np.inf, 0.3])
def test_one_bad_frame_is_measured_again(volts: float) -> None:
    device = SpoiltDevice()
    device.spoil = lambda frame: spread(frame, volts) if device.count == 17 else frame
    quiet, frames = quiet_of(device)
    assert np.isfinite([frame.voltages for frame in frames]).all()
    assert quiet.notes == ["1 of 40 quiet frames had outliers; measured again"]


def test_a_finger_that_lifts_is_waited_for() -> None:
    device = SpoiltDevice()
    device.pressed = lambda count: count < 30
    quiet, frames = quiet_of(device)
    assert device.count >= 80
    assert "the quiet voltages changed during the measurement, by" in quiet.notes[0]
    sound = Baseline.learn(quiet_of(SpoiltDevice())[1])
    np.testing.assert_allclose(Baseline.learn(frames).resistances, sound.resistances, atol=1.0)


def test_a_skin_that_does_not_rest_is_refused() -> None:
    device = SpoiltDevice()
    device.pressed = lambda count: count % 20 < 10
    with pytest.raises(
        DataError, match=r"the skin is not quiet: its voltages change by .*V, their noise is .*V; do not touch it"
    ):
        quiet_of(device)


def test_slow_drift_and_hum_are_no_movement() -> None:
    device = SpoiltDevice()
    device.spoil = lambda frame: spread(frame, 5e-3 * float(np.sin(2 * np.pi * 50 * frame.time)))
    assert quiet_of(device)[0].notes == []
    device.spoil = lambda frame: spread(frame, 3e-4 * frame.time)  # the noise in a second
    assert quiet_of(device)[0].notes == []


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda f: replace(f, currents=0 * f.currents), "reports impossible currents, such as 0 A"),
        (lambda f: replace(f, currents=-f.currents), "reports impossible currents, such as -0.00"),
        (lambda f: replace(f, currents=0 * f.currents + 1e30), r"reports impossible currents, such as 1e\+30 A"),
        (lambda f: replace(f, voltages=np.nan * f.voltages), "every voltage of a frame is missing"),
        (lambda f: replace(f, voltages=np.copysign(np.inf, f.voltages)), "every voltage of a frame clips"),
        (lambda f: replace(f, voltages=0 * f.voltages), "every voltage is 0 V"),
    ],
    ids=["no current", "backwards", "absurd", "missing", "clipped", "zero"],
)
def test_what_is_no_skin_is_refused_with_the_reason(spoil: Spoil, words: str) -> None:
    with pytest.raises(DataError, match=words):
        quiet_of(SpoiltDevice(spoil=spoil))


def test_an_electrode_that_is_open_from_the_start_is_named_and_done_without() -> None:
    device, told = SpoiltDevice(Fault("open", (5,))), list[str]()
    device.pressed = lambda _: False
    with Engine(lambda: device, device.virtual.skin, report=told.append) as engine:
        engine.calibrate()
        assert told == ["electrode 5: open: almost no current flows when it is driven; check its wire; left out"]
        assert not any(engine.step().contacts for _ in range(20))  # type: ignore[union-attr]
        device.pressed = None
        engine.press(0, AT, RADIUS, PRESSURE)
        touches = [engine.step() for _ in range(12)][4:]
        places = [contact.position for touch in touches if touch for contact in touch.contacts]
        assert len(places) == 8
        assert np.median(np.hypot(*np.subtract(places, AT).T)) < 3e-3


def test_too_many_open_electrodes_are_refused() -> None:
    device = SpoiltDevice(*(Fault("open", (electrode,)) for electrode in (1, 3, 6, 9, 12)))
    with (
        Engine(lambda: device, device.virtual.skin) as engine,
        pytest.raises(DataError, match="cannot be used: "),
    ):
        engine.calibrate()
