"""The loop's side of the live page: newest frame out, commands in, never a wait."""

import json
import logging
import queue
import subprocess
import threading
from collections.abc import Mapping
from contextlib import suppress
from io import BufferedReader, BufferedWriter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ohmskin.child import Child
from ohmskin.client.remote import is_loopback
from ohmskin.closing import Closing
from ohmskin.errors import ViewError
from ohmskin.view.wire import check_setup, pack_frame, to_json, write_message

log = logging.getLogger(__name__)

_START_TIMEOUT = 30.0
_STOP_TIMEOUT = 3.0
_MOST_PENDING = 1000


class LiveView(Closing):
    """A page in the browser that shows the newest frame and on which a virtual skin can be pressed.

    A process of its own serves the page, so that no browser can slow the loop. That process asks for one frame at a
    time (a credit) when a browser is ready to draw; frames published without a credit are dropped.

    Args:
        setup: The skin, raster, modes and device to show (docs/live-page.md). Without it the page says that
            the loop is `starting`, until `show` is called.
        host: Address to listen on. Other machines can reach the page only through an address that is not loopback, and
            such an address needs a token.
        port: Port to listen on, or the next free one of 20 beyond it; 0 lets the system choose.
        token: If given, the page and its socket answer only to `?token=...`, which `url` contains.

    Attributes:
        url: Address of the page.
        port: The port that it listens on.
        port_was_taken: Whether `port` is not the requested one.

    Raises:
        ViewError: If the setup is malformed, no port is free, or the host is not loopback and there is no token.
    """

    def __init__(
        self,
        setup: Mapping[str, Any] | None = None,
        host: str = "127.0.0.1",
        port: int = 8000,
        token: str | None = None,
    ) -> None:
        check_address(host, port, token)
        checked = None if setup is None else check_setup(setup)
        self._shape = (0, 0)
        self._credits = 0
        self._pending: list[dict[str, Any]] = []
        self._lock = threading.Lock()  # guards _credits and _pending, held for microseconds only
        self._outbox: queue.SimpleQueue[tuple[bytes, bytes] | None] = queue.SimpleQueue()
        self._closing = False
        self._child, self.port, self.url = start_page("ohmskin.view.server", {}, host, port, token)
        self.port_was_taken = port not in (0, self.port)
        self._threads = [threading.Thread(target=target, daemon=True) for target in (self._write, self._read)]
        for thread in self._threads:
            thread.start()
        if checked is not None:
            self._show(checked)

    def starting(self, words: str, share: float | None = None) -> None:
        """Show the current step of the loop before the first frame.

        Args:
            words: The step.
            share: The share that is done (0 to 1); None: unknown.
        """
        self._outbox.put((b"W", to_json({"type": "starting", "message": words, "share": share}).encode()))

    def show(self, setup: Mapping[str, Any]) -> None:
        """Give the setup, if the constructor was not given one.

        Raises:
            ViewError: If the setup is malformed.
        """
        self._show(check_setup(setup))

    def _show(self, setup: Mapping[str, Any]) -> None:
        self._shape = (int(setup["raster"]["ny"]), int(setup["raster"]["nx"]))
        self._outbox.put((b"S", to_json(setup).encode()))

    @property
    def pid(self) -> int:
        """Number of the page's process."""
        return self._child.process.pid

    def wants_frame(self) -> bool:
        """Whether a browser waits for a frame."""
        return self._credits > 0

    def publish(self, header: Mapping[str, Any], base: NDArray, image: NDArray) -> None:
        """Show a frame if a browser is ready for it, else drop it; never waits.

        Args:
            header: Contacts, pairs, presses, health and state of this frame (docs/live-page.md).
            base: Image of the base scan (ny, nx) in the setup's unit, row 0 at the bottom, NaN off the skin.
            image: Image of the whole scan (ny, nx), likewise.

        Raises:
            ViewError: If an image does not have the raster's shape.
        """
        if self._credits == 0:
            return
        base, image = np.asarray(base), np.asarray(image)
        if base.shape != self._shape or image.shape != self._shape:
            shapes = f"images of shapes {base.shape} and {image.shape}"
            raise ViewError(f"{shapes}; the setup's raster has (ny, nx) = {self._shape}")
        with self._lock:
            self._credits = 0
        self._outbox.put((b"F", pack_frame(header, base, image)))

    def commands(self) -> list[dict[str, Any]]:
        """Commands of browsers since the last call, checked, oldest first; never waits.

        A press that was moved several times since then appears once, at its present place. Its id names browser and
        press.
        """
        with self._lock:
            commands, self._pending = self._pending, []
        return commands

    def close(self) -> None:
        """End the page's process; safe to call twice."""
        with self._lock:
            if self._closing:
                return
            self._closing = True
            self._credits = 0
        self._outbox.put((b"Q", b""))  # said, not only meant by closing the pipe, which a forked process may hold too
        self._outbox.put(None)
        with suppress(subprocess.TimeoutExpired):
            self._child.process.wait(_STOP_TIMEOUT)
        self._child.process.kill()
        for thread in self._threads:
            thread.join()
        self._child.close()

    def _write(self) -> None:
        with suppress(OSError), BufferedWriter(self._child.stdin) as stream:
            while message := self._outbox.get():  # an OSError: the process has gone, which the other thread reports
                write_message(stream, *message)

    def _read(self) -> None:
        with BufferedReader(self._child.stdout) as lines:  # type: ignore[type-var]
            for line in lines:
                message = json.loads(line)
                with self._lock:
                    if "credit" in message:
                        self._credits = 1
                    else:
                        enqueue(self._pending, message["command"])
        with self._lock:
            self._credits = 0
        if not self._closing:
            status = self._child.process.wait()
            log.error("the process of the live page has ended (exit status %s); the loop continues without it", status)
        self._outbox.put(None)


