"""Meshes, layouts and rasters: areas add up, electrodes are nodes, what is broken is refused."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from ohmskin.errors import GeometryError
from ohmskin.geometry import Disc, Domain, Electrodes, Mesh, Polygon, Raster, Rectangle, electrode_points, mesh_domain

SHEET = Rectangle(0.2, 0.2)
OBLONG = Rectangle(0.3, 0.1)
DISC = Disc(0.1)
DOMAINS = [SHEET, OBLONG, DISC]
LAYOUTS = {
    "grid 4 x 4": (SHEET, Electrodes.grid(SHEET)),
    "grid 4 x 4, inset": (SHEET, Electrodes.grid(SHEET, inset=0.02)),
    "12 on the rim": (SHEET, Electrodes.rim(SHEET, 12)),
    "16 on the rim": (SHEET, Electrodes.rim(SHEET, 16)),
    "16 round a disc": (DISC, Electrodes.rim(DISC, 16)),
    "6 x 3 on an oblong": (OBLONG, Electrodes.grid(OBLONG, 6, 3)),
}


def smallest_angle(mesh: Mesh) -> float:
    """In degrees."""
    p = mesh.nodes[mesh.elements]
    smallest = 180.0
    for k in range(3):
        u, v = p[:, (k + 1) % 3] - p[:, k], p[:, (k + 2) % 3] - p[:, k]
        cosine = (u * v).sum(1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)
        smallest = min(smallest, float(np.degrees(np.arccos(cosine.max()))))
    return smallest


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("size", [0.0055, 0.01, 0.0141])
def test_electrodes_are_nodes_of_a_mesh_without_slivers(name: str, size: float) -> None:
    domain, electrodes = LAYOUTS[name]
    mesh = mesh_domain(domain, size, electrodes.positions)
    np.testing.assert_array_equal(mesh.nodes[mesh.nodes_at(electrodes.positions, tolerance=0)], electrodes.positions)
    assert smallest_angle(mesh) > 25
    assert mesh.measures.max() < 2.5 * np.sqrt(3) / 4 * size**2


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("domain", [OBLONG, DISC])
def test_no_node_is_inside_the_circle_about_a_triangle(domain: Domain, seed: int) -> None:
    """Wherever points are that must be nodes, the mesh is Delaunay."""
    x0, y0, x1, y1 = domain.bounds
    points = np.random.default_rng(seed).uniform([x0, y0], [x1, y1], (60, 2))
    points = points[domain.depth(points) > 4e-3]
    points = points[[(np.linalg.norm(points[:i] - points[i], axis=1) > 3e-3).all() for i in range(len(points))]]
    mesh = mesh_domain(domain, 0.01, points)
    a, b, c = mesh.nodes[mesh.elements].swapaxes(0, 1)
    b, c = b - a, c - a
    length, other = (b**2).sum(axis=1), (c**2).sum(axis=1)
    across = np.column_stack([c[:, 1] * length - b[:, 1] * other, b[:, 0] * other - c[:, 0] * length])
    centre = across / (2 * np.linalg.det(np.stack([b, c], axis=1)))[:, None]
    nearest = cKDTree(mesh.nodes).query(a + centre)[0]
    np.testing.assert_allclose(nearest, np.linalg.norm(centre, axis=1), rtol=1e-6)


@pytest.mark.parametrize("domain", [SHEET, OBLONG])
def test_triangle_areas_add_up_to_the_rectangle(domain: Rectangle) -> None:
    mesh = mesh_domain(domain, 0.013)
    assert mesh.measures.sum() == pytest.approx(domain.area, rel=1e-13)
    assert domain.area == domain.width * domain.height


def test_triangle_areas_converge_to_the_disc_as_the_square_of_the_mesh_size() -> None:
    error = [1 - mesh_domain(DISC, size).measures.sum() / (np.pi * 0.01) for size in (0.02, 0.01, 0.005)]
    assert np.log2(error[:-1] / np.array(error[1:])) == pytest.approx([2, 2], abs=0.1)


@pytest.mark.parametrize("domain", DOMAINS)
def test_the_rim_is_counterclockwise_closed_and_found_again_by_its_arc(domain: Domain) -> None:
    arc = np.linspace(0, domain.perimeter, 4000, endpoint=False)
    rim = domain.rim(arc)
    x, y = rim.T
    assert 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) == pytest.approx(domain.area, rel=1e-5)
    np.testing.assert_allclose(domain.depth(rim), 0, atol=1e-15)
    np.testing.assert_allclose(domain.arc(rim), arc, atol=1e-12)
    np.testing.assert_allclose(domain.rim(arc + domain.perimeter), rim, atol=1e-12)
    assert np.linalg.norm(np.diff(rim, axis=0), axis=1).sum() == pytest.approx(domain.perimeter, rel=1e-3)


def test_depth_is_the_distance_from_the_rim() -> None:
    points = np.random.default_rng(0).uniform(-0.05, 0.25, (200, 2))
    rim = SHEET.rim(np.linspace(0, SHEET.perimeter, 20_000))
    distance = np.linalg.norm(points[:, None] - rim[None], axis=2).min(1)
    inside = ((points > 0) & (points < 0.2)).all(1)
    np.testing.assert_allclose(SHEET.depth(points)[inside], distance[inside], atol=2e-5)
    assert (SHEET.depth(points)[~inside] < 0).all()
    assert DISC.depth([[0.03, -0.04]])[0] == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("kind", "arguments"), [(Rectangle, (0, 1)), (Rectangle, (1, np.nan)), (Disc, (-1,)), (Disc, (np.inf,))]
)
def test_lengths_must_be_positive(kind: type, arguments: tuple[float, ...]) -> None:
    with pytest.raises(GeometryError, match="positive length"):
        kind(*arguments)


# --- meshes -----------------------------------------------------------------------------------------------------------


def test_shape_functions_have_the_gradients_of_linear_interpolation() -> None:
    mesh = mesh_domain(SHEET, 0.02)
    field = mesh.nodes @ [3.0, -5.0] + 2
    np.testing.assert_allclose(
        np.einsum("ekd,ek->ed", mesh.gradients, field[mesh.elements]), [[3, -5]] * mesh.n_elem, atol=1e-11
    )
    np.testing.assert_allclose(mesh.gradients.sum(1), 0, atol=1e-11)


def test_a_surface_in_space_has_the_gradients_and_areas_of_its_flat_original() -> None:
    flat = mesh_domain(SHEET, 0.03)
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    tilted = Mesh(np.column_stack([flat.nodes, np.zeros(flat.n_nodes)]) @ turn.T + [1, 2, 3], flat.elements)
    np.testing.assert_allclose(tilted.measures, flat.measures, rtol=1e-10)
    expected = np.concatenate([flat.gradients, np.zeros((flat.n_elem, 3, 1))], axis=2) @ turn.T
    np.testing.assert_allclose(tilted.gradients, expected, atol=1e-8)
    assert tilted.flipped == 0


def test_clockwise_triangles_are_turned_and_counted() -> None:
    mesh = mesh_domain(SHEET, 0.03)
    again = Mesh(mesh.nodes, mesh.elements)
    assert again.flipped == 0
    turned = np.array(mesh.elements)
    turned[[2, 5, 11]] = turned[[2, 5, 11]][:, ::-1]
    repaired = Mesh(mesh.nodes, turned)
    assert repaired.flipped == 3
    assert (_twice_signed_area(repaired.nodes, repaired.elements) > 0).all()
    np.testing.assert_array_equal(np.sort(repaired.elements), np.sort(mesh.elements))


def _twice_signed_area(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    (ax, ay), (bx, by), (cx, cy) = (nodes[triangles[:, k]].T for k in range(3))
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def test_neighbours_share_two_nodes_and_the_rim_has_none() -> None:
    mesh = mesh_domain(SHEET, 0.02)
    for e in range(mesh.n_elem):
        for k, other in enumerate(mesh.neighbours[e]):
            edge = {int(mesh.elements[e, k]), int(mesh.elements[e, (k + 1) % 3])}
            if other >= 0:
                assert edge <= set(mesh.elements[other].tolist())
                assert e in mesh.neighbours[other]
            else:
                assert np.abs(SHEET.depth(mesh.nodes[sorted(edge)])).max() < 1e-12
    free = int((mesh.neighbours < 0).sum())
    assert mesh.n_nodes - (3 * mesh.n_elem + free) / 2 + mesh.n_elem == 1  # Euler's formula of a disc
    assert (mesh.adjacency != mesh.adjacency.T).nnz == 0
    assert mesh.adjacency.sum() == 3 * mesh.n_elem - free


SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
TWO = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    ("nodes", "triangles", "message"),
    [
        (SQUARE[:, :1], TWO, "need \\(n, 2\\) or"),
        (SQUARE.ravel(), TWO, "need \\(n, 2\\) or"),
        (SQUARE, TWO[:, :2], "need integers"),
        (SQUARE, TWO.astype(float), "need integers"),
        (SQUARE, np.empty((0, 3), int), "need integers"),
        (np.where(SQUARE == 1, np.nan, SQUARE), TWO, "node 1 is not finite"),
        (SQUARE, TWO + 1, "name nodes 1..4; there are 4"),
        (SQUARE, TWO - 1, "name nodes -1..2"),
        (np.vstack([SQUARE, [[5, 5]]]), TWO, "1 mesh nodes belong to no triangle \\(first: 4\\)"),
        (SQUARE, np.array([[0, 1, 1], [0, 2, 3]]), "triangle 0 has no area"),
        (SQUARE * [1, 0], TWO, "has no area"),
        (SQUARE * [1, 5e-9], TWO, "triangle 0 has no area"),
        (np.vstack([SQUARE, SQUARE + 3]), np.vstack([TWO, TWO + 4]), "2 parts"),
        (SQUARE, np.array([[0, 1, 2], [0, 2, 3], [0, 2, 1]]), "more than two triangles"),
    ],
)
def test_broken_meshes_are_refused(nodes: np.ndarray, triangles: np.ndarray, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        Mesh(nodes, triangles)


def test_triangles_that_touch_in_a_single_node_do_not_make_one_sheet() -> None:
    nodes = np.array([[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]], float)
    with pytest.raises(GeometryError, match="2 parts that share no edge"):
        Mesh(nodes, np.array([[0, 1, 2], [0, 3, 4]]))


def test_meshes_do_not_change() -> None:
    given = SQUARE.copy()
    mesh = Mesh(given, TWO)
    given[0] = 9
    assert mesh.nodes[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        mesh.nodes[0] = 1
    with pytest.raises(ValueError, match="read-only"):
        mesh.elements[0] = 1


def test_no_node_at_a_point_is_an_error_with_the_remedy() -> None:
    mesh = mesh_domain(SHEET, 0.03)
    with pytest.raises(
        GeometryError, match=r"point 1 at .* m away from the nearest mesh node; make the mesh with these points"
    ):
        mesh.nodes_at([[0, 0], [0.101, 0.0997]])


@pytest.mark.parametrize(
    ("size", "points", "message"),
    [
        (0.0, None, "must be positive"),
        (-1.0, None, "must be positive"),
        (np.nan, None, "must be positive"),
        (0.11, None, "at most 0.1 m"),
        (1e-5, None, "four million"),
        (0.01, [[0.1, 0.1], [0.21, 0.1]], "point 1 at .* lies outside"),
        (0.01, [[0.1, np.nan]], "lies outside"),
        (0.01, [[0.1, 0.1], [0.1005, 0.1]], "too close"),
        (0.01, [[0.055, 0.0005]], "0.0005 m away from the rim, too close"),
    ],
)
def test_meshes_that_cannot_be_made_are_refused(size: float, points: list[list[float]] | None, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        mesh_domain(SHEET, size, points)


@given(start=st.floats(-10, 10), count=st.integers(1, 20), size=st.floats(0.009, 0.03))
@settings(max_examples=40)
def test_a_rim_point_at_any_angle_becomes_a_node(start: float, count: int, size: float) -> None:
    angle = start + 2 * np.pi * np.arange(count) / count
    points = 0.1 * np.column_stack([np.cos(angle), np.sin(angle)])
    mesh = mesh_domain(DISC, size, points)
    np.testing.assert_array_equal(mesh.nodes[mesh.nodes_at(points, tolerance=0)], points)


@pytest.mark.parametrize("size", [0.01, 0.0112])
def test_a_rim_point_a_hair_short_of_the_full_turn_becomes_a_node(size: float) -> None:
    angle = 2 * np.pi * np.arange(1, 17) / 16  # the last has the arc length of the perimeter, to rounding
    points = 0.1 * np.column_stack([np.cos(angle), np.sin(angle)])
    for chosen in (points, points[-1:]):
        assert len(mesh_domain(DISC, size, chosen).nodes_at(chosen, tolerance=0)) == len(chosen)


def test_a_rim_point_a_hair_short_of_the_first_corner_is_that_corner() -> None:
    mesh = mesh_domain(SHEET, 0.02, [[0.0, 1e-14]])
    assert len(mesh.nodes_at([[0.0, 1e-14]], tolerance=0)) == 1
    assert mesh.n_nodes == mesh_domain(SHEET, 0.02).n_nodes


def test_locate_inverts_interpolation_even_where_the_mesh_is_graded() -> None:
    angle = np.arange(12) * 2 * np.pi / 12
    crowd = np.vstack([[0.1, 0.1], 0.1 + 0.003 * np.column_stack([np.cos(angle), np.sin(angle)])])
    mesh = mesh_domain(SHEET, 0.015, crowd)
    assert mesh.measures.max() > 50 * mesh.measures.min()
    points = np.random.default_rng(0).uniform(1e-6, 0.2 - 1e-6, (20_000, 2))
    points = np.vstack([points, 0.1 + np.random.default_rng(1).uniform(-0.02, 0.02, (20_000, 2))])
    element, weights = mesh.locate(points)
    assert (element >= 0).all()
    assert weights.min() > -1e-8
    np.testing.assert_allclose(np.einsum("nk,nkd->nd", weights, mesh.nodes[mesh.elements[element]]), points, atol=1e-14)
    outside, _ = mesh.locate([[0.2001, 0.1], [-1, -1], [0.1, -1e-5]])
    assert (outside == -1).all()
    assert mesh.locate(np.empty((0, 2)))[0].shape == (0,)


def test_points_outside_a_graded_mesh_cost_no_more_than_those_inside() -> None:
    """Small elements lie along the rim, beside others that reach fifty times as far: not all are tried for a point."""
    points = electrode_points(DISC, Electrodes.rim(DISC, 32).with_discs(5e-3, 1e-4), 1.05e-3)
    mesh = mesh_domain(DISC, 0.05, points, closest=0.02)
    assert mesh.reach > 30 * np.sqrt(mesh.measures.min())
    points = np.random.default_rng(0).uniform(-0.13, 0.13, (5000, 2))
    mesh.locate(points[:1])
    tracemalloc.start()
    element, _ = mesh.locate(points)
    used = tracemalloc.get_traced_memory()[1] / len(points)
    tracemalloc.stop()
    assert 1000 < (element < 0).sum() < 4000
    assert used < 2000  # bytes a point: 270, and 50,000 if all within the reach of the largest are tried


def test_locate_and_rasters_need_a_flat_mesh() -> None:
    mesh = Mesh(np.column_stack([SQUARE, [0, 0, 0, 1.0]]), TWO)
    with pytest.raises(GeometryError, match="flat mesh"):
        mesh.locate([[0, 0, 0]])
    with pytest.raises(GeometryError, match="flat mesh"):
        Raster(mesh)


def test_closest_elements_are_closest() -> None:
    mesh = mesh_domain(SHEET, 0.02)
    point = np.array([0.05, 0.13])
    expected = np.argsort(np.linalg.norm(mesh.centroids - point, axis=1))[:3]
    assert set(mesh.closest_elements([point], 3)[0]) == set(expected)


# --- electrodes -------------------------------------------------------------------------------------------------------


def test_the_paper_grid_walks_round_the_rim_and_then_round_the_middle() -> None:
    electrodes = Electrodes.grid(SHEET)
    third = 0.2 / 3
    rim = [(0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (3, 2), (3, 3), (2, 3), (1, 3), (0, 3), (0, 2), (0, 1)]
    np.testing.assert_allclose(electrodes.positions / third, [*rim, (1, 1), (2, 1), (2, 2), (1, 2)], atol=1e-12)
    assert electrodes.rings == (tuple(range(12)), tuple(range(12, 16)))
    assert len(electrodes) == 16


@given(columns=st.integers(2, 9), rows=st.integers(2, 9), inset=st.floats(0, 0.049))
@settings(max_examples=60)
def test_grid_rings_name_every_place_of_the_grid_once(columns: int, rows: int, inset: float) -> None:
    electrodes = Electrodes.grid(OBLONG, columns, rows, inset)
    x, y = np.linspace(inset, 0.3 - inset, columns), np.linspace(inset, 0.1 - inset, rows)
    expected = {(a, b) for a in x for b in y}
    assert {tuple(p) for p in electrodes.positions} == expected
    assert len(electrodes.rings[0]) == 2 * (columns + rows) - 4
    for ring in electrodes.rings:
        if min(columns, rows) > 2 and len(ring) > 3:
            px, py = electrodes.positions[list(ring)].T
            assert np.sum(px * np.roll(py, -1) - np.roll(px, -1) * py) >= -1e-12  # counterclockwise


def test_a_grid_spans_a_sheet_wherever_its_origin_is() -> None:
    centred = Polygon(np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]))
    there = Electrodes.grid(centred).positions
    np.testing.assert_allclose(there, Electrodes.grid(Rectangle(0.2, 0.2)).positions - 0.1, atol=1e-12)


def test_rim_electrodes_are_evenly_spaced() -> None:
    for domain in DOMAINS:
        arc = domain.arc(Electrodes.rim(domain, 16).positions)
        np.testing.assert_allclose(arc, np.arange(16) * domain.perimeter / 16, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Electrodes.at([[0, 0], [1, 0], [1, 1]]), "n >= 4"),
        (lambda: Electrodes.at(np.zeros((4, 4))), "need \\(n, 2\\)"),
        (lambda: Electrodes.at([[0, 0], [1, 0], [np.inf, 1], [0, 1]]), "electrode 2 has a position"),
        (lambda: Electrodes.at([[0, 0], [1, 0], [1, 1], [0, 1e-7]]), "electrodes 0 and 3 are at the same place"),
        (lambda: Electrodes.at(SQUARE, ((0, 1, 2),)), "exactly once"),
        (lambda: Electrodes.at(SQUARE, ((0, 1, 2), (2, 3))), "exactly once"),
        (lambda: Electrodes.rim(DISC, 3), "at least 4"),
        (lambda: Electrodes.rim(DISC, 16.5), "whole number"),
        (lambda: Electrodes.grid(SHEET, 3.5, 4), "whole numbers"),
        (lambda: Electrodes.grid(SHEET, 1, 4), "at least 2 x 2"),
        (lambda: Electrodes.grid(SHEET, inset=0.1), "grid inset 0.1"),
        (lambda: Electrodes.grid(SHEET, inset=-0.01), "grid inset -0.01"),
        (lambda: Electrodes.grid(SHEET, inset=np.nan), "grid inset nan"),
    ],
)
def test_impossible_layouts_are_refused(make, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        make()


# --- rasters ----------------------------------------------------------------------------------------------------------


def test_raster_of_an_oblong_sheet_has_x_along_columns_and_y_up() -> None:
    mesh = mesh_domain(OBLONG, 0.01)
    raster = Raster(mesh, 30)
    assert raster.pitch == pytest.approx(0.01)
    np.testing.assert_allclose(raster.x, 0.005 + 0.01 * np.arange(30), atol=1e-12)
    np.testing.assert_allclose(raster.y, 0.005 + 0.01 * np.arange(10), atol=1e-12)
    assert raster.inside.shape == (10, 30)
    assert raster.inside.all()
    with pytest.raises(GeometryError, match=r"shape \(5,\); this mesh has"):
        raster(np.ones(5))
    picture = raster(np.exp(-np.sum((mesh.centroids - [0.255, 0.015]) ** 2, axis=1) / 0.02**2))
    row, column = np.unravel_index(np.nanargmax(picture), picture.shape)
    assert (raster.x[column], raster.y[row]) == pytest.approx((0.255, 0.015))


def test_raster_reproduces_constants_exactly_and_linear_fields_to_second_order() -> None:
    slope = np.array([2.0, -3.0])
    error = []
    for size in (0.02, 0.01, 0.005):
        mesh = mesh_domain(SHEET, size)
        raster = Raster(mesh, 40)
        np.testing.assert_allclose(raster(np.full(mesh.n_elem, 7.0)), 7.0, rtol=1e-12)
        x, y = np.meshgrid(raster.x, raster.y)
        away = SHEET.depth(np.stack([x.ravel(), y.ravel()], 1)).reshape(x.shape) > 0.042
        error.append(np.sqrt(np.mean((raster(mesh.centroids @ slope) - (slope[0] * x + slope[1] * y))[away] ** 2)))
    assert (error < np.array([1e-3, 1e-4, 2e-6])).all()  # of a range of 1; half a pixel would be 5e-3


def test_pixel_values_belong_to_pixel_centres() -> None:
    """On one triangle pair with equal values at the corners, interpolation is linear between corner means, by hand."""
    mesh = Mesh(SQUARE, TWO)
    picture = Raster(mesh, 2)(np.array([1.0, 3.0]))  # corner means: 2, 1, 2, 3; diagonal 0-2
    np.testing.assert_allclose(picture, [[2.0, 1.5], [2.5, 2.0]], atol=1e-14)


def test_off_the_mesh_a_raster_is_nan() -> None:
    mesh = mesh_domain(DISC, 0.01)
    raster = Raster(mesh, 50)
    x, y = np.meshgrid(raster.x, raster.y)
    radius = np.hypot(x, y)
    assert raster.inside[radius < 0.0995 - 1e-3].all()
    assert not raster.inside[radius > 0.1].any()
    np.testing.assert_array_equal(np.isnan(raster(np.ones(mesh.n_elem))), ~raster.inside)


@pytest.mark.parametrize("pixels", [1, 0, -3, 5000])
def test_a_raster_has_a_sensible_number_of_pixels(pixels: int) -> None:
    with pytest.raises(GeometryError, match="2 to 4096"):
        Raster(mesh_domain(SHEET, 0.03), pixels)
