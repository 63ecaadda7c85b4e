"""Robots with a sense of touch, in MuJoCo: they wear skins and yield when poked."""

from ohmskin.robot.arm import arm
from ohmskin.robot.demonstration import Demonstration, Moment, Sensed, engines
from ohmskin.robot.figures import Encounter, Hug, SelfTouchTrial, summary
from ohmskin.robot.simulation import Push, RobotSimulation

__all__ = [
    "Demonstration",
    "Encounter",
    "Hug",
    "Moment",
    "Push",
    "RobotSimulation",
    "SelfTouchTrial",
    "Sensed",
    "arm",
    "engines",
    "summary",
]
