"""ROS 2 topics over DDS (Cyclone DDS), as ROS 2 lays them out: topic ``rt/NAME``, type ``package::msg::dds_::Name_``.

DDS has no password. It stays on this machine unless an interface is named.
"""

import logging
import os
import socket
import stat
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from typing import Any
from weakref import WeakValueDictionary
from xml.sax.saxutils import quoteattr

from cyclonedds.core import DDSException, Listener
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic as DdsTopic
from cyclonedds.util import duration

from ohmskin.client.remote import domain
from ohmskin.errors import PublishError
from ohmskin.mcap.schemas import FIELD
from ohmskin.outlets.topics import TEXTS, Topic, dds_name

log = logging.getLogger(__name__)

_AT_ONCE = 100  # messages
_DOMAINS: WeakValueDictionary[tuple[int, str], Domain] = WeakValueDictionary()


class DdsOutlet:
    """See `ohmskin.outlets.outlet.Outlet`.

    Args:
        place: The network interface, such as ``eth0``, whose network may then listen; this machine's own unless given.
        topics, node: See `open_outlet`.
        token: Not used: plain DDS knows no such thing.

    Raises:
        PublishError: If there is no such interface.
    """

    def __init__(self, place: str, topics: Sequence[Topic], node: str, token: str | None) -> None:
        self.address, self._domain, self._participant = _joined(place)
        self._writers = {topic: self._writer(topic) for topic in topics}

    def send(self, topic: Topic, stamp: int, data: bytes) -> None:
        """Publish one CDR message."""
        sample = _message(topic.type)()
        sample.ready = data
        self._writers[topic].write(sample, stamp)

    def close(self) -> None:
        """Leave the domain."""
        self._writers.clear()
        del self._participant, self._domain

    def _writer(self, topic: Topic) -> DataWriter:
        lasting = Policy.Reliability.Reliable(duration(seconds=0)) if topic.reliable else Policy.Reliability.BestEffort
        history, cdr = Policy.History.KeepLast(topic.depth), Policy.DataRepresentation(True, False)
        told = Policy.Userdata(f"typehash={topic.hash};".encode())  # where ROS 2 looks for it
        qos = Qos(lasting, Policy.Durability.Volatile, history, cdr, told)
        return DataWriter(self._participant, DdsTopic(self._participant, f"rt{topic.name}", _message(topic.type)), qos)


def listen(
    place: str, topic: str, kind: str, token: str | None, take: Callable[[bytes], None]
) -> tuple[str, Callable[[], None]]:
    """Call `take` with every message (CDR) of a topic; where, and what ends it.

    Raises:
        PublishError: As `DdsOutlet`.
    """

    class Taker(Listener):
        def on_data_available(self, reader: Any) -> None:
            for sample in reader.take(N=_AT_ONCE):
                if isinstance(sample, kept):
                    take(sample.ready)

    address, here, participant = _joined(place)
    kept = _message(kind)
    qos = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(_AT_ONCE))  # which hears reliable ones, too
    topics = DdsTopic(participant, f"rt{topic}", kept)
    taker = Taker()  # type: ignore[no-untyped-call]
    held: list[Any] = [here, participant, topics, DataReader(participant, topics, qos, listener=taker)]
    del here, participant, topics

    def end() -> None:
        while held:
            held.pop()

    return address, end


def _joined(place: str) -> tuple[str, Domain, DomainParticipant]:
    """The address of an interface, and our part in its domain."""
    interface = place or "lo"
    try:
        here = _DOMAINS.get((domain(), interface))
        if here is None:  # a process may configure a domain once
            here = _DOMAINS[domain(), interface] = Domain(domain(), domain_config(interface))
        participant = DomainParticipant(domain())
        stay_on(interface)
    except DDSException as error:
        what = f"DDS cannot use the interface {interface!r}: {error}"
        raise PublishError(f"{what}; `ip link` lists what there is") from error
    return f"dds:{interface}", here, participant


def domain_config(interface: str) -> str:
    """Cyclone's configuration for one interface; on the loopback one without multicast."""
    multicast, peer = ("false", '<Peers><Peer address="127.0.0.1"/></Peers>') if interface == "lo" else ("true", "")
    return (
        f"<CycloneDDS><Domain><General><Interfaces><NetworkInterface name={quoteattr(interface)} "
        f"multicast={quoteattr(multicast)}/></Interfaces><AllowMulticast>{multicast}</AllowMulticast></General>"
        "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
        f"<Discovery><ParticipantIndex>auto</ParticipantIndex>"
        f"<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>{peer}</Discovery></Domain></CycloneDDS>"
    )


def stay_on(interface: str) -> None:
    """Let this process's UDP sockets hear nothing but one interface.

    Cyclone binds them to all addresses, whatever interface is chosen (its issues 1923 and 2090).
    """
    try:
        for own in _udp_sockets():
            with own:
                own.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, interface.encode() + b"\0")
    except (AttributeError, OSError):  # no such option, or no right to use it
        log.warning("cannot bind DDS to %s here; block UDP ports 7400 to 7500 with a firewall", interface)


def _udp_sockets() -> Iterator[socket.socket]:
    """Every UDP socket that this process has, once more."""
    for entry in os.listdir("/proc/self/fd"):
        with suppress(OSError):  # closed meanwhile
            if not stat.S_ISSOCK(os.stat(f"/proc/self/fd/{entry}").st_mode):
                continue
            own = socket.socket(fileno=os.dup(int(entry)))
            if own.type == socket.SOCK_DGRAM and own.family in (socket.AF_INET, socket.AF_INET6):
                yield own
            else:
                own.close()


@cache
def _struct(kind: str) -> Any:
    """A type (``package/Name``) as Cyclone wants to know it."""
    fields: dict[str, Any] = {}
    many: Any = types  # its annotations do not know that these can be indexed
    for own, is_sequence, name in FIELD.findall(TEXTS[kind]):
        one = _struct(own) if "/" in own else {"bool": bool, "string": str}.get(own) or getattr(types, own)
        fields[name] = many.sequence[one] if is_sequence else one
    return make_idl_struct(dds_name(kind).replace("::", "_"), dds_name(kind), fields)


@cache
def _message(topic_type: str) -> Any:
    """A type whose samples bring their bytes along, because `ohmskin.client.cdr` is the one place that makes them."""
    kind = _struct(topic_type.replace("/msg/", "/"))

    def serialize(self: Any, buffer: object = None, endianness: object = None, use_version_2: object = None) -> bytes:
        return bytes(self.ready)

    def deserialize(data: bytes, *_: object, **__: object) -> Any:
        sample = kind()
        sample.ready = bytes(data)
        return sample

    kind.serialize, kind.deserialize = serialize, staticmethod(deserialize)
    kind.deserialize_key = kind.deserialize  # of the sample, not valid, that tells that a publisher has left
    kind.__init__ = lambda self: None
    return kind
