"""Contacts of a robot with itself, told by how its joints stand; contacts in any frame; the wrench on a link."""

import json
import math
import time
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ohmskin.body import Body, SelfTouch
from ohmskin.body.patches import Merger, Patches
from ohmskin.body.posture import Posture
from ohmskin.body.robot import Robot
from ohmskin.body.self_touch import distance_to
from ohmskin.client import Board, Client, JointStates, PatchState, PlacedContact
from ohmskin.client.contacts import LARGEST, merged, pack, wrench
from ohmskin.contacts import Contact as ContactOnMap
from ohmskin.contacts import in_frame
from ohmskin.errors import PublishError, SkinError
from ohmskin.skin import Skin
from ohmskin.view.overview import BoardsPage

URDF = """
<robot name="r">
  <link name="base"><visual><geometry><box size="0.2 0.4 0.4"/></geometry></visual></link>
  <link name="lid"><visual><origin xyz="0 0 0.3"/><geometry><sphere radius="0.1"/></geometry></visual></link>
  <joint name="glue" type="fixed"><parent link="arm"/><child link="lid"/></joint>
  <link name="arm"><visual><geometry><cylinder radius="0.04" length="0.1"/></geometry></visual></link>
  <joint name="slide" type="prismatic"><parent link="base"/><child link="arm"/><axis xyz="1 0 0"/></joint>
</robot>
"""
BODY = """
name = "r"
urdf = "r.urdf"
[joints]
slide = 0.5
[[patch]]
name = "arm"
link = "arm"
skin = "sleeve"
[[patch]]
name = "front"
link = "base"
position = [0.104, -0.1, 0.1]
rotation = [0.0, 1.5707963267948966, 0.0]
"""
NEAR, FAR = 0.145 + 2e-3, 0.145 + 60e-3  # m: the sleeve's radius, half of the box, and what is between


@pytest.fixture(autouse=True)
def boards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))


def body(folder: Path, urdf: str = URDF) -> Body:
    (folder / "r.urdf").write_text(urdf, encoding="utf-8")
    (folder / "r.toml").write_text(BODY, encoding="utf-8")
    return Body.load(folder / "r.toml")


def on_arm(angle: float, spread: float | None = 1e-3, z: float = 0.05) -> PlacedContact:
    """A contact on the sleeve, in the direction of this angle."""
    x, y = math.cos(angle), math.sin(angle)
    covariance = None if spread is None else tuple(tuple(row) for row in (spread**2 * np.diag([0, 1, 1])).tolist())
    return PlacedContact(
        1, "arm", "arm", (0.045 * x, 0.045 * y, z), (x, y, 0.0), 1e-4, 1e-4, 1, 1, covariance=covariance
    )


@pytest.mark.parametrize("tag", ["visual", "collision"])
@pytest.mark.parametrize(
    ("slide", "angle", "own"), [(NEAR, np.pi, True), (FAR, np.pi, False), (NEAR, 0.0, False), (NEAR, np.pi / 2, False)]
)
def test_a_contact_where_another_link_is_is_one_with_oneself(
    tmp_path: Path, slide: float, angle: float, own: bool, tag: str
) -> None:
    """The box is at the inner side of the sleeve only; the ball above, which the arm carries, does not count."""
    known = body(tmp_path, URDF.replace("visual", tag))
    assert known.robot is not None
    robot = known.robot.posed({"slide": slide})
    (told,) = SelfTouch(known).with_self_touch(robot, [on_arm(angle, z=0.14)])
    assert told == replace(on_arm(angle, z=0.14), self_touch=own)


def test_the_skin_of_another_link_counts_beside_its_shapes(tmp_path: Path) -> None:
    known = body(tmp_path, URDF.replace("0.2 0.4 0.4", "0.01 0.01 0.01"))
    assert known.robot is not None
    touch = SelfTouch(known)
    for slide, own in ((NEAR, True), (FAR, False)):
        (told,) = touch.with_self_touch(known.robot.posed({"slide": slide}), [on_arm(np.pi)])
        assert told.self_touch is own


