"""Polygons, surfaces in space, thick skins, anisotropic sheets; meshing by gmsh; files of others."""

import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ohmskin.errors import GeometryError, ModelError
from ohmskin.forward import TransferModel
from ohmskin.forward.assembly import stiffness
from ohmskin.geometry import (
    Disc,
    Electrodes,
    Mesh,
    Polygon,
    Rectangle,
    electrode_points,
    mesh_domain,
    mesh_graded,
    mesh_surface,
    read_mesh,
    thicken,
    write_mesh,
)
from ohmskin.geometry.meshing import checked_mesh
from ohmskin.scan import adjacent, skip

S, SHEET = 1.83e-3, Rectangle(0.2, 0.2)
GRID = Electrodes.grid(SHEET)
MIXED = GRID.with_discs(5e-3, 1e-4, range(12, 16)).with_rim_segments(0.013, 0.1, range(10))
PATTERN = adjacent(GRID.rings)


def regular(count: int, radius: float, centre: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)]) + centre


def ell() -> Polygon:
    """An L with a round hole."""
    corners = [[0, 0], [0.2, 0], [0.2, 0.08], [0.08, 0.08], [0.08, 0.2], [0, 0.2]]
    return Polygon(corners, holes=[regular(24, 0.02, (0.04, 0.04))])


@cache
def flat(size: float = 0.012) -> Mesh:
    return mesh_domain(SHEET, size, GRID.positions)


NARROW = [[0.15, 0.015], [0.85, 0.015], [0.85, 0.5], [0.15, 0.5]]  # a hole that leaves a thin bridge


def least_angle(mesh: Mesh) -> float:
    corners = mesh.nodes[mesh.elements]
    found = []
    for k in range(3):
        u, v = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        found.append(np.arccos(np.sum(u * v, 1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)).min())
    return float(np.degrees(min(found)))


def in_space(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.zeros(len(points))])


