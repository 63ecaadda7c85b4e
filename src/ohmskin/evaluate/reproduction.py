"""The whole reproduction: run the plan, judge the paper's claims, draw the pictures, write the report."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

from ohmskin.errors import OhmskinError
from ohmskin.evaluate.cache import Cache, fingerprint
from ohmskin.evaluate.groups import Groups, Progress, Results, make_folders, run_groups, write_data
from ohmskin.evaluate.plan import Settings, plan


@dataclass(frozen=True)
class Reproduction:
    """Everything that was run.

    Args:
        settings: How thoroughly.
        experiments: By figure and name.
        results: The same, with results.
    """

    settings: Settings
    experiments: Groups
    results: Results = field(repr=False)


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
    return Reproduction(settings, experiments, run_groups(experiments, cache, jobs, scheduler, fresh, progress))


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
    make_folders(folder, "--output")
    kept = Cache(Path(cache) if cache else folder / "cache")
    done = run_plan(settings, tuple(experiments), kept, jobs, scheduler, fresh, progress)
    claims = judge(done)
    try:
        pictures = draw(done, folder / "figures")
        write_data(folder, done.experiments, done.results)
        summary = {"ohmskin": fingerprint(), "settings": asdict(settings), "claims": [asdict(claim) for claim in claims]}
        (folder / "claims.json").write_text(json.dumps(summary, indent=1), encoding="utf-8")
        return write_report(done, claims, pictures, folder / "report.html")
    except OSError as error:
        raise OhmskinError(f"cannot write the report to {folder}: {error}") from error
