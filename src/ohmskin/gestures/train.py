"""Trains the model of gestures on simulated ones (scikit-learn, the extra `learn`).

python -m ohmskin.gestures.train MODEL.json
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.errors import ModelError
from ohmskin.gestures.model import GESTURES, GestureModel
from ohmskin.gestures.reader import GestureReader
from ohmskin.gestures.simulate import Stream, simulated

_HIDDEN, _FALSE = (24,), 0.005  # units; share of simulated gestures that are taken for unlike
_SAMPLES = 6  # moments of each gesture that it is told of, the end among them
_EMPTY = np.empty(0)
_UNTRAINED = GestureModel(_EMPTY, _EMPTY, (), _EMPTY, _EMPTY, 0.0)  # for what needs the features alone


def figures(stream: Stream) -> list[Floats]:
    """The figures (n_features,) of the one episode of a stream after each frame in which something touched, and at its
    end."""
    reader = GestureReader(_UNTRAINED)
    state, found = reader.start(), list[Floats]()
    for time, contacts in stream:
        before = state.episode
        state = reader.update(state, time, contacts)
        if state.episode is not None and state.episode is not before:
            found.append(state.episode.features)
    return found


def train_gestures(seed: int = 0, count: int = 2400, progress: Callable[[str], None] = lambda _: None) -> GestureModel:
    """A model trained on so many simulated gestures.

    Raises:
        ModelError: If scikit-learn is missing.
    """
    try:
        from sklearn.neural_network import MLPClassifier
    except ImportError as error:
        raise ModelError("training needs scikit-learn: pip install 'ohmskin[learn]'") from error
    random = np.random.default_rng(seed)
    rows, names, last = list[Floats](), list[int](), list[bool]()
    for gesture, stream in simulated(seed, count):
        if not (found := figures(stream)):  # too short to be reported
            continue
        chosen = {len(found) - 1, *random.integers(0, len(found), _SAMPLES - 1).tolist()}
        for k in sorted(chosen):
            rows.append(found[k])
            names.append(GESTURES.index(gesture))
            last.append(k == len(found) - 1)
    x, y, ended = np.array(rows), np.array(names), np.array(last)
    middle, spread = x.mean(axis=0), x.std(axis=0)
    progress(f"{len(x)} moments of {ended.sum()} gestures")
    network: Any = MLPClassifier(
        hidden_layer_sizes=_HIDDEN, activation="tanh", alpha=1e-3, early_stopping=True, random_state=seed
    )
    network.fit((x - middle) / spread, y)
    layers = tuple(zip(network.coefs_, network.intercepts_, strict=True))
    standard = (x - middle) / spread
    centres, precision = [], []
    for number in range(len(GESTURES)):
        own = standard[y == number]
        centres.append(own.mean(axis=0))
        precision.append(np.linalg.inv(np.cov(own.T) + 0.05 * np.eye(own.shape[1])))
    model = GestureModel(middle, spread, layers, np.array(precision), np.array(centres), np.inf)
    return replace(model, limit=float(np.quantile(model.distances(x), 1 - _FALSE)))


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(train_gestures(progress=print).dump() + "\n", encoding="utf-8")