def test_the_less_is_known_of_the_place_the_more_is_taken_for_oneself(tmp_path: Path) -> None:
    """15 mm from the box: seven standard deviations beyond what surfaces leave, or one."""
    known = body(tmp_path)
    assert known.robot is not None
    robot = known.robot.posed({"slide": 0.145 + 15e-3})
    told = SelfTouch(known).with_self_touch(robot, [on_arm(np.pi, 1e-3), on_arm(np.pi, 8e-3), on_arm(np.pi, None)])
    assert [contact.self_touch for contact in told] == [False, True, True]


def test_where_the_shape_of_a_link_is_not_known_it_is_not_said_that_nothing_is_there(tmp_path: Path) -> None:
    known = body(tmp_path, URDF.replace('<sphere radius="0.1"/>', '<mesh filename="lid.stl"/>'))
    assert known.robot is not None
    for slide, own in ((NEAR, True), (FAR, None)):
        (told,) = SelfTouch(known).with_self_touch(known.robot.posed({"slide": slide}), [on_arm(np.pi)])
        assert told.self_touch is own


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_where_the_pose_of_a_link_is_not_known_it_is_not_said_that_it_is_there_or_not(
    tmp_path: Path, kind: str
) -> None:
    """A robot that as a whole moves in a world without shapes knows of its own links."""
    loose = body(tmp_path, URDF.replace('"prismatic"', f'"{kind}"').replace('<axis xyz="1 0 0"/>', ""))
    assert loose.robot is not None
    at_box = replace(on_arm(np.pi), position=(0.1, 0.0, 0.0))
    assert [told.self_touch for told in SelfTouch(loose).with_self_touch(loose.robot, [on_arm(0.0), at_box])] == [
        None
    ] * 2
    world = f'<link name="w"/><joint name="f" type="{kind}"><parent link="w"/><child link="base"/></joint></robot>'
    mobile = body(tmp_path, URDF.replace("</robot>", world))
    assert mobile.robot is not None
    for slide, own in ((NEAR, True), (FAR, False)):
        (told,) = SelfTouch(mobile).with_self_touch(mobile.robot.posed({"slide": slide}), [on_arm(np.pi)])
        assert told.self_touch is own


@pytest.mark.parametrize(
    ("shape", "size", "point", "away"),
    [
        ("box", [0.2, 0.4, 0.6], (0.13, 0.24, 0.0), 0.05),
        ("box", [0.2, 0.4, 0.6], (0.09, 0.0, 0.0), -0.01),
        ("cylinder", [0.1, 0.4], (0.06, 0.08, 0.23), 0.03),
        ("cylinder", [0.1, 0.4], (0.09, 0.12, 0.0), 0.05),
        ("cylinder", [0.1, 0.4], (0.0, 0.0, 0.19), -0.01),
        ("capsule", [0.1, 0.4], (0.0, 0.0, 0.35), 0.05),
        ("capsule", [0.1, 0.4], (0.0, 0.12, 0.1), 0.02),
        ("sphere", [0.1], (0.06, 0.08, 0.0), 0.0),
    ],
)
def test_distances_are_those_of_the_shapes(shape: str, size: list[float], point: tuple, away: float) -> None:
    assert distance_to(np.array(point), {"shape": shape, "size": size}) == pytest.approx(away, abs=1e-12)


