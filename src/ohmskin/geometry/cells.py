"""What an image is made of, be it triangles or pixels."""

from typing import Protocol

from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints


class Cells(Protocol):
    """The parts of a sheet that an image gives one value each: a `Mesh`, or the `Pixels` over one."""

    @property
    def centroids(self) -> Floats:
        """(n_cells, 2 or 3) in metres."""

    @property
    def measures(self) -> Floats:
        """Areas (n_cells,) in m2."""

    @property
    def neighbours(self) -> Ints:
        """The cell (n_cells, n) beyond each side, -1 where there is none."""

    @property
    def period(self) -> float:
        """Of a closed band, 0 of others (m)."""

    def closest_elements(self, points: ArrayLike, count: int = 3) -> Ints:
        """Numbers (n, count) of the cells whose centroids are closest to `points` (n, 2 or 3)."""
