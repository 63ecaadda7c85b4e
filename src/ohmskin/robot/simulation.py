"""A robot that wears skins, and the hand that pokes it. MuJoCo does the mechanics."""

from collections import defaultdict
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.body import Body
from ohmskin.body.robot import Robot
from ohmskin.errors import ModelError
from ohmskin.robot.display import mujoco
from ohmskin.robot.scene import FINGER, PAD, PADS, STEP, STIFFNESS, scene
from ohmskin.skin import Press

_MOTION = 0.1  # rad, of the slow movement of each joint
OFF = 10e-3  # m from a skin's surface, beyond which a contact of its hull is none of the skin
_OWN = 30e-3  # m, radius that a link touches another with
_LEAST_RADIUS, _MOST_PRESSURE = 2e-3, 1e6  # m, Pa: within what the virtual skin takes


@dataclass(frozen=True, eq=False)
class Push:
    """A press on a skin, from MuJoCo: the true contact.

    Args:
        patch: Number of the skin.
        place: (2,) middle of the contact on the skin's map (m).
        point: (3,) the same in the world (m).
        force: Normal force (N).
        radius: Radius of the contact (m): of a ball at this depth in thin foam, which is compressed only under the
            ball.
        by: Link that presses it; empty if it is a hand, from outside.
        hand: Number of that hand; -1 if it is a link.
    """

    patch: int
    place: Floats
    point: Floats
    force: float
    radius: float
    by: str = ""
    hand: int = -1

    def press(self, foam_spread: float) -> Press:
        """The equivalent round press on the virtual skin, with the same force, for foam with a `foam_spread` (m)."""
        place, radius = (float(self.place[0]), float(self.place[1])), max(self.radius, _LEAST_RADIUS)
        per_pascal = Press(place, radius, 1.0).force(foam_spread)
        return Press(place, radius, min(self.force / per_pascal, _MOST_PRESSURE))


