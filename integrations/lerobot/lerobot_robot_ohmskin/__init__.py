"""A tactile skin in LeRobot: types ``ohmskin`` of robots and cameras, registered when LeRobot finds this package."""

try:
    from lerobot_robot_ohmskin.camera import OhmskinCamera
    from lerobot_robot_ohmskin.config import OhmskinCameraConfig, OhmskinRobotConfig
    from lerobot_robot_ohmskin.robot import OhmskinRobot
except ModuleNotFoundError as error:
    missing = (error.name or "").partition(".")[0]
    installs = {"lerobot": "'lerobot>=0.4.4'", "ohmskin": "packaging/client, of ohmskin's repository, or ohmskin"}
    what = f"lerobot_robot_ohmskin needs the package {missing!r}: pip install {installs.get(missing, missing)}"
    raise ModuleNotFoundError(what, name=error.name) from error

__all__ = ["OhmskinCamera", "OhmskinCameraConfig", "OhmskinRobot", "OhmskinRobotConfig"]
