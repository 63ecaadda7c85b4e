"""Electrodes of a mesh's facets, and models of other programs that have them."""

from itertools import combinations
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import scipy.io
from matplotlib.figure import Figure
from matplotlib.tri import LinearTriInterpolator, Triangulation

import ohmskin as ohm
from ohmskin.arrays import Floats, Ints
from ohmskin.errors import DataError, GeometryError, ModelError
from ohmskin.geometry import ElectrodeKind, Electrodes, Mesh
from ohmskin.plot import draw_current, draw_mesh

IMPEDANCE = 0.02


def square() -> Mesh:
    return ohm.mesh_domain(ohm.Rectangle(0.2, 0.2), 0.025)


def box() -> Mesh:
    """A body of 4 x 3 x 2 bricks, six tetrahedra each."""
    x, y, z = np.meshgrid(np.linspace(0, 0.2, 5), np.linspace(0, 0.1, 4), np.linspace(0, 0.06, 3), indexing="ij")
    nodes = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    number = np.arange(len(nodes)).reshape(x.shape)
    steps, found = np.eye(3, dtype=int), []
    for corner in np.ndindex(4, 3, 2):
        for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
            walk = np.array(corner) + np.cumsum([np.zeros(3, int), *steps[list(order)]], axis=0)
            found.append([number[tuple(at)] for at in walk])
    return Mesh(nodes, np.array(found))


def on_side(mesh: Mesh, axis: int, end: int, low: float, high: float) -> Ints:
    """Nodes on one side of a body, between two places along the next axis."""
    side = np.isclose(mesh.nodes[:, axis], [mesh.nodes[:, axis].min(), mesh.nodes[:, axis].max()][end])
    along = mesh.nodes[:, (axis + 1) % mesh.dim]
    return np.flatnonzero(side & (along > low - 1e-9) & (along < high + 1e-9))


def groups_of(mesh: Mesh) -> list[Ints]:
    """Three electrodes of several facets, and two points."""
    high = mesh.nodes.max(axis=0)
    areas = [on_side(mesh, 0, 0, 0, high[1] / 2), on_side(mesh, 0, 1, 0, high[1]), on_side(mesh, 1, 1, 0, high[-1] / 2)]
    points = np.setdiff1d(mesh.boundary, np.concatenate(areas))[:2]
    return [*areas, *points[:, None]]


def dense(mesh: Mesh, groups: list[Ints], impedances: Floats, conductivity: Floats) -> Floats:
    """Two-terminal resistances by the complete electrode model, assembled element by element from its textbook form."""
    n, many = mesh.n_nodes, len(groups)
    matrix = np.zeros((n + many, n + many))
    for element, sigma in zip(mesh.elements, conductivity, strict=True):
        corners = np.column_stack([np.ones(len(element)), mesh.nodes[element]])
        gradients = np.linalg.inv(corners)[1:].T
        size = abs(np.linalg.det(corners)) / (2 if mesh.dim == 2 else 6)
        matrix[np.ix_(element, element)] += sigma * size * gradients @ gradients.T
    terminals = []
    for k, group in enumerate(groups):
        if len(group) == 1:
            terminals.append(int(group[0]))
            matrix[n + k, n + k] = 1.0  # not used
            continue
        terminals.append(n + k)
        for facet in mesh.boundary[np.isin(mesh.boundary, group).all(axis=1)]:
            sides = mesh.nodes[facet[1:]] - mesh.nodes[facet[0]]
            size = np.sqrt(np.linalg.det(sides @ sides.T)) / (1 if mesh.dim == 2 else 2)
            count = mesh.dim
            mass = size * (np.ones((count, count)) + np.eye(count)) / (count * (count + 1)) / impedances[k]
            matrix[np.ix_(facet, facet)] += mass
            matrix[facet, n + k] -= mass.sum(axis=1)
            matrix[n + k, facet] -= mass.sum(axis=1)
            matrix[n + k, n + k] += mass.sum()
    found = []
    for a, b in combinations(terminals, 2):
        load = np.zeros(len(matrix))
        load[a], load[b] = 1.0, -1.0
        potential = np.linalg.lstsq(matrix, load, rcond=None)[0]
        found.append(potential[a] - potential[b])
    return np.array(found)


