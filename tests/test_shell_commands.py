"""Commands of README and docs other than ohmskin's: each is run, here or by what a table names, or it is in the table
of those that cannot be, with the reason, and its form is checked. A command in neither table fails."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_documentation import PAGES, ROOT
from tiers import ARM, CLANG, GCC, MAKE, QEMU

PROGRAMS = {  # what commands within sentences begin with; those in blocks may begin with anything
    *("apt", "apt-get", "bash", "cd", "chrt", "cmake", "colcon", "curl", "docker", "g++", "gcc", "git"),
    *("lerobot-record", "make", "pip", "pytest", "python", "python3", "ros2", "rviz2", "source", "ssh", "st-flash"),
    *("sudo", "systemctl", "uv", ".venv/bin/pytest", ".venv/bin/python"),
}


def fences(text: str) -> Iterator[tuple[str, str]]:
    """Language and text of each fenced block."""
    for _, language, block in re.findall(r"^( *)```(\S*)[^\n]*\n(.*?)^ *```", text, re.MULTILINE | re.DOTALL):
        yield language, block


def shell_commands(text: str) -> set[str]:
    """Commands of a page that are not ohmskin's, in blocks of code and in sentences."""
    blocks = "".join(block for language, block in fences(text) if language == "sh").replace("\\\n", "")
    lines = {" ".join(line.split(" #")[0].split()) for line in blocks.splitlines()}
    lines |= {line.strip() for line in text.splitlines() if re.match(" *python docs", line)}  # in docstrings
    prose = re.sub(r"^ *```.*?^ *```", "", text, flags=re.MULTILINE | re.DOTALL)
    spans = {" ".join(span.split()) for span in re.findall(r"`([^`]+)`", prose) if " " in span}
    found = {line for line in lines if line} | {span for span in spans if span.split()[0] in PROGRAMS}
    return {one for one in found if not re.match(r"(\.venv/bin/)?ohmskin ", one)}  # test_documentation.py


RUN = {  # what is run here, and how: as it stands, or with fewer of something
    "make live": 'make live ARGS="--headless --seconds 1"',
    'make test ARGS="-k cholesky"': 'make test ARGS="-k cholesky -n0 -q --collect-only tests/test_cholesky.py"',
    "make test WORKERS=8": 'make test WORKERS=8 ARGS="-n0 -q --collect-only tests/test_cholesky.py"',
    "make test-all": 'make test-all ARGS="-n0 -q --collect-only tests/test_cholesky.py"',
    "source .venv/bin/activate": "source .venv/bin/activate && ohmskin --version",
    "ssh -L 8000:127.0.0.1:8000 robot": "ssh -G -L 8000:127.0.0.1:8000 robot",  # reads options, connects to nothing
    "python -m ohmskin.client": "python -m ohmskin.client",
    "python -m benchmarks.curved": "python -m benchmarks.curved --places 1 --seeds 1 --skins 2 || [ $? = 1 ]",  # missed
    "python -m benchmarks.estimators": "python -m benchmarks.estimators --places 1",
    "python -m benchmarks.latency": "python -m benchmarks.latency --seconds 1",
    "python -m benchmarks.sensors": "python -m benchmarks.sensors --seeds 1 --places 1 --worlds discs:40"
    " --output {tmp}/modes.json --page {tmp}/modes.md",
    ".venv/bin/pytest tests/test_filter.py": "pytest -n0 -q --collect-only tests/test_filter.py",
    ".venv/bin/python tests/fuzzing.py toml --count 10000 --seed 1": "python tests/fuzzing.py toml --count 3 --seed 1",
}
ELSEWHERE = {  # commands (patterns) and what runs them: a test, or CI
    r"make (lint|docs|test|test-long|test-versions)": ".ci/run",
    r"make check": ".ci/run, which makes lint and all tests, one after the other",
    r"make -C firmware (test|headers|fuzz SECONDS=3600)": "test_firmware.py",
    r"make -C firmware (f107|qemu|build/ohmskin-NAME\.elf)": "test_firmware_loop.py",
    r"python docs/guide/(import_tank|data_quality)\.py( DATA)? \[FOLDER\]": "test_import.py",
    r"python docs/guide/recording\.py \[FOLDER\]": "test_recorder.py",
    r"python docs/guide/\w+\.py( \[FOLDER\])?( \[DATA\])?": "test_guides.py",
    r"python examples/mux_and_daq\.py": "test_conformance.py",
    r"python -m benchmarks\.updates": "test_body_page.py",
    r"python -m ohmskin\.gestures\.train mine\.json": "test_gestures.py",
    r"python -m hatchling build -d dist": "test_package.py",
    r"cd packaging/client && python -m hatchling build -t wheel": "test_package.py",
    r'g\+\+ -std=c\+\+17 -O2 -I"\$\(python -m ohmskin\.client\)" loop\.cpp -o loop': "test_cpp_client.py",
    r"pip install packaging/client integrations/lerobot": "test_lerobot.py",
    r"\.venv/bin/python tools/screens\.py": "test_screens.py",
    r"\.venv/bin/python tools/signatures\.py": "test_compiling.py",
}
LAUNCHED = "|".join(re.findall(r'^    "(\w+)": \(', (ROOT / "ros/ohmskin_ros/launch/skin.launch.py").read_text(), re.M))
DEBIAN = {name for need in (MAKE, GCC, CLANG, ARM, QEMU) for name in need.package.split()}
CANNOT = {  # what cannot be run here: its form (patterns of what follows), and why
    r"make PYTHON=python3\.1[1-3] live": "sets up again, with a Python that may not be here",
    r"make -C firmware flash": "needs a board; test_firmware_loop.py makes what it flashes",
    r"sudo apt-get install( [a-z0-9-]+)+": "changes the machine; .ci/run installs the same",
    r"sudo usermod -aG dialout \$USER": "changes the machine",
    r"chrt -r [1-9]\d?": "needs the right to real-time priority, and a command of the reader's",
    r"colcon build": "needs ROS 2's build tools; test_ros_package.py checks what it installs",
    r"ros2 (bag|launch)": "is a name, and needs ROS 2's command line, of which no wheels exist",
    rf"ros2 launch ohmskin_ros skin\.launch\.py( ({LAUNCHED}):=\S+)+": "needs ros2 launch; test_ros_package.py",
    r"ros2 run ohmskin_ros commands\.py": "needs ros2 run; test_commands.py tests what it calls",
    r"rviz2 -d body\.rviz --ros-args -r /tf:=/ohmskin/half/tf": "needs RViz; test_body_replay.py reads its file",
    r"lerobot-record( --(robot|teleop)\.[a-z]+=('[^']+'|\S+))+ \.\.\.": "needs LeRobot and an arm; test_lerobot.py",
}


