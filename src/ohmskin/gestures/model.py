"""The model of gestures: a small network on the figures of an episode, as data."""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import DataError
from ohmskin.gestures.episode import FEATURES

GESTURES = ("tap", "stroke", "push", "grasp")
"""Names of the gestures that are distinguished."""

UNKNOWN = "unknown"
"""Name of an episode that is none of them, or uncertain."""

_SHIPPED = "shipped.json"
_MOST_BYTES, _MOST_HIDDEN = 1_000_000, 256


@dataclass(frozen=True, eq=False)
class GestureModel:
    """Classifies gestures by the features of an episode; see `ohmskin.gestures.train`.

    Args:
        middle, spread: (n_features,) of the training features.
        layers: Weights (n_in, n_out) and offsets (n_out,) of each layer; tanh between, softmax at the end.
        precision: (n_gestures, n_features, n_features) inverse covariance of the standardised figures of each gesture,
        centres: (n_gestures, n_features) and their means, by which features unlike all gestures are recognised.
        limit: Squared distance from the closest gesture beyond which features are unlike all.
        sure: Least probability of a reported gesture.
    """

    middle: Floats
    spread: Floats
    layers: tuple[tuple[Floats, Floats], ...]
    precision: Floats
    centres: Floats
    limit: float
    sure: float = 0.7

    def probabilities(self, features: ArrayLike) -> Floats:
        """(n, n_gestures) probabilities of `GESTURES`, of `features` (n, n_features) of episodes."""
        return self._likely(self._standard(features))

    def distances(self, features: ArrayLike) -> Floats:
        """(n,) squared distances of `features` (n, n_features) from the closest gesture that it was trained on."""
        return self._away(self._standard(features))

    def classify(self, features: ArrayLike) -> tuple[str, float]:
        """The gesture of features (n_features,) and its probability (1): `UNKNOWN` if they are outliers, or none is
        probable."""
        one = self._standard(features)[None]
        if self._away(one)[0] > self.limit:
            return UNKNOWN, 0.0
        likely: list[float] = self._likely(one)[0].tolist()
        best = max(likely)
        return (GESTURES[likely.index(best)] if best >= self.sure else UNKNOWN), best

    def _likely(self, values: Floats) -> Floats:
        *hidden, (last, offsets) = self.layers
        for weights, own in hidden:
            values = np.tanh(values @ weights + own)
        values = values @ last + offsets
        likely = np.exp(values - values.max(axis=1, keepdims=True))
        return np.asarray(likely / likely.sum(axis=1, keepdims=True))

    def _away(self, values: Floats) -> Floats:
        away = (values[:, None] - self.centres)[:, :, None]
        return np.asarray((away @ self.precision @ away.swapaxes(2, 3))[:, :, 0, 0].min(axis=1))

    def _standard(self, features: ArrayLike) -> Floats:
        return np.asarray((np.asarray(features, float) - self.middle) / self.spread)

    def dump(self) -> str:
        """This model as text (JSON), which `parse` reads back."""
        told = {"gestures": GESTURES, "features": FEATURES, "limit": self.limit, "sure": self.sure}
        arrays = {"middle": self.middle, "spread": self.spread, "precision": self.precision, "centres": self.centres}
        found = {name: np.round(one, 5).tolist() for name, one in arrays.items()}
        layers = [[np.round(part, 5).tolist() for part in layer] for layer in self.layers]
        return json.dumps(told | found | {"layers": layers})

    @classmethod
    def parse(cls, text: str) -> "GestureModel":
        """Read a model from text, which contains no code.

        Raises:
            DataError: If it is not a model, or is one of other gestures or features.
        """
        if len(text) > _MOST_BYTES:
            raise DataError(f"a model of gestures of {len(text)} bytes; it has at most {_MOST_BYTES}")
        try:
            given = json.loads(text)
            if tuple(given["gestures"]) != GESTURES or tuple(given["features"]) != FEATURES:
                raise ValueError("it is for other gestures, or has other features")
            names = ("middle", "spread", "precision", "centres")
            middle, spread, precision, centres = arrays = [np.array(given[name], float) for name in names]
            layers = tuple((np.array(w, float), np.array(b, float)) for w, b in given["layers"])
            numbers = float(given["limit"]), float(given["sure"])
            n, count = len(FEATURES), len(GESTURES)
            shapes = [one.shape for one in arrays]
            widths = [n, *(offsets.size for _, offsets in layers)]
            fits = all(w.shape == (a, len(b)) for (w, b), a in zip(layers, widths, strict=False))
            if shapes != [(n,), (n,), (count, n, n), (count, n)] or not fits or widths[-1] != count:
                raise ValueError("its arrays do not fit")
            every = [*arrays, np.array(numbers), *(part for layer in layers for part in layer)]
            if not all(np.isfinite(one).all() for one in every) or not (spread > 0).all() or max(widths) > _MOST_HIDDEN:
                raise ValueError("a number is not finite or out of range")
            return cls(middle, spread, layers, precision, centres, *numbers)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise DataError(f"not a model of gestures: {error}; train one with `ohmskin.gestures.train`") from None

    @classmethod
    def load(cls, path: str | Path | None = None) -> "GestureModel":
        """The model of the file at `path`; the one that ships unless given.

        Raises:
            DataError: If the file cannot be read, or is none.
        """
        if path is None:
            return _shipped()
        try:
            return cls.parse(Path(path).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise DataError(f"cannot read {path}: {error}") from error


@lru_cache(maxsize=1)
def _shipped() -> GestureModel:
    return GestureModel.parse(Path(__file__).with_name(_SHIPPED).read_text(encoding="utf-8"))
