"""One cycle of the adaptive loop, compiled: from voltages to contacts in microseconds."""

from ohmskin.cycle.cycle import FastCycle
from ohmskin.cycle.reference import ReferenceCycle

__all__ = ["FastCycle", "ReferenceCycle"]
