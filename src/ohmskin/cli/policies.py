"""``ohmskin policies``: what to measure next, compared: the paper's scheme, position information, tracking."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from ohmskin.evaluate.policies.comparison import compare
from ohmskin.evaluate.policies.plan import Settings, plan
from ohmskin.evaluate.result import Experiment

_SEVERAL = Parameter(consume_multiple=True)  # --only static pairs


def policies(
    *,
    quick: bool = False,
    out: Path = Path("policies"),
    seeds: int | None = None,
    only: Annotated[tuple[str, ...], _SEVERAL] = (),
    jobs: int | None = None,
    scheduler: str = "",
    cache: Path | None = None,
    fresh: bool = False,
) -> None:
    """Compare drive policies at equal noise and equal time, and hold them against their goals, in one report.

    Example: `ohmskin policies --quick --out out/policies`

    Parameters
    ----------
    quick
        Few seeds and trials: a minute or two on two cores.
    out
        Folder for report.md, figures and data.
    seeds
        Noise seeds; 20 unless given, 5 with --quick.
    only
        Sections wanted: static, time, moving, pairs, detection, quiet, robust, cost.
    jobs
        Processes; one per core unless given.
    scheduler
        Address of a Dask scheduler to run on instead, such as tcp://host:8786.
    cache
        Folder of kept results, from which a run that was stopped goes on; within the output folder unless given.
    fresh
        Run everything anew.
    """
    usual = Settings.quick() if quick else Settings()
    settings = replace(usual, seeds=usual.seeds if seeds is None else seeds)
    started = time.monotonic()
    console = Console()
    columns = (TextColumn("{task.description:<10}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        shares = {section: len(group) for section, group in plan(settings, only).items()}
        bars = {section: progress.add_task(section, total=count) for section, count in shares.items()}

        def done(section: str, task: Experiment, cached: bool) -> None:
            progress.advance(bars[section])

        report = compare(out, settings, only, cache, jobs, scheduler, fresh, done)
    console.print(f"report: {report}  ({time.monotonic() - started:.0f} s)", highlight=False, soft_wrap=True)
