"""The process that compiles what a loop will call while the loop runs already; it gives way to it."""

import os

from ohmskin.child import begin, when_input_ends
from ohmskin.compiler import take_turns
from ohmskin.engine.functions import compile_functions

_LESS_URGENT = 10  # niceness


def main() -> None:
    """Compile what fits call, or until standard input ends."""
    begin()
    when_input_ends(lambda: os._exit(0))
    if hasattr(os, "nice"):
        os.nice(_LESS_URGENT)
    take_turns()
    compile_functions(fits=True)


if __name__ == "__main__":
    main()
