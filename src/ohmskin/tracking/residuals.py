"""Residuals: the last frames, what each of them says, and how well the contacts known explain it."""

from dataclasses import dataclass, field

import numpy as np

from ohmskin.arrays import Floats, Singles
from ohmskin.contacts.information import Information
from ohmskin.scan import Difference


@dataclass(frozen=True, eq=False)
class Reading:
    """One frame, known drift and temperature taken off.

    Args:
        difference: The frame.
        data: What it says, a common change of all resistances included.
        beside: What it says beside that change, as far as it is not known.
        wary: The same, wary of the model's error.
    """

    difference: Difference
    data: Information
    beside: Information
    wary: Information


@dataclass(frozen=True, eq=False)
class Residuals:
    """One frame of the last few, and what it says of a contact more.

    Args:
        reading: The frame.
        innovation: What it says that was not foreseen, a common change of all resistances included.
        residual: What it says that the contacts known by then do not explain.
        energy: Squared size of what they do explain, or did a moment ago, over the noise's variance (1).
        effects: Of each contact known by then, by its name (m2).
        time: When it was taken (s).
        unforeseen: The innovation beside the common change, as far as that is not known.
        score, power: (n_places,) of a contact more at each place.
        told_by: The electrode whose voltages alone showed a contact that others should have seen.
    """

    reading: Reading
    innovation: Information
    residual: Information
    energy: float
    effects: dict[int, float]
    time: float
    unforeseen: Information
    score: Floats | Singles = field(default_factory=lambda: np.empty(0))
    power: Floats | Singles = field(default_factory=lambda: np.empty(0))
    told_by: int | None = None