def test_contacts_in_any_frame(tmp_path: Path) -> None:
    """There and back; lengths, normals and covariances turn with the link."""
    urdf = URDF.replace('<axis xyz="1 0 0"/>', '<origin xyz="1 2 3" rpy="0.3 -0.5 0.9"/><axis xyz="1 0 0"/>')
    known = body(tmp_path, urdf).robot
    assert known is not None
    robot = known.posed({"slide": 0.25})
    contact = replace(
        on_arm(0.4), velocity=(0.1, 0.2, 0.3), covariance=((4e-6, 1e-6, 0), (1e-6, 2e-6, 0), (0, 0, 1e-6))
    )
    (moved,) = robot.place([contact])
    turn = Rotation.from_euler("xyz", [0.3, -0.5, 0.9]).as_matrix()
    origin = np.array([1, 2, 3]) + turn @ [0.25, 0, 0]
    assert moved.frame == robot.root == "base"
    assert moved.position == pytest.approx(origin + turn @ contact.position)
    assert moved.normal == pytest.approx(turn @ contact.normal)
    assert moved.velocity == pytest.approx(turn @ contact.velocity)
    np.testing.assert_allclose(moved.covariance, turn @ np.array(contact.covariance) @ turn.T, atol=1e-18)
    assert moved.spread == pytest.approx(contact.spread)
    (back,) = robot.place([moved], "arm")
    assert back.position == pytest.approx(contact.position)
    with pytest.raises(SkinError, match="no link 'tail'; the links are base, lid, arm"):
        robot.place([contact], "tail")


def test_a_posed_robot_is_one_loaded_so(tmp_path: Path) -> None:
    known = body(tmp_path).robot
    assert known is not None
    assert known.positions == {"slide": 0.5}
    again = Robot.load(tmp_path / "r.urdf", {"slide": 0.1})
    for link, pose in known.posed({"slide": 0.1}).links.items():
        np.testing.assert_array_equal(pose, again.links[link])
    with pytest.raises(SkinError, match="there is no joint 'knee'"):
        known.posed({"knee": 0.0})


# --- live -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Any]:
    """A body whose arm is touched at its inner side: what clients hear of it, until they hear this of self-touch."""
    known, said = body(tmp_path), list[str]()
    patches = [placed.patch for placed in known.patches]
    sequence = 0
    with (
        Posture(known, said.append) as posture,
        Merger("r", patches, ["r.arm", "r.front"], posture) as merger,
        Board("r.arm", {"patches": [asdict(patches[0])]}, LARGEST) as board,
        Client("shm:r") as client,
    ):

        def subscribe(own: bool | None) -> bool:
            nonlocal sequence
            end = time.monotonic() + 60
            while time.monotonic() < end:
                sequence += 1
                seen = PatchState("arm", "arm", sequence, time.monotonic(), time.time_ns(), "16P")
                board.write(pack(merged(sequence, [seen], [on_arm(np.pi)]), patches[:1]))
                merger.step()
                if (heard := client.newest()) is not None and heard.contacts[0].self_touch is own:
                    return True
            return False

        yield subscribe, said


