"""The topics that are published and the definitions of their messages."""

from dataclasses import dataclass
from functools import cached_property

from ohmskin.client.fields import definition
from ohmskin.client.remote import prefix
from ohmskin.mcap.schemas import TOPICS as RECORDED
from ohmskin.outlets.types import Types, dds_name, joined, read_types, rihs01, split

_CONTACTS = """\
# What one skin, or all skins of a robot, felt last.
# stamp: last sample of the patch heard of longest ago; frame_id is empty, each contact has its own
std_msgs/Header header
uint64 boot              # changes whenever the sender starts anew
uint64 sequence          # counts up by one, from 1 at a new boot
ohmskin_msgs/PatchState[] patches
ohmskin_msgs/PlacedContact[] contacts
"""
_PATCH_STATE = """\
# How fresh the part of one patch is.
string name
string frame_id                     # of its contacts
builtin_interfaces/Time stamp       # of its last sample; zero if it has not been heard of
uint64 sequence                     # number of its cycle
string mode                         # drive mode
"""
_PLACED_CONTACT = f"""\
# One place where the robot is touched, in the frame of its patch.
uint32 patch  # place in the list of patches
{definition(3)}"""
_CLOUD = """\
std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields  # x, y, z (m) and change (relative conductivity change), float32
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
"""
_POINT_FIELD = "string name\nuint32 offset\nuint8 datatype\nuint32 count\n"
_WRENCH_STAMPED = "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n"
_WRENCH = "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n"

TEXTS = dict(entry for kind, text in RECORDED.values() for entry in split(kind, text)) | {
    "ohmskin_msgs/msg/Contacts": _CONTACTS,
    "ohmskin_msgs/msg/PatchState": _PATCH_STATE,
    "ohmskin_msgs/msg/PlacedContact": _PLACED_CONTACT,
    "sensor_msgs/msg/PointCloud2": _CLOUD,
    "sensor_msgs/msg/PointField": _POINT_FIELD,
    "geometry_msgs/msg/WrenchStamped": _WRENCH_STAMPED,
    "geometry_msgs/msg/Wrench": _WRENCH,
}
TYPES: Types = {kind: fields for name, text in TEXTS.items() for kind, fields in read_types(name, text).items()}
"""The fields of every message type that is used."""


@dataclass(frozen=True)
class Topic:
    """One topic.

    Args:
        name: Its full name, ``/ohmskin/contacts``.
        type: Type of its messages, ``ohmskin_msgs/msg/Contacts``.
        reliable: Whether a message that got lost is sent again.
        depth: Messages kept for a subscriber that is late.
    """

    name: str
    type: str
    reliable: bool
    depth: int

    @cached_property
    def hash(self) -> str:
        """RIHS01 of the type."""
        return rihs01(self.type, TYPES)

    @cached_property
    def dds_type(self) -> str:
        """The type as DDS calls it."""
        return dds_name(self.type)

    @cached_property
    def definition(self) -> str:
        """The type's definition with all types in it."""
        return joined(self.type, TEXTS, TYPES)


def contacts_topic(name: str) -> Topic:
    """The topic with the contacts of the skin or body of that name."""
    return Topic(f"{prefix(name)}/contacts", "ohmskin_msgs/msg/Contacts", True, 10)
