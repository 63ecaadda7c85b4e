"""Gaussian processes of offsets on positions and features: hyperparameters, inducing points, and weights."""

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from ohmskin.arrays import Floats, Ints
from ohmskin.skin.positions import Regression, kernel

_TUNED = 250  # presses that hyperparameters are tuned on
_INDUCING = 200, 400  # inducing points of positions alone, and with features
_JITTER = 1e-6


def regress(at: Floats, offsets: Floats, size: float) -> Regression:
    """A Gaussian process of offsets.

    Args:
        at: (n, 2 + n_features) positions (m) and features of presses.
        offsets: (n, 2) there (m).
        size: Of the sheet (m).
    """
    amplitudes, lengths, noise = _tuned(at, offsets, size)
    chosen = _spread(at, amplitudes, lengths)
    inducing = at[chosen]
    variance = float((amplitudes[: 1 + (at.shape[1] > 2)] ** 2).sum())
    own = kernel(inducing, inducing, amplitudes, lengths) + _JITTER * variance * np.eye(len(chosen))
    cross = kernel(at, inducing, amplitudes, lengths)
    data = own + cross.T @ cross / noise**2
    weights = np.asarray(np.linalg.solve(data, cross.T @ offsets) / noise**2, float)
    lowered = np.linalg.inv(own) - np.linalg.inv(data)
    values, vectors = np.linalg.eigh((lowered + lowered.T) / 2)
    root: Floats = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    factor = np.asarray(np.linalg.qr(root[:, ::-1]).R[::-1, ::-1], float)  # triangular, which is half to keep
    return Regression(inducing, weights, factor, amplitudes, lengths, noise)


def _tuned(at: Floats, offsets: Floats, size: float) -> tuple[Floats, Floats, float]:
    """Amplitudes, length scales and noise of the largest posterior density, of some presses."""
    some = slice(None, None, -(-len(at) // _TUNED))
    density = Density(at[some], offsets[some], size)
    bounds = [(one - 4 * width, one + 4 * width) for one, width in zip(density.middle, density.widths, strict=True)]
    found = minimize(density, density.middle, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 25})
    best = np.exp(found.x)
    return best[:2], best[2:4], float(best[4])


class Density:
    """The negative logarithm of the posterior density of hyperparameters, and its gradient.

    Args:
        at: (n, 2 + n_features) positions (m) and features of presses.
        offsets: (n, 2) (m).
        size: Of the sheet (m).

    Attributes:
        middle: (5,) likeliest beforehand: logarithms of two amplitudes (m), of their lengths (m, 1), of the noise (m).
        widths: (5,) standard deviations of these beforehand.
    """

    def __init__(self, at: Floats, offsets: Floats, size: float) -> None:
        self._near, features = cdist(at[:, :2], at[:, :2], "sqeuclidean"), at[:, 2:]
        self._far = np.sqrt(3.0) * cdist(features, features) if features.shape[1] else None
        self._offsets = offsets
        usual = max(float(offsets.std()), 1e-6 * size)
        apart = features - features.mean(axis=0)
        spread = np.sqrt(2 * max(float((apart**2).sum(axis=1).mean()), 1e-12))
        self.middle: Floats = np.log([usual, usual, 0.25 * size, spread, 0.5 * usual])
        self.widths = np.array([1.0, 1.0, 0.7, 1.0, 1.0])

    def __call__(self, logs: Floats) -> tuple[float, Floats]:
        """The value and its gradient (5,) at logarithms of hyperparameters (5,)."""
        a, b, c, d, noise = np.exp(logs)
        count, outputs = self._offsets.shape
        rest, away = (logs - self.middle) / self.widths, self._far
        near = a**2 * np.exp(-0.5 * self._near / c**2)
        parts, covariance = {0: 2 * near, 2: near * self._near / c**2}, near
        if away is not None:
            decay = b**2 * np.exp(-away / d)
            far = decay * (1 + away / d)
            parts, covariance = parts | {1: 2 * far, 3: decay * (away / d) ** 2}, near + far
        covariance = covariance + (noise**2 + 1e-9 * a**2) * np.eye(count)
        lower, failed = dpotrf(covariance, lower=True)
        if failed:
            return 1e12, rest / self.widths
        inverse, _ = dpotri(lower, lower=True)
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        solved = inverse @ self._offsets
        value = 0.5 * (self._offsets * solved).sum() + outputs * np.log(np.diag(lower)).sum() + 0.5 * (rest**2).sum()
        by_covariance = 0.5 * (outputs * inverse - solved @ solved.T)
        gradient = rest / self.widths
        for number, part in parts.items():
            gradient[number] += np.vdot(by_covariance, part)
        gradient[4] += 2 * noise**2 * np.trace(by_covariance)
        return float(value), gradient


def _spread(at: Floats, amplitudes: Floats, lengths: Floats) -> Ints:
    """Numbers of inducing points: each where those before say least (pivoted Cholesky)."""
    count = min(len(at), _INDUCING[at.shape[1] > 2])
    variance = float((amplitudes[: 1 + (at.shape[1] > 2)] ** 2).sum())
    left, rows, chosen = np.full(len(at), variance), np.empty((count, len(at))), np.empty(count, np.int64)
    for k in range(count):
        chosen[k] = left.argmax()
        if left[chosen[k]] < _JITTER * variance:
            return chosen[:k]
        row = kernel(at[chosen[k]][None], at, amplitudes, lengths)[0] - rows[:k, chosen[k]] @ rows[:k]
        rows[k] = row / np.sqrt(left[chosen[k]])
        left = left - rows[k] ** 2
    return chosen