def relative(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


# --- polygons ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [0.02, 0.01, 0.004])
def test_a_polygon_with_a_hole_is_meshed_to_its_outline(size: float) -> None:
    mesh = mesh_domain(ell(), size)
    assert mesh.measures.sum() == pytest.approx(ell().area, rel=1e-12)
    rim = mesh.nodes[mesh.boundary]
    np.testing.assert_allclose(ell().depth(rim.reshape(-1, 2)), 0, atol=1e-12)
    np.testing.assert_allclose(ell().depth(rim.mean(axis=1)), 0, atol=1e-12)
    assert mesh.n_nodes - (3 * mesh.n_elem + len(rim)) / 2 + mesh.n_elem == 0  # Euler's formula with one hole


def test_depth_of_a_polygon_is_the_distance_from_the_nearest_outline() -> None:
    domain = ell()
    depth = domain.depth([[0.1, 0.04], [0.15, 0.15], [0.04, 0.04], [0.01, 0.19], [0.07, 0.07], [-1, 0.1]])
    apothem = 0.02 * np.cos(np.pi / 24)
    np.testing.assert_allclose(depth, [0.04, -0.07, -apothem, 0.01, np.hypot(0.01, 0.01), -1], atol=1e-5)
    assert domain.area == pytest.approx(0.2 * 0.08 + 0.12 * 0.08 - 12 * 4e-4 * np.sin(np.pi / 12), rel=1e-12)


def test_a_mesh_of_another_outline_or_without_the_hole_is_not_taken() -> None:
    square, aslant = Polygon([[0, 0], [1, 0], [1, 1], [0, 1]]), np.array([[0, 0], [1, 0], [1.5, 1], [0.5, 1]])
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    assert checked_mesh(square.vertices, halves, square, 1.0).n_elem == 2
    hollow = Polygon(square.vertices, [regular(8, 0.1, (0.5, 0.5))])
    for nodes, domain in ((aslant, square), (square.vertices, hollow)):
        with pytest.raises(GeometryError, match="does not follow the outline"):
            checked_mesh(nodes, halves, domain, 1.0)


def test_arc_and_rim_of_a_polygon_invert_each_other() -> None:
    arc = np.linspace(0.001, 0.799, 50)
    np.testing.assert_allclose(ell().arc(ell().rim(arc)), arc, atol=1e-12)
    clockwise = Polygon(ell().vertices[::-1])
    assert clockwise.area > 0
    np.testing.assert_allclose(clockwise.rim([0.0]), [ell().vertices[-1]])


def test_an_annulus_between_rim_and_hole_has_the_resistance_of_its_logarithm() -> None:
    """Eight sources round the rim and eight sinks round the hole; some way from both the potential is that of full
    rings."""
    outer, inner = regular(96, 0.1), regular(48, 0.03)
    domain = Polygon(outer, holes=[inner])
    electrodes = Electrodes.at(np.vstack([outer[::12], inner[::6]]))
    model = TransferModel(mesh_domain(domain, 0.004, electrodes), electrodes, S)
    between = model.potentials[:, 8:].mean(axis=1) - model.potentials[:, :8].mean(axis=1)
    radius = np.linalg.norm(model.mesh.nodes, axis=1)
    far = (radius > 0.05) & (radius < 0.06)
    slope = np.polyfit(np.log(radius[far]), between[far], 1)[0]
    assert slope == pytest.approx(-1 / (2 * np.pi * S), rel=5e-3)


def test_rim_electrodes_sit_on_a_hole_as_well() -> None:
    hole = regular(40, 0.03, (0.1, 0.1))
    domain = Polygon([[0, 0], [0.2, 0], [0.2, 0.2], [0, 0.2]], holes=[hole])
    electrodes = Electrodes.at(np.vstack([hole[::10], [[0.0, 0.1], [0.2, 0.1]]]))
    length = 4 * np.linalg.norm(hole[1] - hole[0])
    electrodes = electrodes.with_rim_segments(length, 0.1)
    model = TransferModel(mesh_domain(domain, 0.008, electrodes), electrodes, S)
    for k in range(6):
        assert model.quadratures[k].extent == pytest.approx(length)
    s = model.transfer_resistance
    pair = [s[k, k] + s[j, j] - 2 * s[k, j] for k, j in ((0, 1), (1, 2), (2, 3), (3, 0))]
    np.testing.assert_allclose(pair, pair[0], rtol=0.02)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Polygon([[0, 0], [1, 0]]), "need \\(n, 2\\) with n >= 3"),
        (lambda: Polygon([[0, 0], [1, 0], [1, np.nan]]), "corner 2 is not finite"),
        (lambda: Polygon([[0, 0], [1, 0], [2, 0]]), "lie on one line"),
        (lambda: Polygon([[0, 0], [1, 0], [1, 0], [0, 1]]), "corners 1 and 2 are at the same place"),
        (lambda: Polygon([[0, 0], [1, 1], [1, 0], [0, 1.1]]), "sides 0 and 2 cross"),
        (lambda: Polygon([[0, 0], [1, 0], [1, 1], [0, 1]], [regular(8, 0.2, (1, 0.5))]), "hole 0 is not inside"),
        (lambda: Polygon([[0, 0], [1, 0], [1, 1], [0, 1]], [regular(8, 0.2, (3, 0.5))]), "hole 0 is not inside"),
        (lambda: Polygon(10 * regular(8, 1), [regular(8, 1), regular(8, 2)]), "holes 0 and 1 overlap"),
        (lambda: Polygon(10 * regular(8, 1), [regular(8, 1), regular(8, 1, (1, 0))]), "holes 0 and 1 overlap"),
        (lambda: mesh_domain(Polygon([[0, 0], [1, 0], [1, 1], [0, 1]], [NARROW]), 0.1), "does not follow the outline"),
        (lambda: mesh_domain(ell(), 0.01, [[0.04, 0.04]]), "lies outside"),
    ],
)
def test_impossible_polygons_are_refused(make, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        make()


# --- surfaces in space ------------------------------------------------------------------------------------------------


def bend(points: np.ndarray, around: float = 0.11) -> np.ndarray:
    """Lay the plane round a cylinder, without stretching it."""
    return np.column_stack(
        [around * np.sin(points[:, 0] / around), points[:, 1], around * np.cos(points[:, 0] / around)]
    )


def test_a_sheet_bent_round_a_cylinder_measures_what_the_flat_one_does() -> None:
    """Bending keeps lengths within the sheet; triangles are chords of it, so the difference is of second order."""
    sizes, error = np.array([0.02, 0.01, 0.005]), []
    for size in sizes:
        mesh = flat(size)
        straight, bent = TransferModel(mesh, MIXED, S), TransferModel(mesh.mapped(bend), MIXED.mapped(bend), S)
        error.append(relative(bent.transfer_resistance, straight.transfer_resistance))
    assert np.polyfit(np.log(sizes), np.log(error), 1)[0] == pytest.approx(2, abs=0.4)
    assert error[-1] < 1e-3


def test_a_sheet_folded_along_its_edges_measures_exactly_what_the_flat_one_does() -> None:
    x = np.linspace(0, 0.2, 13)
    nodes = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    corner = (np.arange(12)[:, None] * 13 + np.arange(12)).ravel()
    mesh = Mesh(
        nodes,
        np.vstack([np.stack([corner, corner + 1, corner + 14], 1), np.stack([corner, corner + 14, corner + 13], 1)]),
    )

    def fold(points: np.ndarray) -> np.ndarray:
        """By 80 degrees along x = 0.1, an edge of the mesh, and turned in space."""
        beyond = np.maximum(points[:, 0] - 0.1, 0)
        bent = np.column_stack(
            [np.minimum(points[:, 0], 0.1) + beyond * np.cos(1.4), points[:, 1], beyond * np.sin(1.4)]
        )
        turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
        return bent @ turn.T + [1, 2, 3]

    electrodes = Electrodes.at(nodes[[0, 6, 12, 84, 156, 162, 168]]).with_rim_segments(0.021, 0.1, [0, 1, 2])
    straight, folded = TransferModel(mesh, electrodes, S), TransferModel(mesh.mapped(fold), electrodes.mapped(fold), S)
    np.testing.assert_allclose(folded.transfer_resistance, straight.transfer_resistance, atol=1e-9 * 500)
    np.testing.assert_allclose(folded.pair_sensitivity, straight.pair_sensitivity, atol=1e-9 * 1e7)


def test_discs_on_a_bent_sheet_keep_their_area() -> None:
    mesh = flat().mapped(bend)
    discs = GRID.with_discs(6e-3, 1e-4)
    model = TransferModel(mesh, discs.mapped(bend), S)
    share = np.array([1 / 4, 1 / 2, 1 / 2] * 4 + [1.0] * 4)
    extent = np.array([model.quadratures[k].extent for k in range(16)])
    np.testing.assert_allclose(extent, share * np.pi * 36e-6, rtol=0.05)


def test_gmsh_meshes_a_link_anew_with_electrodes_at_nodes() -> None:
    angle, height = np.meshgrid(2 * np.pi * np.arange(40) / 40, np.linspace(0, 0.2, 21))
    nodes = np.column_stack([0.05 * np.cos(angle.ravel()), 0.05 * np.sin(angle.ravel()), height.ravel()])
    quads = [
        (j * 40 + i, j * 40 + (i + 1) % 40, (j + 1) * 40 + (i + 1) % 40, (j + 1) * 40 + i)
        for j in range(20)
        for i in range(40)
    ]
    link = Mesh(nodes, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))
    at = nodes[[205, 215, 225, 235, 410, 420, 430, 400, 605, 615]]
    electrodes = Electrodes.at(at).with_discs(6e-3, 1e-4, range(5))
    mesh = mesh_surface(link, 0.012, electrodes, fine=2e-3)
    assert len(mesh.nodes_at(at, tolerance=1e-12)) == 10
    assert mesh.measures.sum() == pytest.approx(link.measures.sum(), rel=5e-3)
    assert least_angle(mesh) > 15
    near = np.linalg.norm(mesh.centroids[:, None] - at, axis=2).min(axis=1)
    assert mesh.measures[near > 0.03].mean() > 6 * mesh.measures[near < 5e-3].mean()
    r = TransferModel(mesh, electrodes, S).transfer_resistance
    coarse = TransferModel(mesh_surface(link, 0.012, electrodes, fine=4e-3), electrodes, S).transfer_resistance
    assert relative(coarse[:5, :5], r[:5, :5]) < 0.05
    with pytest.raises(GeometryError, match=r"electrode 3 at .* off the surface"):
        mesh_surface(link, 0.012, Electrodes.at(at + np.eye(10)[3][:, None] * 0.01))


