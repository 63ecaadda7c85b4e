"""What a user waits for: from a command to its end, to the page, and to the first contact."""

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from time import perf_counter
from urllib.request import urlopen

import numpy as np

from ohmskin.bench.clock import Effort, seconds_of
from ohmskin.bench.figure import Figure

_LONGEST = 600.0  # s that a start may take
_PAGE, _CONTACT, _DEFAULT = "open ", "contact 1 at", " from here on"  # what lines of `ohmskin live` have


def starting(effort: Effort) -> Iterator[Figure]:
    """Start-up, wall clock of whole processes."""
    commands = {
        "`ohmskin --help`": (["-m", "ohmskin", "--help"], 0.3),
        "`import ohmskin`": (["-c", "import ohmskin"], 0.5),
    }
    for name, (arguments, most) in commands.items():
        start = partial(subprocess.run, [sys.executable, *arguments], stdout=subprocess.DEVNULL, check=True)
        spent = [seconds_of(start, clock=perf_counter) for _ in range(7)]
        yield Figure.median(name, np.array(spent[1:]), "s", most=most, note="wall clock, the first run left out")
    if effort.quick:
        yield from _starts("as this machine is", None, {_CONTACT: None})
        return
    with tempfile.TemporaryDirectory() as folder:  # as on a machine that has compiled nothing
        yield from _starts("first start", Path(folder), {_PAGE: 10, _CONTACT: 20, _DEFAULT: None})
        yield from _starts("second start", Path(folder), {_PAGE: None, _CONTACT: 5})


def _starts(name: str, cache: Path | None, targets: dict[str, float | None]) -> Iterator[Figure]:
    """Seconds from `ohmskin live` to its lines that have each text.

    Args:
        name: Which start it is.
        cache: Where to keep what is compiled; where it is kept anyway unless given.
        targets: The text of each line, in the order in which they come, and the most seconds (s).
    """
    folders = {} if cache is None else {"NUMBA_CACHE_DIR": str(cache / "numba"), "OHMSKIN_CACHE": str(cache / "tables")}
    command = [sys.executable, "-m", "ohmskin", "live", "--no-browser", "--port", "0"]
    spent, begun = dict[str, float](), perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, **folders}) as process:
        assert process.stdout is not None
        late = threading.Timer(_LONGEST, process.kill)
        late.start()
        for line in process.stdout:
            for text in (text for text in targets if text in line and text not in spent):
                if text == _PAGE:
                    with urlopen(line.split()[1], timeout=60) as page:
                        page.read()
                spent[text] = perf_counter() - begun
            if len(spent) == len(targets):
                break
        late.cancel()
        process.terminate()
    for text, what in ((_PAGE, "the page"), (_CONTACT, "the first contact"), (_DEFAULT, "the default mode")):
        if text in targets:
            note = "wall clock" if text in spent else f"no line with {text.strip()!r}"
            yield Figure(f"`ohmskin live` to {what}, {name}", spent.get(text), "s", most=targets[text], note=note)
