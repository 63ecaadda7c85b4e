"""The forward model against analytic solutions, conservation laws, finite differences and an independent
implementation."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ohmskin.errors import GeometryError, ModelError, PatternError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Disc, Electrodes, Rectangle, mesh_domain
from ohmskin.scan import DrivePattern, adjacent, all_pairs, measure_others, skip

SHEET = Rectangle(0.2, 0.2)
GRID = Electrodes.grid(SHEET)
PAPER = adjacent(GRID.rings)


def uneven(n_elem: int, seed: int = 0) -> np.ndarray:
    return 1.83e-3 * np.random.default_rng(seed).uniform(0.5, 2.0, n_elem)


@cache
def model(size: float = 0.012) -> TransferModel:
    """The paper's layout on a sheet of uneven conductivity."""
    mesh = mesh_domain(SHEET, size, GRID.positions)
    return TransferModel(mesh, GRID, uneven(mesh.n_elem))


def random_pattern(seed: int, n_meas: int = 12) -> DrivePattern:
    """Any pairs, driven electrodes measured, too."""
    rng = np.random.default_rng(seed)
    pairs = all_pairs(16)
    injections = pairs[rng.choice(len(pairs), 4, replace=False)]
    which = np.sort(rng.integers(0, 4, n_meas))
    return DrivePattern(injections, np.column_stack([which, pairs[rng.choice(len(pairs), n_meas)][:, ::-1]]))


# --- analytic solutions -----------------------------------------------------------------------------------------------


def test_potential_on_the_rim_of_a_disc_converges_with_second_order() -> None:
    """Current I between two points of the rim: phi(x) = I / (pi s) ln(r_sink / r_source)."""
    s, disc = 1.83e-3, Disc(0.1)
    electrodes = Electrodes.rim(disc, 16)
    pattern = skip([range(16)], 5)
    apart = np.linalg.norm(electrodes.positions[:, None] - electrodes.positions[None], axis=2)
    a, b, c, d = pattern.quadruples.T
    exact = np.log(apart[c, b] / apart[c, a] * apart[d, a] / apart[d, b]) / (np.pi * s)
    sizes = np.array([0.02, 0.01, 0.005, 0.0025])
    error = []
    for size in sizes:
        mesh = mesh_domain(disc, size, electrodes.positions)
        error.append(
            np.linalg.norm(TransferModel(mesh, electrodes, s).voltages(pattern) - exact) / np.linalg.norm(exact)
        )
    order = np.polyfit(np.log(sizes), np.log(error), 1)[0]
    assert order == pytest.approx(2, abs=0.25)
    assert error[-1] < 5e-4


def test_resistance_of_a_strip_is_length_over_width_and_conductivity() -> None:
    """A long strip between opposite ends is one-dimensional in the middle: V = I d / (s w), exact for linear
    elements."""
    strip = Rectangle(0.3, 0.02)
    ends = [[0, 0.01], [0.3, 0.01]]
    probes = [[0.1, 0.0], [0.1, 0.02], [0.2, 0.0], [0.2, 0.02]]
    electrodes = Electrodes.at(ends + probes)
    tube = TransferModel(mesh_domain(strip, 0.0025, electrodes.positions), electrodes, 2e-3)
    volts = tube.voltages(DrivePattern([[0, 1]], [[0, 2, 4], [0, 3, 5], [0, 2, 3]]), 1e-3)
    assert volts == pytest.approx([1e-3 * 0.1 / (2e-3 * 0.02)] * 2 + [0], rel=1e-5, abs=1e-5)


def test_a_driven_electrode_diverges_as_the_logarithm_of_the_mesh_size() -> None:
    """Documented weakness of point electrodes; a corner of the sheet sees a quarter plane: R grows by 2 ln 2 / (pi s)
    each."""
    s = 1.83e-3
    corners = DrivePattern([[0, 6]], [[0, 0, 6]])
    resistance = [
        TransferModel(mesh_domain(SHEET, size, GRID.positions), GRID, s).voltages(corners)[0]
        for size in (0.01, 0.005, 0.0025)
    ]
    assert np.diff(resistance) == pytest.approx([2 * 2 * np.log(2) / (np.pi * s)] * 2, rel=0.05)


# --- conservation and symmetry ----------------------------------------------------------------------------------------


def test_transfer_resistance_is_symmetric_zero_mean_and_positive_on_zero_sum_currents() -> None:
    s = model().transfer_resistance
    assert np.abs(s - s.T).max() == 0
    assert np.abs(s.sum(axis=0)).max() < 1e-10 * np.abs(s).max()
    assert np.linalg.eigvalsh(s)[1] > 0


