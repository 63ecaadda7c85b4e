"""Topics, types and messages as others know them, who share no code with us."""

import json
import re
import time
from collections import defaultdict
from typing import Any

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ohmskin.outlets.topics import contacts_topic

PUBLISHED = {
    "/ohmskin/contacts": "ohmskin_msgs/msg/Contacts",
    "/ohmskin/markers": "visualization_msgs/msg/MarkerArray",
    "/ohmskin/wrench": "geometry_msgs/msg/WrenchStamped",
    "/ohmskin/image": "sensor_msgs/msg/Image",
    "/ohmskin/points": "sensor_msgs/msg/PointCloud2",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


class Ears:
    """A zenoh subscriber to everything, which knows nothing of ohmskin but the layout that rmw_zenoh documents."""

    def __init__(self, place: str, domain: int = 0) -> None:
        import zenoh

        config = zenoh.Config()
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("connect/endpoints", json.dumps([place]))
        config.insert_json5("listen/endpoints", "[]")
        self.heard: dict[str, list[tuple[bytes, bytes, int]]] = defaultdict(list)
        self.session = zenoh.open(config)
        topics = (f"{domain}/ohmskin/**", f"{domain}/diagnostics/**")
        self.subscribers = [self.session.declare_subscriber(topic, self.take) for topic in topics]

    def take(self, sample: Any) -> None:
        self.heard[str(sample.key_expr)].append(
            (sample.payload.to_bytes(), sample.attachment.to_bytes(), time.time_ns())
        )

    def of(self, name: str) -> list[tuple[bytes, bytes, int]]:
        return next((messages for key, messages in dict(self.heard).items() if name in key.split("/")), [])


@pytest.fixture(scope="module")
def store() -> Any:
    """ROS 2's own types, and ours as a ROS 2 tool reads them from the definition that is published."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for part in re.split(r"={80}\n", contacts_topic("skin").definition):
        head, _, rest = part.partition("\n")
        name = (
            head.removeprefix("MSG: ").replace("/", "/msg/")
            if head.startswith("MSG: ")
            else "ohmskin_msgs/msg/Contacts"
        )
        if name.startswith("ohmskin_msgs"):
            types |= get_types_from_msg(rest if head.startswith("MSG: ") else part, name)
    store.register(types)
    return store
