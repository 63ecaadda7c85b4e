"""The complete electrode model and its excitations against Fourier and Bessel series, limits, finite differences."""

from functools import cache

import numpy as np
import pytest
from scipy.special import ellipk, i0, i1

from ohmskin.errors import GeometryError, ModelError
from ohmskin.forward import TransferModel, VoltageSource, drive_currents, drive_voltages
from ohmskin.geometry import Disc, ElectrodeKind, Electrodes, Mesh, Rectangle, mesh_domain
from ohmskin.scan import DrivePattern, all_pairs, measure_others, skip

S = 1.83e-3  # siemens per square
RADIUS, COUNT, LENGTH = 0.1, 8, 0.03
DISC, SHEET = Disc(RADIUS), Rectangle(0.2, 0.2)


def fourier_cem(z: float, core: float = 0.0, k: float = 0.0, modes: int = 400) -> np.ndarray:
    """Two-terminal resistances (COUNT, COUNT) of equal rim electrodes on a disc, by Galerkin in Fourier modes of the
    rim.

    Somersalo, Cheney and Isaacson 1992. Inside `core` times the radius the conductivity is (1 + k) / (1 - k) times S.
    """
    length, count = LENGTH, COUNT
    n = np.arange(-modes, modes + 1)
    apart = n[:, None] - n
    half = length / (2 * RADIUS)
    window = np.where(apart == 0, 2 * half, 2 * np.sin(apart * half) / np.where(apart == 0, 1, apart))  # about angle 0
    centres = 2 * np.pi * np.arange(count) / count
    everywhere = window * np.where(apart % count == 0, count, 0)
    inner = k * core ** (2.0 * np.abs(n))
    system = np.diag(2 * np.pi * S * np.abs(n) * (1 + inner) / (1 - inner)) + everywhere * RADIUS / z
    row = np.where(n == 0, 2 * half, 2 * np.sin(n * half) / np.where(n == 0, 1, n)) * RADIUS / z
    load = row[:, None] * np.exp(-1j * n[:, None] * centres)
    total = length / z
    grounded = (
        total * np.eye(count) - (load.conj().T @ np.linalg.solve(system, load)).real
    )  # conductances of the electrodes
    r = np.linalg.inv(grounded + total / count)  # constants are in no pair's resistance
    d = np.diag(r)
    return np.asarray(d[:, None] + d - 2 * r)


def pair_resistance(s: np.ndarray) -> np.ndarray:
    d = np.diag(s)
    return np.asarray(d[:, None] + d - 2 * s)


def rim_electrodes(z: float) -> Electrodes:
    return Electrodes.rim(DISC, COUNT).with_rim_segments(LENGTH, z)


def ends(electrodes: Electrodes) -> np.ndarray:
    """Where the rim electrodes of a disc begin and end."""
    angle = np.arctan2(*electrodes.positions.T[::-1])
    half = electrodes.extents / (2 * RADIUS)
    at = np.concatenate([angle - half, angle + half])
    return RADIUS * np.column_stack([np.cos(at), np.sin(at)])


@cache
def disc_mesh(size: float, z: float = 0.01) -> Mesh:
    return mesh_domain(DISC, size, ends(rim_electrodes(z)))


@cache
def mixed() -> TransferModel:
    """Points, discs and rim segments on one uneven sheet, each contact with another impedance."""
    grid = Electrodes.grid(SHEET)
    mesh = mesh_domain(SHEET, 0.012, grid.positions)
    z = np.random.default_rng(1).uniform(0.5, 2.0, 16)
    electrodes = grid.with_discs(5e-3, 1e-4 * z[12:], range(12, 16)).with_rim_segments(0.013, 5e-3 * z[:10], range(10))
    return TransferModel(mesh, electrodes, S * np.random.default_rng(0).uniform(0.5, 2.0, mesh.n_elem))


