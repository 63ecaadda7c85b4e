"""Skins cut from the mesh of a link: their maps against those of surfaces of revolution, and contacts on them."""

import re
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin.arrays import Floats, Ints
from ohmskin.client.contacts import Patch
from ohmskin.contacts import in_frame
from ohmskin.device.demo import demo_finger
from ohmskin.engine import Engine
from ohmskin.errors import GeometryError, SkinError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Band, Electrodes, Mesh, MeshChart, Polygon, mesh_domain, write_mesh
from ohmskin.geometry.surface import cut_off
from ohmskin.outlets.publisher import describe_domain
from ohmskin.plot.pattern import Pattern, save_pattern
from ohmskin.scan import skip
from ohmskin.skin import Skin, VirtualSkin
from ohmskin.skin.layout import ElectrodeLayout
from ohmskin.skin.sheet import Sheet
from ohmskin.skin.surface import surface_of, surface_text

ROUND = {
    "half-cylinder": Sheet(shape="cylinder", radius=0.05, height=0.25, angle=np.pi),
    "sleeve": Sheet(shape="cylinder", radius=0.045, height=0.142),
    "cone": Sheet(shape="cone", radius=0.06, top_radius=0.03, height=0.138),
    "part of a cone": Sheet(shape="cone", radius=0.06, top_radius=0.03, height=0.138, angle=2.5),
    "cap": Sheet(shape="sphere", radius=0.1, angle=1.2),
}


def meshed(name: str, size: float = 6e-3) -> Mesh:
    chart = ROUND[name].chart
    return mesh_domain(chart.domain, size).mapped(chart.points)


def link(rows: int = 40, columns: int = 48) -> tuple[Floats, Ints]:
    """A closed link, 30 cm long, as a CAD program triangulates it: a cone that is bent, with a cap at either end."""
    t, phi = np.linspace(0, 1, rows + 1), 2 * np.pi * np.arange(columns) / columns
    radius, bend = 0.05 - 0.015 * t, 0.03 * np.sin(np.pi * t)
    ring = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    body = np.concatenate(
        [radius[:, None, None] * ring + [1, 0] * bend[:, None, None], np.zeros((rows + 1, columns, 1))], 2
    )
    body[..., 2] = 0.3 * t[:, None]
    number = np.arange((rows + 1) * columns).reshape(rows + 1, columns)
    a, b = number[:-1], np.roll(number[:-1], -1, axis=1)
    c, d = np.roll(number[1:], -1, axis=1), number[1:]
    ends = len(number.ravel()) + np.arange(2)
    low, high = number[0], number[-1]
    triangles = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    triangles.append(np.stack([np.roll(low, -1), low, np.full(columns, ends[0])], axis=1))
    triangles.append(np.stack([high, np.roll(high, -1), np.full(columns, ends[1])], axis=1))
    return np.vstack([body.reshape(-1, 3), [[0, 0, 0], [0, 0, 0.3]]]), np.vstack(triangles)


def grid(count: int) -> tuple[Floats, Ints]:
    """Count x count places of a rough square, in triangles."""
    x, y = np.meshgrid(*[np.linspace(0, 0.2, count)] * 2)
    z = np.random.default_rng(1).normal(0, 1e-4, x.size)
    number = np.arange(count**2).reshape(count, count)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    triangles = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    return np.column_stack([x.ravel(), y.ravel(), z]), np.vstack(triangles)


def places_on(chart: MeshChart, count: int, inset: float) -> Floats:
    x0, y0, x1, y1 = chart.domain.bounds
    places = np.random.default_rng(1).uniform([x0, y0], [x1, y1], (6 * count, 2))
    return places[chart.domain.depth(places) > inset][:count]


