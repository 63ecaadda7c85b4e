"""The paper's experiments: each a frozen dataclass of parameters whose `run` is a pure function to named arrays.

Equal parameters give equal arrays, on any machine and in any order, so that a runner may distribute, cache and resume
them.
"""

from ohmskin.evaluate.experiments.discrimination import Discrimination
from ohmskin.evaluate.experiments.localisation import Localisation, MatchedLocalisation
from ohmskin.evaluate.experiments.touches import Merits, PressedShapes, Sections, Touches

__all__ = ["Discrimination", "Localisation", "MatchedLocalisation", "Merits", "PressedShapes", "Sections", "Touches"]
