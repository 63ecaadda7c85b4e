"""Contacts as ROS 2 messages, in the frames of the robot; see `ohmskin.outlets.topics` for their definitions."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ohmskin.arrays import Floats
from ohmskin.client.cdr import CdrEncoder
from ohmskin.client.contacts import Contacts, PlacedContact, wrench
from ohmskin.client.fields import as_number, components, numbers

_FLOAT32 = 7  # of sensor_msgs/PointField
_CONTACT = "Ii" + "d" * (len(components(3)) - 1)


def encode_contacts(merged: Contacts) -> bytes:
    """`ohmskin_msgs/msg/Contacts`."""
    frames = {patch.frame for patch in merged.patches}
    frame = frames.pop() if len(frames) == 1 else ""
    encoder = (
        CdrEncoder()
        .stamp(merged.stamp)
        .text(frame)
        .put("QQ", merged.boot, merged.sequence)
        .put("I", len(merged.patches))
    )
    for patch in merged.patches:
        encoder.text(patch.patch).text(patch.frame).stamp(patch.stamp).put("Q", patch.sequence).text(patch.mode)
    places = {patch.patch: number for number, patch in enumerate(merged.patches)}
    encoder.put("I", len(merged.contacts))
    for c in merged.contacts:
        encoder.put(_CONTACT, places[c.patch], *numbers(c, 3))
    return encoder.array(np.array([as_number(patch.total_force) for patch in merged.patches])).done()


def encode_wrench(contacts: Sequence[PlacedContact], frame: str, stamp: int) -> bytes:
    """`geometry_msgs/msg/WrenchStamped`: what contacts push their link with, and the torque about the link's origin.

    Args:
        contacts: The contacts, whose forces are known.
        frame: The link.
        stamp: ns since 1970.
    """
    force, torque = wrench(contacts)
    return CdrEncoder().stamp(stamp).text(frame).put("dddddd", *force, *torque).done()


def encode_joints(positions: Mapping[str, float], stamp: int) -> bytes:
    """`sensor_msgs/msg/JointState`: positions alone (rad, m)."""
    encoder = CdrEncoder().stamp(stamp).text("").put("I", len(positions))
    for name in positions:
        encoder.text(name)
    for values in (list(positions.values()), [], []):
        encoder.array(np.array(values, float))
    return encoder.done()


def encode_transforms(root: str, poses: Mapping[str, Sequence[float]], stamp: int) -> bytes:
    """`tf2_msgs/msg/TFMessage`: the poses (16,) of links in the frame of the root, row by row (m)."""
    links = {name: np.reshape(pose, (4, 4)) for name, pose in poses.items() if name != root}
    encoder = CdrEncoder().put("I", len(links))
    for name, pose in links.items():
        turn = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True)
        encoder.stamp(stamp).text(root).text(name).put("ddddddd", *pose[:3, 3], *turn)
    return encoder.done()


def encode_cloud(pixels: Floats, places: Floats, frame: str, stamp: int) -> bytes:
    """`sensor_msgs/msg/PointCloud2`: x, y, z and relative conductivity change of every pixel on the skin.

    Args:
        pixels: (ny, nx), NaN off the skin.
        places: Their centres (ny, nx, 3) in the frame (m).
        frame: The link.
        stamp: ns since 1970.
    """
    inside = np.isfinite(pixels)
    points = np.column_stack([places[inside], pixels[inside]]).astype("<f4")
    encoder = CdrEncoder().stamp(stamp).text(frame).put("II", 1, len(points)).put("I", 4)
    for number, name in enumerate(("x", "y", "z", "change")):
        encoder.text(name).put("IBI", 4 * number, _FLOAT32, 1)
    encoder.put("?II", False, 16, 16 * len(points)).array(points.view("u1").ravel())
    return encoder.put("?", True).done()
