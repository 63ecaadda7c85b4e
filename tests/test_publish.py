"""Publishing: readers that share no code with us read what was felt, and the loop never waits for any of them."""

import json
import math
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import command_line
import numpy as np
import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros_listener import PUBLISHED, Ears
from ros_listener import store as store
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from waiting import until

import ohmskin
from ohmskin.body.body import axes
from ohmskin.cli.loop import Loop
from ohmskin.client import BoardReader, Patch, PatchState
from ohmskin.client.contacts import merged
from ohmskin.client.remote import CONTACTS_HASH, CONTACTS_TYPE, data_key, decode_contacts, domain
from ohmskin.contacts import Contact as SheetContact
from ohmskin.engine import State
from ohmskin.errors import DataError, OhmskinError, PublishError
from ohmskin.mcap.schemas import FIELD
from ohmskin.mcap.standard import encode_image, encode_markers
from ohmskin.outlets.messages import (
    encode_cloud,
    encode_contacts,
    encode_wrench,
)
from ohmskin.outlets.outlet import KINDS, open_outlet
from ohmskin.outlets.process import wrenches
from ohmskin.outlets.publisher import Publisher
from ohmskin.outlets.relay import RelayProcess
from ohmskin.outlets.topics import TEXTS, Topic, contacts_topic, wrench_topic
from ohmskin.skin import Skin

STAMP = 1_700_000_000_123_456_789
PATCH = Patch("arm", "forearm_link", (0.1, 0.2, 0.3), axes(0.3, -0.4, 1.1), newtons=True)
ON_SHEET = SheetContact(
    (0.05, 0.12), 2e-4, 3e-4, 0.97, 0.4, 7, ((2.25e-6, 1e-7), (1e-7, 1e-6)), (0.03, -0.02), 8e-3, 5.0, 0.4, 2e4, 2.5e-4
)
CONTACT = PATCH.contact(ON_SHEET)
SIGHTING = PatchState("arm", "forearm_link", 41, 12.5, STAMP, "16O", 7.5)


@pytest.fixture(autouse=True)
def boards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of boards of one's own."""
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))


# --- types ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(PUBLISHED.values()))
def test_types_are_known_to_others_by_the_same_hash(name: str, store: Any) -> None:
    assert Topic("/any", name, True, 1).hash == store.hash_rihs01(name)


def test_a_hash_is_the_one_that_ros_itself_publishes() -> None:
    # as `ros2 topic info --verbose` prints it
    assert Topic("/any", "sensor_msgs/msg/Image", True, 1).hash.endswith(
        "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
    )


@pytest.mark.parametrize("kind", sorted(TEXTS))
def test_the_fields_of_a_definition_are_those_that_others_read(kind: str) -> None:
    name = kind.replace("/", "/msg/")
    _, theirs = get_types_from_msg(TEXTS[kind], name)[name]
    read = [(field, bool(many), own.replace("/", "/msg/")) for own, many, field in FIELD.findall(TEXTS[kind])]
    assert read == [(field, *described(told)) for field, told in theirs]


def described(told: Any) -> tuple[bool, str]:
    """Whether a field is a sequence, and its type, as rosbags tells it."""
    node, what = told
    if node in (Nodetype.SEQUENCE, Nodetype.ARRAY):
        return True, described(what[0])[1]
    return False, what if node == Nodetype.NAME else what[0]


# --- messages, read by rosbags ----------------------------------------------------------------------------------------