def test_reciprocity_holds_for_the_solved_potentials() -> None:
    """R(ab, cd) = R(cd, ab), from the potentials themselves, which the symmetrised transfer matrix would hide."""
    v = model().potentials[model().mesh.nodes_at(GRID.positions)]
    pairs = all_pairs(16)
    driven = v[:, pairs[:, 0]] - v[:, pairs[:, 1]]
    resistance = driven[pairs[:, 0]] - driven[pairs[:, 1]]
    assert np.abs(resistance - resistance.T).max() < 1e-10 * np.abs(resistance).max()


def test_voltages_are_those_of_the_potentials() -> None:
    for seed in range(5):
        pattern = random_pattern(seed)
        currents = np.random.default_rng(seed).normal(size=4)
        nodes = model().mesh.nodes_at(GRID.positions)
        expected = []
        for k, plus, minus in pattern.measurements:
            phi = currents[k] * (
                model().potentials[:, pattern.injections[k, 0]] - model().potentials[:, pattern.injections[k, 1]]
            )
            expected.append(phi[nodes[plus]] - phi[nodes[minus]])
        np.testing.assert_allclose(model().voltages(pattern, currents), expected, atol=1e-10 * np.abs(expected).max())


@given(st.permutations(range(16)))
@settings(max_examples=30)
def test_voltages_of_two_injections_in_series_add_up(order: list[int]) -> None:
    """Superposition: a -> b and b -> c together are a -> c; and voltages add up along a path."""
    a, b, c, d, e, f = order[:6]
    volts = model().voltages(
        DrivePattern([[a, b], [b, c], [a, c]], [[k, *p] for k in range(3) for p in ((d, e), (e, f), (d, f))])
    )
    scale = np.abs(model().transfer_resistance).max()
    assert volts[:3] + volts[3:6] == pytest.approx(volts[6:], abs=1e-11 * scale)
    assert volts[0::3] + volts[1::3] == pytest.approx(volts[2::3], abs=1e-11 * scale)
    turned = model().voltages(DrivePattern([[b, a]], [[0, e, d]]))
    assert turned[0] == pytest.approx(volts[0], abs=1e-11 * scale)


@pytest.mark.parametrize(("source", "sink"), [(0, 6), (13, 15), (3, 14)])
def test_current_through_any_cut_is_the_injected_current(source: int, sink: int) -> None:
    """The flux out of each node's cell vanishes but at the electrodes: finite elements conserve current exactly
    there."""
    mesh, current = model().mesh, 3e-3
    j = model().current_density(source, sink, current)
    flux = np.zeros(mesh.n_nodes)  # int j . grad N_i, the current that leaves into node i's cell
    np.add.at(flux, mesh.elements, -np.einsum("ed,ekd,e->ek", j, mesh.gradients, mesh.measures))
    nodes = mesh.nodes_at(GRID.positions)
    expected = np.zeros(mesh.n_nodes)
    expected[nodes[source]], expected[nodes[sink]] = current, -current
    np.testing.assert_allclose(flux, expected, atol=1e-12 * current * 1e3)


def test_current_flows_from_source_to_sink() -> None:
    """Total current across the sheet, int j dA = I (x_sink - x_source) for insulated rims (a discrete identity,
    too)."""
    for source, sink in ((0, 6), (12, 14), (4, 9)):
        j = model().current_density(source, sink, 2e-3)
        moment = model().mesh.measures @ j
        assert moment == pytest.approx(2e-3 * (GRID.positions[sink] - GRID.positions[source]), abs=1e-13)


@pytest.mark.parametrize(("source", "sink"), [(0, 1), (5, 13)])
def test_power_dissipated_in_the_sheet_is_voltage_times_current(source: int, sink: int) -> None:
    current = 4e-3
    j = model().current_density(source, sink, current)
    power = np.sum((j**2).sum(1) / model().conductivity * model().mesh.measures)
    voltage = model().voltages(DrivePattern([[source, sink]], [[0, source, sink]]), current)[0]
    assert power == pytest.approx(voltage * current, rel=1e-11)


# --- sensitivity ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_sensitivity_is_the_derivative_of_refactorised_models(seed: int) -> None:
    rng = np.random.default_rng(seed)
    base, pattern, currents = model(), random_pattern(seed), rng.normal(size=4) * 1e-3
    jacobian = base.sensitivity(pattern, currents)
    assert jacobian.shape == (pattern.n_meas, base.mesh.n_elem)
    everywhere = rng.normal(size=base.mesh.n_elem) * base.conductivity
    somewhere = np.eye(base.mesh.n_elem)[rng.integers(base.mesh.n_elem)]
    for direction in (everywhere, somewhere):
        step = 1e-5 * direction / np.abs(direction / base.conductivity).max()
        up, down = (
            TransferModel(base.mesh, GRID, base.conductivity + sign * step).voltages(pattern, currents)
            for sign in (1, -1)
        )
        slope = jacobian @ (2 * step)
        np.testing.assert_allclose(up - down, slope, atol=1e-6 * np.abs(slope).max() + 3e-13 * np.abs(up).max())


