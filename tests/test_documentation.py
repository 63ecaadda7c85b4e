"""What README and docs say to type behind `ohmskin`: every command is understood, and run here or by another test.

Other commands are in test_shell_commands.py."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from command_line import ohmskin
from flawed import flawed_skin
from test_learn import table
from waiting import until

from ohmskin.bench.run import GROUPS
from ohmskin.body import Body
from ohmskin.cli import app
from ohmskin.client import Client
from ohmskin.device.server import DeviceServer
from ohmskin.device.virtual import VirtualInstrument
from ohmskin.evaluate.plan import FIGURES
from ohmskin.evaluate.policies.plan import SECTIONS
from ohmskin.skin import Skin

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted(path for path in (ROOT / "docs").rglob("*.md") if "commands" not in path.name)]
BESIDE = {  # so that they end by themselves, and press the skin that is there
    "live": "--headless --seconds=1",
    "replay": "--headless",
    "patches": "--headless --seconds=2",
    "press": "--device=tcp://127.0.0.1:7155",
    "robot": "--pokes=1",
    "--body": "--hugs=0 --self-touches=0 --free=1",  # these in test_robot.py
    "reproduce": "--only=fig3 --seeds=1 --noise=45 --amplitude=0.1 --jobs=1",
}
ELSEWHERE = {  # what cannot be run here, and what runs it
    "serve-skin": "test_cli.py, until Ctrl-C",
    "--install-completion": "test_cli.py, as it changes the shell's start-up",
    "serve-firmware": "test_firmware_loop.py, with QEMU",
    "check-host": "test_hostile.py, with hosts",
    "electrodes": "test_electrodes_page.py, in a browser",
    "policies": "test_policies.py",
    "bench": "test_scale.py and test_speed.py",
}
OF_OTHERS = {"mine.mat", "datamat_2_1.mat"}  # test_import.py, which writes or has such recordings
DEVICES = ("tcp://127.0.0.1:7155", "tcp://127.0.0.1:7156", "serial:///dev/ttyACM0", "rig:/dev/ttyUSB0,Dev1")
FEWER = {
    "--seconds": "1",
    "--start": "0.1",
    "--pokes": "1",
    "--hugs": "1",
    "--self-touches": "1",
    "--free": "1",
    "--count": "3",
    "--injections": "16",
}


BLOCK = r"^(?:    )?(?:\.venv/bin/)?ohmskin ([a-z-].*)$"
SENTENCE = r"`ohmskin ([a-z-]+ [^`]+)`"


def commands(text: str, where: str = BLOCK) -> Iterator[list[str]]:
    """What a page says in blocks of code, or in sentences, to type behind `ohmskin`, word by word."""
    for line in re.findall(where, text, re.MULTILINE):
        if line.split()[0] in app:
            yield shlex.split(line, comments=True)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_is_understood(page: Path) -> None:
    for words in typed(page.read_text(encoding="utf-8")):
        app.parse_args(words, exit_on_error=False, print_error=False)
        if words[0] in STUDIES:
            only = words[words.index("--only") + 1 :] if "--only" in words else []
            assert {*only} <= {*STUDIES[words[0]]}


STUDIES: dict[str, Collection[str]] = {"policies": SECTIONS, "reproduce": FIGURES, "bench": GROUPS}


def typed(text: str) -> Iterator[list[str]]:
    """All that a page says to type, but for names alone, as `ohmskin live --device` and `ohmskin replay FILE` are."""
    yield from commands(text)
    for words in commands(text, SENTENCE):
        if not words[-1].startswith("--") and not any(word.isupper() and len(word) > 2 for word in words):
            yield words


def alone(*arguments: str, cwd: Path) -> "subprocess.CompletedProcess[str]":
    """The command line in a process of its own: MuJoCo chooses what draws when it is imported, here by other tests."""
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    command = [sys.executable, "-m", "ohmskin", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment)


def until_all_are_felt(*arguments: str, cwd: Path) -> "subprocess.CompletedProcess[str]":
    """`ohmskin patches`, ended once each of its skins has given some frames, not after some seconds (the last word)."""
    command = [sys.executable, "-m", "ohmskin", *arguments[:-1], "120"]
    with (
        subprocess.Popen(command, cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process,
        closing(Client(f"shm:{Body.load(cwd / arguments[1]).name}")) as client,
    ):
        try:
            until(lambda: (told := client.newest()) and min(patch.sequence for patch in told.patches) > 20)
        finally:
            process.terminate()
        said = process.communicate(timeout=60)[1]
    return subprocess.CompletedProcess(arguments, process.returncode, "", said)


def runs(words: list[str]) -> bool:
    """Whether a command is run here: not by other tests, for minutes, or on files of others."""
    return not (words[0] in ELSEWHERE or (words[0] in STUDIES and "--only" in words) or {*words} & OF_OTHERS)


ONCE = {"live", "patches", "self-test", "check-device", "press", "replay", "robot"}  # leave nothing that others take
RAN = set[tuple[object, ...]]()


def run_all(page: Path, folder: Path, device: str) -> list[str]:
    """Run the commands of a page in a folder, one after the other, for seconds instead of for ever; their names."""
    ran = []
    for words in typed(page.read_text(encoding="utf-8")):
        if runs(words):
            words = [word for word in words if word != "--loop"]  # which never ends
            words = [FEWER.get(before, word) for before, word in zip(["", *words], words, strict=False)]
            if "--replay" in words:
                words += ["--headless"]
            elif not {"--headless", "--device", "--compare"} & {*words} or words[0] == "live":
                more = [option.split("=") for word in words for option in BESIDE.get(word, "").split()]
                words += [word for option in more if option[0] not in words for word in option]
            words += ["--name", "documentation"] if "--publish" in words and words[0] == "live" else []  # not "skin"
            ran.append(words[0])
            if words[0] in ONCE and (*words, device == "virtual:") in RAN:
                continue
            RAN.add((*words, device == "virtual:"))
            words = [device if word in DEVICES else word.replace("eth0", "lo") for word in words]
            by_itself = until_all_are_felt if {"patches", "--record"} <= {*words} else ohmskin
            done = (alone if words[0] == "robot" else by_itself)(*words, cwd=folder)
            assert done.returncode == int("--fault" in words), f"{words}: {done.stderr}"  # 1: it found the fault
    return ran


@pytest.fixture
def device() -> Iterator[str]:
    """The address of a virtual skin that is served."""
    with DeviceServer(VirtualInstrument(Skin.load("paper"), seed=1), port=0) as server:
        server.start()
        yield server.url


def test_a_newcomer_records_a_touch(tmp_path: Path) -> None:
    ran = run_all(ROOT / "docs" / "tutorials" / "newcomer.md", tmp_path, "")
    assert ran == ["record", "image", "export", "examples", "image", "replay"]
    assert {"touch.mcap", "touch.png", "example.png"} <= {path.name for path in tmp_path.iterdir()}


@pytest.mark.parametrize("page", ["README.md", "docs/tutorials/robot.md"])
def test_commands_run_as_they_stand(page: str, tmp_path: Path, device: str) -> None:
    with_humanoid(tmp_path)
    assert len(run_all(ROOT / page, tmp_path, device)) >= 5


# --- guides and other pages: what they take for granted is put beside them ------------------------------------------


def with_skins(folder: Path) -> None:
    """Skins of one's own, as `ohmskin calibrate` writes them."""
    for name in ("mine.toml", "my-skin.toml"):
        (folder / name).write_text(Skin.load("paper").dump(), encoding="utf-8")


