"""Where contacts really are: a map learned from presses of known places, kept as text in a skin's calibration."""

import base64
import io
import zipfile
import zlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.errors import SkinError

_MOST_BYTES = 2**25  # of a map, unpacked


@dataclass(frozen=True, eq=False)
class Similarity:
    """Scale, turn, perhaps mirrored, and shift: ``linear @ position + shift``.

    Args:
        linear: (2, 2).
        shift: (2,) in metres.
    """

    linear: Floats
    shift: Floats

    def __call__(self, positions: Floats) -> Floats:
        """Positions (n, 2) in the other frame (m)."""
        return np.asarray(positions @ self.linear.T + self.shift)

    def back(self, offsets: Floats) -> Floats:
        """Offsets (n, 2) in the other frame as they are in this one (m)."""
        return np.asarray(offsets @ np.linalg.inv(self.linear).T)

    @property
    def scale(self) -> float:
        """Lengths there over lengths here (1)."""
        return float(np.sqrt(abs(np.linalg.det(self.linear))))


@dataclass(frozen=True, eq=False)
class Regression:
    """A Gaussian process of offsets on positions and features, by inducing points (Quinonero-Candela and Rasmussen,
    JMLR 6, 2005: deterministic training conditional).

    Its kernel is the sum of a squared exponential of positions and a Matern 3/2 of features.

    Args:
        inducing: (n, 2 + n_features) positions (m) and features.
        weights: (n, 2) of the mean (m).
        factor: (n, n) whose product with the kernel, squared, is by how much data lower the variance.
        amplitudes: Standard deviations of the two parts (m).
        lengths: Their length scales (m, 1).
        noise: Standard deviation of a single offset (m).
    """

    inducing: Floats
    weights: Floats
    factor: Floats
    amplitudes: Floats
    lengths: Floats
    noise: float

    def kernel(self, these: Floats, those: Floats) -> Floats:
        """Covariances (n, m) between offsets at places and features (n, 2 + n_features) and (m, ...) (m2)."""
        return kernel(these, those, self.amplitudes, self.lengths)

    def __call__(self, at: Floats) -> tuple[Floats, Floats]:
        """Offsets (n, 2) at positions and features (n, 2 + n_features) (m), and their variances (n,) (m2)."""
        near = self.kernel(at, self.inducing)
        prior = float((self.amplitudes[: 1 + (at.shape[1] > 2)] ** 2).sum())
        left = prior - ((near @ self.factor.T) ** 2).sum(axis=1)
        return near @ self.weights, np.maximum(left, 0.0) + self.noise**2


def kernel(these: Floats, those: Floats, amplitudes: Floats, lengths: Floats) -> Floats:
    """See `Regression.kernel`."""
    found = amplitudes[0] ** 2 * np.exp(-0.5 * _squares(these[:, :2], those[:, :2]) / lengths[0] ** 2)
    if these.shape[1] > 2:
        away = np.sqrt(3 * _squares(these[:, 2:], those[:, 2:])) / lengths[1]
        found += amplitudes[1] ** 2 * (1 + away) * np.exp(-away)
    return np.asarray(found)


def _squares(these: Floats, those: Floats) -> Floats:
    lengths = (these**2).sum(axis=1)[:, None] + (those**2).sum(axis=1)
    return np.asarray(np.maximum(lengths - 2 * these @ those.T, 0.0))


