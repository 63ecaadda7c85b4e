"""What senses while a mode is being compiled, without compiling anything."""

from direct import DirectDevice

from ohmskin import Engine, Skin, VirtualSkin
from ohmskin.engine.compiling import Compilation


class Pending(Compilation):
    """One that goes on until it is told to be over."""

    over = closed = False

    def __init__(self) -> None:
        pass

    @property
    def under_way(self) -> bool:
        return not self.over

    def close(self) -> None:
        self.closed = True


def felt(engine: Engine) -> int:
    """How many contacts the last of some frames has."""
    touches = [engine.step() for _ in range(6)]
    assert touches[-1] is not None
    return len(touches[-1].contacts)


def test_another_mode_stands_in_until_the_one_wanted_is_compiled() -> None:
    skin, pending = Skin.load("paper"), Pending()
    virtual = VirtualSkin(skin, seed=1)
    with Engine(lambda: DirectDevice(virtual), skin, "16P", compilation=pending) as engine:
        engine.calibrate()
        assert engine.mode.name == "16O"
        virtual.press(1, 0.06, 0.14, 0.01, 8e3)
        assert felt(engine) == 1
        assert not pending.closed
        pending.over = True
        assert felt(engine) == 1
        assert engine.mode.name == "16P"
        assert pending.closed


def test_a_mode_that_waits_for_nothing_is_not_stood_in_for() -> None:
    skin, pending = Skin.load("paper"), Pending()
    with Engine(lambda: DirectDevice(VirtualSkin(skin)), skin, "12B", compilation=pending) as engine:
        engine.calibrate()
        assert engine.mode.name == "12B"
        pending.over = True
        engine.step()
        assert engine.mode.name == "12B"
        assert pending.closed  # what is compiled is used from now on
