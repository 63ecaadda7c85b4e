"""A figure of the benchmark, and the target that it is held against."""

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Figure:
    """One measured figure.

    Args:
        name: What was measured.
        value: The figure; a median where it was repeated. None if it could not be measured, `note` then says why.
        unit: Its unit; "times" for ratios.
        least, most: The target's bounds; None where there is no such bound. Without either it is information.
        low, high: Lower and upper quartile over the rounds.
        note: What lies behind it: absolute times, sizes.
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

    @property
    def target(self) -> str:
        """The target in words."""
        if self.least is not None:
            return f"at least {self.least:,g}"
        return "" if self.most is None else f"at most {self.most:,g}"

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**asdict(self), "verdict": self.verdict}
