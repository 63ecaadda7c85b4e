"""Arrays as text in a skin's file: data and never code, bounded and checked."""

import base64
import io
import zipfile
import zlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ohmskin.arrays import Floats

_MOST_BYTES = 2**25  # unpacked
UNREADABLE = (
    ValueError,
    KeyError,
    OSError,
    EOFError,
    MemoryError,
    zipfile.BadZipFile,
    zlib.error,
    NotImplementedError,
)
"""What damaged text may raise."""


def pack(arrays: Mapping[str, NDArray]) -> str:
    """Arrays as text; `unpack` reads them back."""
    packed = io.BytesIO()
    np.savez_compressed(packed, allow_pickle=False, **arrays)
    return base64.b64encode(packed.getvalue()).decode()


def unpack(text: str) -> dict[str, Floats]:
    """The arrays of a text; one of `UNREADABLE` if it holds none, too many, or values that are not finite."""
    packed = io.BytesIO(base64.b64decode(text, validate=True))
    with zipfile.ZipFile(packed) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > _MOST_BYTES:
            raise ValueError(f"it has more than {_MOST_BYTES} bytes")
    with np.load(packed, allow_pickle=False) as arrays:
        given = {name: np.asarray(arrays[name], float) for name in arrays.files}
    if not all(np.isfinite(one).all() for one in given.values()):
        raise ValueError("a value is not finite")
    return given
