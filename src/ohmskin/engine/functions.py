"""Compiled functions of a loop, compiled before it calls them."""

from contextlib import suppress
from importlib import import_module
from typing import Any

from numba.core.errors import NumbaError

from ohmskin.engine.signatures import SIGNATURES

_WITHOUT_FITS = (
    "contacts.misfit:norms",
    "contacts.misfit:signals",
    "contacts.regions:",
    "contacts.whitened:likelihood",
    "forward.sensitivity:",
    "inverse.modes:",
    "scan.coherence:",
    "sensing.soundness:",
)


def compile_functions(fits: bool | None = None) -> None:
    """Compile, or load, what a loop calls: all unless said, what only `fits` call, or what loops without them call."""
    for name, arguments in chosen(fits):
        module, _, function = name.partition(":")
        with suppress(AttributeError, ImportError, TypeError, NumbaError):  # it has changed since; compiled when called
            getattr(import_module(f"ohmskin.{module}"), function).compile(arguments)


def chosen(fits: bool | None = None) -> list[tuple[str, tuple[Any, ...]]]:
    """Those of `SIGNATURES` that `compile_functions` compiles."""
    return [one for one in SIGNATURES if fits is None or fits != one[0].startswith(_WITHOUT_FITS)]
