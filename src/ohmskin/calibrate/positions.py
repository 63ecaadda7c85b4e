"""A map of positions from presses of known places: a similarity, and on what it leaves a Gaussian process and networks.

Its accuracy is estimated by cross-validation of all of it: presses are never judged by what was learned from them, nor
from others at the same place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import log, sqrt

import numpy as np
from scipy.optimize import nnls
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.special import stdtr, stdtrit

from ohmskin.arrays import Bools, Floats, Ints
from ohmskin.calibrate.networks import can_train, trained
from ohmskin.calibrate.processes import regress
from ohmskin.errors import DataError
from ohmskin.scan import DrivePattern, Frame
from ohmskin.sensing import SkinModel
from ohmskin.sensing.learned import one_contact
from ohmskin.skin.positions import PositionMap, Similarity

_LEAST = 8  # places
_SAME = 2e-3  # share of the span of all places within which presses are at the same
_FEATURES = 24
_FOLDS = 5
_MANY = 80  # places from which networks are trained, too
_KNOWN, _RATE = 500, 0.01  # presses kept to tell what is unlike them, and the share of false alarms
_TELLING = 5  # false alarms from which on their rate is counted
_LIMITS = 1e-3, 0.9  # of distances; changes that have nothing to do with presses are some 1.3 away
_COUNTS = (20, 50, 100, 200, 500, 1000)  # presses of a learning curve
_LIKE = 0.7  # share of the places' own scatter that a map of them must come below
_AWAY, _LEAST_AWAY = 6.0, 0.05  # over the median, and of the sheet's size: misses beyond both contradict other presses
_ROUNDS = 4  # in which such presses are told from the rest
_NAMED = 5  # of them at most
_WORSE = 1.1  # times the error without a map, from which on it does not help
_UNITS = (1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3)  # scales of places that were given in another unit
_OWN_SCALE, _OWN_TURN, _OWN_SHIFT = 1.25, np.deg2rad(20), 0.2  # within which another frame is the sheet's own
_NINETY = 4.605  # squared Mahalanobis distance within which are 90 % of a plane's normal distribution


@dataclass(frozen=True, eq=False)
class PositionReport:
    """A map of positions, and its errors at presses that it was not learned from, by cross-validation.

    Args:
        map: The map, learned from all presses.
        physics, similarity, mapped: (n,) distances of estimated places from the true ones (m): by the physical model,
            after the similarity, after the map. NaN: not detected.
        held: Share of the presses within their 90 % ellipses.
        places: Number of places pressed, at which presses are judged by what was learned from other places.
        contradicting: (n,) whether a press is far from where all others say that it is; nothing was learned from it.
        curve: The learning curve: from how many presses a map was learned, and its mean error (m) at others.
    """

    map: PositionMap
    physics: Floats
    similarity: Floats
    mapped: Floats
    held: float
    places: int
    contradicting: Bools
    curve: tuple[tuple[int, float], ...] = ()

    def report(self) -> list[str]:
        """The findings as sentences, one a line."""
        known = np.isfinite(self.physics)
        judged = known & ~self.contradicting
        rows = [("physics", self.physics), ("similarity", self.similarity), ("map", self.mapped)]
        first = rows[0 if self.map.own else 1 :]
        errors = {name: float(np.mean(one[judged])) for name, one in first}
        told = ", ".join(f"{name} {1e3 * error:.2f} mm" for name, error in errors.items())
        at = "presses" if self.places == known.sum() else f"places ({self.places} are known)"
        lines = [
            f"{known.sum()} of {len(known)} presses detected; mean error at {at} not learned from: {told}",
            f"{100 * self.held:.0f} % of them within their 90 % ellipses",
        ]
        if errors.pop("map") > _WORSE * min(errors.values()):
            lines.append("the map makes places no better; learn from more places, or leave it out with --no-positions")
        if len(which := np.flatnonzero(self.contradicting)):
            named = ", ".join(str(k + 1) for k in which[:_NAMED]) + (", ..." if len(which) > _NAMED else "")
            lines.append(
                f"{len(which)} presses are far from where all others say that they are (number {named}): are their "
                "places wrong? They are left out, of these errors, too; with them "
                f"map {1e3 * float(np.mean(self.mapped[known])):.2f} mm"
            )
        if self.curve:
            fewer = ", ".join(f"{count} {1e3 * error:.2f} mm" for count, error in self.curve)
            lines.append(f"learned from fewer presses: {fewer}")
        networks = "a Gaussian process and networks" if self.map.networks is not None else "a Gaussian process alone"
        missing = "" if can_train() else "; networks need scikit-learn: pip install 'ohmskin[learn]'"
        lines.append(f"the map is {networks}{missing}")
        lines.append(f"of presses like these {100 * self.map.rate:.2g} % are outliers, located by the physical model")
        if not self.map.own:
            linear = self.map.registration.linear
            turn = np.rad2deg(np.arctan2(linear[1, 0], linear[0, 0]))
            mirrored = ", mirrored" if np.linalg.det(linear) < 0 else ""
            scale = self.map.registration.scale
            lines.append(
                f"the presses' frame is not the sheet's: turned by {turn:.1f} degrees{mirrored}, scale {scale:.3f}"
            )
            if any(one / _OWN_SCALE < scale < one * _OWN_SCALE for one in _UNITS):
                lines.append(
                    "places seem to have another unit, and so have these errors: name the columns x_mm or x_cm"
                )
        return lines


def read_places(
    known: SkinModel, frames: Sequence[Frame], progress: Callable[[float], None] = lambda _: None
) -> tuple[Floats, Floats]:
    """Place of the contact in each frame by the physical model, one in each, and the other input of `learn_positions`.

    Args:
        known: The model of the quiet skin.
        frames: Of one press each, all of one pattern.
        progress: Called with the share done, 0 to 1.

    Returns:
        Places (n, 2) (m), NaN where nothing was detected; changes (n, n_meas) of the voltages, in units of their error.
    """
    fitter = known.fitter
    found, changes = np.full((len(frames), 2), np.nan), np.zeros((len(frames), frames[0].pattern.n_meas))
    for k, frame in enumerate(frames):
        scan = known.difference(frame)
        changes[k] = scan.volts / known.noise
        if np.isfinite(scan.volts * scan.currents).any():
            told, _, one = one_contact(fitter, [scan])
            if fitter.heights(*fitter.scores(told)).max() >= fitter.bar:
                found[k] = one.params[0, :2]
        progress((k + 1) / len(frames))
    return found, changes


def learn_positions(
    pattern: DrivePattern,
    found: Floats,
    changes: Floats,
    places: Floats,
    size: float,
    progress: Callable[[float], None] = lambda _: None,
) -> PositionReport:
    """Learn a correction of positions from presses at known places.

    Args:
        pattern: That was driven.
        found: (n, 2) places by the physical model (m); NaN where a press was not detected.
        changes: (n, n_meas) of the voltages, in units of their error.
        places: (n, 2) where it was pressed (m), in any frame.
        size: Of the sheet (m).
        progress: Called with the share done, 0 to 1.

    Raises:
        DataError: If presses at fewer than eight places were detected, or the places have nothing to do with them.
    """
    known: Bools = np.asarray(np.isfinite(found).all(axis=1) & np.isfinite(places).all(axis=1))
    alike = same_places(places[known])
    count = int(alike.max(initial=-1)) + 1
    if count < _LEAST or min(np.ptp(places[known], axis=0)) == 0:
        told = f"{known.sum()} of {len(found)} presses were detected whose places are known, at {count} places"
        raise DataError(f"{told}; to learn positions press {_LEAST} places or more, spread over the sheet")
    found, changes, places = found[known], np.nan_to_num(changes[known]), places[known]
    after, whole, near_only = np.empty_like(places), np.empty_like(places), np.empty_like(places)
    variances, away, left = np.empty((len(places), 2)), np.empty(len(places)), np.empty((2, len(places)))
    folds = min(_FOLDS, count)
    fold = np.argsort(np.random.default_rng(0).permutation(count))[alike] % folds
    learn = partial(_learn, pattern, size=size)
    wrong = _contradicting(learn, found, changes, places, fold, size)
    learn = partial(learn, own=_is_own(similarity(found[~wrong], places[~wrong]), found.mean(axis=0), size))
    for number in range(folds):
        test, train = np.flatnonzero(fold == number), np.flatnonzero((fold != number) & ~wrong)
        one = learn(found[train], changes[train], places[train])
        after[test] = one.registration(found[test])
        near_only[test], variances[test, 0] = one.registered(found[test])
        whole[test], variances[test, 1] = one.registered(found[test], changes[test])
        away[test], left[:, test] = one.distances(changes[test]), one.left(changes[test])
        progress((number + 1) / (folds + 2))
    scatter, missed = (
        float(np.sqrt((one**2).sum(axis=1).mean())) for one in (places - places.mean(axis=0), whole - places)
    )
    if missed > _LIKE * scatter:
        told = f"places scatter by {1e3 * scatter:.3g} mm, a map from others misses them by {1e3 * missed:.3g} mm"
        advice = "check that each row has the place of its own press, and the skin; or leave places out: --no-positions"
        raise DataError(f"the places have nothing to do with the presses: {told}; {advice}")
    final, (limit, rate) = learn(found[~wrong], changes[~wrong], places[~wrong]), novelty(away)
    misses = [((one - places) ** 2).sum(axis=1) / variances[:, k] for k, one in enumerate((near_only, whole))]
    trust = np.maximum([_ninety(one) / _NINETY for one in misses], 0.1)
    usual, length = _usual(*left), _length(found, changes)
    final = replace(final, trust=trust, limit=limit, rate=rate, usual=usual, length=length)
    progress((folds + 1) / (folds + 2))
    # each fold by the trust that the others give, so that the share held is not of what it was set by
    held = np.empty(len(places), bool)
    for number in range(folds):
        held[fold == number] = misses[1][fold == number] < _ninety(misses[1][fold != number])
    physics, registered, mapped = (_scattered(np.hypot(*(one - places).T), known) for one in (found, after, whole))
    test, rest = np.flatnonzero((fold == 0) & ~wrong), np.flatnonzero((fold > 0) & ~wrong)
    curve = list[tuple[int, float]]()
    for fewer in (fewer for fewer in _COUNTS if fewer < 0.7 * len(rest)):
        train = np.random.default_rng(1).permutation(rest)[:fewer]
        reached, _ = learn(found[train], changes[train], places[train]).registered(found[test], changes[test])
        curve.append((fewer, float(np.linalg.norm(reached - places[test], axis=1).mean())))
    progress(1.0)
    contradicting = np.zeros(len(known), bool)
    contradicting[known] = wrong
    return PositionReport(final, physics, registered, mapped, float(held.mean()), count, contradicting, tuple(curve))


def _contradicting(
    learn: Callable[..., PositionMap], found: Floats, changes: Floats, places: Floats, fold: Ints, size: float
) -> Bools:
    """Which presses (n,) are far from where a map of those of other folds that are not says that they are."""
    wrong, reached = np.zeros(len(found), bool), np.empty_like(places)
    least = _LEAST_AWAY * size * similarity(found, places).scale
    for _ in range(_ROUNDS):
        for number in range(fold.max() + 1):
            test, train = fold == number, (fold != number) & ~wrong
            one = learn(found[train], changes[train], places[train], own=True, networks=False)
            reached[test], _ = one.registered(found[test], changes[test])
        missed, before = np.linalg.norm(reached - places, axis=1), wrong
        wrong = missed > max(_AWAY * float(np.median(missed)), least)
        if (wrong == before).all():
            break
    return np.asarray(wrong)


def same_places(places: Floats) -> Ints:
    """The number of the place (n,) of each press at `places` (n, 2), in the order in which they are first pressed.

    Those as close as a robot repeats are the same.
    """
    if not len(places):
        return np.empty(0, int)
    apart = max(_SAME * float(np.ptp(places, axis=0).max()), 1e-12)
    some, number = np.unique(np.round(places / (apart / 4)), axis=0, return_inverse=True)
    one, other = KDTree(some).query_pairs(4.0, output_type="ndarray").T
    linked = coo_array((np.ones(len(one)), (one, other)), (len(some), len(some)))
    _, first, number = np.unique(
        connected_components(linked, directed=False)[1][number.ravel()], return_index=True, return_inverse=True
    )
    return np.asarray(np.argsort(np.argsort(first))[number], int)


def similarity(these: Floats, those: Floats) -> Similarity:
    """The similarity, perhaps mirrored, that brings places (n, 2) closest to others (Umeyama, PAMI 13, 1991)."""
    a, b = these - these.mean(axis=0), those - those.mean(axis=0)
    u, singular, vt = np.linalg.svd(b.T @ a)
    linear = (u @ vt) * singular.sum() / (a**2).sum()
    return Similarity(linear, those.mean(axis=0) - linear @ these.mean(axis=0))


def _is_own(one: Similarity, middle: Floats, size: float) -> bool:
    """Whether a frame is the sheet's own but for errors of the physics; `middle` (2,) is that of the presses (m)."""
    turned = abs(np.arctan2(one.linear[1, 0], one.linear[0, 0])) > _OWN_TURN or np.linalg.det(one.linear) < 0
    alike = 1 / _OWN_SCALE < one.scale < _OWN_SCALE
    return bool(alike and not turned and np.linalg.norm(one(middle) - middle) < _OWN_SHIFT * size)


