"""Joint states, from the program that knows them to the one that senses, and where links are by them."""

import json
import struct
import time
from collections.abc import Mapping
from math import isfinite

from ohmskin.client.board import Board, BoardReader
from ohmskin.closing import Closing
from ohmskin.errors import PublishError

_LARGEST = 2**16  # bytes, some thousand joints
_POSE = struct.Struct("<16d")


class JointStates(Closing):
    """Sends joint positions to a body, for the detection of self-touch and for its page.

        with JointStates("torso") as joints:
            joints.push({"elbow": -1.1})            # again whenever they have moved

    Args:
        name: Name of the body.

    Raises:
        PublishError: If another program sends that body's joints now.
    """

    def __init__(self, name: str) -> None:
        self._board = Board(f"{name}.joints", {}, _LARGEST)

    def push(self, positions: Mapping[str, float], age: float = 0.0) -> None:
        """Send the positions of joints; joints that are not named have the positions of the body file.

        A joint that mimics another in the URDF file follows that one, whether it is named or not.

        Args:
            positions: By the name of the joint (rad, m).
            age: How long ago they were measured (s).

        Raises:
            PublishError: If one is not a finite number, or there are too many.
        """
        told = {name: float(position) for name, position in positions.items()}
        if wrong := next((name for name, position in told.items() if not isfinite(position)), None):
            raise PublishError(f"joint {wrong!r} is at {told[wrong]}; it must be a finite number (rad or m)")
        self._board.write(json.dumps({"time": time.monotonic() - age, "positions": told}).encode())

    def close(self) -> None:
        """End sending, and remove the shared memory. Safe to call twice."""
        self._board.close()


class LinkPoses(Closing):
    """Where the links of a body are, by the joint states that it got last.

    Args:
        name: Name of the body.
    """

    def __init__(self, name: str) -> None:
        self._reader = BoardReader(f"{name}.links")
        self._poses: dict[str, tuple[float, ...]] = {}

    def newest(self) -> dict[str, tuple[float, ...]]:
        """The pose of each link in the frame of the root, row by row (m); empty before joint states came.

        Raises:
            PublishError: If the board is of another version.
        """
        if (record := self._reader.newest()) is not None:
            self._poses = dict(zip(self._reader.setup["links"], _POSE.iter_unpack(record), strict=True))
        return self._poses

    def close(self) -> None:
        """Close the board. Safe to call twice."""
        self._reader.close()
