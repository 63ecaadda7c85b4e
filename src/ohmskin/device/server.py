"""Serves an instrument to hosts over TCP and over a pseudo-terminal."""

import errno
import logging
import socket
import threading
from collections.abc import Callable
from contextlib import closing
from typing import Self

from ohmskin.closing import Closing
from ohmskin.device.instrument import Instrument, SharedInstrument
from ohmskin.device.session import Session
from ohmskin.device.terminal import PseudoTerminal
from ohmskin.device.transport import SocketTransport, Transport, place_of
from ohmskin.errors import DeviceError, DeviceLost

_LOG = logging.getLogger(__name__)
_POLL = 0.05  # s, how soon threads notice that the server closes; replies do not wait for it


class DeviceServer(Closing):
    """Serves an instrument over the wire protocol.

    Args:
        instrument: The instrument to scan, by one request at a time.
        host: Address to listen on; "0.0.0.0" lets other machines connect. There is no password.
        port: TCP port; 0 chooses a free one.
        pty: Whether to offer a pseudo-terminal, too.

    Raises:
        DeviceError: If the port is in use, the address is not this machine's, or the system has no pseudo-terminals.
    """

    def __init__(self, instrument: Instrument, host: str = "127.0.0.1", port: int = 7155, pty: bool = False) -> None:
        self._instrument = SharedInstrument(instrument)
        self._listener = listen(host, port)
        self._terminal = PseudoTerminal() if pty else None
        self._stop = threading.Event()
        self._threads: set[threading.Thread] = set()
        self.url = f"tcp://{place_of(host, self._listener.getsockname()[1])}"

    @property
    def pty_path(self) -> str | None:
        """The path of the pseudo-terminal, for ``serial://`` addresses; None if there is none."""
        return self._terminal.path if self._terminal else None

    def start(self) -> None:
        """Answer in the background. Connections made before this call have waited."""
        if self._terminal:
            self._spawn(self._serve_terminal, self._terminal)
        self._spawn(self._accept)  # last: from now on it alone starts threads

    def close(self) -> None:
        """Close all connections, lift their presses and free the port. Safe to call twice."""
        self._stop.set()
        while alive := [thread for thread in self._threads if thread.is_alive()]:  # the accepting one may start another
            for thread in alive:
                thread.join()
        self._listener.close()
        if self._terminal:
            self._terminal.close()

    def __enter__(self) -> Self:
        self.start()
        return self

    def _spawn(self, work: Callable[..., None], *args: object) -> None:
        new = threading.Thread(target=work, args=args, daemon=True, name=f"{self.url} {work.__name__}")
        # a new set: `close` may be looking at the old one
        self._threads = {new, *(thread for thread in self._threads if thread.is_alive())}
        new.start()

    def _accept(self) -> None:
        self._listener.settimeout(_POLL)
        while not self._stop.is_set():
            try:
                connected, (host, port, *_) = self._listener.accept()
                line = SocketTransport(connected, f"tcp://{place_of(host, port)}")
            except TimeoutError:
                continue
            except OSError as error:  # too many open files, or a host that was gone before it was greeted
                _LOG.warning("a connection failed: %s", error)
                self._stop.wait(_POLL)
                continue
            self._spawn(self._serve_socket, line)

    def _serve_socket(self, transport: SocketTransport) -> None:
        with closing(transport):
            self._converse(transport)

    def _serve_terminal(self, terminal: PseudoTerminal) -> None:
        while not self._stop.is_set():
            if terminal.wait_for_host(_POLL):
                self._converse(terminal)

    def _converse(self, line: Transport) -> None:
        """Answer one host until it hangs up."""
        session = Session(self._instrument)
        try:
            while not self._stop.is_set():
                if (data := line.read(_POLL)) and (replies := session.feed(data)):
                    line.write(replies)
        except DeviceLost as gone:
            _LOG.info("%s", gone)
        finally:
            session.end()


def listen(host: str, port: int) -> socket.socket:
    """A listening TCP socket; port 0 chooses a free one.

    Raises:
        DeviceError: If the port is in use or the address is not this machine's.
    """
    if not 0 <= port <= 65535:
        raise DeviceError(f"port {port}; it must be 1..65535, or 0 for any free one")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)  # on Unix it reuses the address of one just closed
    except OSError as error:
        why = f"cannot listen on {place_of(host, port)}: {error}; use 127.0.0.1, or 0.0.0.0 for all"
        if error.errno == errno.EADDRINUSE:
            why = f"port {port} on {host} is in use; stop the other server, or choose another port"
        raise DeviceError(why) from error
