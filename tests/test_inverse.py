"""One-step Gauss-Newton: the textbook formula, its invariances, its noise, and touches found where they are."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ohmskin.drive import OptimalDrive
from ohmskin.errors import DataError, ModelError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Electrodes, Mesh, Rectangle, mesh_domain
from ohmskin.inverse import GaussNewton, paper_laplacian
from ohmskin.inverse.priors import mean_diagonal
from ohmskin.scan import Difference, DrivePattern, adjacent, measure_others, opposite

SHEET = Rectangle(0.2, 0.2)
GRID = Electrodes.grid(SHEET)
BASE = adjacent([GRID.rings[0]])
CURRENT = 1e-3
NOISE, AMPLITUDE = 2e-4, 0.3


@cache
def model() -> TransferModel:
    mesh = mesh_domain(SHEET, 0.014, GRID.positions)
    return TransferModel(mesh, GRID, 1.83e-3 * np.random.default_rng(0).uniform(0.7, 1.4, mesh.n_elem))


@cache
def estimator() -> GaussNewton:
    return GaussNewton(model(), NOISE, amplitude=AMPLITUDE)


@cache
def covariance() -> np.ndarray:
    """Gamma: s^2 R^-1, scaled to a mean variance of s^2 with the same estimate of the mean as the estimator's."""
    penalty = paper_laplacian(model().mesh).toarray()
    return AMPLITUDE**2 * np.linalg.inv(penalty) / mean_diagonal(lambda x: np.linalg.solve(penalty, x), len(penalty))


def textbook(*differences: Difference, noise: float = NOISE) -> np.ndarray:
    """x = Gamma J^T (J Gamma J^T + sigma^2 I)^-1 dv, dense, with relative conductivity changes."""
    jacobian = np.vstack([
        four_terminal_jacobian(d.pattern) * d.currents[:, None] * model().conductivity for d in differences
    ])  # fmt: skip
    volts = np.concatenate([d.volts for d in differences])
    known = np.isfinite(volts)
    jacobian, volts = jacobian[known], volts[known]
    gain = covariance() @ jacobian.T
    return gain @ np.linalg.solve(jacobian @ gain + noise**2 * np.eye(len(volts)), volts)


def four_terminal_jacobian(pattern: DrivePattern) -> np.ndarray:
    """-int grad u . grad v of each measurement, from the potentials alone."""
    mesh, u = model().mesh, model().potentials
    field = np.einsum("ekd,ekl->eld", mesh.gradients, u[mesh.elements])
    a, b, c, d = pattern.quadruples.T
    return -np.einsum("emd,emd,e->me", field[:, a] - field[:, b], field[:, c] - field[:, d], mesh.measures)


def touch(at: tuple[float, float], pattern: DrivePattern, rise: float = 0.5, seed: int | None = None) -> Difference:
    """Voltage change of a disc of raised conductivity, radius 12 mm, on the estimator's mesh."""
    inside = np.linalg.norm(model().mesh.centroids - at, axis=1) < 0.012
    touched = TransferModel(model().mesh, GRID, model().conductivity * (1 + rise * inside))
    volts = touched.voltages(pattern, CURRENT) - model().voltages(pattern, CURRENT)
    if seed is not None:
        volts = volts + NOISE * np.random.default_rng(seed).normal(size=len(volts))
    return Difference(pattern, np.full(pattern.n_meas, CURRENT), volts)


ADAPTIVE = OptimalDrive(GRID, 16).pattern([np.array([[0.06, 0.13], [0.07, 0.13], [0.06, 0.14]])])
CASES = {
    "base": (BASE,),
    "16I": (adjacent(GRID.rings),),
    "adaptive": (ADAPTIVE,),
    "fused": (BASE, ADAPTIVE),
    "fused thrice": (BASE, ADAPTIVE, opposite(range(12))),
}


