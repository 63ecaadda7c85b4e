"""Ways for bytes to reach a device: TCP and serial ports, pseudo-terminals included."""

import contextlib
import errno
import socket
import time
from typing import Protocol
from urllib.parse import parse_qsl, urlsplit

import serial
import serial.tools.list_ports

from ohmskin.errors import DeviceError, DeviceLost

_CHUNK = 65536
_CONNECT_TIMEOUT = 3.0
_WRITE_TIMEOUT = 2.0
_POLL = 0.02  # pyserial waits in steps of this, because changing its timeout reconfigures the port
_BAUD = 921600
_MOST_BAUD = 100_000_000


class Transport(Protocol):
    """A stream of bytes. Every failure is a DeviceLost."""

    @property
    def byte_time(self) -> float:
        """How long one byte takes on the line (s)."""

    def read(self, timeout: float) -> bytes:
        """What has arrived, as soon as anything has; nothing after `timeout` seconds."""

    def write(self, data: bytes) -> None:
        """Send all of `data`."""

    def close(self) -> None:
        """Let go of the line. Safe to call twice."""


def open_transport(url: str) -> Transport:
    """Open `tcp://host:port`, `serial:///dev/ttyACM0?baud=921600` or `serial://COM3`.

    Raises:
        DeviceError: If the address cannot be read.
        DeviceLost: If nothing answers there.
    """
    try:
        parts = urlsplit(url)
    except ValueError as error:
        raise DeviceError(f"{url!r}: {error}; need such as tcp://127.0.0.1:7155 or serial:///dev/ttyACM0") from error
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    allowed: dict[str, set[str]] = {"tcp": set(), "serial": {"baud"}}
    if parts.scheme not in allowed:
        raise DeviceError(f"no transport {parts.scheme!r} in {url!r}; choose one of {', '.join(allowed)}")
    if unknown := options.keys() - allowed[parts.scheme]:
        takes = ", ".join(allowed[parts.scheme]) or "none"
        raise DeviceError(f"{url!r} has the option {min(unknown)!r}; {parts.scheme} takes {takes}")
    if parts.scheme == "tcp":
        try:
            host, port = parts.hostname, parts.port
        except ValueError:  # no number, or too large a one
            host = port = None
        if not host or not port:
            needed = "a port of 1 to 65535, such as tcp://127.0.0.1:7155, or tcp://[::1]:7155 for an IPv6 address"
            raise DeviceError(f"{url!r} has no host and port; need tcp://HOST:PORT with {needed}")
        if more := parts.path.strip("/") or parts.username or parts.fragment:
            raise DeviceError(f"{url!r} has {more!r} beside host and port; leave it out, as in tcp://127.0.0.1:7155")
        return SocketTransport.connect(host, port)
    baud = options.get("baud", str(_BAUD))
    if not (baud.isascii() and baud.isdigit() and len(baud) < 10 and 0 < int(baud) <= _MOST_BAUD):
        raise DeviceError(f"{url!r}: baud is {baud!r}; need a number of 1 to {_MOST_BAUD} such as {_BAUD}")
    port_name = parts.netloc + parts.path
    if not port_name:
        raise DeviceError(f"{url!r} names no port; need serial:///dev/ttyACM0 or serial://COM3; {_ports()}")
    return SerialTransport(port_name, int(baud))


def place_of(host: str, port: int) -> str:
    """``HOST:PORT`` as addresses have it, with brackets round an IPv6 address."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


class SocketTransport:
    """A connected TCP socket, at either end.

    Args:
        connected: The socket, owned from now on.
        peer: What to call the other side in errors.
    """

    byte_time = 0.0

    def __init__(self, connected: socket.socket, peer: str) -> None:
        self._socket = connected
        self._peer = peer
        # Without this, request and reply wait for each other's delayed acknowledgement: 40 ms instead of 0.05.
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    @classmethod
    def connect(cls, host: str, port: int) -> "SocketTransport":
        """Connect to a listening device.

        Raises:
            DeviceLost: If nothing accepts the connection within 3 s.
        """
        place = place_of(host, port)
        try:
            return cls(socket.create_connection((host, port), _CONNECT_TIMEOUT), f"tcp://{place}")
        except (OSError, UnicodeError) as error:  # the second one at a name that cannot be one, such as "a..b"
            why = f"cannot reach {place}: {error}; check the address and the network"
            if isinstance(error, ConnectionRefusedError):
                why = f"no device at {place}; is `ohmskin serve-skin` running there?"
            elif isinstance(error, TimeoutError):
                why = f"{place} did not answer within {_CONNECT_TIMEOUT:g} s; check address and firewall"
            raise DeviceLost(why) from error

    def read(self, timeout: float) -> bytes:
        try:
            self._socket.settimeout(max(timeout, 1e-4))
            data = self._socket.recv(_CHUNK)
        except TimeoutError:
            return b""
        except OSError as error:
            raise DeviceLost(f"connection to {self._peer} lost ({error.strerror or error})") from error
        if not data:
            raise DeviceLost(f"{self._peer} closed the connection")
        return data

    def write(self, data: bytes) -> None:
        try:
            self._socket.settimeout(_WRITE_TIMEOUT)
            self._socket.sendall(data)
        except OSError as error:
            raise DeviceLost(f"cannot send {len(data)} bytes to {self._peer}: {error.strerror or error}") from error

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes a thread that reads
        self._socket.close()


class SerialTransport:
    """A serial port or pseudo-terminal: raw, 8N1, not shared with another program.

    Raises:
        DeviceLost: If the port cannot be opened.
    """

    def __init__(self, port: str, baud: int = _BAUD) -> None:
        self.byte_time = 10 / baud  # start bit, 8 data bits, stop bit
        try:
            self._serial = serial.Serial(port, baud, timeout=_POLL, write_timeout=_WRITE_TIMEOUT, exclusive=True)
        except (OSError, ValueError) as error:
            raise DeviceLost(f"cannot open serial port {port}: {_reason(error)}") from error

    def read(self, timeout: float) -> bytes:
        end = time.monotonic() + timeout
        try:
            while True:
                waiting = self._serial.in_waiting
                data: bytes = self._serial.read(min(waiting, _CHUNK) or 1)
                if data and not waiting:
                    data += self._serial.read(min(self._serial.in_waiting, _CHUNK))
                if data or time.monotonic() >= end:
                    return data
        except (OSError, TypeError) as error:  # pyserial raises TypeError on a port closed meanwhile
            raise DeviceLost(f"serial port {self._serial.port} is disconnected: {error}; plug it in again") from error

    def write(self, data: bytes) -> None:
        try:
            self._serial.write(data)
        except (OSError, TypeError) as error:
            raise DeviceLost(f"cannot send {len(data)} bytes on {self._serial.port}: {error}") from error

    def close(self) -> None:
        self._serial.close()


def _reason(error: OSError | ValueError) -> str:
    join = "join the group that owns it, e.g. `sudo usermod -aG dialout $USER`, and log in again"
    told = dict.fromkeys((errno.EAGAIN, errno.EBUSY), "another program uses it; close that one first")
    told |= {errno.ENOENT: f"there is no such port; {_ports()}", errno.EACCES: f"permission denied; {join}"}
    return told.get(getattr(error, "errno", 0), f"{error}; {_ports()}")


def _ports() -> str:
    ports = sorted(port.device for port in serial.tools.list_ports.comports())
    return f"ports here: {', '.join(ports)}" if ports else "this computer has no serial port; is the device plugged in?"
