"""A touch that was there during calibration is told once it is lifted, and taken off the baseline."""

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin.engine import Engine, Touch
from ohmskin.skin import Skin
from ohmskin.skin.virtual import VirtualSkin

RADIUS, PRESSURE = 7e-3, 20e3
PLACES = [(0.102, 0.066), (0.124, 0.058), (0.029, 0.081), (0.06, 0.13)]  # m; the last beside an electrode


def stepped(engine: Engine, count: int) -> list[Touch]:
    found = [engine.step() for _ in range(count)]
    return [one for one in found if one is not None]


def sure(touches: list[Touch]) -> int:
    """In how many of these a contact is believed."""
    return sum(any(one.confidence > 0.5 for one in touch.contacts) for touch in touches)


@pytest.mark.parametrize("mode", ["16P", "16T"])
@pytest.mark.parametrize("place", PLACES)
def test_a_touch_during_calibration_is_taken_off_once_it_is_lifted(mode: str, place: tuple[float, float]) -> None:
    """Ghosts of confidence 1 had stayed beside an electrode, and were told beside every press."""
    said: list[str] = []
    skin = VirtualSkin(Skin.load("paper"), seed=1)
    skin.press(1, *place, RADIUS, PRESSURE)
    with Engine(lambda: DirectDevice(skin), Skin.load("paper"), mode, said.append) as engine:
        engine.calibrate()
        assert not sure(stepped(engine, 5))
        skin.press(1, *place, RADIUS, 0.0)
        assert sure(stepped(engine, 40)) <= 3
        x, y = (1e3 * np.array(place)).tolist()
        (told,) = [line for line in said if "lifted" in line]
        around = [f"({x + a:.0f}, {y + b:.0f}) mm" for a in (-1, 0, 1) for b in (-1, 0, 1)]
        assert any(one in told for one in around)
        assert "lifted" in engine.message
        assert not sure(stepped(engine, 60))
        for other in ((0.15, 0.15), place):
            skin.press(2, *other, RADIUS, PRESSURE)
            *_, last = stepped(engine, 15)
            (contact,) = last.contacts
            assert np.hypot(*np.subtract(contact.position, other)) < 3e-3
            assert contact.confidence > 0.9
            skin.press(2, *other, RADIUS, 0.0)
            assert not sure(stepped(engine, 15)[5:])


@pytest.mark.parametrize("mode", ["16P", "16T"])
def test_a_touch_on_an_electrode_during_calibration_leaves_nothing(mode: str) -> None:
    """It changes the impedance of the electrode's contact, too."""
    skin = VirtualSkin(Skin.load("paper"), seed=1)
    skin.press(1, 0.07, 0.066, RADIUS, PRESSURE)
    with Engine(lambda: DirectDevice(skin), Skin.load("paper"), mode) as engine:
        engine.calibrate()
        stepped(engine, 5)
        skin.press(1, 0.07, 0.066, RADIUS, 0.0)
        assert sure(stepped(engine, 40)) <= 3
        assert "lifted" in engine.message
        assert not sure(stepped(engine, 100))


def test_a_contact_beside_one_that_is_lifted_is_not_swallowed() -> None:
    skin = VirtualSkin(Skin.load("paper"), seed=1)
    skin.press(1, 0.06, 0.13, RADIUS, PRESSURE)
    with Engine(lambda: DirectDevice(skin), Skin.load("paper"), "16P") as engine:
        engine.calibrate()
        skin.press(2, 0.15, 0.05, RADIUS, PRESSURE)
        stepped(engine, 15)
        skin.press(1, 0.06, 0.13, RADIUS, 0.0)
        for touch in stepped(engine, 20)[5:]:
            assert min(np.hypot(*np.subtract(one.position, (0.15, 0.05))) for one in touch.contacts) < 5e-3
        skin.press(2, 0.15, 0.05, RADIUS, 0.0)
        assert not sure(stepped(engine, 40)[20:])
