"""A pseudo-terminal: a serial port made of software, seen from the device's side. Unix only."""

import contextlib
import os
import select
import time

from ohmskin.errors import DeviceError, DeviceLost

_WRITE_TIMEOUT = 1.0
_POLL = 0.02
_CHUNK = 65536


class PseudoTerminal:
    """The device's end, a `Transport`; hosts open, close and reopen `path` as if it were a serial port.

    Raises:
        DeviceError: If this system has no pseudo-terminals.
    """

    byte_time = 0.0

    def __init__(self) -> None:
        if not hasattr(os, "openpty"):
            raise DeviceError("this system has no pseudo-terminals; serve over TCP instead")
        self._master, host_end = os.openpty()
        self.path = os.ttyname(host_end)
        os.close(host_end)  # open in no one's hands until a host comes; the kernel tells us when the last one goes
        os.set_blocking(self._master, False)
        self._closed = False
        self._reset()

    def wait_for_host(self, timeout: float) -> bool:
        """Whether a host has the port open, after at most `timeout` seconds."""
        end = time.monotonic() + timeout
        while self._poll(select.POLLIN, 0.0) & select.POLLHUP:
            if time.monotonic() >= end:
                return False
            time.sleep(_POLL)  # a hang-up is reported at once, so waiting in poll is not possible
        return True

    def read(self, timeout: float) -> bytes:
        events = self._poll(select.POLLIN, timeout)
        if events & select.POLLHUP:
            self._reset()
            raise DeviceLost(f"the host has closed {self.path}")
        try:
            return os.read(self._master, _CHUNK) if events else b""
        except BlockingIOError:
            return b""
        except OSError as error:
            raise DeviceLost(f"the host has closed {self.path}: {error}") from error

    def write(self, data: bytes) -> None:
        """Send all of `data`; what a host does not take within a second is dropped."""
        left = memoryview(data)
        while left and self._poll(select.POLLOUT, _WRITE_TIMEOUT) & select.POLLOUT:
            try:
                left = left[os.write(self._master, left) :]
            except BlockingIOError:
                continue
            except OSError as error:
                raise DeviceLost(f"the host has closed {self.path}: {error}") from error

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            os.close(self._master)

    def _poll(self, events: int, timeout: float) -> int:
        poll = select.poll()
        poll.register(self._master, events)
        ready = poll.poll(timeout * 1000)
        return ready[0][1] if ready else 0

    def _reset(self) -> None:
        """Make the port raw, as the kernel undoes that when the last host goes, and drop what one has left unread."""
        import termios
        import tty

        with contextlib.suppress(termios.error, OSError):
            tty.setraw(self._master)
            termios.tcflush(self._master, termios.TCIOFLUSH)
