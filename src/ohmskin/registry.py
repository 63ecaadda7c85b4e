"""Things by name: our own, and those that installed packages register as entry points."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, wraps
from pathlib import Path
from traceback import walk_tb
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from ohmskin.errors import OhmskinError, shown

if TYPE_CHECKING:  # importing it takes a sixth of the time of `ohmskin --help`
    from importlib.metadata import EntryPoint

T = TypeVar("T")


@dataclass(frozen=True)
class Plugin:
    """A thing of another package.

    Args:
        noun: What it is.
        entry: Its entry point.
        error: What to raise when it fails.
    """

    noun: str
    entry: "EntryPoint"
    error: type[OhmskinError]

    def __str__(self) -> str:
        made_by = f" of {self.entry.dist.name} {self.entry.dist.version}" if self.entry.dist else ""
        return f"{self.noun} {self.entry.name!r}{made_by} ({self.entry.value})"

    @property
    def package(self) -> str:
        """The package that its code is in."""
        return self.entry.value.partition(":")[0].partition(".")[0].strip()


@contextmanager
def naming(*plugins: Plugin | None, whoever: bool = False) -> Iterator[None]:
    """Make of what other packages raise an error that names them and the line; errors of ours pass.

    Args:
        plugins: Those in use. The ones whose code raised are named; if there is no such one, all of them, as they gave
            what was wrong.
        whoever: Whether any other that was called in this process and raised is named, too.
    """
    try:
        yield
    except OhmskinError:
        raise
    except Exception as error:
        lines = {
            frame.f_globals.get("__name__", "").partition(".")[0]: f" ({Path(frame.f_code.co_filename).name}:{line})"
            for frame, line in walk_tb(error.__traceback__)
        }
        used = [each for each in plugins if each]
        named = [each for each in [*used, *(_CALLED if whoever else ())] if each.package in lines] or used
        if not named:
            raise
        who, where = " or ".join(map(str, named)), lines.get(named[0].package, "")
        raise named[0].error(f"{who} does not work: {type(error).__name__}: {error}{where}{_ADVICE}") from error


_CALLED: dict[Plugin, None] = {}
_ADVICE = "; ask who made it, or use another"


class Registry(Mapping[str, T], Generic[T]):
    """A table of things by name, open to other packages.

    Args:
        noun: What is in it, for errors.
        group: Group of entry points by which other packages add to it.
        own: Our own, by name.
        error: What to raise for an unknown name, and for what fails.
        gives: The type of what those of other packages return when they are called.
        hint: What to add to the error for an unknown name.
    """

    def __init__(
        self, noun: str, group: str, own: Mapping[str, T], error: type[OhmskinError], gives: type[Any], hint: str = ""
    ) -> None:
        self.noun, self.group, self._own, self._error, self._hint = noun, group, dict(own), error, hint
        self._gives = gives

    def __getitem__(self, name: str) -> T:
        """The thing of that name.

        Raises:
            OhmskinError: If there is none; the message lists those there are. If several have it. If its package cannot
                be imported; so does what it gives when it fails, or returns something else than it must.
        """
        theirs = self.plugin(name)
        if theirs is not None:
            return cast(T, self._checked(theirs))
        if name in self._own:
            return self._own[name]
        raise self._error(f"no {self.noun} {name!r}; choose from {', '.join(self)}{self._hint}")

    def __contains__(self, name: object) -> bool:
        return name in [*self]

    def __iter__(self) -> Iterator[str]:
        yield from dict.fromkeys([*self._own, *(entry.name for entry in self.offered)])

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def add(self, name: str, thing: T) -> None:
        """Add a thing for this process, such as an experiment; packages use entry points.

        Raises:
            OhmskinError: If the name is taken.
        """
        if name in self:
            raise self._error(f"{self.noun} {name!r} already exists; choose another name")
        self._own[name] = thing

    def plugin(self, name: str) -> Plugin | None:
        """What another package registered by that name; None if none did.

        Raises:
            OhmskinError: If there is more than one thing of that name.
        """
        found = [Plugin(self.noun, entry, self._error) for entry in self.offered if entry.name == name]
        if len(found) + (name in self._own) > 1:
            who = " and ".join([*(["ohmskin's own"] if name in self._own else []), *map(str, found)])
            raise self._error(f"{self.noun} {name!r} is ambiguous: {who}; uninstall one, or have it renamed")
        return found[0] if found else None

    def title(self, name: str) -> str:
        """The first line of what documents it, or why it cannot be loaded."""
        try:
            thing = self[name]
        except OhmskinError as error:
            return str(error).splitlines()[0]
        return (getattr(thing, "__doc__", None) or name).strip().splitlines()[0].rstrip(".")

    @property
    def offered(self) -> "tuple[EntryPoint, ...]":
        """What other packages register."""
        return tuple(entry_points(self.group))

    def _checked(self, plugin: Plugin) -> Callable[..., Any]:
        """What a plug-in registers; called, it raises an error that names the plug-in where that fails."""
        with naming(plugin):
            thing = plugin.entry.load()
        if not callable(thing):
            raise self._error(f"{plugin} is {shown(thing)}, which is no function{_ADVICE}")

        @wraps(thing)
        def called(*args: Any, **settings: Any) -> Any:
            _CALLED[plugin] = None
            with naming(plugin):
                given = thing(*args, **settings)
                if isinstance(given, self._gives):
                    return given
            raise self._error(f"{plugin} returned {shown(given)}, which is no {self._gives.__name__}{_ADVICE}")

        return called


def entry_points(group: str) -> "Iterable[EntryPoint]":
    """Those of a group, of all installed packages."""
    return cast("Iterable[EntryPoint]", _installed().select(group=group))


@cache  # finding them takes 30 ms
def _installed() -> Any:  # what it is depends on the version of Python
    from importlib import metadata  # here: only what looks for plug-ins needs it

    return metadata.entry_points()
