"""What the documentation says to type: every command is understood; those of README and tutorials are run."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import ohmskin

from ohmskin.cli import app
from ohmskin.device.server import DeviceServer
from ohmskin.device.virtual import VirtualInstrument
from ohmskin.skin import Skin

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted(path for path in (ROOT / "docs").rglob("*.md") if "commands" not in path.name)]
BESIDE = {  # so that they end by themselves, and press the skin that is there
    "live": ["--headless", "--seconds", "1"],
    "replay": ["--headless"],
    "press": ["--device", "tcp://127.0.0.1:7155"],
}
ELSEWHERE = {"serve-skin", "--install-completion"}  # runs until Ctrl-C; changes the shell's start-up: test_cli.py


BLOCK = r"^(?:    )?(?:\.venv/bin/)?ohmskin ([a-z-].*)$"
SENTENCE = r"`ohmskin ([a-z-]+ [^`]+)`"


def commands(text: str, where: str = BLOCK) -> Iterator[list[str]]:
    """What a page says in blocks of code, or in sentences, to type behind `ohmskin`, word by word."""
    for line in re.findall(where, text, re.MULTILINE):
        if line.split()[0] in app:
            yield shlex.split(line, comments=True)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_is_understood(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for words in (*commands(text), *commands(text, SENTENCE)):
        named = words[-1].startswith("--") or any(word.isupper() and len(word) > 2 for word in words)
        if not named:  # as `ohmskin live --device` and `ohmskin replay FILE` are, in a sentence
            app.parse_args(words, exit_on_error=False, print_error=False)


def run_all(page: Path, folder: Path, device: str) -> list[str]:
    """Run the commands of a page in a folder, one after the other, for seconds instead of for ever; their names."""
    ran = []
    for words in commands(page.read_text(encoding="utf-8")):
        if words[0] not in ELSEWHERE:
            words += [] if "--headless" in words else BESIDE.get(words[0], [])
            words += ["--name", "documentation"] if "--publish" in words else []  # "skin" may be another test's
            words = [word.replace("tcp://127.0.0.1:7155", device) for word in words]
            words = ["1" if before == "--seconds" else word for before, word in zip(["", *words], words, strict=False)]
            done = ohmskin(*words, cwd=folder)
            assert done.returncode == 0, f"{words}: {done.stderr}"
            ran.append(words[0])
    return ran


@pytest.fixture
def device() -> Iterator[str]:
    """The address of a virtual skin that is served."""
    with DeviceServer(VirtualInstrument(Skin.load("paper"), seed=1), port=0) as server:
        server.start()
        yield server.url


def test_a_newcomer_records_a_touch(tmp_path: Path) -> None:
    ran = run_all(ROOT / "docs" / "tutorials" / "newcomer.md", tmp_path, "")
    assert ran == ["record", "image", "export", "examples", "image"]
    assert {"touch.mcap", "touch.png", "example.png"} <= {path.name for path in tmp_path.iterdir()}


@pytest.mark.parametrize("page", ["README.md", "docs/tutorials/robot.md"])
def test_commands_run_as_they_stand(page: str, tmp_path: Path, device: str) -> None:
    assert len(run_all(ROOT / page, tmp_path, device)) >= 5
