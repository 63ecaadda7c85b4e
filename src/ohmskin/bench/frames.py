"""Figures of single frames: a new drive pattern, the adaptive frame, its accuracy."""

import gc
from collections.abc import Iterator
from functools import partial
from itertools import cycle as cycled
from time import perf_counter

import numpy as np

from ohmskin.bench import peers, pyeit_alone, sheets
from ohmskin.bench.clock import Effort, Job, duration, in_turns, ratio, read, seconds_of
from ohmskin.bench.figure import Figure
from ohmskin.bench.sheets import Scanned
from ohmskin.bench.tasks import compiled, set_up
from ohmskin.scan import Difference, adjacent
from ohmskin.sensing import CompiledCycle
from ohmskin.sensing.primitives import combine


def changing(effort: Effort) -> Iterator[Figure]:
    """A drive pattern never driven before, to the image of one frame and its contacts."""
    rng = np.random.default_rng(0)
    for cells, least in ((24, 1000), (48, 10_000)):
        estimator, _ = set_up(cells)
        layout, mesh = estimator.model.electrodes, estimator.model.mesh
        name = f"change of drive pattern to image, {mesh.n_elem:,} triangles, against pyEIT"
        cycle, scan = compiled(estimator, 16, fuse=False), sheets.touched(estimator.model, (0.07, 0.12))
        choices = [rng.permutation(120)[:16] for _ in range(256)]
        fresh = cycled([(*scan(cycle.pattern(chosen)), chosen) for chosen in choices])

        if not peers.has_pyeit():
            yield Figure(name, None, "times", least=least, note=peers.MISSING)
            continue
        theirs, pattern = peers.pyeit_mesh(mesh, layout), adjacent(layout.rings)
        quiet = estimator.model.voltages(pattern)
        image = partial(pyeit_alone.image, theirs, *peers.numbers(pattern), 1.01 * quiet, quiet)
        slow = float(np.median([seconds_of(image) for _ in range(1 if effort.quick else 3)]))
        step = partial(lambda cycle, fresh: cycle.second_step(*next(fresh)), cycle, fresh)
        jobs: dict[str, Job] = {"ours": step}
        quick = in_turns(jobs, effort.seconds)["ours"]
        yield ratio(name, slow, quick, least=least, note="48 x 48 pixels, 16 new injections")


def framing(effort: Effort) -> Iterator[Figure]:
    """The adaptive frame on 48 x 48 pixels, four adaptive injections with 13 voltages each."""
    cycle, frames = _cycle_and_frames()
    tables = cycle._tables
    u, out = np.ones(len(tables.modes), np.float32), np.zeros(tables.modes.shape[1], np.float32)
    flat = tables.modes.ravel()
    read_once = (tables.modes[: len(tables.base_squares)], tables.modes, tables.mixing, tables.base_columns)
    arrays = [array.ravel() for array in read_once]
    turn = cycled(frames)

    def frame() -> None:
        base, second = next(turn)
        cycle.frame(base, lambda _: second)

    def read_all() -> None:
        for array in arrays:
            read(array)

    jobs: dict[str, Job] = {"product": lambda: combine(u, tables.modes, out), "read": lambda: read(flat)}
    spent = in_turns({**jobs, "frame": frame, "all": read_all}, 3 * effort.seconds)
    yield ratio("image product against one read of its matrix", spent["product"], spent["read"], most=1.2)
    note = f"m = {cycle._n_meas}; {sum(a.nbytes for a in arrays) / 2**20:.1f} MiB, read from the cache"
    yield ratio("adaptive frame against one read of its matrices", spent["frame"], spent["all"], most=3, note=note)
    gc.collect()
    gc.freeze()
    wall = np.array([seconds_of(frame, clock=perf_counter) for _ in range(2000 if effort.quick else 20_000)])
    gc.unfreeze()
    p50, p99 = np.percentile(wall, [50, 99])
    note = f"wall clock, median {duration(p50)}; by CPU time {1 / float(np.median(spent['frame'])):,.0f}/s"
    name = "adaptive frames per second with contacts, device excluded"
    yield Figure.median(name, 1 / wall, "1/s", least=10_000, note=note)
    note = "wall clock; needs an idle machine"
    yield Figure("99th percentile over median of a frame", float(p99 / p50), "times", most=2.5, note=note)


def _cycle_and_frames() -> tuple[CompiledCycle, list[tuple[Scanned, Scanned]]]:
    estimator, _ = set_up(48)
    cycle = compiled(estimator, 4)
    rng, frames = np.random.default_rng(0), []

    def noisy(scanned: Scanned) -> Scanned:
        return scanned[0] + 1e-6 * rng.normal(size=len(scanned[0])), scanned[1]

    for count in rng.integers(1, 4, 16):
        scan = sheets.touched(estimator.model, *rng.uniform(0.03, 0.17, (count, 2)))
        base = noisy(scan(cycle.drive.base))
        frames.append((base, noisy(scan(cycle.pattern(cycle.base_step(*base))))))
    return cycle, frames


def accuracy(effort: Effort) -> Iterator[Figure]:
    """The compiled frame against Gauss-Newton images in float64."""
    cycle, frames = _cycle_and_frames()
    worst = 0.0
    for base, second in frames:
        chosen = cycle.base_step(*base)
        cycle.second_step(*second)
        scans = []
        for pattern, (volts, currents) in ((cycle.drive.base, base), (cycle.pattern(chosen), second)):
            scans.append(Difference(pattern, currents[pattern.measurements[:, 0]], volts))
        exact = cycle.estimator.reconstruct(scans[0]), cycle.estimator.reconstruct(*scans)
        for quick, image in zip((cycle.base_image, cycle.image), exact, strict=True):
            worst = max(worst, float(np.abs(quick - image.values).max() / np.abs(image.values).max()))
    name = "fast frame against dense float64, largest relative error"
    yield Figure(name, worst, "", most=5e-5, note="of the largest value")