def resistances(model: ohm.TransferModel) -> Floats:
    potentials = model.electrode_potentials
    return np.array(
        [
            potentials[a, a] - potentials[a, b] - potentials[b, a] + potentials[b, b]
            for a, b in combinations(range(len(potentials)), 2)
        ]
    )


@pytest.fixture(params=[square, box], ids=["edges", "faces"])
def mesh(request: pytest.FixtureRequest) -> Mesh:
    made = request.param()
    assert isinstance(made, Mesh)
    return made


def test_facets_and_points_agree_with_the_textbook(mesh: Mesh) -> None:
    groups = groups_of(mesh)
    electrodes = Electrodes.on_mesh(mesh, groups, [IMPEDANCE, 2 * IMPEDANCE, IMPEDANCE, 0, 0])
    assert electrodes.kinds == (ElectrodeKind.FACETS,) * 3 + (ElectrodeKind.POINT,) * 2
    conductivity = np.random.default_rng(1).uniform(0.5, 2, mesh.n_elem)
    model = ohm.TransferModel(mesh, electrodes, conductivity)
    expected = dense(mesh, groups, electrodes.contact_impedances, conductivity)
    np.testing.assert_allclose(resistances(model), expected, rtol=1e-10)


def test_the_sensitivity_to_facets_contact_impedance_is_its_derivative(mesh: Mesh) -> None:
    electrodes = Electrodes.on_mesh(mesh, groups_of(mesh), IMPEDANCE)
    model, step = ohm.TransferModel(mesh, electrodes, 1.0), 1e-5 * IMPEDANCE
    for k in range(3):
        moved = electrodes.contact_impedances.copy()
        moved[k] += step
        difference = (resistances(model.with_contact_impedances(moved)) - resistances(model)) / step
        told = model.pair_contact_sensitivity[:, k]
        scale = np.linalg.norm(difference) / np.linalg.norm(told)
        np.testing.assert_allclose(scale * told, difference, atol=1e-3 * np.abs(difference).max())


def test_explicit_facets_are_those_of_their_nodes(mesh: Mesh) -> None:
    groups = groups_of(mesh)
    facets = [mesh.boundary[np.isin(mesh.boundary, g).all(axis=1)] if len(g) > 1 else g for g in groups]
    one, other = (Electrodes.on_mesh(mesh, given, IMPEDANCE) for given in (groups, facets))
    np.testing.assert_array_equal(one.positions, other.positions)
    assert all(np.array_equal(a, b) for a, b in zip(one.facets, other.facets, strict=True))


def stored(path: Path, mesh: Mesh, groups: list[Ints], **more: Any) -> Path:
    """A .mat file as EIDORS' structs are saved."""
    electrodes = np.zeros((1, len(groups)), dtype=[("nodes", object), ("z_contact", object)])
    for k, group in enumerate(groups):
        electrodes[0, k] = (group[None] + 1, IMPEDANCE * (k + 1))
    stimulation = np.zeros((1, 2), dtype=[("stimulation", object), ("stim_pattern", object), ("meas_pattern", object)])
    for k in range(2):
        drive, measure = np.zeros((len(groups), 1)), np.zeros((1, len(groups)))
        drive[[k, k + 1], 0], measure[0, [k + 2, (k + 3) % len(groups)]] = (0.01, -0.01), (1, -1)
        stimulation[0, k] = ("Amp", scipy.sparse.csc_array(drive), scipy.sparse.csc_array(measure))
    model = {"nodes": mesh.nodes, "elems": mesh.elements + 1.0, "electrode": electrodes, "stimulation": stimulation}
    scipy.io.savemat(path, {"img": {"fwd_model": model, **more}})
    return path


def test_a_model_of_eidors_is_read_whole(mesh: Mesh, tmp_path: Path) -> None:
    groups, values = groups_of(mesh), np.random.default_rng(2).uniform(0.5, 2, mesh.n_elem)
    found = ohm.read_model(stored(tmp_path / "img.mat", mesh, groups, elem_data=values[:, None]))
    electrodes = Electrodes.on_mesh(mesh, groups, IMPEDANCE * np.arange(1, len(groups) + 1))
    np.testing.assert_allclose(
        resistances(found.transfer_model()), resistances(ohm.TransferModel(mesh, electrodes, values)), rtol=1e-12
    )
    assert found.drive is not None
    assert found.drive.pattern.injections.tolist() == [[0, 1], [1, 2]]
    assert found.drive.currents.tolist() == [0.01, 0.01]


