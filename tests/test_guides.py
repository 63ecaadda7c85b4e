"""The examples of the guide run without a display and leave their pictures; its pages show their code."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
GUIDE = ROOT / "docs" / "guide"
EXAMPLES = (
    *("forward.py", "meshes.py", "priors.py", "estimators.py", "estimators_tank.py", "regularisation.py"),
    *("drive_design.py", "tracking.py", "curved.py", "learning.py"),
)
TANK = ROOT.parent / "shared" / "data" / "uef2017"


@pytest.mark.parametrize("name", EXAMPLES)
def test_example_runs_and_leaves_its_picture(name: str, tmp_path: Path) -> None:
    if name.endswith("_tank.py") and not TANK.is_dir():
        pytest.skip("needs the tank recordings in shared/data/uef2017 beside the repository")
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {"OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-W", "error", str(GUIDE / name), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=500, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (picture,) = tmp_path.glob("*.png")
    assert picture.name == name.replace(".py", ".png")
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert str(picture) in done.stdout


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_page_shows_the_code_and_the_picture_of_each_example(name: str) -> None:
    pages = [page.read_text() for page in GUIDE.glob("*.md")]
    code = (GUIDE / name).read_text()
    (page,) = [text for text in pages if f"```python\n{code}```" in text]
    assert f"(../images/guide/{name.replace('.py', '.png')})" in page
    assert f"python docs/guide/{name}" in code


def test_a_drive_an_estimator_and_a_prior_of_ones_own_are_chosen_by_name() -> None:
    """What docs/contributing.md promises: functions and lines of tables, then loop and skin file have them."""
    code, page = (GUIDE / "extend.py").read_text(), (GUIDE / "extend.md").read_text()
    assert f"```python\n{code}```" in page
    command = [sys.executable, "-W", "error", str(GUIDE / "extend.py")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    assert f"```\n{done.stdout}```" in page
    found = re.search(r"mine-too: felt at \(([\d.]+), ([\d.]+)\)", done.stdout)
    assert found is not None
    x, y = map(float, found.groups())
    assert abs(x - 50) < 2
    assert abs(y - 120) < 2
