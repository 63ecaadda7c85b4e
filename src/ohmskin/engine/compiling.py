"""Compiled functions are compiled when they are first called on a machine, once; that takes some 20 s."""

from collections.abc import Callable

import numpy as np
from numba.core import event

from ohmskin.child import Child
from ohmskin.closing import Closing, every
from ohmskin.compiler import LOOK_EVERY, CompileListener, NotCompiled, loading
from ohmskin.drive import Target
from ohmskin.engine.functions import chosen, compile_functions
from ohmskin.sensing import drive_of, mode_named
from ohmskin.skin import Skin

_EACH = 2  # functions compiled for each one that a loop calls, as most have some that only they call


def compile_ahead(report: Callable[[str, float], None], fits: bool = True) -> None:
    """Compile what a loop will call, such as while a device starts.

    Args:
        report: Gets what is done and which share of it, 0 to 1, if anything is to be compiled.
        fits: Whether it fits contacts.
    """
    which = None if fits else False
    count = _EACH * len(chosen(which))
    listener = CompileListener(lambda words: report(words, min(1.0, listener.count / count)))
    with event.install_listener("numba:compile", listener), every(LOOK_EVERY, listener.report):
        compile_functions(which)


class Compilation(Closing):
    """Compiles what fits call, in a process of its own; nothing if all that a loop calls was compiled before."""

    def __init__(self) -> None:
        self._child = None if _loaded() else Child.module("ohmskin.engine.process", "the compiling process", {})

    @property
    def under_way(self) -> bool:
        """Whether something is being compiled still."""
        return self._child is not None and self._child.process.poll() is None

    def close(self) -> None:
        """End the process; what it had compiled is kept. Safe to call twice."""
        if self._child is not None:
            self._child.close(0.0)


def _loaded() -> bool:
    """Load what was compiled before; whether that is all."""
    try:
        with loading():
            compile_functions()
    except NotCompiled:
        return False
    return True


def prepare(skin: Skin, mode: str = "") -> None:
    """Make what a mode needs that follows from the description of a skin alone: its model and the tables of its drive.

    Raises:
        PatternError: If there is no such mode, or the skin does not allow it.
    """
    model, drive = skin.transfer_model(), drive_of(mode_named(skin, mode), skin)
    target = Target(model.mesh.centroids[:, :2].mean(axis=0), 1e-6 * np.eye(2), 1e-4, skin.imaging.mesh_size)
    drive.next([target] if drive.patterns else [], 1)
