"""Estimators: each against the dense mathematics it stands for, and against what it promises of contacts."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import minimize, nnls

from ohmskin.contacts import ContactFitter
from ohmskin.errors import DataError, ModelError
from ohmskin.forward import ContactTable, TransferModel, VoltageSource
from ohmskin.forward.response import effective_change
from ohmskin.geometry import Disc, Electrodes, Mesh, Rectangle, mesh_domain
from ohmskin.geometry.overlap import disc_overlap
from ohmskin.inverse import (
    PRIORS,
    AbsoluteGaussNewton,
    GaussNewton,
    Greit,
    Image,
    Kalman,
    SparseBayes,
    TotalVariation,
    matern,
    noise_figure,
)
from ohmskin.inverse.choice import small_target
from ohmskin.inverse.estimators import FrameWise
from ohmskin.inverse.priors import graph_laplacian, penalty_of, triangle_means
from ohmskin.inverse.variation import Variation
from ohmskin.scan import Baseline, Difference, DrivePattern, Frame, adjacent, measure_others, opposite

SHEET = Rectangle(0.2, 0.2)
GRID = Electrodes.grid(SHEET)
PATTERN = adjacent(GRID.rings)
CURRENT, NOISE = 1e-3, 3e-4
AT = (0.06, 0.13)


@cache
def model(size: float = 0.012) -> TransferModel:
    return TransferModel(mesh_domain(SHEET, size, GRID.positions), GRID, 1.83e-3)


@cache
def fine() -> TransferModel:
    """Where the data come from: another, finer mesh."""
    return model(0.0045)


def drawn(mesh: Mesh, *contacts: tuple[float, float, float, float]) -> np.ndarray:
    """Relative conductivity change (n_elem,) of discs (x, y, radius, strength)."""
    covers = [c[3] * disc_overlap(mesh, [c[:2]], c[2]).toarray()[0] for c in contacts]
    return np.sum(covers, axis=0) / mesh.measures


@cache
def voltages(*contacts: tuple[float, float, float, float], pattern: DrivePattern = PATTERN) -> np.ndarray:
    """Voltages (V) under discs (x, y, radius, strength)."""
    if not contacts:
        return fine().voltages(pattern, CURRENT)
    values = 1 + drawn(fine().mesh, *contacts)
    return TransferModel(fine().mesh, GRID, fine().conductivity * values).voltages(pattern, CURRENT)


def touch(
    *contacts: tuple[float, float, float, float], seed: int = 0, noise: float = NOISE, pattern: DrivePattern = PATTERN
) -> Difference:
    volts = voltages(*contacts, pattern=pattern) - voltages(pattern=pattern)
    return Difference(
        pattern, np.full(pattern.n_meas, CURRENT), volts + noise * np.random.default_rng(seed).normal(size=len(volts))
    )


def place(image: Image, mesh) -> np.ndarray:
    """Centroid of what is above half the peak (m)."""
    mass = np.where(image.values > image.values.max() / 2, image.values, 0) * mesh.measures
    return mass @ mesh.centroids / mass.sum()


@cache
def jacobian() -> np.ndarray:
    return model().sensitivity(PATTERN, CURRENT) * model().conductivity


ESTIMATORS = {
    "Gauss-Newton": lambda **k: GaussNewton(model(), NOISE, "matern", amplitude=0.2, **k),
    "positive Gauss-Newton": lambda **k: GaussNewton(model(), NOISE, "matern", amplitude=0.2, positive=True, **k),
    "GREIT": lambda **k: Greit(model(), NOISE, **k),
    "total variation": lambda **k: TotalVariation(model(), NOISE, amplitude=0.5, outline=0.01, **k),
    "Kalman": lambda **k: Kalman(model(), NOISE, "matern", amplitude=0.2, **k),
    "sparse": lambda **k: SparseBayes(model(), NOISE, amplitude=0.5, **k),
}


@cache
def made(name: str):
    return ESTIMATORS[name]()


@pytest.mark.parametrize("name", ESTIMATORS)
def test_an_image_of_a_frame_is_refused_in_words(name: str) -> None:
    measured = Frame(PATTERN, voltages(), np.full(PATTERN.n_inj, CURRENT), 0.0)
    with pytest.raises(DataError, match="made of differences, not of a Frame"):
        made(name).reconstruct(measured)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_touch_is_found_where_it_is_and_has_the_right_sign(name: str) -> None:
    image = made(name).reconstruct(touch((*AT, 0.012, 0.5)))
    assert image.values.shape == (model().mesh.n_elem,)
    assert np.linalg.norm(place(image, model().mesh) - AT) < 0.01
    assert image.values.max() > 0.05
    std = image.noise_std([int(image.values.argmax()), 5])
    assert (std >= 0).all()
    assert 0 < std[0] < 1


@pytest.mark.parametrize("name", ESTIMATORS)
def test_channels_that_are_not_finite_are_left_out_as_if_never_measured(name: str) -> None:
    full = touch((*AT, 0.012, 0.5))
    lost = np.arange(PATTERN.n_meas) % 7 == 3
    holed = Difference(PATTERN, full.currents, np.where(lost, np.nan, full.volts))
    kept = Difference(
        DrivePattern(PATTERN.injections, PATTERN.measurements[~lost]), full.currents[~lost], full.volts[~lost]
    )
    expected = made(name).reconstruct(kept).values
    np.testing.assert_allclose(made(name).reconstruct(holed).values, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("name", ESTIMATORS)
def test_two_scans_fused_are_one_long_scan(name: str) -> None:
    whole = touch((*AT, 0.012, 0.5))
    cut = np.searchsorted(PATTERN.measurements[:, 0], 7)
    parts = [
        Difference(
            DrivePattern(PATTERN.injections[:7], PATTERN.measurements[:cut]), whole.currents[:cut], whole.volts[:cut]
        ),
        Difference(
            DrivePattern(PATTERN.injections[7:], PATTERN.measurements[cut:] - [7, 0, 0]),
            whole.currents[cut:],
            whole.volts[cut:],
        ),
    ]
    expected = made(name).reconstruct(whole).values
    np.testing.assert_allclose(made(name).reconstruct(*parts).values, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("name", ESTIMATORS)
def test_nothing_finite_is_an_error_and_not_an_image(name: str) -> None:
    with pytest.raises(DataError, match="no finite measurement"):
        made(name).reconstruct(Difference(PATTERN, np.full(PATTERN.n_meas, CURRENT), np.full(PATTERN.n_meas, np.nan)))
    with pytest.raises(DataError, match="give at least one"):
        made(name).reconstruct()


def test_the_image_of_nothing_is_zero_and_stays_the_last_one_without_a_scan() -> None:
    image = FrameWise(made("Gauss-Newton"), model().mesh)
    nothing = image.start()
    assert not nothing.image.values.any()
    assert image.update(nothing, (), (), 0.01) is nothing


@pytest.mark.parametrize("name", ESTIMATORS)
def test_estimators_work_on_a_disc_with_rim_electrodes(name: str) -> None:
    """Another domain, another layout, a pattern that is neither adjacent nor complete."""
    electrodes = Electrodes.rim(Disc(0.1), 12)
    round_model = TransferModel(mesh_domain(Disc(0.1), 0.012, electrodes.positions), electrodes, 1.0)
    pattern = opposite(range(12))
    rise = np.linalg.norm(round_model.mesh.centroids - (0.03, -0.04), axis=1) < 0.015
    touched = TransferModel(round_model.mesh, electrodes, 1.0 + 0.5 * rise)
    difference = Difference(
        pattern, np.full(pattern.n_meas, 1.0), touched.voltages(pattern) - round_model.voltages(pattern)
    )
    kind = type(made(name))
    found = place(kind(round_model, 1e-4).reconstruct(difference), round_model.mesh)
    # opposite drive measured on the rim cannot tell a place from its mirror image through the centre
    assert min(np.linalg.norm(found - (0.03, -0.04)), np.linalg.norm(found)) < 0.02


@cache
def bent() -> TransferModel:
    """The sheet laid round a cylinder of 80 mm radius."""

    def move(points: np.ndarray) -> np.ndarray:
        return np.column_stack([0.08 * np.sin(points[:, 0] / 0.08), points[:, 1], 0.08 * np.cos(points[:, 0] / 0.08)])

    return TransferModel(model().mesh.mapped(move), Electrodes.at(move(GRID.positions), GRID.rings), 1.83e-3)


@cache
def thick() -> TransferModel:
    """A block of tetrahedra, 0.2 x 0.2 x 0.04 m, electrodes on its upper side."""
    axes = np.linspace(0, 0.2, 13), np.linspace(0, 0.2, 13), np.linspace(0, 0.04, 4)
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(nodes)).reshape(13, 13, 4)
    cells = []
    for path in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):  # six to a cube, along its diagonal
        at, corners = np.zeros(3, int), [np.zeros(3, int)]
        for axis in path:
            at = at + np.eye(3, dtype=int)[axis]
            corners.append(at)
        cells.append(np.stack([number[i : i + 12, j : j + 12, k : k + 3].ravel() for i, j, k in corners], axis=1))
    places = np.column_stack([(GRID.positions / 0.2 * 12).round() / 12 * 0.2, np.full(16, 0.04)])
    return TransferModel(Mesh(nodes, np.vstack(cells)), Electrodes.at(places, GRID.rings), 0.05)


@pytest.mark.parametrize("name", [*ESTIMATORS, "iterated"])
@pytest.mark.parametrize("skin", [bent, thick], ids=["bent", "thick"])
def test_estimators_work_on_curved_and_thick_skins(name: str, skin) -> None:
    """A contact on a cylinder and one inside a block of tetrahedra are found where they are."""
    element = int(skin().mesh.closest_elements([[0.054, 0.125, 0.058] if skin is bent else [0.085, 0.115, 0.03]], 1)[0])
    at = skin().mesh.centroids[element]
    inside = np.linalg.norm(skin().mesh.centroids - at, axis=1) < 0.02
    touched = skin().with_conductivity(skin().conductivity * (1 + inside))
    quiet, volts = (sheet.voltages(PATTERN, CURRENT) for sheet in (skin(), touched))
    noise = 3e-3 * float(np.std(volts - quiet))
    if name == "iterated":
        image = AbsoluteGaussNewton(skin(), noise, "matern", amplitude=0.3).reconstruct(frame(volts))
    else:
        settings = {"positive": True} if name.startswith("positive") else {}
        prior = {"prior": "matern"} if name in ("Gauss-Newton", "positive Gauss-Newton", "Kalman") else {}
        estimator = type(made(name))(skin(), noise, **settings, **prior)
        image = estimator.reconstruct(Difference(PATTERN, np.full(PATTERN.n_meas, CURRENT), volts - quiet))
    assert np.linalg.norm(place(image, skin().mesh) - at) < 0.02
    assert image.noise_std([element])[0] >= 0


# positivity


@pytest.mark.parametrize(("noise", "prior"), [(NOISE, "paper"), (NOISE / 300, "paper"), (NOISE / 300, "tikhonov")])
def test_the_positive_image_is_the_non_negative_least_squares_of_the_stacked_system(noise: float, prior: str) -> None:
    """Lawson and Hanson's active set on data and penalty in one, dense, under a prior without unknowns of its own; also
    where the model's error is far larger than the noise."""
    estimator = GaussNewton(model(), noise, prior, amplitude=0.2, positive=True)
    difference = touch((*AT, 0.012, 0.5), noise=noise)
    root = np.linalg.cholesky(penalty_of(model(), prior).normalised.toarray()).T
    stacked = np.vstack([jacobian() / noise, root / 0.2])
    expected = nnls(stacked, np.concatenate([difference.volts / noise, np.zeros(len(root))]), maxiter=10_000)[0]
    image = estimator.reconstruct(difference).values
    assert (image >= 0).all()
    assert 0 < np.mean(image == 0) < 1  # the bound does hold something
    np.testing.assert_allclose(image, expected, atol=1e-5 * expected.max())