def start_page(
    module: str, settings: Mapping[str, Any], host: str, port: int, token: str | None
) -> tuple[Child, int, str]:
    """Start the process that serves a page; it, the page's port, and the page's address for a browser on this machine.

    Raises:
        ViewError: If it cannot start.
    """
    child = Child.module(module, "its process", {**settings, "host": host, "port": port, "token": token})
    found = child.ready(_START_TIMEOUT, lambda why: ViewError(f"the page cannot start: {why}"))["port"]
    shown = {"": "127.0.0.1", "0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    url = f"http://{f'[{shown}]' if ':' in shown else shown}:{found}/" + (f"?token={token}" if token else "")
    return child, found, url


def check_address(host: str, port: int, token: str | None) -> None:
    """Hold where a page is to be served against what is allowed.

    Raises:
        ViewError: If port or token cannot be used, or the host is not loopback and there is no token.
    """
    if not 0 <= port <= 65535:
        raise ViewError(f"port {port}; choose 1 to 65535, or 0 for any free port")
    if token is not None and not (token.isascii() and token.isprintable() and 8 <= len(token) <= 256):
        raise ViewError("the token must be 8 to 256 printable ASCII characters, such as secrets.token_urlsafe() gives")
    if token is None and not is_loopback(host):
        raise ViewError(
            f"host {host!r} can be reached from other machines, which could then press and switch this skin; "
            "give a token, or stay with 127.0.0.1 and forward the port (ssh -L 8000:127.0.0.1:8000 robot)"
        )


def enqueue(pending: list[dict[str, Any]], command: dict[str, Any]) -> None:
    """Append a command; a press that only moved replaces where it was, so that a busy loop finds a short list."""
    if command["type"] == "press":
        for place in range(len(pending) - 1, -1, -1):
            if pending[place]["type"] == "lift_all" or pending[place].get("id") == command["id"]:
                if pending[place]["type"] == "press":
                    pending[place] = command
                    return
                break
    if len(pending) < _MOST_PENDING or command["type"] in ("lift", "lift_all"):
        pending.append(command)
