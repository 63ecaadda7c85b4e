"""Skins: the description, and the physics twin."""

from ohmskin.skin.calibration import Calibration
from ohmskin.skin.description import Skin, shipped_skins
from ohmskin.skin.faults import Fault
from ohmskin.skin.layer import ContactLayer, Foam
from ohmskin.skin.mode import Mode
from ohmskin.skin.twin import Press, PressedSheet
from ohmskin.skin.virtual import VirtualSkin

__all__ = [
    "Calibration",
    "ContactLayer",
    "Fault",
    "Foam",
    "Mode",
    "Press",
    "PressedSheet",
    "Skin",
    "VirtualSkin",
    "shipped_skins",
]
