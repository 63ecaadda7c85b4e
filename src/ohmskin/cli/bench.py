"""``ohmskin bench``: how fast it is, side by side with others and with what the machine can do."""

import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ohmskin.bench import GROUPS, Figure, run
from ohmskin.bench.report import last_seconds, write_report
from ohmskin.cli.options import Flag, Names, check_plot

_COLOURS = {"pass": "green", "short": "red", "not run": "yellow", "": ""}


def bench(
    *,
    quick: Flag = False,
    output: Path = Path("bench"),
    only: Names = (),
) -> None:
    """Measure speed on one thread, and compare it with pyEIT, SciPy and the machine's limits.

    Args:
        quick: Smaller sizes and fewer rounds.
        output: Folder for benchmarks.html, benchmarks.md (the same text), benchmarks.json and the plot; each part is
            written when it is measured.
        only: Parts to measure: machine, setup, fields, pattern, solver, frame, fits, live, touches, scale, electrodes,
            body, accuracy, start.
    """
    check_plot()
    started, console, parts = time.monotonic(), Console(), list(dict.fromkeys(only)) or list(GROUPS)
    found: dict[str, list[Figure]] = {}
    before = last_seconds(output, quick)
    seconds = dict(before)
    with console.status("measuring") as status:

        def say(part: str, figure: str) -> None:
            status.update(f"{part}: {figure}" if figure else part)
            if not figure:
                last = f", {before[part]:.0f} s last time" if part in before else ""
                console.print(f"{part}: part {len(found) + 1} of {len(parts)}{last}", highlight=False)

        begun = started
        for part, figures in run(quick, parts, say):
            found[part], ended = figures, time.monotonic()
            seconds[part], begun = round(ended - begun, 1), ended
            paths = write_report(found, output, quick, parts[len(found) :], seconds)
    table = Table(box=None, padding=(0, 1))
    for title in ("figure", "value", "spread", "target", "", "from"):
        table.add_column(title, justify="right" if title == "value" else "left", overflow="fold")
    for figure in (figure for group in found.values() for figure in group):
        colour, verdict = _COLOURS[figure.verdict], figure.verdict
        table.add_row(*figure.row(f"[{colour}]{verdict}[/{colour}]" if colour else verdict))
    console.print(table, highlight=False)
    for path in paths:
        console.print(str(path), highlight=False, soft_wrap=True)
    console.print(f"{time.monotonic() - started:.0f} s", highlight=False)
