"""Estimators by name, in the one form in which a loop uses them: the state of an image in, the next one out.

Other packages add theirs with an entry point of the group ``ohmskin.estimators``: a function of `Settings` that returns
an `Estimator`, its docstring's first line the title. `FrameWise` makes one of a ``reconstruct(*differences)``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Protocol, runtime_checkable

import numpy as np

from ohmskin.errors import ModelError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Cells
from ohmskin.inverse.absolute import AbsoluteGaussNewton
from ohmskin.inverse.choice import RULES, choose
from ohmskin.inverse.gauss_newton import GaussNewton
from ohmskin.inverse.greit import Greit
from ohmskin.inverse.image import Image, Reconstructor, TabulatedStd
from ohmskin.inverse.kalman import Kalman, KalmanState
from ohmskin.inverse.pixels import Pixels
from ohmskin.inverse.priors import PRIORS
from ohmskin.inverse.sparse import SparseBayes
from ohmskin.inverse.variation import TotalVariation
from ohmskin.registry import Registry
from ohmskin.scan import Difference

Scans = Sequence[Difference]
_WITH_PRIOR = "greit", "total-variation", "sparse-bayes", "absolute-variation"
_MEMORY = 0.1  # s: time over which the Kalman filter forgets an image; fingers move about a radius in it


class Estimate(Protocol):
    """State of an estimator."""

    @property
    def image(self) -> Image:
        """The image."""


@dataclass(frozen=True, eq=False)
class LazyEstimate:
    """An image that is made when it is first asked for, or goes into a pickle."""

    make: Callable[[], Image]

    @cached_property
    def image(self) -> Image:
        """The image."""
        return self.make()

    def __reduce__(self) -> tuple[Callable[[Image], "LazyEstimate"], tuple[Image]]:
        return _estimated, (self.image,)


def _estimated(image: Image) -> LazyEstimate:
    return LazyEstimate(lambda: image)


@runtime_checkable
class Estimator(Protocol):
    """Makes images of successive scans."""

    @property
    def cells(self) -> Cells:
        """The cells of its images."""

    def start(self) -> Estimate:
        """The initial state."""

    def update(self, before: Estimate, new: Scans, recent: Scans, elapsed: float) -> Estimate:
        """The state after one more frame.

        Args:
            before: The state after the last frame.
            new: The frame's scans.
            recent: These, and earlier ones of about the same time where a frame has few injections.
            elapsed: Time since the last frame (s).
        """


@dataclass(frozen=True)
class ZeroEstimate:
    """The image of nothing.

    Args:
        count: Its elements.
    """

    count: int

    @property
    def image(self) -> Image:
        """Zeros."""
        return Image(np.zeros(self.count), TabulatedStd(np.zeros(self.count)))


@dataclass(frozen=True, eq=False)
class FrameWise:
    """An `Estimator` without memory.

    Args:
        estimator: Makes an image of some scans.
        cells: The cells of its images.
    """

    estimator: Reconstructor
    cells: Cells

    def start(self) -> Estimate:
        """The initial state: an image of no change."""
        return ZeroEstimate(len(self.cells.measures))

    def update(self, before: Estimate, new: Scans, recent: Scans, elapsed: float) -> Estimate:
        """The image of the recent scans; without any, the one before."""
        return LazyEstimate(partial(self.estimator.reconstruct, *recent)) if recent else before


@dataclass(frozen=True, eq=False)
class Recursive:
    """A Kalman filter as an `Estimator`.

    Args:
        filter: The filter.
        cells: The cells of its images.
    """

    filter: Kalman
    cells: Cells

    def start(self) -> KalmanState:
        """The prior."""
        return self.filter.start()

    def update(self, before: Estimate, new: Scans, recent: Scans, elapsed: float) -> KalmanState:
        """The belief after the new scans."""
        assert isinstance(before, KalmanState)
        return self.filter.update(before, *new, elapsed=elapsed)


@dataclass(frozen=True, eq=False)
class ByRule:
    """Images with an amplitude that a rule chooses anew for each (`RULES`).

    Args:
        one_step: For which the rule chooses.
        rule: Its name.
        made_with: The estimator with that amplitude.
    """

    one_step: GaussNewton
    rule: str
    made_with: Callable[[float], Reconstructor]

    def reconstruct(self, *differences: Difference) -> Image:
        """The image of one scan, or of several fused.

        Raises:
            DataError: If no finite datum is left.
            ModelError: If the rule finds no amplitude for these data.
        """
        return self.made_with(choose(self.rule, self.one_step, *differences).amplitude).reconstruct(*differences)


@dataclass(frozen=True, eq=False)
class EstimatorSettings:
    """Arguments of an estimator.

    Args:
        model: The untouched sheet, scaled to the quiet data.
        noise: Standard deviation of a difference of voltages (V).
        prior: Name of one of `PRIORS`.
        rule: Name of one of `RULES`, for the regularisation parameter; gauss-newton, positive and absolute allow others
            than `physical`.
        amplitude: Relative conductivity change expected (1).
        model_error: Error of the linear model as a share of the root mean square of the data; added to the noise (1).
        bipolar: Whether contacts may lower the conductivity, too.

    Raises:
        ModelError: If there is no such rule.
    """

    model: TransferModel
    noise: float
    prior: str = "paper"
    rule: str = "physical"
    amplitude: float = 0.1
    model_error: float = 0.02
    bipolar: bool = False

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise ModelError(f"no rule {self.rule!r} for the regularisation parameter; choose from {', '.join(RULES)}")


def gauss_newton(s: EstimatorSettings) -> Estimator:
    """One-step Gauss-Newton; the prior `pixels` makes the image of pixels instead of triangles."""
    pixels = Pixels.over(s.model.mesh) if s.prior == "pixels" else None
    model_error = s.model_error
    one_step = GaussNewton(s.model, s.noise, s.prior, amplitude=s.amplitude, model_error=model_error, pixels=pixels)
    return FrameWise(_by_rule(s, one_step, one_step.with_amplitude), one_step.cells)


def _by_rule(s: EstimatorSettings, own: Reconstructor, made_with: Callable[[float], Reconstructor]) -> Reconstructor:
    """The estimator, its amplitude chosen by the rule where that is not the usual one."""
    if s.rule == "physical":
        return own
    one_step = GaussNewton(s.model, s.noise, s.prior, amplitude=s.amplitude, model_error=s.model_error)
    return ByRule(own if isinstance(own, GaussNewton) else one_step, s.rule, made_with)


def check_choice(estimator: str, prior: str, rule: str) -> None:
    """Raise ModelError if an estimator of ours, by its name, has no use for a prior or a rule."""
    if rule != "physical" and estimator in ("kalman", *_WITH_PRIOR):
        takes = "gauss-newton, positive and absolute take one"
        raise ModelError(f"estimator {estimator!r} does not support the rule {rule!r}; {takes}, or use 'physical'")
    if prior != "paper" and estimator in _WITH_PRIOR:
        takes = "gauss-newton, positive, kalman and absolute take one"
        raise ModelError(
            f"estimator {estimator!r} has its own prior and cannot use {prior!r}; {takes}, or leave it out"
        )
    if prior == "pixels" and estimator in ("positive", "kalman", "absolute"):
        raise ModelError(f"estimator {estimator!r} makes no image of pixels; use gauss-newton, or another prior")


def positive(s: EstimatorSettings) -> Estimator:
    """One-step Gauss-Newton, nowhere negative."""
    if s.bipolar:
        advice = "choose another, or set imaging.bipolar = false"
        raise ModelError(f"estimator 'positive' on a skin whose contacts may lower the conductivity; {advice}")
    own = GaussNewton(s.model, s.noise, s.prior, positive=True, amplitude=s.amplitude, model_error=s.model_error)
    return FrameWise(_by_rule(s, own, own.with_amplitude), s.model.mesh)


def kalman(s: EstimatorSettings) -> Estimator:
    """Kalman filter on images."""
    check_choice("kalman", s.prior, s.rule)
    prior = {"amplitude": s.amplitude, "model_error": s.model_error}
    return Recursive(Kalman(s.model, s.noise, s.prior, time_constant=_MEMORY, **prior), s.model.mesh)


def greit(s: EstimatorSettings) -> Estimator:
    """GREIT."""
    check_choice("greit", s.prior, s.rule)
    return FrameWise(Greit(s.model, s.noise), s.model.mesh)


def total_variation(s: EstimatorSettings) -> Estimator:
    """Total variation."""
    check_choice("total-variation", s.prior, s.rule)
    own = TotalVariation(s.model, s.noise, amplitude=0.5, model_error=s.model_error, positive=not s.bipolar)
    return FrameWise(own, s.model.mesh)


def sparse_bayes(s: EstimatorSettings) -> Estimator:
    """Sparse Bayesian learning."""
    check_choice("sparse-bayes", s.prior, s.rule)
    own = SparseBayes(s.model, s.noise, amplitude=0.5, model_error=s.model_error, positive=not s.bipolar)
    return FrameWise(own, s.model.mesh)


def absolute(s: EstimatorSettings) -> Estimator:
    """Iterated Gauss-Newton on absolute voltages."""
    own = AbsoluteGaussNewton(s.model, s.noise, s.prior, amplitude=s.amplitude, model_error=s.model_error)
    return FrameWise(_by_rule(s, own, lambda amplitude: replace(own, amplitude=amplitude)), s.model.mesh)


def absolute_variation(s: EstimatorSettings) -> Estimator:
    """Iterated Gauss-Newton on absolute voltages with total variation."""
    check_choice("absolute-variation", s.prior, s.rule)
    outline = 0.1 * float(np.ptp(s.model.mesh.nodes, axis=0).max())
    own = AbsoluteGaussNewton(s.model, s.noise, outline=outline, amplitude=s.amplitude, model_error=s.model_error)
    return FrameWise(own, s.model.mesh)


_ESTIMATORS = (gauss_newton, positive, kalman, greit, total_variation, sparse_bayes, absolute, absolute_variation)
ESTIMATORS: Registry[Callable[[EstimatorSettings], Estimator]] = Registry(
    "estimator",
    "ohmskin.estimators",
    {make.__name__.replace("_", "-"): make for make in _ESTIMATORS},
    ModelError,
    Estimator,
)
"""Estimators by name."""


def image_of(name: str) -> tuple[str, str]:
    """Estimator and prior of a short name: an estimator, a prior (of one-step Gauss-Newton), or ``ESTIMATOR:PRIOR``.

    Raises:
        ModelError: If there is no such estimator or prior; the message lists the choices.
    """
    first, _, second = name.partition(":")
    if first in PRIORS and not second:
        return "gauss-newton", first
    if first not in ESTIMATORS or (second and second not in PRIORS):
        raise ModelError(f"no estimator or prior {name!r}; choose from {', '.join([*ESTIMATORS, *PRIORS])}")
    return first, second or "paper"
