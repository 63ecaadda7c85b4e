"""What a drive is: it says what to measure next, from what is believed of the contacts."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import PatternError
from ohmskin.scan import DrivePattern

_SMALL = 2e-3  # m: the triangle about a place when no element of a mesh is given, about the size of one


@dataclass(frozen=True, eq=False)
class Target:
    """What is believed of one contact.

    Args:
        position: (2,) in metres.
        covariance: (2, 2) of the position (m2).
        effect: Relative conductivity change times area (m2).
        radius: In metres.
        anchors: (n, 2) centroids of the elements closest to it, from which eq. (7) weighs pairs (m); a small triangle
            about the position unless given.
    """

    position: Floats
    covariance: Floats
    effect: float
    radius: float
    anchors: Floats = field(default_factory=lambda: np.empty((0, 2)))

    def __post_init__(self) -> None:
        if not len(self.anchors):
            angle = np.pi / 2 + 2 * np.pi / 3 * np.arange(3)
            about = np.asarray(self.position, float) + _SMALL * np.column_stack([np.cos(angle), np.sin(angle)])
            object.__setattr__(self, "anchors", about)


class Drive(Protocol):
    """Says what to measure next. Deterministic, and without memory of its own.

    Attributes:
        patterns: All that it may ever ask for, whole or in part: calibration measures these on the quiet skin.
        scans: How many scans make one frame; those after the first are chosen from what the first one showed.
        injections: How many injections these have together.
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
        """The pattern of scan number `turn` (from 0), given what is believed of the contacts."""

    def with_injections(self, count: int) -> "Drive":
        """The same drive with another number of injections a frame.

        Raises:
            PatternError: If it has no choice, or not that one.
        """


class SecondScan(Protocol):
    """Chooses a pattern for the contacts at hand, always `pairs` injections out of `complete`."""

    complete: DrivePattern
    pairs: int

    def pattern(self, regions: Sequence[ArrayLike]) -> DrivePattern:
        """The pattern for one or several regions, each given by its anchors (n, 2) in metres."""


@dataclass(frozen=True)
class Fixed:
    """Always the same pattern."""

    pattern: DrivePattern
    scans: int = field(default=1, init=False)
    adjustable: bool = field(default=False, init=False)

    @property
    def patterns(self) -> tuple[DrivePattern, ...]:
        """The pattern."""
        return (self.pattern,)

    @property
    def injections(self) -> int:
        """Of the pattern."""
        return self.pattern.n_inj

    def next(self, targets: Sequence[Target], turn: int) -> DrivePattern:
        """The pattern, whatever is believed."""
        return self.pattern

    def with_injections(self, count: int) -> Drive:
        """Refused."""
        raise PatternError(f"a fixed pattern has no choice of injections; it has {self.injections}")


@dataclass(frozen=True)
class TwoScans:
    """A base scan of the whole sheet, then a second scan chosen for what it showed (paper, section III).

    Args:
        base: The pattern of the first scan.
        second: Chooses that of the second.
    """

    base: DrivePattern
    second: SecondScan
    scans: int = field(default=2, init=False)
    adjustable: bool = field(default=False, init=False)

    @property
    def patterns(self) -> tuple[DrivePattern, ...]:
        """The base scan, and all that the second scan is a part of."""
        return self.base, self.second.complete

    @property
    def injections(self) -> int:
        """Of both scans."""
        return self.base.n_inj + self.second.pairs

    def next(self, targets: Sequence[Target], turn: int) -> DrivePattern:
        """The base scan in even turns, the one chosen for the contacts in odd turns."""
        return self.second.pattern([target.anchors for target in targets]) if turn % 2 and targets else self.base

    def with_injections(self, count: int) -> Drive:
        """Refused."""
        raise PatternError(f"a drive of two scans has no choice of injections; it has {self.injections}")


@dataclass(frozen=True)
class WithDriven:
    """A drive whose injections are measured at their source and sink, too.

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
        """What the drive wants, with driven electrodes."""
        return self.drive.next(targets, turn).with_driven

    def with_injections(self, count: int) -> "WithDriven":
        """The same with another number of injections a frame; raises PatternError as the drive does."""
        return WithDriven(self.drive.with_injections(count))
