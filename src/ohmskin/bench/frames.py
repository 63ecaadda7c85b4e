"""Figures of single frames: a new drive pattern, the adaptive frame, its accuracy."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import cycle as cycled
from time import perf_counter, process_time

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.bench import peers
from ohmskin.bench.clock import Effort, Job, duration, in_turns, ratio, read
from ohmskin.bench.figure import Figure
from ohmskin.bench.tasks import set_up
from ohmskin.drive import DRIVES, DriveSettings, TwoScans
from ohmskin.forward import TransferModel
from ohmskin.geometry import Electrodes
from ohmskin.scan import Difference, DrivePattern, adjacent
from ohmskin.sensing import CompiledCycle
from ohmskin.sensing.primitives import combine

NO_PEER = "pyEIT is not installed: pip install 'ohmskin[bench]'"


def in_once(job: Callable[[], object], rounds: int) -> Floats:
    """CPU seconds (rounds,) of a job that takes too long to be repeated for nothing."""
    spent = []
    for _ in range(rounds):
        start = process_time()
        job()
        spent.append(process_time() - start)
    return np.array(spent)


def changing(effort: Effort) -> Iterator[Figure]:
    """A drive pattern never driven before, to the image of one frame and its contacts."""
    rng = np.random.default_rng(0)
    for cells, least in ((24, 1000), (48, 10_000)):
        estimator, _ = set_up(cells)
        layout, mesh = estimator.model.electrodes, estimator.model.mesh
        name = f"change of drive pattern to image, {mesh.n_elem:,} triangles, against pyEIT"
        cycle = CompiledCycle(estimator, _eq7(layout, 16), (0.005, 0.005), fuse=False)
        touched = np.where(np.linalg.norm(mesh.centroids - [0.07, 0.12], axis=1) < 0.01, 1.5, 1.0)
        pressed = estimator.model.with_conductivity(estimator.model.conductivity * touched)
        choices = [rng.permutation(120)[:16] for _ in range(256)]
        changes = [pressed.voltages(p, 1e-3) - estimator.model.voltages(p, 1e-3) for p in map(cycle.pattern, choices)]
        fresh, currents = cycled(zip(changes, choices, strict=True)), np.full(16, 1e-3)

        if not peers.has_pyeit():
            yield Figure(name, None, "times", least=least, note=NO_PEER)
            continue
        theirs = peers.pyeit_mesh(mesh.nodes, mesh.elements, mesh.nodes_at(layout.positions))
        pattern = adjacent(layout.rings)
        quiet = estimator.model.voltages(pattern)
        slow = in_once(partial(peers.pyeit_image, theirs, pattern, 1.01 * quiet, quiet), 1 if effort.quick else 3)
        quick = in_turns({"ours": partial(_next_image, cycle, fresh, currents)}, effort.seconds)["ours"]
        yield ratio(name, np.median(slow, keepdims=True), quick, least=least, note="48 x 48 pixels, 16 new injections")


def _next_image(cycle: CompiledCycle, fresh: Iterator[tuple[Floats, Ints]], currents: Floats) -> None:
    change, chosen = next(fresh)
    cycle.see(change, currents, chosen)


def framing(effort: Effort) -> Iterator[Figure]:
    """The adaptive frame on 48 x 48 pixels, four adaptive injections with 13 voltages each."""
    cycle, frames = _cycle_and_frames()
    tables = cycle._tables
    u, out = np.ones(len(tables.modes), np.float32), np.zeros(tables.modes.shape[1], np.float32)
    flat = tables.modes.ravel()
    read_once = (tables.modes[: len(tables.base_squares)], tables.modes, tables.mixing, tables.base_columns)
    arrays = [array.ravel() for array in read_once]
    turn = iter(range(10**9))

    def frame() -> None:
        base, second = frames[next(turn) % len(frames)]
        cycle.frame(base, lambda _: second)

    def read_all() -> None:
        for array in arrays:
            read(array)

    jobs: dict[str, Job] = {"product": lambda: combine(u, tables.modes, out), "read": lambda: read(flat)}
    spent = in_turns({**jobs, "frame": frame, "all": read_all}, 3 * effort.seconds)
    yield ratio("image product against one read of its matrix", spent["product"], spent["read"], most=1.2)
    note = f"m = {cycle._n_meas}; {sum(a.nbytes for a in arrays) / 2**20:.1f} MiB, read from the cache"
    yield ratio("adaptive frame against one read of its matrices", spent["frame"], spent["all"], most=3, note=note)
    import gc

    gc.collect()
    gc.freeze()
    wall = []
    for _ in range(2000 if effort.quick else 20_000):
        start = perf_counter()
        frame()
        wall.append(perf_counter() - start)
    gc.unfreeze()
    p50, p99 = np.percentile(wall, [50, 99])
    low, high = (1 / np.percentile(wall, q) for q in (75, 25))
    yield Figure(
        "adaptive frames per second with contacts, device excluded", 1 / p50, "1/s", least=10_000, low=low, high=high,
        note=f"wall clock, median {duration(p50)}; by CPU time {1 / float(np.median(spent['frame'])):,.0f}/s",
    )  # fmt: skip
    note = "wall clock; asks for a quiet machine"
    yield Figure("99th percentile over median of a frame", float(p99 / p50), "times", most=2.5, note=note)


def _eq7(layout: Electrodes, pairs: int) -> TwoScans:
    drive = DRIVES["eq7"](DriveSettings(layout, pairs=pairs), 0)
    assert isinstance(drive, TwoScans)
    return drive


def _cycle_and_frames() -> tuple[CompiledCycle, list[tuple[tuple[Floats, Floats], tuple[Floats, Floats]]]]:
    estimator, _ = set_up(48)
    model = estimator.model
    cycle = CompiledCycle(estimator, _eq7(model.electrodes, 4), (0.005, 0.005))
    rng, frames = np.random.default_rng(0), []
    for count in rng.integers(1, 4, 16):
        touched = model.conductivity.copy()
        for place in rng.uniform(0.03, 0.17, (count, 2)):
            touched[np.linalg.norm(model.mesh.centroids - place, axis=1) < 0.01] *= 1.5
        pressed = model.with_conductivity(touched)

        def scanned(pattern: DrivePattern, pressed: TransferModel = pressed) -> tuple[Floats, Floats]:
            volts = pressed.voltages(pattern, 1e-3) - model.voltages(pattern, 1e-3)
            return volts + 1e-6 * rng.normal(size=pattern.n_meas), np.full(pattern.n_inj, 1e-3)

        base = scanned(cycle.drive.base)
        frames.append((base, scanned(cycle.pattern(cycle.look(*base)))))
    return cycle, frames


def accuracy(effort: Effort) -> Iterator[Figure]:
    """The compiled frame against Gauss-Newton images in float64."""
    cycle, frames = _cycle_and_frames()
    worst = 0.0
    for base, second in frames:
        chosen = cycle.look(*base)
        cycle.see(*second)
        scans = []
        for pattern, (volts, currents) in ((cycle.drive.base, base), (cycle.pattern(chosen), second)):
            scans.append(Difference(pattern, currents[pattern.measurements[:, 0]], volts))
        exact = cycle.estimator.reconstruct(scans[0]), cycle.estimator.reconstruct(*scans)
        for quick, image in zip((cycle.base_image, cycle.image), exact, strict=True):
            worst = max(worst, float(np.abs(quick - image.values).max() / np.abs(image.values).max()))
    name = "fast frame against dense float64, largest relative error"
    yield Figure(name, worst, "", most=5e-5, note="of the largest value")
