"""Priors: what they believe, that it does not hang on the mesh where they say so, and the textbook image of each."""

from functools import cache

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.special import kv

from ohmskin.errors import ModelError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Electrodes, Mesh, Rectangle, mesh_domain
from ohmskin.geometry.overlap import disc_overlap
from ohmskin.inverse import (
    PRIORS,
    GaussNewton,
    Penalty,
    graph_laplacian,
    matern,
    noser,
    paper_laplacian,
)
from ohmskin.inverse.priors import penalty_of
from ohmskin.scan import Difference, adjacent

SHEET = Rectangle(0.2, 0.2)
GRID = Electrodes.grid(SHEET)
PATTERN = adjacent(GRID.rings)
CURRENT, NOISE = 1e-3, 2e-4


@cache
def model(size: float = 0.014) -> TransferModel:
    return TransferModel(mesh_domain(SHEET, size, GRID.positions), GRID, 1.83e-3)


def laplacian_of_eq_5() -> sp.csc_array:
    return paper_laplacian(model().mesh)


def with_prior(given: object) -> None:
    """Use a prior that somebody wrote."""
    GaussNewton(model(), NOISE, lambda mesh: given).reconstruct(touch())


@cache
def touch() -> Difference:
    """A disc of raised conductivity on a finer mesh."""
    mesh = mesh_domain(SHEET, 0.006, GRID.positions)
    inside = np.linalg.norm(mesh.centroids - (0.06, 0.13), axis=1) < 0.012
    quiet, touched = (
        TransferModel(mesh, GRID, 1.83e-3 * (1 + r * inside)).voltages(PATTERN, CURRENT) for r in (0.0, 0.5)
    )
    return Difference(PATTERN, np.full(PATTERN.n_meas, CURRENT), touched - quiet)


def covariance(penalty: Penalty) -> np.ndarray:
    """Gamma, dense, of average variance one."""
    inverse = np.linalg.inv(penalty.normalised.toarray())
    return inverse if penalty.image is None else penalty.image @ inverse @ penalty.image.T


@pytest.mark.parametrize("name", PRIORS)
def test_penalties_are_symmetric_and_positive_definite_but_for_a_mean_that_is_free(name: str) -> None:
    penalty = penalty_of(model(), name)
    for matrix in (penalty.matrix.toarray(), penalty.normalised.toarray()):
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
    values = np.linalg.eigvalsh(penalty.matrix.toarray())
    assert values[int(penalty.free_mean)] > 1e-9 * values[-1]
    assert np.linalg.eigvalsh(penalty.normalised.toarray())[0] > 0


def textbook(name: str, units: float, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """The image of a touch, and the x of least |volts - J x|^2 + noise^2 x^T R x by dense orthogonal factors.

    Whitened, with constants that cost nothing taken out: that does not square the condition number.
    """
    grid = Electrodes(GRID.positions * units, GRID.rings)
    mesh = mesh_domain(SHEET, 0.02, GRID.positions)
    sheet = TransferModel(Mesh(mesh.nodes * units, mesh.elements), grid, 1.83e-3)
    inside = np.linalg.norm(mesh.centroids - (0.06, 0.13), axis=1) < 0.02
    volts = sheet.with_conductivity(1.83e-3 * (1 + 0.5 * inside)).voltages(PATTERN, CURRENT)
    volts -= sheet.voltages(PATTERN, CURRENT)
    noise *= float(np.sqrt(np.mean(volts**2)))
    image = GaussNewton(sheet, noise, name).reconstruct(Difference(PATTERN, np.full(len(volts), CURRENT), volts)).values
    penalty = penalty_of(sheet, name)
    jacobian = sheet.sensitivity(PATTERN, CURRENT) * sheet.conductivity
    penalties = penalty.matrix.toarray() * penalty.average_variance
    unknowns = jacobian if penalty.image is None else jacobian @ penalty.image
    level = np.zeros((len(volts), 0))
    if penalty.free_mean:  # x = mean + [0, rest]: the penalty knows differences only
        level, unknowns, penalties = unknowns.sum(axis=1)[:, None], unknowns[:, 1:], penalties[1:, 1:]
    root = np.linalg.cholesky(penalties)
    basis = np.linalg.qr(level)[0]
    rest = np.linalg.solve(root, unknowns.T).T
    left, singular, right = np.linalg.svd(rest - basis @ (basis.T @ rest), full_matrices=False)
    white = right.T @ (singular / (singular**2 + noise**2) * (left.T @ (volts - basis @ (basis.T @ volts))))
    found = np.linalg.solve(root.T, white)
    if penalty.free_mean:
        return image, np.append(0.0, found) + np.linalg.lstsq(level, volts - rest @ white, rcond=None)[0]
    return image, found if penalty.image is None else penalty.image @ found


@pytest.mark.parametrize("units", [1.0, 1e3])  # metres, millimetres
@pytest.mark.parametrize("name", PRIORS)
def test_the_image_under_each_prior_is_the_textbook_image_whatever_the_noise_and_the_unit(
    name: str, units: float
) -> None:
    """Noise from a hundredth to a ten-millionth of the data. From a hundred-thousandth on, rounding J in its last digit
    alone moves the image by up to 1e-8, as long doubles tell."""
    for exponent in range(2, 8):
        image, expected = textbook(name, units, 10.0**-exponent)
        bound = 1e-9 if exponent <= 4 else 2e-7
        np.testing.assert_allclose(image, expected, rtol=0, atol=bound * np.abs(expected).max())


@pytest.mark.parametrize("name", ["paper", "noser", "matern"])
def test_the_variance_averaged_over_the_sheet_is_one(name: str) -> None:
    mean = np.mean(np.diag(covariance(penalty_of(model(0.006), name))))
    assert mean == pytest.approx(
        1.0, rel=0.1 if name == "matern" else 0.02
    )  # the mesh blurs Matern; 256 random signs err by 1 %


def test_the_graph_laplacian_is_twice_degree_less_adjacency() -> None:
    square = Mesh(np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float), np.array([[0, 1, 2], [0, 2, 3]]))
    np.testing.assert_array_equal(graph_laplacian(square).matrix.toarray(), [[2, -2], [-2, 2]])
    ones = np.ones(model().mesh.n_elem)
    assert np.abs(graph_laplacian(model().mesh).matrix @ ones).max() == 0  # constants are its null space


