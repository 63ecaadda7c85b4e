"""The reproduction as a whole: cache, resumption, cluster, command line, report."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from command_line import ohmskin

from ohmskin.cli import app
from ohmskin.errors import OhmskinError
from ohmskin.evaluate.cache import Cache, key
from ohmskin.evaluate.experiments import Localisation
from ohmskin.evaluate.plan import FIGURES, Settings, plan
from ohmskin.evaluate.reproduction import reproduce
from ohmskin.evaluate.runner import run_experiments
from ohmskin.evaluate.verdict import NO, OPEN, YES

TINY = Settings(
    noise=(45.0, 50.0), amplitude=(0.1,), seeds=2, distances=(0.04, 0.02), side=3, assumptions=("same mesh",)
)
BRIEF = [Localisation("discs", float(db), 0.1, 1, side=2, methods=("12B", "16O")) for db in (40, 60)]
LONG = [Localisation("discs", float(db), 0.1, 25, side=3, methods=("12B", "16O")) for db in range(40, 56, 2)]


def same(a, b) -> bool:
    return a.keys() == b.keys() and all(
        np.array_equal(a[name], b[name], equal_nan=a[name].dtype.kind == "f") for name in a
    )


def test_results_are_kept_and_found_again(tmp_path: Path) -> None:
    cache, seen = Cache(tmp_path), []
    first = run_experiments(BRIEF, cache, jobs=1, progress=lambda task, cached: seen.append(cached))
    again = run_experiments(BRIEF, cache, jobs=1, progress=lambda task, cached: seen.append(cached))
    assert seen == [False] * 2 + [True] * 2
    assert all(same(first[task], again[task]) for task in BRIEF)
    assert not list(tmp_path.glob("*.part"))
    fresh: list[bool] = []
    run_experiments(BRIEF[:1], cache, jobs=1, fresh=True, progress=lambda task, cached: fresh.append(cached))
    assert fresh == [False]


def test_a_damaged_or_cut_file_is_computed_anew(tmp_path: Path) -> None:
    cache = Cache(tmp_path)
    whole = run_experiments(BRIEF[:1], cache, jobs=1)[BRIEF[0]]
    (file,) = tmp_path.glob("*.npz")
    for damage in (file.read_bytes()[:200], b"", b"nonsense"):
        file.write_bytes(damage)
        assert cache.load(BRIEF[0]) is None
    assert same(run_experiments(BRIEF[:1], cache, jobs=1)[BRIEF[0]], whole)


def test_other_parameters_and_other_code_have_other_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = {key(task) for task in (*BRIEF, *LONG)}
    assert len(keys) == len(BRIEF) + len(LONG)
    before = key(BRIEF[0])
    monkeypatch.setattr("ohmskin.evaluate.cache.fingerprint", lambda: "9.9.9+other")
    assert key(BRIEF[0]) != before


def test_processes_and_a_dask_cluster_give_the_same_results() -> None:
    distributed = pytest.importorskip("distributed")
    here = run_experiments(BRIEF, jobs=1)
    assert all(same(result, here[task]) for task, result in run_experiments(BRIEF, jobs=2).items())
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        there = run_experiments(BRIEF, scheduler=cluster.scheduler_address)
        with distributed.Client(cluster, set_as_default=False) as client:
            assert len(client.scheduler_info()["workers"]) == 2
            ran = client.run(lambda: sys.modules["ohmskin.evaluate.worlds"].touched.cache_info().currsize)
    assert all(same(there[task], here[task]) for task in BRIEF)
    assert len(ran) == 2
    assert sum(ran.values()) > 0  # the work was done there


def test_a_killed_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    script = (
        "from pathlib import Path\nimport sys\nfrom ohmskin.evaluate.cache import Cache\n"
        "from ohmskin.evaluate.experiments import Localisation\nfrom ohmskin.evaluate.runner import run_experiments\n"
        "if __name__ == '__main__':\n"
        "    levels, methods = range(40, 56, 2), ('12B', '16O')\n"
        "    tasks = [Localisation('discs', float(db), 0.1, 25, side=3, methods=methods) for db in levels]\n"
        "    run_experiments(tasks, Cache(Path(sys.argv[1])), jobs=2)\n"
    )
    (tmp_path / "run.py").write_text(script)
    kept = tmp_path / "kept"
    process = subprocess.Popen([sys.executable, str(tmp_path / "run.py"), str(kept)])
    try:
        deadline = time.monotonic() + 120
        while len(list(kept.glob("*.npz"))) < 2 and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        workers = psutil.Process(process.pid).children(recursive=True)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    _, alive = psutil.wait_procs(workers, timeout=20)
    assert not alive, "workers outlived the run that started them"
    before = len(list(kept.glob("*.npz")))
    assert 2 <= before < len(LONG)
    seen: list[bool] = []
    results = run_experiments(LONG, Cache(kept), jobs=2, progress=lambda task, cached: seen.append(cached))
    assert sum(seen) == before
    assert same(results[LONG[0]], LONG[0].run())


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every figure once, with little data; warnings are errors."""
    folder = tmp_path_factory.mktemp("paper")
    seen = plan(TINY)
    path = reproduce(folder, TINY, jobs=1)
    assert path == folder / "report.html"
    assert len(list((folder / "cache").glob("*.npz"))) == len(
        {task for group in seen.values() for task in group.values()}
    )
    return path


