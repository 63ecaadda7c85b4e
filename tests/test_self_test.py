"""The self-test on the physics twin with things wrong in its wiring, and on instruments with things wrong in them."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin.calibrate import SelfTest, WiringDiagnosis, diagnose, self_test, terminal_pattern
from ohmskin.calibrate.measures import Linearity, mean_frame
from ohmskin.errors import DataError, DeviceError, SkinError
from ohmskin.scan import DrivePattern, Frame, adjacent
from ohmskin.skin import Fault, PressedSheet, Skin, VirtualSkin
from ohmskin.skin.faults import Wiring

PAPER = Skin.load("paper")


@cache
def in_order(skin: Skin) -> VirtualSkin:
    return VirtualSkin(skin)


def virtual(skin: Skin, faults: tuple[str, ...], seed: int) -> VirtualSkin:
    """The same as `VirtualSkin(skin, seed, faults)`, quicker where the physics stays the same."""
    parsed = [Fault.parse(fault) for fault in faults]
    if any(fault.kind == "high" for fault in parsed):
        return VirtualSkin(skin, seed, parsed)
    shared = in_order(skin)
    shared.wiring = Wiring(parsed, len(skin.electrodes))
    shared.reset(seed)
    return shared


def diagnosed(*faults: str, skin: Skin = PAPER, seed: int = 1, scans: int = 4) -> WiringDiagnosis:
    wired = virtual(skin, faults, seed)
    return diagnose(skin, mean_frame([wired.scan(terminal_pattern(len(skin.electrodes))) for _ in range(scans)]))


def said(*faults: str, skin: Skin = PAPER) -> list[str]:
    return [str(finding) for finding in diagnosed(*faults, skin=skin).findings]


def test_the_twin_in_order_is_in_order() -> None:
    found = diagnosed()
    assert found.findings == ()
    assert found.conductivity == pytest.approx(PAPER.sheet.conductivity, rel=5e-3)
    assert found.misfit < 2e-3
    assert found.contradiction < 1e-3


@pytest.mark.parametrize("name", ["sleeve", "dome"])
def test_another_skin_is_not_in_order(name: str) -> None:
    """Its sheet had a negative conductivity, and all 16 electrodes were in order."""
    other = Skin.load(name)
    device = VirtualSkin(other)
    found = diagnose(PAPER, mean_frame([device.scan(terminal_pattern(16)) for _ in range(4)]))
    assert found.findings
    assert found.conductivity > 0 or "is it the skin described" in str(found.findings[-1])


def test_an_open_electrode_and_a_short_are_named_and_nothing_else() -> None:
    assert said("open 3", "short 7 8") == ["electrode 3 is open", "electrodes 7 and 8 are shorted together"]


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        (("swap 1 2",), ["electrodes 1 and 2 are swapped"]),
        (("swap 12 13",), ["electrodes 12 and 13 are swapped"]),
        (("short 0 15 300",), ["electrodes 0 and 15 are bridged by about 3e+02 ohm"]),
        (("high 5 20",), ["electrode 5 has a poor contact"]),
        (("high 12 20",), ["electrode 12 has a poor contact"]),
        (("swap 0 9", "swap 4 12"), ["electrodes 0 and 9 are swapped", "electrodes 4 and 12 are swapped"]),
        (("open 0", "swap 3 4"), ["electrode 0 is open", "electrodes 3 and 4 are swapped"]),
        (("open 1", "open 14"), ["electrode 1 is open", "electrode 14 is open"]),
        (("open 15",), ["electrode 15 is open"]),
        (("short 0 1", "high 10 40"), ["electrodes 0 and 1 are shorted", "electrode 10 has a poor contact"]),
    ],
)
def test_faults_are_named(faults: tuple[str, ...], words: list[str]) -> None:
    found = said(*faults)
    assert len(found) == len(words)
    for text, expected in zip(found, words, strict=True):
        assert text.startswith(expected)


def test_the_size_of_a_poor_contact_and_of_a_bridge_is_measured() -> None:
    extra = 39 * PAPER.electrode.contact_resistivity / (np.pi * PAPER.electrode.radius**2)  # ohm, of an inner electrode
    (poor,) = diagnosed("high 12 40").findings
    assert poor.value == pytest.approx(extra, rel=0.15)
    (bridge,) = diagnosed("short 4 9 150").findings
    assert bridge.value == pytest.approx(150, rel=0.05)


@pytest.mark.parametrize("name", ["paper", "paper-rim16"])
def test_faults_by_chance_are_all_found_and_none_is_invented(name: str) -> None:
    """Single and double faults in turn; `hits` and `false` over more of them are in docs/guide/self-test.md."""
    skin, rng = Skin.load(name), np.random.default_rng(3)
    n_elec = len(skin.electrodes)
    hits = wanted = false = 0
    for trial in range(6):
        left = rng.permutation(n_elec).tolist()
        faults = []
        for _ in range(1 + trial % 2):
            match rng.choice(["open", "short", "swap", "high"]):
                case "open":
                    faults.append(f"open {left.pop()}")
                case "high":
                    faults.append(f"high {left.pop()} {20 * 10 ** rng.uniform(0, 1.5):.1f}")
                case "short":
                    faults.append(f"short {left.pop()} {left.pop()} {10 ** rng.uniform(-1, 1.3):.2f}")
                case "swap":
                    faults.append(f"swap {left.pop()} {left.pop()}")
        kinds = {"open": "open", "short": "shorted", "swap": "swapped", "high": "high"}
        truth = {(kinds[f.kind], tuple(sorted(f.electrodes))) for f in map(Fault.parse, faults)}
        found = {(finding.kind, finding.electrodes) for finding in diagnosed(*faults, skin=skin, seed=trial).findings}
        hits, wanted, false = hits + len(found & truth), wanted + len(truth), false + len(found - truth)
    assert (hits, false) == (wanted, 0)


def test_a_sheet_of_uneven_conductivity_does_not_look_like_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    from ohmskin.forward import TransferModel
    from ohmskin.skin import twin
    from ohmskin.skin import virtual as virtual_skin

    def uneven(mesh, electrodes, sigma):  # type: ignore[no-untyped-def]
        x, y = mesh.centroids.T / 0.2
        waves = 0.3 * np.sin(2 * np.pi * x) * np.cos(np.pi * y) + 0.2 * np.cos(3 * np.pi * (x + y))
        return TransferModel(mesh, electrodes, sigma * np.exp(waves))  # 0.6 to 1.6 times

    even = VirtualSkin(PAPER)
    monkeypatch.setattr(twin, "TransferModel", uneven)
    monkeypatch.setattr(virtual_skin, "_sheet", virtual_skin._sheet.__wrapped__)  # none that was even, nor for others
    in_order.cache_clear()
    assert not np.allclose(in_order(PAPER).transfer_resistance, even.transfer_resistance, rtol=0.01)
    assert said() == []
    assert said("open 3", "short 7 8") == ["electrode 3 is open", "electrodes 7 and 8 are shorted together"]
    assert said("swap 5 13") == ["electrodes 5 and 13 are swapped"]
    in_order.cache_clear()


def test_a_sense_wire_that_is_off_is_told_from_an_electrode_that_is() -> None:
    wired = virtual(PAPER, (), 1)
    frame = mean_frame([wired.scan(terminal_pattern(16)) for _ in range(4)])
    pickup = np.random.default_rng(0).normal(0, 0.05, frame.pattern.n_meas)
    _, plus, minus = frame.pattern.measurements.T
    volts = np.where((plus == 6) | (minus == 6), pickup, frame.voltages)
    found = diagnose(PAPER, replace(frame, voltages=volts)).findings
    assert [(finding.kind, finding.electrodes) for finding in found] == [("contradicts", (6,))]


def test_an_inverting_instrument_is_named() -> None:
    frame = mean_frame([virtual(PAPER, (), 1).scan(terminal_pattern(16)) for _ in range(4)])
    found = diagnose(PAPER, replace(frame, voltages=-frame.voltages)).findings
    assert [(finding.kind, finding.electrodes) for finding in found] == [("contradicts", ())]
    assert "every voltage has the wrong sign" in found[0].text


def test_a_dead_instrument_is_one_finding_not_sixteen() -> None:
    frame = virtual(PAPER, (), 1).scan(terminal_pattern(16))
    (finding,) = diagnose(PAPER, replace(frame, voltages=0 * frame.voltages)).findings
    assert finding.kind == "silent"
    assert "check the source" in finding.text
    unplugged = [f"open {e}" for e in range(16)]  # every wire picks up something
    assert [finding.kind for finding in diagnosed(*unplugged).findings] == ["silent"]
    assert outcome(lambda frame: frame, *unplugged).table() == []
    noise = np.random.default_rng(0).normal(0, 0.05, len(frame.voltages))
    assert [finding.kind for finding in diagnose(PAPER, replace(frame, voltages=noise)).findings] == ["contradicts"]
    with pytest.raises(DataError, match=r"terminal_pattern\(16\)"):
        diagnose(PAPER, virtual(PAPER, (), 1).scan(adjacent([PAPER.electrodes.rings[0]])))


# --- the instrument ---------------------------------------------------------------------------------------------------


def outcome(change: Callable[[Frame], Frame] = lambda frame: frame, *faults: str) -> SelfTest:
    """Of an instrument that changes its frames."""
    instrument = DirectDevice(virtual(PAPER, faults, 3))
    instrument.spoil = change
    return self_test(instrument, PAPER)


def test_an_instrument_in_order_is_measured_and_nothing_remarked() -> None:
    found = outcome()
    assert found.findings == ()
    assert found.remarks == ()
    assert found.noise is not None
    assert found.noise.typical == pytest.approx(PAPER.converter.noise, rel=0.1)
    assert found.offset is not None
    assert found.offset.rms < 1.3 * found.offset.noise
    assert found.linearity is not None
    assert found.linearity.error < 3 * found.linearity.noise
    assert found.rates is not None
    assert found.rates.proposed == found.rates.cycles


def test_noise_beyond_the_description_and_a_noisy_electrode_are_remarked() -> None:
    quiet = replace(PAPER, converter=replace(PAPER.converter, noise=0.05e-3))
    found = self_test(DirectDevice(virtual(PAPER, (), 3)), quiet)
    assert any(remark.startswith("noise is") and "4 times" in remark for remark in found.remarks)
    rng = np.random.default_rng(0)

    def crackle(frame: Frame) -> Frame:
        _, plus, minus = frame.pattern.measurements.T
        return replace(
            frame, voltages=frame.voltages + ((plus == 5) | (minus == 5)) * rng.normal(0, 3e-3, frame.pattern.n_meas)
        )

    assert any("electrode 5 is noisier" in remark for remark in outcome(crackle).remarks)


def test_an_offset_is_found_at_its_electrode() -> None:
    def shift(frame: Frame) -> Frame:
        _, plus, minus = frame.pattern.measurements.T
        return replace(frame, voltages=frame.voltages + 5e-3 * ((plus == 5).astype(float) - (minus == 5)))

    found = outcome(shift)
    assert found.offset is not None
    assert found.offset.worst_electrode == 5
    assert found.offset.worst == pytest.approx(5e-3 * 15 / 16, rel=0.05)  # against the mean of all
    assert any("offset" in remark and "electrode 5" in remark for remark in found.remarks)


def test_an_offset_is_told_from_currents_that_differ_with_their_direction() -> None:
    """A pair's two currents differ by a fifth; what does not turn with them is their offset, not their difference."""

    def lopsided(frame: Frame) -> Frame:
        _, plus, minus = frame.pattern.measurements.T
        factor = np.where(frame.pattern.injections[:, 0] < frame.pattern.injections[:, 1], 1.2, 1.0)
        volts = frame.voltages * factor[frame.pattern.measurements[:, 0]]
        return replace(
            frame,
            voltages=volts + 5e-3 * ((plus == 5).astype(float) - (minus == 5)),
            currents=frame.currents * factor,
        )

    found = outcome(lopsided)
    assert found.offset is not None
    assert found.offset.worst_electrode == 5
    assert found.offset.worst == pytest.approx(5e-3 * 15 / 16, rel=0.05)


