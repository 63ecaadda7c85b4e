"""Gaussian processes of offsets: the gradient that hyperparameters are found by, and what they then say."""

import numpy as np
import pytest

from ohmskin.calibrate.processes import Density, regress


@pytest.mark.parametrize("features", [0, 24])
def test_the_gradient_of_the_density_is_that_of_its_values(features: int) -> None:
    random = np.random.default_rng(0)
    at = np.hstack([random.uniform(0, 0.2, (40, 2)), 5 * random.standard_normal((40, features))])
    offsets = 1e-3 * np.sin(20 * at[:, :2]) + 1e-4 * random.standard_normal((40, 2))
    density = Density(at, offsets, 0.2)
    logs = density.middle + 0.3 * random.standard_normal(5)
    by_values = [(density(logs + 1e-5 * one)[0] - density(logs - 1e-5 * one)[0]) / 2e-5 for one in np.eye(5)]
    np.testing.assert_allclose(density(logs)[1], by_values, rtol=1e-4, atol=1e-4)


def test_a_smooth_offset_is_found_to_its_noise_and_the_errors_stated_are_those_made() -> None:
    random = np.random.default_rng(1)
    at = random.uniform(0, 0.2, (300, 2))
    true = 1e-3 * np.stack([np.sin(25 * at[:, 0]), np.cos(25 * at[:, 1])], axis=1)
    found, variances = regress(at[:200], (true + 2e-4 * random.standard_normal(true.shape))[:200], 0.2)(at[200:])
    errors = found - true[200:]
    assert np.sqrt(np.mean(errors**2)) < 1e-4
    noisy = errors + 2e-4 * random.standard_normal(errors.shape)
    assert np.mean(noisy**2 / variances[:, None]) == pytest.approx(1.0, abs=0.25)
