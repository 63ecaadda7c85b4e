"""Newtons in the loop: presses behind contacts, followed from frame to frame on a twin whose mesh they do not know."""

import json
from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin.arrays import Floats
from ohmskin.cli.live import _Lines, _Table
from ohmskin.client import Client
from ohmskin.client.cdr import CdrDecoder
from ohmskin.client.remote import decode_contacts
from ohmskin.contacts import Contact
from ohmskin.engine import Engine, Touch
from ohmskin.errors import ModelError
from ohmskin.mcap import RecordingReader
from ohmskin.outlets.messages import encode_contacts, encode_wrench
from ohmskin.outlets.publisher import Publisher
from ohmskin.recording import Recorder
from ohmskin.recording.export import CONTACT_COLUMNS
from ohmskin.sensing import KnownPress, PressFitter, fit_layer
from ohmskin.sensing.forces import Presses, PressFollower, forces_of
from ohmskin.skin import Calibration, Press, Skin, VirtualSkin
from ohmskin.view.session import shown_contact

TRUE = Skin.load("paper")
FOAM = TRUE.contact_layer.foam_spread


@cache
def calibrated() -> Skin:
    """What ten known presses of one foot tell of a layer described with half as much conductance again, and another
    exponent."""
    layer = TRUE.contact_layer
    layer = replace(layer, conductance=1.5 * layer.conductance, exponent=layer.exponent - 0.15)
    wrong, random = replace(TRUE, contact_layer=layer), np.random.default_rng(2)
    with Engine(lambda: DirectDevice(VirtualSkin(TRUE, 1)), wrong) as engine:
        engine.calibrate()
        known = engine.known
        assert known is not None
        presses = []
        for force in np.geomspace(1.0, 10.0, 10):
            x, y = random.uniform(0.03, 0.17, 2)
            touches = pressed(engine, Press((x, y), 8e-3, force / Press((x, y), 8e-3, 1.0).force(FOAM)), frames=6)
            assert touches[-1].contacts[0].force is None  # it is not calibrated
            scans = tuple(known.difference(frame) for touch in touches for frame in touch.percept.frames)
            presses.append(KnownPress(float(force), touches[-1].contacts[0], scans))
        found = fit_layer(PressFitter(known), presses)
    return replace(wrong, calibration=found.put_into(Calibration()))


@pytest.fixture(scope="module")
def engine() -> Iterator[Engine]:
    """A loop with the calibrated skin, on the twin with other noise than when it was calibrated."""
    with Engine(lambda: DirectDevice(VirtualSkin(TRUE, 11)), calibrated()) as engine:
        engine.calibrate()
        yield engine


def pressed(engine: Engine, *presses: Press, frames: int = 12) -> list[Touch]:
    """What the loop feels of presses that come at once."""
    engine.forget()
    for number, press in enumerate(presses):
        engine.press(number, press.position, press.radius, press.pressure)
    touches = [touch for touch in (engine.step() for _ in range(frames)) if touch is not None]
    for number, press in enumerate(presses):
        engine.press(number, press.position, press.radius, 0.0)
    return touches


def some(count: int, seed: int) -> list[Press]:
    """Presses of 5 to 12 mm and 2 to 60 kPa, 1 to 30 N, anywhere but on the rim."""
    random, found = np.random.default_rng(seed), list[Press]()
    while len(found) < count:
        x, y = random.uniform(0.015, 0.185, 2)
        press = Press((x, y), random.uniform(5e-3, 12e-3), float(np.exp(random.uniform(np.log(2e3), np.log(60e3)))))
        if 1 <= press.force(FOAM) <= 30:
            found.append(press)
    return found


def test_ten_known_presses_tell_the_forces_of_others(engine: Engine) -> None:
    """Place, radius and pressure all unknown. Found: 2 to 5 % in the median, 15 to 25 % in one of ten."""
    presses = some(16, 5)
    contacts = [pressed(engine, press)[-1].contacts[0] for press in presses]
    true = np.array([press.force(FOAM) for press in presses])
    force, std = (np.array([getattr(contact, name) for contact in contacts]) for name in ("force", "force_std"))
    assert np.median(np.abs(force / true - 1)) < 0.15
    assert np.mean(np.abs(force - true) < 2 * std) > 0.8
    assert np.median(std / true) < 0.4
    np.testing.assert_allclose([c.pressure * c.area for c in contacts], force)  # type: ignore[operator]


def test_light_and_wide_is_told_from_hard_and_narrow_once_it_can_be(engine: Engine) -> None:
    """One frame cannot, and says so; a tenth of a second does."""
    press = Press((0.0652, 0.1717), 11.1e-3, 6.9e3)
    contacts = [touch.contacts[0] for touch in pressed(engine, press, frames=30) if touch.contacts]
    told = [(contact.force, contact.force_std) for contact in contacts if contact.force is not None]
    assert told[-1][0] == pytest.approx(press.force(FOAM), rel=0.2)
    assert told[-1][1] < told[0][1]
    assert all(abs(force - press.force(FOAM)) < 3 * std for force, std in told)  # type: ignore[operator]