def test_contacts_are_read_field_by_field(store: Any) -> None:
    message = store.deserialize_cdr(
        encode_contacts(replace(merged(9, [SIGHTING], [CONTACT]), boot=2**63 + 5)), "ohmskin_msgs/msg/Contacts"
    )
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(STAMP, 10**9)
    assert (message.boot, message.sequence) == (2**63 + 5, 9)
    (patch,) = message.patches
    assert (patch.name, patch.frame_id, patch.sequence, patch.mode) == ("arm", "forearm_link", 41, "16O")
    assert (patch.stamp.sec, patch.stamp.nanosec) == divmod(STAMP, 10**9)
    assert message.total_force.tolist() == [7.5]
    (c,) = message.contacts
    assert (c.patch, c.id) == (0, 7)
    assert (c.position.x, c.position.y, c.position.z) == CONTACT.position
    assert (c.normal.x, c.normal.y, c.normal.z) == CONTACT.normal
    figures = (CONTACT.extent, CONTACT.strength, CONTACT.confidence, CONTACT.peak, CONTACT.radius)
    assert (c.extent, c.strength, c.confidence, c.peak, c.radius) == figures == (2e-4, 3e-4, 0.97, 0.4, 8e-3)
    assert (c.velocity.x, c.velocity.y, c.velocity.z) == CONTACT.velocity
    upper = [getattr(c, f"covariance_{pair}") for pair in ("xx", "xy", "xz", "yy", "yz", "zz")]
    assert CONTACT.covariance is not None
    assert upper == [CONTACT.covariance[i][j] for i in range(3) for j in range(i, 3)]


def test_velocity_and_covariance_turn_with_the_patch() -> None:
    turn = np.array(PATCH.axes).T[:, :2]
    assert CONTACT.velocity == pytest.approx(turn @ [0.03, -0.02])
    np.testing.assert_allclose(np.array(CONTACT.covariance), turn @ np.array(ON_SHEET.covariance) @ turn.T, atol=1e-18)
    plain = PATCH.contact(replace(ON_SHEET, velocity=None, covariance=None, radius=None))
    assert (plain.velocity, plain.covariance, plain.radius) == (None, None, None)
    assert math.isnan(plain.spread)


def test_what_is_not_known_of_a_contact_is_nan_in_a_message_and_none_again(store: Any) -> None:
    plain = replace(CONTACT, radius=None, velocity=None, covariance=None)
    data = encode_contacts(merged(9, [SIGHTING], [plain]))
    (c,) = store.deserialize_cdr(data, "ohmskin_msgs/msg/Contacts").contacts
    assert all(math.isnan(value) for value in (c.radius, c.velocity.z, c.covariance_xx, c.covariance_zz))
    assert decode_contacts(data, 0.0).contacts == (plain,)


def test_the_domain_is_that_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert data_key("/a", "T", "H") == "0/a/T/H"
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert data_key("/a", "T", "H") == "7/a/T/H"
    for wrong in ("233", "-1", "x", "²"):
        monkeypatch.setenv("ROS_DOMAIN_ID", wrong)
        with pytest.raises(PublishError, match="whole number from 0 to 232"):
            open_outlet("dds", [], "node", None)


