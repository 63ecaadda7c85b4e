"""Skins that are cut from a link's mesh by a name, a place or planes: OBJ, STL, Gmsh, URDF."""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from test_meshed import FOREARM, link

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import GeometryError, SkinError
from ohmskin.geometry import Mesh, write_mesh
from ohmskin.geometry.regions import read_triangles
from ohmskin.geometry.surface import check_outside, pieces
from ohmskin.skin import Skin

WALL = 'file = "forearm.obj"\nscale = 1e-3\nregion = "wall"'


def parts() -> tuple[Floats, dict[str, Ints]]:
    """A closed link: its wall, bent, and its two flat ends."""
    nodes, triangles = link(20, 32)
    wall = len(triangles) - 64
    return nodes, {"wall": triangles[:wall], "foot": triangles[wall : wall + 32], "top": triangles[wall + 32 :]}


def skin_file(folder: Path, sheet: str) -> Path:
    given = FOREARM[: FOREARM.index("file")] + sheet + "\n" + FOREARM[FOREARM.index("[electrode]") :]
    (folder / "skin.toml").write_text(given)
    return folder / "skin.toml"


def obj(folder: Path, scale: float = 1e3, quads: bool = False) -> None:
    """The link as CAD programs write it: a group and a material for each part, four corners where there can be."""
    nodes, named = parts()
    lines = ["# a link", *("v {} {} {}".format(*scale * node) for node in nodes), "vn 0 0 1", "o forearm"]
    for name, triangles in named.items():
        lines += [f"g {name} all", f"usemtl {name}-paint"]
        if quads and name == "wall":
            pairs = zip(*np.split(triangles, 2), strict=True)
            lines += ["f {}/1/1 {}//1 {} {}".format(*(one + 1), other[2] + 1) for one, other in pairs]
        else:
            lines += ["f {} {} {}".format(*(corners - len(nodes))) for corners in triangles]
    (folder / "forearm.obj").write_text("\n".join(lines))


def solids(path: Path, nodes: Floats, named: dict[str, Ints]) -> None:
    """An STL file of text, of a solid for each name."""
    lines = []
    for name, triangles in named.items():
        lines.append(f"solid {name}")
        for corners in nodes[triangles]:
            places = ("vertex {:.9e} {:.9e} {:.9e}".format(*at) for at in corners)
            lines += ["facet normal 0 0 0", "outer loop", *places, "endloop", "endfacet"]
        lines.append(f"endsolid {name}")
    path.write_text("\n".join(lines))


def area(skin: Skin) -> float:
    return float(skin.domain.area)


def wall_area() -> float:
    nodes, named = parts()
    return float(Mesh(*_used(nodes, named["wall"])).measures.sum())