# --- maps -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROUND)
def test_a_meshed_surface_has_the_resistances_and_normals_of_the_round_one(name: str) -> None:
    """Electrodes at the same points in space; the round one's map is known in closed form."""
    exact, chart = ROUND[name].chart, MeshChart(meshed(name))
    assert isinstance(chart.domain, Band if exact.domain.period else Polygon)
    assert chart.domain.area == pytest.approx(exact.domain.area, rel=3e-3)
    there = Electrodes.at(places_on(exact, 16, 0.012))  # type: ignore[arg-type]
    here = there.mapped(lambda places: chart.project(exact.points(places))[0])
    np.testing.assert_allclose(chart.points(here.positions), exact.points(there.positions), atol=2e-4)
    frames = chart.frames(here.positions)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (16, 1, 1)), atol=1e-9)
    assert np.sum(frames[:, 2] * exact.frames(there.positions)[:, 2], axis=1).min() > np.cos(np.radians(2))
    step = 1e-3
    for axis in range(2):
        ahead = step / 2 * np.eye(2)[axis]
        along = (chart.points(here.positions + ahead) - chart.points(here.positions - ahead)) / step
        np.testing.assert_allclose(along, chart.scale(here.positions)[:, None] * frames[:, axis], atol=0.06)
    pattern, volts = skip([range(16)], 5), []
    for domain, electrodes in ((exact.domain, there), (chart.domain, here)):
        mesh = mesh_domain(domain, 4e-3, electrodes.positions)
        volts.append(TransferModel(mesh, electrodes, 1e-3).voltages(pattern))
    np.testing.assert_allclose(volts[1], volts[0], atol=5e-3 * np.abs(volts[0]).max())


def test_the_map_of_a_meshed_cone_converges_with_second_order() -> None:
    sizes, errors = np.array([0.024, 0.012, 0.006]), []
    exact = ROUND["cone"].chart
    for size in sizes:
        domain = MeshChart(meshed("cone", size)).domain
        errors.append(abs(domain.area / exact.domain.area - 1))
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] > 1.7


@pytest.mark.parametrize("name", ["half-cylinder", "part of a cone", "sleeve"])
def test_a_developable_surface_unrolls_true_to_lengths(name: str) -> None:
    chart = MeshChart(meshed(name, 4e-3))
    assert chart.flat
    np.testing.assert_allclose(chart.scale(places_on(chart, 200, 1e-3)), 1.0, atol=1e-3)


def test_points_above_a_meshed_skin_are_found_on_its_map() -> None:
    for name in ROUND:
        chart = MeshChart(meshed(name))
        places = places_on(chart, 100, 5e-3)
        found, away = chart.project(chart.points(places) + 3e-3 * chart.frames(places)[:, 2])
        off = found - places
        off[:, 0] -= chart.domain.period * np.rint(off[:, 0] / (chart.domain.period or np.inf))
        assert np.linalg.norm(off, axis=1).max() < 6e-4
        np.testing.assert_allclose(away, 3e-3, rtol=1e-2)
        outside = np.reshape(chart.domain.bounds, (2, 2)) + np.array([[0, -1e-3], [0, 1e-3]])
        assert np.isfinite(chart.points(outside)).all()


@pytest.mark.parametrize("name", ["half-cylinder", "sleeve", "cone"])
def test_upwards_on_the_map_is_upwards_in_space_however_nodes_are_numbered(name: str) -> None:
    surface, random = meshed(name, 0.012), np.random.default_rng(3)
    number = random.permutation(surface.n_nodes)
    chart = MeshChart(Mesh(surface.nodes[np.argsort(number)], number[surface.elements]))
    assert chart.frames(places_on(chart, 20, 0.02))[:, 1, 2].min() > 0.9
    if chart.domain.period:  # it meets itself behind
        (begin,) = chart.points([[0.0, 0.0]])
        np.testing.assert_allclose(begin / np.linalg.norm(begin), [-1, 0, 0], atol=0.2)