@pytest.mark.parametrize(
    ("error", "noise", "remarked"),
    [(0.019, 1e-4, False), (0.021, 1e-4, True), (0.05, 0.011, False), (0.06, 0.011, True)],
)
def test_linearity_is_remarked_beyond_two_per_cent_and_beyond_its_noise(
    error: float, noise: float, remarked: bool
) -> None:
    found = replace(outcome(), linearity=Linearity(error, noise, 0.0))
    assert any("do not add up" in remark for remark in found.remarks) == remarked


def test_currents_that_do_not_add_up_are_remarked() -> None:
    def compress(frame: Frame) -> Frame:  # a source that says more current than it gives
        return replace(frame, currents=frame.currents * (1 + 0.1 * (frame.currents > 2.6e-3)))

    found = outcome(compress)
    assert found.linearity is not None
    assert found.linearity.error > 0.02
    assert any("do not add up" in remark for remark in found.remarks)


def test_settling_is_measured_and_a_longer_wait_proposed() -> None:
    hasty = replace(PAPER, converter=replace(PAPER.converter, settle=20e-6, time_constant=8e-6))

    class Hasty(DirectDevice):
        def __init__(self) -> None:
            super().__init__(VirtualSkin(hasty, 3))
            self.capabilities = replace(self.capabilities, settle_time=20e-6, conversion_time=1e-6)

    found = self_test(Hasty(), hasty)
    assert found.settling is not None
    assert found.settling.left == pytest.approx(np.exp(-20 / 8), rel=0.03)
    swing_over_noise = found.settling.needed / 8e-6  # in time constants: the logarithm of step over noise
    assert 6 < swing_over_noise < 11
    assert any("is left when voltages are sampled; wait" in remark for remark in found.remarks)
    assert found.rates is not None
    assert found.rates.settle_time == found.settling.needed
    assert found.rates.proposed["16O"] < found.rates.cycles["16O"]