def random_pattern(seed: int, driven: np.ndarray, n_meas: int = 20) -> DrivePattern:
    """Any pairs of `driven`, voltages anywhere, at driven electrodes, too."""
    rng = np.random.default_rng(seed)
    injections = np.array([rng.choice(driven, 2, replace=False) for _ in range(5)])
    return DrivePattern(
        injections,
        np.column_stack([np.sort(rng.integers(0, 5, n_meas)), all_pairs(16)[rng.choice(120, n_meas)][:, ::-1]]),
    )


AREAS = np.r_[:10, 12:16]  # of `mixed`, those that are no points


# --- analytic solutions -----------------------------------------------------------------------------------------------


def relative_error(r: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(r - exact) / np.linalg.norm(exact))


@pytest.mark.parametrize("z", [3.0, 30.0, 300.0])
def test_rim_electrodes_on_a_disc_converge_to_the_fourier_series(z: float) -> None:
    """Second order but for a logarithm: the current density jumps at the ends of an electrode, u ~ r log r there."""
    exact = fourier_cem(z)
    sizes = np.array([0.0125, 0.00625, 0.003125])
    models = [TransferModel(disc_mesh(size), rim_electrodes(z), S) for size in sizes]
    error = [relative_error(pair_resistance(model.transfer_resistance), exact) for model in models]
    order = np.polyfit(np.log(sizes), np.log(error), 1)[0]
    assert 1.5 < order < 2.1
    assert error[-1] < 6e-3


@pytest.mark.parametrize("ratio", [0.1, 5.0])
def test_a_concentric_anomaly_is_that_of_the_fourier_series(ratio: float) -> None:
    z, core = 100.0, 0.6
    angle = 2 * np.pi * np.arange(76) / 76
    ring = core * RADIUS * np.column_stack([np.cos(angle), np.sin(angle)])
    mesh = mesh_domain(DISC, 0.005, np.vstack([ends(rim_electrodes(z)), ring]))
    inside = np.linalg.norm(mesh.centroids, axis=1) < core * RADIUS
    model = TransferModel(mesh, rim_electrodes(z), np.where(inside, ratio * S, S))
    found, quiet = pair_resistance(model.transfer_resistance), fourier_cem(z)
    exact = fourier_cem(z, core=core, k=(ratio - 1) / (ratio + 1))
    same = pair_resistance(TransferModel(mesh, rim_electrodes(z), S).transfer_resistance)
    assert relative_error(found - same, exact - quiet) < 5e-3
    assert relative_error(found, exact) < 3e-3


def test_a_disc_electrode_in_the_middle_converges_to_bessel_functions_with_second_order() -> None:
    """Under the disc u'' + u'/r = (u - U) / (s z): R = lambda I0(a / lambda) / (2 pi a s I1(a / lambda)), lambda^2 = s
    z.

    From its edge to the rim ln(R / a) / (2 pi s), through the rim, all of it electrode, z_rim / (2 pi R).
    """
    a, z, z_rim = 0.03, 0.3, 50.0
    decay = np.sqrt(S * z)
    exact = decay * i0(a / decay) / (2 * np.pi * a * S * i1(a / decay)) + np.log(RADIUS / a) / (2 * np.pi * S)
    exact += z_rim / (2 * np.pi * RADIUS)
    places = np.vstack([RADIUS * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]]), [[0, 0]]])
    sizes, error = np.array([0.012, 0.006, 0.003]), []
    for size in sizes:
        diagonal = RADIUS * np.sqrt(0.5) * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
        mesh = mesh_domain(DISC, size, np.vstack([places[:4], diagonal]))
        around = np.linalg.norm(np.diff(mesh.nodes[mesh.boundary], axis=1), axis=2).sum()
        electrodes = Electrodes.at(places).with_rim_segments(around / 4, z_rim, range(4)).with_discs(a, z, [4])
        response = drive_voltages(TransferModel(mesh, electrodes, S), [[0, 0, 0, 0, 1.0]])
        assert response.currents[0, :4] == pytest.approx(-response.currents[0, 4] / 4, rel=2e-2)
        error.append(abs(1 / response.currents[0, 4] / exact - 1))
    assert np.polyfit(np.log(sizes), np.log(error), 1)[0] == pytest.approx(2, abs=0.3)
    assert error[-1] < 1e-3


