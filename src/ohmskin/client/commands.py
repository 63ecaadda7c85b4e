"""Commands to the loop of a skin, from another process of the same user."""

import json
import time

from ohmskin.client.board import Board, BoardReader, check_name
from ohmskin.closing import Closing
from ohmskin.errors import PublishError

LARGEST_COMMAND = 4096  # bytes
_NAP = 0.005  # s


class Commands(Closing):
    """Commands to the loop of a skin: to tare it, or to change its mode. Each waits until the command is executed.

        with Commands("skin") as commands:
            commands.tare()

    Args:
        name: The name given to `ohmskin live --name`; BODY.PATCH for a patch of a body.
        timeout: Time to wait for an answer (s).

    Raises:
        PublishError: If the name is not valid.
    """

    def __init__(self, name: str = "skin", timeout: float = 30.0) -> None:
        check_name(name)
        check_name(f"{name}.asked")  # nor may it be too long for that
        self._name, self._timeout = name, timeout
        self._answers = BoardReader(f"{name}.answered")

    def tare(self) -> None:
        """Learn the untouched skin again: reference, noise and thresholds. Nothing may touch it meanwhile.

        Raises:
            PublishError: If the skin refuses, such as when it is not quiet, or does not answer; the former calibration
                stays.
        """
        self._ask("tare")

    def set_mode(self, mode: str) -> None:
        """Change to another `mode`, by its name, such as 16T.

        Raises:
            PublishError: If it is not possible, or the skin does not answer.
        """
        self._ask("set_mode", mode)

    def close(self) -> None:
        """Close the connection. Safe to call twice."""
        self._answers.close()

    def _ask(self, *command: str) -> None:
        until = time.monotonic() + self._timeout
        with Board(f"{self._name}.asked", {}, LARGEST_COMMAND) as board:  # others may ask before and afterwards
            board.write(json.dumps({"until": until, "command": command}).encode())
            while time.monotonic() < until:
                told = json.loads(self._answers.newest() or b"{}")
                if told.get("boot") == board.boot:
                    if told["failed"]:
                        raise PublishError(str(told["failed"]))
                    return
                time.sleep(_NAP)
        raise PublishError(f"skin {self._name!r} did not answer in {self._timeout:g} s; is it running and publishing?")