@pytest.mark.parametrize("case", CASES)
def test_image_is_the_textbook_data_space_formula(case: str) -> None:
    differences = [touch((0.06, 0.13), pattern, seed=k) for k, pattern in enumerate(CASES[case])]
    expected = textbook(*differences)
    image = estimator().reconstruct(*differences).values
    np.testing.assert_allclose(image, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_image_is_the_textbook_formula_for_any_pattern_and_currents(seed: int) -> None:
    rng = np.random.default_rng(seed)
    injections = np.array([rng.choice(16, 2, replace=False) for _ in range(rng.integers(1, 20))])
    pattern = measure_others(injections, rng.permutation(16))
    currents = rng.uniform(0.5e-3, 2e-3, pattern.n_inj)[pattern.measurements[:, 0]]
    volts = touch((0.12, 0.05), pattern).volts * currents / CURRENT + NOISE * rng.normal(size=pattern.n_meas)
    difference = Difference(pattern, currents, volts)
    expected = textbook(difference)
    np.testing.assert_allclose(
        estimator().reconstruct(difference).values, expected, rtol=0, atol=1e-7 * np.abs(expected).max()
    )


def test_a_stated_model_error_adds_to_the_noise_in_proportion_to_the_data() -> None:
    difference = touch((0.06, 0.13), BASE, seed=0)
    noise = np.hypot(NOISE, 0.1 * np.sqrt(np.mean(difference.volts**2)))
    expected = textbook(difference, noise=noise)
    image = GaussNewton(model(), NOISE, amplitude=AMPLITUDE, model_error=0.1).reconstruct(difference).values
    np.testing.assert_allclose(image, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_the_mean_prior_variance_is_right_to_two_per_cent() -> None:
    penalty = paper_laplacian(model().mesh).toarray()
    estimate = mean_diagonal(lambda x: np.linalg.solve(penalty, x), len(penalty))
    assert estimate == pytest.approx(np.mean(np.diag(np.linalg.inv(penalty))), rel=0.02)


def test_the_laplacian_of_eq_5_has_three_on_its_diagonal_and_minus_one_for_neighbours() -> None:
    square = Mesh(np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float), np.array([[0, 1, 2], [0, 2, 3]]))
    np.testing.assert_array_equal(paper_laplacian(square).toarray(), [[3, -1], [-1, 3]])
    mesh = model().mesh
    shared = (mesh.elements[:, None, :, None] == mesh.elements[None, :, None, :]).sum((2, 3))
    np.testing.assert_array_equal(paper_laplacian(mesh).toarray(), 3 * np.eye(mesh.n_elem) - (shared == 2))
    assert np.linalg.eigvalsh(paper_laplacian(mesh).toarray())[0] > 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_channels_that_are_not_finite_are_left_out_as_if_never_measured(bad: float) -> None:
    full = touch((0.06, 0.13), BASE, seed=0)
    lost = np.arange(BASE.n_meas) % 7 == 3
    holed = Difference(BASE, full.currents, np.where(lost, bad, full.volts))
    reduced = Difference(
        DrivePattern(BASE.injections, BASE.measurements[~lost]), full.currents[~lost], full.volts[~lost]
    )
    expected = estimator().reconstruct(reduced)
    image = estimator().reconstruct(holed)
    np.testing.assert_allclose(image.values, expected.values, atol=1e-9 * np.abs(expected.values).max())
    np.testing.assert_allclose(image.noise_std([0, 50]), expected.noise_std([0, 50]), rtol=1e-9)
    unknown_current = Difference(BASE, np.where(lost, bad, full.currents), full.volts)
    np.testing.assert_allclose(estimator().reconstruct(unknown_current).values, expected.values, atol=1e-9)


def test_nothing_finite_is_an_error_and_not_an_image() -> None:
    with pytest.raises(DataError, match="no finite measurement"):
        estimator().reconstruct(Difference(BASE, np.full(108, CURRENT), np.full(108, np.nan)))
    with pytest.raises(DataError, match="give at least one"):
        estimator().reconstruct()


@pytest.mark.parametrize("conductivity", [1e-3, 1e3])
def test_the_image_does_not_depend_on_the_unit_of_conductivity(conductivity: float) -> None:
    """Voltages scale with 1 / sigma, so at the same signal-to-noise ratio the relative image is the same."""
    difference = touch((0.06, 0.13), BASE, seed=0)
    factor = conductivity / 1.83e-3
    scaled = GaussNewton(model().scaled(factor), NOISE / factor, amplitude=AMPLITUDE)
    image = scaled.reconstruct(Difference(BASE, difference.currents, difference.volts / factor)).values
    expected = estimator().reconstruct(difference).values
    np.testing.assert_allclose(image, expected, atol=1e-7 * np.abs(expected).max())


def test_the_image_does_not_depend_on_the_current_at_the_same_signal_to_noise_ratio() -> None:
    difference = touch((0.06, 0.13), BASE, seed=0)
    louder = GaussNewton(model(), 50 * NOISE, amplitude=AMPLITUDE)
    image = louder.reconstruct(Difference(BASE, 50 * difference.currents, 50 * difference.volts)).values
    expected = estimator().reconstruct(difference).values
    np.testing.assert_allclose(image, expected, atol=1e-9 * np.abs(expected).max())


def test_noise_std_is_the_scatter_of_images_of_noise() -> None:
    some = np.array([3, 77, 200, model().mesh.n_elem - 1])
    rng = np.random.default_rng(0)
    currents = np.full(BASE.n_meas, CURRENT)
    volts = NOISE * rng.normal(size=(1000, BASE.n_meas))
    images = np.array([estimator().reconstruct(Difference(BASE, currents, v)).values[some] for v in volts])
    stated = estimator().reconstruct(Difference(BASE, currents, volts[0])).noise_std(some)
    assert stated == pytest.approx(images.std(axis=0), rel=4 / np.sqrt(2000))
    assert estimator().reconstruct(Difference(BASE, currents, volts[0])).noise_std(77)[0] == pytest.approx(
        stated[1], rel=1e-12
    )


def test_more_data_make_a_better_image_of_the_truth() -> None:
    """Among truths drawn from the prior the fused image errs less than either of its parts, on average
    (Gauss-Markov)."""
    root = np.linalg.cholesky(covariance())
    patterns = (BASE, ADAPTIVE)
    error = np.zeros(3)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        truth = 0.01 * root @ rng.normal(size=len(root))
        exact = [CURRENT * four_terminal_jacobian(p) @ (truth * model().conductivity) for p in patterns]
        volts = [v + 0.01 * NOISE * rng.normal(size=len(v)) for v in exact]
        data = [Difference(p, np.full(p.n_meas, CURRENT), v) for p, v in zip(patterns, volts, strict=True)]
        for k, differences in enumerate(([data[0]], [data[1]], data)):
            error[k] += np.sum((estimator().reconstruct(*differences).values - truth) ** 2)
    assert error[2] < error[:2].min()


@pytest.mark.parametrize("sign", [1, -1])
def test_a_rise_of_conductivity_is_positive_in_the_image_and_a_fall_negative(sign: int) -> None:
    image = estimator().reconstruct(touch((0.06, 0.13), adjacent(GRID.rings), rise=0.3 * sign)).values
    largest = int(np.abs(image).argmax())
    assert sign * image[largest] > 0
    assert np.linalg.norm(model().mesh.centroids[largest] - [0.06, 0.13]) < 0.015


@pytest.mark.parametrize("at", [(0.1, 0.1), (0.05, 0.06), (0.14, 0.07), (0.03, 0.17), (0.1, 0.03), (0.115, 0.15)])
def test_a_touch_is_imaged_where_it_is_though_the_data_come_from_another_mesh(at: tuple[float, float]) -> None:
    sheet = np.full((mesh := mesh_domain(SHEET, 0.0045, GRID.positions)).n_elem, 1.83e-3)
    inside = np.linalg.norm(mesh.centroids - at, axis=1) < 0.01
    pattern = adjacent(GRID.rings)
    quiet, touched = (
        TransferModel(mesh, GRID, s).voltages(pattern, CURRENT) for s in (sheet, sheet * (1 + 0.5 * inside))
    )
    volts = touched - quiet + 1e-5 * np.random.default_rng(0).normal(size=len(quiet))
    coarse = coarse_estimator()
    image = coarse.reconstruct(Difference(pattern, np.full(pattern.n_meas, CURRENT), volts)).values
    mass = coarse.model.mesh.measures * np.where(image > image.max() / 2, image, 0)
    found = mass @ coarse.model.mesh.centroids / mass.sum()
    assert np.linalg.norm(found - at) < 0.004
    assert 0.02 < image.max() < 1.0  # a rise of 0.5, blurred


@cache
def coarse_estimator() -> GaussNewton:
    sheet = TransferModel(mesh_domain(SHEET, 0.0065, GRID.positions), GRID, 1.83e-3)
    return GaussNewton(sheet, noise=1e-5, amplitude=0.1, model_error=0.02)


@pytest.mark.parametrize("noise", [1e-9, 1e-18])
def test_data_without_noise_still_make_an_image(noise: float) -> None:
    quiet = GaussNewton(model(), noise, amplitude=AMPLITUDE)
    difference = touch((0.06, 0.13), BASE, rise=0.01)
    image = quiet.reconstruct(difference).values
    predicted = CURRENT * four_terminal_jacobian(BASE) @ (image * model().conductivity)
    assert np.linalg.norm(predicted - difference.volts) < 1e-2 * np.linalg.norm(difference.volts)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"noise": 0.0}, "noise is 0.0; it must be finite and positive"),
        ({"noise": np.nan}, "noise is nan"),
        ({"noise": np.full(3, 1e-6)}, r"noise is an array of shape \(3,\); give one number"),
        ({"amplitude": -1.0}, "amplitude is -1.0; it must be finite and positive"),
        ({"model_error": -0.1}, "model_error is -0.1; it must be finite and not negative"),
        ({"model_error": np.inf}, "model_error is inf"),
    ],
)
def test_settings_out_of_range_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        GaussNewton(model(), **{"noise": NOISE, **settings})