@pytest.mark.parametrize("name", ["positive Gauss-Newton", "sparse"])
def test_what_only_raises_conductivity_never_lowers_it(name: str) -> None:
    assert made(name).reconstruct(touch((*AT, 0.012, -0.5))).values.min() >= 0
    assert made(name).reconstruct(touch((*AT, 0.012, 0.5))).values.min() >= 0
    assert (
        TotalVariation(model(), NOISE, 0.5, outline=0.01, positive=True)
        .reconstruct(touch((*AT, 0.012, 0.5)))
        .values.min()
        >= 0
    )


# total variation


def test_no_positive_image_has_a_lower_cost_than_that_of_total_variation() -> None:
    """L-BFGS-B on the functional itself, from that image, where the model's error is far larger than the noise."""
    noise, difference = NOISE / 300, touch((*AT, 0.012, 0.5), noise=NOISE / 300)
    image = TotalVariation(model(), noise, 0.5, outline=0.01, positive=True, rounds=100).reconstruct(difference)
    means, penalty = triangle_means(model().mesh), Variation(model().mesh, 0.5, 0.01)
    relative = jacobian() @ means
    nodal = np.maximum(np.linalg.lstsq(means.toarray(), image.values, rcond=None)[0], 0.0)

    def cost(w: np.ndarray) -> tuple[float, np.ndarray]:
        left = difference.volts - relative @ w
        slope = 2 * (penalty.matrix(w) @ w - relative.T @ left / noise**2)
        return float(left @ left / noise**2) + penalty.cost(w), slope

    best = minimize(
        cost, nodal, jac=True, method="L-BFGS-B", bounds=[(0, None)] * len(nodal), options={"maxiter": 2000}
    )
    assert cost(nodal)[0] < 1.01 * best.fun


