"""The public face of the package."""

import ast
import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import ohmskin


def test_everything_public_is_there_and_lazily_so() -> None:
    for name in ohmskin.__all__:
        assert getattr(ohmskin, name) is not None
    assert set(ohmskin.__all__) == set(ohmskin._HOMES)


def test_editors_are_told_of_all_that_is_public() -> None:
    tree = ast.parse(Path(ohmskin.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    told = {alias.name: node.module for node in imports for alias in node.names}
    assert told == {name: f"ohmskin.{home}" for name, home in ohmskin._HOMES.items()}


def test_every_package_exports_what_it_names() -> None:
    for module in pkgutil.iter_modules(ohmskin.__path__, "ohmskin."):
        if module.name != "ohmskin.__main__":
            package = importlib.import_module(module.name)
            for name in getattr(package, "__all__", []):
                assert hasattr(package, name), f"{module.name}.{name}"


def test_importing_the_package_imports_nothing_heavy() -> None:
    heavy = ("numpy", "scipy", "numba", "matplotlib", "starlette")
    code = f"import sys, ohmskin; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, atexit\n"
        "atexit.register(lambda: print([m for m in ('numpy', 'scipy', 'numba', 'matplotlib') if m in sys.modules]))\n"
        "sys.argv = ['ohmskin', '--help']\nimport ohmskin.cli; ohmskin.cli.main()"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip().endswith("[]")