def test_more_conductance_means_less_resistance_between_any_two_electrodes() -> None:
    assert model().pair_sensitivity.max() <= 0


@given(st.integers(0, 10_000))
@settings(max_examples=20)
def test_voltage_is_homogeneous_of_degree_minus_one(seed: int) -> None:
    """Euler: J sigma = -V."""
    pattern = random_pattern(seed)
    volts = model().voltages(pattern, 1e-3)
    scale = np.abs(model().transfer_resistance).max() * 1e-3
    np.testing.assert_allclose(model().sensitivity(pattern, 1e-3) @ model().conductivity, -volts, atol=1e-10 * scale)


@pytest.mark.parametrize("factor", [1e-3, 0.5, 7.0])
def test_a_scaled_model_is_the_model_of_scaled_conductivity(factor: float) -> None:
    scaled, anew = model().scaled(factor), TransferModel(model().mesh, GRID, model().conductivity * factor)
    np.testing.assert_allclose(scaled.transfer_resistance, anew.transfer_resistance, rtol=1e-9, atol=1e-9 / factor)
    largest = np.abs(anew.pair_sensitivity).max()
    np.testing.assert_allclose(scaled.pair_sensitivity, anew.pair_sensitivity, rtol=1e-7, atol=1e-9 * largest)
    np.testing.assert_allclose(scaled.current_density(0, 5), anew.current_density(0, 5), atol=1e-9)
    np.testing.assert_array_equal(scaled.conductivity, anew.conductivity)


# --- an independent implementation ------------------------------------------------------------------------------------


def test_voltages_and_sensitivity_are_those_of_pyeit_on_the_same_mesh() -> None:
    """pyEIT's Jacobian is -dV/dsigma; its measurement is V(first) - V(second) of `meas_mat`."""
    fem = pytest.importorskip("pyeit.eit.fem", reason="pyEIT is not installed")
    from pyeit.eit.protocol import PyEITProtocol
    from pyeit.mesh.wrapper import PyEITMesh

    ours = model()
    mesh = PyEITMesh(
        node=np.column_stack([ours.mesh.nodes, np.zeros(ours.mesh.n_nodes)]),
        element=np.array(ours.mesh.elements),
        perm=np.array(ours.conductivity),
        el_pos=ours.mesh.nodes_at(GRID.positions),
        ref_node=0,
    )
    meas = np.array(PAPER.measurements[:, 1:]).reshape(PAPER.n_inj, -1, 2)
    protocol = PyEITProtocol(ex_mat=np.array(PAPER.injections), meas_mat=meas, keep_ba=np.ones(PAPER.n_meas, bool))
    theirs = fem.EITForward(mesh, protocol)
    jacobian, volts = theirs.compute_jac()
    np.testing.assert_allclose(ours.voltages(PAPER), volts, rtol=0, atol=1e-9 * np.abs(volts).max())
    np.testing.assert_allclose(ours.sensitivity(PAPER), -jacobian, rtol=0, atol=1e-9 * np.abs(jacobian).max())


# --- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_conductivity_must_be_positive(bad: float) -> None:
    mesh = model().mesh
    with pytest.raises(ModelError, match=r"triangle 0 is .* must be positive"):
        TransferModel(mesh, GRID, bad)
    one = np.ones(mesh.n_elem)
    one[17] = bad
    with pytest.raises(ModelError, match=r"triangle 17 is .* must be positive"):
        TransferModel(mesh, GRID, one)
    with pytest.raises(ModelError, match=r"factor is .* must be positive"):
        model().scaled(bad)


@pytest.mark.parametrize("shape", [(3,), (1,), (2, 3)])
def test_conductivity_is_one_value_or_one_per_triangle(shape: tuple[int, ...]) -> None:
    with pytest.raises(ModelError, match="give one value or"):
        TransferModel(model().mesh, GRID, np.ones(shape))


def test_electrodes_must_be_nodes() -> None:
    with pytest.raises(GeometryError, match="make the mesh with these points"):
        TransferModel(mesh_domain(SHEET, 0.012), Electrodes.grid(SHEET, inset=0.013), 1.0)


def test_patterns_must_fit_the_electrodes() -> None:
    beyond = measure_others([[0, 16]], range(16))
    for ask in (model().voltages, model().sensitivity):
        with pytest.raises(PatternError, match="names electrode 16"):
            ask(beyond)
    for source, sink in ((0, 16), (16, 0), (-1, 3), (4, 4)):
        with pytest.raises(PatternError):
            model().current_density(source, sink)


def test_the_model_keeps_its_own_conductivity() -> None:
    given = np.full(model().mesh.n_elem, 2.0)
    made = TransferModel(model().mesh, GRID, given)
    given[:] = 5
    assert made.conductivity.max() == 2