def test_a_positive_variation_image_is_positive_however_early_it_stops() -> None:
    for rounds in (1, 2, 30):
        image = TotalVariation(model(), NOISE, 0.5, outline=0.01, positive=True, rounds=rounds).reconstruct(
            touch((*AT, 0.012, 0.5))
        )
        assert image.values.min() >= 0


def test_total_variation_is_sharper_than_a_quadratic_prior_on_a_block() -> None:
    """Of a block's edge, the share of the area whose value is neither that of the block nor that of the sheet."""
    mesh = model(0.008).mesh
    block = (np.abs(mesh.centroids - (0.08, 0.12)) < 0.03).all(axis=1)
    volts = model(0.008).sensitivity(PATTERN, CURRENT) @ (0.3 * block * model(0.008).conductivity)
    difference = Difference(
        PATTERN, np.full(PATTERN.n_meas, CURRENT), volts + 1e-4 * np.random.default_rng(0).normal(size=len(volts))
    )

    def between(image: Image) -> float:
        top = np.quantile(image.values, 0.97)
        return float(np.mean((image.values > 0.25 * top) & (image.values < 0.75 * top)))

    def error(image: Image) -> float:
        return float(np.linalg.norm(image.values - 0.3 * block))

    quadratic = [GaussNewton(model(0.008), 1e-4, prior, amplitude).reconstruct(difference)
                 for prior in (graph_laplacian, "matern") for amplitude in (0.03, 0.1, 0.3)]  # fmt: skip
    sharp = TotalVariation(model(0.008), 1e-4, amplitude=0.3).reconstruct(difference)
    assert between(sharp) < 0.75 * min(between(image) for image in quadratic)
    assert error(sharp) < 0.9 * min(error(image) for image in quadratic)


def test_lagged_diffusivity_ends_where_the_cost_is_least() -> None:
    estimator = TotalVariation(model(), NOISE, amplitude=0.5, outline=0.01, rounds=200)
    difference = touch((*AT, 0.012, 0.5))
    means = triangle_means(model().mesh)
    rows = jacobian() @ means
    w = np.linalg.lstsq(means.toarray(), estimator.reconstruct(difference).values, rcond=None)[0]
    variation = Variation(model().mesh, 0.5, 0.01)

    def cost(w: np.ndarray) -> float:
        return float(np.sum((difference.volts - rows @ w) ** 2) / NOISE**2) + variation.cost(w)

    least, rng = cost(w), np.random.default_rng(0)
    ways = [rng.normal(size=len(w)) for _ in range(10)] + [w, np.ones(len(w)), variation.matrix(w).diagonal()]
    for way in ways:
        step = 0.02 * np.abs(w).max() * way / np.abs(way).max()
        assert cost(w + step) > least
        assert cost(w - step) > least


def test_the_quadratic_penalty_touches_the_variation() -> None:
    """Same gradient at the field, never below it elsewhere: what makes every round of lagged diffusivity lower the
    cost."""
    rng = np.random.default_rng(0)
    variation = Variation(model().mesh, 0.5, 0.01)
    w, other = (rng.normal(size=model().mesh.n_nodes) for _ in range(2))
    slope = (variation.cost(w + 1e-6 * other) - variation.cost(w - 1e-6 * other)) / 2e-6
    assert slope == pytest.approx(2 * other @ variation.matrix(w) @ w, rel=1e-6)
    matrix = variation.matrix(w)
    for size in (0.1, 1.0, 3.0):
        moved = w + size * other
        assert variation.cost(moved) <= variation.cost(w) + moved @ matrix @ moved - w @ matrix @ w + 1e-9


