"""The client: the newest contacts for a control loop in another process."""

import re
from typing import Protocol

from ohmskin.client.contacts import Contacts, SharedMemory
from ohmskin.closing import Closing
from ohmskin.errors import PublishError

_ADDRESS = re.compile(r"(shm|zenoh):([A-Za-z0-9_.]*)(?:@(.+))?")


class _Source(Protocol):
    def newest(self) -> Contacts | None: ...

    def wait(self, timeout: float) -> Contacts | None: ...

    def close(self) -> None: ...


class Client(Closing):
    """Reads contacts from another process. Neither side waits for the other; either may start and end at any time.

    Args:
        address: ``shm:NAME`` on the same machine, or ``zenoh:NAME@tcp/HOST:PORT`` (extra `zenoh`); the name is that of
            `ohmskin live --name`, ``skin`` unless given.
        token: The sender's password over zenoh, if it has one.

    Raises:
        PublishError: If the address cannot be used or the extra is missing. A missing sender is not an error.
    """

    def __init__(self, address: str = "shm:skin", token: str | None = None) -> None:
        found = _ADDRESS.fullmatch(address)
        if not found or (found[1] == "shm" and found[3]):
            raise PublishError(f"{address!r} is not the address of a skin; use shm:NAME or zenoh:NAME@tcp/HOST:PORT")
        kind, name, where = found[1], found[2] or "skin", found[3]
        self._last: Contacts | None = None
        self._source: _Source
        if kind == "shm":
            self._source = SharedMemory(name)
        else:
            from ohmskin.client.remote import Subscriber  # only here: shared memory needs none of it

            self._source = Subscriber(name, where or "tcp/127.0.0.1:7447", token)

    def newest(self) -> Contacts | None:
        """The newest contacts, even if they were returned before; None before there are any.

        Never waits: check their `age`.
        """
        self._last = self._source.newest() or self._last
        return self._last

    def wait(self, timeout: float) -> Contacts | None:
        """The next contacts that were not returned before; None if there are none within `timeout` seconds."""
        if (fresh := self._source.newest() or self._source.wait(timeout)) is not None:
            self._last = fresh
        return fresh

    def close(self) -> None:
        """Close the connection. Safe to call twice."""
        self._source.close()
