"""The page that shows all patches of a robot at once: small maps on a grid. It reads the boards itself, so nothing waits for it."""

import asyncio
import contextlib
import json
import mimetypes
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from ohmskin.client.board import BoardReader
from ohmskin.client.felt import Felt, Patch, patches_from, unpack
from ohmskin.errors import PublishError, ViewError
from ohmskin.view.live import check_address
from ohmskin.view.server import Guard, Server, listen
from ohmskin.view.wire import to_json

_STATIC = Path(__file__).parent / "static"
_FRAMES_PER_SECOND = 12
_LARGEST_ANSWER = 16  # bytes; a browser only says that it has drawn
_START_TIMEOUT, _STOP_TIMEOUT = 30.0, 3.0
_LENGTH = struct.Struct("<I")
_PICTURE = struct.Struct("<Qq")  # what comes before the pixels on a board, see ohmskin.publish.picture


class Overview:
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
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "ohmskin.view.overview"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        settings = {"name": name, "boards": list(boards), "host": host, "port": port, "token": token}
        with contextlib.suppress(OSError):
            self._process.stdin.write(json.dumps(settings).encode() + b"\n")
            self._process.stdin.flush()
        line = self._process.stdout.readline()
        answer = json.loads(line) if line else {}
        if "port" not in answer:
            self.close()
            raise ViewError(f"the page cannot start: {answer.get('failed', 'its process ended')}")
        shown = {"": "127.0.0.1", "0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
        shown = f"[{shown}]" if ":" in shown else shown
        self.url = f"http://{shown}:{answer['port']}/" + (f"?token={token}" if token else "")

    def close(self) -> None:
        """End the page's process. Safe twice."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(_STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Gallery:
    """The newest of all boards, as browsers get it."""

    def __init__(self, name: str, boards: Sequence[str]) -> None:
        self._name, self._names = name, list(boards)
        self._merged = BoardReader(name)
        self._readers = [BoardReader(board) for board in boards]
        self._pictures = [BoardReader(f"{board}.image") for board in boards]
        self._images: list[tuple[dict[str, Any], bytes]] = [({}, b"")] * len(self._names)
        self._patches: tuple[Patch, ...] = ()
        self._felt: Felt | None = None

    def frame(self) -> bytes:
        """Length of a JSON text, the text, and for each patch its pixels as signed bytes (shares of its `peak` in 127ths)."""
        patches, pixels = [], []
        with contextlib.suppress(PublishError):  # a board of another version: shown as silent
            if (record := self._merged.newest()) is not None:
                self._patches = patches_from(self._merged.setup)
                self._felt = unpack(record, self._patches, self._merged.boot)
        for number, name in enumerate(self._names):
            about, image = self._image(number)
            shown: dict[str, Any] = {"name": name.rpartition(".")[2], "link": "", "age": None, "mode": "", "contacts": [], **about}
            if self._felt is not None and number < len(self._patches):
                patch, seen = self._patches[number], self._felt.patches[number]
                shown |= {"name": patch.name, "link": patch.frame, "age": seen.age if seen.sequence else None, "mode": seen.mode}
                shown["contacts"] = [
                    {"id": c.id, "at": patch.flat(c.position), "in": c.position, "extent": c.extent, "strength": c.strength}
                    for c in self._felt.contacts
                    if c.patch == patch.name
                ]
            patches.append(shown)
            pixels.append(image)
        text = to_json({"name": self._name, "patches": patches}).encode()
        return b"".join([_LENGTH.pack(len(text)), text, *pixels])

    def _image(self, number: int) -> tuple[dict[str, Any], bytes]:
        """What is known of a patch's shape and image, and its pixels."""
        reader = self._pictures[number]
        if (content := reader.newest()) is not None:
            setup = reader.setup
            nx, ny = int(setup["raster"]["nx"]), int(setup["raster"]["ny"])
            values = np.nan_to_num(np.frombuffer(content, "<f4", offset=_PICTURE.size))
            peak = float(np.abs(values).max(initial=0.0))
            codes = np.round(values * (127 / peak if peak else 0.0)).astype(np.int8)
            about = {"domain": setup["domain"], "raster": setup["raster"], "peak": peak, "size": nx * ny}
            self._images[number] = (about, codes.tobytes() if codes.size == nx * ny else bytes(nx * ny))
        return self._images[number]


def build_app(gallery: Gallery, host: str, token: str | None) -> ASGIApp:
    """The page, its files and its socket behind the guard of the live page."""

    async def index(request: Request) -> FileResponse:
        return FileResponse(_STATIC / "overview.html")

    async def show(channel: WebSocket) -> None:
        """A frame for each word of the browser, and no sooner than is due: one that does not read gets none."""
        await channel.accept()
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                began = time.monotonic()
                await channel.send_bytes(gallery.frame())
                await channel.receive_text()
                await asyncio.sleep(max(0.0, began + 1 / _FRAMES_PER_SECOND - time.monotonic()))

    mimetypes.add_type("text/javascript", ".js")
    routes = [Route("/", index), WebSocketRoute("/socket", show), Mount("/static", StaticFiles(directory=_STATIC))]
    return Guard(Starlette(routes=routes), host, token)


async def serve(settings: dict[str, Any]) -> None:
    """Serve until standard input ends."""
    listener = listen(settings["host"], settings["port"])
    app = build_app(Gallery(settings["name"], settings["boards"]), settings["host"], settings["token"])
    server = Server(
        uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            lifespan="off",
            loop="asyncio",
            http="h11",
            proxy_headers=False,
            server_header=False,
            ws_max_size=_LARGEST_ANSWER,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
        )
    )

    def end_with_input() -> None:
        sys.stdin.buffer.read()
        server.should_exit = True

    threading.Thread(target=end_with_input, daemon=True).start()
    print(json.dumps({"port": listener.getsockname()[1]}), flush=True)
    await server.serve(sockets=[listener])


def main() -> None:
    """Run the page's process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        asyncio.run(serve(json.loads(sys.stdin.buffer.readline())))
    except OSError as error:
        print(json.dumps({"failed": str(error)}), flush=True)


if __name__ == "__main__":
    main()
