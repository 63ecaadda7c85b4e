"""Calibration: the quiet skin, strength to newtons, and what is kept in the skin's file."""

import re
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin.calibrate import PressGuide, PressSample, calibrate_quiet, fit_force, press_plan
from ohmskin.cli.calibrate import calibrate
from ohmskin.cli.options import write_skin
from ohmskin.contacts import Contact
from ohmskin.engine import Engine
from ohmskin.errors import DataError, DeviceError, OhmskinError, SkinError
from ohmskin.scan import Frame, n_pairs
from ohmskin.skin import Calibration, Fault, Press, Skin, VirtualSkin

PAPER = Skin.load("paper")


def sampled(law: "object", forces: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0), lag: float = 0.0) -> list[PressSample]:
    """Presses at two places with strength `law(force)`; unloading shows `lag` (a share) more."""
    return [
        PressSample((0.1, y), f, law(f) * (1.0 if loading else 1 + lag), loading)  # type: ignore[operator]
        for y in (0.05, 0.15)
        for loading in (True, False)
        for f in forces
    ]


def contact(at: tuple[float, float], strength: float) -> Contact:
    return Contact(at, 1e-4, strength, 1.0, 0.1)


@pytest.fixture(scope="module")
def quiet() -> Calibration:
    return calibrate_quiet(DirectDevice(VirtualSkin(PAPER, 1)), PAPER, "1.2.3")


def test_the_quiet_skin_is_measured(quiet: Calibration) -> None:
    assert quiet.conductivity == pytest.approx(PAPER.sheet.conductivity, rel=5e-3)
    assert quiet.noise == pytest.approx(PAPER.converter.noise, rel=0.1)
    assert len(quiet.pair_resistances) == n_pairs(16)
    assert quiet.misfit < 2e-3
    assert quiet.drift == 0
    assert (quiet.version, quiet.made_for) == ("1.2.3", PAPER.digest)


def test_another_conductivity_is_found_whatever_the_description_says() -> None:
    other = replace(PAPER, sheet=replace(PAPER.sheet, conductivity=3e-3))
    found = calibrate_quiet(DirectDevice(VirtualSkin(other, 2)), PAPER, scans=3)
    assert found.conductivity == pytest.approx(3e-3, rel=0.03)  # contacts weigh more on a better sheet


def test_contacts_worse_than_described_are_told() -> None:
    poor = replace(PAPER, electrode=replace(PAPER.electrode, contact_resistivity=5e-3))
    found = calibrate_quiet(DirectDevice(VirtualSkin(poor, 2)), PAPER, scans=3)
    inner = (5e-3 - 1e-4) / (
        np.pi * 3e-3**2
    )  # an inner electrode; those on the rim have half of the area, or a quarter
    assert inner < found.contact_resistance < 3 * inner


def test_drift_is_told_from_noise() -> None:
    def drifting(frame: Frame) -> Frame:
        walk.append(walk[-1] + rng.normal(0, 1e-3 * np.sqrt(frame.time - times[-1]), len(frame.voltages)))
        times.append(frame.time)
        return replace(frame, voltages=frame.voltages + walk[-1])

    rng = np.random.default_rng(0)
    walk, times = [np.zeros(1)], [0.0]
    slow = replace(PAPER, converter=replace(PAPER.converter, settle=0.01))  # some 15 s in all
    device = DirectDevice(VirtualSkin(slow, 2))
    device.spoil = drifting
    found = calibrate_quiet(device, slow, scans=12)
    assert found.drift == pytest.approx(1e-3, rel=0.25)


def test_a_skin_that_is_not_in_order_is_not_calibrated() -> None:
    device = DirectDevice(VirtualSkin(PAPER, 1, [Fault.parse("open 3")]))
    with pytest.raises(DataError, match="electrode 3 is open; repair it"):
        calibrate_quiet(device, PAPER, scans=3)
    with pytest.raises(DeviceError, match="16 electrodes, skin 'ktc2023' has 32"):
        calibrate_quiet(DirectDevice(VirtualSkin(PAPER, 1)), Skin.load("ktc2023"))


