"""Where contacts really are: a map learned from presses of known places, kept as text in a skin's calibration.

A Gaussian process, and from some hundred presses on an ensemble of networks beside it: their estimates are averaged.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ohmskin.arrays import Bools, Floats
from ohmskin.errors import SkinError
from ohmskin.skin.packed import UNREADABLE, pack, unpack

_TAUGHT = 1e-9  # part of a direction, below which it is rounding
_RIDGE = 1e-3  # beside 1 of a direction that is wholly measured: what is hardly measured counts as none


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
class Networks:
    """An ensemble of networks with rectified linear units: offsets of places and features.

    Args:
        layers: Weights (n_networks, n_in, n_out) and offsets (n_networks, 1, n_out) of each layer.
        middle, spread: (2 + n_features + 1,) of what they are given: places, features as shares of their size, and
            the logarithm of that.
        scale: Of their output (m).
    """

    layers: tuple[tuple[Floats, Floats], ...]
    middle: Floats
    spread: Floats
    scale: float

    def __call__(self, at: Floats) -> Floats:
        """Offsets (n, 2) at positions and features (n, 2 + n_features) (m)."""
        values = ((inputs(at) - self.middle) / self.spread)[None]
        for number, (weights, offsets) in enumerate(self.layers):
            values = values @ weights + offsets
            if number + 1 < len(self.layers):
                values = np.maximum(values, 0.0)
        return np.asarray(self.scale * values.mean(axis=0))


def inputs(at: Floats) -> Floats:
    """What networks are given (n, 2 + n_features + 1), of positions and features (n, 2 + n_features)."""
    size = np.maximum(np.linalg.norm(at[:, 2:], axis=1, keepdims=True), 1e-300)
    return np.hstack([at[:, :2], at[:, 2:] / size, np.log(size)])


@dataclass(frozen=True, eq=False)
class PositionMap:
    """From the place by the physical model to the place pressed.

    Args:
        registration: From the sheet to the frame that the presses' places were given in.
        own: Whether that is the sheet's own frame, so that it corrects places; else places stay on the sheet.
        basis: (n_features, n_meas) from changes in units of their error to features.
        quadruples: (n_meas, 4) source, sink, plus, minus of the pattern learned.
        near: Tells offsets of places from places alone.
        full: Tells them from the changes, too.
        trust: By what variances are multiplied, so that ellipses hold what they should of presses not learned from (1).
        known: (n_known, n_features) features of some presses learned from, as shares of the size of their changes.
        limit: Distance of such shares from the closest known ones beyond which changes are unlike those learned from,
            and
        rate: share of presses not learned from, but like those, that are beyond it (1).
        usual: (2,) of presses learned from, what features leave of a channel's change: its variance without a press
            (1), and as a share of the squared size of the changes (1).
        length: How far noise of a channel as large as all changes moves a place (m).
        networks: Tell offsets, too; None: `full` alone does.
    """

    registration: Similarity
    own: bool
    basis: Floats
    quadruples: Floats
    near: Regression
    full: Regression
    trust: Floats
    known: Floats
    limit: float
    rate: float
    usual: Floats
    length: float
    networks: Networks | None = None

    def features(self, changes: Floats) -> Floats:
        """(n, n_features) of changes (n, n_meas) in units of their error, 0 where they are not known."""
        return np.asarray(changes @ self.basis.T)

    def completed(self, changes: Floats, missing: Bools) -> Floats:
        """Changes (n_meas,) with those that are missing as the others have them, by what presses have in common."""
        rows = self.basis[:, ~missing]
        normal = rows @ rows.T + _RIDGE * np.eye(len(rows))
        found = np.linalg.solve(normal, rows @ changes[~missing])
        return np.where(missing, found @ self.basis, changes)

    def distances(self, changes: Floats) -> Floats:
        """Distances (n,) of changes (n, n_meas), as shares of their size, from those learned from (1)."""
        changes = np.where(self.taught, changes, 0.0)
        sizes = np.maximum(np.linalg.norm(changes, axis=1, keepdims=True), 1e-300)
        alike = (self.features(changes) / sizes) @ self.known.T
        return np.asarray(np.sqrt(np.maximum(1 + (self._known_squares - 2 * alike).min(axis=1), 0.0)))

    @cached_property
    def _known_squares(self) -> Floats:
        return np.asarray((self.known**2).sum(axis=1))

    @cached_property
    def taught(self) -> Bools:
        """(n_meas,) channels that the map was learned with: not doubtful ones."""
        return np.asarray(np.abs(self.basis).max(axis=0) >= _TAUGHT)

    def left(self, changes: Floats) -> tuple[Floats, Floats]:
        """Variance (n,) of what features leave of a channel's change (1), and squared sizes (n,) of all changes (1)."""
        changes = np.where(self.taught, changes, 0.0)
        squares = (changes**2).sum(axis=1)
        rest = squares - (self.features(changes) ** 2).sum(axis=1)
        return np.maximum(rest, 0.0) / max(int(self.taught.sum()) - len(self.basis), 1), np.maximum(squares, 1e-300)

    def moved_by_noise(self, changes: Floats) -> Floats:
        """Variances (n,) of places along each axis (m2) by noise that the training presses did not have, such as drift:
        by what features leave of changes (n, n_meas) beyond what they left then."""
        left, squares = self.left(changes)
        more = np.maximum(left - self.usual[0] - self.usual[1] * squares, 0.0)
        return np.asarray(self.length**2 * more / squares)

    def registered(self, positions: Floats, changes: Floats | None = None) -> tuple[Floats, Floats]:
        """Places (n, 2) of contacts in the frame of the presses (m), and variances (n,) along each axis (m2).

        Args:
            positions: (n, 2) by the physical model, on the sheet (m).
            changes: (n, n_meas) in units of their error; None: not known.
        """
        if changes is None:
            offsets, variances = self.near(positions)
            return self.registration(positions) + offsets, self.trust[0] * variances
        at = np.hstack([positions, self.features(changes)])
        offsets, variances = self.full(at)
        if self.networks is not None:
            offsets = (offsets + self.networks(at)) / 2
        noise = self.registration.scale**2 * self.moved_by_noise(changes)
        return self.registration(positions) + offsets, self.trust[1] * variances + noise

    def __call__(self, positions: Floats, changes: Floats | None = None) -> tuple[Floats, Floats]:
        """The same, on the sheet."""
        places, variances = self.registered(positions, changes)
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
            "known": self.known.astype(np.float32),
            "novelty": np.array([self.limit, self.rate]),
            "noise": np.array([*self.usual, self.length]),
        }
        if self.networks is not None:
            told = self.networks
            arrays |= {"network_inputs": np.array([told.middle, told.spread]), "network_scale": np.array(told.scale)}
            for k, layer in enumerate(told.layers):
                arrays |= {f"network_{part}{k}": a.astype(np.float32) for part, a in zip("wb", layer, strict=True)}
        for name, one in (("near", self.near), ("full", self.full)):
            rows, columns = np.tril_indices(len(one.inducing))
            arrays |= {
                f"{name}_inducing": one.inducing.astype(np.float32),
                f"{name}_weights": one.weights,
                f"{name}_factor": one.factor[rows, columns].astype(np.float32),
                f"{name}_kernel": np.array([*one.amplitudes, *one.lengths, one.noise]),
            }
        return pack(arrays)

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
        given = unpack(text)
        features, n_meas = given["basis"].shape
        shapes = {"linear": (2, 2), "shift": (2,), "quadruples": (n_meas, 4), "trust": (2,), "own": ()}
        shapes |= {"known": (len(given["known"]), features), "novelty": (2,), "noise": (3,)}
        if wrong := [name for name, shape in shapes.items() if given[name].shape != shape]:
            raise ValueError(f"{wrong[0]} has shape {given[wrong[0]].shape}")
        near, full = (_regression(given, name, width) for name, width in (("near", 2), ("full", 2 + features)))
        if not ((given["trust"] > 0).all() and (given["quadruples"] >= 0).all()):
            raise ValueError("a variance or an electrode's number is negative")
        registration = Similarity(given["linear"], given["shift"])
        if not 1e-6 < registration.scale < 1e6:
            raise ValueError(f"its scale is {registration.scale:g}")
        limit, rate = given["novelty"].tolist()
        if not (len(given["known"]) and limit > 0 and 0 <= rate <= 1):
            raise ValueError(f"{len(given['known'])} presses and a limit of {limit:g} give no limit of novelty")
        if not (given["noise"] >= 0).all():
            raise ValueError(f"its noise is {given['noise']}")
        return PositionMap(
            registration,
            bool(given["own"]),
            given["basis"],
            given["quadruples"],
            near,
            full,
            given["trust"],
            given["known"],
            limit,
            rate,
            given["noise"][:2],
            float(given["noise"][2]),
            _networks(given, 3 + features),
        )
    except UNREADABLE as error:
        raise SkinError(f"calibration.position_map cannot be read: {error}; learn it again") from None


def _networks(given: dict[str, Floats], width: int) -> Networks | None:
    if "network_inputs" not in given:
        return None
    (middle, spread), scale = given["network_inputs"], float(given["network_scale"])
    count = sum(name.startswith("network_w") for name in given)
    layers = tuple((given[f"network_w{k}"], given[f"network_b{k}"]) for k in range(count))
    if middle.shape != (width,) or not ((spread > 0).all() and scale > 0 and layers):
        raise ValueError(f"networks are given {middle.shape[0]} values")
    for weights, offsets in layers:
        wanted = len(layers[0][0]), width
        if weights.ndim != 3 or weights.shape[:2] != wanted or offsets.shape != (wanted[0], 1, weights.shape[2]):
            raise ValueError(f"a layer of networks has shapes {weights.shape} and {offsets.shape}")
        width = weights.shape[2]
    if width != 2:
        raise ValueError(f"networks give {width} values")
    return Networks(layers, middle, spread, scale)


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