@pytest.mark.parametrize("angle", [np.pi / 2, 0.6])
def test_the_shunt_limit_of_two_opposite_arcs_is_the_ratio_of_elliptic_integrals(angle: float) -> None:
    """No contact impedance: a conformal rectangle.

    Two quarters of the rim have the resistance 1 / s, whatever the radius.
    """
    k = np.tan(np.pi / 4 - angle / 4) ** 2
    exact = 2 * ellipk(k**2) / ellipk(1 - k**2) / S
    at = RADIUS * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    sizes, found = np.array([0.004, 0.002]), []
    for size in sizes:
        driven = Electrodes.at(at).with_rim_segments(RADIUS * angle, 1e-7, [0, 1])
        ends = [[c * np.cos(angle / 2), d * np.sin(angle / 2)] for c in (1, -1) for d in (1, -1)]
        mesh = mesh_domain(DISC, size, np.vstack([at, RADIUS * np.array(ends)]))
        found.append(pair_resistance(TransferModel(mesh, driven, S).transfer_resistance)[0, 1])
    assert 2 * found[1] - found[0] == pytest.approx(exact, rel=2e-3)  # first order: the density is singular at the ends


def test_the_limit_of_high_contact_impedance_is_the_gap_model() -> None:
    """R(z) - 2 z / length tends to the resistance between mean potentials under uniform current, with an error like 1
    / z."""
    mesh, harmonic = disc_mesh(0.003125), np.arange(1, 4000)
    half = LENGTH / (2 * RADIUS)
    share = np.sin(harmonic * half) / (harmonic * half)
    gap = 2 / (np.pi * S) * np.sum(share**2 / harmonic * (1 - np.cos(harmonic * np.pi)))
    models = {z: TransferModel(mesh, rim_electrodes(z), S) for z in (1e2, 1e3, 1e4)}
    rest = [pair_resistance(model.transfer_resistance)[0, 4] - 2 * z / LENGTH for z, model in models.items()]
    assert rest[-1] == pytest.approx(gap, rel=6e-3)
    assert (rest[1] - rest[2]) / (rest[0] - rest[1]) == pytest.approx(0.1, abs=0.02)


def test_a_small_disc_is_a_point_for_all_others() -> None:
    grid = Electrodes.grid(SHEET)
    pattern = measure_others([[12, 14], [13, 15]], range(12))
    sizes, apart = (0.012, 0.006), []
    for size in sizes:
        mesh = mesh_domain(SHEET, size, grid.positions)
        point = TransferModel(mesh, grid, S).voltages(pattern)
        discs = grid.with_discs(1e-3, 1e-4, range(12, 16))
        apart.append(relative_error(TransferModel(mesh, discs, S).voltages(pattern), point))
    assert apart[1] < 3e-3


# --- conservation and symmetry ----------------------------------------------------------------------------------------


def test_mixed_electrodes_are_reciprocal_to_rounding() -> None:
    u = mixed().electrode_potentials
    centred = u - u.mean(axis=0) - u.mean(axis=1, keepdims=True) + u.mean()
    assert np.abs(centred - centred.T).max() < 1e-10 * np.abs(centred).max()


def test_the_current_through_each_contact_is_what_was_driven() -> None:
    """Of the drops across the contacts alone: independent of the elements' equations."""
    model = mixed()
    for k in AREAS:
        contact = model.quadratures[int(k)]
        drop = model.electrode_potentials[k] - contact.at @ model.potentials
        through = contact.weights @ drop / model.electrodes.contact_impedances[k]
        expected = np.eye(16)[k] - (k == 0)  # 1 A into each electrode and out of the first
        np.testing.assert_allclose(through, expected, atol=1e-9)