def test_the_report_needs_nothing_else(report: Path) -> None:
    page = report.read_text(encoding="utf-8")
    assert not re.search(r"""(?:src|href)=['"](?!data:|#)|url\(|@import|<script""", page)
    assert "{{" not in page
    assert not re.search(r"<t[hd]>(SR|R)[<,]", page)  # one name for one quantity
    for figure in FIGURES:
        assert f"id='{figure}'" in page
    assert page.count("data:image/png;base64,") == len(list((report.parent / "figures").glob("*.png"))) == 12


def test_the_report_opens_with_a_tally_and_the_key_claims_best_first(report: Path) -> None:
    page = report.read_text(encoding="utf-8")
    opening = re.sub("<[^>]+>", "\n", page[page.index("In short") : page.index("How it was done")])
    claims = json.loads((report.parent / "claims.json").read_text())["claims"]
    verdicts = [claim["verdict"] for claim in claims]
    tally = f"{verdicts.count(YES)} of {len(claims)} tested claims of the paper are confirmed"
    assert opening.index(tally) < opening.index("claims of")
    listed = re.findall(rf"^(?:{YES}|{OPEN}|{NO})$", opening[opening.index("\nverdict\n") :], re.MULTILINE)
    assert len(listed) == sum(claim["key"] for claim in claims)
    assert listed == sorted(listed, key=[YES, OPEN, NO].index)


def test_a_quantity_has_one_name(report: Path) -> None:
    """The paper's R and SR are RNG and RES, in tables, captions and claims."""
    page = re.sub("<[^>]+>", "\n", report.read_text(encoding="utf-8"))
    assert {"RNG", "RES"} <= set(re.findall(r"\b[A-Z]{2,3}\b", page))
    assert "RES and RNG are the paper's SR and R." in page
    assert not re.search(r"\bSR\b|\n *R *\n", page.replace("RES and RNG are the paper's SR and R.", ""))


def test_every_number_is_there_as_json(report: Path) -> None:
    for figure, group in plan(TINY).items():
        data = json.loads((report.parent / "data" / f"{figure}.json").read_text())
        assert set(data["experiments"]) == set(group)
        for entry in data["experiments"].values():
            assert entry["parameters"]["seeds"] >= 2
            assert entry["results"]
    claims = json.loads((report.parent / "claims.json").read_text())["claims"]
    assert {claim["verdict"] for claim in claims} <= {YES, NO, OPEN}
    assert {claim["figure"] for claim in claims} == set(FIGURES) - {"sweep", "assumptions"}
    assert all(claim["paper"] and claim["here"] for claim in claims)


def test_a_second_run_takes_all_results_from_the_cache_of_the_first(report: Path, tmp_path: Path) -> None:
    folder, cache = str(tmp_path / "part"), str(report.parent / "cache")
    app(
        [
            "reproduce",
            "--quick",
            "--noise",
            "45",
            "50",
            "--seeds",
            "2",
            "--only",
            "fig5",
            "table1",
            "--cache",
            cache,
            "--output",
            folder,
        ]
    )
    assert len(list(Path(cache).glob("*.npz"))) == len(
        {task for group in plan(TINY).values() for task in group.values()}
    )
    assert {path.name for path in (tmp_path / "part" / "figures").iterdir()} == {"fig5.png", "table1.png"}


def test_pictures_are_large_and_captions_stand_alone(report: Path) -> None:
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", report.read_text(encoding="utf-8"), re.S)
    assert len(captions) == 12
    assert all(len(caption) > 150 and ("seed" in caption) for caption in captions)
    for picture in (report.parent / "figures").glob("*.png"):
        width = int.from_bytes(picture.read_bytes()[16:20], "big")
        assert width >= 1400, picture


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--only", "fig9"], "choose from fig3"),
        (["--noise", "-5"], "0 to 200 dB"),
        (["--amplitude", "0"], "prior amplitudes"),
        (["--seeds", "0"], "seeds are 0"),
        (["--only", "fig5", "--jobs", "0"], "--jobs is 0"),
        (["--only", "fig5", "--scheduler", "tcp://127.0.0.1:1"], "no Dask scheduler answers"),
        (["--output", "FILE"], "--output"),
        (["--only", "fig5", "--cache", "FILE/x"], "--cache"),
    ],
)
def test_a_mistake_is_told_in_one_line(options, message, tmp_path, monkeypatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ohmskin.evaluate.runner.SCHEDULER_TIMEOUT", "0.2s")
    with pytest.raises(OhmskinError, match=re.escape(message)) as told:
        app(["reproduce", *(option.replace("FILE", str(tmp_path / "file")) for option in options)])
    assert "\n" not in str(told.value)


def test_a_mistake_on_the_command_line_has_no_traceback(tmp_path: Path) -> None:
    done = ohmskin("reproduce", "--only", "fig9", "--output", str(tmp_path / "new"))
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "choose from fig3" in done.stderr
    assert not (tmp_path / "new").exists()


def test_a_missing_extra_names_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(Exception, match=r"pip install 'ohmskin\[cluster\]'"):
        run_experiments(BRIEF, scheduler="tcp://127.0.0.1:1")


def test_the_full_plan_is_as_thorough_as_promised() -> None:
    assert "assumptions" not in plan(Settings.quick())  # whose figure would be empty
    groups = plan(Settings())
    assert set(groups) == set(FIGURES)
    assert all(task.seeds >= 5 for task in groups.pop("assumptions").values())
    assert all(task.seeds >= 20 for group in groups.values() for task in group.values())
    assert {round(d * 1e3) for d in Settings().distances} >= {60, 55, 50, 45, 40, 35, *range(8, 31)}
    assert len({name.split("/")[1] for name in groups["sweep"]}) == 2  # both ways of making data
