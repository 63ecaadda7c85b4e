"""The tool that photographs the pages."""

import subprocess
import sys
from pathlib import Path

from PIL import Image

TOOL = Path(__file__).parents[1] / "tools" / "screens.py"


def screens(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([sys.executable, TOOL, *arguments], capture_output=True, text=True, timeout=300)


def test_states_are_photographed_in_both_themes(tmp_path: Path) -> None:
    done = screens("--output", str(tmp_path), "--widths", "320", "--", "quiet")
    assert done.returncode == 0, done.stderr
    pictures = {path.name: Image.open(path).convert("L") for path in tmp_path.iterdir()}
    assert set(pictures) == {"quiet-320-light.png", "quiet-320-dark.png"}
    assert {picture.width for picture in pictures.values()} == {320}
    light, dark = (pictures[f"quiet-320-{theme}.png"].getpixel((2, 2)) for theme in ("light", "dark"))
    assert light > 200 > 40 > dark


def test_a_state_that_is_none_is_refused_with_a_list() -> None:
    refused = screens("nosuch")
    assert refused.returncode == 2
    assert "no state nosuch; choose from body, docs, doubt" in refused.stderr
