"""The loop's end of `ohmskin.client.Commands`."""

import json
import time
from collections.abc import Callable, Mapping

from ohmskin.client.board import Board, BoardReader
from ohmskin.client.commands import LARGEST_COMMAND
from ohmskin.closing import Closing
from ohmskin.errors import DeviceLost, OhmskinError

_LONGEST = 1000  # characters of an answer


class CommandServer(Closing):
    """Does what is asked of a skin, between two cycles of its loop.

    Args:
        name: Name of the skin.
        commands: What can be asked: functions of strings, which raise OhmskinError where they fail.

    Raises:
        PublishError: If another skin of that name is there.
    """

    def __init__(self, name: str, commands: Mapping[str, Callable[..., None]]) -> None:
        self._asked, self._commands = BoardReader(f"{name}.asked"), commands
        self._answers = Board(f"{name}.answered", {}, 2 * LARGEST_COMMAND)

    def poll(self, lost: str = "") -> None:
        """Do what was asked since the last look; without that it takes a microsecond, and now and then some ten.

        Args:
            lost: Why nothing can be done now, such as that the device is lost: this is answered.
        """
        if (record := self._asked.newest()) is None:
            return
        failed = ""
        try:
            asked = json.loads(record)
            if time.monotonic() > asked["until"]:
                return  # whoever asked has gone
            if lost:
                raise DeviceLost(lost)
            name, *arguments = asked["command"]
            self._commands[name](*map(str, arguments))
        except OhmskinError as error:
            failed = str(error)
        except (ValueError, TypeError, KeyError) as error:
            failed = f"unknown command of a skin ({error}); choose from {', '.join(self._commands)}"
        self._answers.write(json.dumps({"boot": self._asked.boot, "failed": failed[:_LONGEST]}).encode())

    def close(self) -> None:
        """Remove the board. Safe to call twice."""
        self._asked.close()
        self._answers.close()
