"""Experiments in named groups (the figures of a report, its sections): run together, their data written as JSON."""

import json
from collections.abc import Callable
from pathlib import Path

from ohmskin.errors import OhmskinError
from ohmskin.evaluate.cache import Cache, describe, fingerprint
from ohmskin.evaluate.result import Experiment, Result, plain
from ohmskin.evaluate.runner import run_experiments

Groups = dict[str, dict[str, Experiment]]  # by group and name
Results = dict[str, dict[str, Result]]  # the same
Progress = Callable[[str, Experiment, bool], None]  # group, its experiment that is done, whether it came from the cache


def assign(experiments: Groups) -> dict[Experiment, str]:
    """The first group that wants each experiment."""
    return {task: group for group, wanted in reversed(experiments.items()) for task in reversed(wanted.values())}


def run_groups(
    experiments: Groups,
    cache: Cache | None,
    jobs: int | None,
    scheduler: str,
    fresh: bool,
    progress: Progress,
    alone: tuple[str, ...] = (),
) -> Results:
    """Run the experiments of all groups; see `run_experiments` for the arguments.

    Those of the groups `alone` tell how long something takes: they run last, in this process, nothing beside it, and are not kept.
    """
    wanted_by = assign(experiments)

    def done(task: Experiment, cached: bool) -> None:
        progress(wanted_by[task], task, cached)

    together = [task for task, group in wanted_by.items() if group not in alone]
    results = run_experiments(together, cache, jobs, scheduler, fresh, done)
    for task, group in wanted_by.items():
        if group in alone:
            results[task] = task.run()
            done(task, False)
    return {group: {name: results[task] for name, task in wanted.items()} for group, wanted in experiments.items()}


def make_folders(folder: Path, option: str) -> None:
    """Make the output folder with ``figures`` and ``data``; `option` is the command line's name for it.

    Raises:
        OhmskinError: If it cannot be made.
    """
    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
        (folder / "data").mkdir(exist_ok=True)
    except OSError as error:
        raise OhmskinError(f"cannot make the output folder {folder}: {error}; give another with {option}") from error


def write_data(folder: Path, experiments: Groups, results: Results) -> None:
    """Write ``data/GROUP.json`` for every group: parameters and results of its experiments."""
    for group, found in results.items():
        told = {name: {"parameters": describe(experiments[group][name]), "results": plain(r, 4)} for name, r in found.items()}
        text = json.dumps({"ohmskin": fingerprint(), "experiments": told})
        (folder / "data" / f"{group}.json").write_text(text, encoding="utf-8")