def with_presses(folder: Path) -> None:
    """A recording of presses at known places."""
    (folder / "my-skin.toml").write_text(Skin.load("paper-rim16").dump(), encoding="utf-8")
    table(flawed_skin(36, 40), folder / "presses.csv", scale=1e3, unit="_mm")


def with_body(folder: Path) -> None:
    """The body of examples/, and the same as the reader's own."""
    shutil.copytree(ROOT / "examples" / "body", folder / "examples" / "body")
    shutil.copytree(ROOT / "examples" / "body", folder, dirs_exist_ok=True)


def with_humanoid(folder: Path) -> None:
    """The humanoid of examples/."""
    shutil.copytree(ROOT / "examples" / "humanoid", folder / "examples" / "humanoid")


NEEDED = {"learning": with_presses, "several-skins": with_body, "robot": with_humanoid, "safety": with_skins}
OTHERS = [page for page in PAGES[1:] if page.parent.name != "tutorials"]
OTHERS = [page for page in OTHERS if any(map(runs, typed(page.read_text("utf-8"))))]


@pytest.mark.parametrize("page", OTHERS, ids=lambda page: page.stem)
def test_commands_of_guides_run_as_they_stand(page: Path, tmp_path: Path, device: str) -> None:
    NEEDED.get(page.stem, with_skins)(tmp_path)
    assert run_all(page, tmp_path, "virtual:" if page.stem == "learning" else device)  # a rim of 16 is not served


