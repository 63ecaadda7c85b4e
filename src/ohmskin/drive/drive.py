"""What a drive is: it says what to measure next, from what is believed of the contacts."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints
from ohmskin.drive.patterns import base_pattern, candidate_pattern, numbers_of, part_of
from ohmskin.errors import PatternError
from ohmskin.geometry import Electrodes
from ohmskin.scan import DrivePattern

_ANGLES = np.pi / 2 + 2 * np.pi / 3 * np.arange(3)
_TRIANGLE = 2e-3 * np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])  # m, about the size of an element of a mesh


@dataclass(frozen=True, eq=False)
class Target:
    """The belief about one contact.

    Args:
        position: (2,) in metres.
        covariance: (2, 2) of the position (m2).
        effect: Relative conductivity change times area (m2); 0 where there may be no contact.
        radius: In metres.
        closest: (n, 2) centroids of the elements closest to it (m), if they are known.
    """

    position: Floats
    covariance: Floats
    effect: float
    radius: float
    closest: Floats = field(default_factory=lambda: np.empty((0, 2)))

    @classmethod
    def possible(cls, position: Floats, radius: float) -> Self:
        """A contact of usual `radius` (m) that may be at `position` (2,) (m)."""
        return cls(position, radius**2 * np.eye(2), 0.0, radius)

    @property
    def anchors(self) -> Floats:
        """Places (n, 2) from which eq. (7) weights pairs (m): `closest`, or a triangle around the position."""
        return self.closest if len(self.closest) else np.asarray(self.position, float) + _TRIANGLE


@runtime_checkable
class Drive(Protocol):
    """Chooses the next pattern. Deterministic and stateless.

    Attributes:
        patterns: All patterns that it may choose, entirely or in part: calibration measures these on the quiet skin.
        scans: Number of scans of one frame; those after the first are chosen from the data of the first.
        injections: Number of injections of all these scans together.
        adjustable: Whether that may be any number.
    """

    @property
    def patterns(self) -> tuple[DrivePattern, ...]: ...

    @property
    def scans(self) -> int: ...

    @property
    def injections(self) -> int: ...

    @property
    def adjustable(self) -> bool: ...

    def next(self, targets: Sequence[Target], turn: int) -> DrivePattern:
        """The pattern of the next scan.

        Args:
            targets: The belief about contacts; empty if none is known.
            turn: Number of the scan, from 0.
        """

    def with_injections(self, count: int) -> "Drive":
        """The same drive with `count` injections a frame, at least 1.

        Raises:
            PatternError: If the number cannot be chosen, or is out of range.
        """


@dataclass(frozen=True)
class Fixed:
    """A `Drive` that always measures the same pattern, independent of the belief.

    Args:
        pattern: The pattern.
    """

    pattern: DrivePattern
    scans, adjustable = 1, False

    @property
    def patterns(self) -> tuple[DrivePattern, ...]:
        """The pattern alone."""
        return (self.pattern,)

    @property
    def injections(self) -> int:
        """Injections of the pattern."""
        return self.pattern.n_inj

    def next(self, targets: Sequence[Target], turn: int) -> DrivePattern:
        return self.pattern

    def with_injections(self, count: int) -> Drive:
        """Raises PatternError for any `count`."""
        raise PatternError(f"a fixed pattern has no choice of injections; it has {self.injections}")


class SecondScan:
    """Chooses a pattern for the contacts at hand, always `pairs` injections out of `complete`, see `candidate_pattern`.

    Args:
        electrodes: Electrode layout.
        pairs: Number of injections in a pattern (K).
        period: Of a closed band, 0 of others (m).

    Raises:
        PatternError: If `pairs` is not between 1 and the number of electrode pairs.
    """

    repeats = False  # whether an injection may be chosen again

    def __init__(self, electrodes: Electrodes, pairs: int = 16, period: float = 0.0) -> None:
        self.electrodes, self.pairs, self.period = electrodes, pairs, period
        self.complete = candidate_pattern(electrodes, period)
        if not 1 <= pairs <= (np.inf if self.repeats else self.complete.n_inj):
            raise PatternError(f"{pairs} injections in the second scan; there are 1..{self.complete.n_inj} pairs")

    def pattern(self, regions: Sequence[ArrayLike]) -> DrivePattern:
        """The pattern for one or several regions, each given by its anchors (n, 2) in metres. A part of `complete`."""
        return part_of(self.complete, self.choose([np.asarray(anchors, float) for anchors in regions]))

    def next(self, targets: Sequence[Target]) -> DrivePattern:
        """The pattern for the belief about contacts, one or more `targets`."""
        return self.pattern([target.anchors for target in targets])

    def choose(self, regions: Sequence[Floats]) -> Ints:
        """The numbers (pairs,) of the injections of `complete` that are driven; subclasses say how they are chosen.

        Args:
            regions: Each given by its anchors (n, 2) (m).
        """
        raise NotImplementedError


@dataclass(frozen=True)
class TwoScans:
    """A `Drive` of a base scan of the whole sheet and a second scan chosen for what it showed (paper, section III).

    Args:
        base: The pattern of the first scan.
        second: Chooses that of the second.
    """

    base: DrivePattern
    second: SecondScan
    scans, adjustable = 2, False

    @property
    def patterns(self) -> tuple[DrivePattern, ...]:
        """The base scan, and the pattern from which the second scan is chosen."""
        return self.base, self.second.complete

    @property
    def injections(self) -> int:
        """Injections of both scans together."""
        return self.base.n_inj + self.second.pairs

    def next(self, targets: Sequence[Target], turn: int) -> DrivePattern:
        """The base scan in even turns, the scan chosen for the contacts in odd turns."""
        return self.second.next(targets) if turn % 2 and targets else self.base

    def with_injections(self, count: int) -> Drive:
        """Raises PatternError for any `count`."""
        raise PatternError(f"a drive of two scans has no choice of injections; it has {self.injections}")


@dataclass(frozen=True)
class WithDriven:
    """A `Drive` whose injections are measured at their source and sink, too.

    Args:
        drive: What is driven.
    """

    drive: Drive

    @property
    def patterns(self) -> tuple[DrivePattern, ...]:
        """Those of the drive, with driven electrodes."""
        return tuple(pattern.with_driven for pattern in self.drive.patterns)

    @property
    def scans(self) -> int:
        """Of the drive."""
        return self.drive.scans

    @property
    def injections(self) -> int:
        """Of the drive."""
        return self.drive.injections

    @property
    def adjustable(self) -> bool:
        """Of the drive."""
        return self.drive.adjustable

    def next(self, targets: Sequence[Target], turn: int) -> DrivePattern:
        """The drive's pattern, with driven electrodes."""
        return self.drive.next(targets, turn).with_driven

    def with_injections(self, count: int) -> "WithDriven":
        """The same with `count` injections a frame.

        Raises:
            PatternError: As the drive does.
        """
        return WithDriven(self.drive.with_injections(count))


