"""Residuals: the last frames, the information of each, and how well the contacts known explain it."""

from dataclasses import dataclass, field

import numpy as np

from ohmskin.arrays import Floats, Singles
from ohmskin.contacts.information import Information
from ohmskin.scan import Difference


@dataclass(frozen=True, eq=False)
class Observation:
    """One frame, known drift and temperature taken off.

    Args:
        difference: The frame.
        data: Its information, a common change of all resistances included.
        nominal: Its information marginalised over that change, as far as it is not known.
        inflated: The same with noise inflated by the model's error.
    """

    difference: Difference
    data: Information
    nominal: Information
    inflated: Information


@dataclass(frozen=True, eq=False)
class Residuals:
    """One of the last frames less the contacts known, and its score for one contact more.

    Args:
        observation: The frame.
        innovation: The frame less its prediction, a common change of all resistances included.
        residual: The frame less the contacts known by then.
        energy: Squared size of what they do explain, or did a moment ago, over the noise's variance (1).
        effects: Of each contact known by then, by its name (m2).
        time: When it was taken (s).
        marginal_innovation: The innovation marginalised over the common change, as far as that is not known.
        score, power: (n_places,) of a contact more at each place.
        only_electrode: The electrode whose voltages alone showed a contact that others should have shown, too.
    """

    observation: Observation
    innovation: Information
    residual: Information
    energy: float
    effects: dict[int, float]
    time: float
    marginal_innovation: Information
    score: Floats | Singles = field(default_factory=lambda: np.empty(0))
    power: Floats | Singles = field(default_factory=lambda: np.empty(0))
    only_electrode: int | None = None