def test_both_outlets_speak_in_the_domain_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """DDS at the UDP ports that its standard gives to a domain, zenoh in its keys."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "43")
    topic = contacts_topic("skin")
    before = {at.laddr.port for at in psutil.Process().net_connections("udp")}
    outlet: Any = open_outlet("dds", [topic], "node", None)
    ports = {at.laddr.port for at in psutil.Process().net_connections("udp")} - before
    outlet.close()
    first = 7400 + 250 * 43
    assert any(first <= port < first + 250 for port in ports)
    assert not any(7400 <= port < 7650 for port in ports)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    outlet = open_outlet(f"zenoh:listen/{place}", [topic], "node", None)
    ears = Ears(place, 43)
    try:
        data = encode_contacts(merged(1, [SIGHTING], [CONTACT]))
        until(lambda: [outlet.send(topic, STAMP, data), ears.of("contacts")][1])
    finally:
        ears.session.close()
        outlet.close()


def test_a_dds_endpoint_tells_the_hash_of_its_type() -> None:
    from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.qos import Policy

    told: list[bytes] = []

    def found() -> bool:
        seen = reader.take(N=100)
        told.extend(one.qos[Policy.Userdata].data for one in seen if one.topic_name.endswith("contacts"))
        return bool(told)

    with closing(open_outlet("dds", [contacts_topic("skin")], "node", None)):
        listener = DomainParticipant(domain())
        reader = BuiltinDataReader(listener, BuiltinTopicDcpsPublication)
        until(found)
    assert set(told) == {f"typehash={CONTACTS_HASH};".encode()}


def test_contacts_of_one_link_are_in_its_frame(store: Any) -> None:
    frames = [PatchState("a", "x"), PatchState("b", "x"), PatchState("c", "y")]
    heads = [
        store.deserialize_cdr(encode_contacts(merged(1, seen, [])), "ohmskin_msgs/msg/Contacts").header.frame_id
        for seen in (frames[:1], frames[:2], frames)
    ]
    assert heads == ["x", "x", ""]


def test_the_ros_package_has_the_messages_that_are_sent(store: Any) -> None:
    """After a change: python tools/ros_messages.py. Hashes are made of the package's files as ROS 2 reads them."""
    import xml.etree.ElementTree as ElementTree

    package = Path(__file__).parents[1] / "ros" / "ohmskin_msgs"
    files = {path.name: path.read_text(encoding="utf-8") for path in (package / "msg").iterdir()}
    own = {kind.partition("/")[2]: text for kind, text in TEXTS.items() if kind.startswith("ohmskin_msgs/")}
    assert files == {f"{name}.msg": text for name, text in own.items()}
    read = get_typestore(Stores.ROS2_JAZZY)
    read.register({k: v for name in own for k, v in get_types_from_msg(own[name], f"ohmskin_msgs/msg/{name}").items()})
    assert read.hash_rihs01("ohmskin_msgs/msg/Contacts") == CONTACTS_HASH
    used = {other for text in own.values() for other in re.findall(r"^(\w+)/\w+", text, re.MULTILINE)}
    told = ElementTree.fromstring((package / "package.xml").read_text(encoding="utf-8"))
    depends = {entry.text for entry in told.findall("depend")}
    assert depends == used - {"ohmskin_msgs"}
    assert told.findtext("version") == ohmskin.__version__.removesuffix(".dev0")  # package.xml takes three numbers only
    build = (package / "CMakeLists.txt").read_text(encoding="utf-8")
    assert set(re.findall(r"find_package\((\w+)", build)) == depends | {"ament_cmake", "rosidl_default_generators"}


def test_the_client_listens_where_contacts_are_sent() -> None:
    topic = contacts_topic("skin")
    assert (topic.dds_type, topic.hash) == (CONTACTS_TYPE, CONTACTS_HASH)


def test_contacts_recorded_before_there_were_total_forces_are_read() -> None:
    message = encode_contacts(merged(3, [SIGHTING], [CONTACT]))
    before = decode_contacts(message[:-16], offset=0.0)  # their count, padding, and the one number, less
    assert before.contacts == (CONTACT,)
    assert before.patches[0].total_force is None


def test_contacts_come_back_as_they_went() -> None:
    silent = PatchState("hand", "palm_link")
    what = replace(
        merged(3, [SIGHTING, silent], [CONTACT, replace(CONTACT, patch="hand", frame="palm_link", id=8)]), boot=77
    )
    back = decode_contacts(encode_contacts(what), offset=12.5 - STAMP * 1e-9)
    assert back.contacts == what.contacts
    assert (back.boot, back.sequence, back.stamp, back.age) == (77, 3, 0, math.inf)
    assert back.patches[1] == silent
    assert back.patches[0].total_force == 7.5
    assert back.patches[0].time == pytest.approx(12.5, abs=1e-3)  # a double of seconds since 1970 has no more


@given(st.binary(max_size=300))
def test_bytes_that_are_no_contacts_give_one_error(data: bytes) -> None:
    good = encode_contacts(merged(1, [SIGHTING], [CONTACT]))
    for candidate in (b"\0\1\0\0" + data, good[: len(data)], good[: len(data)] + data):
        with suppress(DataError):
            decode_contacts(candidate, 0.0)


