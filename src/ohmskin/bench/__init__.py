"""The benchmark: ohmskin side by side with pyEIT, with plain NumPy and SciPy, and with the limits of the machine."""

from ohmskin.bench.figure import Figure
from ohmskin.bench.run import GROUPS, run

__all__ = ["GROUPS", "Figure", "run"]
