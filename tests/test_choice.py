"""Rules for the regularisation: near the best that hindsight knows, and their curves are what they say."""

from functools import cache

import numpy as np
import pytest

from ohmskin.errors import ModelError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Electrodes, Rectangle, mesh_domain
from ohmskin.inverse import (
    RULES,
    GaussNewton,
    choose,
    cross_validation,
    discrepancy,
    evidence,
    l_curve,
    noise_figure,
    physical,
)
from ohmskin.inverse.choice import small_target
from ohmskin.scan import Difference, adjacent

SHEET = Rectangle(0.2, 0.2)
GRID = Electrodes.grid(SHEET)
PATTERN = adjacent(GRID.rings)
CURRENT, NOISE, AMPLITUDE = 1e-3, 2e-4, 0.05
CURRENTS = np.full(PATTERN.n_meas, CURRENT)


@cache
def estimator() -> GaussNewton:
    """Told an amplitude ten times too high."""
    return GaussNewton(
        TransferModel(mesh_domain(SHEET, 0.014, GRID.positions), GRID, 1.83e-3), NOISE, amplitude=10 * AMPLITUDE
    )


@cache
def truth(seed: int) -> tuple[np.ndarray, Difference]:
    """Modes drawn from the prior at the true amplitude, and data of them."""
    rng = np.random.default_rng(seed)
    u = AMPLITUDE * rng.normal(size=estimator().modes.n_modes)
    volts = CURRENT * estimator().modes.rows(PATTERN) @ u + NOISE * rng.normal(size=PATTERN.n_meas)
    return u, Difference(PATTERN, CURRENTS, volts)


def error(amplitude: float, seed: int) -> float:
    """Squared error of the image."""
    u, difference = truth(seed)
    image = estimator().with_amplitude(amplitude).reconstruct(difference).values
    return float(np.sum((image - u @ estimator().modes.modes) ** 2))


@pytest.mark.parametrize(
    ("rule", "worst"), [("cross-validation", 1.25), ("evidence", 1.15), ("discrepancy", 1.6), ("l-curve", 1.6)]
)
def test_each_rule_comes_near_the_oracle(rule: str, worst: float) -> None:
    """Mean squared error over twenty truths, against the best amplitude for each, chosen in the knowledge of the
    truth."""
    chosen, oracle, told = [], [], []
    for seed in range(20):
        choice = choose(rule, estimator(), truth(seed)[1])
        chosen.append(error(choice.amplitude, seed))
        oracle.append(min(error(a, seed) for a in choice.amplitudes[::6]))
        told.append(error(estimator().amplitude, seed))
    assert np.mean(told) > 1.8 * np.mean(oracle)  # the amplitude matters
    assert np.mean(chosen) < worst * np.mean(oracle)


@pytest.mark.parametrize("rule", ["cross-validation", "evidence", "discrepancy", "l-curve"])
def test_a_mean_that_is_not_penalised_has_no_part_in_what_amplitudes_are_tried(rule: str) -> None:
    noise, modes = NOISE / 300, estimator().modes
    free = GaussNewton(estimator().model, noise, "laplacian", amplitude=0.2)
    volts = CURRENT * modes.rows(PATTERN) @ truth(3)[0] + noise * np.random.default_rng(3).normal(size=PATTERN.n_meas)
    difference = Difference(PATTERN, CURRENTS, volts)
    choice, wide = (choose(rule, free, difference, amplitudes=tried) for tried in (None, np.geomspace(1e-6, 10, 141)))
    assert choice.amplitudes[5] < choice.amplitude < choice.amplitudes[-5]
    assert choice.amplitude == pytest.approx(wide.amplitude, rel=0.2)


def test_evidence_finds_the_amplitude_that_the_truth_was_drawn_with() -> None:
    found = [evidence(estimator(), truth(seed)[1]).amplitude for seed in range(20)]
    assert np.exp(np.mean(np.log(found))) == pytest.approx(AMPLITUDE, rel=0.1)


def test_discrepancy_leaves_as_much_as_noise_would() -> None:
    _, difference = truth(0)
    choice = discrepancy(estimator(), difference, safety=1.1)
    fitted = estimator().with_amplitude(choice.amplitude)
    rows = CURRENT * fitted.model.sensitivity(PATTERN) * fitted.model.conductivity
    left = difference.volts - rows @ fitted.reconstruct(difference).values
    assert np.sqrt(np.mean(left**2)) == pytest.approx(1.1 * NOISE, rel=1e-3)


def test_cross_validation_is_leaving_each_datum_out_on_average() -> None:
    """For each amplitude, GCV agrees with the mean squared error of predicting one datum from all others."""
    _, difference = truth(1)
    choice = cross_validation(estimator(), difference)
    rows = CURRENT * estimator().modes.rows(PATTERN)
    for k in (60, 75):
        weight = (NOISE / choice.amplitudes[k]) ** 2
        hat = rows @ np.linalg.solve(rows.T @ rows + weight * np.eye(rows.shape[1]), rows.T)
        left = (difference.volts - hat @ difference.volts) / (1 - np.diag(hat))
        assert choice.curve[k] == pytest.approx(np.mean(left**2), rel=0.25)
        exact = np.mean((difference.volts - hat @ difference.volts) ** 2) / np.mean(1 - np.diag(hat)) ** 2
        assert choice.curve[k] == pytest.approx(exact, rel=1e-6)


