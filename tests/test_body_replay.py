"""A recorded body shown again: contacts, images, joint states and links, for the page, clients and ROS tools."""

import json
import math
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ohmskin.body import Body
from ohmskin.body.body import PlacedSkin
from ohmskin.body.patches import Merger, Patches
from ohmskin.body.posture import Posture
from ohmskin.client import Client, PatchState, PlacedContact
from ohmskin.client.board import BoardReader
from ohmskin.client.joints import JointStates, LinkPoses
from ohmskin.errors import DataError, PublishError
from ohmskin.outlets.picture import Picture
from ohmskin.outlets.publisher import Publisher
from ohmskin.outlets.relay import RelayProcess
from ohmskin.outlets.topics import Topic, wrench_topic

STORE = get_typestore(Stores.ROS2_JAZZY)
SKIN = "[imaging]\nmesh_size = 20e-3\n[contact_layer]\ncolumns = 4\nrows = 4\npatch = 0.02\n"
URDF = """<robot name="r"><link name="base"/><link name="forearm"/><joint name="elbow" type="revolute">
<origin xyz="0 0 0.3"/><parent link="base"/><child link="forearm"/><axis xyz="0 0 1"/></joint></robot>"""
BODY = """name = "torso"
urdf = "robot.urdf"
[[patch]]
name = "chest"
link = "base"
skin = "skin.toml"
[[patch]]
name = "arm"
link = "forearm"
position = [0.1, 0.0, 0.2]
skin = "skin.toml"
"""


@pytest.fixture(autouse=True)
def boards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))


@pytest.fixture
def body(tmp_path: Path) -> Body:
    for name, text in (("skin.toml", SKIN), ("robot.urdf", URDF), ("body.toml", BODY)):
        (tmp_path / name).write_text(text)
    return Body.load(tmp_path / "body.toml")


def contact(placed: PlacedSkin, number: int, x: float) -> PlacedContact:
    cell = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 0.0))
    place = (x, 0.1, 0.2)
    return PlacedContact(
        number, placed.patch.name, placed.patch.frame, place, (0.0, 0.0, 1.0), 1e-4, 2e-5, 0.9, 0.3, covariance=cell
    )


@contextmanager
def sensing(
    body: Body, file: Path, images: float = 50.0
) -> Iterator[tuple[list[Publisher], JointStates, Merger, RelayProcess]]:
    """What `ohmskin patches --record` has, without loops: patches are shown what a test says."""
    names = [f"{body.name}.{placed.patch.name}" for placed in body.patches]
    assert body.robot is not None
    with ExitStack() as stack:
        pairs = zip(body.patches, names, strict=True)
        publishers = [stack.enter_context(Publisher(p.skin, (), name, p.patch)) for p, name in pairs]
        patches = [placed.patch for placed in body.patches]
        merger = stack.enter_context(Merger(body.name, patches, names, stack.enter_context(Posture(body))))
        pictures = [f"{name}.image" for name in names]
        outlets = [f"mcap:{file}"]
        relay = RelayProcess(body.name, pictures, patches, outlets, None, images, body.robot.root)
        yield publishers, stack.enter_context(JointStates(body.name)), merger, stack.enter_context(relay)


def touched(body: Body, publishers: list[Publisher], cycle: int) -> None:
    """What patches publish of one cycle: the arm is touched further on in each."""
    for publisher, placed in zip(publishers, body.patches, strict=True):
        now = PatchState(placed.patch.name, placed.patch.frame, cycle, time.monotonic(), time.time_ns(), "16P")
        contacts = [contact(placed, 1, 0.01 * cycle)] if placed.patch.name == "arm" else []
        publisher.show(np.full(publisher.raster.inside.shape, float(cycle)), cycle, time.time_ns())
        publisher.repeat(now, contacts)


def recorded(body: Body, file: Path, cycles: int = 12, images: float = 50.0) -> None:
    """The arm is touched further and further on while the elbow bends."""
    with sensing(body, file, images) as (publishers, joints, merger, relay):
        for k in range(1, cycles + 1):
            joints.push({"elbow": 0.1 * k})
            touched(body, publishers, k)
            assert merger.step() is not None
            relay.wake()
            time.sleep(0.03)


