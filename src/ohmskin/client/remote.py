"""The client's other way to hear a skin: through zenoh, from another machine or container.

Topics over zenoh are laid out as rmw_zenoh does: data go to ``<domain>/<topic>/<type>/<hash>``.
"""

import ipaddress
import json
import os
import re
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from ohmskin.client.board import check_name
from ohmskin.client.cdr import CdrDecoder
from ohmskin.client.contacts import Contacts, Patch, PatchState, contact_from
from ohmskin.client.fields import components, known
from ohmskin.errors import DataError, PublishError

CONTACTS_TYPE = "ohmskin_msgs::msg::dds_::Contacts_"
CONTACTS_HASH = "RIHS01_176d6e7acea1c2c576eeb43d025183cc2bbdf548c2dc5674ed8343d25c6385c8"
_USER = "ohmskin"
_PLACE = re.compile(r"tcp/(?:\[[0-9a-fA-F:.]+\]|[^:/\[\]]+):(\d{1,5})")
_LARGEST_DOMAIN = 232  # beyond which DDS has no ports
_CONTACT = "Ii" + "d" * (len(components(3)) - 1)


class Subscriber:
    """The newest contacts of a sender elsewhere; see `Client`. Clocks should agree (NTP): ages come from stamps.

    Raises:
        PublishError: If the extra `zenoh` is missing, or the name or the place cannot be used.
    """

    def __init__(self, name: str, where: str, token: str | None) -> None:
        check_name(name)
        if not is_place(where):
            raise PublishError(f"zenoh cannot join {where!r}; use zenoh:NAME@tcp/HOST:PORT, with a port of 1 to 65535")
        self._fresh: Contacts | None = None
        self._here = threading.Condition()
        self._session = open_session(where, False, token)
        try:
            key = data_key(f"{prefix(name)}/contacts", CONTACTS_TYPE, CONTACTS_HASH)
            self._session.declare_subscriber(key, self._take)
        except BaseException:
            self.close()
            raise

    def newest(self) -> Contacts | None:
        return self.wait(0.0)

    def wait(self, timeout: float) -> Contacts | None:
        with self._here:
            self._here.wait_for(lambda: self._fresh is not None, timeout)
            fresh, self._fresh = self._fresh, None
            return fresh

    def close(self) -> None:
        self._session.close()

    def _take(self, sample: Any) -> None:
        try:
            merged = decode_contacts(sample.payload.to_bytes(), time.monotonic() - time.time())
        except DataError:
            return  # not of ours, or damaged: the one before grows old, which is what its reader looks at
        with self._here:
            self._fresh = merged
            self._here.notify_all()


def prefix(name: str) -> str:
    """What the topics of a skin or body begin with; a patch's name follows its body's behind a dot."""
    return "/ohmskin" if name == "skin" else f"/ohmskin/{name.replace('.', '/')}"


def domain() -> int:
    """The ROS 2 domain to publish and listen in: that of the variable ROS_DOMAIN_ID, 0 unless set.

    Raises:
        PublishError: If it is not 0 to 232.
    """
    given = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not (given.isdecimal() and given.isascii() and int(given) <= _LARGEST_DOMAIN):
        raise PublishError(f"ROS_DOMAIN_ID is {given!r}; it must be a whole number from 0 to {_LARGEST_DOMAIN}")
    return int(given)


def data_key(topic: str, dds_type: str, hash_: str) -> str:
    """The zenoh key of a topic's messages."""
    return f"{domain()}/{topic.strip('/')}/{dds_type}/{hash_}"


def is_place(where: str) -> bool:
    """Whether something can be found or offered over zenoh there: ``tcp/HOST:PORT``."""
    found = _PLACE.fullmatch(where)
    return found is not None and 0 < int(found[1]) < 65536


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def open_session(where: str, listen: bool, token: str | None, gossip: bool = True) -> Any:
    """A zenoh session that joins or listens at one place, asks nobody else, and keeps trying.

    Args:
        where: ``tcp/HOST:PORT``.
        listen: Whether to be found there instead of joining who is.
        token: Password, if there is one.
        gossip: Whether to introduce others there to each other.

    Raises:
        PublishError: If the extra `zenoh` is missing, or it cannot be opened.
    """
    try:
        import zenoh
    except ImportError as error:
        raise PublishError("receiving a skin over zenoh needs a package: pip install 'ohmskin[zenoh]'") from error
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": gossip,
        "listen/endpoints": [where] if listen else [],
        "connect/endpoints": [] if listen else [where],
        "connect/timeout_ms": 0 if listen else -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
    }
    with tempfile.TemporaryDirectory() as folder:
        if token is not None:
            known = Path(folder) / "users"
            known.touch(mode=0o600)
            known.write_text(f"{_USER}:{token}\n", encoding="utf-8")
            settings["transport/auth/usrpwd"] = {"user": _USER, "password": token, "dictionary_file": str(known)}
        try:
            for name, value in settings.items():
                config.insert_json5(name, json.dumps(value))
            return zenoh.open(config)
        except zenoh.ZError as error:
            why = re.sub(r" at /\S+\.rs:\d+\.?", "", str(error))  # where in zenoh's code
            raise PublishError(f"zenoh cannot {'listen at' if listen else 'join'} {where}: {why}") from error


def decode_contacts(data: bytes, offset: float) -> Contacts:
    """What an `ohmskin_msgs/msg/Contacts` says.

    Args:
        data: The message.
        offset: This machine's monotonic clock less the calendar (s), which turns stamps into times.

    Raises:
        DataError: If it is not such a message.
    """
    decoder = CdrDecoder(data)
    stamp = decoder.stamp()
    decoder.text()
    boot, sequence = (int(value) for value in decoder.take("QQ"))
    patches = []
    for _ in range(decoder.count(28)):
        name, frame, seen = decoder.text(), decoder.text(), decoder.stamp()
        number, mode = int(decoder.take("Q")[0]), decoder.text()
        patches.append(PatchState(name, frame, number, seen * 1e-9 + offset if seen else float("-inf"), seen, mode))
    contacts = []
    for _ in range(decoder.count(8 * len(_CONTACT) - 8)):
        place, *own = decoder.take(_CONTACT)
        if place >= len(patches):
            raise DataError(f"a contact of patch {place} in a message of {len(patches)} patches")
        patch = patches[int(place)]
        contacts.append(contact_from(Patch(patch.patch, patch.frame), own))
    if not decoder.ended:  # recordings of 0.1 have no total forces
        totals = decoder.take("d" * decoder.count(8))
        patches = [replace(one, total_force=known(own)) for one, own in zip(patches, totals, strict=False)]
    at = stamp * 1e-9 + offset if stamp else float("-inf")
    return Contacts(sequence, at, stamp, tuple(patches), tuple(contacts), boot)
