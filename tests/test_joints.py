"""Joint states of ROS 2, heard over zenoh and DDS, and passed on to the board of a body."""

import json
import math
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from waiting import until

from ohmskin.body import Body
from ohmskin.client.board import BoardReader
from ohmskin.client.joints import JointStates
from ohmskin.client.remote import data_key, domain, open_session
from ohmskin.errors import PublishError
from ohmskin.outlets.joints import JointMerger, JointsProcess
from ohmskin.outlets.topics import dds_name

STORE = get_typestore(Stores.ROS2_JAZZY)
KIND = "sensor_msgs/msg/JointState"
JOINTS = ("elbow", "wrist")


@pytest.fixture(autouse=True)
def boards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[BoardReader]:
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))
    reader = BoardReader("torso.joints")
    yield reader
    reader.close()


def message(names: list[str], positions: list[float], stamp: float | None = None) -> bytes:
    """As ROS 2 writes it, by code that shares nothing with ours."""
    types = STORE.types
    at = time.time() if stamp is None else stamp
    when = types["builtin_interfaces/msg/Time"](sec=int(at), nanosec=int(at % 1 * 1e9))
    header = types["std_msgs/msg/Header"](stamp=when, frame_id="base")
    numbers = np.array(positions)
    state = types[KIND](header=header, name=names, position=numbers, velocity=np.zeros(0), effort=np.zeros(0))
    return bytes(STORE.serialize_cdr(state, KIND))


def received(reader: BoardReader) -> dict[str, Any] | None:
    record = reader.newest()
    return None if record is None else json.loads(record)


@pytest.fixture
def merger() -> Iterator[JointMerger]:
    with JointStates("torso") as states:
        yield JointMerger(states, JOINTS)


def test_positions_of_the_bodys_joints_are_passed_on_whoever_tells_them(
    merger: JointMerger, boards: BoardReader
) -> None:
    begin = time.monotonic()
    merger.take(message(["wheel", "elbow"], [7.0, -1.25], time.time() - 1.0))
    first = received(boards)
    assert first is not None
    assert first["positions"] == {"elbow": -1.25}
    assert 1.0 <= time.monotonic() - first["time"] < 5.0
    merger.take(message(["wrist"], [0.5]))  # another publisher's
    second = received(boards)
    assert second is not None
    assert second["positions"] == {"elbow": -1.25, "wrist": 0.5}
    took = time.monotonic() - begin  # within which a busy machine may look at its clocks
    assert second["time"] == pytest.approx(first["time"], abs=took)  # all are as old as the oldest


@pytest.mark.parametrize("ahead", [-1e9, -1e3, 1.0, 1e5])
def test_a_stamp_of_another_clock_is_not_believed(merger: JointMerger, boards: BoardReader, ahead: float) -> None:
    """Such as the time of a simulation: what has just come is new."""
    merger.take(message(["elbow"], [0.1], max(time.time() + ahead, 0.0)))
    found = received(boards)
    assert found is not None
    assert time.monotonic() - found["time"] < 5.0


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "CDR"),
        (message(["elbow"], [0.5], 1.0)[:-20], "ends early"),
        (message(["elbow", "wrist"], [0.5], 1.0), "2 joints and 1 positions"),
        (message(["elbow"], [math.nan], 1.0), "'elbow' is at nan"),
        (b"\0\1\0\0" + bytes(8) + b"\1\0\0\0\0\0\0\0\xff\xff\xff\xff", "entries, which do not fit"),
    ],
    ids=["nothing", "cut", "lengths", "no number", "count"],
)
def test_what_makes_no_sense_is_told_once_and_not_used(
    content: bytes, words: str, merger: JointMerger, boards: BoardReader, caplog: pytest.LogCaptureFixture
) -> None:
    merger.take(content)
    merger.take(content)
    assert received(boards) is None
    assert caplog.text.count(words) == 1
    merger.take(message(["elbow"], []))  # velocities alone, say
    assert received(boards) is None
    merger.take(message(["elbow"], [0.5]))
    assert received(boards) is not None


def test_messages_that_are_wrong_in_ever_new_ways_do_not_fill_the_log(
    merger: JointMerger, caplog: pytest.LogCaptureFixture
) -> None:
    for wrong in (math.nan, math.inf, -math.inf):
        merger.take(message(["elbow"], [wrong]))
    assert caplog.text.count("joint states are ignored") == 1


