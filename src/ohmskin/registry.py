"""Things by name: our own, and those that installed packages register as entry points."""

from collections.abc import Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Generic, TypeVar

from ohmskin.errors import OhmskinError

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """A table of things by name, open to other packages.

    Args:
        noun: What is in it, for errors.
        group: Group of entry points by which other packages add to it.
        own: Our own, by name.
        error: What to raise for an unknown name.
        hint: What to add to that error.
    """

    def __init__(self, noun: str, group: str, own: Mapping[str, T], error: type[OhmskinError], hint: str = "") -> None:
        self.noun, self.group, self._own, self._error, self._hint = noun, group, dict(own), error, hint

    def __getitem__(self, name: str) -> T:
        """The thing of that name.

        Raises:
            OhmskinError: If there is none; the message lists those there are. If its package cannot be imported.
        """
        if name in self._own:
            return self._own[name]
        found = self._others()
        if name not in found:
            raise self._error(f"no {self.noun} {name!r}; choose from {', '.join(self)}{self._hint}")
        try:
            loaded: T = found[name].load()
        except Exception as error:  # whatever another package may raise
            why = f"{type(error).__name__}: {error}"
            raise self._error(f"{self.noun} {name!r} cannot be loaded from {found[name].value}: {why}") from error
        return loaded

    def __contains__(self, name: object) -> bool:
        return name in self._own or name in self._others()

    def __iter__(self) -> Iterator[str]:
        yield from self._own
        yield from (name for name in self._others() if name not in self._own)

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

    def title(self, name: str) -> str:
        """The first line of what documents it, or why it cannot be loaded."""
        try:
            thing = self[name]
        except OhmskinError as error:
            return str(error).splitlines()[0]
        return (getattr(thing, "__doc__", None) or name).strip().splitlines()[0].rstrip(".")

    def _others(self) -> dict[str, EntryPoint]:
        return {entry.name: entry for entry in entry_points(group=self.group)}
