"""Foam with a memory: the layer's hysteresis and creep, in the twin, in calibration, and followed by the loop."""

from dataclasses import replace

import numpy as np
import pytest
from direct import DirectDevice
from hypothesis import given
from hypothesis import strategies as st

from ohmskin.arrays import Floats
from ohmskin.drive import complete_pattern
from ohmskin.engine import Engine
from ohmskin.sensing import KnownPress, PressFitter, fit_layer
from ohmskin.skin import Calibration, ContactLayer, Foam, Press, Skin, VirtualSkin

LAYER = ContactLayer(hysteresis=0.3, creep=0.15, creep_time=3.0)
PAPER = Skin.load("paper")
PATTERN = complete_pattern(16)
SKIN = replace(PAPER, contact_layer=replace(LAYER, columns=0, rows=0))


def acting(layer: ContactLayer, pressures: list[float], elapsed: float) -> list[Foam]:
    """The foam under pressures that follow each other."""
    found: list[Foam] = []
    for pressure in pressures:
        found.append(layer.acting(found[-1] if found else None, pressure, elapsed))
    return found


def test_rising_pressure_acts_as_it_is_and_easing_off_leaves_more() -> None:
    layer = replace(LAYER, creep=0.0)
    rising = [1e3, 5e3, 20e3]
    up = acting(layer, rising, 0.01)
    assert [foam.acting for foam in up] == pytest.approx(rising)
    down = acting(layer, [*rising, 5e3, 1e3, 500.0], 0.01)[3:]
    assert [foam.acting / foam.pressure for foam in down] == sorted(foam.acting / foam.pressure for foam in down)
    assert down[-1].acting / down[-1].pressure == pytest.approx(1.3, rel=0.01)
    assert down[0].acting / down[0].pressure == pytest.approx(1.3 ** layer.turned(0.25))


def test_a_lasting_press_creeps_to_its_share() -> None:
    layer = replace(LAYER, hysteresis=0.0)
    held = acting(layer, [1e4] * 301, 0.1)
    assert held[30].acting == pytest.approx(1e4 * (1 + 0.15 * (1 - np.exp(-1))), rel=1e-6)  # creep_time later
    assert held[-1].acting == pytest.approx(1.15e4, rel=1e-3)


@given(
    st.lists(st.floats(1e2, 1e5), min_size=2, max_size=30),
    st.floats(0, 0.5),
    st.floats(0, 1),
    st.floats(1e-3, 10),
)
def test_what_presses_is_found_from_what_acts(
    pressures: list[float], hysteresis: float, creep: float, elapsed: float
) -> None:
    layer = ContactLayer(hysteresis=hysteresis, creep=creep, creep_time=1.0)
    back: Foam | None = None
    for pressed in acting(layer, pressures, elapsed):
        back = layer.pressing(back, pressed.acting, elapsed)
        assert back.pressure == pytest.approx(pressed.pressure, rel=1e-6)


def test_the_twin_remembers_each_press_until_it_is_lifted() -> None:
    def scanned(skin: Skin, *pressures: float) -> Floats:
        """What a scan shows after pressures at one place; all scans have the same noise."""
        twin = VirtualSkin(skin, 1)
        for pressure in pressures:
            twin.press(0, 0.1, 0.1, 8e-3, pressure)
        return np.asarray(twin.scan(PATTERN).voltages)

    np.testing.assert_array_equal(scanned(SKIN, 5e3, 20e3), scanned(PAPER, 20e3))
    eased, harder = scanned(SKIN, 20e3, 5e3), scanned(PAPER, 5e3 * 1.3 ** LAYER.turned(0.25))
    step = 2 * PAPER.converter.full_scale / 2**PAPER.converter.bits
    assert np.abs(eased - scanned(PAPER, 5e3)).max() > 5 * step
    np.testing.assert_allclose(eased, harder, atol=1.5 * step)
    np.testing.assert_array_equal(scanned(SKIN, 20e3, 0.0, 5e3), scanned(PAPER, 5e3))  # foam that is free forgets


