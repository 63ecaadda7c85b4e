"""A body as MuJoCo has it: links of simple shapes, skins that can be touched, servos at the joints, and a finger."""

from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from ohmskin.arrays import Floats
from ohmskin.body import Body, PlacedSkin
from ohmskin.body.robot import Joint
from ohmskin.errors import ModelError

FINGER, PAD = 12e-3, 30e-3  # radius of a hand's fingertip, and of the pads of two arms that hug (m)
PADS = 4
STEP = 1e-3  # s
THICKNESS = 4e-3  # m, of a skin
_SKIN, _SHELL, _HAND = 1, 2, 4  # who touches whom: skins touch all, shells and the hand only skins
_MOST_CORNERS = 400  # of a skin's convex hull, about

# What bears a finger is foam (`RobotSimulation`): its force must not depend on the inertia of what is pressed, as
# that of MuJoCo's contacts does, which begin where foam is dense. Soft neoprene, 8 mm thick, bears 14 to 34 kPa at
# 25 % (ASTM D1056, grade 1). Joints are position servos.
STIFFNESS = 12e6  # pressure of foam for each metre of its compression (Pa/m)
_DENSE = {"priority": "1", "solref": "0.02 1", "solimp": "0.0001 0.9 0.016 0.5 6"}
_SCENE = """
<mujoco model="a robot with skins">
  <compiler angle="radian"/>
  <option timestep="{step}" integrator="implicitfast" gravity="0 0 -9.81"/>
  <statistic center="{center}" extent="{extent}"/>
  <visual>
    <global offwidth="1280" offheight="960" azimuth="-145" elevation="-20" fovy="38"/>
    <headlight ambient="0.45 0.45 0.45" diffuse="0.45 0.45 0.45" specular="0.1 0.1 0.1"/>
    <quality shadowsize="1024"/>
  </visual>
  <default><joint damping="2" armature="0.05"/><position kp="400" kv="30"/></default>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1=".93 .95 .98" rgb2=".75 .8 .87" width="64" height="256"/>
    <texture name="floor" type="2d" builtin="checker" rgb1=".86 .88 .91" rgb2=".82 .84 .88" width="256" height="256"/>
    <material name="floor" texture="floor" texrepeat="8 8" reflectance="0.05"/>
    <material name="skin" rgba="0.13 0.15 0.19 1" specular="0.1" shininess="0.1"/>
    <material name="hand" rgba="0.91 0.72 0.58 1" specular="0.1" shininess="0.2"/>
  </asset>
  <worldbody>
    <light pos="0.6 -0.8 2.2" dir="-0.2 0.35 -1" diffuse="0.5 0.5 0.5" castshadow="true"/>
    <geom type="plane" size="2 2 0.1" pos="0 0 {floor}" material="floor" contype="0" conaffinity="0"/>
    <body name="hand" mocap="true" pos="0 0 9">
      <geom name="hand 0" type="sphere" size="{finger}" material="hand" contype="4" conaffinity="0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.09" size="0.0115" material="hand" contype="0" conaffinity="0"/>
      <geom type="box" pos="0 0.012 0.12" size="0.028 0.04 0.045" material="hand" contype="0" conaffinity="0"/>
    </body>{pads}
  </worldbody>
  <equality/>
  <actuator/>
</mujoco>
"""


_PAD = """
    <body mocap="true" pos="0 0 9">
      <geom name="hand {number}" type="sphere" size="{pad}" material="hand" contype="4" conaffinity="0"/>
      <geom type="capsule" fromto="0 0 0 0.05 0 0.2" size="0.026" material="hand" contype="0" conaffinity="0"/>
    </body>"""


