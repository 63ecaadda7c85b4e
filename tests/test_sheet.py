"""Self-calibration: where electrodes are and how even a sheet is, told from its quiet voltages."""

import sys
from dataclasses import replace
from pathlib import Path
from subprocess import PIPE, run

import numpy as np
import pytest
from direct import DirectDevice
from live_process import serving

from ohmskin.calibrate import calibrate_quiet, skin_as_measured
from ohmskin.calibrate.sheet import SheetFit, _Unknowns, fit_sheet
from ohmskin.drive import complete_pattern
from ohmskin.engine import Engine
from ohmskin.errors import DataError, SkinError
from ohmskin.evaluate import worlds
from ohmskin.evaluate.flaws import Flaw, assumed_model
from ohmskin.evaluate.policies.schemes import scheme
from ohmskin.evaluate.setup import setup
from ohmskin.evaluate.worlds import contact
from ohmskin.forward import TransferModel
from ohmskin.forward.conductivity import cosines
from ohmskin.geometry import Disc, Electrodes, mesh_domain
from ohmskin.mcap.reader import RecordingReader
from ohmskin.skin import Calibration, Fault, Skin, VirtualSkin

PAPER = Skin.load("paper")
PATTERN = complete_pattern(PAPER.electrodes)
FLAW = Flaw(misplaced=2e-3, uneven=0.05)


def fitted(world: str, flaw: Flaw, decibels: float = 50.0) -> SheetFit:
    """The fit to a quiet world, from a description with a flaw."""
    electrodes, build = assumed_model("grid", flaw)
    if world == "pressed":
        electrodes = electrodes.with_discs(PAPER.electrode.radius, PAPER.electrode.contact_resistivity)
    noise = worlds.noise_volts(world, decibels) / worlds.CURRENT / np.sqrt(40)
    true = worlds.voltages(worlds.sheet(world, "grid").untouched, PATTERN) / worlds.CURRENT
    measured = true + noise * np.random.default_rng(flaw.draw).standard_normal(len(true))
    return fit_sheet(PAPER.domain, electrodes, build, PATTERN, measured, noise)


@pytest.mark.parametrize("world", ["discs", "pressed"])
def test_electrodes_are_found_again_on_meshes_that_the_fit_does_not_know(world: str) -> None:
    """Those at corners tell little of their place: the potential is flat there."""
    inner, rim = [], []
    for draw in range(3):
        fit = fitted(world, replace(FLAW, draw=draw))
        off = np.linalg.norm(fit.model.electrodes.positions - PAPER.electrodes.positions, axis=1)
        inner.append(off[12:].mean())
        rim.append(np.delete(off[:12], [0, 3, 6, 9]).mean())
        assert fit.before > 0.04
        assert fit.after < 1e-3  # noise alone is 0.4e-3
    assert np.mean(inner) < 0.2e-3
    assert np.mean(rim) < 0.5e-3


@pytest.mark.parametrize("world", ["discs", "pressed"])
def test_a_sound_skin_stays_as_described(world: str) -> None:
    fit = fitted(world, Flaw())
    assert fit.moved.max() < 0.3e-3
    assert fit.uneven < 0.01
    assert max(fit.before, fit.after) < 1e-3  # noise alone is 0.4e-3


def test_slopes_are_those_of_the_model() -> None:
    """Of an inner electrode, one of the rim and two waves, against differences on a fine mesh."""
    electrodes, _ = assumed_model()

    def build(placed: Electrodes, log_conductivity: np.ndarray) -> TransferModel:
        mesh = mesh_domain(PAPER.domain, 3e-3, placed.positions)
        factor = np.exp(cosines(mesh.centroids, PAPER.domain, log_conductivity))
        return TransferModel(mesh, placed, PAPER.sheet.conductivity * factor)

    unknowns, rows = _Unknowns(PAPER.domain, electrodes), PATTERN.combination(16)
    model = build(electrodes, np.zeros(36))
    slopes = rows @ unknowns.slopes(np.zeros(68), model)
    for number, step in ((13, 2e-3), (16 + 13, 2e-3), (4, 2e-3), (32 + 7, 0.05), (32 + 9, 0.05)):
        u = np.zeros(68)
        u[number] = step
        ahead, behind = (build(unknowns.electrodes(v), unknowns.log_conductivity(v)).voltages(PATTERN) for v in (u, -u))
        exact = (ahead - behind) / (2 * step)
        assert np.linalg.norm(slopes[:, number] - exact) < 0.08 * np.linalg.norm(exact), number


