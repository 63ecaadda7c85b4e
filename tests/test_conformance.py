"""The conformance suite: our own drivers pass it, and each way of being broken fails it by its name."""

import math
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from live_process import serving

from ohmskin.arrays import Floats
from ohmskin.device import Capabilities, Device, Feature, PressCommand, connect, drivers
from ohmskin.device.conformance import Check, check_device
from ohmskin.device.daq import MuxDaqDevice
from ohmskin.errors import DeviceError, DeviceLost, DeviceRefused
from ohmskin.importers import read_recording
from ohmskin.scan import DrivePattern, Frame, FrameFlag, adjacent
from ohmskin.skin import Skin, VirtualSkin

sys.path.insert(0, str(Path(__file__).parent.parent / "examples"))

import mux_and_daq

SKIN = Skin.load("paper")
ABLE = Capabilities(
    "fake",
    16,
    40,
    600,
    3,
    Feature.VOLTAGE_SOURCE | Feature.CURRENT_MEASURED,
    excitation=5.0,
    full_scale=5.0,
    settle_time=1e-5,
)


@cache
def sheet() -> Floats:
    """Transfer resistances of the paper's skin."""
    return VirtualSkin(SKIN, 1).sheet.untouched


class Fake(Device):
    """A real skin as it should be. Broken ones change what it answers."""

    def __init__(self, capabilities: Capabilities = ABLE) -> None:
        super().__init__("fake:", capabilities)
        self.count, self.random = 0, np.random.default_rng(0)

    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        a, b, c, d = pattern.quadruples.T
        currents = np.full(pattern.n_inj, 2e-3)
        r = sheet()
        ohms = r[a, c] - r[a, d] - r[b, c] + r[b, d]
        volts = ohms * 2e-3 + self.random.normal(0, 1e-4, pattern.n_meas)
        self.count += 1
        over = np.abs(volts) > 5.0
        return Frame(
            pattern, np.where(over, np.inf, volts), currents, self.count * 0.01, self.count, FrameFlag(int(over.any()))
        )

    def _press(self, press: PressCommand) -> None:
        raise DeviceRefused("a real skin")

    def _close(self) -> None:
        pass


class Changed(Fake):
    """Changes each frame."""

    def __init__(self, change: Callable[["Changed", Frame], Frame], capabilities: Capabilities = ABLE) -> None:
        super().__init__(capabilities)
        self._change, self.first, self.last = change, None, None

    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        frame = super()._scan(pattern, timeout)
        self.first = self.first or frame
        frame, self.last = self._change(self, frame), frame
        return frame


def failed(checks: list[Check]) -> dict[str, str]:
    return {check.name: check.words for check in checks if check.outcome == "failed"}


def passes(device: Device) -> dict[str, str]:
    """What each check came to, none of them failed."""
    checks = check_device(device)
    assert not failed(checks)
    return {check.name: check.outcome for check in checks}


def test_a_device_in_order_passes_everything() -> None:
    assert set(passes(Fake()).values()) == {"passed"}


@pytest.mark.parametrize("pty", [False, True])
def test_the_wire_driver_passes(pty: bool) -> None:
    with serving("--seed", "1", *(["--pty"] if pty else [])) as (address, _):
        assert address.startswith("serial" if pty else "tcp")
        outcomes = passes(connect(address))
    assert [name for name, outcome in outcomes.items() if outcome == "skipped"] == [
        "presses on a real skin are refused"
    ]


def test_the_virtual_driver_passes_from_the_command_line() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "ohmskin", "check-device", "virtual:"], capture_output=True, text=True, timeout=500
    )
    assert done.returncode == 0, done.stdout
    assert "passed: reciprocity" in done.stdout
    assert "15 checks, 0 failed" in done.stdout


def test_the_replay_driver_passes(tank_folder: Path) -> None:
    file = min(tank_folder.rglob("*.csv"))
    device = connect(f"replay:{file}", rate=1e4)
    assert read_recording(file).frames
    outcomes = passes(device)
    assert list(outcomes.values()).count("skipped") == 5


def test_the_example_of_multiplexers_and_a_card_passes_and_measures_the_sheet() -> None:
    device = mux_and_daq.open_simulated(SKIN)
    pattern = adjacent(SKIN.electrodes.rings)
    frame = device.scan(pattern)
    a, b, c, d = pattern.quadruples.T
    ohms = sheet()[a, c] - sheet()[a, d] - sheet()[b, c] + sheet()[b, d]
    volts = ohms * frame.currents[pattern.measurements[:, 0]]
    assert np.sqrt(np.mean((frame.voltages - volts) ** 2)) < 0.5e-3
    assert passes(device)["presses on a real skin are refused"] == "passed"


class Rig:
    """A board and a card that note what is done to them."""

    def __init__(self) -> None:
        self.log: list[str] = []
        self.trouble: Exception | None = None
        self.volts = np.zeros(16)

    def connect(self, source: int, sink: int) -> None:
        self.log.append(f"connect {source} {sink}")

    def release(self) -> None:
        self.log.append("release")

    def sample(self) -> tuple[np.ndarray, float]:
        self.log.append("sample")
        if self.trouble:
            raise self.trouble
        return self.volts, 0.2

    def close(self) -> None:
        self.log.append("close")


