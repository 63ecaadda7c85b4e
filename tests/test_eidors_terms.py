"""One-step Gauss-Newton by EIDORS' hyperparameter: the same matrix as its formula, and its noise figure."""

import numpy as np
import pytest

import ohmskin as ohm
from ohmskin.arrays import Floats
from ohmskin.errors import ModelError
from ohmskin.inverse import EIDORS_PRIORS, eidors_one_step

SHEET = ohm.Rectangle(0.2, 0.2)
ELECTRODES = ohm.Electrodes.grid(SHEET)
PATTERN = ohm.adjacent(ELECTRODES.rings)
CURRENT = 1e-3


@pytest.fixture(scope="module")
def model() -> ohm.TransferModel:
    return ohm.TransferModel(ohm.mesh_domain(SHEET, 0.018, ELECTRODES.positions), ELECTRODES, 1.83e-3)


def root(model: ohm.TransferModel, jacobian: Floats, prior: str) -> Floats:
    """A matrix whose product with itself is EIDORS' prior."""
    if prior == "tikhonov":
        return np.eye(model.mesh.n_elem)
    if prior == "noser":
        return np.diag((jacobian**2).sum(axis=0) ** 0.25)
    pairs = np.argwhere(np.triu(model.mesh.adjacency.toarray()))
    rows = np.zeros((len(pairs), model.mesh.n_elem))
    rows[np.arange(len(pairs)), pairs[:, 0]], rows[np.arange(len(pairs)), pairs[:, 1]] = np.sqrt(2), -np.sqrt(2)
    return rows


@pytest.mark.parametrize("normalised", [False, True])
@pytest.mark.parametrize("prior", EIDORS_PRIORS)
@pytest.mark.parametrize("share", [0.1, 0.01])
def test_the_matrix_is_that_of_least_squares(
    model: ohm.TransferModel, prior: str, share: float, normalised: bool
) -> None:
    jacobian = model.sensitivity(PATTERN, CURRENT)
    if normalised:
        jacobian = jacobian / model.voltages(PATTERN, CURRENT)[:, None]
    rows = root(model, jacobian, prior)
    hyperparameter = share * np.linalg.norm(jacobian, 2) / np.linalg.norm(rows, 2)
    found = eidors_one_step(model, PATTERN, hyperparameter, prior, CURRENT, normalised=normalised)
    whole, data = np.vstack([jacobian, hyperparameter * rows]), np.eye(len(jacobian) + len(rows))[:, : len(jacobian)]
    expected = np.linalg.lstsq(whole, data, rcond=None)[0]
    assert np.linalg.norm(found.matrix - expected) < 1e-9 * np.linalg.norm(expected)


def test_images_are_changes_of_conductivity_and_those_of_its_estimator(model: ohm.TransferModel) -> None:
    there = int(model.mesh.locate(np.array([[0.08, 0.11]]))[0][0])
    touched = model.with_conductivity(1.83e-3 * (1 + 0.1 * (np.arange(model.mesh.n_elem) == there)))
    volts = touched.voltages(PATTERN, CURRENT) - model.voltages(PATTERN, CURRENT)
    change = ohm.Difference(PATTERN, np.full(PATTERN.n_meas, CURRENT), volts)
    found = eidors_one_step(model, PATTERN, 1e-4, "tikhonov", CURRENT)
    image = found.reconstruct(change)
    assert image.argmax() == there
    np.testing.assert_allclose(image, 1.83e-3 * found.estimator.reconstruct(change).values, rtol=1e-8, atol=1e-12)


def test_the_noise_figure_is_what_noise_on_each_channel_in_turn_makes(model: ohm.TransferModel) -> None:
    found, sizes = eidors_one_step(model, PATTERN, 1e-2, "noser", CURRENT), model.mesh.measures
    signal = model.sensitivity(PATTERN, CURRENT)[:, 60]
    in_image, in_data = [], []
    for noise in 1e-3 * np.eye(PATTERN.n_meas):
        in_image.append(np.std(sizes * (found.matrix @ noise), ddof=1))
        in_data.append(np.std(noise, ddof=1))
    of_data = np.abs(signal).mean() / np.mean(in_data)
    of_image = np.abs(sizes * (found.matrix @ signal)).mean() / np.mean(in_image)
    assert found.noise_figure(signal) == pytest.approx(of_data / of_image, rel=1e-9)
    stronger = eidors_one_step(model, PATTERN, 1e-1, "noser", CURRENT)
    assert stronger.noise_figure(signal) < found.noise_figure(signal)


def test_what_does_not_fit_is_refused(model: ohm.TransferModel) -> None:
    with pytest.raises(ModelError, match="choose from noser, tikhonov, laplace"):
        eidors_one_step(model, PATTERN, 0.03, "total variation")
    with pytest.raises(ModelError, match="hyperparameter"):
        eidors_one_step(model, PATTERN, 0.0)
    uneven = model.with_conductivity(np.linspace(1, 2, model.mesh.n_elem))
    with pytest.raises(ModelError, match="one conductivity"):
        eidors_one_step(uneven, PATTERN, 0.03, "laplace")
    with pytest.raises(ModelError, match="takes \\(208,\\) data"):
        eidors_one_step(model, PATTERN, 0.03).noise_figure(np.ones(3))
