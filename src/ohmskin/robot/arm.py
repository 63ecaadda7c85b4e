"""The arm: three joints, a forearm that carries the skin, and a hand that pokes it. MuJoCo does the mechanics."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.robot.display import mujoco

FINGER = 12e-3  # radius of the hand's fingertip (m)
_REST = np.array([0.0, 0.5, -0.55])  # rad: yaw, shoulder, elbow
_ABOVE = 0.05  # m: where a poke starts, above the skin
_STEP = 1e-3  # s

# The skin is as stiff as thin foam: 8 N push the fingertip about 2 mm in (solref, solimp). Joints are position servos.
_XML = """
<mujoco model="arm with a skin">
  <compiler angle="radian"/>
  <option timestep="{step}" integrator="implicitfast" gravity="0 0 -9.81"/>
  <visual>
    <global offwidth="1280" offheight="960"/>
    <headlight ambient="0.45 0.45 0.45" diffuse="0.45 0.45 0.45" specular="0.1 0.1 0.1"/>
    <quality shadowsize="1024"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1=".93 .95 .98" rgb2=".75 .8 .87" width="64" height="256"/>
    <texture name="floor" type="2d" builtin="checker" rgb1=".86 .88 .91" rgb2=".82 .84 .88" width="256" height="256"/>
    <material name="floor" texture="floor" texrepeat="8 8" reflectance="0.05"/>
    <material name="shell" rgba="0.93 0.94 0.96 1" specular="0.4" shininess="0.5"/>
    <material name="joint" rgba="0.22 0.26 0.33 1" specular="0.3" shininess="0.4"/>
    <material name="skin" rgba="0.13 0.15 0.19 1" specular="0.1" shininess="0.1"/>
    <material name="hand" rgba="0.91 0.72 0.58 1" specular="0.1" shininess="0.2"/>
  </asset>
  <worldbody>
    <light pos="0.6 -0.8 2.2" dir="-0.2 0.35 -1" diffuse="0.5 0.5 0.5" castshadow="true"/>
    <camera name="view" pos="1.14 -0.94 1.12" xyaxes="0.72 0.69 0 -0.33 0.35 0.88" fovy="38"/>
    <geom type="plane" size="2 2 0.1" material="floor"/>
    <geom type="cylinder" size="0.09 0.2" pos="0 0 0.2" material="joint"/>
    <body name="shoulder" pos="0 0 0.45" gravcomp="1">
      <joint name="yaw" axis="0 0 1" damping="2" armature="0.05"/>
      <geom type="sphere" size="0.085" mass="1" material="shell"/>
      <body name="upper" gravcomp="1">
        <joint name="shoulder" axis="0 -1 0" damping="2" armature="0.05"/>
        <geom type="capsule" fromto="0.04 0 0 0.3 0 0" size="0.055" mass="2" material="shell"/>
        <body name="forearm" pos="0.34 0 0" gravcomp="1">
          <joint name="elbow" axis="0 -1 0" damping="2" armature="0.05"/>
          <geom type="cylinder" fromto="0 -0.09 0 0 0.09 0" size="0.06" mass="0.5" material="joint"/>
          <geom type="box" size="0.13 {half_y} 0.03" pos="0.17 0 0" mass="1.5" material="shell"/>
          <geom name="skin" type="box" size="{half_x} {half_y} 0.004" pos="0.17 0 0.034" mass="0.1" material="skin"
                solref="0.02 1" solimp="0.1 0.9 0.006 0.5 2" friction="0.3 0.005 0.0001"/>
          <site name="skin" pos="{corner_x} {corner_y} 0.038"/>
        </body>
      </body>
    </body>
    <body name="hand" mocap="true" pos="0 0 2">
      <geom name="fingertip" type="sphere" size="{finger}" material="hand" solref=".02 1" solimp=".1 .9 .006 .5 2"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.09" size="0.0115" material="hand" contype="0" conaffinity="0"/>
      <geom type="box" pos="0 0.012 0.12" size="0.028 0.04 0.045" material="hand" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <position joint="yaw" kp="400" kv="30"/>
    <position joint="shoulder" kp="400" kv="30"/>
    <position joint="elbow" kp="250" kv="20"/>
  </actuator>