def test_total_variation_without_an_outline_fits_as_well_as_the_noise_allows() -> None:
    difference = touch((*AT, 0.012, 0.5))
    image = TotalVariation(model(), NOISE, amplitude=0.5).reconstruct(difference)
    left = difference.volts - jacobian() @ image.values
    assert np.sqrt(np.mean(left**2)) == pytest.approx(NOISE, rel=0.1)


# Kalman


def scans(count: int) -> list[Difference]:
    """A touch that moves, under patterns that change."""
    patterns = [
        adjacent([GRID.rings[0]]),
        opposite(range(12)),
        measure_others([[12, 14], [13, 15], [0, 12]], range(16)),
    ]
    return [touch((0.05 + 0.004 * k, 0.13, 0.012, 0.5), seed=k, pattern=patterns[k % 3]) for k in range(count)]


@pytest.mark.parametrize(("time_constant", "walk"), [(0.5, 0.0), (np.inf, 0.3), (1.0, 0.2), (np.inf, 0.0)])
def test_the_filter_in_modes_is_the_filter_on_the_full_image(time_constant: float, walk: float) -> None:
    """Mean, standard deviation and what noise alone moves, over six scans of three patterns, against n_elem x n_elem
    matrices."""
    amplitude, period, mesh = 0.2, 0.1, model(0.02).mesh
    estimator = Kalman(model(0.02), NOISE, "paper", amplitude, time_constant, walk, period)
    gamma = np.linalg.inv(penalty_of(model(0.02), "paper").normalised.toarray())
    x, p, n = np.zeros(mesh.n_elem), amplitude**2 * gamma, np.zeros_like(gamma)
    belief = estimator.start()
    kept = np.exp(-period / time_constant)
    for difference in scans(6):
        x, n = kept * x, kept**2 * n
        p = kept**2 * p + ((1 - kept**2) * amplitude**2 + walk**2 * period) * gamma
        rows = model(0.02).sensitivity(difference.pattern, CURRENT) * model(0.02).conductivity
        gain = p @ rows.T @ np.linalg.inv(rows @ p @ rows.T + NOISE**2 * np.eye(len(rows)))
        rest = np.eye(mesh.n_elem) - gain @ rows
        x, p, n = x + gain @ (difference.volts - rows @ x), rest @ p, rest @ n @ rest.T + NOISE**2 * gain @ gain.T
        belief = estimator.update(belief, difference)
        np.testing.assert_allclose(belief.image.values, x, atol=1e-7 * np.abs(x).max())
    some = np.arange(0, mesh.n_elem, 11)
    np.testing.assert_allclose(belief.image.noise_std(some), np.sqrt(np.diag(n)[some]), rtol=1e-5)


def test_without_change_the_filter_becomes_the_image_of_all_scans_together() -> None:
    estimator, static = Kalman(model(), NOISE, "matern", 0.2), GaussNewton(model(), NOISE, "matern", 0.2)
    differences = scans(7)
    belief = estimator.start()
    for difference in differences:
        belief = estimator.update(belief, difference)
    expected = static.reconstruct(*differences)
    np.testing.assert_allclose(belief.image.values, expected.values, atol=1e-7 * np.abs(expected.values).max())
    np.testing.assert_allclose(belief.image.noise_std([3, 40]), expected.noise_std([3, 40]), rtol=1e-5)


def test_unseen_for_long_the_belief_returns_to_the_prior() -> None:
    estimator = Kalman(model(), NOISE, "matern", 0.2, time_constant=0.5)
    seen = estimator.update(estimator.start(), scans(1)[0])
    later = estimator.predict(seen, elapsed=20.0)
    assert np.abs(later.image.values).max() < 1e-9
    np.testing.assert_allclose(later.covariance, estimator.start().covariance, atol=1e-9)


def test_four_injections_a_scan_followed_beat_sixteen_looked_at_alone() -> None:
    """A touch that walks 2 mm a scan: the filter remembers what the scan did not ask."""
    injections = np.array([(k, (k + 5) % 12) for k in range(12)] + [(12, 14), (13, 15), (12, 13), (14, 15)])
    whole, quarters = (
        measure_others(injections, range(16)),
        [measure_others(injections[k::4], range(16)) for k in range(4)],
    )
    estimator = Kalman(model(), NOISE, "matern", 0.2, time_constant=15.0, period=1.0)
    belief, errors = estimator.start(), []
    for k in range(16):
        at = (0.06 + 0.002 * k, 0.1)
        part, full = (touch((*at, 0.012, 0.5), seed=k, pattern=pattern) for pattern in (quarters[k % 4], whole))
        belief = estimator.update(belief, part)
        images = belief.image, estimator.reconstruct(part), estimator.reconstruct(full)
        errors.append([np.linalg.norm(place(image, model().mesh) - at) for image in images])
    followed, single, complete = np.mean(errors[4:], axis=0)
    assert followed < 0.6 * single
    assert followed < 0.9 * complete


# GREIT


@pytest.mark.parametrize("goal", [0.7, 1.5])
def test_greit_attains_its_noise_figure_under_real_noise(goal: float) -> None:
    greit = Greit(model(), NOISE, noise_figure=goal)
    signal = jacobian() @ small_target(model().mesh)
    currents, areas, rng = np.full(PATTERN.n_meas, CURRENT), model().mesh.measures, np.random.default_rng(0)
    noisy = [
        greit.reconstruct(Difference(PATTERN, currents, NOISE * rng.normal(size=len(signal)))).values
        for _ in range(400)
    ]
    image = greit.reconstruct(Difference(PATTERN, currents, signal)).values
    figure = (np.mean(np.abs(signal)) / NOISE) / ((areas @ np.abs(image)) / (areas @ np.std(noisy, axis=0)))
    assert figure == pytest.approx(goal, rel=0.03)


