"""The image of a skin as a camera."""

from typing import Any

import numpy as np
from lerobot.cameras.camera import Camera

from lerobot_robot_ohmskin.config import OhmskinCameraConfig
from lerobot_robot_ohmskin.observe import FIRST, Pictures

_SILENT = 0.5  # s, without an image, beyond which none is given


class OhmskinCamera(Camera):
    """See `Pictures`."""

    def __init__(self, config: OhmskinCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self._pictures: Pictures | None = None

    @property
    def is_connected(self) -> bool:
        return self._pictures is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        return []

    def connect(self, warmup: bool = True) -> None:
        """Find the skin.

        Raises:
            TimeoutError: If it does not send images.
        """
        pictures = Pictures(self.config.skin, (self.config.width or 64, self.config.height or 64), self.config.full)
        try:
            pictures.wait(FIRST)
        except BaseException:
            pictures.close()
            raise
        self._pictures = pictures

    def read(self) -> np.ndarray:
        return self._connected().latest(_SILENT)

    def async_read(self, timeout_ms: float = 200) -> np.ndarray:
        return self._connected().wait(timeout_ms / 1000)

    def read_latest(self, max_age_ms: int = 500) -> np.ndarray:
        return self._connected().latest(max_age_ms / 1000)

    def disconnect(self) -> None:
        if self._pictures is not None:
            self._pictures.close()
        self._pictures = None

    def _connected(self) -> Pictures:
        if self._pictures is None:
            raise ConnectionError(f"camera of skin {self.config.skin!r} is not connected; call connect() first")
        return self._pictures
