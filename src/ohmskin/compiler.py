"""What numba compiles is told: it takes some 20 s, once on a machine."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

from numba.core import event

from ohmskin.closing import every

_REPORT_EVERY = 1.5  # s, sooner than signs of life on the command line
LOOK_EVERY = _REPORT_EVERY / 4  # s between two looks at whether a report is due


class CompileListener(event.Listener):
    """Reports that functions of ours are being compiled, and how many.

    Args:
        report: Called with a sentence, every second or two at most.

    Attributes:
        count: How many there were.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report, self._began, self._due, self._under_way = report, 0.0, 0.0, 0
        self.count = 0

    def on_start(self, event: event.Event) -> None:
        if is_ours(event):
            self._began = self._began or time.monotonic()
            self.count += 1
            self._under_way += 1
            self.report()

    def on_end(self, event: event.Event) -> None:
        self._under_way -= is_ours(event)

    def report(self) -> None:
        """Say how far it is, if anything is being compiled and nothing was said for a while."""
        now = time.monotonic()
        if self._under_way and now >= self._due:
            self._due = now + _REPORT_EVERY
            count = f"{self.count} function{'s' * (self.count != 1)}"
            spent = f"; {count} in {now - self._began:.0f} s" if now > self._began + 1 else ""
            self._report(f"compiling, once on this machine{spent}")


def is_ours(event: event.Event) -> bool:
    """Whether a function of ours is compiled, and not one that numba needs for it."""
    return str(event.data["dispatcher"].py_func.__module__).startswith("ohmskin.")


@contextmanager
def compiling(report: Callable[[str], None], threaded: bool = True) -> Iterator[None]:
    """Say that functions are being compiled when that begins, and every second or two while it goes on.

    Not `threaded`, it is said by the thread that compiles alone, at the next function after that.
    """
    listener = CompileListener(report)
    ticking = every(LOOK_EVERY, listener.report) if threaded else nullcontext()
    with event.install_listener("numba:compile", listener), ticking:
        yield
