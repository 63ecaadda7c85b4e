"""The page that shows all patches of a robot at once: small maps on a grid.

It reads the boards itself, so nothing waits for it.
"""

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from starlette.websockets import WebSocket, WebSocketDisconnect

from ohmskin.child import when_input_ends
from ohmskin.client.board import BoardReader
from ohmskin.client.felt import Contact, Felt, SharedMemory
from ohmskin.closing import Closing
from ohmskin.errors import PublishError
from ohmskin.outlets.picture import Picture
from ohmskin.view.live import check_address, start_page
from ohmskin.view.server import run, serve_page
from ohmskin.view.wire import pack_frame

_FRAMES_PER_SECOND = 12
_LARGEST_ANSWER = 16  # bytes; a browser only says that it has drawn


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
        settings = {"name": name, "boards": list(boards)}
        self._child, _, self.url = start_page("ohmskin.view.overview", settings, host, port, token)

    def close(self) -> None:
        self._child.close()


class BoardsPage:
    """The newest of all boards, as browsers get it."""

    def __init__(self, name: str, boards: Sequence[str]) -> None:
        self._name, self._names = name, list(boards)
        self._merged = SharedMemory(name)
        self._pictures = [BoardReader(f"{board}.image") for board in boards]
        self._images: list[tuple[dict[str, Any], NDArray]] = [({}, np.zeros(0))] * len(self._names)
        self._pictures_of: list[Picture | None] = [None] * len(self._names)
        self._felt: Felt | None = None

    def frame(self) -> bytes:
        """Length of a JSON text, the text, and each patch's pixels as signed bytes (127ths of its `peak`)."""
        patches, pixels = [], []
        with contextlib.suppress(PublishError):  # a board of another version: shown as silent
            self._felt = self._merged.newest() or self._felt
        for number, name in enumerate(self._names):
            (about, image), title = self._image(number), name.rpartition(".")[2]
            shown: dict[str, Any] = {"name": title, "link": "", "age": None, "mode": "", "contacts": []}
            if self._felt is not None and number < len(self._merged.patches):
                patch, seen = self._merged.patches[number], self._felt.patches[number]
                shown |= {"name": patch.name, "link": patch.frame, "mode": seen.mode}
                shown["age"] = seen.age if seen.sequence else None
                own = [contact for contact in self._felt.contacts if contact.patch == patch.name]
                if (picture := self._pictures_of[number]) is not None:
                    shown["contacts"] = [_shown(one, *picture.place(one.position, about["raster"])) for one in own]
            patches.append(shown | about)
            pixels.append(image)
        return pack_frame({"name": self._name, "patches": patches}, *pixels, dtype="i1")

    def _image(self, number: int) -> tuple[dict[str, Any], NDArray]:
        """What is known of a patch's shape and image, and its pixels."""
        reader = self._pictures[number]
        if (content := reader.newest()) is not None:
            with contextlib.suppress(PublishError):  # it does not fit its setup: the one before stays
                self._pictures_of[number] = picture = Picture.unpack(content, reader.setup)
                values = np.nan_to_num(picture.pixels)
                peak = float(np.abs(values).max(initial=0.0))
                about = {"domain": reader.setup["domain"], "raster": reader.setup["raster"], "peak": peak}
                about["size"] = values.size
                self._images[number] = about, np.round(values * (127 / peak if peak else 0.0))
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


def _shown(contact: Contact, x: float, y: float) -> dict[str, Any]:
    """A contact on its skin's map and in its link's frame."""
    told = {name: getattr(contact, name) for name in ("id", "extent", "strength", "confidence")}
    return {**told, "x": x, "y": y, "in": contact.position}


async def serve(settings: dict[str, Any], tell: Callable[..., None]) -> None:
    """Serve until standard input ends."""
    page = BoardsPage(settings["name"], settings["boards"])
    await serve_page("overview.html", page.converse, _LARGEST_ANSWER, settings, tell, when_input_ends)


if __name__ == "__main__":
    run(serve)
