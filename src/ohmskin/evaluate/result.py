"""What an experiment gives: named arrays."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Result = dict[str, NDArray[Any]]


class Experiment(Protocol):
    """A frozen dataclass of parameters that can be run."""

    def run(self) -> Result:
        """The results, by name."""
        ...


def plain(result: Result, digits: int = 6) -> dict[str, Any]:
    """The arrays as nested lists of rounded numbers, None where not finite: what JSON can hold."""

    def convert(value: Any) -> Any:
        if isinstance(value, list):
            return [convert(entry) for entry in value]
        if isinstance(value, float):
            return float(f"{value:.{digits}g}") if np.isfinite(value) else None
        return value

    return {name: convert(np.asarray(array).tolist()) for name, array in result.items()}
