"""A web socket for Foxglove (the desktop program or its page), on this machine unless another address is given.

The protocol has no password: whoever reaches the port may look, but there is nothing that could be changed through it.
"""

import re
from collections.abc import Sequence

import foxglove

from ohmskin.errors import PublishError
from ohmskin.outlets.topics import Topic

PORT = 8765
_BACKLOG = 64  # messages kept for a viewer that is slow; then the oldest go


class FoxgloveOutlet:
    """See `ohmskin.outlets.outlet.Outlet`.

    Args:
        place: ``HOST:PORT``; 127.0.0.1:8765 unless given, port 0 for any free one.
        topics, node: See `open_outlet`.
        token: Not used: the protocol knows no such thing.

    Raises:
        PublishError: If the place cannot be used.
    """

    def __init__(self, place: str, topics: Sequence[Topic], node: str, token: str | None) -> None:
        found = re.fullmatch(r"(\[.*\]|[^:]*):?(\d*)", place)
        assert found is not None
        host, port = found[1].strip("[]") or "127.0.0.1", int(found[2] or PORT)
        context = self._context = foxglove.Context()  # its channels close when it goes
        self._channels = {
            topic: foxglove.Channel(
                topic.name,
                schema=foxglove.Schema(name=topic.type, encoding="ros2msg", data=topic.definition.encode()),
                message_encoding="cdr",
                context=context,
            )
            for topic in topics
        }
        try:
            self._server = foxglove.start_server(
                name=node, host=host, port=port, capabilities=[], context=context, message_backlog_size=_BACKLOG
            )
        except (RuntimeError, OSError, ValueError) as error:
            raise PublishError(f"Foxglove cannot be served at {host}:{port}: {error}; try foxglove:{host}:0") from error
        self.address = f"ws://{f'[{host}]' if ':' in host else host}:{self._server.port}"

    def send(self, topic: Topic, stamp: int, data: bytes) -> None:
        """Publish one CDR message."""
        self._channels[topic].log(data, log_time=stamp)

    def close(self) -> None:
        """Hang up."""
        self._server.stop()
