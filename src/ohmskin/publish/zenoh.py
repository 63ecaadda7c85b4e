"""ROS 2 topics over zenoh, laid out as rmw_zenoh does, so that its nodes, `ros2 topic echo` too, take us for one of theirs.

Data go to ``<domain>/<topic>/<type>/<hash>``, each message with number, time stamp and sender attached; liveliness tokens
``@ros2_lv/...`` tell nodes what there is.
"""

import hashlib
import json
import re
import socket
import struct
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import zenoh

from ohmskin.errors import PublishError
from ohmskin.publish.outlet import is_loopback
from ohmskin.publish.topics import Topic

DOMAIN = 0
PORT = 7447
_USER = "ohmskin"
_PLACE = re.compile(r"(listen/)?(tcp)/(\[[0-9a-fA-F:.]+\]|[^:/\[\]]+):(\d{1,5})")
_ATTACHMENT = struct.Struct("<qqB16s")  # number from 1, ns since 1970, length and bytes of the sender's id
_GID_BYTES = 16
_RELIABLE, _BEST_EFFORT = "", "2"  # of rmw_qos_reliability_policy_t; what is the default is left out


class ZenohOutlet:
    """See `ohmskin.publish.outlet.Outlet`.

    Args:
        place: ``tcp/HOST:PORT`` of a router or peer to join, or ``listen/tcp/HOST:PORT`` to be found at. Unless given, port 7447 of
            this machine: joined if somebody is there (a ROS 2 router), else listened at.
        topics, node, token: See `open_outlet`. With a token, zenoh's user and password are asked for: ``ohmskin`` and the token.

    Raises:
        PublishError: If the place cannot be used, or can be reached from other machines and there is no token.
    """

    def __init__(self, place: str, topics: Sequence[Topic], node: str, token: str | None) -> None:
        listen, where = _place(place)
        host = where.partition("/")[2].rpartition(":")[0]
        if listen and token is None and not is_loopback(host):
            raise PublishError(f"zenoh at {where} can be reached from other machines; give a --token, or stay with 127.0.0.1")
        self.address = f"zenoh:{'listen/' if listen else ''}{where}"
        self._session = open_session(where, listen, token)
        self._counts = dict.fromkeys(topics, 0)
        self._gids: dict[Topic, bytes] = {}
        self._publishers: dict[Topic, Any] = {}
        me = f"@ros2_lv/{DOMAIN}/{self._session.zid()}/0"
        named = "%/%/" + re.sub(r"[^A-Za-z0-9_]", "_", node)
        self._tokens = [self._session.liveliness().declare_token(f"{me}/0/NN/{named}")]
        for number, topic in enumerate(topics, start=10):
            qos = f"{_RELIABLE if topic.reliable else _BEST_EFFORT}::,{topic.depth}:,:,:,,"
            name = topic.name.replace("/", "%")
            token_key = f"{me}/{number}/MP/{named}/{name}/{topic.dds_type}/{topic.hash}/{qos}"
            self._gids[topic] = hashlib.sha256(token_key.encode()).digest()[:_GID_BYTES]
            self._publishers[topic] = self._session.declare_publisher(
                data_key(topic),
                congestion_control=zenoh.CongestionControl.DROP,  # a subscriber that does not read holds up nobody
                priority=zenoh.Priority.REAL_TIME if topic.reliable else zenoh.Priority.DATA,
                express=topic.reliable,  # contacts are small and urgent, images are not
                reliability=zenoh.Reliability.RELIABLE if topic.reliable else zenoh.Reliability.BEST_EFFORT,
            )
            self._tokens.append(self._session.liveliness().declare_token(token_key))

    def send(self, topic: Topic, stamp: int, data: bytes) -> None:
        """Publish one CDR message."""
        self._counts[topic] += 1
        attachment = _ATTACHMENT.pack(self._counts[topic], stamp, _GID_BYTES, self._gids[topic])
        self._publishers[topic].put(data, attachment=attachment)

    def close(self) -> None:
        """Take tokens and publishers back."""
        self._session.close()


def data_key(topic: Topic) -> str:
    """The key of a topic's messages."""
    return f"{DOMAIN}/{topic.name.strip('/')}/{topic.dds_type}/{topic.hash}"


def open_session(where: str, listen: bool, token: str | None) -> Any:
    """A zenoh session that joins or listens at one place, asks nobody else, and keeps trying.

    Raises:
        PublishError: If it cannot be opened.
    """
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": not listen or not is_loopback(where.partition("/")[2].rpartition(":")[0]),
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
            raise PublishError(f"zenoh cannot {'listen at' if listen else 'join'} {where}: {error}") from error


def _place(place: str) -> tuple[bool, str]:
    """Whether to listen, and where."""
    if not place:
        taken = True
        with socket.socket() as probe:
            probe.settimeout(1.0)
            taken = probe.connect_ex(("127.0.0.1", PORT)) == 0
        return not taken, f"tcp/127.0.0.1:{PORT}"
    found = _PLACE.fullmatch(place)
    if not found or not 0 < int(found[4]) < 65536:
        raise PublishError(f"zenoh:{place} is no place; use zenoh, zenoh:tcp/HOST:PORT or zenoh:listen/tcp/HOST:PORT")
    return bool(found[1]), place.removeprefix("listen/")