def test_a_hole_in_a_patch_is_a_hole_of_its_map() -> None:
    sheet = Polygon([(0, 0), (0.2, 0), (0.2, 0.15), (0, 0.15)], [[(0.09, 0.06), (0.12, 0.06), (0.12, 0.09)]])
    bent = mesh_domain(sheet, 5e-3).mapped(lambda p: np.column_stack([p, 2 * (p[:, 0] - 0.1) ** 2]))
    domain = MeshChart(bent).domain
    assert isinstance(domain, Polygon)
    assert len(domain.holes) == 1
    assert domain.area == pytest.approx(bent.measures.sum(), rel=1e-3)
    assert (len(domain.vertices), len(domain.holes[0].vertices)) == (4, 3)
    mesh_domain(domain, 3.6e-3)


def test_what_has_no_good_map_is_refused_in_words() -> None:
    nodes, triangles = link()
    with pytest.raises(GeometryError, match="closed; cut it open"):
        MeshChart(Mesh(nodes, triangles))
    turned = meshed("cap")
    elements = turned.elements.copy()
    elements[3] = elements[3, ::-1]
    with pytest.raises(GeometryError, match="have opposite orientations"):
        MeshChart(Mesh(turned.nodes, elements))
    sphere = mesh_domain(ROUND["cap"].chart.domain, 6e-3)
    polar = 2.9 * np.linalg.norm(sphere.nodes, axis=1) / ROUND["cap"].chart.domain.bounds[2]
    east = np.arctan2(*sphere.nodes.T[::-1])
    nearly = np.column_stack([np.sin(polar) * np.cos(east), np.sin(polar) * np.sin(east), np.cos(polar)]) / 10
    with pytest.raises(GeometryError, match="cut it into two skins"):
        MeshChart(Mesh(nearly, sphere.elements))


# --- skin files -------------------------------------------------------------------------------------------------------

FOREARM = """
name = "forearm"

[sheet]
shape = "mesh"
file = "forearm.stl"
scale = 1e-3                # the file is in millimetres
cut = [[0, 0, 1, 0.08], [0, 0, -1, -0.24]]  # from 8 to 24 cm along the link

[electrode]
layout = "even"
count = 16
"""


def forearm_file(folder: Path, text: str = FOREARM) -> Path:
    nodes, triangles = link()
    write_mesh(folder / "forearm.stl", Mesh(1e3 * nodes, triangles))
    (folder / "skin.toml").write_text(text)
    return folder / "skin.toml"


def test_planes_cut_triangles_exactly() -> None:
    nodes, triangles = cut_off(*link(), [0, 0, 2.0, 0.166])
    nodes, triangles = cut_off(nodes, triangles, [0, 0.6, -0.8, -0.17])
    left = Mesh(nodes, triangles)
    ends = left.nodes[np.unique(left.boundary)]
    np.testing.assert_allclose(np.minimum(abs(ends[:, 2] - 0.083), abs(ends @ [0, 0.6, -0.8] + 0.17)), 0, atol=1e-12)
    with pytest.raises(GeometryError, match="nothing is left"):
        cut_off(nodes, triangles, [0, 0, 1, 5])
    with pytest.raises(GeometryError, match="must not be 0"):
        cut_off(nodes, triangles, [0, 0, 0, 5])


def test_a_skin_keeps_the_surface_that_was_cut_from_its_file(tmp_path: Path) -> None:
    skin = Skin.load(forearm_file(tmp_path))
    assert isinstance(skin.domain, Band)
    assert skin.sheet.file == ""
    (tmp_path / "forearm.stl").unlink()
    again = Skin.parse(skin.dump())
    assert again == skin
    assert hash(again) == hash(skin)
    assert again.digest == skin.digest
    z = skin.chart.points(skin.domain.rim(np.linspace(0, 0.2, 7)))[:, 2]
    np.testing.assert_allclose(z, 0.08, atol=1e-6)


