"""What the reference says: `make docs` takes its pages from `__all__`, and their text from docstrings."""

import ast
import importlib
import inspect
import pkgutil
import re
import sys
import textwrap
from collections.abc import Iterator
from enum import Enum
from functools import reduce
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import ohmskin
from ohmskin import errors


class Public(NamedTuple):
    """A public class or function; of a method with its class."""

    name: str
    thing: Any
    owner: Any = None


def packages() -> list[ModuleType]:
    """The public packages."""
    inner = [found.name for found in pkgutil.walk_packages(ohmskin.__path__, "ohmskin.") if found.ispkg]
    found = [ohmskin, *(one for name in inner if hasattr(one := importlib.import_module(name), "__all__"))]
    assert len(found) > 20
    return found


PACKAGES = packages()


def written(thing: Any) -> Any:
    """What was written, without decorators: a kernel's function, a property's."""
    for name in ("py_func", "fget", "func"):
        thing = getattr(thing, name, None) or thing
    return inspect.unwrap(thing) if callable(thing) else thing


def public() -> Iterator[Public]:
    """All public classes and functions, and the methods and properties of the classes, each once."""
    found = set()
    for package in PACKAGES:
        for name in package.__all__:
            thing = written(getattr(package, name))
            if id(thing) in found or not (inspect.isclass(thing) or inspect.isfunction(thing)):
                continue
            found.add(id(thing))
            yield Public(f"{thing.__module__}.{name}", thing)
            for key, member in vars(thing).items() if inspect.isclass(thing) else ():
                own = written(member.__func__ if isinstance(member, classmethod | staticmethod) else member)
                if inspect.isfunction(own) and own.__name__ == key and (key == "__call__" or not key.startswith("_")):
                    yield Public(f"{thing.__module__}.{name}.{key}", own, thing)


def resolved(name: str, owner: Any, module: ModuleType) -> Public | None:
    """What a docstring means by a name such as `reconstruct` or `Device.press`."""
    *outer, last = name.split(".")
    for place in [owner, module, *PACKAGES] if not outer else [module, *PACKAGES]:
        home = reduce(lambda one, key: getattr(one, key, None), outer, place)
        if (thing := written(getattr(home, last, None))) is not None:
            return Public(name, thing, home if inspect.isclass(home) else None)
    return None


def words_of(one: Public) -> str:
    """What the documentation of something says, with that of its bases and of what it refers to ("as for `that`").

    A method without a docstring has that of its class's bases; and of a protocol, if its class says that it is one.
    """
    module = sys.modules[one.thing.__module__]
    if one.owner is None:
        own = [base for base in getattr(one.thing, "__mro__", [one.thing]) if base.__module__.startswith("ohmskin")]
        said = " ".join(inspect.getdoc(base) or "" for base in own)
        referred = []
    else:
        key = one.thing.__name__
        said = inspect.getdoc(getattr(one.owner, key)) or ""
        named = (resolved(name, None, module) for name in re.findall(r"`(\w+)`", inspect.getdoc(one.owner) or ""))
        protocols = [found.thing for found in named if found and getattr(found.thing, "_is_protocol", False)]
        referred = [f"{other.__name__}.{key}" for other in protocols if other is not one.owner and hasattr(other, key)]
    referred += re.findall(r"\b[Aa]s (?:for|of) `([\w.]+)`", said)
    others = (resolved(name, one.owner, module) for name in referred)
    return " ".join([said, *(words_of(other) for other in others if other and other.thing is not one.thing)])


def documented_constants(package: ModuleType) -> set[str]:
    """Names of a package's modules with a text below their assignment, which the API reference takes."""
    found = set()
    for path in Path(package.__path__[0]).rglob("*.py"):
        body = ast.parse(path.read_text(encoding="utf-8")).body
        for one, below in pairwise(body):
            targets = one.targets if isinstance(one, ast.Assign) else [getattr(one, "target", None)]
            if isinstance(below, ast.Expr) and isinstance(getattr(below.value, "value", None), str):
                found |= {target.id for target in targets if isinstance(target, ast.Name)}
    return found