def test_contacts_are_placed_as_on_a_sound_skin() -> None:
    """Some places on three skins, two seeds each; docs/policies.md has the figures. One skin alone may be at 1.2."""
    mode = scheme("16P", "fit, driven")

    def error(flaw: Flaw, places: np.ndarray) -> float:
        where = setup("pressed", 50.0, flaw=flaw)
        seen = [where.simulate(mode, (contact("pressed", *at),), k).strongest - at for at in places for k in (0, 1)]
        return float(np.linalg.norm(seen, axis=1).mean())

    errors = []
    for draw in range(3):
        places, flaw = np.random.default_rng(draw).uniform(0.02, 0.18, (8, 2)), replace(FLAW, draw=draw)
        errors.append([error(each, places) for each in (Flaw(), flaw, replace(flaw, calibrated=True))])
    sound, off, calibrated = np.mean(errors, axis=0)
    assert off > 1.25 * sound
    assert calibrated < 1.2 * sound


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda p: p[[1, 0, *range(2, 16)]], "order of the electrodes"),
        (lambda p: np.where(np.arange(16)[:, None] == 13, p + 0.015, p), "not the one described"),
    ],
)
def test_what_does_not_explain_the_data_is_refused(wrong, words: str) -> None:  # type: ignore[no-untyped-def]
    electrodes, build = assumed_model()
    measured = build(electrodes.mapped(wrong), np.zeros(1)).voltages(PATTERN)
    with pytest.raises(DataError, match=words):
        fit_sheet(PAPER.domain, electrodes, build, PATTERN, measured, 1e-2)
    with pytest.raises(DataError, match="wrong sign"):
        fit_sheet(PAPER.domain, electrodes, build, PATTERN, -measured, 1e-2)


def test_missing_channels_and_a_disc_are_no_hindrance() -> None:
    tank = Skin.load("tank")
    electrodes, pattern = tank.electrodes, complete_pattern(tank.electrodes)
    assert isinstance(tank.domain, Disc)

    def build(placed: Electrodes, log_conductivity: np.ndarray) -> TransferModel:
        mesh = tank.mesh_for(placed)
        return TransferModel(mesh, placed, np.exp(cosines(mesh.centroids, tank.domain, log_conductivity)))

    turn = 0.01 * np.random.default_rng(0).standard_normal(len(electrodes))
    arcs = tank.domain.arc(electrodes.positions) + turn * tank.sheet.radius
    true = electrodes.mapped(lambda _: tank.domain.rim(arcs))
    measured = 0.7 * build(true, np.zeros(1)).voltages(pattern)
    measured[::7] = np.nan
    fit = fit_sheet(tank.domain, electrodes, build, pattern, measured, 1e-4 * np.nanmax(np.abs(measured)))
    assert fit.after < 0.1 * fit.before
    moved = tank.domain.arc(fit.model.electrodes.positions) - tank.domain.arc(electrodes.positions)
    moved = (moved + np.pi * tank.sheet.radius) % (2 * np.pi * tank.sheet.radius) - np.pi * tank.sheet.radius
    moved, turn = moved - moved.mean(), turn - turn.mean()  # that all are turned alike cannot be told
    assert np.corrcoef(moved, turn)[0, 1] > 0.75  # a sheet that is uneven at its rim looks much alike


