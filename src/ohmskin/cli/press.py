"""``ohmskin press``: touch a virtual skin from the terminal."""

import time

from ohmskin.device import connect
from ohmskin.device.registry import scheme_of
from ohmskin.errors import OhmskinError

_STEPS_PER_SECOND = 50


def press(
    x: float,
    y: float,
    *,
    radius: float = 8.0,
    pressure: float = 20.0,
    seconds: float = 2.0,
    to: tuple[float, float] | None = None,
    device: str = "tcp://127.0.0.1:7155",
) -> None:
    """Press a virtual skin at (x, y) for a while, or slide to another place meanwhile.

    Args:
        x: Place from the left edge (mm).
        y: Place from the lower edge (mm).
        radius: Radius of the finger (mm).
        pressure: Pressure (kPa).
        seconds: Duration (s).
        to: Place to slide to (mm).
        device: Address of the virtual skin.
    """
    if not 0 < seconds <= 3600:
        raise OhmskinError(f"--seconds is {seconds:g}; it must be above 0 and at most 3600")
    if scheme_of(device) == "virtual":
        raise OhmskinError(f"{device} belongs to this command alone; run `ohmskin serve-skin` and press that one")
    with connect(device) as skin:
        steps = max(1, round(seconds * _STEPS_PER_SECOND)) if to else 1
        end = to or (x, y)
        for step in range(steps):
            share = step / max(1, steps - 1)
            at = ((x + share * (end[0] - x)) * 1e-3, (y + share * (end[1] - y)) * 1e-3)
            skin.press(0, at, radius * 1e-3, pressure * 1e3)
            time.sleep(seconds / steps)
        skin.press(0, at, radius * 1e-3, 0.0)
