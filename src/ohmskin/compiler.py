"""What numba compiles is told, and compiled by one process at a time: it takes some 20 s, once on a machine.

What one process has compiled, the others load.
"""

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any, BinaryIO

from numba.core import config, event
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from ohmskin.cache import cache_folder
from ohmskin.closing import Closing, every

_REPORT_EVERY = 1.5  # s, sooner than signs of life on the command line
_LONGEST, _NAP = 120.0, 0.02  # s for which a turn is waited for, several times what any function takes; between looks
LOOK_EVERY = _REPORT_EVERY / 4  # s between two looks at whether a report is due

_held = set[str]()  # turns of this process
_never_wait = ""  # held: all turns


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


class NotCompiled(Exception):
    """A function was not compiled on this machine."""


class _Refusal(event.Listener):
    def on_start(self, event: event.Event) -> None:
        if is_ours(event):
            raise NotCompiled

    def on_end(self, event: event.Event) -> None:
        pass


@contextmanager
def loading() -> Iterator[None]:
    """Functions are loaded, without waiting for another process that compiles one: what was never compiled raises.

    Raises:
        NotCompiled: Then.
    """
    _held.add(_never_wait)
    try:
        with event.install_listener("numba:compile", _Refusal()):
            yield
    finally:
        _held.remove(_never_wait)


class Interpreted(Closing):
    """What is compiled of some modules is interpreted instead, until this is closed: much slower, but at once.

    Args:
        modules: Their names; no other module may have compiled functions that call theirs.
    """

    def __init__(self, modules: Iterable[str]) -> None:
        parts = [(name, part) for name in modules for part in vars(import_module(name)).values()]
        self._compiled = {
            part.py_func: part for name, part in parts if isinstance(part, Dispatcher) and part.__module__ == name
        }
        _exchange({compiled: plain for plain, compiled in self._compiled.items()})

    def close(self) -> None:
        """Take what is compiled again. Safe to call twice."""
        _exchange(self._compiled)


def _exchange(functions: Mapping[object, object]) -> None:
    """Replace functions wherever a module of ours has them."""
    for module in [module for name, module in list(sys.modules.items()) if name.startswith("ohmskin")]:
        for name, part in list(vars(module).items()):
            if isinstance(part, Dispatcher | FunctionType) and part in functions:
                setattr(module, name, functions[part])


@cache
def take_turns() -> None:
    """From now on, this process waits for another one that compiles the function of ours that it needs, and loads it.

    Nor do two of them mix up the index of what is kept of one function.
    """
    alone = Dispatcher.compile

    def compile_in_turn(function: Any, types: Any) -> Any:
        name = f"{function.py_func.__module__}.{function.py_func.__qualname__}"
        if not name.startswith("ohmskin."):
            return alone(function, types)
        with global_compiler_lock, _turn(name):  # in this order: no thread has a turn while it waits for another thread
            return alone(function, types)

    Dispatcher.compile = compile_in_turn  # type: ignore[assignment, method-assign]


@contextmanager
def _turn(name: str) -> Iterator[None]:
    """Only one process at a time has the turn of a name; within it, it has it already."""
    if _held & {name, _never_wait}:
        yield
        return
    file = _locked(name)
    _held.add(name)
    try:
        yield
    finally:
        _held.remove(name)
        if file is not None:
            file.close()


def _locked(name: str) -> BinaryIO | None:
    """A file that is locked until it is closed; None, and all compile by themselves, where none can be written, or
    whoever has it is stuck."""
    folder = Path(config.CACHE_DIR or cache_folder())  # type: ignore[attr-defined]
    with suppress(ImportError, OSError):
        import fcntl  # not everywhere

        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        file, until = (folder / f"{name}.turn").open("ab"), time.monotonic() + _LONGEST
        while time.monotonic() < until:
            with suppress(BlockingIOError):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return file
            time.sleep(_NAP)
        file.close()
    return None
