"""The examples of the guide to the forward model run without a display and leave their pictures; its pages show their code."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
GUIDE = ROOT / "docs" / "guide"
EXAMPLES = ("forward.py", "meshes.py")
PAGES = ("forward.md", "meshes.md")


@pytest.mark.parametrize("name", EXAMPLES)
def test_example_runs_and_leaves_its_picture(name: str, tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {"OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-W", "error", str(GUIDE / name), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (picture,) = tmp_path.glob("*.png")
    assert picture.name == name.replace(".py", ".png")
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert str(picture) in done.stdout


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_page_shows_the_code_and_the_picture_of_each_example(name: str) -> None:
    pages = [(GUIDE / page).read_text() for page in PAGES]
    code = (GUIDE / name).read_text()
    (page,) = [text for text in pages if f"```python\n{code}```" in text]
    assert f"(../images/guide/{name.replace('.py', '.png')})" in page
    assert f"python docs/guide/{name}" in code


@pytest.mark.parametrize("name", PAGES)
def test_links_of_a_page_lead_somewhere(name: str) -> None:
    for link in re.findall(r"\]\(([^)#:]+)\)", (GUIDE / name).read_text()):
        assert (GUIDE / link).exists(), link