def test_evidence_is_the_gaussian_log_probability() -> None:
    _, difference = truth(2)
    choice = evidence(estimator(), difference)
    rows = CURRENT * estimator().modes.rows(PATTERN)

    def minus_two_log(amplitude: float) -> float:
        covariance = amplitude**2 * rows @ rows.T + NOISE**2 * np.eye(len(rows))
        return float(
            np.linalg.slogdet(covariance)[1] + difference.volts @ np.linalg.solve(covariance, difference.volts)
        )

    low, high = choice.amplitudes[[50, 80]]
    assert choice.curve[80] - choice.curve[50] == pytest.approx(minus_two_log(high) - minus_two_log(low), rel=1e-8)


def test_the_physical_rule_has_the_least_expected_error() -> None:
    choice = physical(estimator(), truth(0)[1])
    assert choice.amplitude == estimator().amplitude
    assert choice.amplitudes[np.argmin(choice.curve)] == pytest.approx(
        estimator().amplitude, rel=0.13
    )  # one step of the curve


def test_the_l_curve_is_that_of_the_images() -> None:
    _, difference = truth(3)
    choice = l_curve(estimator(), difference)
    assert (np.diff(choice.residuals) < 0).all()
    assert (np.diff(choice.norms) > 0).all()
    k = 70
    rows = CURRENT * estimator().modes.rows(PATTERN)
    u = np.linalg.solve(
        rows.T @ rows + (NOISE / choice.amplitudes[k]) ** 2 * np.eye(rows.shape[1]), rows.T @ difference.volts
    )
    assert choice.residuals[k] == pytest.approx(np.linalg.norm(difference.volts - rows @ u), rel=1e-6)
    assert choice.norms[k] == pytest.approx(np.linalg.norm(u), rel=1e-6)


@pytest.mark.parametrize("goal", [0.8, 1.5])
def test_the_noise_figure_wanted_is_that_of_real_noise(goal: float) -> None:
    """Signal-to-noise ratios of data and image, from 400 noisy images of the small target."""
    choice = noise_figure(estimator(), truth(0)[1], goal=goal)
    fitted = estimator().with_amplitude(choice.amplitude)
    mesh = fitted.model.mesh
    signal = CURRENT * fitted.model.sensitivity(PATTERN) @ (fitted.model.conductivity * small_target(mesh))
    rng = np.random.default_rng(0)
    noisy = [
        fitted.reconstruct(Difference(PATTERN, CURRENTS, NOISE * rng.normal(size=len(signal)))).values
        for _ in range(400)
    ]
    image = fitted.reconstruct(Difference(PATTERN, CURRENTS, signal)).values
    of_data = np.mean(np.abs(signal)) / NOISE
    of_image = (mesh.measures @ np.abs(image)) / (mesh.measures @ np.std(noisy, axis=0))
    assert of_data / of_image == pytest.approx(goal, rel=0.03)


def test_rules_that_cannot_choose_say_so() -> None:
    _, difference = truth(0)
    with pytest.raises(ModelError, match="no rule 'gcv'; choose from physical, noise figure, cross-validation"):
        choose("gcv", estimator(), difference)
    with pytest.raises(ModelError, match="noise figure 1000 cannot be reached here; choose"):
        noise_figure(estimator(), difference, goal=1e3)
    with pytest.raises(ModelError, match="goal is -1"):
        noise_figure(estimator(), difference, goal=-1)
    impossible = Difference(PATTERN, CURRENTS, np.random.default_rng(0).normal(size=PATTERN.n_meas))
    with pytest.raises(ModelError, match=r"cannot be fitted to 0.0002 V: .* raise noise"):
        discrepancy(estimator(), impossible, amplitudes=np.geomspace(1e-3, 1, 9))
    with pytest.raises(ModelError, match="at least five positive"):
        evidence(estimator(), difference, amplitudes=[1.0, -1.0])
    quiet = Difference(PATTERN, CURRENTS, 0.1 * NOISE * np.random.default_rng(0).normal(size=PATTERN.n_meas))
    assert discrepancy(estimator(), quiet).amplitude < 1e-2 * AMPLITUDE


@pytest.mark.parametrize("rule", RULES)
def test_channels_that_are_not_finite_are_left_out(rule: str) -> None:
    _, difference = truth(4)
    lost = np.arange(PATTERN.n_meas) % 9 == 2
    holed = Difference(PATTERN, CURRENTS, np.where(lost, np.nan, difference.volts))
    choice = choose(rule, estimator(), holed)
    assert np.isfinite(choice.amplitude)
    assert choice.curve.shape == choice.amplitudes.shape == choice.residuals.shape == choice.norms.shape