@pytest.mark.parametrize("layout", ["even", "rim"])
def test_electrodes_on_the_rim_of_a_cut_patch_are_on_its_corners_or_away_from_them(layout: str, tmp_path: Path) -> None:
    """A mesh has nodes at both."""
    for d in (0.0, 0.01, 0.02, 0.03):
        text = FOREARM.replace("-0.24]]", f"-0.24], [1, 0, 0, {d}]]").replace("even", layout)
        skin = Skin.load(forearm_file(tmp_path, text))
        assert isinstance(skin.domain, Polygon)
        assert len(skin.electrodes) == 16
        for mesh in (skin.mesh(), skin.mesh_for(skin.discs, 4e-3)):
            assert mesh.measures.sum() == pytest.approx(skin.domain.area, rel=1e-6)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (("forearm.stl", "../forearm.stl"), "outside the folder"),
        (("forearm.stl", "arm.stl"), "no mesh file"),
        (("1e-3 ", "0"), "sheet.scale is 0"),
        (("[0, 0, 1, 0.08]", "[0, 0, 1]"), r"rows? .*\[nx, ny, nz, d\]|list of \[nx, ny, nz, d\]"),
        (('"mesh"', '"disc"'), "go together"),
        (('file = "forearm.stl"', 'surface = "AAAA"'), "read by Skin.load|not what ohmskin writes"),
    ],
)
def test_a_mesh_that_cannot_be_had_is_told(changed: tuple[str, str], told: str, tmp_path: Path) -> None:
    path = forearm_file(tmp_path, FOREARM.replace(*changed))
    with pytest.raises(SkinError, match=told):
        Skin.load(path)


def test_a_surface_survives_as_text_and_is_bounded() -> None:
    surface = meshed("cap")
    again = surface_of(surface_text(surface))
    np.testing.assert_array_equal(again.elements, surface.elements)
    np.testing.assert_allclose(again.nodes, surface.nodes, atol=1e-8)
    with pytest.raises(GeometryError, match="KiB of a skin file"):
        surface_text(Mesh(*grid(300)))
    for text in ("", "####", surface_text(surface)[:-40]):
        with pytest.raises(GeometryError, match="not what ohmskin writes"):
            surface_of(text)


# --- felt end to end --------------------------------------------------------------------------------------------------


@cache
def engine(kind: str) -> Engine:
    nodes, triangles = link()
    planes = [[0, 0, 1, 0.08], [0, 0, -1, -0.24]] + [[1, 0, 0, 0.02]] * (kind == "patch")
    for plane in planes:
        nodes, triangles = cut_off(nodes, triangles, plane)
    sheet = Sheet(shape="mesh", surface=surface_text(Mesh(nodes, triangles)))
    skin = Skin(kind, sheet, ElectrodeLayout(layout="even"))
    made = Engine(lambda: DirectDevice(VirtualSkin(skin, seed=1)), skin, "16P")
    made.calibrate()
    return made


@pytest.mark.parametrize("kind", ["ring", "patch"])
def test_a_press_on_a_skin_cut_from_a_mesh_is_felt_where_it_is(kind: str) -> None:
    chart = engine(kind).skin.chart
    assert isinstance(chart, MeshChart)
    for place in places_on(chart, 4, 0.015):
        engine(kind).press(0, tuple(place.tolist()), 8e-3, 15e3)
        touches = [engine(kind).step() for _ in range(10)]
        assert touches[-1] is not None
        (felt,) = in_frame(touches[-1].contacts, chart, Patch())
        assert np.linalg.norm(np.array(felt.position) - chart.points(place)[0]) < 5e-3
        assert np.dot(felt.normal, chart.frames(place)[0, 2]) > np.cos(np.radians(5))
        engine(kind).press(0, tuple(place.tolist()), 8e-3, 0.0)
        for _ in range(12):
            engine(kind).step()


# --- the page and the cutting pattern ---------------------------------------------------------------------------------


def test_the_page_is_told_the_outline_of_a_patch_and_its_holes() -> None:
    skin = engine("patch").skin
    told = describe_domain(skin)
    assert told["kind"] == "polygon"
    assert told["holes"] == []
    assert Polygon(told["outline"]).area == pytest.approx(skin.domain.area, rel=1e-4)