def test_power_in_is_power_lost_in_sheet_and_contacts() -> None:
    """Euler: R is homogeneous of degree -1 in conductivity and 1 / z, so R = -s dR/ds + z dR/dz."""
    model = mixed()
    r = pair_resistance(model.transfer_resistance)[np.triu_indices(16, 1)]
    sheet = -model.pair_sensitivity @ model.conductivity
    contact = model.pair_contact_sensitivity @ model.electrodes.contact_impedances
    np.testing.assert_allclose(sheet + contact, r, rtol=1e-10)
    assert (contact >= 0).all()
    assert (model.pair_contact_sensitivity[:, ~model.electrodes.are_areas] == 0).all()


def test_discs_keep_their_share_of_area_at_rim_and_corner() -> None:
    electrodes = Electrodes.grid(SHEET).with_discs(4e-3, 1e-4)
    model = TransferModel(mesh_domain(SHEET, 0.012), electrodes, S)
    extent = np.array([model.quadratures[k].extent for k in range(16)])
    share = np.array([1 / 4, 1 / 2, 1 / 2] * 4 + [1.0] * 4)
    np.testing.assert_allclose(extent, share * np.pi * 16e-6, rtol=1e-12)


@pytest.mark.parametrize("length", [0.004, 0.013, 0.11])
def test_rim_segments_bend_round_corners_and_keep_their_length(length: float) -> None:
    electrodes = Electrodes.at([[0.0, 0.003], [0.2, 0.1], [0.05, 0.2], [0.1, 0.1]]).with_rim_segments(
        length, 1.0, [0, 1]
    )
    mesh = mesh_domain(SHEET, 0.0123, [[0.05, 0.2], [0.1, 0.1]])
    model = TransferModel(mesh, electrodes, S)
    for k, bends in ((0, length > 0.006), (1, length > 0.2)):
        contact = model.quadratures[k]
        assert contact.extent == pytest.approx(length, rel=1e-12)
        points = contact.at @ mesh.nodes
        np.testing.assert_allclose(SHEET.depth(points), 0, atol=1e-12)
        arc = (SHEET.arc(points) - SHEET.arc(electrodes.positions[[k]])[0] + 0.4) % 0.8 - 0.4
        assert contact.weights @ arc == pytest.approx(0, abs=1e-12)  # centred
        assert contact.weights @ arc**2 == pytest.approx(length**3 / 12, rel=1e-9)
        assert (np.ptp(points, axis=0).min() > 1e-9) == bends


def test_no_piece_of_a_rim_segment_is_empty_where_it_ends_at_a_node_to_rounding() -> None:
    electrodes = Electrodes.grid(SHEET).with_rim_segments(15e-3, 3.0, range(12))
    model = TransferModel(mesh_domain(SHEET, 16e-3, electrodes), electrodes, S)  # its mesh puts nodes at their ends
    assert min(contact.weights.min() for contact in model.quadratures.values()) > 1e-6


# --- Jacobians against finite differences -----------------------------------------------------------------------------


def derivative(function, step: float) -> np.ndarray:
    """Central difference of fourth order at 0."""
    return np.asarray((8 * (function(step) - function(-step)) - function(2 * step) + function(-2 * step)) / (12 * step))


def along(seed: int, model: TransferModel):
    """Random relative directions of conductivity and contact impedance, and the models along them."""
    rng = np.random.default_rng(seed)
    ds, dz = (
        rng.normal(size=model.mesh.n_elem) * model.conductivity,
        rng.normal(size=16) * model.electrodes.contact_impedances,
    )

    def by_conductivity(t: float) -> TransferModel:
        return model.with_conductivity(model.conductivity + t * ds)

    def by_contact(t: float) -> TransferModel:
        return model.with_contact_impedances(model.electrodes.contact_impedances + t * dz)

    return (ds, by_conductivity), (dz, by_contact)


def test_sensitivity_to_conductivity_and_contact_impedance_is_the_derivative() -> None:
    model, pattern = mixed(), random_pattern(3, np.arange(16))
    currents = np.linspace(1e-3, 2e-3, 5)
    (ds, by_conductivity), (dz, by_contact) = along(0, model)
    for rows, direction, move in (
        (model.sensitivity(pattern, currents), ds, by_conductivity),
        (model.contact_sensitivity(pattern, currents), dz, by_contact),
    ):
        numeric = derivative(lambda t, move=move: move(t).voltages(pattern, currents), 1e-3)
        assert np.linalg.norm(rows @ direction - numeric) < 1e-6 * np.linalg.norm(numeric)