def messages(file: Path) -> dict[str, list[tuple[str, bytes]]]:
    found: dict[str, list[tuple[str, bytes]]] = {}
    with file.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            found.setdefault(channel.topic, []).append((schema.name, message.data))
    return found


def test_links_are_where_the_last_joint_states_have_them(body: Body, tmp_path: Path) -> None:
    """The links follow some time after the joints: meanwhile contacts are published."""
    with sensing(body, tmp_path / "a.mcap") as (publishers, joints, merger, relay):
        for k in range(3):
            touched(body, publishers, k + 1)
            assert merger.step() is not None
            if k < 2:
                joints.push({"elbow": 0.5 * k})
            relay.wake()
            time.sleep(0.1)
    kind, data = messages(tmp_path / "a.mcap")["/ohmskin/torso/tf"][-1]
    turn = STORE.deserialize_cdr(data, kind).transforms[0].transform.rotation
    assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(0.5)


def test_a_recording_has_the_topics_of_ros_2_as_other_readers_read_them(body: Body, tmp_path: Path) -> None:
    recorded(body, tmp_path / "a.mcap")
    found = messages(tmp_path / "a.mcap")
    assert {"/ohmskin/torso/contacts", "/ohmskin/torso/markers", "/ohmskin/torso/arm/image"} < set(found)
    kind, data = found["/ohmskin/torso/joint_states"][-1]
    state = STORE.deserialize_cdr(data, kind)
    assert (state.name, state.position.tolist()) == (["elbow"], [pytest.approx(1.2)])
    kind, data = found["/ohmskin/torso/tf"][-1]
    (transform,) = STORE.deserialize_cdr(data, kind).transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("base", "forearm")
    turn, place = transform.transform.rotation, transform.transform.translation
    assert (place.x, place.y, place.z) == (0.0, 0.0, 0.3)
    assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(state.position[0])
    with (tmp_path / "a.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        for schema in summary.schemas.values():
            assert schema.encoding == "ros2msg"
            assert get_types_from_msg(schema.data.decode(), schema.name)[schema.name]
    for kind in ("sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage"):
        topic = Topic("/x", kind, True, 10)
        assert topic.hash == STORE.hash_rihs01(kind)
        told = get_types_from_msg(topic.definition, kind)
        assert [name for name, _ in told[kind][1]] == [name for name, _ in STORE.fielddefs[kind][1]]


def test_points_markers_and_wrenches_of_a_curved_skin_are_on_its_surface_in_the_frame_of_its_link(
    tmp_path: Path,
) -> None:
    folder = Path(__file__).parents[1] / "examples" / "humanoid"
    text = BODY.replace("skin.toml", "forearm.toml").replace("[0.1, 0.0, 0.2]", "[0.0, 0.0, -0.24]")
    for name, content in (("forearm.toml", (folder / "forearm.toml").read_text()), ("robot.urdf", URDF)):
        (tmp_path / name).write_text(content)
    (tmp_path / "body.toml").write_text(text)
    curved = Body.load(tmp_path / "body.toml")
    arm = curved.patches[1]
    chart, middle = arm.skin.chart, np.mean(np.reshape(arm.skin.domain.bounds, (2, 2)), axis=0)
    point = arm.patch.place(*chart.points([middle])[0])
    normal = arm.patch.turn(*chart.frames([middle])[0, 2])
    touched = replace(contact(arm, 1, 0.0), position=point, normal=normal, force=4.0, force_std=0.5)
    with sensing(curved, tmp_path / "a.mcap") as (publishers, joints, merger, relay):
        for k in range(1, 13):
            joints.push({"elbow": 0.1})
            for publisher, placed in zip(publishers, curved.patches, strict=True):
                now = PatchState(placed.patch.name, placed.patch.frame, k, time.monotonic(), time.time_ns(), "16P")
                publisher.show(np.where(publisher.raster.inside, 0.25, np.nan), k, time.time_ns())
                publisher.repeat(now, [touched] if placed is arm else [])
            assert merger.step() is not None
            relay.wake()
            time.sleep(0.03)
    found = messages(tmp_path / "a.mcap")
    kind, data = found["/ohmskin/torso/arm/points"][-1]
    cloud = STORE.deserialize_cdr(data, kind)
    assert cloud.header.frame_id == "forearm"
    assert [(field.name, field.offset, field.datatype) for field in cloud.fields] == [
        (name, 4 * k, 7) for k, name in enumerate(("x", "y", "z", "change"))
    ]
    x, y, z, change = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(cloud.width, -1).T
    np.testing.assert_allclose(change, 0.25)
    sheet, height = arm.skin.sheet, z + 0.24
    slope = (sheet.top_radius - sheet.radius) / sheet.height
    np.testing.assert_allclose(np.hypot(x, y), sheet.radius + slope * height, atol=1e-6)
    assert (np.ptp(np.arctan2(y, x)) > 6.0, height.min() < 0.01, height.max() > sheet.height - 0.01) == (True,) * 3
    kind, data = found["/ohmskin/torso/markers"][-1]
    markers = [one for one in STORE.deserialize_cdr(data, kind).markers if one.action == 0]
    assert {one.header.frame_id for one in markers} == {"forearm"}
    ends = [[p.x, p.y, p.z] for one in markers for p in one.points] or [
        [one.pose.position.x, one.pose.position.y, one.pose.position.z] for one in markers
    ]
    assert min(np.linalg.norm(np.array(ends) - point, axis=1)) < 1e-6
    kind, data = found[wrench_topic("torso", "forearm", ["base", "forearm"]).name][-1]
    pushed = STORE.deserialize_cdr(data, kind)
    force = np.array([pushed.wrench.force.x, pushed.wrench.force.y, pushed.wrench.force.z])
    torque = np.array([pushed.wrench.torque.x, pushed.wrench.torque.y, pushed.wrench.torque.z])
    assert pushed.header.frame_id == "forearm"
    np.testing.assert_allclose(force, -4.0 * np.array(normal), atol=1e-9)
    np.testing.assert_allclose(torque, np.cross(point, force), atol=1e-9)


def test_a_recording_replays_the_body(body: Body, tmp_path: Path) -> None:
    recorded(body, tmp_path / "a.mcap")
    felt, poses, images = [], list[float](), list[float]()
    with (
        Patches(body, replay=str(tmp_path / "a.mcap")) as patches,
        Client("shm:torso") as client,
        LinkPoses("torso") as links,
        BoardReader("torso.arm.image") as pictures,
    ):
        while not patches.ended:
            patches.step()
            if (newest := client.newest()) is not None:
                felt.append(newest)
                assert newest.age < 5.0
            if pose := links.newest():
                poses.append(math.asin(pose["forearm"][4]))
            if (record := pictures.newest()) is not None:
                images.append(float(np.nanmax(Picture.unpack(record, pictures.setup).pixels)))
    touched = [one.contacts[0] for one in felt if one.contacts]
    assert [c.position[0] for c in touched] == sorted(c.position[0] for c in touched)
    last = touched[-1]
    assert (last.patch, last.frame, last.id) == ("arm", "forearm", 1)
    assert last.position == pytest.approx((0.12, 0.1, 0.2))
    assert last.covariance == ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 0.0))
    assert last.self_touch is False  # told anew, by the joint states of then
    assert poses[-1] == pytest.approx(1.2)
    assert poses == sorted(poses)
    assert images[-1] == 12.0
    assert {one.patches[1].mode for one in felt} == {"16P"}


