"""Shared by the tests."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy comes: small solves are quicker so, and the same to the last bit
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import shutil
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest

CHROMIUM_FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """In CI nothing may be skipped: a skip is a missing package there, and counts as a failure."""
    report = yield
    if os.environ.get("CI") and report.skipped:
        report.outcome = "failed"
    return report


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A browser, the system's Chromium."""
    from playwright.sync_api import sync_playwright

    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=CHROMIUM_FLAGS)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def uef_folder() -> Path:
    """Folder of the open 2D EIT data of the University of Eastern Finland."""
    folder = Path(__file__).parents[2] / "shared" / "data" / "uef2017"
    if not folder.is_dir():
        pytest.skip(f"needs the UEF recordings in {folder.parent.parent.name}/data beside the repository")
    return folder


@pytest.fixture(scope="session")
def tank_folder() -> Path:
    """Folder of the tank recordings."""
    folder = Path(__file__).parents[2] / "shared" / "data" / "tank_pyeidors"
    if not folder.is_dir():
        pytest.skip(f"needs the tank recordings in {folder.parent.parent.name}/data beside the repository")
    return folder
