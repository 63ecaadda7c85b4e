"""Outlets: the ways out of a publishing process, one class for each protocol, all with one method."""

import re
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Protocol

from ohmskin.errors import PublishError
from ohmskin.outlets.topics import Topic

_HOMES = {
    "zenoh": ("ohmskin.outlets.zenoh", "ZenohOutlet", "zenoh"),
    "dds": ("ohmskin.outlets.dds", "DdsOutlet", "cyclonedds"),
    "foxglove": ("ohmskin.outlets.foxglove", "FoxgloveOutlet", "foxglove"),
    "mcap": ("ohmskin.outlets.file", "FileOutlet", "mcap"),
}
_HOST = r"(\[[0-9a-fA-F:.]+\]|[^:/\[\]]+)"
_PLACES = {
    "zenoh": (rf"((listen/)?tcp/{_HOST}:[1-9]\d{{0,4}})?", "zenoh, zenoh:tcp/HOST:PORT or zenoh:listen/tcp/HOST:PORT"),
    "dds": (r"[A-Za-z0-9_.:@-]{0,32}", "dds or dds:INTERFACE, of which `ip link` lists what there is"),
    "foxglove": (rf"({_HOST}?(:\d{{1,5}})?)", "foxglove or foxglove:HOST:PORT"),
    "mcap": (r".*[^/]\.mcap", "mcap:FILE.mcap"),
}
KINDS = ("shm", *_HOMES)
"""What `--publish` takes. Shared memory needs no outlet: it is where outlets read."""


class Outlet(Protocol):
    """Passes encoded messages on. Made in the publishing process, which may wait in it; the loop never does.

    Attributes:
        address: Where others find it.
    """

    address: str

    def send(self, topic: Topic, stamp: int, data: bytes) -> None:
        """Publish one CDR message, stamped in ns since 1970."""

    def close(self) -> None:
        """Say goodbye."""


def open_outlet(address: str, topics: Sequence[Topic], node: str, token: str | None) -> Outlet:
    """The outlet at an address such as ``zenoh``, ``zenoh:tcp/HOST:PORT``, ``dds:eth0``, ``foxglove:127.0.0.1:8765`` or
    ``mcap:FILE.mcap``.

    Args:
        address: Kind and place; without a place it is on this machine only.
        topics: All that will be sent.
        node: What to call the sender.
        token: What listeners on other machines must give, where the protocol knows such a thing.

    Raises:
        PublishError: If there is no such kind, its extra is missing, or the place cannot be used.
    """
    check_outlet(address)
    kind, _, place = address.partition(":")
    module, name, _ = _HOMES[kind]
    outlet: Outlet = getattr(import_module(module), name)(place, topics, node, token)
    return outlet


def check_outlet(address: str) -> None:
    """Hold an address against those there are; nothing is opened for that.

    Raises:
        PublishError: If there is no such kind, its extra is missing, or the place is none of that kind.
    """
    kind, _, place = address.partition(":")
    if kind not in KINDS or (kind == "shm" and place):
        raise PublishError(f"cannot publish to {address!r}; choose from {', '.join(KINDS)}")
    if kind not in _HOMES:
        return
    if find_spec(_HOMES[kind][-1]) is None:
        raise PublishError(f"publishing to {kind} needs a package: pip install 'ohmskin[{kind}]'")
    pattern, choices = _PLACES[kind]
    port = re.search(r":(\d{1,5})$", place)
    if not re.fullmatch(pattern, place) or (port and int(port[1]) > 65535):
        raise PublishError(f"{address} is not a place; use {choices}")