def test_the_demonstration_finger_stays_on_a_sheet_of_any_outline() -> None:
    """A press in a hole is refused, and that ended the live page."""
    hole = [(0.08, 0.05), (0.12, 0.05), (0.12, 0.08), (0.09, 0.08)]
    domain = Polygon([(0, 0), (0.2, 0), (0.2, 0.15), (0.1, 0.09), (0, 0.15)], [hole])
    places = np.array([demo_finger(domain, 0.05 * k)[0] for k in range(4000)])
    assert domain.depth(places).min() >= 0


def drawn(skin: Skin, folder: Path) -> dict[str, list[Floats]]:
    """The lines of a pattern (mm), by what they are, as a program that reads SVG files sees them."""
    save_pattern(folder / "pattern.svg", Pattern.of(skin), skin.name)
    found: dict[str, list[Floats]] = {}
    for group in ElementTree.parse(folder / "pattern.svg").iter("{http://www.w3.org/2000/svg}g"):
        for path in group.findall("{http://www.w3.org/2000/svg}path"):
            points = np.array(re.findall(r"[ML] (\S+) (\S+)", path.get("d", "")), float)
            found.setdefault(group.get("id", ""), []).append(points * 25.4 / 72)
    return found


def length(line: Floats) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def test_a_sleeve_is_drawn_to_scale(tmp_path: Path) -> None:
    lines = drawn(Skin.load("sleeve"), tmp_path)
    assert length(lines["scale-bar"][0]) == pytest.approx(100, abs=1e-3)
    (outline,) = lines["outline"]
    np.testing.assert_allclose(np.ptp(outline, axis=0), [2 * np.pi * 45, 142], atol=1e-2)
    for edge in ("seam-0", "seam-1"):
        assert length(lines[edge][0]) == pytest.approx(142, abs=1e-2)
    assert len(lines["electrode-0"]) == 2  # on the seam: half on either side
    assert np.ptp(lines["electrode-1"][0], axis=0) == pytest.approx([6, 6], abs=1e-2)


def test_a_cone_unrolls_to_a_sector_of_a_ring(tmp_path: Path) -> None:
    skin = Skin(sheet=ROUND["cone"], electrode=ElectrodeLayout(layout="even"))
    assert Pattern.of(skin).developable
    lines = drawn(skin, tmp_path)
    slant = float(np.hypot(138, 30))
    for edge in ("seam-0", "seam-1"):
        (line,) = lines[edge]
        assert length(line) == pytest.approx(slant, rel=1e-3)
        assert np.linalg.norm(line[-1] - line[0]) == pytest.approx(length(line), rel=1e-5)  # straight
    corners = np.array([lines[edge][0][end] for edge in ("seam-0", "seam-1") for end in (0, -1)])
    for first, second, radius in ((0, 2, 60), (1, 3, 30)):
        far = radius / 30 * slant  # from the tip
        chord = 2 * far * np.sin(np.pi * radius / far)
        assert np.linalg.norm(corners[first] - corners[second]) == pytest.approx(chord, rel=1e-3)


def test_what_wrapping_a_dome_stretches_is_told() -> None:
    """No flat disc lies on a cap: its rim is pressed together, its middle is stretched, see test_wrapped.py."""
    pattern = Pattern.of(Skin.load("dome"))
    assert not pattern.developable
    assert -0.18 < pattern.stretch.min() - 1 < -0.14
    assert 0.09 < pattern.stretch.max() - 1 < 0.13
    assert "wrapping changes its lengths by -" in str(pattern)


def test_a_file_whose_name_cannot_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "skin.toml").write_text('[sheet]\nshape = "mesh"\nfile = "a\\u0000.stl"\n')
    with pytest.raises(SkinError, match="not a file name"):
        Skin.load(tmp_path / "skin.toml")
