"""How strongly to regularise: rules that choose the prior amplitude of a `GaussNewton` estimator, each with its curve.

Each takes the estimator, the data, and the amplitudes to try (n,), a wide range unless given. One singular value
decomposition of the data's rows in image modes makes every image of every amplitude a matter of filter factors, so that
a whole curve costs as much as one image.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import ModelError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Mesh
from ohmskin.inverse.gauss_newton import GaussNewton
from ohmskin.inverse.modes import ImageModes, check_positive
from ohmskin.registry import Registry
from ohmskin.scan import Difference


@dataclass(frozen=True)
class Choice:
    """A chosen amplitude and the curve behind it.

    Args:
        rule: Name of the rule.
        amplitude: The prior amplitude chosen (relative conductivity change); give it to `GaussNewton.with_amplitude`.
        amplitudes: (n,) amplitudes tried, rising.
        curve: (n,) criterion of the rule for each.
        meaning: The quantity on the curve, and the point chosen on it.
        residuals: (n,) norm of each image's residual (V); the horizontal axis of the L-curve.
        norms: (n,) norm of each image in the metric of the prior of amplitude one; the vertical axis of the L-curve.
    """

    rule: str
    amplitude: float
    amplitudes: Floats = field(repr=False)
    curve: Floats = field(repr=False)
    meaning: str
    residuals: Floats = field(repr=False)
    norms: Floats = field(repr=False)


class _Spectrum:
    """Data in the singular vectors of their rows: all amplitudes at once."""

    def __init__(self, estimator: GaussNewton, scans: tuple[Difference, ...], amplitudes: ArrayLike | None) -> None:
        system = estimator.modes.system(*scans)
        self.left, self.singular, self.right = np.linalg.svd(system.rows, full_matrices=False)
        self.noise = system.noise(estimator.noise, estimator.model_error)
        self.data = self.left.T @ system.volts
        self.rest = max(float(system.volts @ system.volts - self.data @ self.data), 0.0)
        self.n_data = len(system.volts)
        if amplitudes is None:
            bound = system.rows[:, int(estimator.modes.free_mean) :]  # a mean that is not penalised has no scale
            amplitudes = self.noise / (np.linalg.norm(bound, 2) * np.geomspace(10.0, 1e-5, 121))
        self.amplitudes = np.asarray(amplitudes, float)
        if self.amplitudes.ndim != 1 or len(self.amplitudes) < 5 or not (self.amplitudes > 0).all():
            raise ModelError("amplitudes to try must be at least five positive numbers")
        self.amplitudes = np.sort(self.amplitudes)
        self.weights = self.noise / self.amplitudes  # lambda
        s, w = self.singular[None, :], self.weights[:, None]
        self.filters = s**2 / (s**2 + w**2)
        self.residuals = np.sqrt((((1 - self.filters) * self.data) ** 2).sum(axis=1) + self.rest)
        self.norms = np.sqrt(((s / (s**2 + w**2) * self.data) ** 2).sum(axis=1))

    def crossing(self, curve: Floats, level: float) -> float:
        """The amplitude at which a curve first crosses a level, coming from strong regularisation."""
        above = curve > level
        k = int(np.argmax(above != above[0]))
        x, y = np.log(self.amplitudes[k - 1 : k + 1]), np.log(curve[k - 1 : k + 1])
        return float(np.exp(x[0] + (x[1] - x[0]) * (np.log(level) - y[0]) / (y[1] - y[0])))

    def choice(self, rule: str, curve: Floats, meaning: str, amplitude: float | None = None) -> Choice:
        """What a rule chooses: where its curve is lowest, unless given."""
        chosen = float(self.amplitudes[np.nanargmin(curve)]) if amplitude is None else amplitude
        return Choice(rule, chosen, self.amplitudes, curve, meaning, self.residuals, self.norms)


def physical(estimator: GaussNewton, *differences: Difference, amplitudes: ArrayLike | None = None) -> Choice:
    """The estimator's own amplitude: the expected change of a touch.

    The curve is the mean squared error to be expected of the modes, smallest there if noise and amplitude are right.
    Arguments as for `choose`.
    """
    at = _Spectrum(estimator, differences, amplitudes)
    s, w = at.singular[None, :], at.weights[:, None]
    unseen = (len(estimator.modes.modes) - len(at.singular)) * estimator.amplitude**2
    error = ((1 - at.filters) ** 2 * estimator.amplitude**2 + (at.noise * s / (s**2 + w**2)) ** 2).sum(axis=1) + unseen
    return at.choice("physical", error, "expected squared error of the modes; smallest", estimator.amplitude)


def cross_validation(estimator: GaussNewton, *differences: Difference, amplitudes: ArrayLike | None = None) -> Choice:
    """Generalised cross-validation (Golub, Heath and Wahba 1979): error of prediction. Does not use the noise.

    Arguments as for `choose`.
    """
    at = _Spectrum(estimator, differences, amplitudes)
    curve = at.n_data * at.residuals**2 / (at.n_data - at.filters.sum(axis=1)) ** 2
    return at.choice("cross-validation", curve, "squared error of predicting data left out (V2); smallest")


def l_curve(estimator: GaussNewton, *differences: Difference, amplitudes: ArrayLike | None = None) -> Choice:
    """The corner of the L-curve (Hansen 1992), log image norm over log residual. Does not use the noise.

    Arguments as for `choose`.
    """
    at = _Spectrum(estimator, differences, amplitudes)
    t = np.log(at.weights)
    x, y = np.log(at.residuals), np.log(at.norms)
    dx, dy = np.gradient(x, t), np.gradient(y, t)
    bend = (dx * np.gradient(dy, t) - np.gradient(dx, t) * dy) / np.maximum((dx**2 + dy**2) ** 1.5, 1e-300)
    bend[:2], bend[-2:] = -np.inf, -np.inf  # differences at the ends are one-sided
    best = float(at.amplitudes[np.argmax(bend)])
    return at.choice("l-curve", bend, "curvature of log image norm over log residual; largest", best)


def discrepancy(
    estimator: GaussNewton, *differences: Difference, safety: float = 1.0, amplitudes: ArrayLike | None = None
) -> Choice:
    """The discrepancy principle (Morozov): the smoothest image that fits the data as well as their noise allows.

    The residual may be `safety` times the noise. Arguments as for `choose`.

    Raises:
        ModelError: If no amplitude fits the data so closely: noise or model error is too low.
    """
    check_positive(safety=safety)
    at = _Spectrum(estimator, differences, amplitudes)
    level = safety * at.noise
    curve = at.residuals / np.sqrt(at.n_data)
    meaning = f"root mean square of the residual (V); falls to {level:.3g}"
    if curve[-1] > level:
        best = f"the data cannot be fitted to {level:.3g} V: {curve[-1]:.3g} V are left at best"
        raise ModelError(f"{best}; raise noise, model_error or safety")
    only_noise = curve[0] <= level
    return at.choice("discrepancy", curve, meaning, at.amplitudes[0] if only_noise else at.crossing(curve, level))


def evidence(estimator: GaussNewton, *differences: Difference, amplitudes: ArrayLike | None = None) -> Choice:
    """The amplitude that makes the data most probable (MacKay 1992): prior and noise white, both Gaussian.

    Arguments as for `choose`.
    """
    at = _Spectrum(estimator, differences, amplitudes)
    share = (at.singular[None, :] * at.amplitudes[:, None] / at.noise) ** 2
    curve = ((at.data / at.noise) ** 2 / (1 + share) + np.log1p(share)).sum(axis=1) + at.rest / at.noise**2
    return at.choice("evidence", curve, "-2 log probability of the data, up to a constant; smallest")


def noise_figure(
    estimator: GaussNewton, *differences: Difference, goal: float = 1.0, amplitudes: ArrayLike | None = None
) -> Choice:
    """The amplitude with a wanted noise figure (Adler and Guardo 1996; Adler et al. 2009), whatever the data's values.

    The noise figure, wanted to be `goal`, is the signal-to-noise ratio of the data over that of the image.
    Arguments as for `choose`.

    Raises:
        ModelError: If no amplitude has this noise figure; the message says which can be had.
    """
    check_positive(goal=goal)
    at = _Spectrum(estimator, differences, amplitudes)
    decomposition = at.left, at.singular, at.right
    curve = noise_figures(estimator.model, estimator.modes, decomposition, differences)(at.weights)
    meaning = f"noise figure of a small target; {goal:g}"
    if not curve.min() <= goal <= curve.max():
        raise ModelError(f"noise figure {goal:g} cannot be reached here; choose {curve.min():.3g} to {curve.max():.3g}")
    return at.choice("noise figure", curve, meaning, at.crossing(curve, goal))


def noise_figures(
    model: TransferModel,
    modes: ImageModes,
    decomposition: tuple[Floats, Floats, Floats],
    differences: tuple[Difference, ...],
) -> Callable[[ArrayLike], Floats]:
    """Noise figures (n,) of a small central target's images as a function of regularisation weights (n,).

    SNR of the data: mean magnitude of the target's signal over the noise. SNR of the image: mean magnitude of its image
    over the mean standard deviation that noise gives it, both weighted by area. `decomposition` is the singular value
    decomposition of the finite data's rows in the modes.
    """
    pairs = (model.pair_sensitivity * model.conductivity) @ small_target(model.mesh)
    volts = [(d.combination(model.pairs) @ pairs) * d.currents for d in differences]
    known = [np.isfinite(d.volts) & np.isfinite(d.currents) for d in differences]
    signal = np.concatenate(volts)[np.concatenate(known)]
    left, singular, right = decomposition
    basis, data = right @ modes.modes, left.T @ signal
    share = model.mesh.measures / model.mesh.measures.sum()

    def figure(weight: float) -> float:
        gain = singular / (singular**2 + weight**2)
        image, noise = (gain * data) @ basis, np.sqrt(gain**2 @ basis**2)
        return float(np.mean(np.abs(signal)) * (share @ noise) / (share @ np.abs(image)))

    return lambda weights: np.array([figure(weight) for weight in np.atleast_1d(weights)])


def small_target(mesh: Mesh) -> Floats:
    """A change of one (n_elem,) about the middle, within 5 % of half the longest side; three triangles at least."""
    centre = mesh.measures @ mesh.centroids / mesh.measures.sum()
    change = np.zeros(mesh.n_elem)
    change[mesh.closest_elements(centre[None], 3)[0]] = 1.0
    change[np.linalg.norm(mesh.centroids - centre, axis=1) < 0.025 * np.ptp(mesh.nodes, axis=0).max()] = 1.0
    return change


RULES: Registry[Callable[..., Choice]] = Registry(
    "rule",
    "ohmskin.rules",
    {
        "physical": physical,
        "noise figure": noise_figure,
        "cross-validation": cross_validation,
        "l-curve": l_curve,
        "discrepancy": discrepancy,
        "evidence": evidence,
    },
    ModelError,
    Choice,
)
"""Rules for the regularisation parameter, by name; other packages add theirs as entry points of ``ohmskin.rules``."""


def choose(rule: str, estimator: GaussNewton, *differences: Difference, amplitudes: ArrayLike | None = None) -> Choice:
    """The amplitude by a rule, with the rule's usual settings.

    Args:
        rule: Its name in `RULES`.
        estimator: The estimator whose amplitude is chosen.
        *differences: The data: one scan, or several fused.
        amplitudes: (n,) amplitudes to try, five or more; a wide range unless given.

    Raises:
        ModelError: If there is no such rule; the message lists the rules.
    """
    return RULES[rule](estimator, *differences, amplitudes=amplitudes)
