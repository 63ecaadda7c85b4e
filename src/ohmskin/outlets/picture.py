"""An image on a board: pixels of the relative conductivity change, and when they were measured."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.errors import PublishError
from ohmskin.geometry import Raster

_HEAD = struct.Struct("<Qq")


@dataclass(frozen=True)
class Picture:
    """An image.

    Args:
        pixels: Relative conductivity change (ny, nx), row 0 at the bottom, NaN off the skin.
        x, y: Pixel centres (nx,), (ny,) on the sheet (m).
        sequence: Number of its cycle.
        stamp: Its last sample (ns since 1970).
    """

    pixels: Floats
    x: Floats
    y: Floats
    sequence: int
    stamp: int

    @staticmethod
    def setup(raster: Raster) -> dict[str, Any]:
        """What the setup of its board tells."""
        first = {"x0": float(raster.x[0]), "y0": float(raster.y[0])}
        return {"raster": {**first, "pitch": raster.pitch, "nx": len(raster.x), "ny": len(raster.y)}}

    @staticmethod
    def pack(pixels: Floats, sequence: int, stamp: int) -> bytes:
        """An image for a board: sequence, stamp, pixels as float32."""
        return _HEAD.pack(sequence, stamp) + pixels.astype("<f4").tobytes()

    @staticmethod
    def size(raster: Raster) -> int:
        """How many bytes `pack` makes."""
        return _HEAD.size + 4 * raster.inside.size

    @classmethod
    def unpack(cls, content: bytes, setup: Mapping[str, Any]) -> "Picture":
        """An image from a board.

        Raises:
            PublishError: If it does not have as many pixels as the setup says.
        """
        try:
            r = setup["raster"]
            nx, ny = int(r["nx"]), int(r["ny"])
            x, y = r["x0"] + r["pitch"] * np.arange(nx), r["y0"] + r["pitch"] * np.arange(ny)
            sequence, stamp = _HEAD.unpack_from(content)
            pixels = np.frombuffer(content, "<f4", offset=_HEAD.size).reshape(ny, nx).astype(float)
        except (KeyError, TypeError, ValueError, struct.error) as error:
            raise PublishError(f"a board's image of {len(content)} bytes does not fit its setup: {error}") from error
        return cls(pixels, x, y, sequence, stamp)
