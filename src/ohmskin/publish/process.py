"""The publishing process: reads boards, encodes messages, hands them to its outlets. Nothing in it can hold up the loop.

It is told on standard input: first a length (4 bytes) and JSON with what to publish where, then any byte whenever there is
something new. It answers on standard output, one JSON object per line, and ends when its standard input does.
"""

import json
import os
import signal
import sys
import time
from contextlib import ExitStack, closing, suppress
from typing import Any

import numpy as np

from ohmskin.client.board import BoardReader
from ohmskin.client.felt import Felt, Patch, patches_from, unpack
from ohmskin.errors import OhmskinError
from ohmskin.publish.messages import encode_cloud, encode_contacts, encode_markers, encode_wrench
from ohmskin.publish.outlet import Outlet, open_outlet
from ohmskin.publish.picture import Picture
from ohmskin.publish.topics import Topic, contacts_topic, prefix
from ohmskin.record.messages import encode_image


class Relay:
    """Takes what is new on the boards to the outlets.

    Args:
        name: Board of the contacts.
        pictures: Boards of the images, in the order of the patches.
        scale: Newtons per m2 of strength; without it no wrench is published, for strength is no force.
        outlets: Addresses, see `open_outlet`.
        token: See `open_outlet`.

    Raises:
        PublishError: If an outlet cannot be opened.
    """

    def __init__(self, name: str, pictures: list[str], scale: float | None, outlets: list[str], token: str | None) -> None:
        self._board, self._pictures = BoardReader(name), [BoardReader(picture) for picture in pictures]
        self._scale = scale
        self._contacts = contacts_topic(name)
        self._markers = Topic(f"{prefix(name)}/markers", "visualization_msgs/msg/MarkerArray", True, 10)
        self._wrench = Topic(f"{prefix(name)}/wrench", "geometry_msgs/msg/WrenchStamped", True, 10)
        self._images = [
            (
                Topic(f"{prefix(own)}/image", "sensor_msgs/msg/Image", False, 5),
                Topic(f"{prefix(own)}/points", "sensor_msgs/msg/PointCloud2", False, 5),
            )
            for own in (picture.removesuffix(".image") for picture in pictures)
        ]
        topics = [self._contacts, self._markers, *(topic for pair in self._images for topic in pair)]
        topics += [self._wrench] if scale is not None else []
        self.outlets: list[Outlet] = []
        with ExitStack() as stack:
            for address in outlets:
                self.outlets.append(stack.enter_context(closing(open_outlet(address, topics, f"ohmskin_{name}", token))))
            self._stack = stack.pop_all()
        self._patches: tuple[Patch, ...] = ()
        self._boot, self._marked, self._due = 0, False, 0.0

    def look(self, picture_every: float) -> None:
        """Publish what is new: contacts at once, markers and images as often as that."""
        if (record := self._board.newest()) is None:
            return
        if self._board.boot != self._boot:
            self._boot, self._patches = self._board.boot, patches_from(self._board.setup)
        felt = unpack(record, self._patches, self._boot)
        self._send(self._contacts, felt.stamp, encode_contacts(felt))
        if self._scale is not None:
            self._send_wrenches(felt, self._scale)
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + picture_every
        if felt.contacts or self._marked:
            self._send(self._markers, felt.stamp, encode_markers(felt.contacts, self._patches, felt.stamp))
            self._marked = bool(felt.contacts)
        for board, patch, (image, points) in zip(self._pictures, self._patches, self._images, strict=True):
            if (content := board.newest()) is not None:
                picture = Picture.unpack(content, board.setup)
                self._send(image, picture.stamp, encode_image(picture.pixels, picture.stamp, patch.frame))
                self._send(points, picture.stamp, encode_cloud(picture.pixels, picture.x, picture.y, patch, picture.stamp))

    def close(self) -> None:
        """Close outlets and boards."""
        self._stack.close()
        for board in (self._board, *self._pictures):
            board.close()

    def _send_wrenches(self, felt: Felt, scale: float) -> None:
        for patch in felt.patches:
            if not patch.sequence:  # not heard of: that it is not pushed is not known
                continue
            own = [contact for contact in felt.contacts if contact.patch == patch.patch]
            for contact in own or (None,):  # none: a wrench of zero, so that the end of a push is told
                self._send(self._wrench, patch.stamp, encode_wrench(contact, patch.frame, patch.stamp, scale))

    def _send(self, topic: Topic, stamp: int, data: bytes) -> None:
        for outlet in self.outlets:
            outlet.send(topic, stamp, data)


def main() -> None:
    """Publish until standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Standard output carries answers, so that whatever a library prints must go elsewhere.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())

    def say(**answer: object) -> None:
        with suppress(OSError):  # the loop has gone; standard input ends next
            print(json.dumps(answer), file=answers, flush=True)

    source = sys.stdin.fileno()
    length = int.from_bytes(_exactly(source, 4), "little")
    settings: dict[str, Any] = json.loads(_exactly(source, length))
    every = settings.pop("picture_every")
    try:
        relay = Relay(**settings)
    except OhmskinError as error:
        say(failed=str(error))
        return
    with closing(relay), np.errstate(all="ignore"):
        say(ready=[outlet.address for outlet in relay.outlets])
        while os.read(source, 65536):
            relay.look(every)


def _exactly(source: int, count: int) -> bytes:
    data = b""
    while len(data) < count:
        if not (more := os.read(source, count - len(data))):
            raise SystemExit
        data += more
    return data


if __name__ == "__main__":
    main()