def test_the_twin_creeps_as_its_clock_goes() -> None:
    twin, plain = VirtualSkin(SKIN, 1), VirtualSkin(PAPER, 1)
    for one in (twin, plain):
        one.press(0, 0.1, 0.1, 8e-3, 2e4)
    apart = []
    while twin.time < 3 * LAYER.creep_time:
        more, same = twin.scan(PATTERN).voltages, plain.scan(PATTERN).voltages
        apart.append(float(np.abs(more - same).max()))
    at = round(len(apart) / 3)  # one creep_time
    assert apart[0] < 0.05 * apart[-1]
    assert apart[at] / apart[-1] == pytest.approx((1 - np.exp(-1)) / (1 - np.exp(-3)), abs=0.1)


@pytest.fixture(scope="module")
def calibrated() -> Skin:
    """What presses that rise and ease off tell of a layer described with half as much conductance again, whose
    hysteresis nobody knows; its creep is described."""
    layer = replace(SKIN.contact_layer, conductance=1.5 * SKIN.contact_layer.conductance, hysteresis=0.0)
    wrong, random = replace(SKIN, contact_layer=layer), np.random.default_rng(5)
    with Engine(lambda: DirectDevice(VirtualSkin(SKIN, 1)), wrong) as engine:
        engine.calibrate()
        known, presses = engine.known, []
        assert known is not None
        for top in (2.0, 4.0, 6.0, 8.0, 10.0):
            place = random.uniform(0.03, 0.17, 2)
            for force, peak in ((top, 0.0), (0.3 * top, top)):
                engine.press(0, (place[0], place[1]), 8e-3, pascals(force, 8e-3))
                touches = [touch for touch in (engine.step() for _ in range(8)) if touch is not None and touch.contacts]
                scans = tuple(known.difference(frame) for touch in touches[-5:] for frame in touch.percept.frames)
                presses.append(KnownPress(force, touches[-1].contacts[0], scans, peak))
            engine.press(0, (place[0], place[1]), 8e-3, 0.0)
            for _ in range(4):
                engine.step()
        found = fit_layer(PressFitter(known), presses)
    assert found.hysteresis == pytest.approx(0.3, abs=0.08)
    return replace(wrong, calibration=found.put_into(Calibration()))


def pascals(force: float, radius: float) -> float:
    """The pressure (Pa) of a force (N) at a place where all of it is on the sheet."""
    return force / Press((0.1, 0.1), radius, 1.0).force(LAYER.foam_spread)


def test_forces_are_followed_up_and_down(calibrated: Skin) -> None:
    """Of fingers that press harder for a twelfth of a second, hold, and ease off, at eighteen places: every frame
    counts. Over three seeds and sets of places 10 to 17 % in the median. While they ease off, forces would be 16 to
    21 % too large, were the foam taken for springs, in place of 1 to 2 %."""
    forgetful = replace(calibrated, calibration=replace(calibrated.calibration, layer_hysteresis=0.0))
    forgetful = replace(forgetful, contact_layer=replace(forgetful.contact_layer, creep=0.0))
    places = np.random.default_rng(8).uniform(0.03, 0.17, (18, 2))
    way = np.repeat(["rise", "hold", "ease off"], [30, 20, 30])
    error, bias = [], []
    for skin in (calibrated, forgetful):
        errors: dict[str, list[float]] = {one: [] for one in way}
        with Engine(lambda: DirectDevice(VirtualSkin(SKIN, 21)), skin) as engine:
            engine.calibrate()
            for (x, y), radius, top in zip(places, 6 * (7e-3, 9e-3, 11e-3), 6 * (6.0, 15.0, 30.0), strict=True):
                forces = np.concatenate([np.linspace(1, top, 30), np.full(20, top), np.linspace(top, 1, 30)])
                for now, force in zip(way, forces, strict=True):
                    engine.press(0, (x, y), radius, pascals(float(force), radius))
                    touch = engine.step()
                    if touch is not None and touch.contacts and touch.contacts[0].force is not None:
                        errors[now].append(touch.contacts[0].force / float(force) - 1)
                engine.press(0, (x, y), radius, 0.0)
                for _ in range(6):
                    engine.step()
        error.append({now: float(np.median(np.abs(some))) for now, some in errors.items()})
        bias.append(float(np.median(errors["ease off"])))
    assert max(error[0].values()) < 0.25, error
    assert error[0]["ease off"] < error[1]["ease off"], error
    assert abs(bias[0]) < bias[1] / 2, bias