def test_all_is_measured_with_electrodes_that_are_not_in_order() -> None:
    found = outcome(lambda frame: frame, "open 3", "short 7 8")
    assert found.remarks == ()
    assert found.noise is not None
    data = json.loads(found.to_json())
    assert [finding["text"] for finding in data["diagnosis"]["findings"]] == [
        str(finding) for finding in found.findings
    ]
    assert data["diagnosis"]["series"][3] is None
    assert len(found.table()) > 10


def test_devices_that_cannot_be_tested_are_told() -> None:
    device = DirectDevice(virtual(PAPER, (), 1))
    with pytest.raises(DeviceError, match="16 electrodes, skin 'ktc2023' has 32"):
        self_test(device, Skin.load("ktc2023"))
    device.reference = [virtual(PAPER, (), 1).scan(adjacent([PAPER.electrodes.rings[0]]))]
    with pytest.raises(DeviceError, match="a recording cannot be tested"):
        self_test(device, PAPER)


def test_the_command_says_so_and_leaves_table_picture_and_json(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "ohmskin",
        "self-test",
        "--output",
        "out",
        "--fault",
        "open 3",
        "--fault",
        "short 7 8",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=500)
    assert done.returncode == 1, done.stderr
    assert done.stdout.splitlines()[:2] == ["electrode 3 is open", "electrodes 7 and 8 are shorted together"]
    assert not any("electrode" in line for line in done.stdout.splitlines()[2:])
    assert "round trip" in done.stdout
    data = json.loads((tmp_path / "out" / "self-test.json").read_text())
    assert data["link"]["bytes_per_scan"] > 312  # 78 voltages of 4 bytes: the first scan of the default mode
    assert (tmp_path / "out" / "self-test.png").read_bytes().startswith(b"\x89PNG")


