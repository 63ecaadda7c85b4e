"""Residuals: the last frames, the information of each, and how well the contacts known explain it."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ohmskin.arrays import Floats, Singles
from ohmskin.contacts.degraded import Degradation
from ohmskin.contacts.information import Information
from ohmskin.contacts.misfit import QuadraticMisfit
from ohmskin.scan import Difference, Pairs
from ohmskin.tracking.kernels import Update


@dataclass(frozen=True, eq=False)
class Observation:
    """One frame, known drift and temperature taken off.

    Args:
        difference: The frame.
        update: What a compiled step made of it.
        degradations: Of contacts of electrodes, found since, and removed.
    """

    difference: Difference
    update: Update
    degradations: tuple[Degradation, ...] = ()

    @cached_property
    def _measured(self) -> tuple[Information, Information]:
        nominal, inflated, white, count = self.update.likelihood
        alone = QuadraticMisfit(*white)
        return Information.made(nominal, alone, count), Information.made(inflated, alone, count)

    @cached_property
    def data(self) -> Information:
        """Its information, a common change of all resistances included."""
        return self._sound(self._measured[0])

    @cached_property
    def nominal(self) -> Information:
        """Its information marginalised over that change, as far as it is not known."""
        return self._sound(self._measured[0].reduced_to(self.update.nominal))

    @cached_property
    def inflated(self) -> Information:
        """The same with noise inflated by the model's error."""
        return self._sound(self._measured[1].reduced_to(self.update.inflated))

    def without(self, degradation: Degradation, pairs: Pairs) -> "Observation":
        """The frame without what degraded contacts of electrodes change of the resistances of pairs."""
        difference = self.difference.minus(degradation.change, pairs)
        return Observation(difference, self.update, (*self.degradations, degradation))

    def _sound(self, data: Information) -> Information:
        for degradation in self.degradations:
            data = degradation.removed_from(data)
        return data


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
        doubted: Number of the place where it alone showed a contact that explains it poorly, as spikes and bursts of
            noise do; None: no such contact.
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
    doubted: int | None = None

    @property
    def sound(self) -> bool:
        """Whether neither a single electrode's voltages nor spikes or noise are what the frame shows."""
        return self.only_electrode is None and self.doubted is None
