"""The topics that are published and the definitions of their messages."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ohmskin.client.fields import definition
from ohmskin.client.remote import CONTACTS_HASH, prefix
from ohmskin.mcap.schemas import TEXTS as RECORDED
from ohmskin.mcap.schemas import whole_definition

TEXTS = RECORDED | {
    "ohmskin_msgs/Contacts": """\
# The newest contacts of one skin, or of all skins of a robot.
# stamp: last sample of the patch with the oldest data; frame_id: of all contacts; empty if patches have several
std_msgs/Header header
uint64 boot              # changes whenever the sender starts anew
uint64 sequence          # counts up by one, from 1 at a new boot
ohmskin_msgs/PatchState[] patches
ohmskin_msgs/PlacedContact[] contacts
float64[] total_force    # N, of all contacts on each patch, by its auxiliary channel; NaN without a sound one
""",
    "ohmskin_msgs/PatchState": """\
# How fresh the part of one patch is.
string name
string frame_id                     # of its contacts
builtin_interfaces/Time stamp       # of its last sample; zero if it has not been heard of
uint64 sequence                     # number of its cycle
string mode                         # mode
""",
    "ohmskin_msgs/PlacedContact": f"""\
# One place where the robot is touched, in the frame of its patch.
uint32 patch  # place in the list of patches
{definition(3)}""",
    "sensor_msgs/PointCloud2": """\
std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields  # x, y, z (m) and change (relative conductivity change), float32
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
""",
    "sensor_msgs/PointField": "string name\nuint32 offset\nuint8 datatype\nuint32 count\n",
    "sensor_msgs/JointState": """\
std_msgs/Header header
string[] name
float64[] position  # rad, m
float64[] velocity
float64[] effort
""",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    ),
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
}
"""Definition of each message type that is recorded, published or heard, without those of the types in it."""

_HASHES = {
    "ohmskin_msgs/msg/Contacts": CONTACTS_HASH,
    "visualization_msgs/msg/MarkerArray": "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
    "geometry_msgs/msg/WrenchStamped": "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    "diagnostic_msgs/msg/DiagnosticArray": "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    "sensor_msgs/msg/Image": "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    "sensor_msgs/msg/JointState": "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "tf2_msgs/msg/TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "sensor_msgs/msg/PointCloud2": "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
}
"""What names each published type to others (REP 2016), made of the types in it; a test holds them against rosbags'."""


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

    @property
    def hash(self) -> str:
        """RIHS01 of the type."""
        return _HASHES[self.type]

    @property
    def dds_type(self) -> str:
        """The type as DDS calls it."""
        return dds_name(self.type.replace("/msg/", "/"))

    @property
    def definition(self) -> str:
        """The type's definition with all types in it."""
        return whole_definition(self.type.replace("/msg/", "/"), TEXTS)


def contacts_topic(name: str) -> Topic:
    """The topic with the contacts of the skin or body of that name."""
    return Topic(f"{prefix(name)}/contacts", "ohmskin_msgs/msg/Contacts", True, 10)


def wrench_topic(name: str, link: str, links: Sequence[str]) -> Topic:
    """The topic with the wrench on a link, of `links` that have one; a skin on one link needs not name it."""
    own = re.sub(r"[^A-Za-z0-9_]", "_", link)
    path = f"{prefix(name)}/wrench" if len(links) == 1 else f"{prefix(name)}/wrench/{own}"
    return Topic(path, "geometry_msgs/msg/WrenchStamped", True, 10)


def dds_name(kind: str) -> str:
    """How DDS calls a type: ``sensor_msgs::msg::dds_::Image_`` for ``sensor_msgs/Image``."""
    package, _, name = kind.partition("/")
    return f"{package}::msg::dds_::{name}_"
