"""Compiled functions are compiled when they are first called on a machine, once; that takes a minute or two."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core import event

_TELL_EVERY = 2.0  # s


class _Listener(event.Listener):
    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell, self._began, self._due = tell, 0.0, 0.0
        self.count = 0

    def on_start(self, event: event.Event) -> None:
        if not event.data["dispatcher"].py_func.__module__.startswith("ohmskin."):
            return
        now = time.monotonic()
        self._began = self._began or now
        self.count += 1
        if now >= self._due:
            self._due = now + _TELL_EVERY
            spent = f"; {self.count} functions in {now - self._began:.0f} s" if self.count > 1 else ""
            self._tell(f"compiling, once on this machine, for a minute or two{spent}")

    def on_end(self, event: event.Event) -> None:
        pass


@contextmanager
def compiling(tell: Callable[[str], None]) -> Iterator[None]:
    """Say that functions are being compiled when that begins, and every two seconds or so while it goes on."""
    with event.install_listener("numba:compile", _Listener(tell)):
        yield
