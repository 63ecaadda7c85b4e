"""Triangles of a skin as text, so that a skin file has all that it needs."""

import base64
import binascii
import struct
import zlib

import numpy as np

from ohmskin.errors import GeometryError
from ohmskin.geometry import Mesh

_MOST_TEXT, _MOST_BYTES = 3 * 2**18, 2**22


def surface_text(surface: Mesh) -> str:
    """Triangles in space as text: node coordinates (32-bit floats, m) and node numbers, compressed.

    Raises:
        GeometryError: If it would be too long.
    """
    nodes, elements = surface.nodes.astype("<f4"), surface.elements.astype("<u4")
    packed = (
        struct.pack("<I", len(nodes)) + nodes.tobytes() + np.diff(elements.ravel(), prepend=0).astype("<u4").tobytes()
    )
    text = base64.b64encode(zlib.compress(packed, 9)).decode()
    if len(text) > _MOST_TEXT or len(packed) > _MOST_BYTES:
        large = f"the surface of {len(elements)} triangles takes {len(text) / 2**10:.0f} KiB of a skin file"
        raise GeometryError(f"{large}, {_MOST_TEXT / 2**10:.0f} are allowed; simplify the mesh, or cut off more of it")
    return text


def surface_of(text: str) -> Mesh:
    """The triangles that `surface_text` wrote.

    Raises:
        GeometryError: If it did not write this.
    """
    try:
        unpack = zlib.decompressobj()
        packed = unpack.decompress(base64.b64decode(text, validate=True), _MOST_BYTES)
        if not unpack.eof:
            raise ValueError("truncated, or too long")
        (count,) = struct.unpack_from("<I", packed)
        nodes = np.frombuffer(packed, "<f4", 3 * count, 4).reshape(-1, 3)
        steps = np.frombuffer(packed, "<u4", offset=4 + nodes.nbytes).reshape(-1, 3)
    except (ValueError, binascii.Error, struct.error, zlib.error) as error:
        raise GeometryError(f"surface is not what ohmskin writes ({error}); give the mesh file again") from None
    numbers = np.cumsum(steps.ravel(), dtype="<u4").reshape(-1, 3)
    return Mesh(nodes.astype(float), numbers.astype(np.int64))
