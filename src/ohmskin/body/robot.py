"""A robot as its URDF file describes it: links, joints at given positions, and what the links look like."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from ohmskin.arrays import Floats
from ohmskin.client.contacts import PlacedContact
from ohmskin.errors import SkinError
from ohmskin.skin.checks import is_number
from ohmskin.skin.urdf import numbers_of, pose_of, read_urdf

_TURNS, _SLIDES = ("revolute", "continuous"), ("prismatic",)
_STILL = ("fixed", "floating", "planar")
_SIZES = {
    "box": ("size", 3),
    "cylinder": ("radius length", 2),
    "capsule": ("radius length", 2),
    "sphere": ("radius", 1),
}
_GREY = "0.78 0.81 0.85 1"


@dataclass(frozen=True)
class Joint:
    """What moves one link against another.

    Args:
        parent, child: The links.
        kind: As URDF has it: revolute, continuous, prismatic; fixed; floating and planar, which stand still here, for
            joint states do not have their poses.
        origin: Pose (4, 4) of the child in the parent at position zero (m).
        axis: Unit vector (3,) in the child.
        limits: Least and greatest position (rad, m); infinite where the file gives none.
        mimics: Joint whose position determines that of this one; None if it has a position of its own.
        multiplier, offset: Its position is that of the joint it mimics times `multiplier`, plus `offset` (rad, m).
    """

    parent: str
    child: str
    kind: str
    origin: Floats
    axis: Floats
    limits: tuple[float, float] = (-np.inf, np.inf)
    mimics: str | None = None
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether it has a position."""
        return self.kind in _TURNS + _SLIDES

    def pose(self, position: float) -> Floats:
        """Pose (4, 4) of the child in the parent at a position (rad, m)."""
        moved = np.eye(4)
        if self.kind in _TURNS:
            moved[:3, :3] = Rotation.from_rotvec(position * self.axis).as_matrix()
        elif self.kind in _SLIDES:
            moved[:3, 3] = position * self.axis
        return np.asarray(self.origin @ moved)


@dataclass(frozen=True)
class Robot:
    """Where the links of a robot are while its joints stand still, and what they look like.

    Args:
        links: Pose (4, 4) of each link in the frame of the root link (m).
        visuals: For each simple shape: link, pose (4, 4) in it, shape, size (m) in URDF's order, colour (RGB, 0 to 1);
            of a link without a visual, its collision shapes.
        unseen: Links that have a mesh, which is not shown.
        joints: Its joints by name, in the order of the file.
        positions: Of joints that do not stand at zero (rad, m).
    """

    links: Mapping[str, Floats]
    visuals: tuple[dict[str, Any], ...] = ()
    unseen: tuple[str, ...] = ()
    joints: Mapping[str, Joint] = field(default_factory=dict)
    positions: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path, joints: Mapping[str, Any] | None = None) -> "Robot":
        """Read a URDF file.

        Args:
            path: The file.
            joints: Positions of joints (rad, m); zero unless given.

        Raises:
            SkinError: If it cannot be read or is no URDF file, or a joint is unknown, mimics another or its position is
                no number.
        """
        root = read_urdf(path)
        names = [link.get("name", "") for link in root.findall("link")]
        try:
            table = _joints(names, root.findall("joint"))
            links = _links(names, table, joints or {})
            if follower := next((name for name in joints or {} if table[name].mimics), None):
                raise SkinError(f"joint {follower!r} mimics {table[follower].mimics!r}; give that joint's position")
            visuals = [found for link in root.findall("link") for found in _visuals(link, root)]
        except SkinError as error:
            raise SkinError(f"{path}: {error}") from None
        shown = tuple(visual for visual in visuals if visual["shape"] != "mesh")
        unseen = dict.fromkeys(visual["link"] for visual in visuals if visual["shape"] == "mesh")
        return cls(links, shown, tuple(unseen), table, dict(joints or {}))

    @property
    def root(self) -> str:
        """The link that hangs on no other, in whose frame all poses are."""
        children = {joint.child for joint in self.joints.values()}
        return next(name for name in self.links if name not in children)

    @property
    def independent(self) -> tuple[str, ...]:
        """Names of the joints that have a position of their own, which determine the posture."""
        return tuple(name for name, joint in self.joints.items() if joint.moves and joint.mimics is None)

    def posed(self, joints: Mapping[str, Any]) -> "Robot":
        """The robot with its joints at other positions.

        Args:
            joints: Positions of joints (rad, m); zero unless given. Those of joints that mimic others are not used.

        Raises:
            SkinError: If a joint is unknown or its position no number.
        """
        return replace(self, links=_links(list(self.links), self.joints, joints), positions=dict(joints))

    def place(self, contacts: Sequence[PlacedContact], frame: str = "") -> tuple[PlacedContact, ...]:
        """Contacts on its links in the frame of one link, that of the root unless given.

        Raises:
            SkinError: If there is no such link.
        """
        frame = frame or self.root
        if unknown := {frame, *(contact.frame for contact in contacts)} - set(self.links):
            raise SkinError(f"there is no link {min(unknown)!r}; the links are {', '.join(list(self.links)[:20])}")
        return tuple(
            contact.moved(np.linalg.solve(self.links[frame], self.links[contact.frame]).tolist(), frame)
            for contact in contacts
        )

    def as_json(self) -> dict[str, Any]:
        """Its description for a page, as JSON has it; poses row by row."""
        visuals = [visual | {"pose": visual["pose"].ravel().tolist()} for visual in self.visuals]
        return {"links": {name: pose.ravel().tolist() for name, pose in self.links.items()}, "visuals": visuals}


