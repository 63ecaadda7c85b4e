"""What a skin feels, as arrays for learning. Nothing of LeRobot here."""

import struct
import time
from typing import Any

import numpy as np

from ohmskin.client import BoardReader, Client
from ohmskin.client.points import point_names, points

FIRST = 5.0
"""Seconds to wait for a skin to be heard."""

_HEAD = struct.Struct("<Qq")  # of an image: its number, and its last sample (ns since 1970)
_NAP = 0.001  # s


class Contacts:
    """Contacts as named numbers of a state; see `ohmskin.client.points`.

    Args:
        skin: Its name.
        most: How many there is room for.
        max_age: Seconds, beyond which the last contacts are not used.
    """

    def __init__(self, skin: str, most: int, max_age: float) -> None:
        self._skin, self._client, self.names = skin, Client(f"shm:{skin}"), point_names(most)
        self._most, self._max_age = most, max_age

    def read(self) -> dict[str, float]:
        """The newest.

        Raises:
            TimeoutError: If the skin is silent.
        """
        newest = self._client.newest()
        if newest is None or newest.age > self._max_age:
            since = "has not been heard of" if newest is None else f"has been silent for {newest.age:.2g} s"
            raise TimeoutError(
                f"skin {self._skin!r} {since}; is `ohmskin live --publish shm --name {self._skin}` running?"
            )
        return dict(zip(self.names, points(newest.contacts, self._most), strict=True))

    def wait(self, timeout: float) -> None:
        """Return once the skin is heard.

        Raises:
            TimeoutError: If it is silent for so many seconds.
        """
        end = time.monotonic() + timeout
        while True:
            try:
                self.read()
                return
            except TimeoutError:
                if time.monotonic() > end:
                    raise
            time.sleep(_NAP)

    def close(self) -> None:
        self._client.close()


class Pictures:
    """Images of a skin as RGB: red where it conducts better, which is where it is pressed, blue where worse.

    Args:
        skin: Its name.
        size: Width and height that images must have.
        full: Relative conductivity change of 255.
    """

    def __init__(self, skin: str, size: tuple[int, int], full: float) -> None:
        self._skin, self._board, self._size, self._full = skin, BoardReader(f"{skin}.image"), size, full
        self._last: np.ndarray | None = None
        self._stamp = 0

    def newest(self) -> np.ndarray | None:
        """An image (height, width, 3) that was not given before, top row first; None if there is none."""
        if (message := self._board.newest()) is None:
            return None
        raster = self._board.setup["raster"]
        size = int(raster["nx"]), int(raster["ny"])
        if size != self._size:
            raise ValueError(
                f"images of skin {self._skin!r} have {size[0]} x {size[1]} pixels; set width and height so"
            )
        self._stamp = _HEAD.unpack_from(message)[1]
        values = np.frombuffer(message, "<f4", offset=_HEAD.size).reshape(size[1], size[0])[::-1]
        level = np.clip(np.nan_to_num(values) / self._full, -1.0, 1.0) * 255
        self._last = np.stack([np.maximum(level, 0), np.zeros_like(level), np.maximum(-level, 0)], axis=-1).astype(
            np.uint8
        )
        return self._last

    def wait(self, timeout: float) -> np.ndarray:
        """The next image.

        Raises:
            TimeoutError: If none comes within so many seconds.
        """
        end = time.monotonic() + timeout
        while (image := self.newest()) is None:
            if time.monotonic() > end:
                why = f"is `ohmskin live --publish shm --name {self._skin}` running?"
                raise TimeoutError(f"no image of skin {self._skin!r} within {timeout:.2g} s; {why}")
            time.sleep(_NAP)
        return image

    def latest(self, max_age: float) -> Any:
        """The newest image, new or given before.

        Raises:
            TimeoutError: If it is older than so many seconds, or there is none.
        """
        self.newest()
        age = (time.time_ns() - self._stamp) * 1e-9
        if self._last is None or age > max_age:
            raise TimeoutError(
                f"the newest image of skin {self._skin!r} is older than {max_age:.2g} s, or there is none"
            )
        return self._last

    def close(self) -> None:
        self._board.close()
