"""An example runs as its first lines say, without a display, and leaves a picture; `make docs` runs all of them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "examples"
EXAMPLES = sorted(path.name for path in FOLDER.glob("[0-9]*.py"))


def test_there_are_six_short_ones_that_say_how_they_are_run() -> None:
    assert len(EXAMPLES) == 6
    for name in EXAMPLES:
        text = (FOLDER / name).read_text(encoding="utf-8")
        assert f"python examples/{name}" in text
        assert len(text.splitlines()) < 65


@pytest.mark.parametrize("name", EXAMPLES[1:2])
def test_example(name: str, tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {"OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-W", "error", str(FOLDER / name), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=500, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (picture,) = tmp_path.glob("*.png")
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert str(picture) in done.stdout