def scene(body: Body) -> str:
    """MuJoCo's description (MJCF) of a body whose URDF file gives its shapes; bodies are called as links are.

    Skins collide as the convex hulls of their surfaces, `skin 0`, `skin 1`, ...; links as their simple shapes.

    Raises:
        ModelError: If the body has no URDF file.
    """
    robot = body.robot
    if robot is None or not robot.visuals:
        raise ModelError(f"body {body.name!r} names no URDF file with simple shapes, which MuJoCo could move; give one")
    reaches = np.array([[max(visual["size"][0], visual["size"][-1] / 2)] for visual in robot.visuals])
    middles = np.array([(robot.links[visual["link"]] @ visual["pose"])[:3, 3] for visual in robot.visuals])
    low, high = (middles - reaches).min(axis=0), (middles + reaches).max(axis=0)
    seen = {"center": _text((low + high) / 2), "extent": f"{0.77 * np.linalg.norm(high - low):.3g}"}
    pads = "".join(_PAD.format(number=number + 1, pad=PAD) for number in range(PADS))
    root = ElementTree.fromstring(_SCENE.format(step=STEP, finger=FINGER, pads=pads, floor=low[2], **seen))
    world, assets, servos = (_child(root, name) for name in ("worldbody", "asset", "actuator"))
    above = {joint.child: (name, joint) for name, joint in robot.joints.items()}
    made: dict[str, Element] = {}

    def make(link: str) -> Element:
        if link not in made:
            name, joint = above.get(link, ("", None))
            made[link] = _link(world if joint is None else make(joint.parent), link, name, joint, servos)
        return made[link]

    for link in robot.links:
        make(link)
    ties = _child(root, "equality")
    for name, joint in robot.joints.items():
        if joint.mimics is not None and joint.moves:
            follows = f"{joint.offset!r} {joint.multiplier!r} 0 0 0"
            SubElement(ties, "joint", joint1=name, joint2=joint.mimics, polycoef=follows)
    for visual in robot.visuals:
        _shell(made[visual["link"]], visual)
    for number, placed in enumerate(body.patches):
        corners = " ".join(f"{value:.5f}" for value in _hull(placed).ravel())
        SubElement(assets, "mesh", name=f"skin {number}", vertex=corners)
        mesh = {"type": "mesh", "mesh": f"skin {number}", "material": "skin", "mass": "0.1"}
        bits = {"contype": str(_SKIN), "conaffinity": str(_SKIN | _SHELL | _HAND)}
        SubElement(made[placed.patch.frame], "geom", {"name": f"skin {number}"} | mesh | bits | _DENSE)
    for element in made.values():
        if element.find("geom") is None:  # a link between two joints: what moves must have a mass
            SubElement(element, "inertial", pos="0 0 0", mass="0.1", diaginertia="1e-3 1e-3 1e-3")
    return ElementTree.tostring(root, encoding="unicode")


def _child(element: Element, name: str) -> Element:
    found = element.find(name)
    assert found is not None
    return found


def _link(parent: Element, link: str, name: str, joint: Joint | None, servos: Element) -> Element:
    pose = np.eye(4) if joint is None else joint.origin
    made = SubElement(parent, "body", {"name": link, "gravcomp": "1"} | _at(pose))
    if joint is not None and joint.moves:
        kind = {"type": "slide" if joint.kind == "prismatic" else "hinge", "axis": _text(joint.axis)}
        SubElement(made, "joint", {"name": name} | kind)
        SubElement(servos, "position", joint=name)
    return made


def _shell(link: Element, visual: dict[str, Any]) -> None:
    """A simple shape of a link; URDF gives lengths, MuJoCo half-lengths."""
    size = np.array(visual["size"])
    half = size / 2 if visual["shape"] == "box" else size * ([1, 0.5][: len(size)])
    bits = {"contype": str(_SHELL), "conaffinity": "0", "density": "300"}
    rgba = _text(np.append(np.array(visual["colour"]), 1.0))
    pose = _at(np.array(visual["pose"]))
    SubElement(link, "geom", {"type": str(visual["shape"]), "size": _text(half), "rgba": rgba} | bits | pose)


def _hull(placed: PlacedSkin) -> Floats:
    """Points (n, 3) of a skin's outside and, as thick as it is, inside, in the frame of its link (m)."""
    chart, mesh = placed.skin.chart, placed.skin.mesh()
    rim = np.unique(mesh.boundary)
    inner = np.setdiff1d(np.arange(len(mesh.nodes)), rim)
    places = mesh.nodes[np.append(rim, inner[:: max(1, len(inner) // _MOST_CORNERS)])]
    outside, normals = chart.points(places), chart.frames(places)[:, 2]
    return np.array([placed.patch.place(*point) for point in np.vstack([outside, outside - THICKNESS * normals])])


def _at(pose: Floats) -> dict[str, str]:
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return {"pos": _text(pose[:3, 3]), "quat": _text(np.array([w, x, y, z]))}


def _text(values: Floats) -> str:
    return " ".join(f"{value:.9g}" for value in values)
