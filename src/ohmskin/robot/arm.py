"""The body that the demonstration pokes where none is given: an arm with a flat skin on its forearm."""

from pathlib import Path

from ohmskin.body import Body, PlacedSkin
from ohmskin.body.robot import Robot
from ohmskin.client.contacts import Patch
from ohmskin.errors import ModelError
from ohmskin.skin import Skin

_REST = {"yaw": 0.0, "pitch": 0.5, "elbow": -0.55}  # rad
_MIDDLE, _TOP = 0.17, 0.038  # m: where on the forearm the middle of the skin is, and how high


def arm(skin: Skin) -> Body:
    """An arm of three joints with a skin on its forearm.

    Raises:
        ModelError: If the skin is not a flat rectangle.
    """
    sheet = skin.sheet
    if sheet.shape != "rectangle":
        raise ModelError(f"the arm wears a rectangular skin, not a {sheet.shape}; give others in a body file (--body)")
    corner = (_MIDDLE - sheet.width / 2, -sheet.height / 2, _TOP)
    robot = Robot.load(Path(__file__).with_name("arm.urdf"), _REST)
    patch = Patch("skin", "forearm", corner, newtons=skin.tells_force)
    return Body("arm", (PlacedSkin(patch, skin, "virtual:", ""),), robot)
