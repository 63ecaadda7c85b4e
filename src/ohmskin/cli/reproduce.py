"""``ohmskin reproduce``: the paper's experiments, figures and table, with verdicts."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ohmskin.cli.studies import run_study
from ohmskin.evaluate.plan import Settings
from ohmskin.evaluate.reproduction import REPRODUCTION

_SEVERAL = Parameter(consume_multiple=True)  # --noise 45 35 55


def reproduce(
    *,
    quick: bool = False,
    output: Path = Path("reproduction"),
    noise: Annotated[tuple[float, ...], _SEVERAL] = (),
    amplitude: Annotated[tuple[float, ...], _SEVERAL] = (),
    seeds: int | None = None,
    only: Annotated[tuple[str, ...], _SEVERAL] = (),
    jobs: int | None = None,
    scheduler: str = "",
    cache: Path | None = None,
    fresh: bool = False,
) -> None:
    """Reproduce the paper: every figure and table, beside the paper's own figures, in one report.

    Args:
        quick: Few seeds and noise levels: about a minute on two cores.
        output: Folder for report.html, figures and data.
        noise: Noise levels (dB below the largest 12B voltage); the first is that of the figures, all make the sweep.
        amplitude: Prior amplitudes (relative conductivity change); the first is that of the figures, all make the
            sweep.
        seeds: Noise seeds; 20 unless given, 5 with --quick.
        only: Figures wanted: fig3, fig4, fig5, table1, fig6, fig7, fig8, sweep.
        jobs: Processes; one per core unless given.
        scheduler: Address of a Dask scheduler to run on instead, such as tcp://host:8786.
        cache: Folder of kept results, from which a run that was stopped goes on; within the output folder unless given.
        fresh: Run everything anew.
    """
    usual = Settings.quick() if quick else Settings()
    settings = replace(
        usual,
        noise=noise or usual.noise,
        amplitude=amplitude or usual.amplitude,
        seeds=usual.seeds if seeds is None else seeds,
    )
    run_study(REPRODUCTION, settings, output, only, cache=cache, jobs=jobs, scheduler=scheduler, fresh=fresh)