def test_the_graph_laplacian_gives_the_image_that_eidors_defines() -> None:
    """(J^T J + lambda^2 R)^-1 J^T dv with the singular R itself."""
    penalty = graph_laplacian(model().mesh)
    jacobian = model().sensitivity(PATTERN, CURRENT) * model().conductivity
    laplacian = 2 * (np.diag(model().mesh.adjacency.sum(axis=1)) - model().mesh.adjacency.toarray())
    for amplitude in (1e-2, 1.0):
        weight = (NOISE / amplitude) ** 2 * penalty.average_variance
        expected = np.linalg.solve(jacobian.T @ jacobian + weight * laplacian, jacobian.T @ touch().volts)
        image = GaussNewton(model(), NOISE, graph_laplacian, amplitude).reconstruct(touch()).values
        np.testing.assert_allclose(image, expected, atol=1e-9 * np.abs(expected).max())


def test_a_change_of_the_whole_sheet_costs_the_graph_laplacian_nothing() -> None:
    """Two per cent more conductivity everywhere: the image is flat, where eq. (5) lets it sag to the rim."""
    volts = model().scaled(1.02).voltages(PATTERN, CURRENT) - model().voltages(PATTERN, CURRENT)
    difference = Difference(PATTERN, np.full(PATTERN.n_meas, CURRENT), volts)
    free, pulled = (
        GaussNewton(model(), NOISE, prior, 0.01).reconstruct(difference).values
        for prior in (graph_laplacian, paper_laplacian)
    )
    assert free.mean() == pytest.approx(0.02, rel=0.03)
    assert np.ptp(free) < 1e-3
    assert np.ptp(pulled) > 5e-3


@pytest.mark.parametrize("length", [0.03, 0.06])
def test_matern_has_the_covariance_it_is_named_for(length: float) -> None:
    """kappa r K_1(kappa r) with kappa = sqrt(8) / length, and variance one, between points away from the rim."""
    mesh = model(0.006).mesh
    middle = int(mesh.closest_elements([[0.1, 0.1]], 1)[0])
    unit = np.zeros((mesh.n_elem, 1))
    unit[middle] = 1.0
    found = matern(length)(mesh).covariance(unit)[:, 0]
    distance = np.linalg.norm(mesh.centroids - mesh.centroids[middle], axis=1)
    near = (distance > 0.008) & (distance < 0.6 * length)
    arm = np.sqrt(8) * distance[near] / length
    np.testing.assert_allclose(found[near], arm * kv(1, arm), atol=0.04)
    assert found[middle] == pytest.approx(1.0, abs=0.1 if length == 0.03 else 0.05)  # the mesh blurs it


