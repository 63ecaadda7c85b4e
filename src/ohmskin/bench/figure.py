"""A figure of the benchmark, and the target that it is held against."""

from dataclasses import asdict, dataclass, field
from typing import Any, Self

import numpy as np

from ohmskin.arrays import Floats


@dataclass(frozen=True)
class Figure:
    """One measured figure.

    Args:
        name: What was measured.
        value: The figure; a median where it was repeated. None if it could not be measured; `note` then gives the
            reason.
        unit: Its unit; "times" for ratios.
        least, most: The target's bounds; None where there is no such bound. Without either it is information.
        low, high: Lower and upper quartile over the rounds.
        note: What it is computed from: absolute times, sizes.
        data: The same, for machines.
    """

    name: str
    value: float | None
    unit: str
    least: float | None = None
    most: float | None = None
    low: float | None = None
    high: float | None = None
    note: str = ""
    data: dict[str, Any] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """``pass``, ``short``, ``not run``, or empty where there is no target."""
        if self.least is None and self.most is None:
            return ""
        if self.value is None:
            return "not run"
        good = (self.least is None or self.value >= self.least) and (self.most is None or self.value <= self.most)
        return "pass" if good else "short"

    @classmethod
    def median(cls, name: str, values: Floats, unit: str, **rest: Any) -> Self:
        """The figure that several rounds gave: median and quartiles of `values`.

        Args:
            name, unit, rest: As for `Figure`.
            values: (n_rounds,) what was measured in each, in that unit.
        """
        low, value, high = (float(quartile) for quartile in np.percentile(values, [25, 50, 75]))
        return cls(name, value, unit, low=low, high=high, **rest)

    def row(self, verdict: str) -> tuple[str, ...]:
        """The row of a table: name, value, spread, target, the `verdict` as shown there, and the note."""
        value = f"{_shown(self.value)} {self.unit}".rstrip()
        spread = "" if self.low is None or self.low == self.high else f"{_shown(self.low)} to {_shown(self.high)}"
        target = f"at least {self.least:,g}" if self.least is not None else ""
        if self.least is None and self.most is not None:
            target = f"at most {self.most:,g}"
        return self.name, value, spread, target, verdict, self.note

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**asdict(self), "verdict": self.verdict}


def _shown(value: float | None) -> str:
    """A value with three figures that count."""
    if value is None:
        return "-"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
