"""The whole reproduction: run the plan, judge the paper's claims, draw the pictures, write the report."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from ohmskin.errors import OhmskinError
from ohmskin.evaluate.cache import Cache, describe, fingerprint
from ohmskin.evaluate.plan import Settings, plan
from ohmskin.evaluate.result import Experiment, Result, plain
from ohmskin.evaluate.runner import run_experiments

Progress = Callable[[str, Experiment, bool], None]  # figure, its experiment that is done, whether it came from the cache


@dataclass(frozen=True)
class Reproduction:
    """Everything that was run.

    Args:
        settings: How thoroughly.
        experiments: By figure and name.
        results: The same, with results.
    """

    settings: Settings
    experiments: dict[str, dict[str, Experiment]]
    results: dict[str, dict[str, Result]] = field(repr=False)


def assign(experiments: dict[str, dict[str, Experiment]]) -> dict[Experiment, str]:
    """The first figure that wants each experiment."""
    return {task: figure for figure, group in reversed(experiments.items()) for task in reversed(group.values())}


def run_plan(
    settings: Settings,
    only: tuple[str, ...] = (),
    cache: Cache | None = None,
    jobs: int | None = None,
    scheduler: str = "",
    fresh: bool = False,
    progress: Progress = lambda figure, task, cached: None,
) -> Reproduction:
    """Run the experiments of the figures wanted; see `run_experiments` for the arguments."""
    experiments = plan(settings, only)
    wanted_by = assign(experiments)

    def done(task: Experiment, cached: bool) -> None:
        progress(wanted_by[task], task, cached)

    results = run_experiments(wanted_by, cache, jobs, scheduler, fresh, done)
    by_name = {figure: {name: results[task] for name, task in group.items()} for figure, group in experiments.items()}
    return Reproduction(settings, experiments, by_name)


def reproduce(
    output: str | Path,
    settings: Settings | None = None,
    only: tuple[str, ...] = (),
    cache: str | Path | None = None,
    jobs: int | None = None,
    scheduler: str = "",
    fresh: bool = False,
    progress: Progress = lambda figure, task, cached: None,
) -> Path:
    """Reproduce the paper: writes ``report.html``, ``figures/*.png``, ``claims.json`` and ``data/*.json`` to a folder.

    Args:
        output: The folder; made if it is not there.
        settings: How thoroughly; everything unless given.
        only: Figures wanted, of `plan.FIGURES`; all unless given.
        cache: Folder of kept results; ``cache`` in the output folder unless given.
        jobs, scheduler, fresh: See `run_experiments`.
        progress: Called after each experiment.

    Returns:
        The report.

    Raises:
        OhmskinError: If something cannot be written, or see `run_experiments`.
    """
    from ohmskin.evaluate.claims import judge
    from ohmskin.evaluate.figures import draw
    from ohmskin.evaluate.report import write_report

    settings, folder = settings or Settings(), Path(output)
    experiments = plan(settings, only)  # a mistake in the options is told before folders are made
    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
        (folder / "data").mkdir(exist_ok=True)
    except OSError as error:
        raise OhmskinError(f"cannot make the output folder {folder}: {error}; give another with --output") from error
    kept = Cache(Path(cache) if cache else folder / "cache")
    done = run_plan(settings, tuple(experiments), kept, jobs, scheduler, fresh, progress)
    claims = judge(done)
    try:
        pictures = draw(done, folder / "figures")
        for figure, results in done.results.items():
            data = {
                "ohmskin": fingerprint(),
                "experiments": {
                    name: {"parameters": describe(done.experiments[figure][name]), "results": plain(result, 4)}
                    for name, result in results.items()
                },
            }
            (folder / "data" / f"{figure}.json").write_text(json.dumps(data), encoding="utf-8")
        summary = {"ohmskin": fingerprint(), "settings": asdict(settings), "claims": [asdict(claim) for claim in claims]}
        (folder / "claims.json").write_text(json.dumps(summary, indent=1), encoding="utf-8")
        return write_report(done, claims, pictures, folder / "report.html")
    except OSError as error:
        raise OhmskinError(f"cannot write the report to {folder}: {error}") from error