class Exploration:
    """A `Drive` that cycles through a fixed set of injections, independent of the belief: it finds contacts everywhere.

    Args:
        electrodes: Electrode layout.
        injections: Injections per frame.
        drives: (n, 2) source and sink of the set; those of `base_pattern` unless given. All are measured.
        period: Of a closed band, 0 of others (m).

    Raises:
        PatternError: If there are no injections, or an electrode is not there.
    """

    scans, adjustable = 1, True

    def __init__(
        self, electrodes: Electrodes, injections: int = 4, drives: Ints | None = None, period: float = 0.0
    ) -> None:
        self.complete, n_elec = candidate_pattern(electrodes, period), len(electrodes)
        self._set_injections(injections)
        pairs = base_pattern(electrodes, period).injections if drives is None else np.asarray(drives)
        if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.min() < 0 or pairs.max() >= n_elec:
            raise PatternError(f"drives of shape {pairs.shape}; give (n, 2) numbers of the {n_elec} electrodes")
        self.drives: list[int] = numbers_of(self.complete, pairs).tolist()

    def _set_injections(self, count: int) -> None:
        if not 1 <= count <= self.complete.n_inj:
            raise PatternError(f"{count} injections per frame; there are 1..{self.complete.n_inj} pairs to choose from")
        self.injections = count

    @property
    def patterns(self) -> tuple[DrivePattern, ...]:
        """All pairs: each of its patterns is a part of them."""
        return (self.complete,)

    def with_injections(self, count: int) -> Self:
        """The same cycle (and its tables, if it has any) with `count` injections a frame.

        Raises:
            PatternError: If there are fewer injections, or `count` is not positive.
        """
        other = copy(self)
        other._set_injections(count)
        return other

    def next(self, targets: Sequence[Target], turn: int) -> DrivePattern:
        """The next injections of the cycle."""
        return part_of(self.complete, self.numbers(turn, self.injections))

    def numbers(self, turn: int, count: int) -> list[int]:
        """Numbers in `complete` of the next `count` injections, if each of the previous `turn` frames took as many."""
        return [self.drives[(turn * count + k) % len(self.drives)] for k in range(count)]