def test_a_contact_of_a_patch_that_the_message_does_not_name_is_refused() -> None:
    data = encode_contacts(merged(1, [SIGHTING], [replace(CONTACT, id=123456789)]))
    own, strange = (struct.pack("<Ii", patch, 123456789) for patch in (0, 1))
    assert data.count(own) == 1
    with pytest.raises(DataError, match="a contact of patch 1 in a message of 1 patches"):
        decode_contacts(data.replace(own, strange), 0.0)


def test_an_image_is_read_in_its_own_frame(store: Any) -> None:
    message = store.deserialize_cdr(
        encode_image(np.arange(6.0).reshape(2, 3), STAMP, "forearm_link"), "sensor_msgs/msg/Image"
    )
    assert (message.header.frame_id, message.encoding, message.height, message.width) == ("forearm_link", "32FC1", 2, 3)
    assert message.data.view("<f4").tolist() == [3, 4, 5, 0, 1, 2]  # top row first


def test_points_lie_where_the_pixels_are(store: Any) -> None:
    pixels = np.array([[1.0, np.nan, 2.0], [3.0, 4.0, np.nan]])
    centres = np.array([[PATCH.place(x, y) for x in (0.0, 0.1, 0.2)] for y in (0.0, 0.1)])
    message = store.deserialize_cdr(encode_cloud(pixels, centres, PATCH.frame, STAMP), "sensor_msgs/msg/PointCloud2")
    assert message.header.frame_id == "forearm_link"
    assert [(f.name, f.offset, f.datatype, f.count) for f in message.fields] == [
        ("x", 0, 7, 1),
        ("y", 4, 7, 1),
        ("z", 8, 7, 1),
        ("change", 12, 7, 1),
    ]
    assert (message.height, message.width, message.point_step, message.row_step, message.is_dense) == (
        1,
        4,
        16,
        64,
        True,
    )
    points = message.data.view("<f4").reshape(-1, 4)
    assert points[:, 3].tolist() == [1, 2, 3, 4]
    places = [PATCH.place(*at) for at in ((0.0, 0.0), (0.2, 0.0), (0.0, 0.1), (0.1, 0.1))]
    np.testing.assert_allclose(points[:, :3], places, atol=1e-7)


def test_a_wrench_pushes_into_the_skin_where_the_contact_is(store: Any) -> None:
    message = store.deserialize_cdr(
        encode_wrench([CONTACT], "forearm_link", STAMP), "geometry_msgs/msg/WrenchStamped"
    ).wrench
    force = np.array([message.force.x, message.force.y, message.force.z])
    torque = np.array([message.torque.x, message.torque.y, message.torque.z])
    assert np.linalg.norm(force) == pytest.approx(CONTACT.force)
    assert force @ CONTACT.normal < 0
    # the work of a small turn w about the origin is the same for torque and force: w . t = (w x r) . f
    for turn in np.eye(3):
        assert turn @ torque == pytest.approx(np.cross(turn, CONTACT.position) @ force)
    other = replace(CONTACT, position=(0.3, 0.0, 0.1), force=2.0)
    both = store.deserialize_cdr(
        encode_wrench([CONTACT, other], "forearm_link", STAMP), "geometry_msgs/msg/WrenchStamped"
    ).wrench
    push = -np.array(CONTACT.normal)
    assert (both.force.x, both.force.y, both.force.z) == pytest.approx(tuple(7.0 * push))
    turn = np.cross(CONTACT.position, 5.0 * push) + np.cross(other.position, 2.0 * push)
    assert (both.torque.x, both.torque.y, both.torque.z) == pytest.approx(tuple(turn))
    none = store.deserialize_cdr(encode_wrench([], "forearm_link", STAMP), "geometry_msgs/msg/WrenchStamped").wrench
    assert (none.force.x, none.force.y, none.force.z, none.torque.x, none.torque.y, none.torque.z) == (0,) * 6


