"""A robot as its URDF file describes it: links, joints at given positions, and what the links look like."""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from ohmskin.arrays import Floats
from ohmskin.errors import SkinError
from ohmskin.skin.checks import is_number, read_text

_LARGEST = 16 * 2**20
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
class Robot:
    """Where the links of a robot are while its joints stand still, and what they look like.

    Args:
        links: Pose (4, 4) of each link in the frame of the root link (m).
        visuals: For each simple shape: link, pose (4, 4) in it, shape, size (m) in URDF's order, colour (RGB, 0 to 1).
        unseen: Links that have a mesh, which is not shown.
    """

    links: Mapping[str, Floats]
    visuals: tuple[dict[str, Any], ...] = ()
    unseen: tuple[str, ...] = ()

    @classmethod
    def load(cls, path: Path, joints: Mapping[str, Any] | None = None) -> "Robot":
        """Read a URDF file.

        Args:
            path: The file.
            joints: Positions of joints (rad, m); zero unless given.

        Raises:
            SkinError: If it cannot be read or is no URDF file, or a joint is unknown or its position no number.
        """
        text = read_text(path, _LARGEST, "URDF file")
        if "<!DOCTYPE" in text or "<!ENTITY" in text:  # entities can grow without bound and fetch other files
            raise SkinError(f"{path} declares XML entities, which a URDF file does not need; remove them")
        try:
            root = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError) as error:
            raise SkinError(f"{path} is not valid XML: {error}") from error
        names = [link.get("name", "") for link in root.findall("link")]
        if root.tag != "robot" or not names:
            raise SkinError(f"{path} is no URDF file: it must have a <robot> with <link>s (expand xacro first)")
        try:
            links = _links(names, root.findall("joint"), joints or {})
            visuals = [found for link in root.findall("link") for found in _visuals(link, root)]
        except SkinError as error:
            raise SkinError(f"{path}: {error}") from None
        shown = tuple(visual for visual in visuals if visual["shape"] != "mesh")
        unseen = dict.fromkeys(visual["link"] for visual in visuals if visual["shape"] == "mesh")
        return cls(links, shown, tuple(unseen))

    def told(self) -> dict[str, Any]:
        """What a page is told of it, as JSON has it; poses row by row."""
        visuals = [visual | {"pose": visual["pose"].ravel().tolist()} for visual in self.visuals]
        return {"links": {name: pose.ravel().tolist() for name, pose in self.links.items()}, "visuals": visuals}


def _links(names: list[str], joints: list[Element], positions: Mapping[str, Any]) -> dict[str, Floats]:
    """The pose of each link: forward kinematics."""
    above: dict[str, tuple[str, Floats]] = {}
    known = {joint.get("name", ""): joint for joint in joints}
    if unknown := next((name for name in positions if name not in known), None):
        raise SkinError(f"there is no joint {unknown!r}; the joints are {', '.join(list(known)[:20]) or 'none'}")
    for name, joint in known.items():
        ends = [end.get("link", "") if (end := joint.find(tag)) is not None else "" for tag in ("parent", "child")]
        if ends[0] not in names or ends[1] not in names or ends[1] in above:
            raise SkinError(
                f"joint {name!r} goes from link {ends[0]!r} to {ends[1]!r}; each link has one parent at most"
            )
        above[ends[1]] = ends[0], _pose(joint) @ _moved(name, joint, positions.get(name, 0.0))
    poses: dict[str, Floats] = {}
    for name in names:
        pose, at, steps = np.eye(4), name, 0
        while at in above:
            at, step = above[at]
            pose, steps = step @ pose, steps + 1
            if steps > len(names):
                raise SkinError(f"the joints above link {name!r} go round in a circle")
        poses[name] = pose
    return poses


def _moved(name: str, joint: Element, position: Any) -> Floats:
    """What the position of a joint does."""
    if not is_number(position) or not abs(position) < 1e3:
        raise SkinError(f"joint {name!r} is at {position!r}; it must be a number (rad or m)")
    kind, moved = joint.get("type", "fixed"), np.eye(4)
    found = joint.find("axis")
    axis = _numbers("1 0 0" if found is None else found.get("xyz", ""), 3, f"the axis of joint {name!r}")
    if kind not in (*_TURNS, *_SLIDES, *_STILL) or not np.linalg.norm(axis) > 0:
        raise SkinError(
            f"joint {name!r} is of type {kind!r} about {axis}; choose from {', '.join(_TURNS + _SLIDES + _STILL)}"
        )
    axis /= np.linalg.norm(axis)
    if kind in _TURNS:
        moved[:3, :3] = Rotation.from_rotvec(position * axis).as_matrix()
    elif kind in _SLIDES:
        moved[:3, 3] = position * axis
    return moved


def _visuals(link: Element, root: Element) -> list[dict[str, Any]]:
    colours = {given.get("name"): given.find("color") for given in root.findall("material")}
    name, found = link.get("name", ""), []
    for visual in link.findall("visual"):
        geometry, material = visual.find("geometry"), visual.find("material")
        if geometry is None or not len(geometry):
            raise SkinError(f"a visual of link {name!r} has no geometry")
        colour = None if material is None else material.find("color")
        if material is not None and colour is None:
            colour = colours.get(material.get("name"))
        what, shape = f"the visual of link {name!r}", geometry[0].tag
        size: list[float] = []
        if shape in _SIZES:
            words, count = _SIZES[shape]
            size = _numbers(" ".join(geometry[0].get(word, "") for word in words.split()), count, what).tolist()
        elif shape != "mesh":
            raise SkinError(f"{what} is a {shape!r}; choose from {', '.join(_SIZES)} and mesh")
        rgb = _numbers(_GREY if colour is None else colour.get("rgba", ""), 4, f"the colour of {what}")[:3]
        found.append({"link": name, "pose": _pose(visual), "shape": shape, "size": size, "colour": rgb.tolist()})
    return found


def _pose(element: Element) -> Floats:
    """The origin of a joint or a visual (4, 4)."""
    pose, origin = np.eye(4), element.find("origin")
    if origin is not None:
        pose[:3, 3] = _numbers(origin.get("xyz", "0 0 0"), 3, "an origin's xyz")
        pose[:3, :3] = Rotation.from_euler(
            "xyz", _numbers(origin.get("rpy", "0 0 0"), 3, "an origin's rpy")
        ).as_matrix()
    return pose


def _numbers(text: str, count: int, what: str) -> Floats:
    words = text.split()
    if len(words) != count or not all(
        re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,2})?", word) for word in words
    ):
        raise SkinError(f"{what} is {text!r}; it must be {count} numbers")
    return np.array([float(word) for word in words])