def test_another_skin_on_the_line_is_told_and_a_warmer_one_with_worse_contacts_is_not(quiet: Calibration) -> None:
    calibrated = replace(PAPER, calibration=quiet)
    warm = replace(
        PAPER,
        sheet=replace(PAPER.sheet, conductivity=1.3 * PAPER.sheet.conductivity),
        electrode=replace(PAPER.electrode, contact_resistivity=5 * PAPER.electrode.contact_resistivity),
    )
    uneven = replace(PAPER, calibration=replace(quiet, log_conductivity=(0.0, 0.05, 0.05, -0.05)))
    for skin, told in ((PAPER, False), (warm, False), (uneven, True)):
        for mode in ("16P", "12B"):
            with Engine(partial(DirectDevice, VirtualSkin(skin, 3)), calibrated, mode) as engine:
                engine.calibrate()
                assert ("unlike those of the skin that was calibrated" in engine.message) == told
                assert bool(engine.message) == told


def test_the_force_curve_is_monotone_and_returns_what_was_pressed() -> None:
    curve = fit_force(sampled(lambda f: 1e-4 * f**0.7))
    calibration = curve.put_into(Calibration())
    np.testing.assert_allclose(calibration.force([1e-4 * f**0.7 for f in (1, 2, 4, 8)]), (1, 2, 4, 8), rtol=1e-9)
    assert calibration.force(1e-4 * 3**0.7) == pytest.approx(3, rel=0.03)
    newtons = calibration.force(np.linspace(0, 1e-3, 500))
    assert (np.diff(newtons) >= 0).all()
    assert newtons[0] == 0
    assert newtons[-1] == pytest.approx(8)  # the least it can be
    assert curve.error < 1e-9
    assert curve.hysteresis == 0


def test_hysteresis_and_scatter_are_shown() -> None:
    curve = fit_force(sampled(lambda f: 1e-4 * f, lag=0.2))
    assert curve.hysteresis == pytest.approx(0.2 * 8 / (8 * 1.1))
    assert curve.error > 0.1


def test_forces_that_strength_cannot_tell_apart_are_named() -> None:
    curve = fit_force(sampled(lambda f: 1e-4 * min(f, 4.0)))
    assert curve.forces == pytest.approx((1.0, 2.0, np.sqrt(4.0 * 8.0)))
    assert curve.flat == (8.0,)


def test_scatter_between_places_does_not_make_forces_small() -> None:
    """Strength that saturates, and differs by 15 % between places, each of which is pressed once."""
    random, off = np.random.default_rng(1), []
    for _ in range(100):
        forces, scatter = np.exp(random.uniform(-1, 1.5, (2, 10))), np.exp(0.15 * random.normal(size=(2, 10)))
        known, felt = 1e-4 * forces**0.25 * scatter
        curve = fit_force([PressSample((0.1, 0.1), f, s, True) for f, s in zip(forces[0], known, strict=True)])
        off += np.log(curve.put_into(Calibration()).force(felt) / forces[1]).tolist()
    assert np.median(off) == pytest.approx(0, abs=0.1)


def test_presses_not_felt_are_counted_and_left_out() -> None:
    curve = fit_force(sampled(lambda f: 1e-4 * f if f > 1 else 0.0))
    assert curve.missed == 4
    assert curve.forces[0] == 2.0
    with pytest.raises(DataError, match="0 of 16 presses were detected"):
        fit_force(sampled(lambda f: 0.0))
    with pytest.raises(DataError, match="does not rise with force"):
        fit_force(sampled(lambda f: 1e-4 / f))


def test_a_plan_stays_on_the_sheet_and_loads_and_unloads() -> None:
    for name in ("paper", "tank"):
        skin = Skin.load(name)
        plan = press_plan(skin, [2.0, 1.0, 4.0], places=5)
        assert [step.force for step in plan[:5]] == [1, 2, 4, 2, 1]
        assert [step.loading for step in plan[:5]] == [True, True, True, False, False]
        at = np.array(sorted({step.at for step in plan}))
        assert len(at) == 5
        assert (np.ptp(at, axis=0) > 0.4 * np.ptp(np.reshape(skin.domain.bounds, (2, 2)), axis=0)).all()
        apart = np.sqrt(skin.domain.area / 16)
        assert np.linalg.norm(at[:, None] - skin.electrodes.positions, axis=2).min() > 0.2 * apart
        assert (skin.domain.depth([step.at for step in plan]) > 0).all()
    assert "put 102 g in total (1.00 N) at x 100 mm, y 100 mm" in str(press_plan(PAPER, [1.0, 2.0])[0])
    with pytest.raises(SkinError, match="two or more"):
        press_plan(PAPER, [1.0])