def _ninety(values: Floats) -> float:
    """What one value more is below with a probability of 0.9, however few (n,) there are (split conformal)."""
    return float(np.quantile(values, 0.9, method="weibull"))


def novelty(away: Floats) -> tuple[float, float]:
    """The limit of distances beyond which changes are unlike presses of these distances (n,), and the share of presses
    like these that are beyond it: of few presses as if distances were log-normal."""
    count = len(away)
    if count * _RATE >= _TELLING:
        limit = float(np.clip(np.quantile(away, 1 - _RATE), *_LIMITS))
        return limit, max(float(np.mean(away > limit)), _RATE)
    logs = np.log(np.maximum(away, _LIMITS[0]))
    middle, spread = float(logs.mean()), float(logs.std(ddof=1)) * sqrt(1 + 1 / count) + 1e-9
    limit = float(np.clip(np.exp(middle + stdtrit(count - 1, 1 - _RATE) * spread), *_LIMITS))
    return limit, max(float(stdtr(count - 1, (middle - log(limit)) / spread)), _RATE)


def _usual(left: Floats, squares: Floats) -> Floats:
    """`PositionMap.usual`, from what features leave (n,) of changes of squared sizes (n,)."""
    rows = np.stack([1 / squares, np.ones(len(left))], axis=1)
    scale = rows.max(axis=0)
    return np.asarray(nnls(rows / scale, left / squares)[0] / scale)


