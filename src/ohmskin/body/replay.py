"""A recorded body again: contacts, images and joint positions, on the boards of its patches."""

import logging
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from ohmskin.body.body import Body
from ohmskin.client.joints import JointStates
from ohmskin.client.remote import decode_contacts, prefix
from ohmskin.closing import Closing
from ohmskin.errors import DataError
from ohmskin.mcap.container import Container
from ohmskin.mcap.standard import decode_image
from ohmskin.outlets.joints import JointMerger
from ohmskin.outlets.publisher import Publisher

log = logging.getLogger(__name__)


class BodyReplay(Closing):
    """Writes the boards of a body's patches from a recording of it, at the pace of then.

    Args:
        body: The body that was recorded.
        path: The recording, made by ``ohmskin patches --record``.

    Attributes:
        ended: Whether all has been shown.

    Raises:
        DataError: If it cannot be read, or is none of this body.
        PublishError: If a board's name is taken.
    """

    def __init__(self, body: Body, path: str | Path) -> None:
        self._body, self._path, self._began, self.ended = body, Path(path), time.monotonic(), False
        own = {placed.patch.name: f"{body.name}.{placed.patch.name}" for placed in body.patches}
        self._contacts, self._joints = f"{prefix(body.name)}/contacts", f"{prefix(body.name)}/joint_states"
        self._images = {f"{prefix(board)}/image": name for name, board in own.items()}
        self._seen = dict.fromkeys(own, 0)
        with ExitStack() as stack:
            self._messages = self._read(stack.enter_context(Container(path)))
            if (first := next(self._messages, None)) is None:
                raise DataError(
                    f"{path} has no messages of a body named {body.name!r}; record one: ohmskin patches --record"
                )
            self._next: tuple[str, int, bytes] | None = first
            self._start = first[1]
            self._publishers = {
                placed.patch.name: stack.enter_context(Publisher(placed.skin, (), own[placed.patch.name], placed.patch))
                for placed in body.patches
            }
            joints = () if body.robot is None else body.robot.independent
            self._follower = None
            if joints:
                self._follower = JointMerger(stack.enter_context(JointStates(body.name)), joints)
            self._stack = stack.pop_all()

    def step(self) -> None:
        """Show what is due by now."""
        while self._next is not None and self._next[1] - self._start <= (time.monotonic() - self._began) * 1e9:
            self._show(*self._next)
            self._next = next(self._messages, None)
        self.ended = self._next is None

    def close(self) -> None:
        """Let go of the file and the boards. Safe to call twice."""
        self._stack.close()

    def _read(self, file: Container) -> Iterator[tuple[str, int, bytes]]:
        topics = {self._contacts, self._joints, *self._images}
        for topic, _, message in file.messages():
            if topic in topics:
                yield topic, message.log_time, message.data

    def _show(self, topic: str, at: int, data: bytes) -> None:
        try:
            if topic == self._contacts:
                self._show_contacts(at, data)
            elif topic in self._images:
                name = self._images[topic]
                self._publishers[name].show(decode_image(data), self._seen[name], time.time_ns())
            elif self._follower is not None:
                self._follower.take(data, time.time() - at * 1e-9)
        except DataError as error:
            log.warning("a message of %s at %s is skipped: %s", topic, self._path, error)

    def _show_contacts(self, at: int, data: bytes) -> None:
        """Publish the contacts of each patch that had new ones; times as long ago as they were then."""
        merged = decode_contacts(data, time.monotonic() - at * 1e-9)
        for seen in merged.patches:
            if (publisher := self._publishers.get(seen.patch)) is None or publisher.patch.frame != seen.frame:
                raise DataError(f"patch {seen.patch!r} on {seen.frame!r} does not belong to body {self._body.name!r}")
            if seen.sequence in (0, self._seen[seen.patch]):
                continue
            self._seen[seen.patch] = seen.sequence
            now = replace(seen, stamp=time.time_ns() - round((time.monotonic() - seen.time) * 1e9))
            own = tuple(contact for contact in merged.contacts if contact.patch == seen.patch)
            publisher.repeat(now, own)
