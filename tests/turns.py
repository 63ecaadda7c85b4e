"""What one process has compiled, no other has to: they take turns at each function that is kept."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

_held: set[str] = set()


@contextmanager
def turn(name: str) -> Iterator[None]:
    """Only one process at a time has the turn of a name; within it, it has it already."""
    with global_compiler_lock:  # first: its threads never wait for one another with a turn in hand
        if name in _held:
            yield
            return
        os.makedirs(os.environ["NUMBA_CACHE_DIR"], exist_ok=True)
        with open(os.path.join(os.environ["NUMBA_CACHE_DIR"], f"{name}.turn"), "a") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # until it is closed
            _held.add(name)
            try:
                yield
            finally:
                _held.remove(name)


def take_turns() -> None:
    """From now on, load or compile a function of ours in its turn: compiled by another process, it is loaded."""
    alone = Dispatcher.compile

    def compile_in_turn(function: Any, types: Any) -> Any:
        name = f"{function.py_func.__module__}.{function.py_func.__qualname__}"
        if not name.startswith("ohmskin."):
            return alone(function, types)
        with turn(name):
            return alone(function, types)

    Dispatcher.compile = compile_in_turn  # type: ignore[assignment, method-assign]
