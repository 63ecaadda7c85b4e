"""How a robot stands: the joint states that its program pushes, and where its links are by them."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ohmskin.body.body import Body
from ohmskin.body.self_touch import SelfTouch
from ohmskin.client.board import Board, BoardReader
from ohmskin.client.contacts import PlacedContact
from ohmskin.closing import Closing
from ohmskin.errors import SkinError

_STALE = 0.2  # s without joint states, after which the robot may stand otherwise


class Posture(Closing):
    """Follows the joint states of a body (`ohmskin.client.JointStates`) and publishes where its links are, on a board.

    Args:
        body: The body, which names a URDF file.
        report: Called with every message for the user.

    Raises:
        PublishError: If the name is taken.
        SkinError: If the body names no URDF file.
    """

    def __init__(self, body: Body, report: Callable[[str], None] = lambda _: None) -> None:
        self._self_touch = SelfTouch(body)
        assert body.robot is not None
        self.robot, self._still, self._report = body.robot, dict(body.robot.positions), report
        self._reader, self._time, self._reported = BoardReader(f"{body.name}.joints"), -np.inf, False
        links = list(body.robot.links)
        self._board = Board(f"{body.name}.links", {"links": links}, 128 * len(links))

    def step(self) -> None:
        """Take over joint states that are new.

        While they cannot be, which is reported once until it ends, the posture counts as unknown.
        """
        if (record := self._reader.newest()) is None:
            return
        try:
            told = json.loads(record)
            self.robot = self.robot.posed(self._still | told["positions"])
            self._time = float(told["time"])
            self._board.write(np.stack(list(self.robot.links.values())).astype("<f8").tobytes())
            self._reported = False
        except (SkinError, ValueError, KeyError, TypeError) as error:
            self._time = -np.inf
            if not self._reported:
                self._reported = True
                self._report(f"joint states are ignored: {error}")

    def with_self_touch(self, contacts: Sequence[PlacedContact]) -> tuple[PlacedContact, ...]:
        """Contacts with their `self_touch`; None while the joint states are not known."""
        if time.monotonic() - self._time > _STALE:
            return tuple(replace(contact, self_touch=None) for contact in contacts)
        return self._self_touch.with_self_touch(self.robot, contacts)

    def close(self) -> None:
        """Let go of the boards. Safe to call twice."""
        self._reader.close()
        self._board.close()