# --- faults of the twin -----------------------------------------------------------------------------------------------


def test_a_fault_is_read_and_written() -> None:
    for text in ("open 3", "short 7 8 1", "short 7 8 50", "swap 1 2", "high 5 20"):
        assert str(Fault.parse(text)) == text
    assert Fault.parse("short 7 8") == Fault("short", (7, 8), 1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is not known"),
        ("broken 3", 'must be like "open 3"'),
        ("open", "it takes 1"),
        ("open x", "not a number"),
        ("open 3 4", "has 2 numbers"),
        ("short 7 7", "it takes 2"),
        ("high 5", "has 1 numbers"),
        ("high 5 0.5", "factor 0.5; it must be 1 to"),
        ("open -1", "names electrodes"),
        ("high 5 nan", "factor nan"),
    ],
)
def test_a_fault_that_is_none_is_told(text: str, message: str) -> None:
    with pytest.raises(SkinError, match=message):
        Fault.parse(text)


def test_faults_must_fit_the_skin_and_each_other() -> None:
    with pytest.raises(SkinError, match="names electrode 16; there are 16"):
        VirtualSkin(PAPER, 1, [Fault.parse("open 16")])
    with pytest.raises(SkinError, match="electrode 3 is in two faults"):
        VirtualSkin(PAPER, 1, [Fault.parse("open 3"), Fault.parse("short 3 4")])


def test_the_wiring_of_the_twin_obeys_its_circuit() -> None:
    sheet = PressedSheet(PAPER)
    r = sheet.untouched

    def across(resistance: np.ndarray, a: int, b: int) -> float:
        return float(resistance[a, a] + resistance[b, b] - 2 * resistance[a, b])

    bridged = virtual(PAPER, ("short 7 8 200",), 1).transfer_resistance
    assert across(bridged, 7, 8) == pytest.approx(1 / (1 / across(r, 7, 8) + 1 / 200))
    assert across(bridged, 0, 5) < across(r, 0, 5)
    swapped = virtual(PAPER, ("swap 1 2",), 1).transfer_resistance
    assert across(swapped, 1, 9) == pytest.approx(across(r, 2, 9))
    assert across(swapped, 1, 2) == pytest.approx(across(r, 1, 2))
    opened = virtual(PAPER, ("open 3",), 1)
    frame = opened.scan(DrivePattern(np.array([[3, 0], [0, 3], [0, 9]]), np.array([[0, 5, 6], [1, 5, 6], [2, 5, 6]])))
    assert (np.abs(frame.currents[:2]) < 1e-5).all()
    assert (np.abs(frame.voltages[:2]) < 2e-3).all()
    assert abs(frame.voltages[2]) > 0.01