def test_voltage_drive_has_the_derivative_of_its_sensitivities() -> None:
    model, rng = mixed(), np.random.default_rng(5)
    volts = np.full((4, 16), np.nan)
    for row in volts:
        row[rng.choice(AREAS, 5, replace=False)] = rng.normal(size=5)
    series = rng.uniform(0, 200, 16)
    response = drive_voltages(model, volts, series)
    for (direction, move), pairs in zip(
        along(1, model), (model.pair_sensitivity, model.pair_contact_sensitivity), strict=True
    ):
        for name in ("currents", "potentials"):
            rows = getattr(response, f"{name}_by_pairs") @ pairs
            numeric = derivative(
                lambda t, move=move, name=name: getattr(drive_voltages(move(t), volts, series), name), 1e-3
            )
            assert np.linalg.norm(rows @ direction - numeric) < 1e-6 * np.linalg.norm(numeric)


def test_current_drive_has_the_derivative_of_its_sensitivities() -> None:
    model = mixed()
    currents = 1e-3 * np.cos(2 * np.pi * np.outer([1, 2, 3], np.arange(16)) / 16)
    response = drive_currents(model, currents)
    for (direction, move), pairs in zip(
        along(2, model), (model.pair_sensitivity, model.pair_contact_sensitivity), strict=True
    ):
        numeric = derivative(lambda t, move=move: drive_currents(move(t), currents).potentials, 1e-3)
        rows = response.potentials_by_pairs @ pairs @ direction
        assert np.linalg.norm(rows - numeric) < 1e-6 * np.linalg.norm(numeric)
    assert (response.currents_by_pairs == 0).all()


@pytest.mark.parametrize("resistance", [0.0, 350.0])
def test_a_voltage_source_has_the_derivative_of_its_sensitivities(resistance: float) -> None:
    model, pattern, source = mixed(), random_pattern(4, AREAS), VoltageSource(5.0, resistance)
    (ds, by_conductivity), (dz, by_contact) = along(3, model)
    for rows, direction, move in (
        (source.sensitivity(model, pattern), ds, by_conductivity),
        (source.contact_sensitivity(model, pattern), dz, by_contact),
    ):
        numeric = derivative(lambda t, move=move: source.voltages(move(t), pattern), 1e-3)
        assert np.linalg.norm(rows @ direction - numeric) < 1e-6 * np.linalg.norm(numeric)


# --- excitations ------------------------------------------------------------------------------------------------------


def test_voltage_drive_inverts_current_drive() -> None:
    model, rng = mixed(), np.random.default_rng(6)
    currents = np.zeros((3, 16))
    currents[:, AREAS] = rng.normal(size=(3, len(AREAS)))
    currents[:, AREAS] -= currents[:, AREAS].mean(axis=1, keepdims=True)
    by_current = drive_currents(model, currents)
    given = np.where(model.electrodes.are_areas, by_current.potentials + 7.0, np.nan)
    by_voltage = drive_voltages(model, given)
    np.testing.assert_allclose(by_voltage.currents, currents, atol=1e-10)
    np.testing.assert_allclose(by_voltage.potentials, by_current.potentials + 7.0, atol=1e-8)