def test_the_robin_rim_keeps_the_variance_of_matern_even() -> None:
    """With a free rim it would double at an edge and quadruple in a corner."""
    mesh = model(0.009).mesh
    penalty = matern(0.04)(mesh)
    variance = np.diag(covariance(penalty))
    rim = (mesh.neighbours < 0).any(axis=1)
    assert variance[rim].mean() == pytest.approx(1.0, abs=0.25)
    assert variance.min() > 0.6
    assert variance.max() < 1.8


def disc_means(mesh: Mesh) -> np.ndarray:
    """Rows (4, n_elem) that take the mean of an image over discs of 20 mm radius."""
    rows = disc_overlap(mesh, [(0.1, 0.1), (0.125, 0.1), (0.06, 0.13), (0.165, 0.03)], 0.02).toarray()
    return rows / rows.sum(axis=1, keepdims=True)


@pytest.mark.parametrize(("name", "bound"), [("matern", 0.05), ("tikhonov", 0.08)])
def test_what_is_believed_of_places_does_not_depend_on_the_mesh(name: str, bound: float) -> None:
    """Covariances of means over discs, on meshes of 1 : 4 in triangles, are the same; other priors follow the
    triangles."""

    def change(prior: str) -> float:
        believed = []
        for size in (0.009, 0.0045):
            rows = disc_means(model(size).mesh)
            believed.append(rows @ penalty_of(model(size), prior).covariance(rows.T))
        return float(np.abs(believed[1] - believed[0]).max() / np.abs(believed[1]).max())

    assert change(name) < bound
    assert change("paper") > 0.15
    assert change("noser") > 1


def test_bending_the_sheet_does_not_change_matern() -> None:
    """On a cylinder, distances along the sheet are what counts."""
    flat = model(0.008).mesh
    x, y = flat.nodes.T
    bent = Mesh(np.column_stack([0.1 * np.sin(x / 0.1), y, 0.1 * np.cos(x / 0.1)]), flat.elements)
    columns = np.eye(flat.n_elem)[:, [10, 300, 700]]
    one, other = (matern(0.04)(mesh).covariance(columns) for mesh in (flat, bent))
    np.testing.assert_allclose(one, other, atol=5e-3)


def test_noser_evens_out_what_the_data_feel() -> None:
    """Weighed by the prior to the full power, every triangle is felt alike; to the power 0, all penalties are equal."""
    feel = np.sum((model().sensitivity(PATTERN) * model().conductivity) ** 2, axis=0)
    np.testing.assert_allclose(noser(model(), exponent=1.0)(model().mesh).diagonal(), feel / feel.max(), rtol=1e-12)
    np.testing.assert_array_equal(noser(model(), exponent=0.0)(model().mesh).diagonal(), 1.0)
    half = noser(model())(model().mesh).diagonal()
    np.testing.assert_allclose(half**2, feel / feel.max(), rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: penalty_of(model(), "matérn"),
            "no prior 'matérn'; choose from paper, laplacian, tikhonov, noser, matern",
        ),
        (lambda: GaussNewton(model(), NOISE, "tv"), "no prior 'tv'; choose from .*TotalVariation"),
        (lambda: matern(0.0), "correlation length is 0.0; it must be positive"),
        (lambda: matern(np.nan), "correlation length is nan"),
        (lambda: matern(1e-3)(model().mesh), "below the mesh's edges of 0.01.* refine the mesh"),
        (lambda: noser(model(), exponent=2.0), "NOSER exponent is 2.0; it must be 0 to 1"),
        (lambda: noser(model())(model(0.009).mesh), "belongs to another model"),
        (
            lambda: with_prior(sp.eye_array(model().mesh.n_nodes)),
            "prior is of 254 values; give 446, one for each",
        ),
        (lambda: with_prior(sp.triu(laplacian_of_eq_5())), "not symmetric .*both triangles are needed"),
        (lambda: with_prior(laplacian_of_eq_5() + sp.triu(laplacian_of_eq_5(), 1)), "not symmetric .by 0.33 of"),
        (lambda: with_prior(laplacian_of_eq_5() * (1 + 1j)), "type complex128; a prior gives a sparse symmetric"),
        (lambda: with_prior(laplacian_of_eq_5() * np.nan), "not finite"),
        (lambda: with_prior(None), "a prior gave NoneType"),
        (lambda: with_prior(laplacian_of_eq_5()[:5]), "shape .5, 446."),
        (lambda: with_prior(-laplacian_of_eq_5()), "prior's matrix is not positive definite; add to its diagonal"),
        (lambda: with_prior(graph_laplacian(model().mesh).matrix), "not positive definite|singular .*free_mean=True"),
        (lambda: with_prior(Penalty(laplacian_of_eq_5(), free_mean=True)), "free_mean penalises constants"),
    ],
)
def test_priors_that_cannot_be_are_refused(make, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        make()
