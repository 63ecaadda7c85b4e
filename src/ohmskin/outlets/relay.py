"""The loop's end of the publishing process."""

import logging
import os
from collections.abc import Sequence
from typing import Any

from ohmskin.child import Child
from ohmskin.client.contacts import Patch
from ohmskin.closing import Closing
from ohmskin.errors import PublishError
from ohmskin.outlets.outlet import check_outlet

log = logging.getLogger(__name__)

_START_TIMEOUT = 60.0


class RelayProcess(Closing):
    """A process that publishes what is on some boards. Nothing here waits for it once it runs.

    Args:
        name, pictures, patches, token: See `ohmskin.outlets.process.Relay`.
        outlets: See `open_outlet`; with none but ``shm`` there is no process at all.
        picture_rate: Most images per second.
        root: See `ohmskin.outlets.process.Relay`.

    Attributes:
        addresses: Where its outlets are.

    Raises:
        PublishError: If an outlet cannot be opened.
    """

    def __init__(
        self,
        name: str,
        pictures: Sequence[str],
        patches: Sequence[Patch],
        outlets: Sequence[str],
        token: str | None,
        picture_rate: float,
        root: str = "",
    ) -> None:
        for address in outlets:
            check_outlet(address)
        self.addresses: list[str] = []
        self._child: Child | None = None
        outlets = [address for address in dict.fromkeys(outlets) if address != "shm"]
        if not outlets:
            return
        boards = {"name": name, "pictures": list(pictures), "picture_every": 1 / picture_rate}
        links = list(dict.fromkeys(patch.frame for patch in patches if patch.newtons))
        settings: dict[str, Any] = {**boards, "links": links, "outlets": outlets, "token": token, "root": root}
        child = Child.module("ohmskin.outlets.process", "the publishing process", settings, OMP_NUM_THREADS="1")
        self.addresses = child.ready(_START_TIMEOUT, PublishError)["ready"]
        os.set_blocking(child.stdin.fileno(), False)
        self._child = child

    @property
    def pid(self) -> int:
        """Number of the process; 0 if there is none."""
        return self._child.process.pid if self._child is not None else 0

    def wake(self) -> None:
        """Tell it that there is something new; never waits."""
        if self._child is None:
            return
        try:
            os.write(self._child.stdin.fileno(), b".")
        except BlockingIOError:  # it has much to read still, and will find the newest
            pass
        except OSError:
            process = self._child.process
            self.close()  # its pipe can break before its exit status is known
            log.error(
                "the publishing process has ended (exit status %s); the loop continues without it", process.returncode
            )

    def close(self) -> None:
        """End the process. Safe to call twice."""
        if self._child is not None:
            self._child.close()
            self._child = None