def test_every_public_name_has_what_the_reference_shows_of_it() -> None:
    silent = []
    for package in PACKAGES:
        constants = documented_constants(package)
        for name in package.__all__:
            thing = getattr(package, name)
            described = inspect.isclass(thing) or inspect.isroutine(thing) or hasattr(thing, "py_func")
            if not (thing.__doc__ if described else name in constants):
                silent.append(f"{package.__name__}.{name}")
    assert silent == []


def test_every_method_and_property_is_described() -> None:
    """In its own words, those of a base or protocol, or among the attributes of its class: no other is shown."""
    silent = []
    for one in public():
        attributes = (inspect.getdoc(one.owner) or "").partition("Attributes:")[2]
        if one.owner and not words_of(one).strip() and f"{one.thing.__name__}:" not in attributes:
            silent.append(one.name)
        if inspect.isclass(one.thing) and issubclass(one.thing, Enum):
            lines = re.findall(r"^    [A-Z_]+ = .*", inspect.getsource(one.thing), re.MULTILINE)
            silent += [f"{one.name}: {line}" for line in lines if "  #: " not in line]
    assert silent == []


def test_the_tree_of_errors_is_drawn_as_it_is() -> None:
    drawing = inspect.getdoc(errors.OhmskinError) or ""
    drawn, above = {}, ["Exception", *[""] * 8]
    for indent, name, other in re.findall(r"^(    +)(\w+)(?: +an? (\w+), too)?$", drawing, re.MULTILINE):
        depth = len(indent) // 4
        drawn[name], above[depth] = [above[depth - 1], *filter(None, [other])], name
    kinds = [one for one in vars(errors).values() if inspect.isclass(one) and issubclass(one, errors.OhmskinError)]
    assert drawn == {kind.__name__: [base.__name__ for base in kind.__bases__] for kind in kinds}


def arguments_of(one: Public) -> list[str]:
    """The arguments that its user gives."""
    thing = one.thing
    if inspect.isclass(thing) and (issubclass(thing, Exception | Enum) or getattr(thing, "_is_protocol", False)):
        return []
    try:
        names = inspect.signature(thing).parameters
    except ValueError:  # a type without a signature
        return []
    return [name for name in names if not name.startswith("_") and name not in ("self", "cls")]


def test_every_argument_of_what_is_public_is_described() -> None:
    """Named, at least, in its documentation."""
    silent, seen = [], 0
    for one in public():
        arguments = arguments_of(one)
        seen += len(arguments)
        known = set(re.findall(r"\w+", words_of(one))) if arguments else set()
        silent += [f"{one.name}: {argument}" for argument in arguments if argument not in known]
    assert silent == []
    assert seen > 1800


def raised(one: Public) -> set[type[Exception]]:
    """The errors of ohmskin that something raises itself; of a class, those of making one."""
    own = (
        [vars(one.thing).get(name) for name in ("__init__", "__post_init__")]
        if inspect.isclass(one.thing)
        else [one.thing]
    )
    code = [made.__code__ for made in own if inspect.isfunction(made) and made.__code__.co_filename != "<string>"]
    trees = [ast.parse(textwrap.dedent(inspect.getsource(made))) for made in code]
    made = [node.exc for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Raise) and node.exc]
    names = {ast.unparse(getattr(error, "func", error)) for error in made}
    return {getattr(errors, name) for name in names if hasattr(errors, name)}


def test_every_error_that_is_raised_is_told() -> None:
    """By what is public and raises it itself; the name of a base of it will do."""
    silent, seen = [], 0
    for one in public():
        for error in raised(one):
            seen += 1
            names = [base.__name__ for base in error.__mro__ if issubclass(base, errors.OhmskinError)]
            if not set(names) & set(re.findall(r"\w+", words_of(one))):
                silent.append(f"{one.name}: {error.__name__}")
    assert silent == []
    assert seen > 100
