"""Sphinx extension: the pages of the reference that come from the code, and a check that no public name is missing.

A package is public if it has an `__all__`; each gets a page in reference/api with a table of its names and each of
them. A name that several packages export is described once, where it is defined; the others link to it. The page of
the commands is what cyclopts makes of their help. A public name without documentation, or one that the built site
lacks, is a warning, which `make docs` takes for an error.
"""

import importlib
import inspect
import pkgutil
import re
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from sphinx.application import Sphinx
from sphinx.errors import PycodeError
from sphinx.pycode import ModuleAnalyzer
from sphinx.util import logging

import ohmskin
from ohmskin.cli import app as commands

SECTIONS = {"Args", "Attributes", "Raises", "Returns", "Yields"}  # of docstrings, which napoleon reads
log = logging.getLogger(__name__)


@cache
def packages() -> tuple[ModuleType, ...]:
    """The public packages, `ohmskin` first."""
    inner = [found.name for found in pkgutil.walk_packages(ohmskin.__path__, "ohmskin.") if found.ispkg]
    return ohmskin, *(package for name in inner if hasattr(package := importlib.import_module(name), "__all__"))


def home(package: ModuleType, name: str) -> str:
    """The full name under which a public name is described: that of the exporting package nearest to its definition."""
    thing = getattr(package, name)
    defined = f"{getattr(thing, '__module__', '')}."
    exporting = [one.__name__ for one in packages() if getattr(one, name, None) is thing and name in one.__all__]
    nearest = [one for one in exporting if defined.startswith(f"{one}.")]
    return f"{max(nearest or exporting, key=len)}.{name}"


def entry(package: ModuleType, name: str) -> str:
    """The directive that describes a public name."""
    thing = getattr(package, name)
    if inspect.isclass(thing) or inspect.isroutine(thing) or hasattr(thing, "py_func"):
        kind = "exception" if inspect.isclass(thing) and issubclass(thing, Exception) else "class"
        return f".. auto{kind if inspect.isclass(thing) else 'function'}:: {name}\n"
    return f".. py:data:: {name}\n\n   {constant(package, name)}\n"


def constant(package: ModuleType, name: str) -> str:
    """The documentation of a constant: the text below its assignment, in the module of the package that has it."""
    for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        try:
            texts = ModuleAnalyzer.for_module(found.name).find_attr_docs()
        except PycodeError:
            continue
        if ("", name) in texts:
            return " ".join(texts["", name]).strip()
    return ""


def page(package: ModuleType) -> str:
    """The page of a package: what it is for, a table of its names, and each that is described here."""
    title = (
        f"{package.__name__}\n{'=' * len(package.__name__)}\n\n.. automodule:: {package.__name__}\n   :no-members:\n\n"
    )
    homes = {name: home(package, name) for name in package.__all__}
    table = "\n".join(f"   * - :py:obj:`~{at}`\n     - {summary(package, name)}" for name, at in homes.items())
    described = "\n".join(entry(package, name) for name, at in homes.items() if at == f"{package.__name__}.{name}")
    return (
        f"{title}.. list-table::\n   :widths: auto\n\n{table}\n\n.. currentmodule:: {package.__name__}\n\n{described}"
    )


def summary(package: ModuleType, name: str) -> str:
    """The first sentence of the documentation of a public name."""
    text = first(getattr(package, name)) if entry(package, name).startswith(".. auto") else constant(package, name)
    if not text:
        log.warning("%s.%s has no documentation", package.__name__, name)
    return text


def first(thing: object) -> str:
    """The first paragraph of the docstring of something, on one line."""
    return (inspect.getdoc(thing) or "").partition("\n\n")[0].replace("\n", " ")


def heading(found: "re.Match[str]") -> str:
    """What stands in place of a heading of cyclopts: it lists all commands twice."""
    return "# Commands" if found[0] == "# ohmskin" else ""


def write(app: Sphinx) -> None:
    """Write the pages; those that have not changed are left alone, so that Sphinx need not read them again."""
    folder = Path(app.srcdir) / "reference"
    pages = {folder / "api" / f"{package.__name__}.rst": page(package) for package in packages()}
    rows = [f"| [{one.__name__}](api/{one.__name__}.rst) | {first(one)} |" for one in packages()]
    pages[folder / "api" / "packages.txt"] = "\n".join(["| package | content |", "|---|---|", *rows, ""])
    told = commands.generate_docs(output_format="markdown", recursive=True)
    contents = r"^# ohmskin$|^## Table of Contents\n(\n|- .*\n)*"
    pages[folder / "commands.md"] = re.sub(contents, heading, told, flags=re.MULTILINE)
    for path, text in pages.items():
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def mark_blocks(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Mark indented blocks of a docstring, which are code or equations, as literal; sections such as `Args` are not."""
    marked, inside, section = list[str](), False, False
    if what == "property":
        lines[0] = lines[0].replace(": ", " - ", 1)  # napoleon takes what is before a colon for a type
    for line in lines:
        indented = line.startswith("    ")
        if line.strip() and not indented:
            inside, section = False, line.rstrip(":") in SECTIONS
        elif indented and not inside and not section:
            marked += ["::", ""]
            inside = True
        marked.append(line)
    lines[:] = marked


def skip(app: Sphinx, what: str, name: str, thing: Any, skipped: bool, options: Any) -> bool | None:
    """Leave out the fields of named tuples: the `Attributes` of their class describe them."""
    return True if (inspect.getdoc(thing) or "").startswith("Alias for field number") else None


def check(app: Sphinx, error: Exception | None) -> None:
    """Warn of public names that the site lacks."""
    described = {entry[0] for entry in app.env.get_domain("py").get_objects()}
    for package in packages() if error is None else ():
        for name in package.__all__:
            if home(package, name) not in described:
                log.warning("%s.%s is public and not in the API reference", package.__name__, name)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.connect("builder-inited", write)
    app.connect("autodoc-process-docstring", mark_blocks, priority=400)  # before napoleon's
    app.connect("autodoc-skip-member", skip)
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
