"""Networks that estimate offsets of positions, trained by scikit-learn; the loop needs NumPy alone."""

import warnings
from importlib.util import find_spec
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.skin.positions import Networks, inputs

COUNT = 5
_HIDDEN, _DECAY, _BATCH = (64, 32), 1e-2, 64
_EPOCHS, _PATIENCE, _ASIDE = 250, 10, 0.15  # at most; without progress; share of the presses that tells progress


def can_train() -> bool:
    """Whether scikit-learn is installed."""
    return find_spec("sklearn") is not None


def trained(at: Floats, offsets: Floats) -> Networks | None:
    """Networks of offsets (n, 2) at positions and features (n, 2 + n_features) (m); None without scikit-learn.

    Each stops when its error at a share of the presses, another for each, no longer falls.
    """
    if not can_train():
        return None
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPRegressor

    given = inputs(at)
    middle, spread = given.mean(axis=0), np.maximum(given.std(axis=0), 1e-9)
    scale = max(float(offsets.std()), 1e-9)
    networks: list[Any] = []
    for number in range(COUNT):
        one = MLPRegressor(
            hidden_layer_sizes=_HIDDEN,
            alpha=_DECAY,
            batch_size=min(_BATCH, len(at) // 2),
            max_iter=_EPOCHS,
            early_stopping=True,
            n_iter_no_change=_PATIENCE,
            validation_fraction=_ASIDE,
            random_state=number,
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            networks.append(one.fit((given - middle) / spread, offsets / scale))
    layers = tuple(
        (np.stack([one.coefs_[k] for one in networks]), np.stack([one.intercepts_[k][None] for one in networks]))
        for k in range(len(_HIDDEN) + 1)
    )
    return Networks(layers, middle, spread, scale)
