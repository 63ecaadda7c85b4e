"""Robots with a sense of touch, in MuJoCo: they wear skins and yield when they are poked."""

from ohmskin.robot.arm import arm
from ohmskin.robot.demonstration import Demonstration, Moment, Sensed, engines
from ohmskin.robot.figures import Encounter, Hug, OwnTouch, summary
from ohmskin.robot.wearer import Push, Wearer

__all__ = [
    "Demonstration",
    "Encounter",
    "Hug",
    "Moment",
    "OwnTouch",
    "Push",
    "Sensed",
    "Wearer",
    "arm",
    "engines",
    "summary",
]
