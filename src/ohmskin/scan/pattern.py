"""Drive patterns: which electrodes inject current and between which ones the voltage is measured."""

import operator
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import accumulate

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ohmskin.arrays import Ints, ReadOnly
from ohmskin.errors import PatternError
from ohmskin.scan.pairs import SIGNS, Pairs, terms


@dataclass(frozen=True)
class DrivePattern(ReadOnly):
    """A sequence of two-electrode injections, each with its measured voltages. Zero-sum by construction.

    Args:
        injections: (n_inj, 2) source and sink electrode; current enters the sheet at the source.
        measurements: (n_meas, 3) injection number, plus and minus electrode of V(plus) - V(minus); sorted by injection.

    Raises:
        PatternError: If shapes or numbers are invalid, an injection has the same source and sink, a measurement has the
            same two electrodes, or injection numbers are out of order.
    """

    injections: Ints
    measurements: Ints

    def __post_init__(self) -> None:
        for name, width in (("injections", 2), ("measurements", 3)):
            given = np.asarray(getattr(self, name))
            if given.ndim != 2 or given.shape[1] != width or len(given) == 0 or given.dtype.kind not in "iu":
                told = f"{name} have shape {given.shape} and type {given.dtype}"
                raise PatternError(f"{told}; need integers (n, {width}), n >= 1")
            array = given.astype(np.int64)
            if array.min() < 0:
                raise PatternError(f"{name} name electrode or injection {array.min()}; numbers start at 0")
            if len(same := np.flatnonzero(array[:, -2] == array[:, -1])):
                raise PatternError(f"{name}[{same[0]}] uses electrode {array[same[0], -1]} twice; it needs two")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        which = self.measurements[:, 0]
        if which.max() >= len(self.injections) or (np.diff(which) < 0).any():
            last = len(self.injections) - 1
            raise PatternError(f"measurements must be sorted by injection number and name injections 0..{last}")

    @classmethod
    def valid(cls, injections: Ints, measurements: Ints) -> "DrivePattern":
        """A pattern made without checks.

        Args:
            injections, measurements: As for `DrivePattern`, int64; made read-only.
        """
        pattern = object.__new__(cls)
        for name, array in (("injections", injections), ("measurements", measurements)):
            array.setflags(write=False)
            object.__setattr__(pattern, name, array)
        return pattern

    @cached_property
    def n_inj(self) -> int:
        """Number of injections."""
        return len(self.injections)

    @cached_property
    def n_meas(self) -> int:
        """Number of measurements."""
        return len(self.measurements)

    @cached_property
    def measured(self) -> Ints:
        """How many voltages (n_inj,) are measured of each injection."""
        return np.bincount(self.measurements[:, 0], minlength=self.n_inj)

    @cached_property
    def quadruples(self) -> Ints:
        """Source, sink, plus, minus (n_meas, 4) of each measurement."""
        return np.hstack([self.injections[self.measurements[:, 0]], self.measurements[:, 1:]])

    @cached_property
    def injection_numbers(self) -> Ints:
        """The number of the injection behind each measurement (n_meas,)."""
        return self.measurements[:, 0].copy()

    @cached_property
    def last(self) -> int:
        """The largest number of an electrode that it names."""
        return int(max(self.injections.max(), self.measurements[:, 1:].max()))

    @cached_property
    def driven(self) -> NDArray[np.bool_]:
        """Which measurements (n_meas,) involve an electrode that carries the current: its contact impedance counts."""
        source, sink, plus, minus = self.quadruples.T
        return np.asarray((source == plus) | (source == minus) | (sink == plus) | (sink == minus))

    @cached_property
    def idle(self) -> Ints:
        """The numbers (n,) of the measurements that involve no electrode that carries the current."""
        return np.flatnonzero(~self.driven)

    @cached_property
    def undriven(self) -> "DrivePattern":
        """The pattern without the measurements of electrodes that carry the current.

        Raises:
            PatternError: If it has no others.
        """
        if not len(self.idle):
            raise PatternError("all measurements of the pattern involve an electrode that carries the current")
        return DrivePattern.valid(self.injections, self.measurements[self.idle])

    @cached_property
    def with_driven(self) -> "DrivePattern":
        """The pattern with two more voltages for each injection: source and sink against its first and last electrode.

        An injection that already measures one of them stays unchanged.
        """
        which, plus, minus = self.measurements.T
        count = self.measured
        last = np.cumsum(count) - 1
        numbers = np.flatnonzero((count > 0) & (np.bincount(which[self.driven], minlength=self.n_inj) == 0))
        first, last = (last - count + 1)[numbers], last[numbers]
        source, sink = self.injections[numbers].T
        more = [np.stack([numbers, *ends], axis=1) for ends in ((source, plus[first]), (minus[last], sink))]
        rows = np.concatenate([self.measurements, *more])
        return DrivePattern.valid(self.injections, rows[np.argsort(rows[:, 0], kind="stable")])

    def uses(self, electrodes: ArrayLike) -> NDArray[np.bool_]:
        """Whether each measurement (n_meas,) involves any of `electrodes`, one or several, driven or measured."""
        return np.asarray((self.quadruples[..., None] == np.atleast_1d(electrodes)).any(axis=(1, 2)))

    @cached_property
    def digest(self) -> int:
        """A 32-bit checksum that names this pattern on the wire: CRC-32 of both counts, injections and measurements."""
        parts = (np.array([self.n_inj, self.n_meas]), self.injections, self.measurements)
        return zlib.crc32(b"".join(part.astype("<u2").tobytes() for part in parts))

    def combination(self, pairs: Pairs | int) -> sp.csr_array:
        """The sparse matrix (n_meas, n_pairs) that makes this pattern's rows from two-terminal quantities.

        Args:
            pairs: Theirs, or the number of electrodes, of all pairs.

        Raises:
            PatternError: If the pattern names an electrode that is not there, or needs a pair that is not among them.
        """
        pairs = Pairs.all(pairs)
        self.check(pairs.n_elec)
        i, j = terms(self.quadruples)
        distinct = i != j  # of a driven electrode that is also measured, F_ii = 0
        signs, columns = np.broadcast_to(SIGNS, i.shape)[distinct], pairs.index(i, j)[distinct]
        ends = np.append(0, distinct.sum(axis=1).cumsum())
        rows = sp.csr_array((signs, columns, ends), shape=(self.n_meas, len(pairs)))
        rows.sum_duplicates()
        return rows

    def check(self, n_elec: int) -> None:
        """Raise PatternError unless every electrode named is one of `n_elec`."""
        if self.last >= n_elec:
            raise PatternError(f"the pattern names electrode {self.last}; there are {n_elec} (0..{n_elec - 1})")

    def split(self, max_injections: int, max_measurements: int = 2**31) -> Iterator["DrivePattern"]:
        """This pattern in pieces, in order.

        Args:
            max_injections: Most injections of a piece, at least 1.
            max_measurements: Most measurements of a piece.

        Raises:
            PatternError: If one injection alone has more measurements than that.
        """
        most = int(self.measured.max())
        if most > max_measurements or max_injections < 1:
            raise PatternError(f"an injection with {most} measurements does not fit into {max_measurements} a scan")
        max_injections = min(max_injections, max_measurements // most)
        for start in range(0, self.n_inj, max_injections):
            stop = min(start + max_injections, self.n_inj)
            low, high = np.searchsorted(self.measurements[:, 0], [start, stop])
            yield DrivePattern(self.injections[start:stop], self.measurements[low:high] - np.array([start, 0, 0]))

    def __eq__(self, other: object) -> bool:
        return self is other or (
            isinstance(other, DrivePattern)
            and np.array_equal(self.injections, other.injections)
            and np.array_equal(self.measurements, other.measurements)
        )

    def __hash__(self) -> int:
        return self.digest


@lru_cache(maxsize=1024)
def joined(patterns: tuple[DrivePattern, ...]) -> DrivePattern:
    """Patterns driven one after the other as one; the same ones give the same object again."""
    starts = accumulate((pattern.n_inj for pattern in patterns), initial=0)
    measurements = [p.measurements + np.array([start, 0, 0]) for p, start in zip(patterns, starts, strict=False)]
    return DrivePattern.valid(np.concatenate([p.injections for p in patterns]), np.concatenate(measurements))


def measure_others(injections: ArrayLike, electrodes: Sequence[int]) -> DrivePattern:
    """Drive `injections` (n_inj, 2) and measure between neighbours among all other `electrodes`, in their cyclic order.

    The order starts after the sink, so that adjacent drive gives the classical adjacent voltages. The n - 3 voltages of
    an injection span all that can be measured without a driven electrode, whose contact impedance would be included.

    Raises:
        PatternError: If there are fewer than four electrodes, or the pattern is invalid.
    """
    pairs = np.asarray(injections)
    order = np.asarray(_ring(electrodes, electrodes))
    if len(order) < 4:
        raise PatternError(f"{len(order)} electrodes; need at least 4 to drive two and measure between two others")
    measurements = []
    for k, (source, sink) in enumerate(pairs):
        start = np.flatnonzero(order == sink)
        walk = np.roll(order, -int(start[0]) - 1) if len(start) else order
        rest = walk[(walk != source) & (walk != sink)]
        measurements.append(np.column_stack([np.full(len(rest) - 1, k), rest[:-1], rest[1:]]))
    return DrivePattern(pairs, np.vstack(measurements))


def skip(rings: Sequence[Sequence[int]], step: int = 1) -> DrivePattern:
    """Drive each electrode of each ring against the one `step` places further on; measure at all other electrodes.

    A ring of one electrode, such as the middle of a 3 x 3 grid, is measured but not driven.

    Args:
        rings: Electrode numbers of each ring in their order round it, such as `Electrodes.rings`, or [range(16)].
        step: Places from source to sink, 1 for neighbours.

    Raises:
        PatternError: If `step` is not between 1 and the size of the smallest driven ring less one, or an electrode is
            named twice.
    """
    rings = [_ring(ring, rings) for ring in (rings if isinstance(rings, Iterable) else [rings])]
    electrodes = [electrode for ring in rings for electrode in ring]
    if len({*electrodes}) < len(electrodes):
        twice = next(electrode for electrode in electrodes if electrodes.count(electrode) > 1)
        raise PatternError(f"electrode {twice} is in the rings more than once; name each once")
    smallest = min((len(ring) for ring in rings if len(ring) > 1), default=1)
    if not 1 <= step < smallest:
        raise PatternError(f"step {step}; it must be 1..{smallest - 1} for rings of {smallest} electrodes or more")
    injections = [(ring[k], ring[(k + step) % len(ring)]) for ring in rings if len(ring) > 1 for k in range(len(ring))]
    return measure_others(np.array(injections), electrodes)


def adjacent(rings: Sequence[Sequence[int]]) -> DrivePattern:
    """Adjacent drive round each ring, voltages at all other electrodes (paper, section III-A).

    Args:
        rings: Electrode numbers of each ring in their order round it, such as `Electrodes.rings`, or [range(16)].

    Raises:
        PatternError: If there are fewer than four electrodes, or rings are not lists of numbers.
    """
    return skip(rings, 1)


def opposite(ring: Sequence[int]) -> DrivePattern:
    """Drive each electrode of one ring against the one half-way round, once; measure at all others of the ring.

    Args:
        ring: Electrode numbers in their order round it, such as range(16).

    Raises:
        PatternError: If there are fewer than four electrodes or an odd number, or the ring is no list of numbers.
    """
    ring = _ring(ring, ring)
    half = len(ring) // 2
    if len(ring) % 2:
        raise PatternError(f"a ring of {len(ring)} electrodes has none half-way round from another; use `skip`")
    return measure_others(np.array([(ring[k], ring[k + half]) for k in range(half)]), list(ring))


def _ring(ring: Sequence[int], given: object) -> Sequence[int]:
    try:
        return [operator.index(electrode) for electrode in ring]
    except TypeError:
        wanted = "lists of electrode numbers, such as Electrodes.rings or [range(16)]; for one ring range(16)"
        raise PatternError(f"a ring of electrodes is given as {str(given)[:40]}; give {wanted}") from None


def needed(patterns: Iterable[DrivePattern]) -> list[DrivePattern]:
    """The patterns except those contained in a longer one, longest first."""
    kept: list[tuple[DrivePattern, set[tuple[int, ...]]]] = []
    for pattern in sorted(patterns, key=lambda pattern: -pattern.n_meas):
        measured = set(map(tuple, pattern.quadruples.tolist()))
        if not any(measured <= theirs for _, theirs in kept):
            kept.append((pattern, measured))
    return [pattern for pattern, _ in kept]
