"""What an experiment gives, named arrays, and what a whole study gives."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

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
    """Everything that a study ran.

    Args:
        settings: How thoroughly.
        experiments: By group and name.
        results: The same, with results.
    """

    settings: S
    experiments: Groups
    results: dict[str, dict[str, Result]] = field(repr=False)

    def of(self, group: str, prefix: str = "") -> Iterator[tuple[str, Any, Result]]:
        """Name, experiment and result of each experiment of a group whose name starts with `prefix`; none if the group
        was not run."""
        for name, result in self.results.get(group, {}).items():
            if name.startswith(prefix):
                yield name, self.experiments[group][name], result


def plain(result: Result, digits: int = 6) -> dict[str, Any]:
    """The arrays as nested lists of rounded numbers, None where not finite: what JSON can hold."""

    def convert(value: Any) -> Any:
        if isinstance(value, list):
            return [convert(entry) for entry in value]
        if isinstance(value, float):
            return float(f"{value:.{digits}g}") if np.isfinite(value) else None
        return value

    return {name: convert(np.asarray(array).tolist()) for name, array in result.items()}
