"""Joint states of a robot that speaks ROS 2 (`sensor_msgs/msg/JointState`), passed on to the board of its body.

A process of its own listens until its standard input ends, from which it first reads what to hear (`ohmskin.child`).
"""

import logging
import os
import struct
import time
from collections.abc import Callable, Collection
from contextlib import ExitStack
from importlib import import_module

from ohmskin.child import Child, begin
from ohmskin.client.cdr import CdrDecoder
from ohmskin.client.joints import JointStates
from ohmskin.closing import Closing
from ohmskin.errors import OhmskinError, PublishError
from ohmskin.outlets.outlet import check_outlet

log = logging.getLogger(__name__)

_TYPE = "sensor_msgs/JointState"
_START_TIMEOUT = 60.0
_REPORT_EVERY = 10.0  # s
_OTHER_CLOCK = 10.0  # s from now, beyond which a stamp is by another clock, such as a simulation's


class JointMerger:
    """Keeps the newest position of each joint of a body, whoever sends it, and passes them on together.

    Args:
        states: Where to.
        joints: Names of the body's joints; messages may have others.
    """

    def __init__(self, states: JointStates, joints: Collection[str]) -> None:
        self._states, self._joints = states, joints
        self._known: dict[str, tuple[float, float]] = {}  # position, and when it was so (s, monotonic clock)
        self._report_at = 0.0  # s, monotonic clock

    def take(self, message: bytes, since: float = 0.0) -> None:
        """Pass on a message (CDR) that came `since` seconds ago. One without sense is told, unless one was lately.

        All positions are as old as the oldest: of a joint that no message has, nothing is known.
        """
        try:
            known = self._known | self._decoded(message, since)
            if known:
                positions = {name: position for name, (position, _) in known.items()}
                self._states.push(positions, time.monotonic() - min(at for _, at in known.values()))
            self._known = known
        except OhmskinError as error:
            if (now := time.monotonic()) >= self._report_at:
                self._report_at = now + _REPORT_EVERY
                log.warning("joint states are ignored: %s", error)

    def _decoded(self, message: bytes, since: float) -> dict[str, tuple[float, float]]:
        decoder = CdrDecoder(message)
        age = time.time() - since - decoder.stamp() * 1e-9
        at = time.monotonic() - (age if 0 < age < _OTHER_CLOCK else 0.0)
        decoder.text()
        names = [decoder.text() for _ in range(decoder.count(4))]
        block = decoder.block(8)
        positions = struct.unpack(f"<{len(block) // 8}d", block)
        if positions and len(positions) != len(names):
            raise PublishError(f"a message has {len(names)} joints and {len(positions)} positions")
        return {name: (p, at) for name, p in zip(names, positions, strict=bool(positions)) if name in self._joints}


class JointsProcess(Closing):
    """The process that listens.

    Args:
        name: Name of the body.
        joints: Names of its joints.
        place: ``zenoh`` or ``dds``, with a place as outlets have it (`ohmskin.outlets.outlet.open_outlet`).
        topic: The topic, usually ``/joint_states``.
        token: As for outlets.

    Attributes:
        address: Where it listens.

    Raises:
        PublishError: If it cannot listen there, or another program sends the body's joints.
    """

    def __init__(self, name: str, joints: Collection[str], place: str, topic: str, token: str | None) -> None:
        if place.partition(":")[0] not in ("zenoh", "dds"):
            raise PublishError(f"joint states cannot be received over {place!r}; choose from zenoh and dds")
        check_outlet(place)
        settings = {"name": name, "joints": list(joints), "place": place, "topic": topic, "token": token}
        self._child = Child.module("ohmskin.outlets.joints", "the process that receives joint states", settings)
        self.address = str(self._child.ready(_START_TIMEOUT, PublishError)["ready"])

    def close(self) -> None:
        """End it. Safe to call twice."""
        self._child.close()


def subscribe(
    place: str, topic: str, kind: str, token: str | None, take: Callable[[bytes], None]
) -> tuple[str, Callable[[], None]]:
    """Call `take` with every message of a topic, in a thread of the library's; where that is, and what ends it.

    Raises:
        PublishError: If the place cannot be used.
    """
    protocol, _, where = place.partition(":")
    listen = import_module(f"ohmskin.outlets.{protocol}").listen
    address, end = listen(where, f"/{topic.strip('/')}", kind, token, take)
    return str(address), end


def main() -> None:
    """Listen until standard input ends."""
    settings, answer = begin()
    with ExitStack() as stack:
        try:
            states = stack.enter_context(JointStates(settings["name"]))
            merger = JointMerger(states, settings["joints"])
            address, end = subscribe(settings["place"], settings["topic"], _TYPE, settings["token"], merger.take)
        except OhmskinError as error:
            answer(failed=str(error))
            return
        stack.callback(end)
        answer(ready=address)
        while os.read(0, 65536):
            pass


if __name__ == "__main__":
    main()