def test_forces_of_two_presses_are_told_apart_and_follow(engine: Engine) -> None:
    hard, light = Press((0.06, 0.13), 8e-3, 40e3), Press((0.14, 0.06), 8e-3, 4e3)
    contacts = sorted(pressed(engine, hard, light)[-1].contacts, key=lambda contact: contact.position[0])
    assert [c.force for c in contacts] == pytest.approx([hard.force(FOAM), light.force(FOAM)], rel=0.3)
    engine.press(0, light.position, light.radius, light.pressure)
    risen = replace(light, pressure=4 * light.pressure)
    for _ in range(10):
        engine.step()
    engine.press(0, risen.position, risen.radius, risen.pressure)
    for _ in range(40):
        touch = engine.step()
    engine.press(0, risen.position, risen.radius, 0.0)
    assert touch is not None
    assert touch.contacts[0].force == pytest.approx(risen.force(FOAM), rel=0.3)


@pytest.mark.parametrize("place", [(0.15, 0.1), (0.14, 0.06), (0.06, 0.13)])
def test_forces_beside_a_finger_are_right_within_what_they_say(engine: Engine, place: tuple[float, float]) -> None:
    """Of 5.1 N 2.1 +- 0.35 N had been told: what fingers 50 mm apart do to each other was taken for another size."""
    first, second = Press((0.1, 0.1), 8e-3, 20e3), Press(place, 8e-3, 20e3)
    off = []
    for touch in pressed(engine, first, second, frames=80)[20:]:
        assert len(touch.contacts) == 2
        told = [(one.force, one.force_std) for one in touch.contacts]
        off += [(force - first.force(FOAM)) / std for force, std in told if force is not None and std is not None]
    assert len(off) > 80
    assert np.quantile(np.abs(off), 0.95) < 2


