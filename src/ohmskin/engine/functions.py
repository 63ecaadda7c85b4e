"""Compiled functions of a loop, compiled before it calls them."""

from contextlib import suppress
from importlib import import_module

from numba.core.errors import NumbaError

from ohmskin.engine.signatures import SIGNATURES


def compile_all() -> None:
    """Compile, or load, what a loop that fits contacts will call."""
    for name, arguments in SIGNATURES:
        module, _, function = name.partition(":")
        with suppress(AttributeError, ImportError, TypeError, NumbaError):  # it has changed since; compiled when called
            getattr(import_module(f"ohmskin.{module}"), function).compile(arguments)
