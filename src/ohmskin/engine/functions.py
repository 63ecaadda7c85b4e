"""Compiled functions of a loop, compiled before it calls them."""

from contextlib import suppress
from enum import Enum
from importlib import import_module
from typing import Any

from numba.core.errors import NumbaError

from ohmskin.engine.signatures import SIGNATURES

INTERPRETED = tuple(
    f"ohmskin.{name}"
    for name in ("contacts.kernels", "contacts.misfit", "contacts.refit", "contacts.whitened", "tracking.kernels")
)
"""Modules whose functions are interpreted while they are compiled in another process: they take long to compile, and a
loop without fits calls them rarely."""

HALVES = ("", "contacts.refit:")
"""What two processes begin with that compile as much each."""

_JUDGING = ("contacts.misfit:norms", "contacts.misfit:signals", "contacts.whitened:likelihood")
_STANDING_IN = (
    "contacts.regions:",
    "forward.assembly:",
    "forward.sensitivity:",
    "inverse.modes:",
    "scan.coherence:",
    "sensing.soundness:",
)


class Part(Enum):
    """Some of `SIGNATURES`, by what their names begin with."""

    ALL = ("",)
    WITHOUT_FITS = (*_JUDGING, *_STANDING_IN)
    """What a loop that fits no contacts calls."""
    STANDING_IN = _STANDING_IN
    """What it calls while `INTERPRETED` are interpreted."""
    AWAITED = ()
    """All others: what it waits for meanwhile."""


def compile_functions(part: Part = Part.ALL, first: str = "") -> None:
    """Compile, or load, what a loop calls: what has a name that begins with `first`, what another process does not
    begin with, and the rest."""
    for name, arguments in sorted(
        chosen(part), key=lambda one: (not one[0].startswith(first), one[0].startswith(HALVES[1]))
    ):
        module, _, function = name.partition(":")
        with suppress(AttributeError, ImportError, TypeError, NumbaError):  # it has changed since; compiled when called
            getattr(import_module(f"ohmskin.{module}"), function).compile(arguments)


def chosen(part: Part) -> list[tuple[str, tuple[Any, ...]]]:
    """Those of `SIGNATURES` that `compile_functions` compiles."""
    awaited = part is Part.AWAITED
    return [one for one in SIGNATURES if one[0].startswith(_STANDING_IN if awaited else part.value) != awaited]
