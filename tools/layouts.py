"""Makes the layouts of RViz and Foxglove for a body: its URDF file, points, markers, wrenches, and where its links are.

.venv/bin/python tools/layouts.py examples/humanoid/body.toml    writes body.rviz and foxglove-layout.json beside it
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ohmskin.body import Body
from ohmskin.client.remote import prefix
from ohmskin.outlets.topics import wrench_topic

_FULL = 0.5  # relative change of conductivity of the brightest colour


def topics(body: Body) -> tuple[dict[str, str], dict[str, str]]:
    """The topics with the points of each patch, and with the wrench on each link that has one."""
    points = {placed.patch.name: f"{prefix(body.name)}/{placed.patch.name}/points" for placed in body.patches}
    links = list(dict.fromkeys(placed.patch.frame for placed in body.patches if placed.patch.newtons))
    return points, {link: wrench_topic(body.name, link, links).name for link in links}


def rviz(body: Body, path: Path, urdf: str) -> str:
    """RViz's configuration. Each display is written in full: its reader knows no merged keys."""
    assert body.robot is not None
    points, wrenches = topics(body)

    def topic(name: str, reliability: str) -> dict[str, Any]:
        return {"Value": name, "Depth": 10, "Reliability Policy": reliability, "Durability Policy": "Volatile"}

    cloud = {"Class": "rviz_default_plugins/PointCloud2", "Enabled": True, "Color Transformer": "Intensity"}
    cloud |= {"Channel Name": "change", "Use rainbow": True, "Autocompute Intensity Bounds": False}
    cloud |= {"Min Intensity": 0, "Max Intensity": _FULL, "Style": "Points", "Size (Pixels)": 4}
    robot = {"Class": "rviz_default_plugins/RobotModel", "Name": "Robot", "Enabled": True, "Alpha": 0.6}
    displays = [
        robot | {"Description Source": "File", "Description File": urdf},
        {"Class": "rviz_default_plugins/MarkerArray", "Name": "Contacts", "Enabled": True}
        | {"Topic": topic(f"{prefix(body.name)}/markers", "Reliable")},
        *(cloud | {"Name": name, "Topic": topic(path, "Best Effort")} for name, path in points.items()),
        *(
            {"Class": "rviz_default_plugins/Wrench", "Name": f"Wrench on {link}", "Enabled": True}
            | {"Force Arrow Scale": 0.02, "Torque Arrow Scale": 0.2, "Topic": topic(path, "Reliable")}
            for link, path in wrenches.items()
        ),
    ]
    x, y, z = middle(body)
    view = {"Class": "rviz_default_plugins/Orbit", "Distance": 1.6, "Focal Point": {"X": x, "Y": y, "Z": z}}
    manager = {
        "Class": "",
        "Displays": displays,
        "Global Options": {"Fixed Frame": body.robot.root, "Background Color": "48; 48; 48"},
        "Tools": [{"Class": "rviz_default_plugins/MoveCamera"}],
        "Views": {"Current": view | {"Pitch": 0.3, "Yaw": 0.8}},
    }
    panels = [{"Class": "rviz_common/Displays", "Name": "Displays"}]
    text = yaml.safe_dump({"Panels": panels, "Visualization Manager": manager}, sort_keys=False)
    start = f"rviz2 -d {path.name} --ros-args -r /tf:={prefix(body.name)}/tf"
    return f"# {start}      (in this folder, beside ohmskin patches body.toml --publish zenoh)\n{text}"


def foxglove(body: Body) -> str:
    """Foxglove's layout: the robot in space, and its contacts as text."""
    assert body.robot is not None
    points, wrenches = topics(body)
    cloud = {"visible": True, "colorField": "change", "colorMode": "colormap", "colorMap": "turbo"}
    cloud |= {"pointSize": 4, "minValue": 0, "maxValue": _FULL}
    shown: dict[str, Any] = dict.fromkeys(points.values(), cloud)
    shown |= {path: {"visible": True} for path in (*wrenches.values(), *(f"{prefix(body.name)}/{k}" for k in _ALL))}
    camera = {"perspective": True, "distance": 1.6, "phi": 75, "thetaOffset": 60, "targetOffset": middle(body)}
    camera |= {"target": [0, 0, 0], "targetOrientation": [0, 0, 0, 1], "fovy": 45, "near": 0.01, "far": 50}
    urdf = {"visible": True, "frameLocked": True, "label": "robot", "instanceId": "robot", "layerId": "foxglove.Urdf"}
    urdf |= {"sourceType": "filePath", "filePath": "", "framePrefix": "", "order": 1, "displayMode": "visual"}
    space, raw = f"3D!{body.name}", f"RawMessages!{body.name}"
    scene = {"cameraState": camera, "followMode": "follow-none", "followTf": body.robot.root, "topics": shown}
    panels = {space: scene | {"layers": {"robot": urdf}}, raw: {"topicPath": f"{prefix(body.name)}/contacts"}}
    parts = {"first": space, "second": raw, "direction": "row", "splitPercentage": 75}
    empty: dict[str, Any] = {"globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return json.dumps({"configById": panels, **empty, "layout": parts}, indent=1) + "\n"


_ALL = ("markers", "tf")


def middle(body: Body) -> list[float]:
    """The middle of the robot in the frame of its root link (m)."""
    assert body.robot is not None
    places = np.array([pose[:3, 3] for pose in body.robot.links.values()])
    return [round(float(value), 2) for value in (places.min(axis=0) + places.max(axis=0)) / 2]


def main() -> None:
    """Write both files."""
    path = Path(sys.argv[1])
    body = Body.load(path)
    target = path.with_suffix(".rviz")
    target.write_text(rviz(body, target, "robot.urdf"), encoding="utf-8")
    path.with_name("foxglove-layout.json").write_text(foxglove(body), encoding="utf-8")


if __name__ == "__main__":
    main()