EXTRAS = (
    "matplotlib",
    "pyarrow",
    "zenoh",
    "cyclonedds",
    "foxglove",
    "distributed",
    "zarr",
    "sklearn",
    "mujoco",
    "gmsh",
)
BARE = f"import sys; sys.modules.update(dict.fromkeys({EXTRAS})); from ohmskin.cli import main; main()"


def test_a_first_session_needs_no_extra(tmp_path: Path) -> None:
    """README's and the tutorial's commands but those that draw."""
    for line in (
        "info",
        "examples",
        "live --headless --seconds 1",
        "record touch.mcap --seconds 1",
        "export touch.mcap --to csv",
        "replay touch.mcap --headless",
        "self-test",
        "calibrate --no-force",
    ):
        command = [sys.executable, "-c", BARE, *line.split()]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
        assert done.returncode == 0, f"{line}: {done.stderr}"


IDIOMS = (  # with what stands in their place
    ("nothing listens on", "no device at"),
    ("has lost its program", "connection to ohmskin lost"),
    ("waits for device", "waiting for device"),
    ("drawn/s", "displayed fps"),
    ("informed injections", "information-optimal injections"),
    ("tell most", "most informative"),
    ("surer contacts", "more precise"),
    ("double-click it away", "double-click to remove"),
    ("comes out", "confirmed"),
    ("Figures wanted", "Figures to make"),
    ("hardly a voltage", "almost no voltage"),
    ("no free software", "not free software"),
    ("Traps that are gone", "Pitfalls handled for you"),
    ("foretell", "predict"),
    ("adapting pays", "adaptive drive gains"),
    ("how sure it is", "its standard deviation, or confidence"),
    ("stands out of the noise", "exceeds a limit"),
    ("cannot be told apart", "cannot be distinguished"),
    ("Well again", "Recovered"),
    ("what goes wrong", "fault"),
    ("in vain", "without success"),
    ("came out", "were"),
    ("gets nothing of", "does not receive"),
    ("broke: [", "connection lost (reset by peer)"),
    ("connect again; reconnecting", "reconnecting"),
    ("The maps show this place", "Showing 2.44 s of 11.99 s"),
    ("trace of its diagonal", "a small multiple of the identity"),
    ("device's moods", "errors of the device"),
    ("who started this", "the terminal"),
    ("by who uses it", "by the caller"),
    ("cost is not told", "not measured"),
)


def test_idioms_stay_away() -> None:
    files = [
        *PAGES,
        ROOT / "CHANGELOG.md",
        *(path for kind in ("py", "js", "html") for path in (ROOT / "src").rglob(f"*.{kind}")),
    ]
    files = [path for path in files if "vendor" not in path.parts]
    assert len(files) > 300
    texts = {path: " ".join(path.read_text(encoding="utf-8").split()) for path in files}
    found = [
        f"{path}: {idiom!r}; say {better!r}"
        for path, text in texts.items()
        for idiom, better in IDIOMS
        if idiom in text
    ]
    assert found == []
