"""Runs experiments: here, on all cores, or on a Dask cluster; what is already in the cache is not run again."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from typing import Any, TypeVar

from ohmskin.errors import OhmskinError
from ohmskin.evaluate.cache import Cache, fingerprint, key
from ohmskin.evaluate.result import Experiment, Result

SCHEDULER_TIMEOUT = "10s"
Task = TypeVar("Task", bound=Experiment)
_AHEAD = 4  # tasks handed out per process or thread; neither they nor their results may fill the memory

Progress = Callable[[Experiment, bool], None]  # the experiment that is done, and whether it came from the cache


def run_experiments(
    tasks: Iterable[Experiment],
    cache: Cache | None = None,
    jobs: int | None = None,
    scheduler: str = "",
    fresh: bool = False,
    progress: Progress = lambda task, cached: None,
) -> dict[Experiment, Result]:
    """The results of experiments, each kept as soon as it is there.

    Args:
        tasks: What to run; equal ones are run once.
        cache: Where results are kept and looked for.
        jobs: Processes; as many as there are cores unless given. 1 runs everything in this process.
        scheduler: Address of a Dask scheduler, such as ``tcp://host:8786``, to run on its workers instead.
        fresh: Whether to run even what is in the cache.
        progress: Called after each experiment.

    Raises:
        OhmskinError: If `jobs` is not positive, a worker process dies, or the cluster cannot be used.
    """
    if jobs is not None and jobs < 1:
        raise OhmskinError(f"--jobs is {jobs}; it must be 1 or more")
    wanted = list(dict.fromkeys(tasks))
    results: dict[Experiment, Result] = {}
    for task in wanted:
        if cache and not fresh and (kept := cache.load(task)) is not None:
            results[task] = kept
            progress(task, True)
    missing = [task for task in wanted if task not in results]
    for task, result in spread(missing, jobs or os.cpu_count() or 1, scheduler):
        if cache:
            cache.save(task, result)
        results[task] = result
        progress(task, False)
    return {task: results[task] for task in wanted}


def spread(tasks: list[Task], jobs: int, scheduler: str = "") -> Iterator[tuple[Task, Result]]:
    """Run tasks in `jobs` processes (1: in this one) or on a Dask scheduler's workers; results in any order."""
    if not tasks:
        return iter(())
    if scheduler:
        return _on_cluster(tasks, scheduler)
    if jobs == 1:
        return ((task, task.run()) for task in tasks)
    return _on_cores(tasks, jobs)


def _on_cores(tasks: list[Task], jobs: int) -> Iterator[tuple[Task, Result]]:
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # the workers inherit it; each has one core
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(jobs, len(tasks)), spawn, initializer=_die_with_parent)

    def submit(task: Task) -> Future[Result]:
        with _ctrl_c_is_ours():  # this may start a worker
            return pool.submit(_run, task)

    try:
        submitted = ((submit(task), task) for task in tasks)
        futures = dict(islice(submitted, _AHEAD * jobs))
        while futures:
            for future in wait(futures, return_when=FIRST_COMPLETED).done:
                yield futures.pop(future), future.result()
                futures |= dict(islice(submitted, 1))
    except BrokenProcessPool as error:
        raise OhmskinError(
            "a worker process died, perhaps for lack of memory: run again with fewer --jobs, finished parts are kept. "
            "A script must start its run below: if __name__ == '__main__':"
        ) from error
    finally:
        running = list((pool._processes or {}).values())  # of which nothing is known after the shutdown
        pool.shutdown(wait=False, cancel_futures=True)
        for process in running:  # before Python 3.14 there is no public way to stop a running task
            process.terminate()


@contextmanager
def _ctrl_c_is_ours() -> Iterator[None]:
    """Processes that are started meanwhile never see Ctrl-C; this one sees it afterwards."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _run(task: Experiment) -> Result:
    return task.run()


def _die_with_parent() -> None:
    """End this worker when the process that started it is killed, which could not say so."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _on_cluster(tasks: list[Task], scheduler: str) -> Iterator[tuple[Task, Result]]:
    try:
        import distributed
    except ImportError as error:
        raise OhmskinError("--scheduler needs dask.distributed; install it: pip install 'ohmskin[cluster]'") from error
    try:
        dask: Any = distributed  # without type information
        client = dask.Client(scheduler, timeout=SCHEDULER_TIMEOUT, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise OhmskinError(f"no Dask scheduler answers at {scheduler}: {error}; start one: dask scheduler") from error
    with client:
        try:
            versions = client.run(fingerprint)
        except ImportError as error:
            text = f"a worker of {scheduler} cannot import ohmskin: {error}; install this version there"
            raise OhmskinError(text) from error
        if not versions:
            raise OhmskinError(f"the Dask scheduler at {scheduler} has no workers; start some: dask worker {scheduler}")
        for worker, version in versions.items():
            if version != fingerprint():
                text = f"worker {worker} has ohmskin {version}, here is {fingerprint()}"
                raise OhmskinError(f"{text}; install the same version there")
        waiting = ((client.submit(_run, task, key=key(task), pure=False), task) for task in tasks)
        futures = dict(islice(waiting, _AHEAD * sum(client.nthreads().values())))
        arriving = dask.as_completed(list(futures), loop=client.loop)
        for future in arriving:
            yield futures.pop(future), future.result()
            for following, task in islice(waiting, 1):
                futures[following] = task
                arriving.add(following)
