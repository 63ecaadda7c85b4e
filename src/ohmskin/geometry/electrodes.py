"""Electrode layouts: where the electrodes are and in what order a scan walks round them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ohmskin.errors import GeometryError
from ohmskin.geometry.domain import Domain, Floats, Rectangle

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Electrodes:
    """Electrode centres, numbered ring by ring from the rim inwards, each ring counterclockwise.

    Args:
        positions: Electrode centres (n_elec, 2) in metres.
        rings: Electrode numbers of each ring, the rim first. A base scan walks round the first ring.

    Raises:
        GeometryError: If positions are not finite, not distinct, fewer than four, or not all named once by `rings`.
    """

    positions: Floats
    rings: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        positions = np.array(self.positions, float)
        if positions.ndim != 2 or positions.shape[1] != 2 or len(positions) < 4:
            raise GeometryError(f"electrode positions have shape {positions.shape}; need (n, 2) with n >= 4")
        if not np.isfinite(positions).all():
            raise GeometryError(f"electrode {int(np.argmin(np.isfinite(positions).all(1)))} has a position that is not finite")
        gaps = np.linalg.norm(positions[:, None] - positions[None], axis=-1) + np.diag(np.full(len(positions), np.inf))
        if gaps.min() < 1e-6:
            a, b = np.unravel_index(np.argmin(gaps), gaps.shape)
            raise GeometryError(f"electrodes {a} and {b} are at the same place {positions[a]}; move one of them")
        named = sorted(e for ring in self.rings for e in ring)
        if named != list(range(len(positions))):
            raise GeometryError(f"rings {self.rings} must name each of the {len(positions)} electrodes exactly once")
        positions.setflags(write=False)
        object.__setattr__(self, "positions", positions)

    def __len__(self) -> int:
        return len(self.positions)

    @classmethod
    def at(cls, positions: ArrayLike, rings: tuple[tuple[int, ...], ...] | None = None) -> "Electrodes":
        """Electrodes at given positions (n_elec, 2) in metres; one ring in the given order unless `rings` says otherwise."""
        points = np.asarray(positions, float)
        return cls(points, rings or (tuple(range(len(points))),))

    @classmethod
    def rim(cls, domain: Domain, count: int, start: float = 0.0, clockwise: bool = False) -> "Electrodes":
        """`count` electrodes evenly spaced along the rim of `domain`.

        Args:
            domain: The sheet.
            count: How many.
            start: Place of the first, as a share of the rim's length counterclockwise from where the rim starts (0 to 1). On a
                disc, 0.25 is 12 o'clock.
            clockwise: Number them clockwise.
        """
        if count < 4:
            raise GeometryError(f"{count} electrodes on the rim; need at least 4")
        if not 0 <= start < 1:
            raise GeometryError(f"start {start} of the rim; it must be from 0 to below 1, a share of the rim's length")
        shares = start + (-1 if clockwise else 1) * np.arange(count) / count
        return cls.at(domain.rim(np.mod(shares, 1.0) * domain.perimeter))

    @classmethod
    def grid(cls, sheet: Rectangle, columns: int = 4, rows: int = 4, inset: float = 0.0) -> "Electrodes":
        """A regular grid that spans the sheet, `inset` metres away from its rim (paper, section IV-A).

        The default 4 x 4 grid has 12 electrodes on the outer ring (0-11) and 4 inside (12-15).
        """
        if columns < 2 or rows < 2:
            raise GeometryError(f"a grid of {columns} x {rows} electrodes; need at least 2 x 2")
        if not 0 <= inset < min(sheet.width, sheet.height) / 2:
            raise GeometryError(f"grid inset {inset} m; it must be from 0 to below half of the sheet's shorter side")
        x = np.linspace(inset, sheet.width - inset, columns)
        y = np.linspace(inset, sheet.height - inset, rows)
        positions: list[tuple[float, float]] = []
        rings: list[tuple[int, ...]] = []
        while len(x) and len(y):
            ring = list(dict.fromkeys(
                [(a, y[0]) for a in x] + [(x[-1], b) for b in y] + [(a, y[-1]) for a in x[::-1]] + [(x[0], b) for b in y[::-1]]
            ))  # fmt: skip
            rings.append(tuple(range(len(positions), len(positions) + len(ring))))
            positions += ring
            x, y = x[1:-1], y[1:-1]
        return cls(np.array(positions), tuple(rings))