class RobotSimulation:
    """A robot in skins, its root link fixed in the world, the hand that pokes it, and the pads that hug it.

    Args:
        body: The robot; its file gives the posture (`joints`).

    Attributes:
        model, data: MuJoCo's.
        target: Joint positions (rad, m) that the servos hold, in MuJoCo's order.
        low, high: Their limits.
        hands: Radius of the tip of each hand (m): the finger's, then the pads'.

    Raises:
        ModelError: If the body has no URDF file, or MuJoCo rejects it.
    """

    def __init__(self, body: Body) -> None:
        described = scene(body)
        try:
            self.model: Any = mujoco.MjModel.from_xml_string(described)
        except ValueError as error:
            raise ModelError(f"MuJoCo does not take body {body.name!r}: {error}; correct its URDF file") from error
        assert body.robot is not None
        self.body, self.robot, self.data = body, body.robot, mujoco.MjData(self.model)
        self._names = [self.model.joint(number).name for number in range(self.model.njnt)]
        self._skins = {self.model.geom(f"skin {number}").id: number for number in range(len(body.patches))}
        self.hands = (FINGER, *[PAD] * PADS)
        self._hands = {self.model.geom(f"hand {number}").id: number for number in range(len(self.hands))}
        joints = [body.robot.joints[name] for name in self._names]
        self.low, self.high = np.array([joint.limits for joint in joints]).reshape(-1, 2).T
        self._ties, self._offsets = np.eye(len(joints)), np.array([joint.offset for joint in joints])
        for row, joint in zip(self._ties, joints, strict=True):
            if joint.mimics is not None:
                row[:] = np.array(self._names) == joint.mimics
                row *= joint.multiplier
        self._still = self._tied(np.array([body.robot.positions.get(name, 0.0) for name in self._names]))
        self.target: Floats = self._still.copy()
        self.data.qpos[:], self.data.ctrl[:] = self._still, self._still
        mujoco.mj_forward(self.model, self.data)

    @property
    def time(self) -> float:
        """Simulated time (s)."""
        return float(self.data.time)

    def posed(self) -> Robot:
        """The robot with its joints as its encoders read now."""
        return self.robot.posed(dict(zip(self._names, self.data.qpos.tolist(), strict=True)))

    def surface(self, patch: int, place: Floats) -> tuple[Floats, Floats]:
        """Where a place of a skin is in the world.

        Args:
            patch: Number of the skin.
            place: (2,) on its map (m).

        Returns:
            The point (3,) in the world (m), and the outward normal (3,) there.
        """
        placed = self.body.patches[patch]
        link = self.data.body(placed.patch.frame)
        turn, chart = link.xmat.reshape(3, 3), placed.skin.chart
        point = link.xpos + turn @ placed.patch.place(*chart.points([place])[0])
        return point, turn @ placed.patch.turn(*chart.frames([place])[0, 2])

    def place(self, patch: int, point: Floats) -> tuple[Floats, float]:
        """The place of a skin closest to a point.

        Args:
            patch: Number of the skin.
            point: (3,) in the world (m).

        Returns:
            The place (2,) on the skin's map (m), and how far off it the point is (m).
        """
        placed = self.body.patches[patch]
        link = self.data.body(placed.patch.frame)
        local = (point - link.xpos) @ link.xmat.reshape(3, 3) - placed.patch.position
        places, away = placed.skin.chart.project(np.array(placed.patch.axes) @ local)
        return places[0], float(away[0])

    def _tied(self, joints: Floats) -> Floats:
        """Positions (n_joints,) of the `joints` (rad, m), of which those that mimic others follow these."""
        return np.asarray(self._ties @ joints + self._offsets)

    def advance(self, seconds: float, *tips: Floats) -> None:
        """Simulate.

        Args:
            seconds: How long (s); whole steps of `STEP`, at least one.
            tips: (3,) where the tip of each of the first hands is at the end (m, in the world); they move straight.
        """
        steps, ends = max(1, round(seconds / STEP)), np.array(tips)
        start = self.data.mocap_pos[: len(tips)].copy()
        for k in range(steps):
            self.data.mocap_pos[: len(tips)] = start + (ends - start) * (k + 1) / steps
            self.data.ctrl[:] = self.target
            mujoco.mj_step1(self.model, self.data)
            self._press_foam()
            mujoco.mj_step2(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)  # links and contacts of now: a step leaves those of before it

    def _press_foam(self) -> None:
        """Let foam push apart what presses it, with the same force in both directions."""
        self.data.qfrc_applied[:] = 0.0
        for contact in self.data.contact[: self.data.ncon]:
            force = self._foam_force(contact) * contact.frame[:3]  # on the second geom
            for geom, own in ((contact.geom1, -force), (contact.geom2, force)):
                body = self.model.geom_bodyid[geom]
                mujoco.mj_applyFT(self.model, self.data, own, np.zeros(3), contact.pos, body, self.data.qfrc_applied)

    def _foam_force(self, contact: Any) -> float:
        """With which foam bears a ball so deep in it (N): only right under it, as in a Winkler foundation."""
        hands = [self._hands[geom] for geom in (contact.geom1, contact.geom2) if geom in self._hands]
        radius = self.hands[hands[0]] if hands else _OWN
        return float(np.pi * STIFFNESS * radius * max(-contact.dist, 0.0) ** 2)

    def place_hand(self, tip: Floats, normal: Floats, hand: int = 0) -> None:
        """Place the tip of a hand at a point (3,) in the world at once, the hand along a normal (3,)."""
        self.data.mocap_pos[hand] = tip
        mujoco.mju_quatZ2Vec(self.data.mocap_quat[hand], normal)

    def copy(self) -> "RobotSimulation":
        """A copy in the same posture, without a hand near it."""
        other = copy(self)
        other.data = mujoco.MjData(self.model)
        other.data.mocap_pos[:] = 0.0, 0.0, 9.0
        other.stand(self.data.qpos)
        return other

    def stand(self, joints: Floats) -> None:
        """Set the `joints` to these positions (n_joints,) (rad, m), at once."""
        self.data.qpos[:] = joints
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)

    def touching(self) -> tuple[int, Floats] | None:
        """A skin that touches something, and the place (2,) on its map; None if none does."""
        for contact in self.data.contact[: self.data.ncon]:
            for geom in (contact.geom1, contact.geom2):
                if geom in self._skins:
                    return self._skins[geom], self.place(self._skins[geom], contact.pos)[0]
        return None

    def pushes(self) -> tuple[Push, ...]:
        """The present presses on the skins, the strongest first; all contacts with one link are one press."""
        found: dict[tuple[int, int], list[tuple[Floats, float, float]]] = defaultdict(list)
        wrench = np.zeros(6)
        for number in range(self.data.ncon):
            contact = self.data.contact[number]
            mujoco.mj_contactForce(self.model, self.data, number, wrench)
            force = wrench[0] + self._foam_force(contact)
            for skin, other in ((contact.geom1, contact.geom2), (contact.geom2, contact.geom1)):
                if skin in self._skins and force > 0:
                    by = -1 - self._hands[other] if other in self._hands else int(self.model.geom_bodyid[other])
                    found[self._skins[skin], by].append((contact.pos.copy(), force, -float(contact.dist)))
        pushes = [self._push(patch, by, parts) for (patch, by), parts in found.items()]
        return tuple(sorted((push for push in pushes if push is not None), key=lambda push: -push.force))

    def _push(self, patch: int, by: int, parts: list[tuple[Floats, float, float]]) -> Push | None:
        """One push of several contacts; None if they are off the skin, at the end of its hull."""
        points, forces, depths = zip(*parts, strict=True)
        place, away = self.place(patch, np.average(points, axis=0, weights=forces))
        if away > OFF or self.body.patches[patch].skin.domain.depth([place])[0] < 0:
            return None
        radius = float(np.sqrt(2 * (self.hands[-1 - by] if by < 0 else _OWN) * max(0.0, *depths)))
        name, hand = ("", -1 - by) if by < 0 else (self.model.body(by).name, -1)
        return Push(patch, place, self.surface(patch, place)[0], float(sum(forces)), radius, name, hand)

    def inward_step(self, patch: int, place: Floats) -> Floats:
        """Steps of all joints (rad, m) that move a place of a skin inwards by 1 m along its normal, to first order.

        Args:
            patch, place: As for `surface`.
        """
        jacobian = np.zeros((3, self.model.nv))
        point, normal = self.surface(patch, place)
        link = self.model.body(self.body.patches[patch].patch.frame).id
        mujoco.mj_jac(self.model, self.data, jacobian, None, point, link)
        along = normal @ jacobian @ self._ties
        return np.asarray(self._ties @ (-along / (along @ along + 1e-3)))

    def aim(self, joints: Floats) -> None:
        """Set the servos' targets, positions (n_joints,) of the `joints` (rad, m), within their limits; joints that
        mimic others follow these."""
        self.target = np.clip(self._tied(joints), self.low, self.high)

    def rest(self, time: float) -> Floats:
        """Joint positions (rad, m) of the robot's own slow movement at a `time` (s)."""
        numbers = np.arange(len(self._still))
        return self._tied(self._still + _MOTION * np.sin((0.5 + 0.13 * numbers) * time))


def above(simulation: RobotSimulation, patch: int, place: Floats, height: float, radius: float = FINGER) -> Floats:
    """Where (3,) the middle of a tip of some radius is when it is `height` above a place (2,) of a skin (m)."""
    point, normal = simulation.surface(patch, place)
    return np.asarray(point + (radius + height) * normal)