def _used(nodes: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    used, own = np.unique(triangles, return_inverse=True)
    return nodes[used], own.reshape(-1, 3)


@pytest.mark.parametrize("quads", [False, True])
@pytest.mark.parametrize("region", ["wall", "wall-paint"])
def test_a_group_or_a_material_of_an_obj_file_is_a_skin(quads: bool, region: str, tmp_path: Path) -> None:
    obj(tmp_path, quads=quads)
    skin = Skin.load(skin_file(tmp_path, WALL.replace('"wall"', f'"{region}"')))
    assert area(skin) == pytest.approx(wall_area(), rel=1e-3)
    assert skin.domain.period  # a ring, whose ends are the rims
    assert Skin.parse(skin.dump()) == skin


def test_a_solid_of_an_stl_file_is_a_skin(tmp_path: Path) -> None:
    nodes, named = parts()
    solids(tmp_path / "forearm.stl", 1e3 * nodes, named)
    skin = Skin.load(skin_file(tmp_path, WALL.replace(".obj", ".stl")))
    assert area(skin) == pytest.approx(wall_area(), rel=1e-3)


def test_a_physical_surface_of_gmsh_and_a_set_of_elements_are_regions(tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio")
    nodes, named = parts()
    everything = np.vstack(list(named.values()))
    tags = np.repeat([1, 2, 3], [len(part) for part in named.values()])
    data = meshio.Mesh(
        nodes,
        [("triangle", everything)],
        cell_data={"gmsh:physical": [tags], "gmsh:geometrical": [tags]},
        field_data={name: np.array([k + 1, 2]) for k, name in enumerate(named)},
    )
    data.write(tmp_path / "link.msh", file_format="gmsh22")
    found, triangles = read_triangles(tmp_path / "link.msh", "top")
    np.testing.assert_allclose(found[triangles].reshape(-1, 3)[:, 2], 0.3)
    sets = meshio.Mesh(nodes, [("triangle", everything)], cell_sets={"FOOT": [np.flatnonzero(tags == 2)]})
    sets.write(tmp_path / "link.inp")
    found, triangles = read_triangles(tmp_path / "link.inp", "FOOT")
    np.testing.assert_allclose(found[triangles].reshape(-1, 3)[:, 2], 0.0)


def test_a_place_chooses_the_part_up_to_its_creases(tmp_path: Path) -> None:
    """An STL file of one unnamed solid: the wall of a link ends where its ends begin."""
    nodes, named = parts()
    write_mesh(tmp_path / "forearm.stl", Mesh(1e3 * nodes, np.vstack(list(named.values()))))
    sheet = 'file = "forearm.stl"\nscale = 1e-3\nseed = [0.08, 0.0, 0.15]'
    assert area(Skin.load(skin_file(tmp_path, sheet))) == pytest.approx(wall_area(), rel=1e-3)
    top = Skin.load(skin_file(tmp_path, sheet.replace("0.08, 0.0, 0.15", "0.01, 0.0, 0.3")))
    assert area(top) == pytest.approx(np.pi * 0.035**2, rel=0.02)
    with pytest.raises(SkinError, match="closed; cut it open"):
        Skin.load(skin_file(tmp_path, f"{sheet}\ncrease = 3.0"))
    cut = f"{sheet}\ncut = [[0, 0, 1, 0.1], [1, 0, 0, 0.02]]"
    assert area(Skin.load(skin_file(tmp_path, cut))) < 0.5 * wall_area()


def test_pieces_that_do_not_touch_are_told_and_a_place_chooses_one(tmp_path: Path) -> None:
    nodes, named = parts()
    both = np.vstack([nodes, nodes + np.array([0.2, 0, 0])])
    triangles = np.vstack([named["wall"], named["wall"] + len(nodes)])
    solids(tmp_path / "two.stl", both, {"two": triangles})
    with pytest.raises(SkinError, match="2 separate pieces; choose one by seed"):
        Skin.load(skin_file(tmp_path, 'file = "two.stl"'))
    skin = Skin.load(skin_file(tmp_path, 'file = "two.stl"\nseed = [0.25, 0.0, 0.01]'))
    assert area(skin) == pytest.approx(wall_area(), rel=1e-3)
    assert skin.chart.points(skin.electrodes.positions)[:, 0].min() > 0.1
    np.testing.assert_array_equal(np.unique(pieces(both, triangles)), [0, 1])


ROBOT = """<robot name="r"><link name="base"/><link name="forearm">
<visual><geometry><box size="1 1 1"/></geometry></visual>
<visual name="shell"><origin xyz="0 0 0.5" rpy="0 0 1.5708"/>
  <geometry><mesh filename="package://my_robot/meshes/forearm.obj" scale="0.001 0.001 0.001"/></geometry></visual>
<visual><geometry><mesh filename="package://my_robot/meshes/motor.stl"/></geometry></visual></link></robot>"""


def test_a_visual_of_a_urdf_link_is_a_skin_in_the_frame_of_the_link(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    obj(tmp_path / "meshes")
    (tmp_path / "robot.urdf").write_text(ROBOT)
    sheet = 'file = "robot.urdf"\nlink = "forearm"\nvisual = "shell"\nregion = "wall"'
    skin = Skin.load(skin_file(tmp_path, sheet))
    assert area(skin) == pytest.approx(wall_area(), rel=1e-3)
    points = skin.chart.points(skin.mesh().nodes)
    np.testing.assert_allclose([points[:, 2].min(), points[:, 2].max()], [0.5, 0.8], atol=1e-6)
    assert points[:, 1].max() > 0.07  # the bend, along x in the file, is turned to y
    assert abs(points[:, 0]).max() < 0.055
    assert skin.sheet.link == skin.sheet.visual == skin.sheet.region == ""


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (
            ('"wall"', '"walls"'),
            "no region 'walls'; its regions are all, foot, foot-paint, forearm, top, top-p",
        ),
        (
            ('"shell"', '"box"'),
            "link 'forearm' has 2 meshes, and visual is 'box'; choose sheet.visual from shell",
        ),
        (('\nvisual = "shell"', ""), "choose sheet.visual from shell, motor"),
        (('"forearm"', '"base"'), "no link 'base' with a mesh; links with meshes are forearm"),
        (('"shell"', '"motor"'), "mesh 'package://my_robot/meshes/motor.stl' of link 'forearm' is not there"),
        (('"robot.urdf"', '"skin.toml"'), "is not valid XML"),
        (('"wall"', '"wall"\nseed = [0.0, 0.0]'), "it must be a place"),
        (('"wall"', '"wall"\nseed = [9.0, 0.0, 0.0]'), r"seed \[9.0, 0.0, 0.0\] is .* m off a surface"),
    ],
)
def test_what_cannot_be_found_is_told_with_what_there_is(changed: tuple[str, str], told: str, tmp_path: Path) -> None:
    obj(tmp_path)
    (tmp_path / "robot.urdf").write_text(ROBOT)
    sheet = 'file = "robot.urdf"\nlink = "forearm"\nvisual = "shell"\nregion = "wall"'.replace(*changed)
    with pytest.raises(SkinError, match=told):
        Skin.load(skin_file(tmp_path, sheet))


def inside_out(nodes: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    return nodes, triangles[:, ::-1]


def not_a_number(nodes: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    return np.where(np.arange(len(nodes))[:, None] == triangles[7, 1], np.nan, nodes), triangles


@pytest.mark.parametrize(
    ("closed", "spoilt", "told"),
    [
        (False, inside_out, "clockwise seen from outside; reverse them"),
        (True, inside_out, "clockwise seen from outside; reverse them"),
        (False, not_a_number, r"a corner of triangle \d+ is not a finite number"),
        (
            False,
            lambda nodes, triangles: (1e3 * nodes, triangles),
            "m large, 10 m are allowed; give scale, which is 1e-3",
        ),
    ],
    ids=["tube inside out", "closed and inside out", "nan", "millimetres"],
)
def test_a_mesh_that_would_make_a_wrong_skin_is_refused(
    closed: bool, spoilt: Callable[[Floats, Ints], tuple[Floats, Ints]], told: str, tmp_path: Path
) -> None:
    nodes, named = parts()
    triangles = np.vstack(list(named.values())) if closed else named["wall"]
    sheet = 'file = "forearm.stl"\ncut = [[0, 0, 1, 0.08], [0, 0, -1, -0.24]]'
    solids(tmp_path / "forearm.stl", nodes, {"wall": triangles})
    Skin.load(skin_file(tmp_path, sheet))
    nodes, triangles = spoilt(nodes, triangles)
    solids(tmp_path / "forearm.stl", nodes, {"wall": triangles})
    with pytest.raises(SkinError, match=told):
        Skin.load(skin_file(tmp_path, sheet))


@pytest.mark.parametrize("depth", [0.0, 0.02, -0.02, -0.2])
@pytest.mark.parametrize("hole", [0.002, 0.02, 0.09])
def test_flat_rings_and_bowls_with_holes_may_be_worn_inside(depth: float, hole: float) -> None:
    """A round sheet with a round hole, level, or bent to either side; the deepest with the widest hole is a tube."""
    t, phi = np.linspace(0, 1, 9)[:, None], 2 * np.pi * np.arange(24) / 24
    radius = 0.1 + (hole - 0.1) * t
    nodes = np.stack([radius * np.cos(phi), radius * np.sin(phi), depth * t + 0 * phi], axis=2).reshape(-1, 3)
    number = np.arange(9 * 24).reshape(9, 24)
    a, b, c, d = number[:-1], np.roll(number[:-1], -1, axis=1), np.roll(number[1:], -1, axis=1), number[1:]
    triangles = np.vstack([np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))])
    tube = (depth, hole) == (-0.2, 0.09)
    with pytest.raises(GeometryError, match="reverse them") if tube else nullcontext():
        check_outside(nodes, triangles)
    if depth <= 0:
        check_outside(*inside_out(nodes, triangles))


def test_an_empty_file_has_no_triangles(tmp_path: Path) -> None:
    (tmp_path / "forearm.stl").write_bytes(b"")
    with pytest.raises(SkinError, match="has no triangles"):
        Skin.load(skin_file(tmp_path, 'file = "forearm.stl"'))


@pytest.mark.parametrize("text", ["f 1 2 3", "v 1 2\nv 3 4\n", "v a b c", "f", "v 0 0 0\nf 1 2 -7", "v 0 0 0\nf 1/x b"])
def test_an_obj_file_that_is_none_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "bad.obj").write_text(text)
    with pytest.raises(GeometryError, match=r"cannot read mesh file|no triangles"):
        read_triangles(tmp_path / "bad.obj")