# --- thick skins ------------------------------------------------------------------------------------------------------


def test_tetrahedra_fill_what_lies_below_the_sheet() -> None:
    body = thicken(flat(0.02), 0.012, [0.2, 0.3, 0.5])
    assert body.dim == 3
    assert body.flipped == 0
    assert body.measures.sum() == pytest.approx(0.04 * 0.012, rel=1e-12)
    np.testing.assert_allclose(np.unique(body.nodes[:, 2]), [-0.012, -0.006, -0.0024, 0], atol=1e-15)
    faces = body.nodes[body.boundary]
    area = np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(2 * 0.04 + 0.8 * 0.012, rel=1e-12)
    points = np.random.default_rng(0).uniform([0, 0, -0.012], [0.2, 0.2, 0], (500, 3))
    element, weights = body.locate(points)
    assert (element >= 0).all()
    np.testing.assert_allclose(np.einsum("nk,nkd->nd", weights, body.nodes[body.elements[element]]), points, atol=1e-14)


def test_linear_fields_have_exact_gradients_and_energy_in_every_dimension() -> None:
    slope = np.array([2.0, -3.0, 5.0])
    for mesh in (flat(0.03), flat(0.03).mapped(in_space), thicken(flat(0.03), 0.05, 3)):
        direction = slope[: mesh.nodes.shape[1]]
        tangent = direction if mesh.nodes.shape[1] == mesh.dim else direction * [1, 1, 0]
        field = mesh.nodes @ direction
        np.testing.assert_allclose(
            np.einsum("ekd,ek->ed", mesh.gradients, field[mesh.elements]), [tangent] * mesh.n_elem, atol=1e-9
        )
        k = stiffness(mesh, np.full(mesh.n_elem, S))
        assert field @ k @ field == pytest.approx(S * tangent @ tangent * mesh.measures.sum(), rel=1e-10)
        assert np.abs(k @ np.ones(mesh.n_nodes)).max() < 1e-12