def _length(found: Floats, changes: Floats) -> float:
    """`PositionMap.length`, from the places (n, 2) (m) of presses and of those whose changes are most alike."""
    some = slice(None, None, -(-len(found) // 1000))
    found, shares = (
        found[some],
        changes[some] / np.maximum(np.linalg.norm(changes[some], axis=1, keepdims=True), 1e-300),
    )
    squares = np.maximum(2 - 2 * shares @ shares.T, 1e-12)
    np.fill_diagonal(squares, np.inf)
    alike = squares.argmin(axis=1)
    apart = ((found - found[alike]) ** 2).sum(axis=1)
    return float(np.sqrt(np.median(apart / squares.min(axis=1))))


def _learn(
    pattern: DrivePattern, found: Floats, changes: Floats, places: Floats, size: float, own: bool, networks: bool = True
) -> PositionMap:
    registration = similarity(found, places)
    left = places - registration(found)
    _, _, directions = np.linalg.svd(changes[:: -(-len(changes) // 1000)], full_matrices=False)
    basis = directions[:_FEATURES]
    features = changes @ basis.T
    at = np.hstack([found, features])
    near, full = regress(found, left, size), regress(at, left, size)
    sizes = np.maximum(np.linalg.norm(changes, axis=1, keepdims=True), 1e-300)
    known = (features / sizes)[np.random.default_rng(2).permutation(len(features))[:_KNOWN]]
    many = networks and same_places(places).max() + 1 >= _MANY
    quadruples, beside = pattern.quadruples.astype(float), trained(at, left) if many else None
    return PositionMap(
        registration, own, basis, quadruples, near, full, np.ones(2), known, 1.0, _RATE, np.zeros(2), 0.0, beside
    )


def _scattered(values: Floats, known: Bools) -> Floats:
    found = np.full(len(known), np.nan)
    found[known] = values
    return found