def rig_device(rig: Rig, **changes: float) -> MuxDaqDevice:
    settings = {"n_elec": 16, "shunt": 100.0, "excitation": 5.0, "full_scale": 5.0, "settle": 1e-4} | changes
    return MuxDaqDevice("rig:", rig, rig, **settings)  # type: ignore[arg-type]


TWO = DrivePattern(np.array([[0, 1], [2, 3]]), np.array([[0, 4, 5], [1, 5, 6]]))


def test_multiplexers_switch_before_each_sample_and_let_go_at_the_end() -> None:
    rig = Rig()
    with rig_device(rig, averages=2) as device:
        frame = device.scan(TWO)
    one, other = ["connect 0 1", "sample", "sample"], ["connect 2 3", "sample", "sample"]
    assert rig.log == [*one, *other, "release", "release", "close", "close"]  # once after the scan, once on closing
    np.testing.assert_allclose(frame.currents, 2e-3)


def test_a_card_out_of_range_is_clipped_not_believed() -> None:
    rig = Rig()
    rig.volts[5] = 5.0
    frame = rig_device(rig).scan(TWO)
    assert FrameFlag.CLIPPED in frame.flags
    np.testing.assert_array_equal(frame.voltages, [-np.inf, np.inf])


def test_a_board_or_card_that_fails_leaves_no_current_flowing() -> None:
    rig = Rig()
    rig.trouble = OSError("usb gone")
    device = rig_device(rig)
    with pytest.raises(DeviceLost, match="rig: failed during a scan: usb gone; check its cables"):
        device.scan(TWO)
    assert rig.log[-1] == "release"
    rig.trouble = None
    slow = rig_device(rig, settle=0.05)
    with pytest.raises(DeviceLost, match=r"measured 1 of 2 injections in 0\.01 s"):
        slow.scan(TWO, timeout=0.01)
    assert rig.log[-1] == "release"
    rig.volts = np.zeros(15)
    with pytest.raises(DeviceError, match="one for each electrode"):
        device.scan(TWO)
    assert rig.log[-1] == "release"
    with pytest.raises(DeviceError, match="shunt is 0 ohm"):
        rig_device(rig, shunt=0)
    with pytest.raises(DeviceError, match="settle is -1 s"):
        rig_device(rig, settle=-1)


def test_a_board_that_was_pulled_out_is_closed_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: Rig) -> None:
        self.log.append("failed")
        raise DeviceError("no such board")

    monkeypatch.setattr(Rig, "close", fail)
    rig = Rig()
    rig_device(rig).close()
    assert rig.log == ["release", "failed", "failed"]
    monkeypatch.setattr(Rig, "release", fail)
    rig_device(rig).scan(TWO)


def _slots_mixed_up(device: Changed, frame: Frame) -> Frame:
    """Pattern after pattern, the voltages are those of the scan before whenever they fit."""
    if (
        device.last is not None
        and device.last.pattern != frame.pattern
        and device.last.voltages.shape == frame.voltages.shape
    ):
        return replace(frame, voltages=device.last.voltages)
    return frame


def _raising(device: Changed, frame: Frame) -> Frame:
    if frame.pattern.n_inj > 30:
        raise ValueError("index 30 is out of bounds")
    return frame


BROKEN: dict[str, tuple[Callable[[Changed, Frame], Frame], str, str]] = {
    "another pattern": (lambda d, f: d.first, "current enters", "another pattern than was asked for"),
    "no currents": (lambda d, f: replace(f, currents=0 * f.currents), "frames fit", "not positive"),
    "missing currents": (lambda d, f: replace(f, currents=np.nan * f.currents), "frames fit", "not finite"),
    "all missing": (lambda d, f: replace(f, voltages=np.nan * f.voltages), "frames fit", "no voltage is finite"),
    "missing later": (
        lambda d, f: replace(f, voltages=f.voltages * (np.nan if f.sequence > 4 else 1)),
        "repeated",
        "no voltage is finite",
    ),
    "nothing but 0": (lambda d, f: replace(f, voltages=np.zeros(f.pattern.n_meas)), "reciproc", "all are exactly 0"),
    "silent clipping": (
        lambda d, f: replace(f, voltages=np.where(f.voltages > 0.1, np.inf, f.voltages)),
        "frames fit",
        "CLIPPED",
    ),
    "beyond its range": (lambda d, f: replace(f, voltages=1e3 * f.voltages), "frames fit", "beyond full_scale"),
    "signs exchanged": (lambda d, f: replace(f, voltages=-f.voltages), "current enters", "signs swapped"),
    "one wrong channel": (
        lambda d, f: replace(f, voltages=np.where(f.pattern.quadruples[:, 2] % 3 == 0, 0.6, 1) * f.voltages),
        "reciproc",
        "mixed-up channels",
    ),
    "wrong currents": (
        lambda d, f: replace(f, currents=f.currents * (1 + np.arange(f.pattern.n_inj))),
        "superposition",
        "wrong currents",
    ),
    "too noisy": (
        lambda d, f: replace(f, voltages=f.voltages + d.random.normal(0, 0.1, f.pattern.n_meas)),
        "repeated",
        "scatter by",
    ),
    "clock stands": (lambda d, f: replace(f, time=1.0), "time and sequence", "times do not rise"),
    "clock in milliseconds": (lambda d, f: replace(f, time=1e6 * f.time), "time and sequence", "is it in seconds"),
    "sequence stands": (lambda d, f: replace(f, sequence=7), "time and sequence", "sequence numbers do not rise"),
    "slots mixed up": (_slots_mixed_up, "more patterns than slots", "voltages are off"),
    "raises anything": (_raising, "largest pattern", "raised ValueError"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_driver_fails_by_name(name: str) -> None:
    change, check, words = BROKEN[name]
    found = failed(check_device(Changed(change)))
    assert any(any(part in title for part in check.split("|")) for title in found), found
    assert any(part in text for text in found.values() for part in words.split("|")), found
    assert not any("Warning" in text for text in found.values()), found  # such as of a division by no current


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"full_scale": 0.0}, "full_scale is 0"),
        ({"excitation": 0.0}, "excitation is 0"),
        ({"name": " "}, "no name"),
        ({"n_electrodes": 3}, "4 at least"),
        ({"features": Feature.VOLTAGE_SOURCE}, "without measured currents"),
        ({"settle_time": 100.0}, "are they in seconds"),
    ],
)
def test_capabilities_that_make_no_sense_are_told(change: dict[str, object], words: str) -> None:
    found = failed(check_device(Fake(replace(ABLE, **change))))  # type: ignore[arg-type]
    assert words in found["capabilities make sense"]


