"""What an experiment gives, named arrays, and what a whole study gives."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ohmskin.errors import OhmskinError

Result = dict[str, NDArray[Any]]
S = TypeVar("S")


class Experiment(Protocol):
    """A frozen dataclass of parameters that can be run."""

    def run(self) -> Result:
        """The results, by name."""
        ...


Groups = dict[str, dict[str, Experiment]]  # experiments by group (figures or sections of a report) and name
Progress = Callable[[str, Experiment, bool], None]  # group, its experiment that is done, whether it came from the cache


@dataclass(frozen=True)
class Outcome(Generic[S]):
    """All experiments of a study.

    Args:
        settings: Seeds, noise levels and counts.
        experiments: By group and name.
        results: Their results, likewise.
    """

    settings: S
    experiments: Groups
    results: dict[str, dict[str, Result]] = field(repr=False)

    def of(self, group: str, prefix: str = "") -> Iterator[tuple[str, Any, Result]]:
        """Name, experiment and result of those of a group whose name starts with `prefix`; none if it was not run."""
        for name, result in self.results.get(group, {}).items():
            if name.startswith(prefix):
                yield name, self.experiments[group][name], result


def plain(value: Any) -> Any:
    """Arrays as JSON can hold them: nested lists of numbers of four digits, None where not finite."""
    if isinstance(value, dict):
        return {name: plain(np.asarray(array).tolist()) for name, array in value.items()}
    if isinstance(value, list):
        return [plain(entry) for entry in value]
    if isinstance(value, float):
        return float(f"{value:.4g}") if np.isfinite(value) else None
    return value


def chosen(groups: Groups, only: Sequence[str], what: str) -> Groups:
    """The groups wanted; all if none is named.

    Raises:
        OhmskinError: If one is unknown.
    """
    if unknown := [name for name in only if name not in groups]:
        raise OhmskinError(f"no {what} {unknown[0]!r}; choose from {', '.join(groups)}")
    return {name: group for name, group in groups.items() if not only or name in only}
