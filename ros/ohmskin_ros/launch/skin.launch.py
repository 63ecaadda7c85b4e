"""Starts a skin, and RViz and the robot's description if wanted.

ros2 launch ohmskin_ros skin.launch.py params:=my_skin.yaml rviz:=true urdf:=robot.urdf
"""

from pathlib import Path

import yaml
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SHARE = Path(__file__).resolve().parents[1]
NEGATIVES = ("browser", "demo")  # options of `ohmskin live` that have a negative form
ARGUMENTS = {
    "params": (str(SHARE / "config" / "skin.yaml"), "Options of `ohmskin live`, a YAML file."),
    "ohmskin": ("ohmskin", "The command, such as the one of a virtual environment."),
    "commands": ("false", "Whether to offer services to tare the skin and to change its mode."),
    "rviz": ("false", "Whether to show it in RViz."),
    "urdf": ("", "File of the robot's description, for RViz and tf; none for a skin alone."),
}


def actions(context):
    """What to start, by the arguments as given."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    options = yaml.safe_load(Path(given["params"]).read_text(encoding="utf-8")) or {}
    if not isinstance(options, dict):
        raise ValueError(f"{given['params']} has no options; need lines such as `name: left_arm`")
    options = {name: value for name, value in options.items() if value is not None}
    command = [given["ohmskin"], "live"]
    for name, value in options.items():
        for one in value if isinstance(value, list) else [value]:
            flag = name.replace("_", "-")
            if one is False:
                command += [f"--no-{flag}"] * (name in NEGATIVES)
            else:
                command += [f"--{flag}"] if one is True else [f"--{flag}", str(one)]
    started = [ExecuteProcess(cmd=command, output="screen")]
    if given["commands"].lower() == "true":
        told = {"skins": [str(options.get("name", "skin"))]}
        started.append(Node(package="ohmskin_ros", executable="commands.py", parameters=[told], output="screen"))
    if given["urdf"]:
        told = {"robot_description": Path(given["urdf"]).read_text(encoding="utf-8")}
        started.append(Node(package="robot_state_publisher", executable="robot_state_publisher", parameters=[told]))
    if given["rviz"].lower() == "true":
        config = str(SHARE / "rviz" / "skin.rviz")
        started.append(Node(package="rviz2", executable="rviz2", arguments=["-d", config]))
    return started


def generate_launch_description():
    """What ROS 2's launch calls."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=told)
        for name, (default, told) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=actions)])