@pytest.fixture(scope="module")
def crooked() -> Skin:
    """A skin whose inner electrodes are off, and whose sheet is uneven."""
    moved = PAPER.electrodes.positions.copy()
    moved[12:] += 3e-3 * np.array([[1, 0], [0, -1], [-0.7, 0.7], [0.6, 0.8]])
    waves = np.zeros(36)
    waves[[1, 7, 12]] = 0.04, -0.05, 0.03
    places = tuple(map(tuple, moved.tolist()))
    true = Calibration(positions=places, log_conductivity=tuple(waves.tolist()), conductivity=1.5e-3)
    return replace(PAPER, calibration=true)


def test_calibration_finds_and_keeps_what_the_skin_is_like(crooked: Skin) -> None:
    told: list[str] = []
    found = calibrate_quiet(DirectDevice(VirtualSkin(crooked, 1)), PAPER, report=told.append)
    skin = Skin.parse(replace(PAPER, calibration=found).dump())
    assert skin.calibration == found
    off = np.linalg.norm(skin.electrodes.positions - crooked.electrodes.positions, axis=1)
    assert off[12:].max() < 0.4e-3
    mesh = PAPER.mesh()
    ratio = skin.conductivity_on(mesh) / crooked.conductivity_on(mesh)
    assert np.std(ratio) < 0.02
    assert np.mean(ratio) == pytest.approx(1, rel=0.01)
    before, after = found.unexplained
    assert after < 0.05 * before
    assert len(found.contact_impedances) == 16
    assert np.median(found.contact_impedances[12:]) == pytest.approx(PAPER.electrode.contact_impedance, abs=5)
    assert len(told) == 1
    assert "unexplained before" in told[0]


def test_a_skin_that_is_not_like_that_keeps_its_description_and_says_so() -> None:
    moved = PAPER.electrodes.positions.copy()
    moved[13] += 0.02
    other = replace(PAPER, calibration=Calibration(positions=tuple(map(tuple, moved.tolist()))))
    told: list[str] = []
    found = calibrate_quiet(DirectDevice(VirtualSkin(other, 1)), PAPER, scans=3, report=told.append)
    assert (found.positions, found.log_conductivity) == ((), ())
    assert told[0].startswith("the described electrodes and sheet are kept: the quiet skin is not the one described")


def off_by(skin: Skin, true: Skin) -> float:
    """Of inner electrodes, root mean square (m)."""
    return float(np.sqrt(np.mean((skin.electrodes.positions - true.electrodes.positions)[12:] ** 2)))


def test_a_skin_is_fitted_before_the_loop_starts_where_it_is_unlike_its_description(crooked: Skin) -> None:
    told: list[str] = []
    found = skin_as_measured(DirectDevice(VirtualSkin(crooked, 1)), PAPER, "1.2.3", told.append, told.append)
    assert off_by(found, crooked) < 0.2 * off_by(PAPER, crooked)
    assert found.calibration.version == "1.2.3"
    assert len(told) == 2
    assert "unlike the description: estimating electrodes and sheet" in told[0]
    assert "unexplained before" in told[1]


def test_a_skin_as_described_or_calibrated_is_not_fitted(crooked: Skin) -> None:
    told: list[str] = []
    sound, wrong = DirectDevice(VirtualSkin(PAPER, 1)), DirectDevice(VirtualSkin(crooked, 1))
    assert skin_as_measured(sound, PAPER, report=told.append, begins=told.append) is PAPER
    calibrated = replace(PAPER, calibration=Calibration().made_now(PAPER.digest, ""))
    assert skin_as_measured(wrong, calibrated, report=told.append, begins=told.append) is calibrated
    sound.gone = True
    assert skin_as_measured(sound, PAPER, report=told.append, begins=told.append) is PAPER
    assert not told


@pytest.mark.parametrize("fault", [Fault("swap", (3, 9)), Fault("open", (5,))])
def test_a_skin_that_cannot_be_fitted_is_taken_as_described_and_that_is_said(fault: Fault) -> None:
    told: list[str] = []
    faulty = DirectDevice(VirtualSkin(PAPER, 1, faults=[fault]))
    assert skin_as_measured(faulty, PAPER, report=told.append) is PAPER
    assert len(told) == 1
    assert told[0].startswith("electrodes and sheet are taken as described: the wiring is faulty: ")


