"""What a skin and a robot both need of a URDF file: its XML, origins and numbers, and the meshes of its links."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from ohmskin.arrays import Floats
from ohmskin.errors import SkinError
from ohmskin.skin.checks import read_text, sibling_path

_LARGEST = 16 * 2**20
_LISTED = 20


@dataclass(frozen=True)
class LinkMesh:
    """A mesh that a link shows.

    Args:
        path: Its file.
        scale: Metres per unit of the file (3,), along its axes.
        pose: Where it is in the link (4, 4) (m).
    """

    path: Path
    scale: Floats
    pose: Floats

    def placed(self, nodes: Floats) -> Floats:
        """Nodes (n, 3) of the file, in the link's frame (m)."""
        return np.asarray(nodes * self.scale @ self.pose[:3, :3].T + self.pose[:3, 3])


def read_urdf(path: Path) -> Element:
    """The root of a URDF file.

    Raises:
        SkinError: If it cannot be read or is no URDF file.
    """
    text = read_text(path, _LARGEST, "URDF file")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # entities can grow without bound and fetch other files
        raise SkinError(f"{path} declares XML entities, which a URDF file does not need; remove them")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise SkinError(f"{path} is not valid XML: {error}") from error
    if root.tag != "robot" or root.find("link") is None:
        raise SkinError(f"{path} is not a URDF file: it must have a <robot> with <link>s (expand xacro first)")
    return root


def link_mesh(path: Path, link: str, visual: str, folder: Path) -> LinkMesh:
    """The mesh of a link's visual.

    Args:
        path: The URDF file.
        link: The link.
        visual: Name of the visual, or of its mesh file without its ending; needed if the link has several meshes.
        folder: In which, or below which, the mesh file must lie. Of ``package://NAME/PATH`` and of paths that are not
            there, the longest end that is there is taken.

    Raises:
        SkinError: If there is no such link or mesh, or its file is not there.
    """
    root = read_urdf(path)
    shown = {one.get("name", ""): _meshes(one) for one in root.findall("link")}
    if not (found := shown.get(link, {})):
        there = ", ".join([name for name, meshes in shown.items() if meshes][:_LISTED]) or "none"
        raise SkinError(f"{path.name} has no link {link!r} with a mesh; links with meshes are {there}")
    names = [visual] if visual else list(found)
    if len(names) > 1 or names[0] not in found:
        choice = f"choose sheet.visual from {', '.join(list(found)[:_LISTED])}"
        raise SkinError(f"link {link!r} has {len(found)} meshes, and visual is {visual!r}; {choice}")
    element = found[names[0]]
    mesh = element.find("geometry/mesh")
    assert mesh is not None
    scale = numbers_of(mesh.get("scale", "1 1 1"), 3, f"the scale of a mesh of link {link!r}")
    if not (scale > 0).all():
        raise SkinError(f"the scale of a mesh of link {link!r} is {scale.tolist()}; it must be positive")
    filename = mesh.get("filename", "")
    parts = [part for part in re.sub(r"^[a-z]+://", "", filename).split("/") if part not in ("", ".", "..")]
    ends = (Path(base, *parts[k:]) for k in range(len(parts)) for base in (path.parent, folder))
    file = next((end for end in ends if end.is_file()), None)
    if file is None:
        raise SkinError(f"mesh {filename!r} of link {link!r} is not there; put it beside the skin file")
    file = sibling_path(folder, str(file.resolve()), "a mesh of the URDF file", "skin file")
    return LinkMesh(file, scale, pose_of(element))


def _meshes(link: Element) -> dict[str, Element]:
    """The visuals of a link that are meshes, by name."""
    found: dict[str, Element] = {}
    for visual in link.findall("visual"):
        if (mesh := visual.find("geometry/mesh")) is not None:
            stem = Path(mesh.get("filename", "").rpartition("/")[2]).stem
            found[visual.get("name") or stem] = visual
    return found


def pose_of(element: Element) -> Floats:
    """The origin of a joint or a visual (4, 4).

    Raises:
        SkinError: If it is not of numbers.
    """
    pose, origin = np.eye(4), element.find("origin")
    if origin is not None:
        pose[:3, 3] = numbers_of(origin.get("xyz", "0 0 0"), 3, "an origin's xyz")
        turn = numbers_of(origin.get("rpy", "0 0 0"), 3, "an origin's rpy")
        pose[:3, :3] = Rotation.from_euler("xyz", turn).as_matrix()
    return pose


def numbers_of(text: str, count: int, what: str) -> Floats:
    """So many numbers (n,) of a text.

    Raises:
        SkinError: If it has others; the message says of `what`.
    """
    words = text.split()
    if len(words) != count or not all(
        re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,2})?", word) for word in words
    ):
        raise SkinError(f"{what} is {text!r}; it must be {count} numbers")
    return np.array([float(word) for word in words])
