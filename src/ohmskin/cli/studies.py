"""``ohmskin reproduce`` and ``ohmskin policies``: studies, each in one report."""

import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from ohmskin.cli.options import Flag, Jobs, Names, Numbers, Scheduler, say
from ohmskin.evaluate.plan import Settings
from ohmskin.evaluate.policies.comparison import POLICIES
from ohmskin.evaluate.policies.plan import Settings as PolicySettings
from ohmskin.evaluate.reproduction import REPRODUCTION
from ohmskin.evaluate.result import Experiment
from ohmskin.evaluate.study import Study, assign

S = TypeVar("S", Settings, PolicySettings)


def reproduce(
    *,
    quick: Flag = False,
    output: Path = Path("reproduction"),
    noise: Numbers = (),
    amplitude: Numbers = (),
    seeds: int | None = None,
    only: Names = (),
    jobs: Jobs = None,
    scheduler: Scheduler = "",
    cache: Path | None = None,
    fresh: Flag = False,
) -> None:
    """Reproduce the paper: every figure and table, compared with the paper's, with verdicts.

    Args:
        quick: Few seeds and noise levels: about a minute on two cores.
        output: Folder for report.html, figures and data.
        noise: Noise levels (dB below the largest 12B voltage); the figures have the first, the sweep all of them.
        amplitude: Prior amplitudes (relative conductivity change); the figures have the first, the sweep all of them.
        seeds: Noise seeds; 20 unless given, 5 with --quick.
        only: Figures to make: fig3, fig4, fig5, table1, fig6, fig7, fig8, sweep, assumptions.
        cache: Folder of kept results, from which an interrupted run continues; within the output folder unless given.
        fresh: Ignore the kept results and run everything again.
    """
    given = {"noise": noise or None, "amplitude": amplitude or None, "seeds": seeds}
    usual = Settings.quick() if quick else Settings()
    _run(REPRODUCTION, usual, given, output, only, cache=cache, jobs=jobs, scheduler=scheduler, fresh=fresh)


def policies(
    *,
    quick: Flag = False,
    output: Path = Path("policies"),
    seeds: int | None = None,
    only: Names = (),
    jobs: Jobs = None,
    scheduler: Scheduler = "",
    cache: Path | None = None,
    fresh: Flag = False,
) -> None:
    """Compare drive policies (the paper's, by information, tracking) at equal noise and equal time, and check their
    goals.

    Args:
        quick: Few seeds and trials: ten minutes or more on two cores, the section `time` alone a minute.
        output: Folder for report.html, the same as report.md, figures and data.
        seeds: Noise seeds; 20 unless given, 5 with --quick.
        only: Sections to make: static, driven, time, gain, moving, pairs, press, sensitivity, detection, quiet,
            trouble, robust, cost.
        cache: Folder of kept results, from which an interrupted run continues; within the output folder unless given.
        fresh: Ignore the kept results and run everything again.
    """
    usual = PolicySettings.quick() if quick else PolicySettings()
    _run(POLICIES, usual, {"seeds": seeds}, output, only, cache=cache, jobs=jobs, scheduler=scheduler, fresh=fresh)


def _run(
    study: Study[S, Any], usual: S, given: dict[str, Any], output: Path, only: tuple[str, ...], **options: Any
) -> None:
    """Run a study and say where its report is; for the options see `Study.run`.

    How far it is, is shown by a bar for each group on a terminal, elsewhere in a line for each experiment.
    """
    settings = replace(usual, **{name: value for name, value in given.items() if value is not None})
    started, console = time.monotonic(), Console()
    columns = (TextColumn("{task.description:<10}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        groups = study.plan(settings, only)
        shares = Counter(assign(groups).values())
        finished = Counter[str]()
        if progress.disable:
            say(f"experiments: {', '.join(f'{group} {shares[group]}' for group in groups)}")
        bars = {group: progress.add_task(group, total=shares[group]) for group in groups}

        def done(group: str, task: Experiment, cached: bool) -> None:
            progress.advance(bars[group])
            if progress.disable:
                finished[group] += 1
                say(f"{group}: {finished[group]} of {shares[group]} done")

        report = study.run(output, settings, only, progress=done, **options)
    console.print(f"report: {report}  ({time.monotonic() - started:.0f} s)", highlight=False, soft_wrap=True)
