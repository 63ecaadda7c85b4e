"""What a skin is: its description and its physics twin."""

from ohmskin.skin.description import Skin, shipped_skins
from ohmskin.skin.twin import Press, PressedSheet
from ohmskin.skin.virtual import VirtualSkin

__all__ = ["Press", "PressedSheet", "Skin", "VirtualSkin", "shipped_skins"]
