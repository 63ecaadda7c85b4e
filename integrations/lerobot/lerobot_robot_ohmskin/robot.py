"""A robot that wears a skin."""

from functools import cached_property
from typing import Any

import draccus
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots.config import RobotConfig
from lerobot.robots.robot import Robot
from lerobot.robots.utils import make_robot_from_config

from lerobot_robot_ohmskin.config import OhmskinRobotConfig
from lerobot_robot_ohmskin.observe import FIRST, Contacts


class OhmskinRobot(Robot):
    """Any robot of LeRobot's, or none, with contacts in its state and the cameras of the configuration."""

    config_class = OhmskinRobotConfig
    name = "ohmskin"

    def __init__(self, config: OhmskinRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self.robot = make_robot_from_config(draccus.decode(RobotConfig, config.robot)) if config.robot else None
        self.cameras = make_cameras_from_configs(config.cameras)
        self._contacts: Contacts | None = None

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        own = {} if self.robot is None else self.robot.observation_features
        names = Contacts(self.config.skin, self.config.contacts, self.config.max_age).names
        seen = {name: (camera.height, camera.width, 3) for name, camera in self.cameras.items()}
        return own | dict.fromkeys(names, float) | seen

    @property
    def action_features(self) -> dict[str, Any]:
        return {} if self.robot is None else self.robot.action_features

    @property
    def is_connected(self) -> bool:
        return self._contacts is not None and (self.robot is None or self.robot.is_connected)

    def connect(self, calibrate: bool = True) -> None:
        """Connect robot, cameras and skin; if one cannot be, disconnect the others.

        Args:
            calibrate: Whether to calibrate a robot that is not.

        Raises:
            ConnectionError: If they are connected.
            TimeoutError: If the skin is silent.
        """
        if self.is_connected:
            raise ConnectionError("the robot is connected; call disconnect() first")
        try:
            if self.robot is not None:
                self.robot.connect(calibrate)
            for camera in self.cameras.values():
                camera.connect()
            self._contacts = Contacts(self.config.skin, self.config.contacts, self.config.max_age)
            self._contacts.wait(FIRST)
        except BaseException:
            self.disconnect()
            raise

    @property
    def is_calibrated(self) -> bool:
        return self.robot is None or self.robot.is_calibrated

    def calibrate(self) -> None:
        if self.robot is not None:
            self.robot.calibrate()

    def configure(self) -> None:
        if self.robot is not None:
            self.robot.configure()

    def get_observation(self) -> dict[str, Any]:
        """What robot, skin and cameras observe now.

        Raises:
            TimeoutError: If the skin is silent.
        """
        if self._contacts is None:
            raise ConnectionError("the skin is not connected; call connect() first")
        own = {} if self.robot is None else self.robot.get_observation()
        return own | self._contacts.read() | {name: camera.read_latest() for name, camera in self.cameras.items()}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        return {} if self.robot is None else self.robot.send_action(action)

    def disconnect(self) -> None:
        for camera in self.cameras.values():
            if camera.is_connected:
                camera.disconnect()
        if self._contacts is not None:
            self._contacts.close()
            self._contacts = None
        if self.robot is not None and self.robot.is_connected:
            self.robot.disconnect()
