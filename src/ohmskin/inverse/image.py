"""What a reconstruction gives."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.scan import Difference

NoiseStd = Callable[[ArrayLike], Floats]


@dataclass(frozen=True)
class Image:
    """A reconstructed image.

    Args:
        values: (n_elem,) relative change of conductivity (1).
        noise_std: Function from element numbers (n,) to the standard deviation (n,) of their noise.
        logarithmic: Whether it was solved for in the logarithm of the conductivity.
        shares: Of an image of pixels, (n_elem, n_pixels) share of each element in each pixel; else None.
    """

    values: Floats
    noise_std: NoiseStd = field(repr=False)
    logarithmic: bool = False
    shares: sp.csc_array | None = field(default=None, repr=False)

    @cached_property
    def on_mesh(self) -> "Image":
        """This image with one value per element of the mesh, whatever it is made of; noise is that of the pixel with
        the largest share of an element."""
        if (shares := self.shares) is None:
            return self

        def noise_std(elements: ArrayLike) -> Floats:
            entries = shares.tocoo()  # each element has one at least
            order = np.lexsort((entries.data, entries.row))
            last = np.flatnonzero(np.diff(entries.row[order], append=-1))
            largest = entries.col[order][last]
            return self.noise_std(largest[np.asarray(elements)])

        return Image(shares @ self.values, noise_std, self.logarithmic)

    @property
    def contrast(self) -> Floats:
        """(n_elem,) values to search for contacts: the image, or the log conductivity ratio of a logarithmic one.

        A ratio is bounded below but not above, so that noise would resemble contacts that conduct better.
        """
        return np.log1p(self.values) if self.logarithmic else self.values

    def __reduce__(self) -> tuple[object, ...]:
        table = TabulatedStd(
            self.noise_std(np.arange(len(self.values)))
        )  # what it is computed from is large, and stays here
        return Image, (self.values, table, self.logarithmic, self.shares)

    def contrast_std(self, elements: ArrayLike) -> Floats:
        """Standard deviations (n,) that measurement noise gives the contrast of some elements (n,)."""
        std = self.noise_std(elements)
        return std / (1 + self.values[np.atleast_1d(elements)]) if self.logarithmic else std


@dataclass(frozen=True)
class TabulatedStd:
    """Standard deviations (n_elem,) that are known already, as a function of element numbers."""

    std: Floats

    def __call__(self, elements: ArrayLike) -> Floats:
        """Of some elements (n,)."""
        return np.asarray(self.std[np.atleast_1d(elements)])


class Reconstructor(Protocol):
    """Makes an image of some scans, whatever came before."""

    def reconstruct(self, *differences: Difference) -> Image:
        """The image of one scan, or of several fused. Channels that are not finite are left out.

        Args:
            differences: The scans, each as changes against the untouched skin.

        Raises:
            DataError: If no finite datum is left.
        """
