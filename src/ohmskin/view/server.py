"""The page's own process: serves the page, passes frames to browsers and their commands to the loop.

It reads messages from standard input and writes one JSON object per line to standard output (the other side is
`ohmskin.view.live`), and it ends when its standard input does, be it that the loop closed it or that the loop died.
"""

import asyncio
import contextlib
import errno
import hmac
import json
import mimetypes
import os
import re
import socket
import threading
from collections.abc import Awaitable, Callable, Coroutine, Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from ohmskin.child import begin
from ohmskin.view.wire import LARGEST_COMMAND, CommandError, read_command, read_message, to_json

_STATIC = Path(__file__).parent / "static"
_PORTS = 21
_MOST_PRESSES = 32
_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-cache",
}


@dataclass(eq=False)
class Browser:
    """One open page: what it was sent, whether it is ready for more, which presses it holds."""

    name: str
    channel: WebSocket
    wake: asyncio.Event = field(default_factory=asyncio.Event)
    awaited: int | None = None  # sequence of the frame that it is drawing
    seen: int = 0
    sent: str = ""  # of the loop's start, or the setup
    held: set[str] = field(default_factory=set)
    refusals: list[str] = field(default_factory=list)


class Page:
    """Passes the newest frame to each browser that is ready for one, and their commands to `send`."""

    def __init__(self, send: Callable[..., None]) -> None:
        self._setup: dict[str, Any] | None = None
        self._starting = to_json({"type": "starting", "message": "starting", "share": None})
        self._send = send
        self._browsers: list[Browser] = []
        self._frame = b""
        self._sequence = 0
        self._arrived = 0  # frames so far; a browser that has seen fewer has something to draw
        self._asked = False
        self._names = 0

    def take(self, kind: bytes, message: bytes) -> None:
        """A message of the loop: how far its start is, the setup, or a frame."""
        if kind == b"W":
            self._starting = message.decode()
        elif kind == b"S":
            self._setup = json.loads(message)
        else:
            self._asked, self._frame = False, message
            length = int.from_bytes(message[:4], "little")
            self._sequence = json.loads(message[4 : 4 + length]).get("sequence", 0)
            self._arrived += 1
        for browser in self._browsers:
            browser.wake.set()

    async def converse(self, channel: WebSocket) -> None:
        """One browser, from its connection to its end."""
        await channel.accept()
        self._names += 1
        browser = Browser(f"b{self._names}", channel)
        self._browsers.append(browser)
        browser.wake.set()
        feeding = asyncio.create_task(self._feed(browser))
        try:
            while True:
                message = await channel.receive()
                if message["type"] == "websocket.disconnect":
                    break
                self._receive(browser, message.get("text"))
        finally:
            feeding.cancel()
            self._browsers.remove(browser)
            for press in sorted(browser.held):
                self._send(command={"type": "lift", "id": press})

    async def _feed(self, browser: Browser) -> None:
        # The only place that sends: a browser that does not read holds up nothing but this task.
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                await browser.wake.wait()
                browser.wake.clear()
                if browser.sent != (news := self._status(browser)):
                    browser.sent = news
                    await browser.channel.send_text(news)
                if self._setup is None:
                    continue
                while browser.refusals:
                    await browser.channel.send_text(to_json({"type": "refused", "message": browser.refusals.pop(0)}))
                if browser.awaited is None and browser.seen < self._arrived and self._frame:
                    browser.seen, browser.awaited = self._arrived, self._sequence
                    await browser.channel.send_bytes(self._frame)
                self._ask()

    def _status(self, browser: Browser) -> str:
        """What there is to show, once the loop has said so; until then, how far it is."""
        return to_json(self._setup | {"type": "setup", "client": browser.name}) if self._setup else self._starting

    def _ask(self) -> None:
        waiting = any(b.awaited is None and (b.seen == self._arrived or not self._frame) for b in self._browsers)
        if waiting and not self._asked:
            self._asked = True
            self._send(credit=1)

    def _receive(self, browser: Browser, text: str | None) -> None:
        try:
            if text is None:
                raise CommandError("commands are text, not binary")
            if self._setup is None:
                raise CommandError("the loop is starting; wait until it is ready")
            command = read_command(text, self._setup)
            if command["type"] == "ack":
                if command["sequence"] == browser.awaited:
                    browser.awaited = None
                    browser.wake.set()
                return
            self._note_press(browser, command)
        except CommandError as refusal:
            if len(browser.refusals) < 8:
                browser.refusals.append(str(refusal))
            browser.wake.set()
            return
        self._send(command=command)

    def _note_press(self, browser: Browser, command: dict[str, Any]) -> None:
        if command["type"] == "lift_all":
            for other in self._browsers:
                other.held.clear()
        if "id" not in command:
            return
        command["id"] = f"{browser.name}:{command['id']}"
        if command["type"] == "lift":
            browser.held.discard(command["id"])
        elif command["id"] not in browser.held and len(browser.held) >= _MOST_PRESSES:
            raise CommandError(f"at most {_MOST_PRESSES} presses at once")
        else:
            browser.held.add(command["id"])


