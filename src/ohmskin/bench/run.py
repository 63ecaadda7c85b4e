"""The figures of the benchmark, in groups that can be run by themselves."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from time import perf_counter

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ohmskin.arrays import Floats, Ints
from ohmskin.bench import peers, pyeit_alone, sheets
from ohmskin.bench.clock import Effort, Job, duration, in_turns, ratio, read, seconds_of
from ohmskin.bench.figure import Figure
from ohmskin.bench.fits import fitting
from ohmskin.bench.frames import accuracy, changing, framing
from ohmskin.bench.growth import bigger
from ohmskin.bench.live import living
from ohmskin.bench.starts import starting
from ohmskin.bench.tasks import apart
from ohmskin.bench.together import together
from ohmskin.errors import OhmskinError
from ohmskin.forward import TouchTable, TransferModel
from ohmskin.forward.assembly import System, assemble
from ohmskin.scan import adjacent

Group = Callable[[Effort], Iterator[Figure]]


def machine(effort: Effort) -> Iterator[Figure]:
    """What this machine can do: speed of reading memory and of products of matrices, one thread."""
    large = np.ones(2**26 if not effort.quick else 2**24, np.float32)
    small = np.ones(2**18, np.float32)
    for where, array in (("memory", large), ("the cache", small)):
        spent = in_turns({"read": lambda array=array: read(array)}, effort.seconds / 2)["read"]  # type: ignore[misc]
        name = f"reading {array.nbytes / 2**20:.0f} MiB from {where}"
        yield Figure.median(name, array.nbytes / spent / 1e9, "GB/s")
    for kind in (np.float64, np.float32):
        square = np.random.default_rng(0).normal(size=(768, 768)).astype(kind)
        spent = in_turns({"product": partial(np.matmul, square, square)}, effort.seconds / 2)["product"]
        yield Figure.median(f"product of matrices, {np.dtype(kind).name}", 2 * 768**3 / spent / 1e9, "GFLOP/s")


def setting_up(effort: Effort) -> Iterator[Figure]:
    """From nodes and triangles to the first image, against pyEIT's JAC, each in a process of its own."""
    name = "set-up to first image, 4,608 triangles, against pyEIT's JAC"
    apart("ours", cells=24)  # compiles what is not compiled yet, which takes memory
    own, theirs = apart("ours", cells=48), peers.pyeit_apart(48)
    if "error" in own or "error" in theirs:
        yield Figure(name, None, "times", least=100, note=own.get("error") or theirs["error"])
        return
    yield ratio(name, theirs["seconds"], own["seconds"], least=100)
    note = f"peaks of the whole process {theirs['peak']:.0f} / {own['peak']:.0f} MiB, of which"
    note += f" {theirs['before']:.0f} / {own['before']:.0f} before the sheet"
    data = {"ours": own, "pyeit": theirs}
    yield Figure("memory of the same", theirs["peak"] / own["peak"], "times", least=5, note=note, data=data)


def fields(effort: Effort) -> Iterator[Figure]:
    """Fields and the sensitivity of all electrode pairs, against pyEIT's Jacobian of one pattern."""
    layout = sheets.electrodes()
    for cells, least in ((33, 100), (72, 400)):
        mesh, pattern = sheets.mesh(cells), adjacent(layout.rings)
        name = f"fields and sensitivity of all pairs, {mesh.n_elem:,} triangles, against pyEIT's Jacobian"
        if not peers.has_pyeit():
            yield Figure(name, None, "times", least=least, note=peers.MISSING)
            continue
        jacobian = partial(pyeit_alone.jacobian, peers.pyeit_mesh(mesh, layout), *peers.numbers(pattern))
        build = partial(TransferModel, mesh, layout, sheets.CONDUCTIVITY)
        jobs: dict[str, Job] = {"ours": lambda build=build: build().pair_sensitivity}  # type: ignore[misc]
        quick = in_turns(jobs, effort.seconds)["ours"]
        slow = float(np.median([seconds_of(jacobian) for _ in range(1 if cells > 50 else 3)]))
        again = in_turns(jobs, effort.seconds)["ours"]
        yield ratio(name, slow, np.concatenate([quick, again]), least=least)


def _grounded(system: System) -> tuple[Ints, Floats]:
    """The unknowns that are left with the first electrode grounded, and a load of 1 A at each of 15 others."""
    free = np.delete(np.arange(system.matrix.shape[0]), system.terminals[0])
    load = np.zeros((system.matrix.shape[0], 15))
    load[system.terminals[1:], np.arange(15)] = 1.0
    return free, load


def solving(effort: Effort) -> Iterator[Figure]:
    """Factorise and solve for 15 injections, against SciPy's `splu` with default settings and tuned."""
    mesh = sheets.mesh(72)
    system = assemble(mesh, sheets.electrodes(), np.full(mesh.n_elem, sheets.CONDUCTIVITY))
    free, load = _grounded(system)
    grounded = sp.csc_matrix(system.matrix[free][:, free])
    ordered = system.elimination()
    best = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True, "Equil": False}}
    spent = in_turns(
        {
            "splu": lambda: splu(grounded).solve(load[free]),
            "tuned": lambda: splu(grounded, **best).solve(load[free]),
            "ours": lambda: system.factorise().solve(load),
            "again": lambda: ordered.factorise(system.matrix.data).solve(load),
        },
        2 * effort.seconds,
    )
    where = "factorise and solve, 10,368 triangles"
    yield ratio(
        f"{where}, against splu with default settings", spent["splu"], spent["ours"], least=4, note="order found anew"
    )
    yield ratio(f"{where}, order known, against splu with default settings", spent["splu"], spent["again"])
    yield ratio(f"{where}, against splu tuned for symmetry", spent["tuned"], spent["ours"])