def test_greit_is_the_trained_matrix() -> None:
    """Y D^T (D D^T + w^2 I)^-1 with the responses D and desired images Y of its training."""
    greit, difference = made("GREIT"), touch((*AT, 0.012, 0.5))
    data = CURRENT * PATTERN.combination(16) @ greit.responses
    weight = greit.weight((difference,))
    matrix = greit.desired @ data.T @ np.linalg.inv(data @ data.T + weight**2 * np.eye(len(data)))
    expected = matrix @ difference.volts
    np.testing.assert_allclose(greit.reconstruct(difference).values, expected, atol=1e-6 * np.abs(expected).max())


def test_greit_shows_equal_touches_more_alike_than_any_quadratic_prior() -> None:
    """At equal noise figure, over 81 places: less spread of the peak, and less ringing beside it, than Gauss-Newton
    images."""
    areas, currents = model().mesh.measures, np.full(PATTERN.n_meas, CURRENT)
    line = np.linspace(0.03, 0.17, 9)
    targets = disc_overlap(model().mesh, np.stack(np.meshgrid(line, line), -1).reshape(-1, 2), 0.01).toarray() / areas

    def figures(estimator: GaussNewton | Greit) -> tuple[float, float]:
        peaks, ringing = [], []
        for target in targets:
            values = estimator.reconstruct(Difference(PATTERN, currents, jacobian() @ target)).values
            core = values > values.max() / 2
            peaks.append(values.max())
            ringing.append(areas[~core] @ np.abs(values[~core]) / (areas[core] @ values[core]))
        return float(np.std(peaks) / np.mean(peaks)), float(np.mean(ringing))

    greit = figures(Greit(model(), NOISE, noise_figure=2.0))
    for prior in PRIORS:
        gauss = GaussNewton(model(), NOISE, prior, 0.2)
        tuned = figures(gauss.with_amplitude(noise_figure(gauss, touch(), goal=2.0).amplitude))
        assert greit[0] < 0.8 * tuned[0]
        assert greit[1] < 0.9 * tuned[1]


# absolute


def frame(volts: np.ndarray) -> Frame:
    return Frame(PATTERN, volts, np.full(PATTERN.n_inj, CURRENT), 0.0)


def test_iterating_finds_the_conductivity_that_one_step_misses() -> None:
    """A strong contact on the model's own mesh, next to no noise: the strength that a single step underrates."""
    inside = np.linalg.norm(model().mesh.centroids - AT, axis=1) < 0.025
    touched = TransferModel(model().mesh, GRID, model().conductivity * (1 + 4.0 * inside))
    volts = touched.voltages(PATTERN, CURRENT)
    one = GaussNewton(model(), 1e-5, "matern", 1.0).reconstruct(
        Difference(PATTERN, np.full(PATTERN.n_meas, CURRENT), volts - model().voltages(PATTERN, CURRENT)))  # fmt: skip
    many = AbsoluteGaussNewton(model(), 1e-5, "matern", 1.0).iterate(frame(volts))
    assert many.converged
    assert (np.diff(many.costs) < 0).all()
    assert many.residual < 1.5
    truth = 4.0 * inside
    assert np.linalg.norm(many.image.values - truth) < 0.65 * np.linalg.norm(one.values - truth)
    assert many.image.values[inside].mean() > 2.7  # smoothed
    assert one.values[inside].mean() < 1.5


def test_log_conductivity_keeps_an_insulator_positive() -> None:
    inside = np.linalg.norm(model().mesh.centroids - AT, axis=1) < 0.025
    touched = TransferModel(model().mesh, GRID, model().conductivity * np.where(inside, 0.02, 1.0))
    iterations = AbsoluteGaussNewton(model(), 1e-4, "matern", 1.0).iterate(frame(touched.voltages(PATTERN, CURRENT)))
    assert iterations.image.values.min() > -1
    assert np.median(iterations.image.values[inside]) < -0.85


def test_steps_that_would_raise_the_cost_are_shortened() -> None:
    """Without smoothness, full steps towards an insulator overshoot: here some are halved, and the cost falls in every
    round."""
    inside = np.linalg.norm(model().mesh.centroids - AT, axis=1) < 0.025
    volts = model().with_conductivity(model().conductivity * np.where(inside, 0.02, 1.0)).voltages(PATTERN, CURRENT)
    iterations = AbsoluteGaussNewton(model(), 1e-3, "tikhonov", 1.0, rounds=30).iterate(frame(volts))
    assert (np.diff(iterations.costs) < 0).all()
    assert iterations.converged
    assert iterations.residual < 1


@pytest.mark.parametrize("settings", [{"prior": "paper"}, {"prior": "matern"}, {"outline": 0.02}])
def test_the_absolute_image_is_where_the_cost_is_least(settings: dict) -> None:
    """No direction in log conductivity lowers |V - V(x)|^2 / noise^2 + penalty, with the forward model solved anew."""
    estimator = AbsoluteGaussNewton(model(), 3e-3, amplitude=0.5, tolerance=1e-9, rounds=60, **settings)
    data = frame(voltages((*AT, 0.02, 1.0)) - voltages() + model().voltages(PATTERN, CURRENT))
    if "prior" in settings:
        prior = penalty_of(model(), settings["prior"])
        to_image, matrix = prior.image, prior.normalised / 0.5**2
        to_image = sp.eye_array(model().mesh.n_elem) if to_image is None else to_image
        penalty = lambda w: float(w @ (matrix @ w))  # noqa: E731
    else:
        to_image, penalty = triangle_means(model().mesh), Variation(model().mesh, 0.5, settings["outline"]).cost

    def cost(w: np.ndarray) -> float:
        changed = model().with_conductivity(model().conductivity * np.exp(to_image @ w))
        return float(np.sum((data.voltages - changed.voltages(PATTERN, CURRENT)) ** 2) / 3e-3**2) + penalty(w)

    w = np.linalg.lstsq(to_image.toarray(), np.log1p(estimator.reconstruct(data).values), rcond=None)[0]
    least, rng = cost(w), np.random.default_rng(0)
    for way in [rng.normal(size=len(w)) for _ in range(6)] + [w, np.ones(len(w))]:
        for step in (1e-2, -1e-2):
            assert cost(w + step * way / np.abs(way).max()) > least - 1e-6