def test_a_recording_ends_with_the_newest_image_however_few_are_recorded(body: Body, tmp_path: Path) -> None:
    recorded(body, tmp_path / "a.mcap", images=0.01)
    found = messages(tmp_path / "a.mcap")
    images = [STORE.deserialize_cdr(data, kind).data.view("<f4") for kind, data in found["/ohmskin/torso/arm/image"]]
    assert len(images) <= 2  # one in 100 s, and the last
    assert np.nanmax(images[-1]) == 12.0


def test_a_replay_can_be_recorded_again_and_says_the_same(body: Body, tmp_path: Path) -> None:
    recorded(body, tmp_path / "a.mcap", cycles=20)
    with Patches(body, [f"mcap:{tmp_path / 'b.mcap'}"], images=1000.0, replay=str(tmp_path / "a.mcap")) as patches:
        while not patches.ended:
            patches.step()
    first, again = messages(tmp_path / "a.mcap"), messages(tmp_path / "b.mcap")
    for topic in ("/ohmskin/torso/joint_states", "/ohmskin/torso/arm/image"):
        said, repeated = ({(kind, data[12:]) for kind, data in found[topic]} for found in (first, again))
        assert repeated  # how many depends on how often the relaying process got a core: it sends what is newest
        assert repeated <= said  # but for their stamps


