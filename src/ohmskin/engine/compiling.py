"""Compiled functions are compiled when they are first called on a machine, once; that takes some 20 s."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from importlib import import_module

import numpy as np
from numba.core import event
from numba.core.errors import NumbaError

from ohmskin.closing import every
from ohmskin.drive import Target
from ohmskin.engine.signatures import SIGNATURES
from ohmskin.sensing import drive_of, mode_named
from ohmskin.skin import Skin

_REPORT_EVERY = 1.5  # s, sooner than signs of life on the command line
_FUNCTIONS = 2 * len(SIGNATURES)  # as each has some that only it calls


class _Listener(event.Listener):
    def __init__(self, report: Callable[[str], None]) -> None:
        self._report, self._began, self._due, self._under_way = report, 0.0, 0.0, 0
        self.count = 0

    def on_start(self, event: event.Event) -> None:
        if _own(event):
            self._began = self._began or time.monotonic()
            self.count += 1
            self._under_way += 1
            self.report()

    def on_end(self, event: event.Event) -> None:
        self._under_way -= _own(event)

    def report(self) -> None:
        """Say how far it is, if anything is being compiled and nothing was said for a while."""
        now = time.monotonic()
        if self._under_way and now >= self._due:
            self._due = now + _REPORT_EVERY
            spent = f"; {self.count} functions in {now - self._began:.0f} s" if now > self._began + 1 else ""
            self._report(f"compiling, once on this machine{spent}")


def _own(event: event.Event) -> bool:
    """Whether a function of ours is compiled, and not one that numba needs for it."""
    return str(event.data["dispatcher"].py_func.__module__).startswith("ohmskin.")


@contextmanager
def compiling(report: Callable[[str], None], threaded: bool = True) -> Iterator[None]:
    """Say that functions are being compiled when that begins, and every second or two while it goes on.

    Not `threaded`, it is said by the thread that compiles alone, at the next function after that.
    """
    listener = _Listener(report)
    ticking = every(_REPORT_EVERY / 4, listener.report) if threaded else nullcontext()
    with event.install_listener("numba:compile", listener), ticking:
        yield


def compile_ahead(report: Callable[[str, float], None]) -> None:
    """Compile what a loop that fits contacts will call, such as while a device starts.

    Args:
        report: Gets what is done and which share of it, 0 to 1, if anything is to be compiled.
    """
    listener = _Listener(lambda words: report(words, min(1.0, listener.count / _FUNCTIONS)))
    with event.install_listener("numba:compile", listener), every(_REPORT_EVERY / 4, listener.report):
        for name, arguments in SIGNATURES:
            module, _, function = name.partition(":")
            try:
                getattr(import_module(f"ohmskin.{module}"), function).compile(arguments)
            except (AttributeError, ImportError, TypeError, NumbaError):  # it has changed since; compiled when called
                continue


def prepare(skin: Skin, mode: str = "") -> None:
    """Make what a mode needs that follows from the description of a skin alone: its model and the tables of its drive.

    Raises:
        PatternError: If there is no such mode, or the skin does not allow it.
    """
    model, drive = skin.transfer_model(), drive_of(mode_named(skin, mode), skin)
    target = Target(model.mesh.centroids[:, :2].mean(axis=0), 1e-6 * np.eye(2), 1e-4, skin.imaging.mesh_size)
    drive.next([target] if drive.patterns else [], 1)
