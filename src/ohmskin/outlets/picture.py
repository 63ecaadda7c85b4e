"""An image on a board: pixels of the relative conductivity change, and when they were measured."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.client.contacts import Patch
from ohmskin.errors import PublishError

if TYPE_CHECKING:  # the publishing process needs no meshes
    from ohmskin.geometry import Chart, Raster

_HEAD = struct.Struct("<Qq")


@dataclass(frozen=True)
class Picture:
    """An image.

    Args:
        pixels: Relative conductivity change (ny, nx), row 0 at the bottom, NaN off the skin.
        points: Pixel centres (ny, nx, 3) in the patch's frame (m).
        sequence: Number of its cycle.
        stamp: Its last sample (ns since 1970).
    """

    pixels: Floats
    points: Floats
    sequence: int
    stamp: int

    def place(self, point: Sequence[float], raster: Mapping[str, Any]) -> tuple[float, float]:
        """Where on the skin's map (m) a point (3,) in the frame is: from the closest pixel on along the skin."""
        away = np.asarray(point, float) - self.points
        row, column = np.unravel_index(np.argmin((away**2).sum(axis=2)), self.pixels.shape)
        found = []
        for axis, at in ((1, column), (0, row)):
            ahead = min(at + 1, self.pixels.shape[axis] - 1)
            line = self.points[row] if axis else self.points[:, column]
            step = line[ahead] - line[ahead - 1]
            found.append(float(at + away[row, column] @ step / max(step @ step, 1e-300)))
        return raster["x0"] + raster["pitch"] * found[0], raster["y0"] + raster["pitch"] * found[1]

    @staticmethod
    def setup(raster: "Raster") -> dict[str, Any]:
        """What a page gets of its pixels on the skin's map."""
        first = {"x0": float(raster.x[0]), "y0": float(raster.y[0])}
        return {"raster": {**first, "pitch": raster.pitch, "nx": len(raster.x), "ny": len(raster.y)}}

    @staticmethod
    def in_space(raster: "Raster", chart: "Chart", patch: Patch) -> dict[str, Any]:
        """What the setup of its board has beside that: where the pixels are in the patch's frame (m)."""
        centres = np.stack(np.meshgrid(raster.x, raster.y), axis=-1).reshape(-1, 2)
        points = np.array(patch.position) + chart.points(centres) @ np.array(patch.axes)
        return {"points": points.round(6).ravel().tolist()}

    @staticmethod
    def pack(pixels: Floats, sequence: int, stamp: int) -> bytes:
        """An image for a board: sequence, stamp, pixels as float32."""
        return _HEAD.pack(sequence, stamp) + pixels.astype("<f4").tobytes()

    @staticmethod
    def size(raster: "Raster") -> int:
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
            points = np.asarray(setup["points"], float).reshape(ny, nx, 3)
            sequence, stamp = _HEAD.unpack_from(content)
            pixels = np.frombuffer(content, "<f4", offset=_HEAD.size).reshape(ny, nx).astype(float)
        except (KeyError, TypeError, ValueError, struct.error) as error:
            raise PublishError(
                f"an image of {len(content)} bytes in shared memory does not fit its setup: {error}"
            ) from error
        return cls(pixels, points, sequence, stamp)