@dataclass(frozen=True, eq=False)
class PositionMap:
    """From the place that physics tells to the place pressed.

    Args:
        registration: From the sheet to the frame that the presses' places were given in.
        own: Whether that is the sheet's own frame, so that it corrects places; else places stay on the sheet.
        basis: (n_features, n_meas) from changes in units of their error to features.
        quadruples: (n_meas, 4) source, sink, plus, minus of the pattern learned.
        near: Tells offsets of places from places alone.
        full: Tells them from the changes, too.
        trust: By what variances are multiplied, so that ellipses hold what they should of presses not learned from (1).
    """

    registration: Similarity
    own: bool
    basis: Floats
    quadruples: Floats
    near: Regression
    full: Regression
    trust: Floats

    def features(self, changes: Floats) -> Floats:
        """(n, n_features) of changes (n, n_meas) in units of their error; what is not known counts as none."""
        return np.asarray(np.nan_to_num(changes) @ self.basis.T)

    def registered(self, positions: Floats, features: Floats | None = None) -> tuple[Floats, Floats]:
        """Places (n, 2) of contacts in the frame of the presses (m), and variances (n,) along each axis (m2).

        Args:
            positions: (n, 2) as physics tells them, on the sheet (m).
            features: (n, n_features); None: not known.
        """
        regression, trust = (self.near, self.trust[0]) if features is None else (self.full, self.trust[1])
        offsets, variances = regression(positions if features is None else np.hstack([positions, features]))
        return self.registration(positions) + offsets, trust * variances

    def __call__(self, positions: Floats, features: Floats | None = None) -> tuple[Floats, Floats]:
        """The same, on the sheet."""
        places, variances = self.registered(positions, features)
        if self.own:
            return places, variances
        back = self.registration.back(places - self.registration(positions))
        return positions + back, variances / self.registration.scale**2

    def dump(self) -> str:
        """This map as text; `PositionMap.parse` reads it back."""
        arrays = {
            "linear": self.registration.linear,
            "shift": self.registration.shift,
            "own": np.array(self.own),
            "basis": self.basis.astype(np.float32),
            "quadruples": self.quadruples.astype(np.int16),
            "trust": self.trust,
        }
        for name, one in (("near", self.near), ("full", self.full)):
            rows, columns = np.tril_indices(len(one.inducing))
            arrays |= {
                f"{name}_inducing": one.inducing.astype(np.float32),
                f"{name}_weights": one.weights,
                f"{name}_factor": one.factor[rows, columns].astype(np.float32),
                f"{name}_kernel": np.array([*one.amplitudes, *one.lengths, one.noise]),
            }
        packed = io.BytesIO()
        np.savez_compressed(packed, allow_pickle=False, **arrays)
        return base64.b64encode(packed.getvalue()).decode()

    @classmethod
    def parse(cls, text: str) -> "PositionMap":
        """Read a map from text.

        Raises:
            SkinError: If it is none.
        """
        return _parse(text)


@lru_cache(maxsize=8)
def _parse(text: str) -> PositionMap:
    try:
        packed = io.BytesIO(base64.b64decode(text, validate=True))
        with zipfile.ZipFile(packed) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > _MOST_BYTES:
                raise ValueError(f"it has more than {_MOST_BYTES} bytes")
        with np.load(packed, allow_pickle=False) as arrays:
            given = {name: np.asarray(arrays[name], float) for name in arrays.files}
        if not all(np.isfinite(one).all() for one in given.values()):
            raise ValueError("a value is not finite")
        features, n_meas = given["basis"].shape
        shapes = {"linear": (2, 2), "shift": (2,), "quadruples": (n_meas, 4), "trust": (2,), "own": ()}
        if wrong := [name for name, shape in shapes.items() if given[name].shape != shape]:
            raise ValueError(f"{wrong[0]} has shape {given[wrong[0]].shape}")
        near, full = (_regression(given, name, width) for name, width in (("near", 2), ("full", 2 + features)))
        if not ((given["trust"] > 0).all() and (given["quadruples"] >= 0).all()):
            raise ValueError("a variance or an electrode's number is negative")
        registration = Similarity(given["linear"], given["shift"])
        if not 1e-6 < registration.scale < 1e6:
            raise ValueError(f"its scale is {registration.scale:g}")
        return PositionMap(
            registration, bool(given["own"]), given["basis"], given["quadruples"], near, full, given["trust"]
        )
    except (
        ValueError,
        KeyError,
        OSError,
        EOFError,
        MemoryError,
        zipfile.BadZipFile,
        zlib.error,
        NotImplementedError,
    ) as error:
        raise SkinError(f"calibration.position_map cannot be read: {error}; learn it again") from None


def _regression(given: dict[str, Floats], name: str, width: int) -> Regression:
    inducing, weights, packed, kernel = (
        given[f"{name}_{part}"] for part in ("inducing", "weights", "factor", "kernel")
    )
    count = len(inducing)
    if inducing.shape != (count, width) or weights.shape != (count, 2) or kernel.shape != (5,):
        raise ValueError(f"{name} has shapes {inducing.shape}, {weights.shape}, {kernel.shape}")
    if packed.shape != (count * (count + 1) // 2,) or not (kernel > 0).all():
        raise ValueError(f"{name} has a factor of shape {packed.shape}, or a kernel of {kernel}")
    factor = np.zeros((count, count))
    factor[np.tril_indices(count)] = packed
    return Regression(inducing, weights, factor, kernel[:2], kernel[2:4], float(kernel[4]))
