"""What ``ohmskin reproduce`` and ``ohmskin policies`` share: running a study with a progress bar for each group."""

import time
from collections import Counter
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from ohmskin.evaluate.result import Experiment
from ohmskin.evaluate.study import Study, assign

S = TypeVar("S")


def run_study(study: Study[S, Any], settings: S, output: Path, only: tuple[str, ...], **options: Any) -> None:
    """Run a study and say where its report is; for the options see `Study.run`."""
    started, console = time.monotonic(), Console()
    columns = (TextColumn("{task.description:<10}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        groups = study.plan(settings, only)
        shares = Counter(assign(groups).values())
        bars = {group: progress.add_task(group, total=shares[group]) for group in groups}

        def done(group: str, task: Experiment, cached: bool) -> None:
            progress.advance(bars[group])

        report = study.run(output, settings, only, progress=done, **options)
    console.print(f"report: {report}  ({time.monotonic() - started:.0f} s)", highlight=False, soft_wrap=True)