def test_models_of_eidors_with_values_that_cannot_be_are_refused(tmp_path: Path) -> None:
    mesh = square()
    groups = groups_of(mesh)
    for part, value, words in (
        ("nodes", np.full((4, 2), 1e300), "mesh node 0 is not finite, or beyond 1e.100 m"),
        ("elems", np.full((1, 3), 1e300), "elems holds other numbers than 1, 2, 3"),
        ("z_contact", np.zeros((0, 0)), "electrode 1: z_contact has 0 values; need one"),
    ):
        path = stored(tmp_path / "img.mat", mesh, groups)
        variables = scipy.io.loadmat(path)
        model = variables["img"]["fwd_model"][0, 0]
        if part in model.dtype.names:
            model[part][0, 0] = value
        else:
            model["electrode"][0, 0][part][0, 0] = value
        scipy.io.savemat(path, {"img": variables["img"]})
        with pytest.raises((DataError, GeometryError), match=words):
            ohm.read_model(path)


def test_units_of_length_change_no_resistance(mesh: Mesh, tmp_path: Path) -> None:
    path = stored(tmp_path / "img.mat", mesh, groups_of(mesh), elem_data=np.full((mesh.n_elem, 1), 2.0))
    one, other = (ohm.read_model(path, scale=scale).transfer_model() for scale in (1.0, 1e-3))
    assert np.ptp(other.mesh.nodes[:, 0]) == pytest.approx(0.2e-3)
    np.testing.assert_allclose(resistances(other), resistances(one), rtol=1e-9)


def test_physical_groups_of_gmsh_are_electrodes(mesh: Mesh, tmp_path: Path) -> None:
    facet, element = ("line", "triangle") if mesh.dim == 2 else ("triangle", "tetra")
    groups = groups_of(mesh)
    blocks, tags, names = [(element, mesh.elements)], [np.full(mesh.n_elem, 99)], {"skin": np.array([99, mesh.dim])}
    for k, group in enumerate(groups):
        cells = mesh.boundary[np.isin(mesh.boundary, group).all(axis=1)] if len(group) > 1 else group[None]
        blocks.append((facet if len(group) > 1 else "vertex", cells))
        tags.append(np.full(len(cells), k + 1))
        names[f"electrode {10 - k}"] = np.array([k + 1, mesh.dim - 1 if len(group) > 1 else 0])
    nodes = mesh.nodes if mesh.dim == 3 else np.column_stack([mesh.nodes, np.zeros(mesh.n_nodes)])
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    meshio.Mesh(1e3 * nodes, blocks, cell_data=data, field_data=names).write(
        tmp_path / "skin.msh", file_format="gmsh22"
    )
    found = ohm.read_model(tmp_path / "skin.msh", scale=1e-3, contact_impedance=IMPEDANCE)
    expected = ohm.TransferModel(mesh, Electrodes.on_mesh(mesh, groups[::-1], IMPEDANCE), 2.0)
    np.testing.assert_allclose(resistances(found.transfer_model(2.0)), resistances(expected), rtol=1e-9)


def test_what_cannot_be_an_electrode_is_refused(mesh: Mesh, tmp_path: Path) -> None:
    groups = groups_of(mesh)
    inside = np.flatnonzero(~np.isin(np.arange(mesh.n_nodes), mesh.boundary))
    for wrong, words in (
        ([*groups[:3], [mesh.n_nodes]], "needs nodes 0 to"),
        ([*groups[:3], [0.5]], "needs nodes 0 to"),
        ([*groups[:3], inside[:3]], "make no facet"),
        ([*groups[:3], groups[1]], "electrodes 1 and 3 share a facet"),
        ([*groups[:3], np.zeros((2, 5), int)], "has shape"),
    ):
        with pytest.raises(GeometryError, match=words):
            Electrodes.on_mesh(mesh, wrong, IMPEDANCE)
    with pytest.raises(GeometryError, match="must be positive"):
        Electrodes.on_mesh(mesh, groups, 0.0)
    scipy.io.savemat(tmp_path / "data.mat", {"vi": np.ones((4, 1))})
    with pytest.raises(DataError, match="no struct with nodes, elems and electrode"):
        ohm.read_model(tmp_path / "data.mat")