def test_normalised_data_are_imaged_as_shares_of_the_untouched_skins_voltages() -> None:
    """Rows, data and noise divided by v0: (J / v0)^T (J / v0) and so on, as EIDORS normalises."""
    change = touch((0.06, 0.13), CASES["16I"][0], seed=4)
    reference = model().voltages(change.pattern, CURRENT)
    change = replace(change, reference=reference)
    share = NOISE / np.abs(reference).mean()
    jacobian = four_terminal_jacobian(change.pattern) * CURRENT / reference[:, None] * model().conductivity
    prior = covariance()
    gain = prior @ jacobian.T @ np.linalg.inv(jacobian @ prior @ jacobian.T + share**2 * np.eye(change.pattern.n_meas))
    image = replace(estimator(), noise=share).reconstruct(change.normalised)
    expected = gain @ (change.volts / reference)
    np.testing.assert_allclose(image.values, expected, atol=1e-9 * np.abs(expected).max())
    with pytest.raises(DataError, match="is not known"):
        _ = touch((0.06, 0.13), BASE).normalised


def test_each_measurement_counts_by_its_own_noise() -> None:
    """The inverse covariance of the data is diagonal, as EIDORS' meas_icov."""
    change = touch((0.06, 0.13), CASES["16I"][0], seed=4)
    noise = NOISE * np.random.default_rng(5).uniform(0.5, 3, change.pattern.n_meas)
    jacobian, prior = four_terminal_jacobian(change.pattern) * CURRENT * model().conductivity, covariance()
    gain = prior @ jacobian.T @ np.linalg.inv(jacobian @ prior @ jacobian.T + np.diag(noise**2))
    image = replace(estimator(), noise=1.0).reconstruct(change.weighted(noise))
    expected = gain @ change.volts
    np.testing.assert_allclose(image.values, expected, atol=1e-9 * np.abs(expected).max())
    for wrong in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(DataError, match="not positive"):
            change.weighted(np.where(np.arange(change.pattern.n_meas) == 3, wrong, noise))
