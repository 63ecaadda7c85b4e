"""``ohmskin policies``: what to measure next, compared: the paper's scheme, position information, tracking."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ohmskin.cli.studies import run_study
from ohmskin.evaluate.policies.comparison import POLICIES
from ohmskin.evaluate.policies.plan import Settings

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

    Args:
        quick: Few seeds and trials: a minute or two on two cores.
        out: Folder for report.md, figures and data.
        seeds: Noise seeds; 20 unless given, 5 with --quick.
        only: Sections wanted: static, time, moving, pairs, detection, quiet, robust, cost.
        jobs: Processes; one per core unless given.
        scheduler: Address of a Dask scheduler to run on instead, such as tcp://host:8786.
        cache: Folder of kept results, from which a run that was stopped goes on; within the output folder unless given.
        fresh: Run everything anew.
    """
    usual = Settings.quick() if quick else Settings()
    settings = replace(usual, seeds=usual.seeds if seeds is None else seeds)
    run_study(POLICIES, settings, out, only, cache=cache, jobs=jobs, scheduler=scheduler, fresh=fresh)
