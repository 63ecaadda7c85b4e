"""The topics of a recording and the definitions of their messages, as ROS 2 has them."""

import re
import struct

from ohmskin.client.fields import components, definition

_TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
_DURATION = "MSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n"
_HEADER = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"

_PATTERN = """\
# A drive pattern. A frame refers to the newest pattern before it with its digest.
uint32 digest          # CRC-32 that names the pattern, as on the wire
uint16[] injections    # source, sink electrode of each injection, one pair after the other
uint32[] measurements  # number of the injection, plus, minus electrode of each voltage, one triple after the other
"""

_FRAME = """\
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
string mode                    # drive mode, if told
"""

_CONTACT_HEAD = "MSG: ohmskin_msgs/Contact\n"
_CONTACT = _CONTACT_HEAD + definition(2)

_TOUCH = """\
# What one cycle of the loop felt.
builtin_interfaces/Time stamp  # when it was recorded, by the calendar
uint64 sequence    # number of the cycle
float64 time       # of the last sample, on the host's monotonic clock (s)
string mode        # drive mode
uint64[] frames    # sequence numbers of the cycle's frames
ohmskin_msgs/Contact[] contacts
"""

_IMAGE = """\
# Relative conductivity change; row 0 is at the top (largest y), NaN off the skin. Metadata "raster" says where pixels
# are.
std_msgs/Header header
uint32 height
uint32 width
string encoding    # 32FC1
uint8 is_bigendian
uint32 step
uint8[] data
"""

_MARKERS = "visualization_msgs/Marker[] markers\n"
_MARKER = """\
MSG: visualization_msgs/Marker
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
"""
_POINT = "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
_POSE = "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
_QUATERNION = "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
_VECTOR = "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
_COLOUR = "MSG: std_msgs/ColorRGBA\nfloat32 r\nfloat32 g\nfloat32 b\nfloat32 a\n"
_COMPRESSED = "MSG: sensor_msgs/CompressedImage\nstd_msgs/Header header\nstring format\nuint8[] data\n"
_UV = "MSG: visualization_msgs/UVCoordinate\nfloat32 u\nfloat32 v\n"
_MESH = "MSG: visualization_msgs/MeshFile\nstring filename\nuint8[] data\n"
_MARKER_PARTS = (_HEADER, _TIME, _DURATION, _POSE, _POINT, _QUATERNION, _VECTOR, _COLOUR, _COMPRESSED, _UV, _MESH)

_HEALTH = "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n"
_STATUS = """\
MSG: diagnostic_msgs/DiagnosticStatus
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
"""
_KEY_VALUE = "MSG: diagnostic_msgs/KeyValue\nstring key\nstring value\n"

_LOG = """\
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
"""


def _joined(*parts: str) -> str:
    return ("=" * 80 + "\n").join(parts)


TOPICS = {
    "/ohmskin/pattern": ("ohmskin_msgs/msg/Pattern", _PATTERN),
    "/ohmskin/frame": ("ohmskin_msgs/msg/Frame", _joined(_FRAME, _TIME)),
    "/ohmskin/touch": ("ohmskin_msgs/msg/Touch", _joined(_TOUCH, _TIME, _CONTACT)),
    "/ohmskin/image": ("sensor_msgs/msg/Image", _joined(_IMAGE, _HEADER, _TIME)),
    "/ohmskin/markers": ("visualization_msgs/msg/MarkerArray", _joined(_MARKERS, _MARKER, *_MARKER_PARTS)),
    "/ohmskin/health": ("diagnostic_msgs/msg/DiagnosticArray", _joined(_HEALTH, _HEADER, _TIME, _STATUS, _KEY_VALUE)),
    "/ohmskin/log": ("rcl_interfaces/msg/Log", _joined(_LOG, _TIME)),
}
"""Type and definition of each topic; a topic's number is its place here, from 0."""

PATTERN, FRAME, TOUCH, IMAGE, MARKERS, HEALTH, LOG = range(len(TOPICS))
PREFIX = struct.Struct("<BIQI")
"""What precedes a message on its way to the writer's process: topic, sequence, time (ns), length."""


def contact_fields(touch_definition: str) -> tuple[str, ...]:
    """Names of the numbers of a contact in a file, by its own definition of a touch: older files have fewer."""
    own = touch_definition.partition(_CONTACT_HEAD)[2].partition("=" * 80)[0]
    found = re.findall(r"^(int32|float64) (\w+)", own, re.MULTILINE)
    kinds = [kind for kind, _ in found]
    if kinds[:1] != ["int32"] or "int32" in kinds[1:]:
        return components(2)
    return tuple(name for _, name in found)
