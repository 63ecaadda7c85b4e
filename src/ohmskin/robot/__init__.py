"""A robot with a sense of touch, in MuJoCo: an arm with a skin on its forearm that yields when it is poked."""

from ohmskin.robot.arm import Arm, Poke
from ohmskin.robot.demonstration import Demonstration, Encounter, Moment, summary

__all__ = ["Arm", "Demonstration", "Encounter", "Moment", "Poke", "summary"]