def test_a_thin_block_is_a_sheet_of_conductivity_times_thickness() -> None:
    mesh, electrodes = flat(0.015), GRID.with_discs(6e-3, 1e-4)
    sheet = TransferModel(mesh, electrodes, S)
    error = []
    for thickness in (4e-3, 2e-3, 1e-3, 1e-5):
        body = TransferModel(thicken(mesh, thickness, 1), electrodes.mapped(in_space), S / thickness)
        error.append(relative(body.voltages(PATTERN), sheet.voltages(PATTERN)))
    assert error[-1] < 1e-6
    assert (np.diff(error) < 0).all()
    assert error[0] > 1e-3


def test_a_block_between_its_faces_has_length_over_area_and_conductivity() -> None:
    """A long bar driven at its ends is one-dimensional in the middle."""
    bar = mesh_domain(
        Rectangle(0.2, 0.02), 0.005, [[0.08, 0.0], [0.08, 0.02], [0.12, 0.0], [0.12, 0.02], [0.0, 0.01], [0.2, 0.01]]
    )
    body = thicken(bar, 0.02, 4)
    at = np.array(
        [[0.0, 0.01, 0.0], [0.2, 0.01, 0.0], [0.08, 0.0, 0.0], [0.08, 0.02, 0.0], [0.12, 0.0, 0.0], [0.12, 0.02, 0.0]]
    )
    model = TransferModel(body, Electrodes.at(at), 0.5)
    s = model.transfer_resistance
    drop = s[0, 2] - s[0, 4] - s[1, 2] + s[1, 4]
    assert drop == pytest.approx(0.04 / (0.5 * 0.02 * 0.02), rel=1e-3)


def test_the_sensitivity_of_a_thick_skin_is_the_derivative() -> None:
    body = thicken(flat(0.03), 0.02, 2)
    electrodes = GRID.mapped(in_space).with_discs(8e-3, 1e-3, range(12, 16))
    rng = np.random.default_rng(0)
    model = TransferModel(body, electrodes, rng.uniform(0.5, 2, body.n_elem))
    direction = rng.normal(size=body.n_elem) * model.conductivity
    up, down = (model.with_conductivity(model.conductivity + t * direction).voltages(PATTERN) for t in (1e-4, -1e-4))
    numeric = (up - down) / 2e-4
    assert relative(model.sensitivity(PATTERN) @ direction, numeric) < 1e-6


def test_a_disc_at_the_edge_of_a_block_is_cut_off() -> None:
    electrodes = GRID.mapped(in_space).with_discs(6e-3, 1e-4, range(12, 16))
    body = thicken(flat(0.02), 0.01, 2)
    lifted = electrodes.mapped(lambda p: p * [0.98, 0.98, 1] + [0.002, 0.002, 0])  # 2 mm inside the rim
    model = TransferModel(body, lifted.with_discs(6e-3, 1e-4), S / 0.01)
    beyond = np.arccos(1 / 3) * 36e-6 - 2e-3 * np.sqrt(32e-6)  # circular segment 2 mm off the centre
    assert model.quadratures[1].extent == pytest.approx(36e-6 * np.pi - beyond, rel=0.02)


