"""The ROS 2 package that starts a skin, held against what there is; ROS 2 itself is neither needed nor tried."""

import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
from command_line import ohmskin
from test_publish import PUBLISHED

from ohmskin.errors import PublishError

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


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", []),
        ("seconds:\nname:\n", []),
        ("browser: false\ndemo: false\njson: false\n", ["--no-browser", "--no-demo"]),
        ("demo: true\nprior: paper\n", ["--demo", "--prior", "paper"]),
    ],
)
def test_options_that_are_off_or_empty_are_given_as_such(
    text: str, words: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "own.yaml").write_text(text)
    process, commands = launched(monkeypatch, commands="true", params=str(tmp_path / "own.yaml"))
    assert process.cmd == ["ohmskin", "live", *words]
    assert commands.parameters == [{"skins": ["skin"]}]
    negative = set(re.findall(r"--no-[a-z-]+", ohmskin("live", "--help").stdout))
    assert negative == {"--no-browser", "--no-demo"}  # those that the launch file knows


def test_a_file_of_options_that_has_none_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text("name\n")
    with pytest.raises(ValueError, match=r"own\.yaml has no options; need lines such as"):
        launched(monkeypatch, params=str(tmp_path / "own.yaml"))


class Ros:
    """Stand-ins for the few classes of ROS 2 that the node of services uses.

    Args:
        monkeypatch: Takes them back.
        skins: The parameter as it is given; an error is raised.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, skins: Any) -> None:
        self.services: dict[str, Any] = {}
        self.offered: list[str] = []
        self.groups: dict[str, Any] = {}
        self.threads = 0
        error = type("ParameterException", (Exception,), {})

        def declare(_: str, __: list[str]) -> SimpleNamespace:
            if isinstance(skins, str):
                raise error(skins)
            return SimpleNamespace(value=skins)

        def service(_: Any, name: str, answer: Any, callback_group: Any = None) -> None:
            self.services[name], self.groups[name] = answer, callback_group
            self.offered.append(name)

        def executor(num_threads: int) -> SimpleNamespace:
            self.threads = num_threads
            return SimpleNamespace(add_node=lambda _: None, spin=lambda: None)

        node = SimpleNamespace(declare_parameter=declare, create_service=service)
        parts: dict[str, dict[str, Any]] = {
            "rclpy": {"init": lambda: None, "spin": lambda _: None},
            "rclpy.callback_groups": {"MutuallyExclusiveCallbackGroup": object},
            "rclpy.exceptions": {"ParameterException": error},
            "rclpy.executors": {"ExternalShutdownException": KeyError, "MultiThreadedExecutor": executor},
            "rclpy.node": {"Node": lambda _: node},
            "ohmskin_msgs": {},
            "ohmskin_msgs.srv": {"SetMode": object},
            "std_srvs": {},
            "std_srvs.srv": {"Trigger": object},
        }
        for name, members in parts.items():
            module = ModuleType(name)
            vars(module).update(members)
            monkeypatch.setitem(sys.modules, name, module)
        self.main = runpy.run_path(str(PACKAGE / "scripts" / "commands.py"))["main"]


def test_services_are_in_the_namespace_of_the_node_and_offered_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))
    ros = Ros(monkeypatch, ["skin", "skin"])
    ros.main()
    assert ros.offered == ["ohmskin/tare", "ohmskin/set_mode"]  # names without a slash in front are relative


def test_a_silent_skin_does_not_keep_the_services_of_others_waiting(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))
    ros = Ros(monkeypatch, ["skin", "torso.left"])
    ros.main()
    prefixes = ("ohmskin", "ohmskin/torso/left")
    assert sorted(ros.services) == sorted(f"{prefix}/{what}" for prefix in prefixes for what in ("tare", "set_mode"))
    first, second = ({id(ros.groups[f"{prefix}/{what}"]) for what in ("tare", "set_mode")} for prefix in prefixes)
    assert len(first) == len(second) == 1
    assert first != second
    assert ros.threads > 2
    monkeypatch.setattr(
        "ohmskin.client.Commands.set_mode", lambda skin, mode: (_ for _ in ()).throw(PublishError(mode))
    )
    told = ros.services["ohmskin/set_mode"](SimpleNamespace(mode="16Z"), SimpleNamespace())
    assert (told.success, told.message) == (False, "16Z")


@pytest.mark.parametrize(
    ("skins", "why"), [(None, "it is empty"), ("of type 'INTEGER'", "of type 'INTEGER'"), (["bad name"], "'bad name")]
)
def test_a_parameter_that_names_no_skins_is_told_in_one_line(
    skins: Any, why: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))
    with pytest.raises(SystemExit) as told:
        Ros(monkeypatch, skins).main()
    assert str(told.value).startswith("the parameter `skins` must be a list of names of skins")
    assert why in str(told.value)
    assert "\n" not in str(told.value)


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
