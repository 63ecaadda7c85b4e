"""A node of ROS 2 itself (rclpy on Fast DDS) hears what is published over DDS, and its joint states are heard.

It runs in an environment of its own (`make .venv-ros/.ready`), as ROS 2's packages are none that tests should import.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from ros_listener import PUBLISHED
from waiting import until

from ohmskin.child import Child
from ohmskin.client.board import BoardReader
from ohmskin.outlets.joints import JointsProcess
from ohmskin.outlets.topics import Topic
from ohmskin.skin import Calibration, Skin

PYTHON = Path(__file__).parents[1] / ".venv-ros" / "bin" / "python"
OWN = "/ohmskin/contacts"  # of a type that ROS 2 does not bring: seen, but not subscribed to


@pytest.fixture
def live(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """`ohmskin live` with a calibrated skin that a demonstration finger presses, in a domain of its own."""
    if not PYTHON.exists():
        (pytest.fail if os.environ.get("CI") else pytest.skip)("needs a node of ROS 2: make .venv-ros/.ready")
    monkeypatch.setenv("ROS_DOMAIN_ID", "83")
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))
    skin, layer = Skin.load("paper"), Skin.load("paper").contact_layer
    known = Calibration(layer_conductance=layer.conductance, layer_exponent=layer.exponent)
    file = tmp_path / "calibrated.toml"
    file.write_text(replace(skin, calibration=known).dump(), encoding="utf-8")
    command = [sys.executable, "-m", "ohmskin", "live", "--headless", "--mode", "16O", "--publish", "dds"]
    child = Child([*command, "--skin", str(file)], "the skin", stderr=subprocess.STDOUT)
    with ExitStack() as stack:
        stack.callback(child.close)
        stack.callback(child.process.terminate)
        yield


@pytest.mark.usefixtures("live")
def test_a_node_hears_every_topic_and_is_heard() -> None:
    topics = [f"{name}={kind.replace('/msg/', '/')}" for name, kind in PUBLISHED.items() if name != OWN]
    local = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PYTHONPATH": ""}
    node = Child([str(PYTHON), str(Path(__file__).with_name("ros_node.py")), *topics], "a node", environment=local)
    with JointsProcess("torso", ["wrist"], "dds", "/joint_states", None), BoardReader("torso.joints") as joints:
        positions = json.loads(until(joints.newest))["positions"]
        told: dict[str, Any] = json.loads(node.stdout.readline())
    node.close()
    assert positions == {"wrist": 0.75}
    assert set(told["heard"]) == set(PUBLISHED) - {OWN}
    published = {name: kind for name, kind in PUBLISHED.items() if name.startswith("/ohmskin")}
    assert told["known"] == {name: [kind] for name, kind in published.items()}
    assert told["hashes"] == {name: Topic(name, kind, True, 1).hash for name, kind in published.items()}
    assert told["image"] == ["32FC1", 64, 64, "skin", 4 * 64 * 64]
    assert told["wrench"][0] == "skin"
    assert told["wrench"][1] <= 0  # into the skin, where it is pressed
