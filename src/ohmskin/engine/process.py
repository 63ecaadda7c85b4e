"""A process that compiles what a loop will call while the loop runs already; it gives way to it."""

import os

from ohmskin.child import begin, when_input_ends
from ohmskin.compiler import take_turns
from ohmskin.engine.functions import Part, compile_functions
from ohmskin.engine.tables import prepare
from ohmskin.skin import Skin

_LESS_URGENT = 10  # niceness


def main() -> None:
    """Compile what a loop waits for, what begins with `first` first, and prepare its default mode of a `skin`; or until
    standard input ends."""
    settings, _ = begin()
    when_input_ends(lambda: os._exit(0))
    if hasattr(os, "nice"):
        os.nice(_LESS_URGENT)
    take_turns()
    compile_functions(Part.AWAITED, settings["first"])
    if settings["skin"]:
        prepare(Skin.parse(settings["skin"]))


if __name__ == "__main__":
    main()
