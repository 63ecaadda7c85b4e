"""Self-touch distinguished from touch by others: whether another link of the robot is where a contact is."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf, isnan
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.body.body import Body
from ohmskin.body.robot import Joint, Robot
from ohmskin.client.contacts import PlacedContact
from ohmskin.errors import SkinError

_GAP = 6e-3  # m between a skin and what touches it: a skin's thickness, and what the shapes of links leave out
_UNKNOWN = 5e-3  # m, standard deviation of a contact's position where the mode gives none
_SURE = 3.0  # standard deviations


class SelfTouch:
    """Detects contacts of a robot with itself.

    A contact is a self-touch if the surface of another link, a simple shape of it or a skin on it, is at the contact:
    closer than the allowed gap between surfaces plus three standard deviations of the position. Links that cannot move
    relative to the contact's own do not count.

    Args:
        body: Its skins, and the URDF file with the shapes of its links.

    Raises:
        SkinError: If it names no URDF file.
    """

    def __init__(self, body: Body) -> None:
        if body.robot is None:
            raise SkinError(f"body {body.name!r} names no URDF file, without which self-touch cannot be determined")
        self._body, self._unseen = body, body.robot.unseen
        self._rigid = _highest(body.robot, lambda joint: joint.kind == "fixed")
        self._known = _highest(body.robot, lambda joint: joint.kind == "fixed" or joint.moves)
        solid = [visual["link"] for visual in body.robot.visuals] + [placed.patch.frame for placed in body.patches]
        self._solid = {self._known[link] for link in solid}

    def with_self_touch(self, robot: Robot, contacts: Sequence[PlacedContact]) -> tuple[PlacedContact, ...]:
        """The same contacts, with their `self_touch` determined.

        It is None where nothing is near but a link has a mesh, whose shape is not known here, or a planar or floating
        joint is between a link and the contact's own, whose relative pose is not known then.

        Args:
            robot: In the posture of that moment.
            contacts: In the frames of its links.
        """
        with_self_touch = []
        for contact, placed in zip(contacts, robot.place(contacts), strict=True):
            spread = _UNKNOWN if isnan(contact.spread) else contact.spread
            own = self.nearest(robot, np.array(placed.position), contact.frame)[1] <= _GAP + _SURE * spread
            sure = not self._unseen and self._solid <= {self._known[contact.frame]}
            with_self_touch.append(replace(contact, self_touch=own if own or sure else None))
        return tuple(with_self_touch)

    def nearest(self, robot: Robot, point: Floats, link: str) -> tuple[str, float]:
        """The surface closest to a point, among all links that can move relative to its link in a known way.

        Args:
            robot: In the posture of that moment.
            point: (3,) in the frame of the root (m).
            link: Whose surface the point is on.

        Returns:
            The link of that surface, empty if there is none, and how far it is (m), below zero within a simple shape.
        """
        found = ("", inf)
        for visual in robot.visuals:
            if self._counts(visual["link"], link):
                pose = robot.links[visual["link"]] @ visual["pose"]
                away = distance_to((point - pose[:3, 3]) @ pose[:3, :3], visual)
                found = min(found, (visual["link"], away), key=lambda one: one[1])
        for placed in self._body.patches:
            if self._counts(placed.patch.frame, link):
                pose = robot.links[placed.patch.frame]
                local = (point - pose[:3, 3]) @ pose[:3, :3] - placed.patch.position
                away = float(placed.skin.chart.project(np.array(placed.patch.axes) @ local)[1][0])
                found = min(found, (placed.patch.frame, away), key=lambda one: one[1])
        return found

    def _counts(self, other: str, link: str) -> bool:
        """Whether the other link can move relative to a link, and joint states determine how."""
        return self._rigid[other] != self._rigid[link] and self._known[other] == self._known[link]


def _highest(robot: Robot, through: Callable[[Joint], bool]) -> dict[str, str]:
    """For each link the first one, from the root on, that only such joints connect it to."""
    above = {joint.child: joint for joint in robot.joints.values() if through(joint)}
    found = {}
    for link in robot.links:
        found[link] = link
        while found[link] in above:
            found[link] = above[found[link]].parent
    return found


def distance_to(point: Floats, visual: dict[str, Any]) -> float:
    """From a point (3,) in the frame of a simple shape to its surface (m); below zero within it."""
    shape, size = visual["shape"], np.array(visual["size"])
    if shape in ("sphere", "capsule"):
        half = size[1] / 2 if shape == "capsule" else 0.0
        axis = np.array([0.0, 0.0, np.clip(point[2], -half, half)])
        return float(np.linalg.norm(point - axis) - size[0])
    if shape == "cylinder":
        beyond = np.array([np.hypot(point[0], point[1]) - size[0], abs(point[2]) - size[1] / 2])
    else:
        beyond = np.abs(point) - size / 2
    return float(np.linalg.norm(np.maximum(beyond, 0.0)) + min(0.0, beyond.max()))
