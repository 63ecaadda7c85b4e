"""ROS 2's own messages: images, markers, health and the log, as recordings and outlets pack them.

What reads a message raises `DataError` for bytes that are not one.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ohmskin.arrays import Floats, quiet_nans
from ohmskin.client.cdr import CdrDecoder, CdrEncoder
from ohmskin.client.contacts import Patch, PlacedContact
from ohmskin.errors import DataError

FRAME_ID = "skin"
"""The coordinate frame of contacts and images: metres on the sheet."""
_DELETE_ALL, _ADD, _CYLINDER = 3, 0, 3  # of visualization_msgs/Marker


def encode_image(pixels: Floats, stamp: int, frame_id: str = FRAME_ID) -> bytes:
    """`sensor_msgs/msg/Image`, 32FC1, of pixels (ny, nx) with row 0 at the bottom, as `Raster` gives them."""
    height, width = pixels.shape
    flipped = np.ascontiguousarray(pixels[::-1], "<f4")
    encoder = CdrEncoder().stamp(stamp).text(frame_id).put("II", height, width).text("32FC1")
    return encoder.put("BI", 0, 4 * width).array(flipped.view("u1").ravel()).done()


def decode_image(data: bytes) -> Floats:
    """The pixels (ny, nx) of a 32FC1 image, row 0 at the bottom."""
    decoder = CdrDecoder(data)
    decoder.stamp()
    decoder.text()
    height, width = (int(n) for n in decoder.take("II"))
    encoding = decoder.text()
    _, step = decoder.take("BI")
    content = read_array(decoder, "u1")
    if encoding != "32FC1" or step != 4 * width or content.size != 4 * width * height:
        raise DataError(f"an image of {height} x {width} pixels, {encoding!r}, {content.size} bytes; need 32FC1")
    return quiet_nans(content.view("<f4").reshape(height, width)[::-1])


def encode_markers(contacts: Sequence[PlacedContact], patches: Sequence[Patch], stamp: int) -> bytes:
    """`visualization_msgs/msg/MarkerArray`: those of before go, which is said in the first frame, and contacts come.

    Each is a flat cylinder of its extent, red where conductivity rises, blue where it falls.
    """
    nothing = PlacedContact(0, "", patches[0].frame, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0, 0.0, 0.0, 0.0)
    turns = {"": (0.0, 0.0, 0.0, 1.0)}
    turns |= {p.name: Rotation.from_matrix(np.array(p.axes).T).as_quat(canonical=True).tolist() for p in patches}
    encoder = CdrEncoder().put("I", 1 + len(contacts))
    for action, c in [(_DELETE_ALL, nothing), *((_ADD, contact) for contact in contacts)]:
        width = 2 * float(np.sqrt(c.extent / np.pi))
        colour = (0.84, 0.19, 0.15, 0.7) if c.strength >= 0 else (0.19, 0.36, 0.76, 0.7)
        encoder.stamp(stamp).text(c.frame).text(c.patch).put("iii", c.id, _CYLINDER, action)
        encoder.put("ddddddd", *c.position, *turns[c.patch]).put("dddffff", width, width, 1e-3, *colour)
        encoder.put("iI?", 0, 0, False)  # shown until replaced; not locked to a moving frame
        encoder.put("II", 0, 0).text("")  # points, colours, texture's name
        encoder.put("iI", 0, 0).text("").text("").put("I", 0)  # texture: header, format, data
        encoder.put("I", 0).text("").text("").text("").put("I", 0).put("?", False)  # texture's places, text, mesh
    return encoder.done()


def encode_health(
    values: Mapping[str, float], message: str, device: str, stamp: int, name: str = "ohmskin", error: bool = False
) -> bytes:
    """`diagnostic_msgs/msg/DiagnosticArray` with one status of that name; a message makes it a warning or an error."""
    encoder = CdrEncoder().stamp(stamp).text(FRAME_ID).put("I", 1)
    encoder.put("B", 2 if error else 1 if message else 0).text(name).text(message or "running").text(device)
    encoder.put("I", len(values))
    for name, value in values.items():
        encoder.text(name).text(f"{value:.6g}")
    return encoder.done()


def encode_log(message: str, stamp: int) -> bytes:
    """`rcl_interfaces/msg/Log` at the level INFO."""
    return CdrEncoder().stamp(stamp).put("B", 20).text("ohmskin").text(message).text("").text("").put("I", 0).done()


def decode_log(data: bytes) -> str:
    """The sentence of a log message."""
    decoder = CdrDecoder(data)
    decoder.stamp()
    decoder.take("B")
    decoder.text()
    return decoder.text()


def read_array(decoder: CdrDecoder, kind: str) -> NDArray:
    """A sequence of numbers of a NumPy type such as ``f8``, as an array of its own."""
    dtype = np.dtype("<" + kind)
    return np.frombuffer(decoder.block(dtype.itemsize), dtype).copy()