def test_the_guide_waits_for_nobody_and_takes_the_median_near_the_place() -> None:
    plan = press_plan(PAPER, [1.0, 2.0], places=1)
    guide = PressGuide(plan, settle=2, cycles=3)
    assert not any(guide.add([contact((0.1, 0.1), 9.0)]) for _ in range(20))  # nobody has begun
    guide.begin()
    seen = [(0.1, 9.0), (0.1, 9.0), (0.1, 1.0), (0.18, 7.0), (0.105, 3.0)]  # two to settle; one far away
    done = [guide.add([contact((x, 0.1), strength)]) for x, strength in seen]
    assert done == [False] * 4 + [True]
    assert guide.samples[0].strength == 1.0
    for _ in plan[1:]:
        guide.begin()
        while not guide.add([]):
            pass
    assert guide.step is None
    assert [sample.strength for sample in guide.samples[1:]] == [0.0, 0.0]


def test_the_force_of_a_virtual_press_is_the_integral_of_its_pressure() -> None:
    press, foam = Press((0.1, 0.1), 8e-3, 20e3), 2e-3
    step = 5e-5
    x = np.arange(-0.011, 0.011, step)
    distance = np.hypot(*np.meshgrid(x, x))
    pressure = 20e3 * np.clip((8e-3 + foam - distance) / foam, 0, 1)
    assert press.force(foam) == pytest.approx(pressure.sum() * step**2, rel=1e-3)
    assert press.force() == pytest.approx(20e3 * np.pi * 8e-3**2)


def test_a_calibration_is_kept_in_the_file_and_old_files_still_load(quiet: Calibration) -> None:
    full = fit_force(sampled(lambda f: 1e-4 * f)).put_into(quiet)
    skin = replace(PAPER, calibration=full)
    again = Skin.parse(skin.dump())
    assert again == skin
    assert again.calibration.force(2e-4) == pytest.approx(2.0)
    assert "calibration" not in PAPER.dump()
    assert PAPER.calibration == Calibration()
    with pytest.raises(SkinError, match="not calibrated to newtons; run `ohmskin calibrate`"):
        PAPER.calibration.force(1e-4)
    np.testing.assert_allclose(skin.transfer_model().conductivity, quiet.conductivity, rtol=0.03)
    assert skin.transfer_model().conductivity.mean() == pytest.approx(PAPER.sheet.conductivity, rel=2e-3)


@pytest.mark.parametrize(
    "change", [{"electrode": {"inset": 0.01}}, {"sheet": {"width": 0.21}}, {"imaging": {"amplitude": 0.2}}]
)
def test_a_calibration_of_another_skin_is_refused(quiet: Calibration, change: dict[str, dict[str, float]]) -> None:
    ((table, values),) = change.items()
    other = replace(PAPER, **{table: replace(getattr(PAPER, table), **values)})  # type: ignore[arg-type]
    with pytest.raises(
        SkinError, match=r"was made for another skin .* remove \[calibration\] and run `ohmskin calibrate`"
    ):
        replace(other, calibration=quiet)
    replace(
        PAPER, sheet=replace(PAPER.sheet, conductivity=1e-3), calibration=quiet
    )  # which calibration finds out itself


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("strengths = [1e-4, 2e-4]\nforces = [1.0]", "2 strengths and 1 forces"),
        ("strengths = [1e-4, 1e-4]\nforces = [1.0, 2.0]", "strengths must rise"),
        ("strengths = [1e-4, -1]\nforces = [1.0, 2.0]", "strengths must"),
        ("strengths = 3", "strengths must be a list of numbers"),
        ('strengths = ["a", "b"]\nforces = [1.0, 2.0]', "must"),
        ("noise = -1.0", "noise is -1.0; it must be 0 to"),
        ("colour = 1", "unknown entry calibration.colour"),
    ],
)
def test_a_calibration_that_makes_no_sense_is_told(text: str, message: str) -> None:
    with pytest.raises(SkinError, match=message):
        Skin.parse(f"[calibration]\n{text}")


