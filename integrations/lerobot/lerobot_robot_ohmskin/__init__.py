"""A tactile skin in LeRobot: types ``ohmskin`` of robots and cameras, registered when LeRobot finds this package."""

from lerobot_robot_ohmskin.camera import OhmskinCamera
from lerobot_robot_ohmskin.config import OhmskinCameraConfig, OhmskinRobotConfig
from lerobot_robot_ohmskin.robot import OhmskinRobot

__all__ = ["OhmskinCamera", "OhmskinCameraConfig", "OhmskinRobot", "OhmskinRobotConfig"]
