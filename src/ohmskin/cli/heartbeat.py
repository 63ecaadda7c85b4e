"""Signs of life of a command: while it is imported, starts, calibrates and computes; and its end at Ctrl-C."""

import signal
import sys
import time
from contextlib import suppress
from threading import Event, RLock, Thread, Timer, get_ident
from typing import Any, Self, TextIO, cast

_EVERY = 2.0  # s
_AGAIN = 0.05  # s, until an interrupt that was swallowed is raised again


class _TimedStream:
    """A stream, and when something was last written to it."""

    def __init__(self, stream: TextIO, life: "Heartbeat") -> None:
        self._stream, self._life = stream, life

    def write(self, text: str) -> int:
        with self._life.lock:
            self._life.printing()
            return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class Heartbeat:
    """Within `with`, a dot on standard error whenever nothing has been printed for two seconds, until `end`."""

    def __init__(self) -> None:
        self.lock, self._ended = RLock(), Event()
        self._last, self._dots = 0.0, False

    def printing(self) -> None:
        """Something is about to be printed, on a line of its own."""
        if self._dots:
            self._dots = False
            self._print("\n")
        self._last = time.monotonic()

    def end(self) -> None:
        """No more from here on: the command runs until it is stopped, or waits for its user."""
        self._ended.set()

    def __enter__(self) -> Self:
        self._streams, self._ended = (sys.stdout, sys.stderr), Event()
        self._last, self._dots = time.monotonic(), False
        sys.stdout, sys.stderr = (cast(TextIO, _TimedStream(stream, self)) for stream in self._streams)
        Thread(target=self._watch, args=(self._ended,), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
        with self.lock:
            self.printing()
        sys.stdout, sys.stderr = self._streams

    def _watch(self, ended: Event) -> None:
        while not ended.wait(max(0.0, self._last + _EVERY - time.monotonic())):
            with self.lock:
                if not ended.is_set() and time.monotonic() >= self._last + _EVERY:
                    self._print(".")
                    self._dots, self._last = True, time.monotonic()

    def _print(self, text: str) -> None:
        with suppress(OSError, ValueError):  # nobody reads it any more
            self._streams[1].write(text)
            self._streams[1].flush()


INTERRUPTED = Event()
"""Whether Ctrl-C was pressed in this process's command."""


def interrupt(*_: object) -> None:
    """End the command at Ctrl-C: raise KeyboardInterrupt.

    It may be raised within a compiler or a destructor. What these leave half made is not reported when it is deleted,
    and if they swallow it, it is raised again: later, because what is raised within this hook is swallowed, too.
    """

    def unraisable(swallowed: "sys.UnraisableHookArgs") -> None:
        if issubclass(swallowed.exc_type, KeyboardInterrupt):
            again = Timer(_AGAIN, signal.pthread_kill, (get_ident(), signal.SIGINT))
            again.daemon = True
            again.start()

    sys.unraisablehook = unraisable
    INTERRUPTED.set()
    raise KeyboardInterrupt


HEARTBEAT = Heartbeat()
"""Those of this process's command."""
