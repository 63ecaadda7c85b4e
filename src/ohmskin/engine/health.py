"""Health figures of the running loop."""

from collections import deque
from dataclasses import dataclass

import numpy as np

_WINDOW = 1000  # cycles over which latencies are reported
_SPAN = 1.0  # seconds over which rates are reported
_UNITS = {"rate": "Hz", "latency_p50": "s", "latency_p99": "s", "noise": "V"}


@dataclass(frozen=True)
class Health:
    """Rate, latency and losses of the loop.

    Args:
        rate: Cycles per second over the last second.
        latency_p50, latency_p99: Time from the last sample of a cycle to its contacts (s), over the last 1000 cycles.
            The device's clock is synchronised to the host's by the fastest answer seen, so that the smallest transit
            time is not included.
        dropped: Frames lost in transit since the start.
        noise: Standard deviation of a voltage on the quiet skin (V).
        waiting: Share of the time spent waiting for the device (0 to 1).
        cycles: Cycles since the start.
    """

    rate: float = 0.0
    latency_p50: float = 0.0
    latency_p99: float = 0.0
    dropped: int = 0
    noise: float = 0.0
    waiting: float = 0.0
    cycles: int = 0

    @property
    def figures(self) -> dict[str, float]:
        """All but the count of cycles by name, for pages and JSON."""
        return {name: value for name, value in vars(self).items() if name != "cycles"}

    @property
    def diagnostics(self) -> dict[str, float]:
        """All by name and unit, for diagnostics: ``rate_Hz``, ``latency_p50_s``, ..."""
        return {f"{name}_{_UNITS[name]}" if name in _UNITS else name: value for name, value in vars(self).items()}


class HealthMonitor:
    """Collects times of cycles and reports `Health` a few times a second."""

    def __init__(self) -> None:
        self._latencies: deque[float] = deque(maxlen=_WINDOW)
        self._marks: deque[tuple[float, float]] = deque()  # (time, seconds waited since the start)
        self._waited = 0.0
        self._offset = np.inf
        self._cycles = 0
        self._reported = Health()
        self._next = 0.0

    def waited(self, seconds: float) -> None:
        """Count time spent waiting for the device."""
        self._waited += seconds

    def arrived(self, host: float, device: float) -> float:
        """The time on the host's clock of a sample that the device took at `device` and that arrived at `host` (s)."""
        self._offset = min(self._offset, host - device)
        return device + self._offset

    def reconnected(self) -> None:
        """Forget the device's clock; it may have started anew."""
        self._offset = np.inf

    def cycle(self, now: float, sampled: float, dropped: int, noise: float) -> Health:
        """Count a cycle that ended at `now`, its last sample taken at `sampled` (host clock, s)."""
        self._cycles += 1
        self._latencies.append(now - sampled)
        self._marks.append((now, self._waited))
        while self._marks[0][0] < now - _SPAN and len(self._marks) > 2:
            self._marks.popleft()
        if now >= self._next or noise != self._reported.noise:
            self._next = now + 0.2
            (first, waited_first), count = self._marks[0], len(self._marks)
            span = max(now - first, 1e-9)
            p50, p99 = np.percentile(self._latencies, [50, 99])
            waiting = min(1.0, (self._waited - waited_first) / span)
            self._reported = Health((count - 1) / span, float(p50), float(p99), dropped, noise, waiting, self._cycles)
        return self._reported
