"""The page that shows all patches of a robot at once: small maps on a grid.

It reads the boards itself, so nothing waits for it.
"""

import asyncio
import contextlib
import struct
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from ohmskin.child import Child, when_input_ends
from ohmskin.client.board import BoardReader
from ohmskin.client.felt import Contact, Felt, Patch, SharedMemory
from ohmskin.closing import Closing
from ohmskin.errors import PublishError, ViewError
from ohmskin.outlets.picture import Picture
from ohmskin.view.live import check_address, page_url
from ohmskin.view.server import build_app, listen, make_server, run
from ohmskin.view.wire import to_json

_FRAMES_PER_SECOND = 12
_LARGEST_ANSWER = 16  # bytes; a browser only says that it has drawn
_START_TIMEOUT = 30.0
_LENGTH = struct.Struct("<I")


class Overview(Closing):
    """The page, served by a process of its own.

    Args:
        name: Board with the contacts of all patches.
        boards: The boards of the patches, in the same order.
        host, port, token: As for `LiveView`.

    Attributes:
        url: Where the page is.

    Raises:
        ViewError: If no port is free, or the host is not loopback and there is no token.
    """

    def __init__(
        self, name: str, boards: Sequence[str], host: str = "127.0.0.1", port: int = 8000, token: str | None = None
    ) -> None:
        check_address(host, port, token)
        settings = {"name": name, "boards": list(boards), "host": host, "port": port, "token": token}
        self._child = Child.module("ohmskin.view.overview", "the page's process", settings)
        answer = self._child.ready(_START_TIMEOUT, lambda why: ViewError(f"the page cannot start: {why}"))
        self.url = page_url(host, answer["port"], token)

    def close(self) -> None:
        """End the page's process. Safe twice."""
        self._child.close()


class BoardsPage:
    """The newest of all boards, as browsers get it."""

    def __init__(self, name: str, boards: Sequence[str]) -> None:
        self._name, self._names = name, list(boards)
        self._merged = SharedMemory(name)
        self._readers = [BoardReader(board) for board in boards]
        self._pictures = [BoardReader(f"{board}.image") for board in boards]
        self._images: list[tuple[dict[str, Any], bytes]] = [({}, b"")] * len(self._names)
        self._felt: Felt | None = None

    def frame(self) -> bytes:
        """Length of a JSON text, the text, and each patch's pixels as signed bytes (127ths of its `peak`)."""
        patches, pixels = [], []
        with contextlib.suppress(PublishError):  # a board of another version: shown as silent
            self._felt = self._merged.newest() or self._felt
        for number, name in enumerate(self._names):
            about, image = self._image(number)
            shown: dict[str, Any] = {
                "name": name.rpartition(".")[2],
                "link": "",
                "age": None,
                "mode": "",
                "contacts": [],
            }
            if self._felt is not None and number < len(self._merged.patches):
                patch, seen = self._merged.patches[number], self._felt.patches[number]
                shown |= {"name": patch.name, "link": patch.frame, "mode": seen.mode}
                shown["age"] = seen.age if seen.sequence else None
                shown["contacts"] = [_shown(c, patch) for c in self._felt.contacts if c.patch == patch.name]
            shown |= about
            patches.append(shown)
            pixels.append(image)
        text = to_json({"name": self._name, "patches": patches}).encode()
        return b"".join([_LENGTH.pack(len(text)), text, *pixels])

    def _image(self, number: int) -> tuple[dict[str, Any], bytes]:
        """What is known of a patch's shape and image, and its pixels."""
        reader = self._pictures[number]
        if (content := reader.newest()) is not None:
            with contextlib.suppress(PublishError):  # it does not fit its setup: the one before stays
                values = np.nan_to_num(Picture.unpack(content, reader.setup).pixels)
                peak = float(np.abs(values).max(initial=0.0))
                codes = np.round(values * (127 / peak if peak else 0.0)).astype(np.int8)
                about = {"domain": reader.setup["domain"], "raster": reader.setup["raster"], "peak": peak}
                self._images[number] = (about | {"size": codes.size}, codes.tobytes())
        return self._images[number]

    async def converse(self, channel: WebSocket) -> None:
        """A frame for each word of the browser, and no sooner than is due: one that does not read gets none."""
        await channel.accept()
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                began = time.monotonic()
                await channel.send_bytes(self.frame())
                await channel.receive_text()
                await asyncio.sleep(max(0.0, began + 1 / _FRAMES_PER_SECOND - time.monotonic()))


def _shown(contact: Contact, patch: Patch) -> dict[str, Any]:
    """A contact on its sheet and in its link's frame."""
    places = {"at": patch.flat(contact.position), "in": contact.position}
    return {"id": contact.id, **places, "extent": contact.extent, "strength": contact.strength}


async def serve(settings: dict[str, Any], tell: Callable[..., None]) -> None:
    """Serve until standard input ends."""
    listener = listen(settings["host"], settings["port"])
    page = BoardsPage(settings["name"], settings["boards"])
    app = build_app("overview.html", page.converse, settings["host"], settings["token"])
    server = make_server(app, _LARGEST_ANSWER)
    when_input_ends(lambda: setattr(server, "should_exit", True))
    tell(port=listener.getsockname()[1])
    await server.serve(sockets=[listener])


if __name__ == "__main__":
    run(serve)
