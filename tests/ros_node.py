"""A node of ROS 2, run by test_ros_node.py with a Python that has rclpy; it knows nothing of ohmskin.

It tells joint states, and prints as JSON what it hears on the topics that it is given (NAME=PACKAGE/Type) once it has
heard each of them, and the types and hashes that ROS 2 sees there.
"""

import json
import sys
import time
from importlib import import_module

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import JointState

topics = dict(pair.split("=") for pair in sys.argv[1:])
rclpy.init()
node = rclpy.create_node("listener")
heard = {}
for name, kind in topics.items():
    package, message = kind.split("/")
    best_effort = message in ("Image", "PointCloud2")
    qos = qos_profile_sensor_data if best_effort else QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
    type_ = getattr(import_module(f"{package}.msg"), message)
    node.create_subscription(type_, name, lambda told, name=name: heard.__setitem__(name, told), qos)
joints = node.create_publisher(JointState, "/joint_states", 10)
end = time.monotonic() + 90
while len(heard) < len(topics) and time.monotonic() < end:
    told = JointState(name=["wrist"], position=[0.75])
    told.header.stamp = node.get_clock().now().to_msg()
    joints.publish(told)
    rclpy.spin_once(node, timeout_sec=0.05)
known = {name: kinds for name, kinds in node.get_topic_names_and_types() if name.startswith("/ohmskin")}
hashes = {name: str(node.get_publishers_info_by_topic(name)[0].topic_type_hash) for name in known}
image, wrench = heard.get("/ohmskin/image"), heard.get("/ohmskin/wrench")
print(json.dumps({
    "heard": sorted(heard),
    "known": known,
    "hashes": hashes,
    "image": image and [image.encoding, image.width, image.height, image.header.frame_id, len(image.data)],
    "wrench": wrench and [wrench.header.frame_id, wrench.wrench.force.z],
}))  # fmt: skip