def test_markers_lie_flat_on_the_skin(store: Any) -> None:
    message = store.deserialize_cdr(encode_markers((CONTACT,), (PATCH,), STAMP), "visualization_msgs/msg/MarkerArray")
    gone, marker = message.markers
    assert gone.action == 3
    assert (marker.header.frame_id, marker.ns, marker.id, marker.type, marker.action) == (
        "forearm_link",
        "arm",
        7,
        3,
        0,
    )
    assert (marker.pose.position.x, marker.pose.position.y, marker.pose.position.z) == CONTACT.position
    turn = marker.pose.orientation
    np.testing.assert_allclose(rotate((turn.x, turn.y, turn.z, turn.w), [0, 0, 1]), PATCH.normal, atol=1e-12)
    assert math.pi * marker.scale.x**2 / 4 == pytest.approx(CONTACT.extent)


def rotate(turn: tuple[float, ...], vector: Any) -> np.ndarray:
    """A vector turned by a quaternion (x, y, z, w)."""
    axis, w, v = np.array(turn[:3]), turn[3], np.asarray(vector, float)
    return v + 2 * w * np.cross(axis, v) + 2 * np.cross(axis, np.cross(axis, v))


@given(st.tuples(*[st.floats(-3.2, 3.2)] * 3))
def test_a_marker_is_turned_as_its_patch(store: Any, angles: tuple[float, float, float]) -> None:
    patch = replace(PATCH, axes=axes(*angles))
    message = store.deserialize_cdr(encode_markers((CONTACT,), (patch,), STAMP), "visualization_msgs/msg/MarkerArray")
    turn = message.markers[1].pose.orientation
    for vector, axis in zip(np.eye(3), patch.axes, strict=True):
        np.testing.assert_allclose(rotate((turn.x, turn.y, turn.z, turn.w), vector), axis, atol=1e-12)


# --- outlets ----------------------------------------------------------------------------------------------------------


def test_the_layout_for_foxglove_shows_topics_that_there_are() -> None:
    import ohmskin.outlets.outlet

    text = Path(ohmskin.outlets.outlet.__file__).with_name("foxglove-layout.json").read_text(encoding="utf-8")
    shown = set(re.findall(r"/ohmskin/\w+", text))
    assert {"/ohmskin/points", "/ohmskin/image", "/ohmskin/contacts", "/ohmskin/markers"} <= shown <= PUBLISHED.keys()
    layout = json.loads(text)
    assert set(re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"]))) == set(layout["configById"])


@pytest.mark.skipif(not hasattr(socket, "SO_BINDTODEVICE"), reason="no such option on this system")
def test_sockets_of_dds_hear_one_interface_only() -> None:
    code = (
        "import os, socket\nfrom ohmskin.outlets.outlet import open_outlet\n"
        "from ohmskin.outlets.topics import contacts_topic\n"
        "outlet = open_outlet('dds', [contacts_topic('skin')], 'test', None)\n"
        "for entry in os.listdir('/proc/self/fd'):\n"
        "    try:\n        own = socket.socket(fileno=os.dup(int(entry)))\n    except OSError:\n        continue\n"
        "    if own.family in (socket.AF_INET, socket.AF_INET6):\n"
        "        device = own.getsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, 16)\n"
        "        print(own.getsockname()[1], device.rstrip(b'\\0').decode())\n"
        "outlet.close()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    sockets = [line.split() for line in done.stdout.splitlines()]
    assert len(sockets) >= 2, done.stderr
    assert all(entry[1:] == ["lo"] for entry in sockets), sockets


def test_dds_that_cannot_be_tied_to_an_interface_says_so_and_leaks_nothing(caplog: pytest.LogCaptureFixture) -> None:
    from ohmskin.outlets.dds import stay_on

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM), socket.socket():
        before = len(os.listdir("/proc/self/fd"))
        stay_on("nosuch0")  # refused by the system, as without the right to do so
        assert len(os.listdir("/proc/self/fd")) == before
    assert "cannot bind DDS to nosuch0" in caplog.text


def test_diagnostics_tell_once_a_second_that_the_device_is_lost(
    store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))
    engine: Any = SimpleNamespace(state=State.LOST, message="device lost: unplugged", step=lambda: None)
    going: Any = type("Going", (list,), {"listen": lambda _: None})()  # false: not stopped
    with Publisher(Skin.load("paper")) as publisher, BoardReader("skin.health") as health:
        Loop(engine, None, [], print, [publisher.lost]).run(going, 0.05)
        message = health.newest()
        (status,) = store.deserialize_cdr(message, PUBLISHED["/diagnostics"]).status
        publisher.lost("still")
        time.sleep(0.06)  # after which a reader looks again
        assert health.newest() is None
    assert (status.level, status.name, status.message) == (2, "ohmskin: skin", "device lost: unplugged")