def touching(effort: Effort) -> Iterator[Figure]:
    """Touches simulated exactly, against factorising the touched sheet anew."""
    cells = 72
    model = TransferModel(sheets.mesh(cells), sheets.electrodes(), sheets.CONDUCTIVITY)
    places = [sheets.square(cells, c, r, 3) for c in range(0, cells, 3) for r in range(0, cells, 3)]
    table = TouchTable(model, places)
    rng = np.random.default_rng(0)
    count = 2000
    where, change = rng.integers(0, len(table), (count, 1)), rng.uniform(0.1, 5, (count, 1))
    touched = model.conductivity.copy()
    touched[places[5]] *= 2
    free, load = _grounded(assemble(model.mesh, model.electrodes, touched))

    def anew() -> None:
        matrix = assemble(model.mesh, model.electrodes, touched).matrix
        splu(sp.csc_matrix(matrix[free][:, free])).solve(load[free])

    jobs: dict[str, Job] = {"table": lambda: table.many(where, change), "splu": anew}
    spent = in_turns({**jobs, "ours": lambda: model.with_conductivity(touched)}, 3 * effort.seconds)
    one = spent["table"] / count
    name = "one touch simulated exactly, 10,368 triangles"
    yield ratio(f"{name}, against refactorising with splu", spent["splu"], one, least=5000)
    yield ratio(f"{name}, against our own factorisation", spent["ours"], one, least=700)
    work = rng.integers(0, len(table), (20 * count, 2)), rng.uniform(0.1, 5, (20 * count, 2))
    wall: dict[int, list[float]] = {1: [], 2: []}
    table.many(*work, threads=2)
    for _ in range(3 if effort.quick else 9):
        for threads, times in wall.items():
            times.append(seconds_of(partial(table.many, *work, threads=threads), clock=perf_counter))
    one, two, note = np.array(wall[1]), np.array(wall[2]), "wall clock; needs two idle cores"
    yield ratio("simulated touches, two cores against one", one, two, least=1.7, note=note)


def scaling(effort: Effort) -> Iterator[Figure]:
    """Growth of the set-up with the number of triangles, and its memory."""
    sizes: Sequence[int] = (24, 72, 225) if effort.quick else (24, 48, 72, 141, 225, 450, 708)
    found = {2 * cells**2: apart("ours", cells=cells) for cells in sizes}
    if errors := [f["error"] for f in found.values() if "error" in f]:
        yield Figure("growth of the set-up", None, "power of n", most=1.2, note=errors[0])
        return
    n, seconds = np.array(list(found)), np.array([f["seconds"] for f in found.values()])
    large = n >= 10_000
    power = float(np.polyfit(np.log(n[large]), np.log(seconds[large]), 1)[0])
    note = ", ".join(f"{a:,}: {duration(s)}" for a, s in zip(n, seconds, strict=True))
    data = {"triangles": n.tolist(), "seconds": seconds.tolist(), "stages": [f["stages"] for f in found.values()]}
    name = f"growth of the set-up, 10k to {n[-1]:,} triangles"
    yield Figure(name, power, "power of n", most=1.2, note=note, data=data)
    peak = found[int(n[-1])]["peak"] / 1024
    most = None if effort.quick else 4.0
    yield Figure(f"peak memory at {n[-1]:,} triangles and 16 electrodes", peak, "GiB", most=most, note="whole process")


GROUPS: dict[str, Group] = {
    "machine": machine,
    "setup": setting_up,
    "fields": fields,
    "pattern": changing,
    "solver": solving,
    "frame": framing,
    "fits": fitting,
    "live": living,
    "touches": touching,
    "scale": scaling,
    "electrodes": bigger,
    "body": together,
    "accuracy": accuracy,
    "start": starting,
}
"""Groups of figures by name, as `ohmskin bench --only` names them."""


def run(
    quick: bool = False, only: Sequence[str] = (), report: Callable[[str, str], None] = lambda _, __: None
) -> Iterator[tuple[str, list[Figure]]]:
    """Measure, group by group: the name and the figures of each, once it is done.

    Args:
        quick: Smaller sizes and fewer rounds.
        only: Names of groups; all of `GROUPS` unless given.
        report: Called with a group's name and an empty text when it begins, and with the name of each of its figures.

    Raises:
        OhmskinError: If there is no such group; the message lists those there are.
    """
    if unknown := [name for name in only if name not in GROUPS]:
        raise OhmskinError(f"no benchmark {unknown[0]!r}; choose from {', '.join(GROUPS)}")
    return ((name, _measured(name, Effort(0.6 if quick else 3.0, quick), report)) for name in only or GROUPS)


def _measured(name: str, effort: Effort, report: Callable[[str, str], None]) -> list[Figure]:
    report(name, "")
    figures = []
    for figure in GROUPS[name](effort):
        figures.append(figure)
        report(name, figure.name)
    return figures
