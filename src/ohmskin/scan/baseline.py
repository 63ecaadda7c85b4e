"""The untouched skin: reference data and noise, learned from quiet frames."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from math import sqrt

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints, WeakCache, changed, real
from ohmskin.errors import DataError, PatternError
from ohmskin.scan.frame import Frame
from ohmskin.scan.pairs import Pairs
from ohmskin.scan.pattern import DrivePattern

_SHIFT = np.int64(1) << np.arange(45, -1, -15, dtype=np.int64)  # electrode numbers fit 15 bits


@dataclass(frozen=True, eq=False)
class Difference:
    """Voltage changes of one frame against the untouched skin (paper, eq. 4).

    Args:
        pattern: The pattern driven.
        currents: (n_meas,) current behind each measurement (A).
        volts: (n_meas,) change of voltage at that current (V); NaN where it is not known.
        source_loading: (n_meas,) by how much more a voltage would rise with the two-terminal resistance of its
            injection if the current stayed the same (ohm per ohm): for a voltage source whose current is not measured,
            see `VoltageSource.unmeasured`. None where the currents are measured or given.
        reference: (n_meas,) voltage of the untouched skin at that current (V), if it is known.

    Raises:
        DataError: If shapes do not fit the pattern, or an array is complex.
    """

    pattern: DrivePattern
    currents: Floats
    volts: Floats
    source_loading: Floats | None = None
    reference: Floats | None = None

    def __post_init__(self) -> None:
        for name in ("currents", "volts", "source_loading", "reference"):
            if (given := getattr(self, name)) is None:
                continue
            array = real(given, f"the {name} of a difference are", DataError)
            if array.shape != (self.pattern.n_meas,):
                needs = f"the pattern driven needs ({self.pattern.n_meas},), one for each measurement"
                raise DataError(f"the {name} of a difference have shape {array.shape}; {needs}")
            object.__setattr__(self, name, array)

    @classmethod
    def valid(
        cls,
        pattern: DrivePattern,
        currents: Floats,
        volts: Floats,
        source_loading: Floats | None = None,
        reference: Floats | None = None,
    ) -> "Difference":
        """A difference made without checks.

        Args:
            pattern, currents, volts, source_loading, reference: As for `Difference`, float arrays of these shapes.
        """
        one = object.__new__(cls)
        vars(one).update(
            pattern=pattern, currents=currents, volts=volts, source_loading=source_loading, reference=reference
        )
        return one

    @cached_property
    def undriven(self) -> "Difference":
        """The data of electrodes that carry no current, which do not depend on contact impedances.

        Itself if all or
        none are such.
        """
        kept = self.pattern.idle
        if len(kept) in (0, self.pattern.n_meas):
            return self
        loading, reference = (None if a is None else a[kept] for a in (self.source_loading, self.reference))
        return self.valid(self.pattern.undriven, self.currents[kept], self.volts[kept], loading, reference)

    @property
    def known(self) -> bool:
        """Whether any of it is known."""
        return bool(np.isfinite(self.volts + self.currents).any())

    @property
    def negated(self) -> "Difference":
        """The change from there to here."""
        return changed(self, volts=-self.volts)

    def caused_by(self, changes: Floats, pairs: Pairs | None = None) -> Floats:
        """The part of this difference (n_meas,) (V) that changes of two-terminal resistances cause.

        Args:
            changes: (n_pairs,) in ohms.
            pairs: Of which pairs of electrodes they are; of all unless given.
        """
        pairs = Pairs.all(round((1 + sqrt(1 + 8 * len(changes))) / 2)) if pairs is None else pairs
        known = np.zeros(len(changes) + 1)  # the last of no pair
        known[:-1] = changes
        ad, bc, ac, bd, ab = known[terms_of(self.pattern, pairs)]
        own = 0.0 if self.source_loading is None else self.source_loading * ab
        return np.asarray(self.currents * (0.5 * (ad + bc - ac - bd) - own))

    def minus(self, changes: Floats, pairs: Pairs | None = None) -> "Difference":
        """The difference without what changes of two-terminal resistances cause; arguments as for `caused_by`."""
        return changed(self, volts=self.volts - self.caused_by(changes, pairs))

    def times(self, shares: Floats | float) -> "Difference":
        """The same data with voltage and current of each measurement multiplied by a share.

        An estimator's noise then
        applies to these: a measurement with a smaller share has a lower weight.

        Args:
            shares: One value or (n_meas,) (1).
        """
        reference = None if self.reference is None else self.reference * shares
        return changed(self, currents=self.currents * shares, volts=self.volts * shares, reference=reference)

    def weighted(self, noise: ArrayLike) -> "Difference":
        """In units of the noise of each measurement, one value or (n_meas,) (V): give estimators a noise of 1.

        Raises:
            DataError: If a noise is not positive.
        """
        std = real(noise, "noises are", DataError)
        if not ((std > 0) & (std < np.inf)).all():
            raise DataError("a noise is not positive and finite; give the standard deviation of each voltage (V)")
        return self.times(1 / std)

    @property
    def normalised(self) -> "Difference":
        """Relative change of each voltage, v / v0 - 1: give estimators a relative noise, too (1).

        Raises:
            DataError: If the untouched skin's are not known, or one of them is zero.
        """
        if self.reference is None or not np.all(self.reference):
            what = "is not known" if self.reference is None else "is zero at one measurement"
            raise DataError(f"the voltage of the untouched skin {what}; normalised data are shares of it")
        return self.times(1 / self.reference)

    def combination(self, pairs: Pairs | int) -> sp.csr_array:
        """The sparse matrix (n_meas, n_pairs) from changes of two-terminal resistances to these volts, per ampere.

        Arguments and errors as of `DrivePattern.combination`.
        """
        rows = self.pattern.combination(pairs)
        if self.source_loading is None:
            return rows
        source, sink = self.pattern.injections[self.pattern.measurements[:, 0]].T
        at = (np.arange(self.pattern.n_meas), Pairs.all(pairs).index(source, sink))
        return sp.csr_array(rows - sp.csr_array((self.source_loading, at), shape=rows.shape))


@dataclass(frozen=True, eq=False)
class Baseline:
    """Reference transfer resistances of every measurement seen while nothing touched the skin.

    Dividing by the measured current makes data of a voltage source comparable between the touched and the untouched
    skin.

    Args:
        keys: (n,) sorted codes of the (source, sink, plus, minus) quadruples; those of either polarity of the current
            are apart, as a device may measure it with another gain.
        resistances: (n,) mean transfer resistances (ohm).
        noise: Standard deviation of a single voltage (V).
        repeats: Smallest number of times that any of them was measured.
    """

    keys: Ints
    resistances: Floats
    noise: float
    repeats: int
    _known: WeakCache[DrivePattern, Floats] = field(default_factory=WeakCache, init=False, repr=False)

    @classmethod
    def learn(cls, frames: Iterable[Frame]) -> "Baseline":
        """Learn from quiet frames, of one or several patterns.

        The noise is the scatter of repeated frames about their mean, at electrodes that carry no current: at the
        others, errors of the current are as large. A pattern seen once has no scatter; if no pattern
        is repeated, the noise is taken from the disagreement of reciprocal measurements, which must be equal.

        Raises:
            DataError: If there is no frame, or too few finite values to estimate the noise.
        """
        frames = list(frames)
        if not frames:
            raise DataError("no quiet frames to learn the baseline from; scan the untouched skin first")
        signed = [(frame, *_polar_codes(frame.pattern)) for frame in frames]
        keys, which = np.unique(np.concatenate([codes for _, codes, _ in signed]), return_inverse=True)
        volts = np.concatenate([signs * frame.voltages for frame, _, signs in signed])
        currents = np.concatenate([frame.measurement_currents for frame in frames])
        known = np.isfinite(volts) & np.isfinite(currents)
        which, volts, currents = which[known], volts[known], currents[known]
        repeats = np.bincount(which, minlength=len(keys))
        squares = np.bincount(which, currents**2, minlength=len(keys))
        products = np.bincount(which, volts * currents, minlength=len(keys))
        resistances = np.divide(products, squares, out=np.full(len(keys), np.nan), where=squares > 0)
        errors = (volts - resistances[which] * currents) ** 2
        counted = ~np.concatenate([frame.pattern.driven for frame in frames])[known]
        if not counted.any():
            counted[:] = True
        scatter = float(np.nansum(errors[counted]))
        freedom = int(np.maximum(np.bincount(which[counted], minlength=len(keys)) - 1, 0).sum())
        if freedom > 0 and scatter > 0:
            noise = float(np.sqrt(scatter / freedom))
        else:
            one_each = {frame.pattern: frame for frame in frames}.values()
            noise = float(np.mean([_reciprocity_error(frame) for frame in one_each]))
        return cls(keys, resistances, noise, int(max(1, repeats.min())))

    @property
    def difference_noise(self) -> float:
        """Standard deviation of a difference (V): of the voltage and of its reference together.

        With a single quiet frame the noise comes from reciprocity; most of that error is the same in both frames of a
        difference and cancels, so that it is used unchanged.
        """
        return self.noise * float(np.sqrt(1 + 1 / self.repeats)) if self.repeats > 1 else self.noise

    def reference(self, pattern: DrivePattern) -> Floats:
        """Untouched transfer resistances (n_meas,) of a pattern (ohm).

        Raises:
            PatternError: If one of its measurements was never seen while the skin was quiet.
        """
        if (known := self._known.get(pattern)) is not None:
            return known
        codes, signs = _polar_codes(pattern)
        same, reversed_ = (
            np.minimum(np.searchsorted(self.keys, key), len(self.keys) - 1) for key in (codes, codes ^ 1)
        )
        at = np.where(self.keys[same] == codes, same, reversed_)
        if len(missing := np.flatnonzero(self.keys[at] >> 1 != codes >> 1)):
            raise PatternError(
                f"no quiet reference for source, sink, plus, minus = {pattern.quadruples[missing[0]].tolist()}; "
                "calibrate with this pattern included"
            )
        known = self._known[pattern] = signs * self.resistances[at]
        return known

    def difference(self, frame: Frame) -> Difference:
        """The change of a frame's voltages against the untouched skin at the same currents.

        Args:
            frame: Of any pattern whose measurements were seen while the skin was quiet.

        Raises:
            PatternError: If one was not.
        """
        currents = frame.measurement_currents
        reference = currents * self.reference(frame.pattern)
        volts = frame.voltages - reference
        if np.count_nonzero(finite := np.isfinite(volts)) < len(volts):
            volts[~finite] = np.nan
        return Difference.valid(frame.pattern, currents, volts, reference=reference)


def newest(new: Sequence[Difference], older: Iterable[Difference], injections: int) -> tuple[Difference, ...]:
    """The `new` scans, and as many older ones, newest first, as are needed for this number of injections."""
    taken, count = [*new], sum(scan.pattern.n_inj for scan in new)
    for scan in older:
        if count >= injections:
            break
        taken.append(scan)
        count += scan.pattern.n_inj
    return tuple(taken)


@lru_cache(maxsize=1024)
def terms_of(pattern: DrivePattern, pairs: Pairs) -> Ints:
    """The numbers (5, n_meas) of the two-terminal resistances F_ad, F_bc, F_ac, F_bd and F_ab of each measurement; of
    no pair n_pairs."""
    a, b, c, d = pattern.quadruples.T
    return pairs.index(np.array([a, b, a, b, a]), np.array([d, c, c, d, b]))


def _reciprocity_error(frame: Frame) -> float:
    """Noise (V) estimated from one frame: R(ab, cd) and R(cd, ab) must be equal, their difference is noise.

    Raises:
        DataError: If no measurement of the frame has its reciprocal in it.
    """
    quadruples, current = frame.pattern.quadruples, frame.measurement_currents
    codes, signs = codes_of(quadruples)
    mirrored, mirrored_signs = codes_of(quadruples[:, [2, 3, 0, 1]])
    order = np.argsort(codes)
    partner = order[np.minimum(np.searchsorted(codes, mirrored, sorter=order), len(codes) - 1)]
    paired = (codes[partner] == mirrored) & (codes != mirrored)  # a two-terminal measurement is its own mirror
    known = np.isfinite(frame.voltages) & np.isfinite(current) & (current != 0)
    ohms = np.divide(frame.voltages, current, out=np.full(len(current), np.nan), where=known)
    errors = ((signs * ohms)[partner] - mirrored_signs * ohms)[paired] * current[paired]
    finite = errors[np.isfinite(errors)]
    if len(finite) < 4:
        why = "the noise cannot be estimated from one quiet frame without reciprocal measurements"
        raise DataError(f"{why}; record at least two")
    return float(np.sqrt(np.mean(finite**2) / 2))


def _polar_codes(pattern: DrivePattern) -> tuple[Ints, Ints]:
    """The codes of its measurements, doubled, odd where the current flows from the higher number; their signs."""
    codes, signs = codes_of(pattern.quadruples)
    source, sink = pattern.quadruples.T[:2]
    return 2 * codes + (source > sink), signs


def codes_of(quadruples: Ints) -> tuple[Ints, Ints]:
    """One number for each measurement whatever the direction of its two pairs, and the sign of the direction."""
    a, b, c, d = quadruples.T
    forward = np.column_stack([np.minimum(a, b), np.maximum(a, b), np.minimum(c, d), np.maximum(c, d)])
    return forward @ _SHIFT, np.where((a < b) == (c < d), 1, -1)