# --- the loop does not wait -------------------------------------------------------------------------------------------


@pytest.fixture
def relay() -> Iterator[RelayProcess]:
    from ohmskin.client import Board

    with Board("skin", {"patches": []}, 1000):
        process = RelayProcess("skin", [], [], ["foxglove:127.0.0.1:0"], None, 30.0)
        try:
            yield process
        finally:
            process.close()


def test_a_wrench_is_told_of_each_link_whose_skins_all_tell_forces_and_have_been_heard_of() -> None:
    patches = [Patch(name, link, newtons=name != "d") for name, link in zip("abcde", "xxyzw", strict=True)]
    links = ["x", "y", "w"]  # d, on z, is not calibrated for force
    seen = [PatchState(name, link, 1, 0.0, STAMP) for name, link in zip("abce", "xxyw", strict=True)]
    contacts = [replace(CONTACT, patch="a", frame="x"), replace(CONTACT, patch="c", frame="y", force=None)]
    first = merged(1, [*seen[:3], PatchState("d", "z", 1, 0.0, STAMP), PatchState("e", "w")], contacts)
    known = ("x", STAMP, contacts[:1])  # of y the force is not known yet, and e was never heard of
    assert list(wrenches(first, patches, links)) == [known]
    later = merged(2, seen, contacts[:1])
    assert list(wrenches(later, patches, links)) == [(link, STAMP, contacts[: link == "x"]) for link in links]
    assert wrench_topic("arm", "x", links).name == "/ohmskin/arm/wrench/x"
    assert wrench_topic("skin", "arm/base-link", ["arm/base-link"]).name == "/ohmskin/wrench"
    assert wrench_topic("arm", "arm/base-link", ["arm/base-link", "x"]).name == "/ohmskin/arm/wrench/arm_base_link"


def test_a_stopped_publishing_process_does_not_stop_the_loop(relay: RelayProcess) -> None:
    process = psutil.Process(relay.pid)
    process.send_signal(signal.SIGSTOP)

    def many() -> None:
        for _ in range(200_000):  # three times what the pipe holds: a write that waits never comes back
            relay.wake()

    thread = threading.Thread(target=many, daemon=True)
    thread.start()
    thread.join(60)
    came_back = not thread.is_alive()
    process.send_signal(signal.SIGCONT)
    assert came_back
    assert process.is_running()


def test_a_killed_publishing_process_is_told_and_the_loop_goes_on(
    relay: RelayProcess, caplog: pytest.LogCaptureFixture
) -> None:
    process = psutil.Process(relay.pid)
    process.kill()

    def told() -> bool:
        relay.wake()
        return bool(caplog.records)

    until(told)  # the pipe breaks when the last of its threads has ended
    for _ in range(3):
        relay.wake()
    assert [record.getMessage() for record in caplog.records] == [
        "the publishing process has ended (exit status -9); the loop continues without it"
    ]


