"""The check of imports and lengths that `make lint` runs."""

from pathlib import Path

import pytest

from tools.imports import LONGEST_FILE, LONGEST_LINE, circles, graph, main


def _package(folder: Path, files: dict[str, str]) -> Path:
    package = folder / "skin"
    for name, text in {"__init__": "", **files}.items():
        path = package / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return package


BACK = {
    "plain": "import skin.b",
    "from": "from skin.b import thing",
    "submodule": "from skin import b",
    "relative": "from .b import thing",
    "within a function": "def late():\n    from skin.b import thing\n    return thing",
    "for types alone": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from skin.b import thing",
    "by name": "from importlib import import_module\nthing = lambda: import_module('skin.b')",
    "an entry of a table": "TABLE = {'b': 'skin.b:thing'}",
    "a made name": "TABLE = {'thing': 'b'}\ndef late(name):\n    return import_module(f'skin.{TABLE[name]}')",
}


@pytest.mark.parametrize("way", BACK)
def test_a_circle_is_found_however_a_module_is_imported(tmp_path: Path, way: str) -> None:
    package = _package(tmp_path, {"a": BACK[way], "b": "from skin.c import thing", "c": "from skin.a import thing"})
    assert circles(graph(package)) == [["skin.a", "skin.b", "skin.c", "skin.a"]]


def test_a_package_may_import_its_parts_but_they_not_it(tmp_path: Path) -> None:
    parts = {"__init__": "from skin.a import thing", "a": "import skin.b", "b": "'''Of skin.a, in words.'''"}
    package = _package(tmp_path, parts)
    assert circles(graph(package)) == []
    (package / "b.py").write_text("import skin")
    assert circles(graph(package)) == [["skin", "skin.a", "skin.b", "skin"]]


def test_packages_that_import_each_other_fail_though_their_modules_do_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parts = {"low/__init__": "", "high/__init__": "", "low/a": "import skin.high.b", "high/c": "import skin.low.d"}
    package = _package(tmp_path, {**parts, "low/d": "", "high/b": ""})
    assert circles(graph(package)) == []
    assert main(str(package)) == 1
    assert "skin.high -> skin.low -> skin.high" in capsys.readouterr().out


def test_long_files_and_lines_fail(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    package = _package(tmp_path, {"a": "x = 1\n" * LONGEST_FILE})
    assert main(str(package)) == 0
    (package / "a.py").write_text("x = 1\n" * (LONGEST_FILE + 1))
    (package / "page.css").write_text("/" * (LONGEST_LINE + 1))
    assert main(str(package)) == 1
    said = capsys.readouterr().out
    assert "a.py: 351 lines" in said
    assert "page.css:1: 121 characters" in said
    assert main(str(_package(tmp_path / "short", {})), str(package)) == 1
    assert " lines; " not in capsys.readouterr().out  # tests may be long files, but not of long lines