def test_a_shell_round_a_cylinder_has_its_volume() -> None:
    """Thickness t inwards from the radius R: t (1 - t / 2R) per area; at the straight edges normals are those of
    chords."""
    outside = flat(0.01).mapped(bend)
    shell = thicken(outside, 0.02, 3)
    assert shell.measures.sum() == pytest.approx(0.02 * (1 - 0.01 / 0.11) * outside.measures.sum(), rel=5e-3)
    with pytest.raises(GeometryError, match="folds where the surface bends"):
        thicken(outside, 0.15, 1)
    outwards = Mesh(outside.nodes, outside.elements[:, [0, 2, 1]])
    assert thicken(outwards, 0.15, 1).measures.sum() == pytest.approx(0.15 * (1 + 0.075 / 0.11) * 0.04, rel=0.02)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: thicken(flat(), 0.0), "thickness is 0.0 m"),
        (lambda: thicken(flat(), 0.01, 0), "layers are 0"),
        (lambda: thicken(flat(), 0.01, [0.5, 0.4]), "sum to one"),
        (lambda: thicken(thicken(flat(0.03), 0.01), 0.01), "of tetrahedra already"),
        (lambda: Mesh(np.eye(4)[:, :2], [[0, 1, 2, 3]]), "tetrahedra and need nodes \\(n, 3\\)"),
        (lambda: Mesh(np.eye(4)[:, :3] * [1, 1, 0], [[0, 1, 2, 3]]), "tetrahedron 0 has no volume"),
        (
            lambda: TransferModel(thicken(flat(0.03), 0.01), GRID.mapped(in_space).with_discs(6e-3, 1e-4), S),
            "as much on one face",
        ),
        (
            lambda: TransferModel(thicken(flat(0.03), 0.01), GRID.mapped(in_space).with_rim_segments(0.01, 1.0), S),
            "faces, no rim",
        ),
    ],
)
def test_impossible_bodies_are_refused(make, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        make()


def test_a_surface_that_is_not_ordered_alike_has_no_below() -> None:
    elements = flat(0.03).elements.copy()
    elements[3] = elements[3][::-1]
    with pytest.raises(GeometryError, match="have mixed orientations"):
        thicken(Mesh(in_space(flat(0.03).nodes), elements), 0.01)


# --- anisotropy -------------------------------------------------------------------------------------------------------

TENSOR = S * np.array([[2.0, 0.6], [0.6, 0.9]])


def test_an_anisotropic_sheet_is_a_stretched_isotropic_one() -> None:
    """With x' = M x the tensor becomes M T M^T / det M: for M = T^-1/2 isotropic, sqrt(det T). Exact for elements."""
    mesh = flat()
    values, vectors = np.linalg.eigh(TENSOR)
    stretch = vectors @ np.diag(values**-0.5) @ vectors.T

    def move(points: np.ndarray) -> np.ndarray:
        return points @ stretch

    anisotropic = TransferModel(mesh, GRID, TENSOR)
    isotropic = TransferModel(mesh.mapped(move), GRID.mapped(move), np.sqrt(np.linalg.det(TENSOR)))
    np.testing.assert_allclose(anisotropic.transfer_resistance, isotropic.transfer_resistance, rtol=1e-9, atol=1e-8)
    assert anisotropic.conductivity == pytest.approx(np.sqrt(np.linalg.det(TENSOR)), rel=1e-12)
    relative_one = anisotropic.pair_sensitivity * anisotropic.conductivity
    np.testing.assert_allclose(relative_one, isotropic.pair_sensitivity * isotropic.conductivity, rtol=1e-7, atol=1e-9)
    j, straight = anisotropic.current_density(0, 6), isotropic.current_density(0, 6)
    np.testing.assert_allclose(j @ stretch / np.linalg.det(stretch), straight, atol=1e-9 * np.abs(straight).max())


def test_equal_tensors_are_the_isotropic_sheet_on_flat_and_bent_meshes() -> None:
    for mesh, electrodes, dim in ((flat(), MIXED, 2), (flat().mapped(bend), MIXED.mapped(bend), 3)):
        tensors = TransferModel(mesh, electrodes, S * np.eye(dim))
        plain = TransferModel(mesh, electrodes, S)
        np.testing.assert_allclose(tensors.transfer_resistance, plain.transfer_resistance, rtol=1e-10, atol=1e-8)
        np.testing.assert_allclose(tensors.current_density(0, 5), plain.current_density(0, 5), atol=1e-9)


def test_of_a_tensor_in_space_only_what_is_tangential_counts() -> None:
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    whole = np.zeros((3, 3))
    whole[:2, :2] = TENSOR
    whole[2] = whole[:, 2] = S * np.array([0.3, -0.2, 5.0])  # across the sheet and between the two

    def tilt(points: np.ndarray) -> np.ndarray:
        return in_space(points) @ turn.T

    plain = TransferModel(flat(), GRID, TENSOR)
    tilted = TransferModel(flat().mapped(tilt), GRID.mapped(tilt), turn @ whole @ turn.T)
    np.testing.assert_allclose(tilted.conductivity, plain.conductivity, rtol=1e-10)
    np.testing.assert_allclose(tilted.transfer_resistance, plain.transfer_resistance, atol=1e-7)
    np.testing.assert_allclose(tilted.pair_sensitivity, plain.pair_sensitivity, rtol=1e-6, atol=1e-3)
    flow = plain.current_density(0, 6)
    np.testing.assert_allclose(tilted.current_density(0, 6), tilt(flow), atol=1e-9 * np.abs(flow).max())


def test_the_tensor_sensitivity_is_the_derivative() -> None:
    rng, mesh = np.random.default_rng(0), flat()
    wobble = rng.normal(size=(mesh.n_elem, 2, 2)) * 0.2 * S
    base = TENSOR + wobble @ wobble.swapaxes(1, 2) / S
    direction = rng.normal(size=base.shape) * S
    direction += direction.swapaxes(1, 2)
    up, down = (TransferModel(mesh, MIXED, base + t * direction).voltages(PATTERN, 1e-3) for t in (1e-4, -1e-4))
    rows = TransferModel(mesh, MIXED, base).tensor_sensitivity(PATTERN, 1e-3)
    np.testing.assert_array_equal(rows, rows.swapaxes(2, 3))
    assert relative(np.einsum("meab,eab->m", rows, direction), (up - down) / 2e-4) < 1e-6


def test_the_sensitivity_of_an_anisotropic_sheet_is_that_to_the_factor_of_its_tensors() -> None:
    model, rng = TransferModel(flat(), MIXED, TENSOR), np.random.default_rng(1)
    direction = rng.normal(size=flat().n_elem) * model.conductivity
    up, down = (model.with_conductivity(model.conductivity + t * direction).voltages(PATTERN) for t in (1e-4, -1e-4))
    assert relative(model.sensitivity(PATTERN) @ direction, (up - down) / 2e-4) < 1e-6
    np.testing.assert_allclose(model.tensors, np.broadcast_to(TENSOR, (flat().n_elem, 2, 2)), rtol=1e-12)


@pytest.mark.parametrize(
    ("tensor", "message"),
    [
        (
            np.array([[1.0, 0.5], [0.4, 1.0]]),
            "triangle 0 is .* must be symmetric positive definite \\(siemens per square\\)",
        ),
        (np.array([[1.0, 2.0], [2.0, 1.0]]), "must be symmetric positive definite"),
        (np.array([[np.nan, 0], [0, 1.0]]), "must be symmetric positive definite"),
        (np.eye(3), "give one value or .* or tensors \\(2, 2\\)"),
    ],
)
def test_impossible_tensors_are_refused(tensor: np.ndarray, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        TransferModel(flat(), GRID, tensor)


# --- gmsh -------------------------------------------------------------------------------------------------------------


def test_gmsh_refines_at_electrodes_and_puts_them_at_nodes() -> None:
    electrodes = GRID.with_discs(3e-3, 1e-4, range(12, 15)).with_rim_segments(6e-3, 0.1, range(12))
    mesh = mesh_graded(SHEET, 0.01, electrodes)
    assert mesh.measures.sum() == pytest.approx(0.04, rel=1e-12)
    mesh.nodes_at(GRID.positions[12:], tolerance=1e-15)
    x, y = GRID.positions[1]
    mesh.nodes_at(
        [[x - 3e-3, y], [x + 3e-3, y], [3e-3, 0], [0, 3e-3]], tolerance=1e-12
    )  # ends, round the corner as well
    mesh.nodes_at(GRID.positions[13] + regular(4, 3e-3), tolerance=1e-12)
    assert least_angle(mesh) > 25
    near = np.linalg.norm(mesh.centroids[:, None] - GRID.positions, axis=2).min(axis=1)
    assert mesh.measures[near > 0.02].mean() > 30 * mesh.measures[near < 3e-3].mean()


def test_refined_at_electrodes_a_graded_mesh_beats_an_even_one_of_more_nodes() -> None:
    electrodes = GRID.with_discs(3e-3, 1e-4, range(12, 16)).with_rim_segments(6e-3, 0.5, range(12))
    fine = TransferModel(mesh_graded(SHEET, 0.005, electrodes, fine=1.5e-4), electrodes, S).transfer_resistance
    graded = mesh_graded(SHEET, 0.012, electrodes)
    even = mesh_domain(SHEET, 0.0032, electrodes)
    assert graded.n_nodes < even.n_nodes
    error = [relative(TransferModel(mesh, electrodes, S).transfer_resistance, fine) for mesh in (graded, even)]
    assert error[0] < 1e-2
    assert error[0] < error[1] / 3


def test_rings_of_nodes_resolve_discs_as_gmsh_does() -> None:
    """What contact impedances three times as high do to undriven voltages, on edges twice as long as the radius."""
    discs, pattern = GRID.with_discs(3e-3, 1e-4), adjacent(GRID.rings)

    def voltages(mesh: Mesh) -> np.ndarray:
        models = (TransferModel(mesh, discs.with_contact_impedances(z), S) for z in (1e-4, 3e-4))
        return np.array([model.voltages(pattern) for model in models])

    exact = voltages(mesh_graded(SHEET, 5e-3, discs, fine=2.5e-4))
    ringed = voltages(mesh_domain(SHEET, 6e-3, electrode_points(SHEET, discs, 1.3e-4), closest=0.02))
    plain = voltages(mesh_domain(SHEET, 6e-3, discs))
    assert relative(ringed, exact) < 2e-3 < relative(plain, exact)
    assert relative(np.diff(ringed, axis=0), np.diff(exact, axis=0)) < 0.1
    assert relative(np.diff(plain, axis=0), np.diff(exact, axis=0)) > 0.5


def test_rings_keep_to_their_electrode_and_off_the_corners() -> None:
    """Electrodes 7 mm apart, one of them 2 mm from a corner."""
    near = Electrodes.at([[0.002, 0.0], [0.009, 0.0], [0.1, 0.1], [0.107, 0.1], [0.1, 0.2]]).with_discs(3e-3, 1e-4)
    points = electrode_points(SHEET, near, 1e-4)
    assert len(mesh_domain(SHEET, 5e-3, points, closest=0.02).nodes_at(near.positions, tolerance=1e-12)) == 5
    between = points[(points[:, 1] > 0.095) & (points[:, 1] < 0.105)]
    own = np.linalg.norm(between[:, None] - near.positions[2:4], axis=2)
    assert (own.min(axis=1) < 12.1e-3).all()
    assert np.linalg.norm(points, axis=1).min() > 1e-4  # a corner is a node of the mesh anyhow


@pytest.mark.parametrize("domain", [SHEET, Disc(0.1), ell()], ids=["rectangle", "disc", "polygon"])
def test_gmsh_keeps_outlines_and_holes(domain) -> None:
    mesh = mesh_graded(domain, 0.012, Electrodes.rim(domain, 8))
    assert mesh.measures.sum() == pytest.approx(domain.area, rel=3e-3)
    assert (domain.depth(mesh.nodes) > -1e-9).all()
    rim = mesh.nodes[np.unique(mesh.boundary)]
    assert np.abs(domain.depth(rim)).max() < 1e-9


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: mesh_graded(SHEET, 0.0, GRID), "mesh size 0.0 m; it must be"),
        (lambda: mesh_graded(SHEET, 0.01, GRID, fine=-1.0), "mesh fine -1.0 m"),
        (lambda: mesh_graded(SHEET, 0.01, GRID, growth=5), "growth is 5; it must be 0.01 to 1"),
        (lambda: mesh_graded(Rectangle(0.1, 0.1), 0.01, GRID), "electrode at .* lies outside the domain"),
        (
            lambda: mesh_graded(SHEET, 0.01, GRID.with_rim_segments(0.01, 1.0)),
            "rim electrode 12 at .* away from the rim",
        ),
        (lambda: mesh_graded(SHEET, 0.01, GRID.mapped(in_space)), "electrodes in space do not fit a flat domain"),
        (lambda: mesh_surface(flat(), 0.01, GRID), "triangles in space anew"),
        (lambda: mesh_surface(flat().mapped(bend), 0.01, GRID), "need three coordinates"),
    ],
)
def test_impossible_graded_meshes_are_refused(make, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        make()


def test_a_missing_extra_names_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for package, make in (
        ("gmsh", lambda: mesh_graded(SHEET, 0.01, GRID)),
        ("meshio", lambda: write_mesh(tmp_path / "a.vtu", flat())),
    ):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(GeometryError, match=rf"cannot import {package} .* pip install 'ohmskin\[mesh\]'"):
            make()


# --- files ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ["vtu", "vtk", "msh", "inp", "ply", "obj", "stl"])
def test_surfaces_come_back_from_files(ending: str, tmp_path: Path) -> None:
    mesh = flat(0.03).mapped(bend)
    write_mesh(tmp_path / f"a.{ending}", mesh)
    again = read_mesh(tmp_path / f"a.{ending}")
    assert (again.n_nodes, again.n_elem) == (mesh.n_nodes, mesh.n_elem)
    assert again.measures.sum() == pytest.approx(mesh.measures.sum(), rel=1e-4)
    assert read_mesh(tmp_path / f"a.{ending}", 1e-3).measures.sum() == pytest.approx(
        1e-6 * mesh.measures.sum(), rel=1e-4
    )


def test_bodies_and_their_values_come_back_from_files(tmp_path: Path) -> None:
    import meshio

    body = thicken(flat(0.03), 0.01, 2)
    write_mesh(tmp_path / "body.vtu", body, {"conductivity": np.arange(body.n_elem), "potential": body.nodes[:, 0]})
    again = read_mesh(tmp_path / "body.vtu")
    np.testing.assert_allclose(again.nodes[again.elements], body.nodes[body.elements])
    stored = meshio.read(tmp_path / "body.vtu")
    np.testing.assert_array_equal(stored.cell_data["conductivity"][0], np.arange(body.n_elem))
    np.testing.assert_allclose(stored.point_data["potential"], body.nodes[:, 0])


def test_a_flat_mesh_comes_back_flat(tmp_path: Path) -> None:
    write_mesh(tmp_path / "a.vtu", flat(0.03))
    again = read_mesh(tmp_path / "a.vtu")
    assert again.nodes.shape[1] == 2
    np.testing.assert_allclose(again.measures, flat(0.03).measures)


def test_unusable_files_are_refused(tmp_path: Path) -> None:
    import meshio

    with pytest.raises(GeometryError, match="no mesh file"):
        read_mesh(tmp_path / "absent.msh")
    (tmp_path / "a.msh").write_text("nonsense")
    with pytest.raises(GeometryError, match=r"cannot read mesh file .*a\.msh"):
        read_mesh(tmp_path / "a.msh")
    (tmp_path / "a.xyz7").write_text("nonsense")
    with pytest.raises(GeometryError, match="cannot read mesh file"):
        read_mesh(tmp_path / "a.xyz7")
    meshio.Mesh(np.eye(4)[:, :3], [("quad", [[0, 1, 2, 3]])]).write(tmp_path / "quad.vtu")
    with pytest.raises(GeometryError, match="has quad; need triangles or tetrahedra"):
        read_mesh(tmp_path / "quad.vtu")
    with pytest.raises(GeometryError, match="scale is -1"):
        read_mesh(tmp_path / "quad.vtu", -1)
    with pytest.raises(GeometryError, match=r"field 'x' has shape \(3,\)"):
        write_mesh(tmp_path / "a.vtu", flat(0.03), {"x": np.ones(3)})
    with pytest.raises(GeometryError, match="cannot write mesh file"):
        write_mesh(tmp_path / "a.nothing", flat(0.03))


def test_any_pattern_runs_on_any_skin() -> None:
    for mesh, electrodes in (
        (flat(), MIXED),
        (flat().mapped(bend), MIXED.mapped(bend)),
        (thicken(flat(0.03), 0.01, 2), GRID.with_discs(6e-3, 1e-4, range(12, 16)).mapped(in_space)),
    ):
        model = TransferModel(mesh, electrodes, S)
        for pattern in (PATTERN, skip([range(16)], 3)):
            volts = model.voltages(pattern)
            lost = model.sensitivity(pattern) @ model.conductivity
            contact = model.contact_sensitivity(pattern) @ electrodes.contact_impedances
            np.testing.assert_allclose(contact - lost, volts, atol=1e-9 * np.abs(volts).max())


def test_a_broken_pipe_stays_an_error_that_can_be_caught() -> None:
    """gmsh sets SIGPIPE to its default, which ends the process; seen by writing to a pipe that nobody reads."""
    script = (
        "import os\nfrom ohmskin import Rectangle, mesh_graded\nfrom ohmskin.geometry import Electrodes\n"
        "sheet = Rectangle(0.1, 0.1)\nmesh_graded(sheet, 0.02, Electrodes.grid(sheet))\n"
        "reading, writing = os.pipe()\nos.close(reading)\n"
        "try:\n    os.write(writing, b'x')\nexcept BrokenPipeError:\n    print('caught')\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "caught\n"), done.stderr
