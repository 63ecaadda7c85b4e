"""The shortest tests with other versions of what we depend on: the lowest that pyproject.toml allows, and the newest.

    .venv/bin/python tools/versions.py [lowest-3.11] [newest-3.11] [newest-3.13]

The lowest are tried on the oldest Python that is supported, the newest on that and on the newest one, unless told
otherwise. A Python that is not on this machine is named and left out. What fails is shown whole; the exit status is
then 1.
"""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from tiers import SMOKE  # noqa: E402

TRIED = {
    "lowest-3.11": ("lowest-direct", "3.11"),
    "newest-3.11": ("highest", "3.11"),
    "newest-3.13": ("highest", "3.13"),
}
FILES = {f"tests/{row.partition('::')[0]}" for row in SMOKE}
ALONE = {"tests/test_publish.py"}  # all of these speak in one ROS domain


def find_python(version: str) -> str | None:
    """A Python of that version: on the path, or one of pyenv's."""
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    for name in (sys.executable, f"python{version}", *map(str, sorted(kept.glob(f"{version}.*/bin/python")))):
        told = [name, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        try:
            if subprocess.run(told, capture_output=True, text=True).stdout.strip() == version:
                return name
        except OSError:
            continue
    return None


def install(folder: Path, python: str, resolution: str) -> None:
    """A virtual environment in `folder` with what tests need."""
    uv = [sys.executable, "-m", "uv", "--quiet"]
    subprocess.run([*uv, "venv", "--no-python-downloads", "--python", python, str(folder)], check=True)
    what = ["--python", str(folder), "--resolution", resolution, f"{ROOT}[dev]"]
    subprocess.run([*uv, "pip", "install", *what], check=True, cwd=ROOT)


def run(folder: Path, files: set[str]) -> "subprocess.CompletedProcess[str]":
    """The shortest tests of these files, in that environment."""
    settings = {"NUMBA_CACHE_DIR": str(folder / "numba"), "OPENBLAS_NUM_THREADS": "1"}
    command = [str(folder / "bin" / "python"), "-m", "pytest", "-m", "smoke", "-p", "no:cacheprovider", *sorted(files)]
    return subprocess.run(command, cwd=ROOT, env=os.environ | settings, capture_output=True, text=True)


def installed_and_run(folder: Path, python: str, resolution: str) -> "subprocess.CompletedProcess[str]":
    """Those that may run beside the tests of another environment."""
    install(folder, python, resolution)
    return run(folder, FILES - ALONE)


def main() -> int:
    """Exit status: 0 if all pass that could be run."""
    if unknown := [name for name in sys.argv[1:] if name not in TRIED]:
        sys.exit(f"no versions {unknown[0]!r}; choose from {', '.join(TRIED)}")
    failed = False
    with TemporaryDirectory() as scratch:
        made: dict[str, tuple[Path, str, str]] = {}
        for name in sys.argv[1:] or TRIED:
            resolution, version = TRIED[name]
            title = f"{name.partition('-')[0]} versions on Python {version}"
            if (python := find_python(version)) is None:
                print(f"{title}: not tried, there is no python{version} here", flush=True)
                continue
            made[title] = Path(scratch) / name, python, resolution
        with ThreadPoolExecutor(2) as pool:  # one is installed while another is tried
            done = dict(zip(made, pool.map(lambda one: installed_and_run(*one), made.values()), strict=True))
        for title, (folder, *_) in made.items():
            for tests in (done[title], run(folder, ALONE)):
                failed |= tests.returncode != 0
                print(
                    f"{title}: {tests.stdout[-20000:] if tests.returncode else tests.stdout.strip().splitlines()[-1]}"
                )
                print(tests.stderr[-5000:], end="", file=sys.stderr, flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
