"""Goals: what was asked for, held against what was measured. Every verdict is computed; none is written down here."""

from dataclasses import dataclass

from ohmskin.evaluate.statistics import Estimate

MET, MISSED, OPEN = "met", "missed", "undecided"


@dataclass(frozen=True)
class Goal:
    """A bound that was set beforehand, and the measured value with its 95 % interval.

    Args:
        section: Of `plan.SECTIONS`.
        text: What is asked.
        limit: The bound.
        at_most: Whether the value may not exceed it; otherwise it may not fall below it.
        measured: What was found.
        unit: ``ratio``, ``%`` or empty for a count.
        data: How much data the interval comes from, with the number of seeds or trials.
        note: What else one should know.
        key: Whether it is one that was asked for; others are the same questions in other circumstances.
    """

    section: str
    text: str
    limit: float
    at_most: bool
    measured: Estimate
    unit: str
    data: str
    note: str = ""
    key: bool = True

    @property
    def verdict(self) -> str:
        """`MET` or `MISSED` if the whole interval says so, otherwise `OPEN`."""
        sign = 1 if self.at_most else -1
        inside = [sign * value <= sign * self.limit for value in (self.measured.low, self.measured.value, self.measured.high)]
        return MET if all(inside) else OPEN if any(inside) else MISSED

    @property
    def bound(self) -> str:
        """The bound, as text."""
        return f"{'≤' if self.at_most else '≥'} {self._number(self.limit)}"

    @property
    def found(self) -> str:
        """The value with its interval, as text."""
        m = self.measured
        if m.low == m.value == m.high:
            return self._number(m.value)
        return f"{self._number(m.value)} ({self._number(m.low)} to {self._number(m.high)})"

    @property
    def margin(self) -> str:
        """By how much the bound is kept or missed: the value over the bound of a ratio, the difference otherwise."""
        if self.unit == "ratio":
            return f"{100 * (self.measured.value / self.limit - 1):+.0f} %"
        if self.unit == "%":
            return f"{100 * (self.measured.value - self.limit):+.1f} points"
        return f"{self.measured.value - self.limit:+.3g}"

    def _number(self, value: float) -> str:
        if self.unit == "%":
            return f"{100 * value:.3g} %"
        return f"{value:.2f}" if self.unit == "ratio" else f"{value:.3g}"