</mujoco>
"""


@dataclass(frozen=True)
class Poke:
    """What presses the skin now, as MuJoCo has it: the truth.

    Args:
        position: (2,) middle of the contact on the skin (m).
        force: Normal force (N).
        radius: Radius of the contact (m), by Hertz from the depth.
    """

    position: Floats
    force: float
    radius: float


class Arm:
    """The arm and the hand that pokes it.

    Args:
        width, height: Size of the skin (m), along the forearm and across.

    Attributes:
        model, data: MuJoCo's.
        target: (3,) joint angles that the servos hold (rad).
    """

    def __init__(self, width: float, height: float) -> None:
        corner = {"corner_x": 0.17 - width / 2, "corner_y": -height / 2}
        xml = _XML.format(step=_STEP, half_x=width / 2, half_y=height / 2, finger=FINGER, **corner)
        self.model: Any = mujoco.MjModel.from_xml_string(xml)
        self.data: Any = mujoco.MjData(self.model)
        self._skin, self._finger = self.model.geom("skin").id, self.model.geom("fingertip").id
        self.target: Floats = _REST.copy()
        self.data.qpos[:], self.data.ctrl[:] = _REST, _REST
        mujoco.mj_forward(self.model, self.data)

    @property
    def time(self) -> float:
        """Simulated time (s)."""
        return float(self.data.time)

    def to_world(self, position: Floats) -> Floats:
        """A place (2,) on the skin (m), in the world (3,)."""
        site = self.data.site("skin")
        return np.asarray(site.xpos + site.xmat.reshape(3, 3)[:, :2] @ position)

    def to_skin(self, point: Floats) -> Floats:
        """A point (3,) in the world (m), on the skin (2,)."""
        site = self.data.site("skin")
        return np.asarray((point - site.xpos) @ site.xmat.reshape(3, 3)[:, :2])

    @property
    def normal(self) -> Floats:
        """Outward normal (3,) of the skin in the world."""
        return np.array(self.data.site("skin").xmat.reshape(3, 3)[:, 2])

    def advance(self, seconds: float, finger: Floats) -> None:
        """Go on by so much time, while the fingertip moves to a point (3,) in the world."""
        steps = max(1, round(seconds / _STEP))
        start = self.data.mocap_pos[0].copy()
        for k in range(steps):
            self.data.mocap_pos[0] = start + (finger - start) * (k + 1) / steps
            self.data.ctrl[:] = self.target
            mujoco.mj_step(self.model, self.data)

    def poke(self) -> Poke | None:
        """What presses the skin now; None if nothing does."""
        points, forces, depth = [], [], 0.0
        wrench = np.zeros(6)
        for k in range(self.data.ncon):
            contact = self.data.contact[k]
            if {int(contact.geom1), int(contact.geom2)} == {self._skin, self._finger}:
                mujoco.mj_contactForce(self.model, self.data, k, wrench)
                points.append(self.to_skin(contact.pos))
                forces.append(wrench[0])
                depth = max(depth, -float(contact.dist))
        force = float(np.sum(forces))
        if force <= 0:
            return None
        return Poke(np.average(points, axis=0, weights=forces), force, float(np.sqrt(FINGER * depth)))

    def retreat(self, position: Floats, speed: float, seconds: float) -> None:
        """Move the target so that this place (2,) of the skin goes inwards, along the normal, at `speed` (m/s)."""
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jac(self.model, self.data, jacobian, None, self.to_world(position), self.model.body("forearm").id)
        along = self.normal @ jacobian
        self.target = self.target - along * (speed * seconds / (along @ along + 1e-3))

    def relax(self, rest: Floats, speed: float, seconds: float) -> None:
        """Move the target towards joint angles (3,) at no more than `speed` (rad/s)."""
        self.target = self.target + np.clip(rest - self.target, -speed * seconds, speed * seconds)

    def rest(self, time: float) -> Floats:
        """Joint angles (3,) of the arm's own slow movement (rad)."""
        return np.asarray(_REST + np.array([0.25 * np.sin(0.5 * time), 0.05 * np.sin(0.7 * time), 0.0]))


def above(arm: Arm, position: Floats, height: float = _ABOVE) -> Floats:
    """Where (3,) the middle of the fingertip is when it is `height` above a place (2,) of the skin (m)."""
    return np.asarray(arm.to_world(position) + (FINGER + height) * arm.normal)
