"""Residuals: the last frames, what each of them says, and how well the contacts known explain it."""

from dataclasses import dataclass, field

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.contacts.likelihood import Data
from ohmskin.scan import Difference


@dataclass(frozen=True, eq=False)
class Reading:
    """One frame, known drift and temperature taken off.

    Args:
        difference: The frame.
        data: What is finite of it.
        common: (n_meas,) what it would change by if all resistances doubled (V); zero where that is not known.
        errors: (n_meas, k) directions in which it errs (V); the last is that of temperature, where `common` is known.
    """

    difference: Difference
    data: Data
    common: Floats
    errors: Floats


@dataclass(frozen=True, eq=False)
class Residuals:
    """One frame of the last few, and what it says of a contact more.

    Args:
        reading: The frame.
        innovation: (n_meas,) what was not foreseen of it (V).
        residual: (n_meas,) what the contacts known by then do not explain (V).
        unsure: (n_meas, k) directions in which it is not known any better (V); the reading's errors come last.
        energy: Squared norm of what they do explain, or did a moment ago (V2).
        effects: Of each contact known by then, by its name (m2).
        time: When it was taken (s).
        score, power: (n_places,) of a contact more at each place.
    """

    reading: Reading
    innovation: Floats
    residual: Floats
    unsure: Floats
    energy: float
    effects: dict[int, float]
    time: float
    score: Floats = field(default_factory=lambda: np.empty(0))
    power: Floats = field(default_factory=lambda: np.empty(0))