def test_the_publishing_process_ends_with_the_loop() -> None:
    code = (
        "import os, signal\nfrom ohmskin.client import Board\nfrom ohmskin.outlets.relay import RelayProcess\n"
        "b = Board('skin', {'patches': []}, 100)\n"
        "r = RelayProcess('skin', [], [], ['foxglove:127.0.0.1:0'], None, 30.0)\n"
        "print(r.pid, flush=True)\nos.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    pid = int(done.stdout)
    until(lambda: not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE, 10)


# --- mistakes ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("outlet", "says"),
    [
        ("nosuch", "choose from shm, zenoh, dds, foxglove"),
        ("shm:x", "choose from"),
        ("zenoh:udp/1.2.3.4:7447", "not a place"),
        ("zenoh:listen/tcp/127.0.0.1:99999", "not a place"),
        ("zenoh:listen/tcp/0.0.0.0:7447", "give a --token"),
        ("zenoh:listen/tcp/[::]:7447", "give a --token"),
        ("zenoh:listen/tcp/robot.example:7447", "give a --token"),
        ("dds:nosuch0", "ip link"),
        ("dds:<x>", "not a place; use dds or dds:INTERFACE"),
        ("mcap:x.txt", "not a place; use mcap:FILE.mcap"),
        ("foxglove:127.0.0.1:99999", "not a place"),
        ("foxglove:192.0.2.1:0", "cannot be served"),
        ("mcap:/nosuch/x.mcap", "No such file or directory; choose another file"),
    ],
)
def test_an_outlet_that_cannot_be_opened_says_why(outlet: str, says: str) -> None:
    with pytest.raises(PublishError, match=re.escape(says)):
        open_outlet(outlet, [contacts_topic("skin")], "test", None)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("shm", "mcap")])
def test_a_missing_extra_names_the_line_that_installs_it(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, {"zenoh": "zenoh", "dds": "cyclonedds", "foxglove": "foxglove"}[kind], None)
    with pytest.raises(PublishError, match=rf"pip install 'ohmskin\[{kind}\]'"):
        open_outlet(kind, [], "test", None)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"images": 0.0}, "above 0"),
        ({"token": "short"}, "8 to 256"),
        ({"token": "has:colon-in-it"}, "8 to 256"),
        ({"name": "../x"}, "cannot name"),
        ({"outlets": ["nosuch"]}, "choose from"),
    ],
)
def test_settings_out_of_range_are_told_and_leave_nothing_behind(settings: dict[str, Any], says: str) -> None:
    skin = Skin.load("paper")
    with pytest.raises(OhmskinError, match=re.escape(says)):
        Publisher(skin, **settings)
    Publisher(skin).close()


def test_a_wrong_outlet_gets_one_line_on_the_command_line() -> None:
    done = command_line.ohmskin("live", "--headless", "--publish", "zenoh:listen/tcp/0.0.0.0:7447")
    assert done.returncode == 2
    assert "give a --token" in done.stderr


def test_zenoh_joins_a_router_that_is_there_and_listens_if_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    import ohmskin.outlets.zenoh as outlet

    with socket.socket() as router:
        router.bind(("127.0.0.1", 0))
        monkeypatch.setattr(outlet, "PORT", router.getsockname()[1])
        where = f"tcp/127.0.0.1:{router.getsockname()[1]}"
        assert outlet.meeting_place("") == (True, where)
        router.listen()
        assert outlet.meeting_place("") == (False, where)


@given(st.tuples(st.floats(1e-8, 1), st.floats(1e-8, 1), st.floats(-0.99, 0.99)))
def test_the_spread_is_that_of_the_worst_direction(drawn: tuple[float, float, float]) -> None:
    xx, yy, correlation = drawn
    xy = correlation * math.sqrt(xx * yy)
    matrix = ((xx, xy), (xy, yy))
    contact = PATCH.contact(replace(ON_SHEET, covariance=matrix))
    assert contact.spread == pytest.approx(math.sqrt(np.linalg.eigvalsh(matrix)[-1]))


def test_a_zenoh_outlet_that_fails_half_way_leaves_no_session() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with pytest.raises(KeyError, match="not a type"):
        open_outlet(f"zenoh:listen/tcp/127.0.0.1:{port}", [Topic("/x", "not a type", True, 1)], "test", None)
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0


def test_topics_of_a_named_skin_are_under_its_name() -> None:
    assert contacts_topic("torso").name == "/ohmskin/torso/contacts"
    assert Topic("/x", "sensor_msgs/msg/Image", False, 5).dds_type == "sensor_msgs::msg::dds_::Image_"