def test_clients_hear_of_self_touch_while_joint_states_come(live: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    subscribe, said = live
    monkeypatch.setattr("ohmskin.body.posture._STALE", 50.0)
    assert subscribe(None)  # nobody tells how the joints stand
    with JointStates("r") as joints:
        for slide, own in ((FAR, False), (NEAR, True), (FAR, False)):
            joints.push({"slide": slide})
            assert subscribe(own)
        joints.push({"slide": NEAR}, age=100.0)
        assert subscribe(None)  # it may stand otherwise by now
        joints.push({"slide": NEAR})
        assert subscribe(True)
        for wrong in ("knee", "hip"):
            joints.push({wrong: 1.0})
            assert subscribe(None)
        assert len(said) == 1  # not again before it has recovered
        assert "no joint 'knee'; the joints are glue, slide" in said[0]
        joints.push({"slide": NEAR})
        assert subscribe(True)
        joints.push({"hip": 1.0})
        assert subscribe(None)
        assert len(said) == 2
        with pytest.raises(PublishError, match="joint 'slide' is at nan"):
            joints.push({"slide": math.nan})


def geared(folder: Path) -> Body:
    """A body whose slide mimics a motor."""
    tied = '<axis xyz="1 0 0"/><mimic joint="motor" multiplier="0.5" offset="0.1"/>'
    motor = """<link name="gear"/><joint name="motor" type="continuous">
        <parent link="base"/><child link="gear"/></joint></robot>"""
    urdf = URDF.replace('<axis xyz="1 0 0"/>', tied).replace("</robot>", motor)
    (folder / "r.urdf").write_text(urdf, encoding="utf-8")
    (folder / "r.toml").write_text(BODY.replace("slide = 0.5", "motor = 3.0"), encoding="utf-8")
    return Body.load(folder / "r.toml")


def test_the_posture_is_known_without_joints_that_mimic_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ohmskin.body.posture._STALE", 50.0)
    with Posture(geared(tmp_path)) as posture, JointStates("r") as joints:
        for told, slide in (({"motor": 0.4}, 0.3), ({"motor": 0.4, "slide": 0.0}, 0.3), ({}, 1.6)):
            joints.push(told)
            time.sleep(0.06)  # a reader looks that often whether there is a new board
            posture.step()
            assert posture.robot.links["arm"][0, 3] == pytest.approx(slide)
            assert posture.with_self_touch([on_arm(0.0)])[0].self_touch is False


def test_joint_states_of_joints_that_mimic_others_do_not_age_the_posture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = MagicMock(side_effect=PublishError("that is enough"))
    monkeypatch.setattr("ohmskin.body.patches.JointsProcess", heard)
    monkeypatch.setattr("ohmskin.body.patches.RelayProcess", MagicMock())
    with pytest.raises(PublishError, match="that is enough"):
        Patches(geared(tmp_path), joints="zenoh")
    assert list(heard.call_args.args[1]) == ["motor"]


def test_the_page_is_told_where_links_are_now(live: Any) -> None:
    subscribe, _ = live
    page = BoardsPage("r", ["r.arm", "r.front"], {"links": {}, "visuals": []})

    def links() -> Any:
        frame = page.frame()
        return json.loads(frame[4 : 4 + int.from_bytes(frame[:4], "little")])["links"]

    assert links() == {}
    with JointStates("r") as joints:
        joints.push({"slide": 0.25})
        assert subscribe(False)
        end = time.monotonic() + 60
        while not (told := links()) and time.monotonic() < end:
            time.sleep(0.01)
    assert told["arm"] == [1, 0, 0, 0.25, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]


# --- wrenches ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ["sleeve", "dome"])
def test_the_wrench_of_contacts_on_a_curved_skin_is_that_of_their_pressure(shape: str) -> None:
    """Of round presses on the surface, in the frame of the link: held against the sum of the pressure's pushes over the
    surface. A press of 8 mm on a radius of 45 mm pushes 0.6 % less than its force, as its rim pushes inwards, too."""
    skin, places = Skin.load(shape), np.array([[0.02, 0.03], [-0.03, 0.05]])
    chart, patch = skin.chart, Body.load(Path(__file__).parents[1] / "examples" / "body" / "body.toml").patches[0].patch
    places = places + (np.array([0.1, 0.03]) if shape == "sleeve" else 0.0)
    forces, radius = [3.0, 7.0], 8e-3
    contacts = [
        ContactOnMap(tuple(place), 1e-4, 1e-4, 1.0, 1.0, id=k, radius=radius, force=force)
        for k, (place, force) in enumerate(zip(places.tolist(), forces, strict=True))
    ]
    told = np.concatenate(wrench(in_frame(contacts, chart, patch)))

    whole = np.zeros(6)
    for place, force in zip(places, forces, strict=True):
        fine = np.stack(np.meshgrid(*2 * [np.linspace(-0.02, 0.02, 201)]), -1).reshape(-1, 2) + place
        points, scale, middle = chart.points(fine), chart.scale(fine), chart.points([place])[0]
        under = np.linalg.norm(points - middle, axis=1) < radius
        areas = scale[under] ** 2 / (scale[under] ** 2).sum()
        for point, normal, share in zip(points[under], chart.frames(fine[under])[:, 2], areas, strict=True):
            push = -force * share * np.array(patch.turn(*normal))
            whole += np.concatenate([push, np.cross(patch.place(*point), push)])
    np.testing.assert_allclose(told[:3], whole[:3], atol=0.01 * sum(forces))
    np.testing.assert_allclose(told[3:], whole[3:], atol=0.01 * sum(forces) * 0.2)
    assert np.linalg.norm(told[3:]) > 0.1
