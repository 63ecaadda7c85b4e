"""The publishing process: reads boards, encodes messages, hands them to its outlets. The loop never waits for it.

It reads from standard input what to publish where (`ohmskin.child`), then any byte whenever there is something new.
"""

import json
import math
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, suppress

import numpy as np

from ohmskin.child import begin
from ohmskin.client.board import BoardReader
from ohmskin.client.cdr import CdrDecoder
from ohmskin.client.contacts import Contacts, Patch, PlacedContact, SharedMemory
from ohmskin.client.joints import LinkPoses
from ohmskin.client.remote import prefix
from ohmskin.errors import OhmskinError
from ohmskin.mcap.standard import encode_image, encode_markers
from ohmskin.outlets.messages import encode_cloud, encode_contacts, encode_joints, encode_transforms, encode_wrench
from ohmskin.outlets.outlet import Outlet, open_outlet
from ohmskin.outlets.picture import Picture
from ohmskin.outlets.topics import Topic, contacts_topic, wrench_topic

_DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", True, 10)


class Relay:
    """Takes what is new on the boards to the outlets.

    Args:
        name: Board of the contacts.
        pictures: Boards of the images, in the order of the patches.
        links: Frames with patches that have forces: each has a topic of wrenches, for strength is no force.
        outlets: Addresses, see `open_outlet`.
        token: See `open_outlet`.
        root: Link in whose frame the poses of a robot's links are given, with its joint states; empty: they are not.

    Raises:
        PublishError: If an outlet cannot be opened.
    """

    def __init__(
        self, name: str, pictures: list[str], links: list[str], outlets: list[str], token: str | None, root: str = ""
    ) -> None:
        self._root = root
        self._joints = Topic(f"{prefix(name)}/joint_states", "sensor_msgs/msg/JointState", True, 10)
        self._transforms = Topic(f"{prefix(name)}/tf", "tf2_msgs/msg/TFMessage", True, 100)
        self._contacts = contacts_topic(name)
        self._markers = Topic(f"{prefix(name)}/markers", "visualization_msgs/msg/MarkerArray", True, 10)
        self._wrenches = {link: wrench_topic(name, link, links) for link in links}
        self._images = [
            (
                Topic(f"{prefix(own)}/image", "sensor_msgs/msg/Image", False, 5),
                Topic(f"{prefix(own)}/points", "sensor_msgs/msg/PointCloud2", False, 5),
            )
            for own in (picture.removesuffix(".image") for picture in pictures)
        ]
        topics = [self._contacts, self._markers, *(topic for pair in self._images for topic in pair)]
        topics += [*self._wrenches.values(), _DIAGNOSTICS, *([self._joints, self._transforms] if root else [])]
        self.outlets: list[Outlet] = []
        with ExitStack() as stack:
            self._board = stack.enter_context(closing(SharedMemory(name)))
            self._states = stack.enter_context(closing(BoardReader(f"{name}.joints")))
            self._poses = stack.enter_context(LinkPoses(name))
            self._pictures = [stack.enter_context(BoardReader(picture)) for picture in pictures]
            health = [picture.removesuffix(".image") + ".health" for picture in pictures]
            self._health = [stack.enter_context(BoardReader(board)) for board in health]
            for address in outlets:
                opened = open_outlet(address, topics, f"ohmskin_{name}", token)
                self.outlets.append(stack.enter_context(closing(opened)))
            self._stack = stack.pop_all()
        self._unmarked: Contacts | None = None  # the newest contacts, until markers show them
        self._marked, self._shown = False, -math.inf
        self._stood, self._posed = 0, self._poses.newest()

    def poll(self, picture_every: float) -> None:
        """Publish what is new: contacts at once, markers and images as often as that."""
        if (merged := self._board.newest()) is not None:
            self._unmarked = merged
            self._send(self._contacts, merged.stamp, encode_contacts(merged))
            for link, stamp, pushing in wrenches(merged, self._board.patches, self._wrenches):
                self._send(self._wrenches[link], stamp, encode_wrench(pushing, link, stamp))
            self._send_posture()
        if (now := time.monotonic()) - self._shown >= picture_every:
            self._shown = now
            self._send_pictures()

    def close(self) -> None:
        """Close outlets and boards."""
        self._stack.close()

    def _send_posture(self) -> None:
        """How the joints stand, and where the links are by them, if that is new."""
        with suppress(ValueError, KeyError, TypeError, AttributeError):  # whoever writes that board may err
            if self._root and (record := self._states.newest()) is not None:
                told = json.loads(record)
                self._stood = time.time_ns() - round((time.monotonic() - float(told["time"])) * 1e9)
                self._send(self._joints, self._stood, encode_joints(told["positions"], self._stood))
            if self._root and (poses := self._poses.newest()) is not self._posed:  # some time after the joints
                self._posed = poses
                self._send(self._transforms, self._stood, encode_transforms(self._root, poses, self._stood))

    def _send_pictures(self) -> None:
        """Health, markers and images, those that are new."""
        for board in self._health:
            if (told := board.newest()) is not None:
                self._send(_DIAGNOSTICS, CdrDecoder(told).stamp(), told)
        if not (patches := self._board.patches):
            return
        if (merged := self._unmarked) is not None and (merged.contacts or self._marked):
            self._send(self._markers, merged.stamp, encode_markers(merged.contacts, patches, merged.stamp))
            self._marked = bool(merged.contacts)
        self._unmarked = None
        for board, patch, (image, points) in zip(self._pictures, patches, self._images, strict=True):
            if (content := board.newest()) is not None:
                picture = Picture.unpack(content, board.setup)
                pixels, stamp = picture.pixels, picture.stamp
                self._send(image, stamp, encode_image(pixels, stamp, patch.frame))
                self._send(points, stamp, encode_cloud(pixels, picture.points, patch.frame, stamp))

    def _send(self, topic: Topic, stamp: int, data: bytes) -> None:
        for outlet in self.outlets:
            outlet.send(topic, stamp, data)


def wrenches(
    merged: Contacts, patches: Sequence[Patch], links: Iterable[str]
) -> Iterator[tuple[str, int, list[PlacedContact]]]:
    """Links, with the time (ns) and all the contacts that push them: none when nothing does; no link of which that is
    not known."""
    telling = {patch.name for patch in patches if patch.newtons}
    for link in links:
        seen = [one for one in merged.patches if one.frame == link and one.patch in telling]
        names = [one.patch for one in seen]
        own = [contact for contact in merged.contacts if contact.patch in names]
        if all(one.sequence for one in seen) and not any(contact.force is None for contact in own):
            yield link, min(one.stamp for one in seen), own


def main() -> None:
    """Publish until standard input ends."""
    settings, answer = begin()
    every = settings.pop("picture_every")
    try:
        relay = Relay(**settings)
    except OhmskinError as error:
        answer(failed=str(error))
        return
    with closing(relay), np.errstate(all="ignore"):
        answer(ready=[outlet.address for outlet in relay.outlets])
        while os.read(0, 65536):
            relay.poll(every)
        relay.poll(0.0)  # the end is shown too, however soon after the last image


if __name__ == "__main__":
    main()