def test_a_touch_at_the_start_is_not_taken_for_electrodes_and_sheet(crooked: Skin) -> None:
    for place in ((0.06, 0.05), (0.10, 0.16)):
        told: list[str] = []
        device = DirectDevice(VirtualSkin(crooked, 1))
        device.press(1, place, 0.012, 20e3)
        assert skin_as_measured(device, PAPER, report=told.append) is PAPER
        assert len(told) == 1
        assert "lift whatever touches the skin" in told[0] or "nothing touches the skin" in told[0]


def test_a_noisy_skin_is_fitted_likewise(crooked: Skin) -> None:
    noisy = replace(crooked, converter=replace(crooked.converter, noise=3 * crooked.converter.noise))
    found = skin_as_measured(DirectDevice(VirtualSkin(noisy, 1)), PAPER)
    assert off_by(found, crooked) < 0.3 * off_by(PAPER, crooked)


def test_a_loop_tells_of_a_skin_that_is_unlike_its_description(crooked: Skin) -> None:
    told: list[str] = []
    fitted = skin_as_measured(DirectDevice(VirtualSkin(crooked, 1)), PAPER)
    with Engine(lambda: DirectDevice(VirtualSkin(crooked, 1)), PAPER, report=told.append) as engine:
        engine.calibrate()
        assert "unlike those of the skin as described" in engine.message
    assert len(told) == 1
    assert "`ohmskin calibrate`" in told[0]
    told.clear()
    with Engine(lambda: DirectDevice(VirtualSkin(crooked, 1)), fitted, report=told.append) as engine:
        engine.calibrate()
    assert not told


def test_noise_is_not_told_as_unlike_the_description() -> None:
    noisy, told = replace(PAPER, converter=replace(PAPER.converter, noise=150 * PAPER.converter.noise)), list[str]()
    with Engine(lambda: DirectDevice(VirtualSkin(noisy, 1)), PAPER, report=told.append) as engine:
        engine.calibrate()
    assert skin_as_measured(DirectDevice(VirtualSkin(noisy, 1)), PAPER, "", told.append, told.append) is PAPER
    assert not told


def test_a_recording_holds_the_skin_as_it_was_fitted(crooked: Skin, tmp_path: Path) -> None:
    own, file = tmp_path / "crooked.toml", tmp_path / "touch.mcap"
    own.write_text(crooked.dump(), encoding="utf-8")
    with serving("--skin", str(own)) as (url, _):
        command = ["record", str(file), "--device", url, "--skin", "paper", "--seconds", "0.5"]
        said = run([sys.executable, "-m", "ohmskin", *command], stdout=PIPE, text=True, check=True).stdout
    with RecordingReader(file) as reader:
        recorded = reader.skin
    assert "estimating electrodes and sheet" in said
    assert off_by(Skin.parse(recorded), crooked) < 0.2 * off_by(PAPER, crooked)


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"positions": ((0.1, 0.1),)}, "positions has 1 entries for 16 electrodes"),
        ({"positions": ((0.3, 0.1), *((0.0, 0.01 * k) for k in range(15)))}, "off the sheet"),
        ({"positions": 3.0}, "list of"),
        ({"contact_impedances": (1.0, 2.0)}, "contact_impedances has 2 entries"),
        ({"log_conductivity": (0.0, 0.1)}, "2 entries; 36, or a square"),
        ({"log_conductivity": (99.0,)}, "-10 to 10"),
    ],
)
def test_entries_that_do_not_fit_are_refused(entries, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(SkinError, match=words):
        replace(PAPER, calibration=Calibration(**entries))


def test_a_virtual_skin_is_as_its_calibration_says(crooked: Skin) -> None:
    pattern = complete_pattern(PAPER.electrodes)
    one, other = (VirtualSkin(skin, 1).scan(pattern) for skin in (PAPER, crooked))
    assert not np.allclose(one.voltages, other.voltages, atol=10 * PAPER.noise)