class Guard:
    """Lets in only who may see the page: the right Host, the same Origin, the token if there is one.

    A page of another site can make the reader's browser send requests here, also by pointing its own name at 127.0.0.1
    (DNS rebinding), but it cannot choose the Host and Origin that the browser writes.
    """

    def __init__(self, app: ASGIApp, host: str, token: str | None) -> None:
        self._app = app
        self._token = token
        # Behind a wildcard address the machine may have any name; there the token, always required, guards.
        self._names = None if host in ("", "0.0.0.0", "::") else {"127.0.0.1", "localhost", "::1", host.lower()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            return
        if (why := self._refusal(scope)) and scope["type"] == "http":
            await PlainTextResponse(why + "\n", status_code=403, headers=_HEADERS)(scope, receive, send)
            return
        if why:
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": why})  # before accept: a 403
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        await self._app(scope, receive, send_with_headers)

    def _refusal(self, scope: Scope) -> str:
        headers = Headers(scope=scope)
        host = headers.get("host", "").lower()
        name = re.fullmatch(r"(?:\[([0-9a-f:.]+)\]|([^\[\]:/@]+))(?::\d{1,5})?", host)
        if not name or (self._names is not None and (name[1] or name[2]) not in self._names):
            return "This page is served under other names. Use the address that was printed when it started."
        origin = headers.get("origin")
        ours = origin is None or origin.lower() in (f"http://{host}", f"https://{host}")
        if scope["type"] == "websocket" and not ours:
            return "Only the page itself may open this socket."
        if self._token is not None and scope["path"] in ("/", "/socket"):
            given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
            if not hmac.compare_digest(given.encode(), self._token.encode()):
                return "A token is needed. Use the whole address that was printed when the page started."
        return ""


class Server(uvicorn.Server):
    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        yield  # Ctrl-C is the loop's: it closes this process through standard input


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens on `port` or the next free one.

    Raises:
        OSError: If the host has no address here or no port is free.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host or "0.0.0.0", None, type=socket.SOCK_STREAM)[0]
    except OSError as unknown:
        raise OSError(f"{host!r} is not an address of this machine ({unknown.strerror})") from unknown
    both = family == socket.AF_INET6 and socket.has_dualstack_ipv6()
    for candidate in [port] if port == 0 else range(port, min(port + _PORTS, 65536)):
        try:
            return socket.create_server((address[0], candidate), family=family, backlog=64, dualstack_ipv6=both)
        except OSError as refused:
            reason = os.strerror(refused.errno or 0)
            if refused.errno in (errno.EACCES, errno.EPERM):
                raise OSError(f"port {candidate} may not be used ({reason}); choose one above 1023") from refused
            if refused.errno != errno.EADDRINUSE:
                break
    raise OSError(f"cannot listen on {host} port {port} or the {_PORTS - 1} after it: {reason}")


async def serve_page(
    page: str,
    converse: Callable[[WebSocket], Awaitable[None]],
    largest: int,
    settings: dict[str, Any],
    send: Callable[..., None],
    when_over: Callable[[Callable[[], None]], None],
) -> None:
    """Serve a page of the static files, these files, and a socket, behind the guard, until it is over.

    Args:
        page: The file that is the page.
        converse: Serves the socket.
        largest: Bytes of the largest message that a browser may send.
        settings: Host, port and token.
        send: Called with the port.
        when_over: Takes what is to be called in the end, in any thread.
    """

    async def index(request: Request) -> FileResponse:
        return FileResponse(_STATIC / page)

    mimetypes.add_type("text/javascript", ".js")  # some systems' tables say otherwise, and browsers insist
    routes = [Route("/", index), WebSocketRoute("/socket", converse), Mount("/static", StaticFiles(directory=_STATIC))]
    config = uvicorn.Config(
        Guard(Starlette(routes=routes), settings["host"], settings["token"]),
        log_level="warning",
        access_log=False,
        lifespan="off",
        loop="asyncio",
        http="h11",
        proxy_headers=False,
        server_header=False,
        ws_max_size=largest,
        ws_per_message_deflate=False,  # costs more time than it saves on images of floats
        timeout_graceful_shutdown=1,
    )
    server, listener = Server(config), listen(settings["host"], settings["port"])
    when_over(lambda: setattr(server, "should_exit", True))
    send(port=listener.getsockname()[1])
    await server.serve(sockets=[listener])


async def serve(settings: dict[str, Any], send: Callable[..., None]) -> None:
    """Serve until the loop says so or standard input ends."""
    page = Page(send)
    loop = asyncio.get_running_loop()

    def listen_to_loop(end: Callable[[], None]) -> None:
        inbox = os.fdopen(os.dup(0), "rb")
        with contextlib.suppress(RuntimeError):  # the event loop has ended first
            while (message := read_message(inbox)) and message[0] != b"Q":
                loop.call_soon_threadsafe(page.take, *message)
        end()

    def start(end: Callable[[], None]) -> None:
        threading.Thread(target=listen_to_loop, args=(end,), daemon=True).start()

    await serve_page("index.html", page.converse, LARGEST_COMMAND, settings, send, start)


def run(serve: Callable[[dict[str, Any], Callable[..., None]], Coroutine[Any, Any, None]]) -> None:
    """Be the process of a page: `serve` it as the settings say, with a function that tells the parent."""
    settings, send = begin()
    try:
        asyncio.run(serve(settings, send))
    except OSError as error:
        send(failed=str(error))


if __name__ == "__main__":
    run(serve)