def test_no_force_stays_where_presses_that_were_known_cannot_be_evaluated_together(engine: Engine) -> None:
    """Too wide a press was taken as it was beside a second one; the last force was told from then on, unchanged."""
    engine.forget()
    first, second = Press((0.1, 0.1), 8e-3, 20e3), Press((0.15, 0.1), 8e-3, 20e3)

    def told(number: int, press: Press, frames: int) -> list[float | None]:
        engine.press(number, press.position, press.radius, press.pressure)
        touches = [touch for touch in (engine.step() for _ in range(frames)) if touch is not None]
        ours = [min(touch.contacts, key=lambda one: abs(one.position[0] - 0.1)) for touch in touches[frames // 2 :]]
        return [contact.force for contact in ours]

    told(0, first, 120)
    forces = [
        *told(1, second, 60),
        *told(0, replace(first, pressure=4e3), 60),
        *told(1, replace(second, pressure=0), 60),
    ]
    engine.press(0, first.position, first.radius, 0.0)
    known = [force for force in forces if force is not None]
    assert len(set(known)) > 0.9 * len(known) > 0.5 * len(forces)


@pytest.mark.parametrize("place", [(0.06, 0.06), (0.13, 0.05), (0.11, 0.14)])
@pytest.mark.parametrize("radii", [(11e-3, 5e-3), (5e-3, 11e-3)])
def test_presses_that_jump_to_another_size_are_found_again(
    engine: Engine, place: tuple[float, float], radii: tuple[float, float]
) -> None:
    """A fit that was followed alone ends where pressure is the least that may be, a fifth of the force.

    A factor of 3, as the size of what is narrow shows in few data: half the force is told at the first place under some
    noise, and a standard deviation as large."""
    told, presses = [], [Press(place, radius, 20e3) for radius in radii]
    pressed(engine, presses[0], frames=1)
    for press in (press for press in presses for _ in range(20)):
        engine.press(0, press.position, press.radius, press.pressure)
        touch = engine.step()
        assert touch is not None
        told.append([(contact.force, contact.force_std) for contact in touch.contacts])
    engine.press(0, place, radii[1], 0.0)
    true = presses[1].force(FOAM)
    last = [one[0] for one in told[-10:] if one]
    assert all(force is not None and true / 3 < force < 3 * true for force, _ in last), (last, true)
    off = [abs(force - true) > 3 * std for force, std in last if force is not None and std is not None]
    assert np.mean(off) < 0.2, (last, true)


@pytest.mark.parametrize("seed", [11, 12])
def test_no_force_is_told_that_was_found_before_the_press_changed(seed: int) -> None:
    """One press eases off by 45 % a frame while another one comes, so that both are sought afresh: the force of before
    had been told until they were found, up to 200 times the true one."""
    with Engine(lambda: DirectDevice(VirtualSkin(TRUE, seed)), calibrated()) as loop:
        loop.calibrate()
        for place, other in (((0.06, 0.06), (0.15, 0.15)), ((0.13, 0.05), (0.05, 0.15)), ((0.11, 0.14), (0.05, 0.05))):
            told = list[float | None]()
            pressed(loop, Press(place, 8e-3, 40e3), frames=25)
            loop.press(1, other, 8e-3, 20e3)
            for pressure in 40e3 * 0.55 ** np.arange(1, 9):
                loop.press(0, place, 8e-3, pressure)
                touch = loop.step()
                assert touch is not None
                near = [one for one in touch.contacts if np.hypot(*np.subtract(one.position, place)) < 0.02]
                told += [one.force for one in near]
            for number in range(2):
                loop.press(number, place, 8e-3, 0.0)
            assert not [a for a, b in pairwise(told) if a is not None and a == b], (place, told)


def test_forces_that_swell_and_ease_off_are_told_no_surer_than_they_are() -> None:
    """A ball of 12 mm in foam moves up and down and along, its size with it. A fit that is followed alone keeps to a
    size of before, sure of a light press on much area in place of a harder one on less: 8 % of frames were off by more
    than three standard deviations of the logarithm (0 to 22 % by place and seed), with others beside it 3 %."""
    worn, off = Skin.load(Path(__file__).parents[1] / "examples" / "humanoid" / "chest.toml"), list[bool]()
    for seed in (11, 12):
        twin = VirtualSkin(replace(worn, calibration=Calibration()), seed)
        with Engine(partial(DirectDevice, twin), worn) as loop:
            loop.calibrate()
            for x, y in ((0.05, 0.11), (0.24, 0.06), (0.14, 0.08), (0.2, 0.12)):
                loop.forget()
                for k, depth in enumerate(1e-3 * (2.1 + 1.4 * np.cos(np.arange(60) / 15 * np.pi))):
                    place, radius, force = (x + 1e-4 * k, y), float(np.sqrt(24e-3 * depth)), np.pi * 0.144e6 * depth**2
                    loop.press(0, place, radius, force / Press(place, radius, 1.0).force(FOAM))
                    touch = loop.step()
                    assert touch is not None
                    off += [
                        bool(abs(np.log(one.force / force)) > 3 * np.log1p(one.force_std / one.force))
                        for one in touch.contacts
                        if one.force and one.force_std
                    ]
                loop.press(0, place, radius, 0.0)
                for _ in range(5):
                    loop.step()
    assert len(off) > 400
    assert np.mean(off) < 0.05


@pytest.mark.parametrize("place", [(0.06, 0.06), (0.13, 0.05), (0.11, 0.14)])
def test_presses_that_rise_fast_do_not_jump(
    engine: Engine, monkeypatch: pytest.MonkeyPatch, place: tuple[float, float]
) -> None:
    """A finger that pokes doubles its force within six frames, hundreds of standard deviations of noise in each:
    fits of other sizes would be started afresh, of 5 ms an evaluation, in nearly every one."""
    assert engine.sensor is not None
    follower, evaluated = engine.sensor.forces, list[int]()
    assert isinstance(follower, PressFollower)
    inner, rising = follower.fitter.caused, np.geomspace(4e3, 32e3, 18)
    pressed(engine, Press(place, 8e-3, rising[0]), frames=1)
    for _ in range(20):
        engine.press(0, place, 8e-3, rising[0])
        engine.step()
    monkeypatch.setattr(follower.fitter, "caused", lambda params: evaluated.append(1) or inner(params))
    for pressure in rising:
        engine.press(0, place, 8e-3, pressure)
        engine.step()
    engine.press(0, place, 8e-3, 0.0)
    assert len(evaluated) < 2 * len(rising)


def test_a_refused_step_is_damped_at_once(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    """However bold good steps have made the next one."""
    assert engine.sensor is not None
    follower, updates = engine.sensor.forces, list[tuple[object, ...]]()
    assert isinstance(follower, PressFollower)
    inner = follower.update

    def noted(*given: object) -> object:
        updates.append(given)
        return inner(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(follower, "update", noted)
    pressed(engine, Press((0.1, 0.08), 8e-3, 20e3), frames=14)
    monkeypatch.undo()
    state, contacts, scans, elapsed = updates[-1]
    assert isinstance(state, Presses)
    assert any(fit.found is not None for fit in state.fits)
    bold = [replace(fit, damping=1e-12, caused=fit.caused / 2) for fit in state.fits]  # more pressure is called for
    refused, far = list[Floats](), [1e3 * part for part in follower.fitter.caused(state.fits[0].params)]
    monkeypatch.setattr(follower.fitter, "caused", lambda params: refused.append(params) or far)
    after, _ = follower.update(replace(state, fits=tuple(bold)), contacts, scans, elapsed)  # type: ignore[arg-type]
    assert len(bold) <= len(refused) <= len(bold) + 1  # each was tried, one of another size, and none started afresh
    assert all(fit.damping == pytest.approx(1e-2) for fit in after.fits)


def test_patches_are_prepared_in_a_share_of_idle_time(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    """One takes some 5 ms: in every frame of 9 ms that would be half of a core."""
    assert engine.sensor is not None
    follower, made = engine.sensor.forces, list[int]()
    assert isinstance(follower, PressFollower)
    monkeypatch.setattr(follower.fitter.sheet, "prepare", lambda: made.append(1))
    state = Presses()
    for _ in range(100):
        state, _ = follower.update(state, (), (), 9e-3)
    assert 3 <= len(made) <= 5


def test_a_palm_is_felt_without_a_force_that_would_hold_up_the_loop(engine: Engine) -> None:
    contact = pressed(engine, Press((0.1, 0.1), 30e-3, 20e3), frames=6)[-1].contacts[0]
    assert contact.radius is not None
    assert (contact.force, contact.force_std, contact.pressure, contact.area) == (None,) * 4


def test_a_press_beyond_the_model_is_felt_without_a_force(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ModelError("the mesh is too coarse for patches so hard pressed")

    assert engine.sensor is not None
    follower = engine.sensor.forces
    assert isinstance(follower, PressFollower)
    monkeypatch.setattr(follower.fitter, "caused", fails)
    touch = pressed(engine, Press((0.1, 0.08), 8e-3, 20e3), frames=5)[-1]
    assert [contact.force for contact in touch.contacts] == [None]


def test_the_same_force_is_told_everywhere(
    engine: Engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Client, topic, wrench, page, JSON, terminal, recording and export; the total of a load cell likewise."""
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))
    touch = pressed(engine, Press((0.09, 0.11), 8e-3, 15e3))[-1]
    touch = replace(touch, percept=replace(touch.percept, total_force=3.5))
    (contact,) = touch.contacts
    told = contact.force, contact.force_std, contact.pressure, contact.area
    assert None not in told
    with Publisher(engine.skin, (), "skin") as publisher, Client() as client:
        publisher.publish(touch)
        felt = client.newest()
    assert felt is not None
    assert felt.patches[0].total_force == 3.5
    heard = {"client": felt.contacts[0], "topic": decode_contacts(encode_contacts(felt), 0.0).contacts[0]}
    with Recorder(tmp_path / "a.mcap", engine.skin) as recorder:
        recorder.tee(engine.device)
        recorder.frame(touch.percept.frames[0])
        recorder.publish(touch)
    with RecordingReader(tmp_path / "a.mcap") as reader:
        heard["recording"] = reader.touches[-1].contacts[0]
    for name, found in heard.items():
        assert (found.force, found.force_std, found.pressure, found.area) == told, name
    wrench = CdrDecoder(encode_wrench(felt.contacts, "skin", felt.stamp))
    wrench.stamp()
    wrench.text()
    assert wrench.take("dddddd")[2] == pytest.approx(-told[0])
    capsys.readouterr()
    lines = _Lines(calibrates=True)
    lines.engine = engine
    lines(touch)
    line = json.loads(capsys.readouterr().out)
    assert line["total_force"] == 3.5
    (printed,) = line["contacts"]
    for name, shown in {"JSON": printed, "page": shown_contact(contact, 1.0)}.items():
        assert tuple(shown[field] for field in ("force", "force_std", "pressure", "area")) == told, name
    _Table()(touch)
    assert f"{told[0]:.1f} ± {told[1]:.1f}" in capsys.readouterr().out
    assert {"force_N", "force_std_N", "pressure_Pa", "area_m2"} <= set(CONTACT_COLUMNS)


def test_a_curve_tells_forces_in_its_own_mode_only_and_says_that_the_size_is_unknown(engine: Engine) -> None:
    curve = Calibration(strengths=(1e-4, 4e-4), forces=(1.0, 10.0), force_error=0.2, mode="16P")
    known = copy(engine.known)
    assert known is not None
    known.skin = replace(TRUE, calibration=curve)
    forces = forces_of(known, engine.modes["16P"])
    assert forces is not None
    _, (contact,) = forces.update(Presses(), [Contact((0.1, 0.1), 2e-4, 3e-4, 1.0, 0.5, 1)], (), 0.01)
    assert contact.force == pytest.approx(float(curve.force(3e-4)))
    assert contact.force_std == pytest.approx(np.hypot(0.2, 0.5 * contact.force))
    assert contact.pressure is None
    assert forces_of(known, engine.modes["16O"]) is None
    known.skin = TRUE
    assert forces_of(known, engine.modes["16P"]) is None