def test_a_driver_that_hangs_beyond_its_timeout_fails() -> None:
    class Hanging(Fake):
        def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
            if timeout < 0.1:
                time.sleep(1.2)
            return super()._scan(pattern, timeout)

    found = failed(check_device(Hanging()))
    assert list(found) == ["timeouts are kept"]


def test_a_driver_that_a_timeout_or_refusal_breaks_fails() -> None:
    class Fragile(Fake):
        broken = False

        def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
            if timeout < 0.1:
                self.broken = True
            if self.broken:
                raise DeviceLost("out of step")
            return super()._scan(pattern, timeout)

    assert {"timeouts are kept", "several threads"} <= failed(check_device(Fragile())).keys()


def test_a_driver_that_sorts_its_threads_badly_fails() -> None:
    class Shared(Fake):
        """Undoes the lock of its base class, and has one buffer for all."""

        def __init__(self) -> None:
            super().__init__()
            self._lock = _NoLock()  # type: ignore[assignment]

        def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
            self.buffer = super()._scan(pattern, timeout)
            time.sleep(2e-3)
            return self.buffer

    assert list(failed(check_device(Shared()))) == ["several threads"]


class _NoLock:
    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...


def test_a_driver_that_works_on_after_close_or_lies_about_its_size_fails() -> None:
    class Undead(Fake):
        def _check_open(self) -> None:
            pass

    assert list(failed(check_device(Undead()))) == ["closing twice"]

    class Small(Fake):
        def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
            if pattern.n_meas > 500:
                raise DeviceRefused("out of memory")
            return super()._scan(pattern, timeout)

    assert failed(check_device(Small())) == {"largest pattern": "DeviceRefused: out of memory"}


def test_plugins_are_found_by_their_entry_points(monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib.metadata import EntryPoint

    entry = EntryPoint("rig", "mux_and_daq:open_simulated", "ohmskin.devices")
    monkeypatch.setattr("ohmskin.registry.entry_points", lambda group: [entry] if group == entry.group else [])
    monkeypatch.setattr(mux_and_daq, "open_simulated", lambda url: rig_device(Rig()))
    assert drivers()["rig"] == "mux_and_daq:open_simulated"
    with connect("rig:simulated") as device:
        assert math.isclose(device.scan(TWO).currents[0], 2e-3)
    with pytest.raises(DeviceError, match="lacks a card"):
        mux_and_daq.open_rig("rig:/dev/ttyUSB0")
    for wrong, why in (
        (lambda url: {}["card"], r"does not work: KeyError: 'card'"),
        (lambda url: None, "returned None, which is no Device"),
    ):
        monkeypatch.setattr(mux_and_daq, "open_simulated", wrong)
        with pytest.raises(DeviceError, match=rf"driver 'rig' \(mux_and_daq:open_simulated\) {why}"):
            connect("rig:simulated")
    for scanned, why in (
        (lambda pattern, timeout: {}["card"], "does not work: KeyError: 'card'"),
        (lambda pattern, timeout: None, "gave None for a scan; it must be a Frame"),
    ):
        device = rig_device(Rig())
        monkeypatch.setattr(device, "_scan", scanned)
        monkeypatch.setattr(mux_and_daq, "open_simulated", lambda url, device=device: device)
        with (
            connect("rig:simulated") as opened,
            pytest.raises(DeviceError, match=rf"driver 'rig' \(mux_and_daq:open_simulated\) {why}"),
        ):
            opened.scan(TWO)