def test_what_is_no_recording_of_this_body_is_refused_in_words(body: Body, tmp_path: Path) -> None:
    recorded(body, tmp_path / "a.mcap", cycles=2)
    with pytest.raises(DataError, match="cannot read recording"):
        Patches(body, replay=str(tmp_path / "none.mcap"))
    (tmp_path / "body.toml").write_text(BODY.replace('"torso"', '"other"'))
    with pytest.raises(DataError, match="no messages of a body named 'other'"):
        Patches(Body.load(tmp_path / "body.toml"), replay=str(tmp_path / "a.mcap"))
    with pytest.raises(PublishError, match=r"use mcap:FILE\.mcap"):
        Patches(body, ["mcap:a.bag"])
    with pytest.raises(PublishError, match="File exists"):
        Patches(body, [f"mcap:{tmp_path / 'a.mcap'}"])
    (tmp_path / "body.toml").write_text(BODY.replace('"forearm"', '"base"'))
    moved = Body.load(tmp_path / "body.toml")
    with Patches(moved, replay=str(tmp_path / "a.mcap")) as patches:  # a message that does not fit is left out
        while not patches.ended:
            felt = patches.step()
            assert felt is None or not [c for c in felt.contacts if c.patch == moved.patches[1].patch.name]


def test_damaged_messages_are_left_out(body: Body, tmp_path: Path) -> None:
    recorded(body, tmp_path / "a.mcap")
    content = bytearray((tmp_path / "a.mcap").read_bytes())
    rng = np.random.default_rng(0)
    for case in range(12):
        spoilt = bytearray(content)
        for at in rng.integers(8, len(spoilt), 20):
            spoilt[at] = rng.integers(256)
        if case % 3 == 0:
            del spoilt[rng.integers(8, len(spoilt)) :]
        (tmp_path / "b.mcap").write_bytes(spoilt)
        try:
            with Patches(body, replay=str(tmp_path / "b.mcap")) as patches:
                end = time.monotonic() + 0.5
                while not patches.ended and time.monotonic() < end:
                    patches.step()
        except DataError:
            pass


@pytest.mark.parametrize("example", ["body", "humanoid"])
def test_the_layouts_of_rviz_and_foxglove_name_topics_links_and_files_that_are_there(example: str) -> None:
    """After a change: python tools/layouts.py examples/.../body.toml. RViz's reader knows no merged keys."""
    folder = Path(__file__).parents[1] / "examples" / example
    body, text = Body.load(folder / "body.toml"), (folder / "body.rviz").read_text(encoding="utf-8")
    assert body.robot is not None
    own, patches = f"/ohmskin/{body.name}", [placed.patch for placed in body.patches]
    links = list(dict.fromkeys(patch.frame for patch in patches if patch.newtons))
    published = {f"{own}/{patch.name}/points" for patch in patches} | {f"{own}/markers"}
    published |= {wrench_topic(body.name, link, links).name for link in links}
    assert len(links) == (6 if example == "humanoid" else 0)
    displays = yaml.safe_load(text)["Visualization Manager"]
    assert {one["Topic"]["Value"] for one in displays["Displays"][1:]} == published
    assert all("Class" in one and "Name" in one for one in displays["Displays"])
    assert "<<" not in text
    assert "*" not in text
    assert f"/tf:={own}/tf" in text
    assert (folder / displays["Displays"][0]["Description File"]).exists()
    assert displays["Global Options"]["Fixed Frame"] == body.robot.root
    layout = json.loads((folder / "foxglove-layout.json").read_text(encoding="utf-8"))["configById"]
    space = layout[f"3D!{body.name}"]
    assert set(space["topics"]) == published | {f"{own}/tf"}
    assert space["followTf"] == body.robot.root
    assert layout[f"RawMessages!{body.name}"]["topicPath"] == f"{own}/contacts"
    assert space["layers"]["robot"]["layerId"] == "foxglove.Urdf"
