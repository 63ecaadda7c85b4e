"""The benchmark: ohmskin side by side with pyEIT, with plain NumPy and SciPy, and with what the machine can do."""

from ohmskin.bench.figure import Figure
from ohmskin.bench.run import GROUPS, run

__all__ = ["GROUPS", "Figure", "run"]