def test_a_baseline_takes_off_what_the_model_gets_wrong() -> None:
    """A sheet that conducts 5 % better than the model, and another mesh: without the untouched frame all of that is
    imaged."""
    quiet, touched = voltages() / 1.05, voltages((*AT, 0.012, 0.5)) / 1.05
    baseline = Baseline.learn([frame(quiet)] * 2)
    far = np.linalg.norm(model().mesh.centroids - AT, axis=1) > 0.05
    with_it, without = (
        AbsoluteGaussNewton(model(), 3e-4, "matern", 0.3, baseline=b).reconstruct(frame(touched))
        for b in (baseline, None)
    )
    assert np.linalg.norm(place(with_it, model().mesh) - AT) < 0.006
    assert abs(with_it.values[far].mean()) < 0.005
    assert without.values[far].mean() > 0.03


# sparse


def test_sparse_images_are_of_few_compact_contacts() -> None:
    difference = touch((0.06, 0.13, 0.012, 0.5), (0.14, 0.07, 0.012, 0.5))
    image = made("sparse").reconstruct(difference)
    smooth = made("Gauss-Newton").reconstruct(difference)

    def support(image: Image) -> float:
        return float(np.mean(np.abs(image.values) > 0.1 * image.values.max()))

    assert support(image) < 0.08
    assert support(image) < 0.4 * support(smooth)
    for at in ((0.06, 0.13), (0.14, 0.07)):
        near = np.linalg.norm(model().mesh.centroids - at, axis=1) < 0.03
        mass = np.where(near, image.values, 0) * model().mesh.measures
        assert np.linalg.norm(mass @ model().mesh.centroids / mass.sum() - at) < 0.008


def test_what_is_only_raised_is_learned_as_such() -> None:
    """One contact lowers conductivity, against the assumption: blobs that only rise leave less of the data than a
    signed image does that is cut off at zero (1.8 and 2.2 times the noise).
    """
    difference = touch((0.06, 0.13, 0.012, 0.5), (0.14, 0.07, 0.012, -0.3))
    left = difference.volts - jacobian() @ made("sparse").reconstruct(difference).values
    assert np.sqrt(np.mean(left**2)) < 2.0 * NOISE


def test_noise_alone_is_no_contact() -> None:
    empty = [made("sparse").reconstruct(touch(seed=seed)).values.max() for seed in range(20)]
    assert np.median(empty) < 0.15


# contacts fitted to the data


@cache
def table(radius: float = 0.011) -> ContactTable:
    return ContactTable(model(0.0065), radius, 0.004)


def fitter(noise: float = 2e-4, radius: float = 0.011, model_error: float = 0.02, **settings: float) -> ContactFitter:
    return ContactFitter(table(radius), noise, model_error, **settings)


def test_lost_channels_are_left_out_of_a_fit_and_two_scans_are_one_long_scan() -> None:
    whole = touch((*AT, 0.012, 0.5))
    lost = np.arange(PATTERN.n_meas) % 7 == 3
    holed = Difference(PATTERN, whole.currents, np.where(lost, np.nan, whole.volts))
    left = DrivePattern(PATTERN.injections, PATTERN.measurements[~lost])
    kept = Difference(left, whole.currents[~lost], whole.volts[~lost])
    cut = int(np.searchsorted(PATTERN.measurements[:, 0], 7))
    parts = [
        Difference(
            DrivePattern(PATTERN.injections[:7], PATTERN.measurements[:cut]), whole.currents[:cut], whole.volts[:cut]
        ),
        Difference(
            DrivePattern(PATTERN.injections[7:], PATTERN.measurements[cut:] - [7, 0, 0]),
            whole.currents[cut:],
            whole.volts[cut:],
        ),
    ]
    for found, expected in (([holed], [kept]), (parts, [whole])):
        a, b = fitter().fit(*found), fitter().fit(*expected)
        assert len(a.params) == 1
        np.testing.assert_allclose(a.params, b.params, rtol=1e-6)
        np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-4, atol=1e-6 * b.covariance.max())
    with pytest.raises(DataError, match="no finite measurement"):
        fitter().fit(Difference(PATTERN, whole.currents, np.full(PATTERN.n_meas, np.nan)))
    with pytest.raises(DataError, match="give at least one"):
        fitter().fit()


def test_quiet_data_are_explained_by_no_contact() -> None:
    assert not any(len(fitter(NOISE).fit(touch(seed=seed)).params) for seed in range(40))


