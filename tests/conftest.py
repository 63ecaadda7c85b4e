"""Shared by the tests: markers and needs, what every process must leave behind, and dear fixtures."""

import os

# Before NumPy comes: small solves are quicker with one thread, and the same to the last bit. Before numba comes: what
# one worker has compiled, no other one has to.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_CACHE_DIR", os.path.abspath(f"{__file__}/../../.pytest_cache/numba"))
os.environ.setdefault("OHMSKIN_CACHE", os.path.abspath(f"{__file__}/../../.pytest_cache/ohmskin"))

import faulthandler
import shutil
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from leftovers import Leftovers
from tiers import CHROMIUM, needs, rows
from units import Units, unit

ROOT = Path(__file__).parents[1]
CHROMIUM_FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",  # WebGL without a GPU
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
END = float(os.environ.get("TESTS_END", "30"))  # s that a process may take to end after its last test
LEFTOVERS = Leftovers()
hypothesis.settings.register_profile("patient", deadline=None)  # others on the machine slow an example down
hypothesis.settings.load_profile("patient")


@pytest.hookimpl(trylast=True)
def pytest_sessionstart() -> None:
    """Workers compile nothing twice, and never mix up the index of what is kept of one function."""
    from ohmskin.compiler import take_turns

    take_turns()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give each test the markers of the table; the files that take longest come first, so that workers end together."""
    for item in items:
        for row in rows(item.path.name, item.name):
            item.add_marker(getattr(pytest.mark, row.marker)(reason=row.reason))
    items.sort(key=lambda item: unit(item.path.name, item.name))  # a stable sort: within a file nothing moves


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Units:
    """Workers take files, and long tests of some files by themselves, in the order of the table."""
    return Units(config, log)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test whose needs are not there; in CI it fails."""
    for row in rows(item.path.name, item.name):
        for need in row.needs:
            needs(*need.names, package=need.package)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """In CI nothing may be skipped: a skip is a missing package there, and counts as a failure."""
    report = yield
    if os.environ.get("CI") and report.skipped:
        report.outcome = "failed"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, None, None]:
    """A file of tests must leave neither a thread that holds the process nor a child process, whatever failed in it."""
    failed: BaseException | None = None
    try:
        yield
    except BaseException as error:
        failed = error
        raise
    finally:
        if (nextitem is None or nextitem.path != item.path) and (left := LEFTOVERS.end()):
            message = f"{item.path.name} left behind: {'; '.join(left)}"
            if failed is None:
                pytest.fail(message, pytrace=False)
            failed.add_note(message)


def pytest_unconfigure(config: pytest.Config) -> None:
    """Whatever keeps the interpreter from ending is shown and ended; xdist ends its own workers."""
    if not hasattr(config, "workerinput"):  # not by xdist's variable, which a pytest that a test starts inherits
        faulthandler.dump_traceback_later(END, exit=True, file=sys.__stderr__)


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A browser, the system's Chromium."""
    from playwright.sync_api import sync_playwright

    needs(*CHROMIUM.names, package=CHROMIUM.package)
    path = next(path for name in CHROMIUM.names if (path := shutil.which(name)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=CHROMIUM_FLAGS)
        LEFTOVERS.keep()
        yield browser
        browser.close()


def recordings(name: str) -> Path:
    """A folder of recordings beside the repository."""
    folder = ROOT.parent / "shared" / "data" / name
    if not folder.is_dir():
        pytest.skip(f"needs the recordings of shared/data/{name} beside the repository")
    return folder


@pytest.fixture(scope="session")
def uef_folder() -> Path:
    """Folder of the open 2D EIT data of the University of Eastern Finland."""
    return recordings("uef2017")


@pytest.fixture(scope="session")
def tank_folder() -> Path:
    """Folder of the tank recordings."""
    return recordings("tank_pyeidors")