def test_nodes_are_heard_over_zenoh(boards: BoardReader) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with JointsProcess("torso", JOINTS, f"zenoh:listen/{place}", "/joint_states", None) as process:
        assert process.address == f"zenoh:listen/{place}"
        session = open_session(place, False, None)
        try:
            key = data_key("/joint_states", dds_name("sensor_msgs/JointState"), STORE.hash_rihs01(KIND))
            put = session.declare_publisher(key)

            def heard() -> dict[str, Any] | None:
                put.put(message(["elbow", "wrist"], [-1.5, 0.25]))
                return received(boards)

            assert until(heard)["positions"] == {"elbow": -1.5, "wrist": 0.25}
        finally:
            session.close()
    with pytest.raises(PublishError, match="can be reached from other machines"):
        JointsProcess("torso", JOINTS, "zenoh:listen/tcp/0.0.0.0:7447", "/joint_states", None)
    with JointStates("torso"), pytest.raises(PublishError, match=r"torso\.joints"):
        JointsProcess("torso", JOINTS, f"zenoh:listen/{place}", "/joint_states", None)


@pytest.mark.parametrize("reliable", [True, False])
def test_nodes_are_heard_over_dds(boards: BoardReader, reliable: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.idl import make_idl_struct, types
    from cyclonedds.pub import DataWriter
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    from ohmskin.outlets.dds import Domain, domain_config

    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    many: Any = types
    stamp = make_idl_struct("T", "builtin_interfaces::msg::dds_::Time_", {"sec": types.int32, "nanosec": types.uint32})
    header = make_idl_struct("H", "std_msgs::msg::dds_::Header_", {"stamp": stamp, "frame_id": str})
    doubles = dict.fromkeys(("position", "velocity", "effort"), many.sequence[types.float64])
    fields = {"header": header, "name": many.sequence[str], **doubles}
    state = make_idl_struct("J", "sensor_msgs::msg::dds_::JointState_", fields)
    held = Domain(domain(), domain_config("lo")), DomainParticipant(domain())
    participant = held[1]
    qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)) if reliable else Policy.Reliability.BestEffort)
    writer = DataWriter(participant, Topic(participant, "rt/arm/joint_states", state), qos)
    with JointsProcess("torso", JOINTS, "dds", "arm/joint_states", None) as process:
        assert process.address == "dds:lo"

        def heard() -> dict[str, Any] | None:
            now = time.time()
            head = header(stamp=stamp(sec=int(now), nanosec=0), frame_id="")
            writer.write(state(header=head, name=["wrist"], position=[0.75], velocity=[], effort=[]))
            return received(boards)

        assert until(heard)["positions"] == {"wrist": 0.75}


def test_only_zenoh_and_dds_and_bodies_with_joints_can_be_heard() -> None:
    with pytest.raises(PublishError, match="choose from zenoh and dds"):
        JointsProcess("torso", JOINTS, "foxglove", "/joint_states", None)


def test_a_body_follows_them(tmp_path: Path) -> None:
    """As `ohmskin patches --joints` does: the page and the contacts then know where the links are."""
    from ohmskin.body.patches import Patches
    from ohmskin.client.joints import LinkPoses

    urdf = """<robot name="r"><link name="base"/><link name="forearm"/><joint name="elbow" type="revolute">
        <parent link="base"/><child link="forearm"/><axis xyz="0 0 1"/></joint></robot>"""
    (tmp_path / "robot.urdf").write_text(urdf)
    patch = '[[patch]]\nname = "front"\nlink = "forearm"\ndevice = "replay:nosuch.mcap"\n'
    (tmp_path / "body.toml").write_text(f'name = "torso"\nurdf = "robot.urdf"\n{patch}')
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    said: list[str] = []
    body = Body.load(tmp_path / "body.toml")
    with Patches(body, joints=f"zenoh:listen/{place}", report=said.append) as patches, LinkPoses("torso") as poses:
        assert f"receiving joint states at zenoh:listen/{place}, /joint_states" in said
        session = open_session(place, False, None)
        try:
            put = session.declare_publisher(data_key("/joint_states", dds_name("sensor_msgs/JointState"), "RIHS01_0"))

            def posed() -> bool:
                put.put(message(["elbow"], [math.pi / 2]))
                patches.step()
                return bool(poses.newest())

            until(posed)
        finally:
            session.close()
        np.testing.assert_allclose(np.reshape(poses.newest()["forearm"], (4, 4))[:2, :2], [[0, -1], [1, 0]], atol=1e-9)
    (tmp_path / "body.toml").write_text(f'name = "torso"\n{patch}')
    with pytest.raises(PublishError, match="URDF file"):
        Patches(Body.load(tmp_path / "body.toml"), joints="zenoh")
