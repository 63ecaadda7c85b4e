"""ROS 2 topics over zenoh, laid out as rmw_zenoh does, so that its nodes take us for one of theirs.

Data go to ``<domain>/<topic>/<type>/<hash>``, each message with number, time stamp and sender attached; liveliness
tokens
``@ros2_lv/...`` announce to nodes what there is.
"""

import hashlib
import re
import socket
import struct
from collections.abc import Callable, Iterator, Sequence
from itertools import count
from typing import Any

import zenoh

from ohmskin.client.remote import data_key, domain, is_loopback, open_session
from ohmskin.errors import PublishError
from ohmskin.outlets.topics import Topic, dds_name

PORT = 7447
_ATTACHMENT = struct.Struct("<qqB16s")  # number from 1, ns since 1970, length and bytes of the sender's id
_GID_BYTES = 16
_RELIABLE, _BEST_EFFORT = "", "2"  # of rmw_qos_reliability_policy_t; what is the default is left out


class ZenohOutlet:
    """See `ohmskin.outlets.outlet.Outlet`.

    Args:
        place: ``tcp/HOST:PORT`` of a router or peer to join, or ``listen/tcp/HOST:PORT`` to be found at. Unless given,
            port 7447 of this machine: joined if somebody is there (a ROS 2 router), else listened at.
        topics, node, token: See `open_outlet`. With a token, zenoh asks for user ``ohmskin`` and the token.

    Raises:
        PublishError: If the place cannot be used, or can be reached from other machines and there is no token.
    """

    def __init__(self, place: str, topics: Sequence[Topic], node: str, token: str | None) -> None:
        self.address, self._session = _opened(place, token)
        try:
            self._announce(topics, node)
        except BaseException:
            self.close()
            raise

    def _announce(self, topics: Sequence[Topic], node: str) -> None:
        """Declare the node and a publisher for each topic."""
        self._publishers: dict[Topic, tuple[Any, bytes, Iterator[int]]] = {}  # with sender's id and numbers
        me = f"@ros2_lv/{domain()}/{self._session.zid()}/0"
        named = "%/%/" + re.sub(r"[^A-Za-z0-9_]", "_", node)
        self._tokens = [self._session.liveliness().declare_token(f"{me}/0/NN/{named}")]
        for number, topic in enumerate(topics, start=10):
            qos = f"{_RELIABLE if topic.reliable else _BEST_EFFORT}::,{topic.depth}:,:,:,,"
            name = topic.name.replace("/", "%")
            token_key = f"{me}/{number}/MP/{named}/{name}/{topic.dds_type}/{topic.hash}/{qos}"
            gid = hashlib.sha256(token_key.encode()).digest()[:_GID_BYTES]
            publisher = self._session.declare_publisher(
                data_key(topic.name, topic.dds_type, topic.hash),
                congestion_control=zenoh.CongestionControl.DROP,  # a subscriber that does not read holds up nobody
                priority=zenoh.Priority.REAL_TIME if topic.reliable else zenoh.Priority.DATA,
                express=topic.reliable,  # contacts are small and urgent, images are not
                reliability=zenoh.Reliability.RELIABLE if topic.reliable else zenoh.Reliability.BEST_EFFORT,
            )
            self._publishers[topic] = publisher, gid, count(1)
            self._tokens.append(self._session.liveliness().declare_token(token_key))

    def send(self, topic: Topic, stamp: int, data: bytes) -> None:
        """Publish one CDR message."""
        publisher, gid, numbers = self._publishers[topic]
        publisher.put(data, attachment=_ATTACHMENT.pack(next(numbers), stamp, _GID_BYTES, gid))

    def close(self) -> None:
        """Take tokens and publishers back."""
        self._session.close()


def listen(
    place: str, topic: str, kind: str, token: str | None, take: Callable[[bytes], None]
) -> tuple[str, Callable[[], None]]:
    """Call `take` with every message (CDR) of a topic, whatever hash its type has; where, and what ends it.

    Raises:
        PublishError: As `ZenohOutlet`.
    """
    address, session = _opened(place, token)
    session.declare_subscriber(data_key(topic, dds_name(kind), "*"), lambda sample: take(sample.payload.to_bytes()))
    return address, session.close


def _opened(place: str, token: str | None) -> tuple[str, Any]:
    """A session at a place, and its address."""
    here, where = meeting_place(place)
    host = where.partition("/")[2].rpartition(":")[0]
    if here and token is None and not is_loopback(host):
        instead = "give a --token, or stay with 127.0.0.1"
        raise PublishError(f"zenoh at {where} can be reached from other machines; {instead}")
    session = open_session(where, here, token, gossip=not here or not is_loopback(host))
    return f"zenoh:{'listen/' if here else ''}{where}", session


def meeting_place(place: str) -> tuple[bool, str]:
    """Whether to listen, and where."""
    if not place:
        with socket.socket() as probe:
            probe.settimeout(1.0)
            taken = probe.connect_ex(("127.0.0.1", PORT)) == 0
        return not taken, f"tcp/127.0.0.1:{PORT}"
    where = place.removeprefix("listen/")
    return where != place, where