EXTRA = "|".join(tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"])
PIP = rf"pip install '?(ohmskin|\.)(\[({EXTRA})(,({EXTRA}))*\])?'?"


def kind(command: str) -> str:
    """Which of the tables has a command; empty if none has."""
    if command in RUN:
        return "run"
    if re.fullmatch(PIP, command):
        return "pip"
    for name, table in (("elsewhere", ELSEWHERE), ("cannot", CANNOT)):
        if any(re.fullmatch(pattern, command) for pattern in table):
            return name
    return ""


COMMANDS = {command for page in PAGES for command in shell_commands(page.read_text(encoding="utf-8"))}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_is_run_or_listed_with_the_reason_why_not(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert {command for command in shell_commands(text) if not kind(command)} == set()
    for language, block in fences(text):
        outside = [line for line in block.splitlines() if line.split(" ")[0] in PROGRAMS]
        assert language in ("sh", "cpp", "python") or not outside, (
            f"a command in a block of {language or 'no language'}"
        )


def test_tables_have_no_command_that_no_page_has_and_name_files_that_are_there() -> None:
    assert {*RUN} <= COMMANDS
    for pattern, where in (ELSEWHERE | CANNOT).items():
        assert any(re.fullmatch(pattern, command) for command in COMMANDS), pattern
        for file in re.findall(r"test_\w+\.py", where):
            assert (ROOT / "tests" / file).is_file()
    for command in COMMANDS:
        if script := re.match(r"\S*python ((?:docs|examples|tools)\S+)\.py", command):
            where = next(where for pattern, where in ELSEWHERE.items() if re.fullmatch(pattern, command))
            assert Path(script[1]).name in (ROOT / "tests" / where).read_text(encoding="utf-8"), command
    ran = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert all(f"make {target}" in ran for target in ("lint", "docs", "test", "test-long", "test-versions"))
    (installed,) = (one for one in COMMANDS if one.startswith("sudo apt-get"))
    assert {*installed.split()[3:]} <= DEBIAN


@pytest.mark.parametrize(
    "wrong",
    [
        *("make dosc", "make -C firmware flahs", "python -m benchmarks.none", "sudo rm x", "colcon build --symlink"),
        *("pip install 'ohmskin[plots]'", "ls x", "ssh robot", "chrt -f 5", "docker run x", "./mine.sh", "gmsh a.geo"),
        "ros2 launch ohmskin_ros skin.launch.py rivz:=true",
    ],
)
def test_commands_that_no_table_has_are_found(wrong: str) -> None:
    assert shell_commands(f"```sh\n{wrong}   # as it is\n```\n") == {wrong}
    assert kind(wrong) == ""


@pytest.mark.parametrize("command", RUN)
def test_a_command_runs(command: str, tmp_path: Path) -> None:
    if (program := shlex.split(command)[0]) in ("make", "ssh") and not shutil.which(program):
        pytest.skip(f"needs {program}")
    if program in ("make", "source") and not (ROOT / ".venv" / ".ready").exists():
        pytest.skip("needs the environment that `make live` sets up")
    line = RUN[command].replace("{tmp}", str(tmp_path))
    shell = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(["bash", "-c", line], cwd=ROOT, env=shell, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr


def test_what_pip_installs_can_be_installed() -> None:
    """All in one, without an index: the environment of these tests has every extra, and builds the project."""
    asked = {word for one in COMMANDS if kind(one) == "pip" for word in shlex.split(one)[2:]}
    assert {".[plot]", "ohmskin[zenoh]", "ohmskin[learn]"} <= asked
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--no-index", "--no-build-isolation"]
    for words in (sorted(word for word in asked if word[0] == "."), sorted(word for word in asked if word[0] != ".")):
        done = subprocess.run([*command, *words], cwd=ROOT, capture_output=True, text=True, timeout=300)
        assert (done.returncode, "does not provide the extra" in done.stderr) == (0, False), done.stderr