def _joints(names: list[str], found: list[Element]) -> dict[str, Joint]:
    """All joints by name."""
    if wrong := [name for name, count in Counter(names).items() if count > 1 or not name]:
        raise SkinError(f"links must have names of their own; correct {', '.join(map(repr, wrong[:20]))}")
    children: set[str] = set()
    joints: dict[str, Joint] = {}
    for joint in found:
        name, kind = joint.get("name", ""), joint.get("type", "fixed")
        parent, child = (
            end.get("link", "") if (end := joint.find(tag)) is not None else "" for tag in ("parent", "child")
        )
        if parent not in names or child not in names or child in children:
            raise SkinError(f"joint {name!r} connects link {parent!r} to {child!r}; each link has one parent at most")
        if not name or name in joints:
            raise SkinError(f"joint {name!r} from link {parent!r} to {child!r} must have a name of its own")
        children.add(child)
        given, limit = joint.find("axis"), joint.find("limit")
        axis = numbers_of("1 0 0" if given is None else given.get("xyz", ""), 3, f"the axis of joint {name!r}")
        if kind in _STILL:
            axis = np.array([1.0, 0.0, 0.0])  # whatever stands there
        elif kind not in (*_TURNS, *_SLIDES) or not np.linalg.norm(axis) > 0:
            raise SkinError(
                f"joint {name!r} is of type {kind!r} about {axis}; choose from {', '.join(_TURNS + _SLIDES + _STILL)}"
            )
        limits = (-np.inf, np.inf)
        if limit is not None and kind != "continuous":
            words = f"{limit.get('lower', '0')} {limit.get('upper', '0')}"
            limits = tuple(numbers_of(words, 2, f"the limit of joint {name!r}").tolist())
        joints[name] = Joint(parent, child, kind, pose_of(joint), axis / np.linalg.norm(axis), limits, *_mimic(joint))
    if len(roots := [name for name in names if name not in children]) > 1:
        raise SkinError(f"links {', '.join(roots[:20])} are on no joint as its child; only one, the root, may be so")
    return {name: _resolved(name, joints) for name in joints}


def _mimic(joint: Element) -> tuple[str | None, float, float]:
    """The joint that a joint mimics, multiplier and offset."""
    if (mimic := joint.find("mimic")) is None:
        return None, 1.0, 0.0
    words = f"{mimic.get('multiplier', '1')} {mimic.get('offset', '0')}"
    multiplier, offset = numbers_of(words, 2, f"multiplier and offset of joint {joint.get('name')!r}").tolist()
    return mimic.get("joint", ""), multiplier, offset


def _resolved(name: str, joints: Mapping[str, Joint]) -> Joint:
    """The joint; one that mimics others mimics the last of their chain, which has a position of its own."""
    joint, passed, at = joints[name], {name}, name
    while (source := joints[at].mimics) is not None:
        if source in passed or source not in joints:
            why = "in a circle" if source in passed else "which is not in the file"
            raise SkinError(f"joint {at!r} mimics {source!r}, {why}; let it mimic a joint with a position of its own")
        passed.add(source)
        if (further := joints[source]).mimics is not None:
            multiplier, offset = joint.multiplier * further.multiplier, joint.multiplier * further.offset + joint.offset
            joint = replace(joint, mimics=further.mimics, multiplier=multiplier, offset=offset)
        at = source
    return joint


def _links(names: list[str], joints: Mapping[str, Joint], positions: Mapping[str, Any]) -> dict[str, Floats]:
    """The pose of each link: forward kinematics."""
    for name, position in positions.items():
        if name not in joints:
            raise SkinError(f"there is no joint {name!r}; the joints are {', '.join(list(joints)[:20]) or 'none'}")
        if not is_number(position) or not abs(position) < 1e3:
            raise SkinError(f"joint {name!r} is at {position!r}; it must be a number (rad or m)")
    above = {}
    for name, joint in joints.items():
        position = joint.multiplier * positions.get(joint.mimics or name, 0.0) + joint.offset
        above[joint.child] = joint.parent, joint.pose(position)
    poses: dict[str, Floats] = {}
    for name in names:
        pose, at, steps = np.eye(4), name, 0
        while at in above:
            at, step = above[at]
            pose, steps = step @ pose, steps + 1
            if steps > len(names):
                raise SkinError(f"the joints above link {name!r} form a cycle")
        poses[name] = pose
    return poses


def _visuals(link: Element, root: Element) -> list[dict[str, Any]]:
    colours = {given.get("name"): given.find("color") for given in root.findall("material")}
    name, found = link.get("name", ""), []
    for visual in link.findall("visual") or link.findall("collision"):
        geometry, material = visual.find("geometry"), visual.find("material")
        if geometry is None or not len(geometry):
            raise SkinError(f"a {visual.tag} of link {name!r} has no geometry")
        colour = None if material is None else material.find("color")
        if material is not None and colour is None:
            colour = colours.get(material.get("name"))
        what, shape = f"the {visual.tag} of link {name!r}", geometry[0].tag
        size: list[float] = []
        if shape in _SIZES:
            words, count = _SIZES[shape]
            size = numbers_of(" ".join(geometry[0].get(word, "") for word in words.split()), count, what).tolist()
        elif shape != "mesh":
            raise SkinError(f"{what} is a {shape!r}; choose from {', '.join(_SIZES)} and mesh")
        rgb = numbers_of(_GREY if colour is None else colour.get("rgba", ""), 4, f"the colour of {what}")[:3]
        found.append({"link": name, "pose": pose_of(visual), "shape": shape, "size": size, "colour": rgb.tolist()})
    return found
