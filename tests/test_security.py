"""Only this machine by default, only data from outside, and limits on all of it."""

import ast
import inspect
import os
import re
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

import ohmskin
from ohmskin.client.remote import is_loopback
from ohmskin.device.protocol import MAX_PACKET, PacketDecoder
from ohmskin.device.server import DeviceServer
from ohmskin.errors import OhmskinError, SkinError, ViewError
from ohmskin.outlets.outlet import open_outlet
from ohmskin.outlets.topics import contacts_topic
from ohmskin.skin import Skin
from ohmskin.view import LiveView
from ohmskin.view.overview import Overview
from ohmskin.view.wire import LARGEST_COMMAND, CommandError, read_command

SOURCES = sorted(Path(ohmskin.__file__).parent.rglob("*.py"))

MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "yaml", "jsonpickle", "xmlrpc"}
CALLS = {"eval", "exec", "compile", "__import__", "os.system", "os.popen", "np.loadtxt", "np.fromfile", "yaml.load"}


def faults(text: str) -> list[str]:
    """What in a source would run data as code, or take them for more than data."""
    found = []
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Import(names=names):
                found += [name.name for name in names if name.name.split(".")[0] in MODULES]
            case ast.ImportFrom(module=str(module)) if module.split(".")[0] in MODULES:
                found.append(module)
            case ast.Call(func=function):
                name = ast.unparse(function)
                keywords = {keyword.arg: keyword.value for keyword in node.keywords}
                if name in CALLS:
                    found.append(name)
                if (
                    "allow_pickle" in keywords and ast.unparse(keywords["allow_pickle"]) != "False"
                ):  # NumPy's default is False
                    found.append(f"{name} with allow_pickle")
                if "shell" in keywords and ast.unparse(keywords["shell"]) != "False":
                    found.append("shell=True")
    return found


def test_no_source_runs_data_as_code() -> None:
    assert len(SOURCES) > 100
    assert {str(path): found for path in SOURCES if (found := faults(path.read_text(encoding="utf-8")))} == {}


@pytest.mark.parametrize(
    "text",
    [
        "import pickle",
        "from pickle import load",
        "def f():\n    import dill.source",
        "x = eval('1')",
        "np.load(f, allow_pickle=trusted)",
        "np.load(f, allow_pickle=True)",
        "subprocess.run(c, shell=True)",
        "os.system('x')",
        "import yaml",
    ],
)
def test_the_search_finds_what_it_looks_for(text: str) -> None:
    assert len(faults(text)) == 1


def test_the_page_runs_no_text_as_code() -> None:
    static = Path(ohmskin.__file__).parent / "view" / "static"
    for path in [*static.glob("*.js"), *static.glob("*.html")]:
        text = path.read_text(encoding="utf-8")
        assert not re.search(
            r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function|https?://(?!www\.w3\.org)",
            text,
        ), path


# --- this machine only ------------------------------------------------------------------------------------------------


def test_every_host_is_loopback_unless_told() -> None:
    """Every function and class of ours that takes a host takes this machine's unless another is given."""
    seen = 0
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                arguments = [*node.args.posonlyargs, *node.args.args]
                defaults: list[Any] = [None] * (len(arguments) - len(node.args.defaults)) + node.args.defaults
                pairs = [
                    *zip(arguments, defaults, strict=True),
                    *zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True),
                ]
                for argument, default in pairs:
                    if argument.arg == "host" and default is not None:
                        assert ast.literal_eval(default) == "127.0.0.1", f"{path}: {node.name}"
                        seen += 1
            elif isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "host" and node.value is not None:
                assert ast.literal_eval(node.value) == "127.0.0.1", f"{path}: line {node.lineno}"
                seen += 1
    assert seen >= 5
    assert inspect.signature(DeviceServer).parameters["host"].default == "127.0.0.1"


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.0.7", "robot.example", ""])
def test_what_others_can_reach_needs_a_token_where_there_is_such_a_thing(host: str) -> None:
    assert not is_loopback(host)
    with pytest.raises(ViewError, match="token"):
        LiveView({}, host=host)
    with pytest.raises(ViewError, match="token"):
        Overview("torso", [], host=host)
    if host:
        with pytest.raises(OhmskinError, match="--token"):
            open_outlet(
                f"zenoh:listen/tcp/{f'[{host}]' if ':' in host else host}:7447", [contacts_topic("skin")], "test", None
            )


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.9.10", "::1", "[::1]", "localhost"])
def test_loopback_addresses_are_known(host: str) -> None:
    assert is_loopback(host)


# --- limits -----------------------------------------------------------------------------------------------------------


def test_a_skin_file_has_a_largest_size(tmp_path: Path) -> None:
    path = tmp_path / "skin.toml"
    path.write_text("#" * 2**20, encoding="utf-8")
    assert Skin.load(path) == Skin()
    path.write_text("#" * (2**20 + 1), encoding="utf-8")
    with pytest.raises(SkinError, match="more than 1048576 bytes"):
        Skin.load(path)
    path.unlink()
    path.symlink_to("/dev/zero")  # which never ends
    with pytest.raises(SkinError, match="more than"):
        Skin.load(path)


@pytest.mark.parametrize(
    "text", [f"x = {'[' * 100_000}", f"x = {'[' * 9000}{']' * 9000}", f"name = {'9' * 5000}", "x = {a = {b = 1}}"]
)
def test_a_skin_that_would_break_its_reader_gives_one_error(text: str) -> None:
    with pytest.raises(SkinError):
        Skin.parse(text)


def test_a_line_that_never_ends_takes_no_memory() -> None:
    decoder = PacketDecoder()
    tracemalloc.start()
    for _ in range(2000):
        assert decoder.feed(b"x" * 4096) == []
    assert tracemalloc.get_traced_memory()[1] < 8 * MAX_PACKET  # of 8 MB
    tracemalloc.stop()
    assert decoder.tally.overlong == 1


@pytest.mark.parametrize(
    "text", ["[" * LARGEST_COMMAND, '{"type":' * 500, "9" * LARGEST_COMMAND, '"' + "x" * 4000 + '"']
)
def test_a_browser_cannot_break_the_page_with_nesting(text: str) -> None:
    with pytest.raises(CommandError):
        read_command(text, {"modes": [], "press": None})


def test_a_token_is_no_argument_of_another_process() -> None:
    """Arguments of a process can be seen by all users of the machine; what we start is told its token through a
    pipe."""
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("subprocess.Popen", "Child"):
                assert "token" not in ast.unparse(node.args[0]), path


def test_boards_are_nobody_elses(tmp_path: Path) -> None:
    code = (
        "import os, stat\nfrom ohmskin.client import Board\nfrom ohmskin.client.board import board_folder\n"
        "os.umask(0)\nb = Board('skin', {}, 10)\n"
        "print(*(oct(stat.S_IMODE(p.stat().st_mode)) for p in [board_folder(), *board_folder().iterdir()]))"
    )
    environment = os.environ | {"OHMSKIN_BOARDS": str(tmp_path / "boards")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.stdout.split() == ["0o700", "0o600", "0o600"], done.stderr
