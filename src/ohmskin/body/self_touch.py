"""Self-touch distinguished from touch by others: whether another link of the robot is where a contact is."""

from collections.abc import Sequence
from dataclasses import replace
from math import inf, isnan
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.body.body import Body
from ohmskin.body.robot import Robot
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
        self._body, self._rigid = body, _rigid(body.robot)
        self._sure = not body.robot.unseen

    def with_self_touch(self, robot: Robot, contacts: Sequence[PlacedContact]) -> tuple[PlacedContact, ...]:
        """The same contacts, with their `self_touch` determined.

        It is None where nothing is near but a link has a mesh, whose shape is not known here.

        Args:
            robot: In the posture of that moment.
            contacts: In the frames of its links.
        """
        with_self_touch = []
        for contact, placed in zip(contacts, robot.place(contacts), strict=True):
            spread = _UNKNOWN if isnan(contact.spread) else contact.spread
            own = self.nearest(robot, np.array(placed.position), contact.frame)[1] <= _GAP + _SURE * spread
            with_self_touch.append(replace(contact, self_touch=own if own or self._sure else None))
        return tuple(with_self_touch)

    def nearest(self, robot: Robot, point: Floats, link: str) -> tuple[str, float]:
        """The surface closest to a point, among all links that can move relative to its link.

        Args:
            robot: In the posture of that moment.
            point: (3,) in the frame of the root (m).
            link: Whose surface the point is on.

        Returns:
            The link of that surface, empty if there is none, and how far it is (m), below zero within a simple shape.
        """
        found = ("", inf)
        for visual in robot.visuals:
            if self._rigid[visual["link"]] != self._rigid[link]:
                pose = robot.links[visual["link"]] @ visual["pose"]
                away = distance_to((point - pose[:3, 3]) @ pose[:3, :3], visual)
                found = min(found, (visual["link"], away), key=lambda one: one[1])
        for placed in self._body.patches:
            if self._rigid[placed.patch.frame] != self._rigid[link]:
                pose = robot.links[placed.patch.frame]
                local = (point - pose[:3, 3]) @ pose[:3, :3] - placed.patch.position
                away = float(placed.skin.chart.project(np.array(placed.patch.axes) @ local)[1][0])
                found = min(found, (placed.patch.frame, away), key=lambda one: one[1])
        return found


def _rigid(robot: Robot) -> dict[str, str]:
    """For each link the first one, from the root on, that it cannot move against."""
    above = {joint.child: joint for joint in robot.joints.values() if not joint.moves}
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
