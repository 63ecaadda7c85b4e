"""The tests' own rules: tables that name tests which exist, needs that name packages, runs that end whatever fails."""

import os
import re
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

import psutil
import pytest
from tiers import LONG, TABLE, Need, needs
from units import SLOWEST, unit

FOLDER = Path(__file__).parent
FAILING = """
import subprocess, sys, threading
import pytest

@pytest.fixture(scope="module")
def broken():
    threading.Thread(target=threading.Event().wait).start()
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
    print("child", child.pid)
    raise RuntimeError("set-up failed")

def test_one(broken):
    pass
"""


def test_every_row_names_a_test_that_exists() -> None:
    found = {
        f"{path.name}::{name}"
        for path in FOLDER.glob("test_*.py")
        for name in re.findall(r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert found
    for row in TABLE:
        pattern = row.tests.partition("[[]")[0]  # without the parameters
        assert any(fnmatch(name, pattern if "::" in pattern else f"{pattern}::*") for name in found), row.tests
    assert all(LONG.values())
    for row in SLOWEST:
        assert any(fnmatch(name, row) for name in found) if "::" in row else (FOLDER / row).exists(), row


def test_what_shares_fixtures_is_shared_out_together() -> None:
    alone = unit("test_independent.py", "test_a_contact_that_degrades_is_no_touch[0-4.0-16P]")
    assert alone[1] == "test_independent.py::test_a_contact_that_degrades_is_no_touch[0-4.0-16P]"
    together = [unit("test_independent.py", f"test_a_quiet_skin_is_quiet[{seed}]") for seed in (0, 1)]
    assert together == [(SLOWEST.index("test_independent.py"), "test_independent.py")] * 2
    assert together[0] < alone < unit("test_of_no_row.py", "test_one") == (len(SLOWEST), "test_of_no_row.py")


def test_what_is_missing_is_skipped_with_its_package_and_fails_in_ci(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Need(("no-such-program", sys.executable), "none").met()
    assert Need(("libc.so.6",), "libc6").met()
    assert not Need(("libno-such.so.1",), "none").met()
    monkeypatch.delenv("CI", raising=False)
    with pytest.raises(pytest.skip.Exception, match="needs no-such-program: apt-get install nowhere"):
        needs("no-such-program", package="nowhere")
    monkeypatch.setenv("CI", "true")
    with pytest.raises(pytest.fail.Exception, match="apt-get install nowhere"):
        needs("no-such-program", package="nowhere")


def test_a_run_ends_after_a_failed_set_up_and_takes_its_children_with_it(tmp_path: Path) -> None:
    (tmp_path / "test_failing.py").write_text(FAILING)
    path = os.pathsep.join([str(FOLDER), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "pytest", "-p", "conftest", "-p", "no:zarr", "--rootdir", str(tmp_path)]
    done = subprocess.run(
        [*command, "-c", os.devnull, str(tmp_path)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": path, "TESTS_END": "2"},
        capture_output=True,
        text=True,
        timeout=500,
    )
    assert done.returncode != 0
    assert "set-up failed" in done.stdout
    assert "left behind: thread" in done.stdout
    number, *_ = re.findall(r"^child (\d+)", done.stdout, re.MULTILINE)
    child = int(number)
    assert not psutil.pid_exists(child) or psutil.Process(child).status() == psutil.STATUS_ZOMBIE