def test_points_with_given_potentials_are_dirichlet_nodes() -> None:
    """Against the stiffness matrix with the nodes of driven points held, written out."""
    mesh = mesh_domain(SHEET, 0.02, GRID.positions)
    model = TransferModel(mesh, GRID, np.random.default_rng(1).uniform(1, 2, mesh.n_elem))
    matrix = np.zeros((mesh.n_nodes, mesh.n_nodes))
    for element, gradients, weight in zip(
        mesh.elements, mesh.gradients, model.conductivity * mesh.measures, strict=True
    ):
        matrix[np.ix_(element, element)] += weight * gradients @ gradients.T
    volts = np.full(16, np.nan)
    volts[[0, 5, 13]] = 1.0, -0.5, 0.2
    held, values = mesh.nodes_at(GRID.positions[[0, 5, 13]]), np.array([1.0, -0.5, 0.2])
    free = np.setdiff1d(np.arange(mesh.n_nodes), held)
    potential = np.empty(mesh.n_nodes)
    potential[held] = values
    potential[free] = np.linalg.solve(matrix[np.ix_(free, free)], -matrix[np.ix_(free, held)] @ values)
    response = drive_voltages(model, [volts], dirichlet_points=True)
    np.testing.assert_allclose(response.potentials[0], potential[mesh.nodes_at(GRID.positions)], atol=1e-10)
    np.testing.assert_allclose(response.currents[0, [0, 5, 13]], (matrix @ potential)[held], rtol=1e-10)


def test_series_resistance_drops_what_flows_through_it() -> None:
    model, series = mixed(), np.linspace(0, 300, 16)
    volts = np.full((1, 16), np.nan)
    volts[0, AREAS[:4]] = [1.0, 2.0, -1.0, 0.5]
    response = drive_voltages(model, volts, series)
    driven = AREAS[:4]
    np.testing.assert_allclose(
        response.potentials[0, driven], volts[0, driven] - series[driven] * response.currents[0, driven]
    )
    assert (response.currents[0, np.isnan(volts[0])] == 0).all()
    assert response.currents.sum() == pytest.approx(0, abs=1e-15)


def test_a_voltage_source_on_a_pair_is_voltage_drive_of_two_electrodes() -> None:
    """V / (R_pair + R_series), the paper's source behind its multiplexers."""
    model, resistance = mixed(), 350.0
    pattern = DrivePattern([[AREAS[0], AREAS[5]]], [[0, 10, 11], [0, AREAS[0], AREAS[5]]])
    volts = np.full((1, 16), np.nan)
    volts[0, pattern.injections[0]] = [5.0, 0.0]
    response = drive_voltages(model, volts, resistance / 2)
    source = VoltageSource(5.0, resistance)
    assert source.currents(model, pattern) == pytest.approx(response.currents[0, AREAS[0]])
    u = response.potentials[0]
    np.testing.assert_allclose(source.voltages(model, pattern), [u[10] - u[11], u[AREAS[0]] - u[AREAS[5]]])
    r = pair_resistance(model.transfer_resistance)[AREAS[0], AREAS[5]]
    assert source.currents(model, pattern) == pytest.approx(5 / (r + resistance))


