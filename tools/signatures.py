"""Write `ohmskin/engine/signatures.py` anew: compiled functions that a loop calls, with which types."""

import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from numba import types
from numba.core.dispatcher import Dispatcher

import ohmskin as ohm
from ohmskin.device import connect

PLACE = Path(__file__).parents[1] / "src" / "ohmskin" / "engine" / "signatures.py"
HEAD = '''"""What a loop that fits contacts has compiled, with the types that it calls it with.

`tools/signatures.py` writes this file; `tests/test_compiling.py` says when that is due.
"""

from typing import Any

from numba import types

_tuple: Any = types.Tuple
'''
TAIL = '"""Module, name and argument types of each function."""\n'


def compiled() -> dict[str, set[tuple[Any, ...]]]:
    """The types that each compiled function of ours was called with, by module and name."""
    parts = {
        part
        for name, module in list(sys.modules.items())
        if name.startswith("ohmskin.")
        for part in vars(module).values()
        if isinstance(part, Dispatcher)
    }
    return {f"{p.py_func.__module__.removeprefix('ohmskin.')}:{p.py_func.__name__}": set(p.signatures) for p in parts}


def touch(mode: str) -> None:
    """Run a loop that is touched."""
    skin = ohm.Skin.load("paper")
    with connect("virtual:") as device, ohm.Engine(lambda: device, skin, mode) as engine:
        engine.calibrate()
        on_an_electrode = tuple(skin.electrodes.positions[-1].tolist())
        for number, at in enumerate([(0.06, 0.14), (0.14, 0.05), on_an_electrode]):
            engine.press(number, at, 0.01, 8e3)
            for _ in range(8):
                engine.step()


def listed(words: Iterable[str]) -> str:
    """A tuple, as it is written."""
    found = list(words)
    return f"({', '.join(found)}{',' if len(found) == 1 else ''})"


class Names:
    """A short name for every type, and the lines that make them."""

    def __init__(self) -> None:
        self.lines: dict[Any, tuple[str, str]] = {}

    def __call__(self, kind: Any) -> str:
        if kind not in self.lines:
            self.lines[kind] = self._line(kind)
        return self.lines[kind][0]

    def _line(self, kind: Any) -> tuple[str, str]:
        if isinstance(kind, types.BaseTuple):
            inner = listed(self(one) for one in kind)
            name = f"_T{sum(isinstance(one, types.BaseTuple) for one in self.lines) + 1}"
            return name, f"{name} = _tuple({inner})"
        if isinstance(kind, types.Array):
            fixed = "" if kind.mutable else "_FIXED"
            layout = "" if kind.layout == "C" else f"_{kind.layout}"
            name = f"{self(kind.dtype)}_{kind.ndim}{layout}{fixed}"
            readonly = "" if kind.mutable else ", readonly=True"
            return name, f'{name} = types.Array({self(kind.dtype)}, {kind.ndim}, "{kind.layout}"{readonly})'
        return f"_{str(kind).upper()}", f"_{str(kind).upper()} = types.{'bool_' if kind == types.bool_ else kind}"


def main() -> None:
    touch("16P")
    names, rows = Names(), list[str]()
    for name, signatures in sorted(compiled().items()):
        for signature in sorted(signatures, key=str):
            rows.append(f'("{name}", {listed(map(names, signature))}),')
    made = "\n".join(line for _, line in names.lines.values())
    table = "\n    ".join(["SIGNATURES: tuple[tuple[str, tuple[types.Type, ...]], ...] = (", *rows])
    PLACE.write_text(f"{HEAD}{made}\n\n{table}\n)\n{TAIL}", encoding="utf-8")
    subprocess.run([sys.executable, "-m", "ruff", "format", "--quiet", PLACE], check=True)


if __name__ == "__main__":
    if "--again" not in sys.argv:  # a function that was compiled, not loaded, names those that it calls as well
        touch("16P")
        with TemporaryDirectory() as folder:  # without the tables that have been made, for which some are called
            environment = {**os.environ, "OHMSKIN_CACHE": folder}
            subprocess.run([sys.executable, __file__, "--again"], env=environment, check=True)
    else:
        main()
        print(f"wrote {PLACE.name}")
