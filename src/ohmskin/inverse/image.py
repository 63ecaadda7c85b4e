"""What a reconstruction gives."""

from collections.abc import Callable
from dataclasses import dataclass, field

from numpy.typing import ArrayLike

from ohmskin.geometry.domain import Floats


@dataclass(frozen=True)
class Image:
    """A reconstructed image.

    Args:
        values: (n_elem,) relative change of conductivity (1).
        noise_std: Function from element numbers (n,) to the standard deviation (n,) that measurement noise gives the values.
    """

    values: Floats
    noise_std: Callable[[ArrayLike], Floats] = field(repr=False)