@pytest.mark.parametrize(
    ("ratio", "dim", "expected"), [(1.0, 2, 0.0), (3.0, 2, 1.0), (1e9, 2, 2.0), (1e-9, 2, -2.0), (1e9, 3, 3.0)]
)
def test_the_effective_change_is_that_of_a_disc_in_a_uniform_field(ratio: float, dim: int, expected: float) -> None:
    assert effective_change(np.log(ratio), dim)[0] == pytest.approx(expected, abs=1e-6)
    slope = (effective_change(np.log(ratio) + 1e-6, dim)[0] - effective_change(np.log(ratio) - 1e-6, dim)[0]) / 2e-6
    assert effective_change(np.log(ratio), dim)[1] == pytest.approx(slope, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("strength", [4.0, 0.5, -0.8])
def test_the_effective_change_holds_for_strong_contacts(strength: float) -> None:
    """Against the factorised model. To first order in the change the response errs by a quarter to threefold."""
    sheet = model(0.003)
    factor = float(effective_change(np.log1p(strength))[0])
    change = ContactTable(sheet, 0.02, 0.01)([0.09, 0.11]).values[0] * np.pi * 0.02**2
    predicted = CURRENT * PATTERN.combination(16) @ change * factor
    raised = 1 + drawn(sheet.mesh, (0.09, 0.11, 0.02, strength))
    exact = sheet.with_conductivity(sheet.conductivity * raised).voltages(PATTERN, CURRENT)
    exact -= sheet.voltages(PATTERN, CURRENT)
    assert np.linalg.norm(predicted - exact) < 0.04 * np.linalg.norm(exact)
    assert np.linalg.norm(predicted * strength / factor - exact) > 0.2 * np.linalg.norm(exact)


def test_the_stated_covariance_of_a_contact_is_that_of_its_scatter() -> None:
    """Contacts drawn from the fit's own prior of size, data of its own response, a hundred seeds: the squared error
    over the covariance averages to the number of parameters, and each is within its standard deviation two times in
    three."""
    fit, rng = fitter(2e-4, model_error=0.0, most=1), np.random.default_rng(0)
    square, distances, within = 0.011**2, [], []
    for _ in range(100):
        at, effect, share = rng.uniform(0.04, 0.16, 2), rng.uniform(1e-4, 3e-4), 0.0
        while not 0.3 < share < 2.25:  # to where the table ends
            share = 1 + 0.75 * rng.normal()
        change = table()(at, np.sqrt(share * square)).values[0] * effect
        volts = CURRENT * PATTERN.combination(16) @ change + 2e-4 * rng.normal(size=PATTERN.n_meas)
        found = fit.fit(Difference(PATTERN, np.full(PATTERN.n_meas, CURRENT), volts))
        wrong = found.params[0] - [*at, effect, share * square]
        distances.append(wrong @ np.linalg.solve(found.covariance, wrong))
        within.append(np.abs(wrong) < np.sqrt(np.diag(found.covariance)))
    assert np.mean(distances) == pytest.approx(4.0, abs=3 * np.sqrt(8 / 100))
    np.testing.assert_allclose(np.mean(within, axis=0), 0.683, atol=3 * np.sqrt(0.683 * 0.317 / 100))


def test_the_fit_beats_the_centroid() -> None:
    """Twelve touches, data of another mesh: mean error of the fit against that of the linear image."""
    fit, gauss = fitter(radius=0.01), GaussNewton(model(0.0065), 2e-4, "matern", 0.1)
    errors = []
    for seed, at in enumerate(np.random.default_rng(3).uniform(0.03, 0.17, (12, 2))):
        difference = touch((*at, 0.01, 0.5), seed=seed, noise=2e-4)
        (found,) = fit.contacts(fit.fit(difference))
        middle = place(gauss.reconstruct(difference), model(0.0065).mesh)
        errors.append([np.linalg.norm(p - at) for p in (np.array(found.position), middle)])
    disc, centroid = np.mean(errors, axis=0)
    assert disc < 0.0015
    assert disc < 0.5 * centroid


@pytest.mark.parametrize(
    "contacts",
    [
        ((0.06, 0.13, 0.012, 0.5),),
        ((0.06, 0.13, 0.012, 0.5), (0.14, 0.07, 0.012, 0.4)),
        ((0.085, 0.1, 0.01, 0.5), (0.115, 0.1, 0.01, 0.5)),
        ((0.05, 0.05, 0.012, 0.5), (0.15, 0.05, 0.012, 0.5), (0.1, 0.15, 0.012, 0.5)),
    ],
)
def test_the_number_of_contacts_is_found(contacts: tuple) -> None:
    """Five seeds. The third case stands 30 mm apart, where a linear image at this noise shows one blob: there the
    farther contact errs by 3 to 18 mm, by 4.4 mm in the median of twelve seeds."""
    fit, errors = fitter(), []
    for seed in range(5):
        solution = fit.fit(touch(*contacts, noise=2e-4, seed=seed))
        found = fit.contacts(solution)
        assert len(found) == len(contacts)
        errors.append(max(min(np.hypot(*np.subtract(c.position, at[:2])) for c in found) for at in contacts))
        assert len(solution.covariance) == 4 * len(contacts)
        assert all(one.covariance is not None and 0.003 < one.radius < 0.023 for one in found)
    assert np.median(errors) < (0.005 if contacts[0][0] == 0.085 else 0.0025)


def test_close_contacts_are_found_by_splitting_one() -> None:
    """24 mm apart, more than one disc can be moved out of: starting from the first disc and the rest alone errs by 9
    to 15 mm."""
    contacts = (0.058, 0.12, 0.01, 0.5), (0.082, 0.12, 0.01, 0.5)
    fit = fitter(radius=0.01, model_error=0.003, most=2)
    found = fit.contacts(fit.fit(touch(*contacts, noise=2e-4)))
    for contact in contacts:
        assert min(np.linalg.norm(np.subtract(one.position, contact[:2])) for one in found) < 0.003


def test_contacts_come_strongest_first_and_the_weakest_is_found_far_from_the_others() -> None:
    """Effects of 20 : 5 : 1 at next to no noise. The weakest is below what a tenth of the strongest's signal, wrongly
    modelled, may look like; but it is apart from the others, and explains most of what they leave."""
    contacts = (0.05, 0.05, 0.012, 0.05), (0.15, 0.06, 0.012, 1.0), (0.1, 0.15, 0.012, 0.25)
    difference = touch(*contacts, noise=2e-5)
    doubtful, sure = (fitter(2e-5, model_error=share) for share in (0.1, 0.002))
    strongest, second, weakest = doubtful.contacts(doubtful.fit(difference))
    assert np.linalg.norm(np.subtract(weakest.position, (0.05, 0.05))) < 0.005
    assert np.linalg.norm(np.subtract(strongest.position, (0.15, 0.06))) < 0.002
    assert np.linalg.norm(np.subtract(second.position, (0.1, 0.15))) < 0.002
    everything = sure.contacts(sure.fit(difference))
    assert min(np.linalg.norm(np.subtract(found.position, (0.05, 0.05))) for found in everything) < 0.005


def test_a_contact_that_only_raises_conductivity_is_not_fitted_to_a_fall() -> None:
    """Started on top of a fall, the effect stops at zero; allowed to fall, it does, and is found where it is."""
    difference = touch((0.08, 0.12, 0.015, -0.6), noise=2e-4)
    start = np.array([[0.08, 0.12, 1e-4, 0.011**2]])
    for bipolar in (False, True):
        fit = fitter(bipolar=bipolar)
        assert (fit.refine(fit.information(difference)[0], start).params[0, 2] > 0) != bipolar
    (contact,) = fit.contacts(fit.fit(difference))
    assert np.linalg.norm(np.subtract(contact.position, (0.08, 0.12))) < 0.002
    assert contact.strength < 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Greit(model(), NOISE, noise_figure=1e4).reconstruct(touch()),
            "noise figure 10000 cannot be reached with this scan; choose",
        ),
        (lambda: Greit(model(), -1.0), "noise is -1.0; it must be finite and positive"),
        (lambda: TotalVariation(model(), NOISE, outline=0.0), "outline is 0.0"),
        (lambda: TotalVariation(model(), NOISE, rounds=0), "rounds is 0"),
        (lambda: Kalman(model(), NOISE, time_constant=0.0), "time_constant is 0.0; it must be positive"),
        (lambda: Kalman(model(), NOISE, walk=-1.0), "walk is -1.0; it must be finite and not negative"),
        (lambda: Kalman(model(), NOISE, prior="tv"), "no prior 'tv'; choose from paper, laplacian"),
        (lambda: made("Kalman").update(made("Kalman").start(), touch(), elapsed=-1.0), "elapsed is -1.0"),
        (lambda: SparseBayes(model(), NOISE, radius=np.nan), "radius is nan"),
        (lambda: SparseBayes(model(), NOISE, rounds=0), "rounds is 0"),
        (lambda: fitter(false_twos=1.0), "false_twos is 1.0; it must be a rate above 0 and below 1"),
        (lambda: fitter(most=0), "cannot look for 0 contacts"),
        (lambda: ContactTable(bent()), "needs a flat sheet; on surfaces in space find contacts in an image"),
        (lambda: AbsoluteGaussNewton(model(), NOISE, rounds=0), "rounds is 0"),
        (lambda: AbsoluteGaussNewton(model(), NOISE, "tv"), "no prior 'tv'"),
        (lambda: AbsoluteGaussNewton(model(), NOISE, outline=-1.0), "outline is -1.0"),
    ],
)
def test_settings_that_cannot_be_are_refused(make, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        make()


def test_absolute_images_need_a_frame_with_something_in_it() -> None:
    estimator = AbsoluteGaussNewton(model(), NOISE)
    with pytest.raises(DataError, match="give at least one"):
        estimator.reconstruct()
    with pytest.raises(DataError, match="no finite measurement"):
        estimator.reconstruct(frame(np.full(PATTERN.n_meas, np.nan)))


def test_matern_can_be_given_as_a_function_too() -> None:
    named, made_here = (
        GaussNewton(model(), NOISE, prior, 0.2).reconstruct(touch((*AT, 0.012, 0.5))).values
        for prior in ("matern", matern(0.03))
    )
    np.testing.assert_allclose(named, made_here, rtol=1e-9)


def test_an_absolute_image_of_a_source_without_current_measurement_knows_its_loading() -> None:
    """The current rises by a tenth with the touch; taken for constant, the image has nothing to do with it."""
    electrodes = Electrodes.grid(Rectangle(0.2, 0.2), inset=0.01).with_discs(4e-3, 2e-4)
    model = TransferModel(mesh_domain(Rectangle(0.2, 0.2), 0.012, electrodes), electrodes, 1.83e-3)
    inside = np.linalg.norm(model.mesh.centroids - [0.06, 0.13], axis=1) < 0.02
    touched, source = model.with_conductivity(1.83e-3 * (1 + inside)), VoltageSource(5.0, 100.0)
    pattern = adjacent(electrodes.rings)
    quiet, now = (source.currents(one, pattern)[pattern.measurements[:, 0]] for one in (model, touched))
    volts = source.voltages(touched, pattern)
    measured = Difference(pattern, now, volts - now * model.voltages(pattern))
    told = source.unmeasured(model, Difference(pattern, quiet, volts - source.voltages(model, pattern)))
    estimator = AbsoluteGaussNewton(model, 1e-4 * np.abs(volts).max(), amplitude=0.5)
    exact, known, blind = (
        estimator.reconstruct(one).values for one in (measured, told, replace(told, source_loading=None))
    )
    assert np.corrcoef(exact, known)[0, 1] > 0.8
    assert np.corrcoef(exact, blind)[0, 1] < 0.5
    assert np.linalg.norm(model.mesh.centroids[known.argmax()] - [0.06, 0.13]) < 0.02
