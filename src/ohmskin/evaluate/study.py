"""Studies: experiments that are planned, run, assessed, drawn and reported in one go."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from ohmskin.errors import OhmskinError
from ohmskin.evaluate.cache import Cache, describe, fingerprint
from ohmskin.evaluate.figures.drawing import Drawn, save_pictures
from ohmskin.evaluate.result import Experiment, Groups, Outcome, Progress, plain
from ohmskin.evaluate.runner import run_experiments
from ohmskin.plot.report import ReportPicture, Section, write_report

S = TypeVar("S")
V = TypeVar("V")
Pictures = Mapping[str, Sequence[ReportPicture]]


def assign(experiments: Groups) -> dict[Experiment, str]:
    """The first group that wants each experiment."""
    return {task: group for group, wanted in reversed(experiments.items()) for task in reversed(wanted.values())}


@dataclass(frozen=True)
class Study(Generic[S, V]):
    """One study: what is run, what is concluded from it, and how that is shown.

    Args:
        settings: Makes the usual settings.
        plan: The experiments of the groups wanted (all if none is named), by group and name.
        assess: Verdicts from the outcome.
        painters: What draws the pictures of a group.
        sections: The sections of the report: first an introduction, then one for each group.
        reports: File names of the report, ``*.html`` or ``*.md``; the first is the one to look at.
        verdicts: What the verdicts are called: they go to a JSON file of that name.
        dpi: Of the pictures.
        alone: Groups that measure time: they run last, in this process, nothing beside them, and are
            not kept.
        record: The fields of a verdict, as JSON can hold them.
    """

    settings: Callable[[], S]
    plan: Callable[[S, tuple[str, ...]], Groups]
    assess: Callable[[Outcome[S]], Sequence[V]]
    painters: Mapping[str, Callable[[Outcome[S]], Sequence[Drawn]]]
    sections: Callable[[Outcome[S], Sequence[V], Pictures], Sequence[Section]]
    reports: tuple[str, ...]
    verdicts: str
    dpi: int = 200
    alone: tuple[str, ...] = ()
    record: Callable[[V], dict[str, Any]] = asdict  # type: ignore[assignment]

    def run(
        self,
        output: str | Path,
        settings: S | None = None,
        only: tuple[str, ...] = (),
        cache: str | Path | None = None,
        jobs: int | None = None,
        scheduler: str = "",
        fresh: bool = False,
        progress: Progress = lambda group, task, cached: None,
    ) -> Path:
        """Run the study: writes the report, ``figures/*.png``, the verdicts and ``data/*.json`` to a folder.

        Args:
            output: The folder; made if it is not there.
            settings: Seeds, noise levels and counts; the usual ones unless given.
            only: Groups to run; all unless given.
            cache: Folder of cached results; ``cache`` in the output folder unless given.
            jobs, scheduler, fresh: See `run_experiments`.
            progress: Called after each experiment.

        Returns:
            The report.

        Raises:
            OhmskinError: If something cannot be written, or see `run_experiments`.
        """
        settings, folder = settings or self.settings(), Path(output)
        experiments = self.plan(settings, only)  # a mistake in the options is reported before folders are made
        try:
            (folder / "figures").mkdir(parents=True, exist_ok=True)
            (folder / "data").mkdir(exist_ok=True)
        except OSError as error:
            text = f"cannot make the output folder {folder}: {error}; give another with --output"
            raise OhmskinError(text) from error
        kept, wanted_by = Cache(Path(cache) if cache else folder / "cache"), assign(experiments)

        def ran(task: Experiment, cached: bool) -> None:
            progress(wanted_by[task], task, cached)

        together = [task for task, group in wanted_by.items() if group not in self.alone]
        results = run_experiments(together, kept, jobs, scheduler, fresh, ran)
        for task in [task for task in wanted_by if task not in results]:
            results[task] = task.run()
            ran(task, False)
        found = {group: {name: results[task] for name, task in wanted.items()} for group, wanted in experiments.items()}
        done = Outcome(settings, experiments, found)
        verdicts = self.assess(done)
        try:
            pictures = save_pictures(done, self.painters, folder / "figures", self.dpi)
            for group in found:
                told = {name: {"parameters": describe(t), "results": plain(r)} for name, t, r in done.of(group)}
                text = json.dumps({"ohmskin": fingerprint(), "experiments": told})
                (folder / "data" / f"{group}.json").write_text(text, encoding="utf-8")
            summary = {"ohmskin": fingerprint(), "settings": asdict(settings)}  # type: ignore[call-overload]
            summary[self.verdicts] = [self.record(verdict) for verdict in verdicts]
            (folder / f"{self.verdicts}.json").write_text(json.dumps(summary, indent=1), encoding="utf-8")
            sections = self.sections(done, verdicts, pictures)
            written = [write_report(sections, folder / name) for name in self.reports]
            return written[0]
        except OSError as error:
            raise OhmskinError(f"cannot write the report to {folder}: {error}") from error