def test_scaling_divides_voltages_and_contact_impedances() -> None:
    model, pattern = mixed(), random_pattern(7, np.arange(16))
    assert model.transfer_resistance.any()  # what has been computed for the model must not be taken for the scaled one
    assert model.pair_sensitivity.any()
    assert model.pair_contact_sensitivity.any()
    scaled = model.scaled(2.5)
    electrodes = model.electrodes.with_contact_impedances(model.electrodes.contact_impedances / 2.5)
    anew = TransferModel(model.mesh, electrodes, model.conductivity * 2.5)
    np.testing.assert_allclose(scaled.voltages(pattern), model.voltages(pattern) / 2.5, rtol=1e-12)
    np.testing.assert_allclose(scaled.voltages(pattern), anew.voltages(pattern), rtol=1e-9)
    np.testing.assert_allclose(scaled.sensitivity(pattern), anew.sensitivity(pattern), rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(scaled.pair_contact_sensitivity, anew.pair_contact_sensitivity, rtol=1e-8, atol=1e-9)


# --- refusals ---------------------------------------------------------------------------------------------------------

GRID = Electrodes.grid(SHEET)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: GRID.with_discs(0.0, 1e-4), r"extents\[0\] of a disc electrode is 0; it must be positive"),
        (
            lambda: GRID.with_discs(1e-3, -1.0),
            r"contact_impedances\[0\] of a disc electrode is -1; it must be positive \(ohm m2",
        ),
        (lambda: GRID.with_rim_segments(np.nan, 1.0), r"extents\[0\] of a rim electrode is nan"),
        (lambda: GRID.with_discs([1e-3, 2e-3], 1e-4), "one for each of 16 electrodes"),
        (lambda: GRID.with_discs(1e-3, 1e-4, [3, 16]), r"electrodes \[3, 16\] to change; there are 16"),
        (lambda: GRID.with_discs(0.04, 1e-4), "electrodes 0 and 1 overlap"),
        (
            lambda: GRID.with_contact_impedances(np.ones(16)),
            r"contact_impedances\[0\] of a point electrode is 1; it must be 0",
        ),
        (lambda: GRID.with_contact_impedances(np.ones(3)), r"have shape \(3,\); give \(16,\)"),
        (lambda: Electrodes(GRID.positions, GRID.rings, kinds=("ring",) * 16), "choose from point, disc, rim"),
        (lambda: Electrodes(GRID.positions, GRID.rings, kinds=("point",) * 3), "3 electrode kinds for 16 electrodes"),
    ],
)
def test_impossible_contacts_are_refused(make, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        make()


@pytest.mark.parametrize(
    ("electrodes", "message"),
    [
        (GRID.with_rim_segments(0.01, 1.0), "electrode 12 at .* off the rim; move it or use with_discs"),
        (GRID.with_rim_segments(0.07, 1.0, range(12)), "electrodes 0 and 1 overlap: 0.0667 m apart on the rim"),
        (GRID.with_rim_segments(0.9, 1.0, [0]), "electrode 0 is 0.9 m long, its rim 0.8 m"),
        (
            Electrodes.at(GRID.positions[:4] - 1).with_discs(0.01, 1.0),
            "electrode 0, a disc .* does not lie on the mesh",
        ),
        (Electrodes.at(np.eye(4)[:, :3] / 9), "electrodes have 3 coordinates, mesh nodes 2; move both with mapped"),
    ],
)
def test_contacts_that_miss_the_skin_are_refused(electrodes: Electrodes, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        TransferModel(mixed().mesh, electrodes, S)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (
            lambda m: drive_voltages(m, np.ones((1, 16))),
            "electrode 10 is a point, whose own resistance grows without bound",
        ),
        (lambda m: drive_voltages(m, [[1.0] + [np.nan] * 15]), "excitation 0 gives 1 electrodes a voltage"),
        (lambda m: drive_voltages(m, np.ones(16)), r"voltages have shape \(16,\); give \(n_drive, 16\)"),
        (lambda m: drive_voltages(m, np.full((1, 16), np.inf)), "infinite; give NaN"),
        (lambda m: drive_voltages(m, np.ones((1, 16)), -1.0), "series resistance is -1.0"),
        (lambda m: drive_voltages(m, np.ones((1, 16)), np.ones(3)), "series resistance is"),
        (lambda m: drive_currents(m, np.ones((1, 16))), "currents of excitation 0 sum to 16 A"),
        (lambda m: drive_currents(m, np.full((2, 16), np.nan)), "excitation 0 are not finite"),
        (lambda m: drive_currents(m, np.zeros((2, 15))), "one for each electrode"),
        (lambda m: VoltageSource(0.0), "amplitude is 0.0 V"),
        (lambda m: VoltageSource(5.0, -1.0), "resistance is -1.0 ohm"),
        (lambda m: VoltageSource(5.0).voltages(m, skip([range(16)])), "electrode 10 is a point"),
        (lambda m: m.voltages(skip([range(16)]), np.ones(3)), r"currents have shape \(3,\); give one value or \(16,\)"),
    ],
)
def test_impossible_excitations_are_refused(ask, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        ask(mixed())


def test_kinds_mix_and_can_be_undone() -> None:
    electrodes = mixed().electrodes
    assert [electrodes.kinds.count(kind) for kind in ElectrodeKind] == [2, 4, 10, 0]
    assert (electrodes.with_points().extents == 0).all()
    assert Electrodes(GRID.positions, GRID.rings).kinds == (ElectrodeKind.POINT,) * 16
