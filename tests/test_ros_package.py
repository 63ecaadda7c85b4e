"""The ROS 2 package that starts a skin, held against what there is; ROS 2 itself is neither needed nor tried."""

import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
from command_line import ohmskin
from test_publish import PUBLISHED

yaml = pytest.importorskip("yaml")

PACKAGE = Path(__file__).parents[1] / "ros" / "ohmskin_ros"
SCRIPTS = {path.name: path.read_text(encoding="utf-8") for path in sorted((PACKAGE / "scripts").iterdir())}
RVIZ = {
    "PointCloud2": "sensor_msgs/msg/PointCloud2",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "Wrench": "geometry_msgs/msg/WrenchStamped",
    "Image": "sensor_msgs/msg/Image",
}


def launched(monkeypatch: pytest.MonkeyPatch, **given: str) -> list[Any]:
    """What the launch file starts, told by stand-ins for the few classes of `launch` that it uses."""

    def note(**settings: Any) -> SimpleNamespace:
        return SimpleNamespace(**settings)

    class Configuration:
        def __init__(self, name: str) -> None:
            self.name = name

        def perform(self, context: dict[str, str]) -> str:
            return context[self.name]

    parts: dict[str, dict[str, Any]] = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {
            "DeclareLaunchArgument": lambda name, **rest: note(name=name, **rest),
            "ExecuteProcess": note,
            "OpaqueFunction": note,
        },
        "launch.substitutions": {"LaunchConfiguration": Configuration},
        "launch_ros": {},
        "launch_ros.actions": {"Node": note},
    }
    for name, members in parts.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    file = PACKAGE / "launch" / "skin.launch.py"
    described: dict[str, Any] = {"__file__": str(file)}
    exec(compile(file.read_text(encoding="utf-8"), str(file), "exec"), described)
    *declared, opaque = described["generate_launch_description"]()
    return list(opaque.function({one.name: one.default_value for one in declared} | given))


def test_the_launch_file_starts_the_skin_with_options_that_there_are(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (process,) = launched(monkeypatch)
    assert process.cmd[:2] == ["ohmskin", "live"]
    known = set(re.findall(r"--[a-z-]+", ohmskin("live", "--help").stdout))
    assert {word for word in process.cmd if word.startswith("--")} <= known
    assert process.cmd[-3:] == ["--publish", "dds", "--headless"]
    (tmp_path / "robot.urdf").write_text("<robot name='r'/>")
    (tmp_path / "own.yaml").write_text("publish: [zenoh, foxglove]\nheadless: false\nseconds: 2.5\n")
    given = {"params": str(tmp_path / "own.yaml"), "urdf": str(tmp_path / "robot.urdf")}
    process, commands, state, rviz = launched(monkeypatch, rviz="true", commands="true", **given)
    assert commands.parameters == [{"skins": ["skin"]}]
    assert process.cmd[2:] == ["--publish", "zenoh", "--publish", "foxglove", "--seconds", "2.5"]
    assert state.parameters == [{"robot_description": "<robot name='r'/>"}]
    assert Path(rviz.arguments[1]).is_file()


def test_rviz_shows_topics_that_there_are_with_their_types_and_qos() -> None:
    shown = yaml.safe_load((PACKAGE / "rviz" / "skin.rviz").read_text(encoding="utf-8"))
    displays = {d["Class"].split("/")[1]: d for d in shown["Visualization Manager"]["Displays"]}
    for kind, message in RVIZ.items():
        topic = displays[kind]["Topic"]
        assert PUBLISHED[topic["Value"]] == message
        sensor_data = kind in ("PointCloud2", "Image")  # best effort, as they are published
        assert topic["Reliability Policy"] == ("Best Effort" if sensor_data else "Reliable")


def test_the_package_installs_and_names_what_it_uses() -> None:
    needs = {e.text for e in ElementTree.parse(PACKAGE / "package.xml").getroot().iter("exec_depend")}
    launch = (PACKAGE / "launch" / "skin.launch.py").read_text(encoding="utf-8")
    used = set(re.findall(r'package="(\w+)"', launch)) | set(re.findall(r"^from (launch\w*)", launch, re.MULTILINE))
    for script in SCRIPTS.values():
        used |= set(re.findall(r"^(?:from|import) (rclpy|std_srvs|ohmskin_msgs)", script, re.MULTILINE))
    assert used - {"ohmskin_ros"} <= needs
    build = (PACKAGE / "CMakeLists.txt").read_text(encoding="utf-8")
    installed = re.findall(r"install\(DIRECTORY (.*) DESTINATION", build)[0].split()
    assert sorted([*installed, "scripts"]) == sorted(path.name for path in PACKAGE.iterdir() if path.is_dir())
    programs = re.findall(r"install\(PROGRAMS (.*) DESTINATION lib/", build)[0].split()
    assert programs == [f"scripts/{name}" for name in SCRIPTS]
    assert set(re.findall(r'executable="(\w+\.py)"', launch)) == set(SCRIPTS)
