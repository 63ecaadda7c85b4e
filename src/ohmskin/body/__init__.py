"""A body: several skins of one robot, each in a separate process, and one stream of their contacts."""

from ohmskin.body.body import Body, PlacedSkin
from ohmskin.body.patches import Patches
from ohmskin.body.self_touch import SelfTouch

__all__ = ["Body", "Patches", "PlacedSkin", "SelfTouch"]
