"""How the benchmark measures: side by side, in turns, in CPU seconds of one thread.

CPU time leaves out what other programs take from the processor, but not that they push data out of its caches: what is
compared is run in turns, so that both suffer alike, and a ratio is the median over the turns.
"""

import json
import os
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numba import njit

from ohmskin.arrays import Floats
from ohmskin.bench.figure import Figure

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
Job = Callable[[], object]


@dataclass(frozen=True)
class Effort:
    """How long to measure: seconds for a comparison, and whether to leave out what takes minutes."""

    seconds: float
    quick: bool


def seconds_of(job: Job, repeats: int = 1, clock: Callable[[], float] = process_time) -> float:
    """Seconds that a job takes, the mean of some repeats, of the CPU or by another clock."""
    start = clock()
    for _ in range(repeats):
        job()
    return (clock() - start) / repeats


def in_turns(jobs: Mapping[str, Job], seconds: float, most: int = 200, least: int = 3) -> dict[str, Floats]:
    """CPU seconds (n_rounds,) of each job, run in turns for about `seconds`, `least` to `most` rounds.

    Quick jobs are repeated within a round, so that each takes a millisecond at least.
    """
    repeats = {}
    for name, job in jobs.items():
        job()
        repeats[name] = max(1, round(1e-3 / max(seconds_of(job), 1e-6)))
    spent: dict[str, list[float]] = {name: [] for name in jobs}
    end = perf_counter() + seconds
    for done in range(most):
        if done >= least and perf_counter() > end:
            break
        for name, job in jobs.items():
            spent[name].append(seconds_of(job, repeats[name]))
    return {name: np.array(times) for name, times in spent.items()}


def ratio(name: str, slow: Floats | float, quick: Floats | float, note: str = "", **target: float | None) -> Figure:
    """How many times as long `slow` takes as `quick`, (n_rounds,) or one value, against a target (`least`, `most`)."""
    ratios = np.atleast_1d(np.divide(slow, quick))
    data = {"slow_s": float(np.median(slow)), "quick_s": float(np.median(quick)), "rounds": len(ratios)}
    note = f"{duration(data['slow_s'])} / {duration(data['quick_s'])}{'; ' if note else ''}{note}"
    return Figure.median(name, ratios, "times", note=note, data=data, **target)


def duration(seconds: float) -> str:
    """A time with a unit that fits it."""
    for scale, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"


def outcome(command: list[str]) -> dict[str, Any]:
    """The JSON that a command prints last; {"error": what it said} if it fails."""
    environment = {**os.environ, **dict.fromkeys(THREADS, "1")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        return {"error": (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]}
    return dict(json.loads(done.stdout.splitlines()[-1]))


@njit(cache=True, nogil=True, fastmath=True)
def read(matrix: np.ndarray) -> float:
    """Sum of a contiguous array (n,): the quickest way to have read it."""
    total = matrix[0] - matrix[0]
    for k in range(len(matrix)):
        total += matrix[k]
    return float(total)
