"""A recording of what is published: an MCAP file with the very messages, as Foxglove and ROS 2 tools read it."""

import logging
import time
from collections.abc import Sequence

from ohmskin.errors import PublishError
from ohmskin.mcap.writer import Disk, open_writer
from ohmskin.outlets.topics import Topic

log = logging.getLogger(__name__)

_CHUNK = 64 * 1024  # bytes: what a crash may cost, a tenth of a second of eight skins


class FileOutlet:
    """See `ohmskin.outlets.outlet.Outlet`.

    Args:
        place: The file, which must not be there yet.
        topics, node: See `open_outlet`.
        token: Not used.

    Raises:
        PublishError: If the file cannot be made.
    """

    def __init__(self, place: str, topics: Sequence[Topic], node: str, token: str | None) -> None:
        self.address = f"mcap:{place}"
        try:
            self._disk = Disk(place)
        except OSError as error:
            raise PublishError(f"cannot record to {place}: {error.strerror or error}; choose another file") from error
        self._writer = open_writer(self._disk, _CHUNK)
        self._writer.start("ros2", library=node)
        self._channels, self._count, self._lost = {}, 0, 0
        for topic in topics:
            schema = self._writer.register_schema(topic.type, "ros2msg", topic.definition.encode())
            self._channels[topic] = self._writer.register_channel(topic.name, "cdr", schema)

    def send(self, topic: Topic, stamp: int, data: bytes) -> None:
        """Record one CDR message; while the disk takes none and much is waiting, it is given up."""
        self._disk.commit()
        if self._disk.full:
            self._lost += 1
            if self._lost == 1:
                log.warning("%s cannot be written (%s); messages are lost", self.address, self._disk.trouble)
            return
        self._count += 1
        self._writer.add_message(self._channels[topic], time.time_ns(), data, stamp, self._count)

    def close(self) -> None:
        """Finish the file. Safe to call twice."""
        if self._channels:
            self._channels.clear()
            self._writer.finish()
            self._disk.commit(now=True)
            self._disk.close()
            if self._lost or self._disk.trouble:
                log.warning("%s lacks %d messages: %s", self.address, self._lost, self._disk.trouble or "disk full")
