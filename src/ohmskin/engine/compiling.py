"""Compiled functions are compiled when they are first called on a machine, once; that takes some 20 s."""

from collections.abc import Callable
from contextlib import ExitStack

from numba.core import event

from ohmskin.child import Child
from ohmskin.closing import Closing, every
from ohmskin.compiler import LOOK_EVERY, CompileListener, Interpreted, NotCompiled, loading
from ohmskin.engine.functions import HALVES, INTERPRETED, Part, chosen, compile_functions
from ohmskin.forward.assembly import uncompiled
from ohmskin.skin import Skin

_EACH = 2  # functions compiled for each one that a loop calls, as most have some that only they call


def compile_ahead(report: Callable[[str, float], None], part: Part = Part.ALL) -> None:
    """Compile what a loop will call, such as while a device starts.

    Args:
        report: Gets what is done and which share of it, 0 to 1, if anything is to be compiled.
        part: What the loop calls.
    """
    count = _EACH * len(chosen(part))
    listener = CompileListener(lambda words: report(words, min(1.0, listener.count / count)))
    with event.install_listener("numba:compile", listener), every(LOOK_EVERY, listener.report):
        compile_functions(part)


class Compilation(Closing):
    """Compiles what a loop waits for in processes of its own; in none if all was compiled before.

    Args:
        skin: Of a loop that runs meanwhile, in which fits are interpreted until this is closed; the tables of its
            default mode are made, too. None: this process compiles the same, and has half of it compiled.
    """

    def __init__(self, skin: Skin | None = None) -> None:
        self._children = list[Child]()
        with ExitStack() as parts:
            if not _loaded():
                begun = {HALVES[1]: ""}
                if skin:
                    parts.enter_context(Interpreted(INTERPRETED))
                    parts.enter_context(uncompiled())
                    begun[HALVES[0]] = skin.dump()
                for first, prepared in begun.items():
                    settings = {"first": first, "skin": prepared}
                    child = Child.module("ohmskin.engine.process", "a compiling process", settings)
                    self._children.append(child)
                    parts.callback(child.close, 0.0)
            self._parts = parts.pop_all()

    @property
    def under_way(self) -> bool:
        """Whether something is being compiled still."""
        return any(child.process.poll() is None for child in self._children)

    def close(self) -> None:
        """End the processes; what they had compiled is kept, and used from now on. Safe to call twice."""
        self._parts.close()


def _loaded() -> bool:
    """Load what was compiled before; whether that is all."""
    try:
        with loading():
            compile_functions()
    except NotCompiled:
        return False
    return True