def test_the_virtual_skin_calibrates_itself_from_the_command_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ohmskin", "calibrate", "--places", "2", "--weights", "200", "500"]
    arguments = ["--output", "mine.toml", "--picture", "force.png", "--mode", "16I"]
    done = subprocess.run([*command, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    skin = Skin.load(tmp_path / "mine.toml")
    assert (skin.calibration.mode, skin.calibration.made_for) == ("16I", PAPER.digest)
    assert skin.calibration.forces == pytest.approx((1.961, 4.903), rel=1e-3)
    assert (tmp_path / "force.png").read_bytes().startswith(b"\x89PNG")
    assert re.findall(r"\[(\d) of 6\] .*\n    strength \d", done.stdout) == list("123456")


@pytest.mark.parametrize(("factor", "is_told"), [(1e3, True), (3.0, False), (1e-2, True)])
def test_a_conductivity_that_is_rather_a_wrong_unit_is_told(
    factor: float, is_told: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    skin = VirtualSkin(replace(PAPER, sheet=replace(PAPER.sheet, conductivity=factor * PAPER.sheet.conductivity)), 3)
    monkeypatch.setattr("ohmskin.cli.calibrate.open_skin", lambda device, name: (DirectDevice(skin), PAPER))
    calibrate(device="virtual:", force=False, output=tmp_path / "mine.toml")
    with Engine(partial(DirectDevice, skin), PAPER, "12B") as engine:
        engine.calibrate()
        for said in (capsys.readouterr().out, engine.message):
            told = re.findall(r"the voltages are (.*) times those of the described conductivity: check the units", said)
            assert [float(times) for times in told] == pytest.approx([1 / factor] if is_told else [], rel=0.02)


def test_a_skin_that_was_there_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.toml"
    names = ["first", "second", "third"]
    for name in names:
        write_skin(path, replace(PAPER, name=name))
    found = [Skin.load(one).name for one in (tmp_path / "mine-before-1.toml", tmp_path / "mine-before-2.toml", path)]
    assert found == names
    assert len(list(tmp_path.iterdir())) == 3
    assert f"the {path} that was there is now {tmp_path / 'mine-before-2.toml'}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"out": "no/such/folder.toml"}, "cannot write no/such"),
        ({"out": "."}, "is a folder"),
        ({"mode": "9Z"}, "mode .9Z. is not possible"),
    ],
)
def test_mistakes_are_told_before_anything_is_measured(
    settings: dict[str, str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    device = DirectDevice(VirtualSkin(PAPER, 1))
    monkeypatch.setattr("ohmskin.cli.calibrate.open_skin", lambda *_: (device, PAPER))
    device.spoil = lambda _: pytest.fail("scanned")
    out = Path(settings.pop("out", "mine.toml"))
    with pytest.raises(OhmskinError, match=words):
        calibrate(output=out, **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"force": False, "weights": (100.0, 200.0)}, "--weights has no effect where --no-force is given"),
        ({"force": False, "force_from": "zenoh"}, "--force-from has no effect where --no-force is given"),
        ({"presses": Path("x.csv"), "places": 3}, "--places has no effect where --presses is given"),
        ({"force_from": "zenoh", "presses": Path("x.csv")}, "--presses has no effect where --force-from is given"),
        ({"samples": 20}, "--samples has no effect where forces come from weights"),
        ({"force_topic": "/other"}, "--force-topic has no effect where forces come from weights"),
    ],
)
def test_an_option_that_would_be_ignored_is_refused(options: dict[str, object], says: str) -> None:
    with pytest.raises(OhmskinError, match=f"^{says}; leave it out$"):
        calibrate(**options)  # type: ignore[arg-type]
