"""What LeRobot's command line takes."""

from dataclasses import dataclass, field
from typing import Any

from lerobot.cameras.configs import CameraConfig
from lerobot.robots.config import RobotConfig


@CameraConfig.register_subclass("ohmskin")
@dataclass(kw_only=True)
class OhmskinCameraConfig(CameraConfig):
    """The image of a skin as a camera.

    Args:
        skin: What `ohmskin live --name` gave.
        full: Relative conductivity change that is shown as 255.
        fps: Images a second, 30 from `ohmskin live`.
        width, height: Pixels; a square skin has 64 by 64.
    """

    skin: str = "skin"
    full: float = 0.3
    fps: int | None = 30
    width: int | None = 64
    height: int | None = 64

    def __post_init__(self) -> None:
        if not self.full > 0:
            raise ValueError(f"full is {self.full}; it must be a positive relative conductivity change")


@RobotConfig.register_subclass("ohmskin")
@dataclass(kw_only=True)
class OhmskinRobotConfig(RobotConfig):
    """A robot that wears a skin, or a skin alone.

    Args:
        robot: The robot that wears it, as LeRobot describes one: ``{type: so101_follower, port: /dev/ttyACM0}``; what
            it observes and does stays. Not a `RobotConfig`, of which LeRobot would offer one in the other for ever.
        skin: What `ohmskin live --name` gave, or the name of a body.
        contacts: How many contacts the state has room for.
        max_age: Seconds without news of the skin after which recording ends: silence is not taken for no contact.
        cameras: Such as one of type ``ohmskin``, the skin's image.
    """

    robot: dict[str, Any] = field(default_factory=dict)
    skin: str = "skin"
    contacts: int = 4
    max_age: float = 0.5
    cameras: dict[str, CameraConfig] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.contacts <= 64:
            raise ValueError(f"contacts is {self.contacts}; it must be 1 to 64")
        if not self.max_age > 0:
            raise ValueError(f"max_age is {self.max_age} s; it must be positive")