def test_electrodes_of_facets_serve_with_their_mesh_alone(mesh: Mesh) -> None:
    electrodes = Electrodes.on_mesh(mesh, groups_of(mesh), IMPEDANCE)
    other = box() if mesh.dim == 2 else square()
    with pytest.raises(GeometryError, match=r"of another mesh|coordinates"):
        ohm.TransferModel(other, electrodes, 1.0)
    assert electrodes.with_points().kinds == (ElectrodeKind.POINT,) * 5
    if mesh.dim == 2:
        with pytest.raises(GeometryError, match="belong to the mesh"):
            ohm.mesh_domain(ohm.Rectangle(0.2, 0.2), 0.025, electrodes)


def test_simulated_frames_have_the_noise_asked_for() -> None:
    mesh = square()
    electrodes = Electrodes.at([[0, 0], [0.2, 0], [0.2, 0.2], [0, 0.2]])
    model, pattern = ohm.TransferModel(mesh, electrodes, 2e-3), ohm.adjacent(electrodes.rings)
    frames = model.simulate(pattern, 2e-3, noise=1e-4, count=2000, seed=3)
    volts = np.array([frame.voltages for frame in frames])
    np.testing.assert_allclose(volts.std(axis=0), 1e-4, rtol=0.08)
    np.testing.assert_allclose(volts.mean(axis=0), model.voltages(pattern, 2e-3), atol=1e-5)
    (exact,) = model.simulate(pattern, np.full(pattern.n_inj, 2e-3))
    np.testing.assert_array_equal(exact.voltages, model.voltages(pattern, 2e-3))
    for noise, count in ((-1e-3, 1), (np.nan, 1), (0.0, 0)):
        with pytest.raises(ModelError, match="noise"):
            model.simulate(pattern, noise=noise, count=count)


def test_meshes_fields_and_currents_are_drawn_in_one_call_each(mesh: Mesh) -> None:
    electrodes = Electrodes.on_mesh(mesh, groups_of(mesh), IMPEDANCE)
    model = ohm.TransferModel(mesh, electrodes, 1.0)
    figure = Figure()
    axes = figure.add_subplot(projection="3d") if mesh.dim == 3 else figure.add_subplot()
    faces = len(mesh.boundary) if mesh.dim == 3 else mesh.n_elem
    assert draw_mesh(axes, mesh, electrodes=electrodes).get_array() is None
    by_element = draw_mesh(axes, mesh, np.full(mesh.n_elem, 7.0))
    assert np.array_equal(by_element.get_array(), np.full(faces, 7.0))  # type: ignore[arg-type]
    signed = draw_mesh(axes, mesh, np.linspace(-1.0, 3.0, mesh.n_elem))
    assert min(signed.to_rgba(0.0)[:3]) > 0.9  # zero is near white
    by_node = draw_mesh(axes, mesh, model.potentials[:, 1], electrodes, edges=False)
    assert by_node.get_array().shape == (faces,)  # type: ignore[union-attr]
    figure.canvas.draw()
    with pytest.raises(DataError, match="by element or"):
        draw_mesh(axes, mesh, np.ones(3))
    other = figure.add_subplot() if mesh.dim == 3 else figure.add_subplot(projection="3d")
    with pytest.raises(DataError, match="needs other axes"):
        draw_mesh(other, mesh)
    if mesh.dim == 3:
        with pytest.raises(DataError, match="flat sheets"):
            draw_current(other, model, 0, 1)
    else:
        shown = draw_current(axes, model, 3, 4, 2e-3)
        expected = 2e-3 * (model.potentials[:, 3] - model.potentials[:, 4])[mesh.elements].mean(axis=1)
        np.testing.assert_allclose(shown.get_array(), expected)  # type: ignore[arg-type]
        lines = axes.collections[-1].get_segments()  # type: ignore[attr-defined]
        begins, ends = (np.array([line[k] for line in lines]) * 1e-3 for k in (0, -1))
        volts = LinearTriInterpolator(Triangulation(*mesh.nodes.T, mesh.elements), model.potentials @ [0, 0, 0, 1, -1])
        assert np.mean(volts(*begins.T) >= volts(*ends.T)) > 0.95  # current flows down the potential
