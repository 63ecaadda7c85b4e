"""The topics of a recording and the definitions of their messages, as ROS 2 has them."""

import re
import struct
from collections.abc import Mapping

from ohmskin.client.fields import components, definition

_XYZ = "float64 x\nfloat64 y\nfloat64 z\n"

TEXTS = {
    "ohmskin_msgs/Pattern": """\
# A drive pattern. A frame refers to the newest pattern before it with its digest.
uint32 digest          # CRC-32 that names the pattern, as on the wire
uint16[] injections    # source, sink electrode of each injection, one pair after the other
uint32[] measurements  # number of the injection, plus, minus electrode of each voltage, one triple after the other
""",
    "ohmskin_msgs/Frame": """\
# One scan of one drive pattern.
builtin_interfaces/Time stamp  # when it arrived, by the calendar
float64 time                   # of the last sample, on the device's clock (s)
float64 arrived                # on the host's monotonic clock (s)
uint64 sequence                # counted by the device
uint32 pattern                 # digest of the pattern really driven
uint32 flags                   # 1 clipped, 2 current limit, 4 first since the device started, 8 overrun
# 0 not told, 1 first scan of a cycle, 2 a later one, 3 of the untouched skin (calibration)
uint8 role
float64[] voltages             # V; NaN where nothing was measured, infinite where the converter clipped
float64[] currents             # measured, A, one for each injection
string mode                    # mode, if told
float64 auxiliary              # of the auxiliary channel: N of a force, Pa of air; NaN not known
bool has_auxiliary             # whether the device has one
""",
    "ohmskin_msgs/Touch": """\
# What one cycle of the loop felt.
builtin_interfaces/Time stamp  # when it was recorded, by the calendar
uint64 sequence    # number of the cycle
float64 time       # of the last sample, on the host's monotonic clock (s)
string mode        # mode
uint64[] frames    # sequence numbers of the cycle's frames
ohmskin_msgs/Contact[] contacts
""",
    "ohmskin_msgs/Contact": definition(2),
    "sensor_msgs/Image": """\
# Relative conductivity change; row 0 is at the top (largest y), NaN off the skin. Metadata "raster" says where pixels
# are.
std_msgs/Header header
uint32 height
uint32 width
string encoding    # 32FC1
uint8 is_bigendian
uint32 step
uint8[] data
""",
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers\n",
    "visualization_msgs/Marker": """\
std_msgs/Header header
string ns
int32 id
int32 type
int32 action
geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
std_msgs/ColorRGBA color
builtin_interfaces/Duration lifetime
bool frame_locked
geometry_msgs/Point[] points
std_msgs/ColorRGBA[] colors
string texture_resource
sensor_msgs/CompressedImage texture
visualization_msgs/UVCoordinate[] uv_coordinates
string text
string mesh_resource
visualization_msgs/MeshFile mesh_file
bool mesh_use_embedded_materials
""",
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
    "diagnostic_msgs/DiagnosticStatus": """\
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
""",
    "rcl_interfaces/Log": """\
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
""",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec\n",
    "diagnostic_msgs/KeyValue": "string key\nstring value\n",
    "geometry_msgs/Point": _XYZ,
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Quaternion": f"{_XYZ}float64 w\n",
    "geometry_msgs/Vector3": _XYZ,
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data\n",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data\n",
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v\n",
}
"""Definition of each message type of a recording, without those of the types in it."""

FIELD = re.compile(r"^([a-z]\w*(?:/\w+)?)(\[\])? ([a-z]\w*)", re.MULTILINE)
"""A line of a definition: type, whether it is a sequence, name."""


def whole_definition(kind: str, texts: Mapping[str, str] = TEXTS) -> str:
    """The definition of a type (``package/Name``) and of all types in it, as ROS tools put them one after the other."""
    found, ahead = set(), {kind}
    while ahead:
        found |= ahead
        ahead = {own for part in ahead for own, *_ in FIELD.findall(texts[part]) if "/" in own} - found
    parts = (f"MSG: {own}\n{texts[own]}" for own in sorted(found - {kind}))
    return ("=" * 80 + "\n").join((texts[kind], *parts))


TOPICS = {
    f"/ohmskin/{name}": (kind.replace("/", "/msg/"), whole_definition(kind))
    for name, kind in {
        "pattern": "ohmskin_msgs/Pattern",
        "frame": "ohmskin_msgs/Frame",
        "touch": "ohmskin_msgs/Touch",
        "image": "sensor_msgs/Image",
        "markers": "visualization_msgs/MarkerArray",
        "health": "diagnostic_msgs/DiagnosticArray",
        "log": "rcl_interfaces/Log",
    }.items()
}
"""Type and definition of each topic; a topic's number is its place here, from 0."""

PATTERN, FRAME, TOUCH, IMAGE, MARKERS, HEALTH, LOG = range(len(TOPICS))
PREFIX = struct.Struct("<BIQI")
"""What precedes a message on its way to the writer's process: topic, sequence, time (ns), length."""


def contact_fields(touch_definition: str) -> tuple[str, ...]:
    """Names of the numbers of a contact in a file, by its own definition of a touch: older files have fewer."""
    own = touch_definition.partition("MSG: ohmskin_msgs/Contact\n")[2].partition("=" * 80)[0]
    kinds, names = zip(*re.findall(r"^(int32|float64) (\w+)", own, re.MULTILINE) or [("", "")], strict=True)
    return names if kinds[0] == "int32" and "int32" not in kinds[1:] else components(2)
