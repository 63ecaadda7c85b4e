"""Links of a robot: where the joints of its URDF file put them, and what they look like."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ohmskin.body import Body
from ohmskin.body.robot import Robot
from ohmskin.errors import SkinError

EXAMPLE = Path(__file__).parents[1] / "examples" / "body" / "body.toml"
CHAIN = """
<robot name="r">
  <material name="red"><color rgba="1 0 0 1"/></material>
  <link name="base"/>
  <link name="hand"><visual><origin xyz="0 0 0.1"/><geometry><sphere radius="0.05"/></geometry>
    <material name="red"/></visual></link>
  <link name="arm"><visual><geometry><mesh filename="arm.stl"/></geometry></visual></link>
  <joint name="slide" type="prismatic"><parent link="arm"/><child link="hand"/>
    <origin xyz="0 0 0.3" rpy="0.2 -0.4 1.1"/><axis xyz="0 0 2"/></joint>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>
    <origin xyz="1 2 3" rpy="0.1 0.5 -0.7"/><axis xyz="0 3 4"/></joint>
</robot>
"""


def load(folder: Path, text: str, **joints: Any) -> Robot:
    (folder / "r.urdf").write_text(text, encoding="utf-8")
    return Robot.load(folder / "r.urdf", joints)


def test_links_are_where_the_joints_put_them(tmp_path: Path) -> None:
    robot = load(tmp_path, CHAIN, turn=0.8, slide=0.25)
    np.testing.assert_array_equal(robot.links["base"], np.eye(4))
    turned = Rotation.from_euler("xyz", [0.1, 0.5, -0.7]) * Rotation.from_rotvec(0.8 * np.array([0, 0.6, 0.8]))
    np.testing.assert_allclose(robot.links["arm"][:3, :3], turned.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(robot.links["arm"][:3, 3], [1, 2, 3])
    inner = Rotation.from_euler("xyz", [0.2, -0.4, 1.1])
    at = np.array([1, 2, 3]) + turned.apply(np.array([0, 0, 0.3]) + inner.apply([0, 0, 0.25]))
    np.testing.assert_allclose(robot.links["hand"][:3, 3], at, atol=1e-12)
    np.testing.assert_allclose(robot.links["hand"][:3, :3], (turned * inner).as_matrix(), atol=1e-12)
    (ball,) = robot.visuals
    assert (ball["link"], ball["shape"], ball["size"], ball["colour"]) == ("hand", "sphere", [0.05], [1, 0, 0])
    assert robot.unseen == ("arm",)
    still = load(tmp_path, CHAIN).links["hand"][:3, 3]
    up = Rotation.from_euler("xyz", [0.1, 0.5, -0.7]).apply([0, 0, 0.3])
    np.testing.assert_allclose(still, np.array([1, 2, 3]) + up)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('<child link="hand"/>', '<child link="foot"/>', "joint 'slide' connects link 'arm' to 'foot'"),
        ('<child link="hand"/>', '<child link="arm"/>', "one parent at most"),
        ('<parent link="base"/>', '<parent link="hand"/>', "form a cycle"),
        ('<parent link="base"/>', "", "connects link '' to 'arm'"),
        ('"revolute"', '"ball"', "of type 'ball'"),
        ('"0 3 4"', '"0 0 0"', "about [0. 0. 0.]"),
        ('"0 3 4"', '"0 3 nan"', "it must be 3 numbers"),
        ('"1 2 3"', '"1 2"', "an origin's xyz is '1 2'; it must be 3 numbers"),
        ('radius="0.05"', "", "the visual of link 'hand' is ''; it must be 1 numbers"),
        ("sphere", "torus", "is a 'torus'; choose from box"),
        ('<geometry><sphere radius="0.05"/></geometry>', "", "has no geometry"),
        ('"1 0 0 1"', '"red"', "the colour of the visual"),
        ('name="turn"', 'name="slide"', "joint 'slide' from link 'base' to 'arm' must have a name of its own"),
        ('name="turn" ', "", "joint '' from link 'base' to 'arm' must have a name of its own"),
        ('<link name="base"/>', 2 * '<link name="base"/>', "links must have names of their own; correct 'base'"),
        ('<link name="base"/>', '<link/><link name="base"/>', "links must have names of their own; correct ''"),
        ('<link name="base"/>', '<link name="base"/><link name="tail"/>', "links base, tail are on no joint as its"),
        ('"0 3 4"/>', '"0 3 4"/><mimic joint="knee"/>', "joint 'turn' mimics 'knee', which is not in the file"),
        ('"0 3 4"/>', '"0 3 4"/><mimic offset="1"/>', "joint 'turn' mimics '', which is not in the file"),
        ('"0 3 4"/>', '"0 3 4"/><mimic joint="turn"/>', "joint 'turn' mimics 'turn', in a circle"),
        (
            '"0 3 4"/>',
            '"0 3 4"/><mimic joint="slide" offset="far"/>',
            "multiplier and offset of joint 'turn' is '1 far'",
        ),
    ],
)
def test_a_wrong_robot_says_what(tmp_path: Path, old: str, new: str, says: str) -> None:
    with pytest.raises(SkinError, match=re.escape(says)):
        load(tmp_path, CHAIN.replace(old, new))


def test_joints_may_not_mimic_each_other_in_a_circle(tmp_path: Path) -> None:
    circle = CHAIN.replace('"0 0 2"/>', '"0 0 2"/><mimic joint="turn"/>')
    with pytest.raises(SkinError, match="joint 'turn' mimics 'slide', in a circle"):
        load(tmp_path, circle.replace('"0 3 4"/>', '"0 3 4"/><mimic joint="slide"/>'))


def test_a_world_link_may_carry_the_robot(tmp_path: Path) -> None:
    world = (
        '<link name="world"/><joint name="w" type="fixed"><parent link="world"/><child link="base"/></joint></robot>'
    )
    assert load(tmp_path, CHAIN.replace("</robot>", world)).root == "world"


def test_the_axis_of_a_joint_that_does_not_move_does_not_matter(tmp_path: Path) -> None:
    still = CHAIN.replace('"revolute"', '"fixed"')
    np.testing.assert_array_equal(
        load(tmp_path, still.replace('"0 3 4"', '"0 0 0"')).links["arm"], load(tmp_path, still).links["arm"]
    )


def test_a_joint_that_mimics_another_follows_it(tmp_path: Path) -> None:
    """Also through a third one, wherever they are in the file, and whatever is said of its own position."""
    finger = """<link name="tip"/><joint name="curl" type="revolute"><parent link="hand"/><child link="tip"/>
        <axis xyz="0 1 0"/></joint></robot>"""
    free = CHAIN.replace("</robot>", finger)
    tied = free.replace('"0 0 2"/>', '"0 0 2"/><mimic joint="curl" multiplier="2" offset="0.3"/>')
    tied = tied.replace('"0 1 0"/>', '"0 1 0"/><mimic joint="turn" multiplier="-0.5" offset="0.1"/>')
    robot = load(tmp_path, tied)
    assert robot.independent == ("turn",)
    for turn in (0.0, 0.8):
        curl = -0.5 * turn + 0.1
        expected = load(tmp_path, free, turn=turn, curl=curl, slide=2 * curl + 0.3)
        for posed in (robot.posed({"turn": turn}), robot.posed({"turn": turn, "slide": 9.0, "curl": 9.0})):
            for link, pose in expected.links.items():
                np.testing.assert_allclose(posed.links[link], pose, atol=1e-12)
    same = load(tmp_path, CHAIN.replace('"0 0 2"/>', '"0 0 2"/><mimic joint="turn"/>'), turn=0.8)
    np.testing.assert_array_equal(same.links["hand"], load(tmp_path, CHAIN, turn=0.8, slide=0.8).links["hand"])
    with pytest.raises(SkinError, match="joint 'slide' mimics 'turn'; give that joint's position"):
        load(tmp_path, tied, slide=0.5)


@pytest.mark.parametrize(
    ("joints", "says"), [({"knee": 0.0}, "no joint 'knee'; the joints are slide, turn"), ({"turn": "far"}, "'far'")]
)
def test_joints_must_be_there_and_be_numbers(tmp_path: Path, joints: dict[str, Any], says: str) -> None:
    with pytest.raises(SkinError, match=re.escape(says)):
        load(tmp_path, CHAIN, **joints)


def test_a_body_file_says_how_its_joints_stand(tmp_path: Path) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    (tmp_path / "robot.urdf").write_text(EXAMPLE.with_name("robot.urdf").read_text(encoding="utf-8"), encoding="utf-8")

    def hand(joints: str) -> np.ndarray:
        """Where the forearm ends."""
        (tmp_path / "body.toml").write_text(re.sub(r"joints = .*", joints, text), encoding="utf-8")
        robot = Body.load(tmp_path / "body.toml").robot
        assert robot is not None
        return robot.links["forearm"] @ [0, 0, -0.285, 1]

    np.testing.assert_allclose(hand("")[:3], [0, 0.19, 0.36 - 0.30 - 0.285])
    np.testing.assert_allclose(hand(f"joints = {{ elbow = {-np.pi / 2} }}")[:3], [0.285, 0.19, 0.06], atol=1e-12)
    np.testing.assert_allclose(hand(f"joints = {{ shoulder = {np.pi / 2} }}")[:3], [0, 0.19 + 0.585, 0.36], atol=1e-12)
    with pytest.raises(SkinError, match=r"body.toml: .*robot.urdf: there is no joint 'knee'; the joints are neck, sh"):
        hand("joints = { knee = 1.0 }")
    with pytest.raises(SkinError, match="joints is 5; it must be a table"):
        hand("joints = 5")
