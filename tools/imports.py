"""Import circles between modules, files over 350 lines and lines over 120 characters: what `make lint` checks besides.

    python tools/imports.py src/ohmskin tests

An import counts wherever it stands: within a function, under TYPE_CHECKING, or by name, as the text "package.module" or
"package.module:object", or as an f-string that begins with the package's name, f"package.{name}", which counts for
every text in its module that makes it the name of a module.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

LONGEST_FILE = 350  # lines
LONGEST_LINE = 120  # characters
_KINDS = {".py", ".js", ".css", ".html"}


def modules(package: Path) -> dict[str, Path]:
    """The file of each module of a package, by the module's full name."""
    found = {}
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def graph(package: Path) -> dict[str, set[str]]:
    """The modules that each module of a package imports."""
    known = modules(package)
    return {name: _imported(name, path, known) - {name} for name, path in known.items()}


def _imported(name: str, path: Path, known: dict[str, Path]) -> set[str]:
    found, texts, prefixes = set(), set(), set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            source = _absolute(name, path, node)
            members = {f"{source}.{alias.name}" for alias in node.names}
            found |= members & known.keys()
            if members - known.keys():
                found.add(source)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            texts.add(node.value)
        elif isinstance(node, ast.JoinedStr) and isinstance(first := node.values[0], ast.Constant):
            prefixes.add(str(first.value))
    root = next(iter(known)).partition(".")[0]
    own = {prefix for prefix in prefixes if re.fullmatch(rf"{root}(\.\w+)*\.", prefix)}
    named = {text.partition(":")[0] for text in texts if text.startswith(f"{root}.")}
    return (found | named | {prefix + text for prefix in own for text in texts}) & known.keys()


def _absolute(name: str, path: Path, node: ast.ImportFrom) -> str:
    """The module that a `from` names, a relative one made absolute."""
    if not node.level:
        return node.module or ""
    parts = name.split(".")
    kept = len(parts) - node.level + (path.name == "__init__.py")
    return ".".join([*parts[:kept], *([node.module] if node.module else [])])


def circles(imports: dict[str, set[str]]) -> list[list[str]]:
    """One circle, the shortest from its first module, of each set of modules that import each other."""
    reached = {name: _reachable(imports, name) for name in imports}
    found, done = [], set()
    for name in sorted(imports):
        if name in reached[name] and name not in done:
            done |= {other for other in reached[name] if name in reached[other]}
            found.append(_way_round(imports, name))
    return found


def _reachable(imports: dict[str, set[str]], start: str) -> set[str]:
    seen, waiting = set(), [start]
    while waiting:
        new = imports[waiting.pop()] - seen
        seen |= new
        waiting.extend(new)
    return seen


def _way_round(imports: dict[str, set[str]], start: str) -> list[str]:
    ways = [[start]]
    for way in ways:  # grows while it is read: breadth first
        for following in sorted(imports[way[-1]]):
            if following == start:
                return [*way, start]
            if all(following not in other for other in ways):
                ways.append([*way, following])
    raise AssertionError(f"{start} is in no circle")


def by_package(imports: dict[str, set[str]]) -> dict[str, set[str]]:
    """The same between the packages and modules directly below the root."""
    merged: dict[str, set[str]] = {}
    for name, imported in imports.items():
        own = merged.setdefault(_branch(name), set())
        own |= {_branch(other) for other in imported} - {_branch(name)}
    return merged


def _branch(name: str) -> str:
    return ".".join(name.split(".")[:2])


def lengths(folder: Path, longest_file: int | None = LONGEST_FILE) -> Iterator[str]:
    """What is too long in a folder's sources, in words."""
    for path in sorted(p for p in folder.rglob("*") if p.suffix in _KINDS and "vendor" not in p.parts):
        lines = path.read_text(encoding="utf-8").splitlines()
        if longest_file and len(lines) > longest_file:
            yield f"{path}: {len(lines)} lines; at most {longest_file}, one noun to a file"
        for number, line in enumerate(lines, 1):
            if len(line) > LONGEST_LINE:
                yield f"{path}:{number}: {len(line)} characters; at most {LONGEST_LINE}"


def main(package: str, *others: str) -> int:
    """Print what is wrong; 1 if anything is."""
    imports = graph(Path(package))
    found = circles(imports) + circles(by_package(imports))
    wrong = [f"import circle: {' -> '.join(circle)}" for circle in found]
    wrong += lengths(Path(package))
    for folder in others:
        wrong += lengths(Path(folder), None)
    print("\n".join(wrong) or "no import circle; no file or line too long")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
