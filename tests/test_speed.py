"""Every fast path gives what its plain twin gives.

How fast it is, `ohmskin bench` measures; no test looks at a clock.
"""

from functools import cache

import numpy as np
import pytest
import scipy.sparse as sp
from numpy.testing import assert_allclose
from scipy.sparse.linalg import splu

from ohmskin.contacts import Contact, ContactFinder, find_regions, label_peaks
from ohmskin.drive import DRIVES, DriveSettings, TwoScans, pair_weights, round_robin
from ohmskin.errors import DataError, GeometryError, ModelError, PatternError
from ohmskin.forward import LocalUpdate, TouchTable, TransferModel
from ohmskin.forward.assembly import assemble, stiffness
from ohmskin.forward.cholesky import Elimination
from ohmskin.forward.sensitivity import fill_pairs
from ohmskin.geometry import Disc, Electrodes, Mesh, Rectangle, mesh_domain, thicken
from ohmskin.inverse import GaussNewton, Pixels
from ohmskin.inverse.modes import combined
from ohmskin.inverse.priors import mean_diagonal
from ohmskin.scan import (
    Baseline,
    Difference,
    DrivePattern,
    Frame,
    Pairs,
    adjacent,
    all_pairs,
    measure_others,
    pair_index,
)
from ohmskin.scan.baseline import terms_of
from ohmskin.sensing import CompiledCycle
from ohmskin.sensing.primitives import choose, flood

SHEET = Rectangle(0.2, 0.2)
GRID = Electrodes.grid(SHEET)
SCAN = adjacent(GRID.rings)


@cache
def mesh() -> Mesh:
    return mesh_domain(SHEET, 0.009, GRID)


@cache
def model() -> TransferModel:
    uneven = np.random.default_rng(0).uniform(1e-3, 3e-3, mesh().n_elem)
    return TransferModel(mesh(), GRID, uneven)


@cache
def even() -> TransferModel:
    return TransferModel(mesh(), GRID, 1.83e-3)


@cache
def thick() -> Mesh:
    return thicken(mesh_domain(SHEET, 0.03), 0.02, 3)


def random_scan(seed: int, count: int = 6) -> DrivePattern:
    pairs = all_pairs(16)
    return measure_others(pairs[np.random.default_rng(seed).permutation(len(pairs))[:count]], range(16))


# --- finite elements --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["triangles", "tetrahedra", "tensors"])
def test_assembly_into_known_slots_is_the_sum_over_elements(kind: str) -> None:
    where = thick() if kind == "tetrahedra" else mesh()
    rng = np.random.default_rng(1)
    sigma, dim = rng.uniform(1, 2, where.n_elem), where.dim
    root = np.eye(dim)[None] if kind != "tensors" else rng.normal(size=(where.n_elem, dim, dim))
    tensors = (sigma * where.measures)[:, None, None] * (root @ root.transpose(0, 2, 1))
    parts = np.einsum("eik,ekl,ejl->eij", where.gradients, tensors, where.gradients)
    dense = np.zeros((where.n_nodes, where.n_nodes))
    np.add.at(dense, (where.elements[:, :, None], where.elements[:, None, :]), parts)
    found = stiffness(where, sigma, where.gradients @ root)
    assert_allclose(found.toarray(), dense, rtol=0, atol=1e-13 * np.abs(dense).max())
    assert (np.diff(found.indices)[np.diff(np.repeat(np.arange(where.n_nodes), np.diff(found.indptr))) == 0] > 0).all()


def test_gradients_and_areas_written_out_are_those_of_a_solver() -> None:
    corners = mesh().nodes[mesh().elements]
    edges = corners[:, 1:] - corners[:, :1]
    assert_allclose(mesh().measures, np.abs(np.linalg.det(edges)) / 2, rtol=1e-13)
    assert_allclose(
        mesh().gradients[:, 1:] @ edges.transpose(0, 2, 1), np.broadcast_to(np.eye(2), edges.shape), atol=1e-12
    )
    curved = mesh().mapped(lambda p: np.column_stack([0.1 * np.cos(8 * p[:, 0]), 0.1 * np.sin(8 * p[:, 0]), p[:, 1]]))
    sides = curved.nodes[curved.elements][:, 1:] - curved.nodes[curved.elements][:, :1]
    assert_allclose(
        curved.gradients[:, 1:] @ sides.transpose(0, 2, 1), np.broadcast_to(np.eye(2), edges.shape), atol=1e-12
    )


def test_neighbours_are_the_elements_that_share_an_edge() -> None:
    owners: dict[frozenset[int], list[int]] = {}
    for e, (a, b, c) in enumerate(mesh().elements.tolist()):
        for side in ((a, b), (b, c), (c, a)):
            owners.setdefault(frozenset(side), []).append(e)
    for e, (a, b, c) in enumerate(mesh().elements.tolist()):
        beside = [[o for o in owners[frozenset(side)] if o != e] for side in ((a, b), (b, c), (c, a))]
        assert mesh().neighbours[e].tolist() == [others[0] if others else -1 for others in beside]


# --- factorisation ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["points", "discs", "thick", "line", "one place"])
def test_factor_solves_as_superlu_does(case: str) -> None:
    rng = np.random.default_rng(2)
    if case in ("line", "one place"):  # coordinates that cannot be halved, and chains that can
        n = 300
        matrix = sp.csc_array(sp.diags_array([np.full(n, 2.1), *[np.full(n - 1, -1.0)] * 2], offsets=[0, 1, -1]))
        places, held = np.column_stack([np.arange(n) if case == "line" else np.zeros(n), np.zeros(n)]), -1
    else:
        where = thick() if case == "thick" else mesh()
        electrodes = GRID.with_discs(4e-3, 1e-4) if case == "discs" else GRID
        if case == "thick":
            electrodes = Electrodes.at(where.nodes[[0, 5, 11, 17, 23]])
        system = assemble(where, electrodes, rng.uniform(1, 2, where.n_elem))
        matrix, places, held = system.matrix, system.places, int(system.terminals[0])
    load = rng.normal(size=(matrix.shape[0], 3))
    free = np.flatnonzero(np.arange(matrix.shape[0]) != held)
    expected = splu(sp.csc_matrix(matrix[free][:, free])).solve(load[free])
    elimination = Elimination(matrix, places, held)
    factor = elimination.factorise(matrix.data)
    found = factor.solve(load)
    assert_allclose(found[free], expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    assert held < 0 or (found[held] == 0).all()
    assert_allclose(factor.solve(load[:, 0]), found[:, 0], rtol=1e-12, atol=1e-14 * np.abs(found).max())
    half = factor.half_solve(load)  # W^T W is the inverse
    assert_allclose(half.T @ half, load[free].T @ expected, rtol=1e-9)
    assert sorted(elimination.order.tolist()) == free.tolist()


def test_factor_stays_sparse() -> None:
    """Nested dissection: n log n numbers, not n^2; places at random make it nine times as many."""
    system = assemble(even().mesh, GRID, even().conductivity)
    n = system.matrix.shape[0]
    assert system.elimination().factor_start[-1] < 3.5 * n * np.log2(n)


def test_a_matrix_that_is_not_positive_is_refused() -> None:
    system = assemble(even().mesh, GRID, even().conductivity)
    values, last = system.matrix.data.copy(), system.matrix.shape[0] - 1
    diagonal = int(
        np.flatnonzero(system.matrix.indices[system.matrix.indptr[last] :] == last)[0] + system.matrix.indptr[last]
    )
    for bad in (-1.0, np.nan):
        values[diagonal] = bad
        with pytest.raises(ModelError, match="not positive definite"):
            system.elimination().factorise(values)


def test_another_conductivity_reuses_the_order_but_not_the_numbers() -> None:
    other = np.random.default_rng(3).uniform(1e-3, 2e-3, mesh().n_elem)
    for electrodes in (GRID, GRID.with_discs(4e-3, 1e-4)):
        first = TransferModel(mesh(), electrodes, 1.83e-3)
        again, anew = first.with_conductivity(other), TransferModel(mesh(), electrodes, other)
        assert again._elimination is first._elimination
        assert_allclose(again.transfer_resistance, anew.transfer_resistance, rtol=1e-10, atol=1e-9)


# --- sensitivity ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", [2, 3])
def test_sensitivity_kernel_is_the_product_of_fields(dim: int) -> None:
    where = mesh() if dim == 2 else thick()
    potentials = np.random.default_rng(4).normal(size=(where.n_nodes, 5))
    field = np.einsum("ekd,ekl->led", where.gradients, potentials[where.elements])
    i, j = all_pairs(5).T
    plain = -np.sum((field[i] - field[j]) ** 2, axis=2) * where.measures
    quick = np.empty_like(plain)
    fill_pairs(where.elements, where.gradients, where.measures, potentials, all_pairs(5), quick)
    assert_allclose(quick, plain, rtol=0, atol=1e-12 * np.abs(plain).max())


def test_grouped_sensitivity_is_that_of_the_elements_summed() -> None:
    shares = Pixels.over(mesh(), 13).shares
    expected = model().pair_sensitivity @ shares
    assert_allclose(model().grouped_sensitivity(shares), expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    for wrong in (-1.0, np.nan, np.inf):  # negative ones had made it compute for ever
        with pytest.raises(ModelError, match="finite numbers from 0 on"):
            model().grouped_sensitivity(wrong * shares)


@pytest.mark.parametrize("seed", range(3))
def test_rows_without_a_sparse_matrix_are_the_combination(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pairs = rng.normal(size=(120, 7))
    quadruples = np.array([rng.permutation(16)[:4] for _ in range(40)] + [[3, 5, 3, 5], [3, 5, 5, 9]])
    pattern = DrivePattern(quadruples[:, :2], np.column_stack([np.arange(42), quadruples[:, 2:]]))
    assert_allclose(combined(terms_of(pattern, Pairs.all(16)), pairs), pattern.combination(16) @ pairs, atol=1e-13)


# --- pixels -----------------------------------------------------------------------------------------------------------


def test_every_element_is_shared_out_whole() -> None:
    for domain in (SHEET, Disc(0.1), Rectangle(0.2, 0.07)):
        where = mesh_domain(domain, 0.008)
        pixels = Pixels.over(where, 24)
        assert_allclose(pixels.shares.sum(axis=1), 1.0, rtol=1e-12)
        assert_allclose(pixels.measures.sum(), where.measures.sum(), rtol=1e-12)
        # a shared element lies in the pixel: no centroid of it is further off than its size and the pixel's
        element, pixel = pixels.shares.nonzero()
        away = np.abs(where.centroids[element] - pixels.centroids[pixel]).max(axis=1)
        assert away.max() < pixels.pitch / 2 + 0.012
        whole = pixels.measures > 0.999 * pixels.pitch**2
        assert_allclose(pixels.measures.max(), pixels.pitch**2, rtol=0.35)  # samples, not exact overlaps
        assert whole.any()


def test_pixel_prior_has_variance_one_and_is_eq_5_for_squares() -> None:
    pixels = Pixels.over(mesh(), 12)
    matrix = pixels.penalty.matrix.toarray()
    assert (np.diag(matrix) == 4).all()
    inner = ((pixels.neighbours >= 0).sum(axis=1) == 4).nonzero()[0]
    assert (matrix[inner].sum(axis=1) == 0).all()
    assert np.trace(pixels.penalty.covariance(np.eye(144))) / 144 == pytest.approx(1, rel=1e-12)
    round_ = Pixels.over(mesh_domain(Disc(0.1), 0.008), 20)  # not a whole rectangle: from random signs
    apply = round_.penalty.covariance
    assert mean_diagonal(apply, len(round_)) == pytest.approx(1, rel=1e-9)
    assert np.trace(apply(np.eye(len(round_)))) / len(round_) == pytest.approx(1, rel=0.05)


def test_images_on_pixels_do_not_depend_on_the_mesh() -> None:
    """Data of a touch on a third mesh, images on a coarse and a fine one; with the paper's prior on triangles they
    differ more."""
    truth = TransferModel(mesh_domain(SHEET, 0.0045, GRID), GRID, 1.83e-3)
    raised = np.where(np.linalg.norm(truth.mesh.centroids - [0.06, 0.12], axis=1) < 0.015, 1.5, 1.0)
    volts = truth.with_conductivity(truth.conductivity * raised).voltages(SCAN, 1e-3) - truth.voltages(SCAN, 1e-3)
    difference = Difference(SCAN, np.full(SCAN.n_meas, 1e-3), volts)
    on_pixels, on_triangles = [], []
    for size in (0.009, 0.005):
        where = mesh_domain(SHEET, size, GRID)
        fine, pixels = TransferModel(where, GRID, 1.83e-3), Pixels.over(where, 24)
        on_pixels.append(GaussNewton(fine, 1e-4, amplitude=0.1, pixels=pixels).reconstruct(difference).values)
        own = GaussNewton(fine, 1e-4, amplitude=0.1).reconstruct(difference).values
        on_triangles.append((own * where.measures) @ pixels.shares / pixels.measures)
    change = [np.linalg.norm(b - a) / np.linalg.norm(b) for a, b in (on_pixels, on_triangles)]
    assert change[0] < 0.03
    assert change[1] > 0.035


def test_pixels_are_refused_where_they_make_no_sense() -> None:
    with pytest.raises(GeometryError, match="flat"):
        Pixels.over(mesh().mapped(lambda p: np.column_stack([p, p[:, 0]])))
    with pytest.raises(GeometryError, match="2 to 1024"):
        Pixels.over(mesh(), 1)


# --- images -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 4, 12])  # fewer and more measurements than modes
@pytest.mark.parametrize("on_pixels", [False, True])
def test_the_smaller_system_gives_the_textbook_image(count: int, on_pixels: bool) -> None:
    pixels = Pixels.over(mesh(), 16) if on_pixels else None
    estimator = GaussNewton(even(), 1e-5, amplitude=0.1, pixels=pixels)
    pattern = random_scan(5, count)
    volts = np.random.default_rng(5).normal(size=pattern.n_meas) * 1e-5
    penalty = estimator.penalty.normalised.toarray()
    jacobian = pattern.combination(16) @ estimator.relative() * 1e-3
    normal = jacobian.T @ jacobian + (1e-5 / 0.1) ** 2 * penalty
    exact = np.linalg.solve(normal, jacobian.T @ volts)
    image = estimator.reconstruct(Difference(pattern, np.full(pattern.n_meas, 1e-3), volts))
    assert_allclose(image.values, exact, rtol=0, atol=2e-6 * np.abs(exact).max())
    std = 1e-5 * np.linalg.norm(np.linalg.solve(normal, jacobian.T)[[3, 40]], axis=1)
    assert_allclose(image.noise_std([3, 40]), std, rtol=1e-5)


@cache
def estimator() -> GaussNewton:
    return GaussNewton(even(), 1e-6, amplitude=0.1, model_error=0.02, pixels=Pixels.over(mesh(), 20))


# --- the cycle --------------------------------------------------------------------------------------------------------


def touched(*places: tuple[float, float], radius: float = 0.012) -> TransferModel:
    raised = np.ones(mesh().n_elem)
    for place in places:
        raised[np.linalg.norm(mesh().centroids - place, axis=1) < radius] = 1.5
    return even().with_conductivity(even().conductivity * raised)


def scanned(pressed: TransferModel, pattern: DrivePattern, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    currents = 1e-3 * rng.uniform(0.95, 1.05, pattern.n_inj)
    volts = pressed.voltages(pattern, currents) - even().voltages(pattern, currents)
    return volts + 1e-6 * rng.normal(size=pattern.n_meas), currents


def eq7(pairs: int, electrodes: Electrodes = GRID) -> TwoScans:
    drive = DRIVES["eq7"](DriveSettings(electrodes, pairs=pairs), 0)
    assert isinstance(drive, TwoScans)
    return drive


class Plain:
    """What a compiled cycle sees, with the parts of the other packages, in float64."""

    def __init__(self, cycle: CompiledCycle) -> None:
        self.cycle, self.estimator, self.scans = cycle, cycle.estimator, []

    def base_step(self, volts: np.ndarray, currents: np.ndarray, usual: float = 1e-3) -> list[int]:
        """The pairs of eq. (7) about the regions of the base image; about its highest place if there are none."""
        base, cells = self.cycle.drive.base, self.estimator.cells
        share = usual / currents[base.measurements[:, 0]]
        self.scans = [Difference(base, np.full(base.n_meas, usual), volts * share)]
        self.base_image = self.estimator.reconstruct(*self.scans).values
        regions = find_regions(self.base_image, cells, max(0.02, 0.3 * self.base_image.max()), 0.2)
        middles = [region.centroid for region in regions] or [cells.centroids[self.base_image.argmax()]]
        anchors = [cells.centroids[cells.closest_elements(middle[None], 3)[0]] for middle in middles]
        injections = self.cycle.drive.second.pattern(anchors).injections
        return pair_index(injections[:, 0], injections[:, 1], len(self.estimator.model.electrodes)).tolist()

    def second_step(self, volts: np.ndarray, currents: np.ndarray, chosen: np.ndarray) -> list[Contact]:
        """The contacts of the image of both scans, or of the second one alone."""
        pattern = self.cycle.pattern(chosen)
        second = Difference(pattern, currents[pattern.measurements[:, 0]], volts)
        image = self.estimator.reconstruct(*self.scans[: self.cycle.fuse], second)
        self.image = image.values
        return ContactFinder(0.02).find(image, self.estimator.cells)


@pytest.mark.parametrize(("pairs", "fuse"), [(4, False), (4, True), (12, False), (12, True)])
def test_the_compiled_cycle_sees_what_its_parts_see(pairs: int, fuse: bool) -> None:
    drive = eq7(pairs)
    fast = CompiledCycle(estimator(), drive, (0.02, 0.02), fuse=fuse)
    plain = Plain(fast)
    rng = np.random.default_rng(7)
    seen = 0
    for k in range(12):
        pressed = touched(*rng.uniform(0.03, 0.17, (k % 4, 2)))
        base = scanned(pressed, drive.base, rng)
        chosen, expected = fast.base_step(*base), plain.base_step(*base)
        assert_allclose(fast.base_image, plain.base_image, rtol=0, atol=5e-6 * np.abs(plain.base_image).max())
        assert len(set(chosen.tolist())) == pairs
        # float32 may turn the order of pairs that are alike, and exchange the last for one as good; no more
        assert len(set(chosen.tolist()) & set(expected)) >= pairs - 1
        second = scanned(pressed, fast.pattern(chosen), rng)
        found, right = fast.second_step(*second), plain.second_step(*second, chosen)
        assert_allclose(fast.image, plain.image, rtol=0, atol=5e-6 * np.abs(plain.image).max())
        assert len(found) == len(right)
        for a, b in zip(found, right, strict=True):
            assert_allclose(a.position, b.position, atol=1e-6)
            assert_allclose(
                [a.extent, a.strength, a.peak, a.confidence], [b.extent, b.strength, b.peak, b.confidence], rtol=1e-4
            )
        seen += len(found)
    assert seen >= 12  # it was not empty agreement


@pytest.mark.parametrize("pairs", [3, 9])
def test_the_compiled_cycle_pads_measurements_and_modes(pairs: int) -> None:
    """Ten electrodes have 45 modes, and 21 or 63 measurements: none of them a multiple of four."""
    ten = Electrodes.rim(SHEET, 10)
    where = mesh_domain(SHEET, 0.015, ten)
    quiet = TransferModel(where, ten, 1.83e-3)
    pressed = quiet.with_conductivity(
        1.83e-3 * np.where(np.linalg.norm(where.centroids - [0.05, 0.12], axis=1) < 0.02, 1.5, 1.0)
    )
    drive = eq7(pairs, ten)
    fast = CompiledCycle(GaussNewton(quiet, 1e-5, amplitude=0.1), drive, (0.02, 0.02))
    plain = Plain(fast)
    base = pressed.voltages(drive.base, 1e-3) - quiet.voltages(drive.base, 1e-3), np.full(drive.base.n_inj, 1e-3)
    chosen = fast.base_step(*base)
    pattern = fast.pattern(chosen)
    plain.base_step(*base)
    second = pressed.voltages(pattern, 1e-3) - quiet.voltages(pattern, 1e-3), np.full(pattern.n_inj, 1e-3)
    (found,), (right,) = fast.second_step(*second), plain.second_step(*second, chosen)
    assert_allclose(fast.image, plain.image, rtol=0, atol=5e-6 * plain.image.max())
    assert_allclose([*found.position, found.confidence], [*right.position, right.confidence], rtol=1e-5)


def test_the_compiled_cycle_is_the_estimator_with_the_contact_finder() -> None:
    """Against the parts of the usual loop: one estimator, eq. (7) and the contact finder, at the usual currents."""
    drive = eq7(6)
    fast = CompiledCycle(estimator(), drive, (0.02, 0.02))
    pressed = touched((0.06, 0.13))
    base = pressed.voltages(drive.base, 1e-3) - even().voltages(drive.base, 1e-3)
    chosen = fast.base_step(base, np.full(drive.base.n_inj, 1e-3))
    first = Difference(drive.base, np.full(drive.base.n_meas, 1e-3), base)
    image = estimator().reconstruct(first)
    assert_allclose(fast.base_image, image.values, rtol=0, atol=5e-5 * image.values.max())
    pattern = fast.pattern(chosen)
    volts = pressed.voltages(pattern, 1e-3) - even().voltages(pattern, 1e-3)
    contacts = fast.second_step(volts, np.full(pattern.n_inj, 1e-3))
    both = estimator().reconstruct(first, Difference(pattern, np.full(pattern.n_meas, 1e-3), volts))
    assert_allclose(fast.image, both.values, rtol=0, atol=5e-5 * both.values.max())
    assert len(contacts) == 1
    assert np.hypot(contacts[0].position[0] - 0.06, contacts[0].position[1] - 0.13) < 0.005
    assert ContactFinder(0.02).threshold < contacts[0].peak == pytest.approx(both.values.max(), rel=5e-5)


def test_with_a_baseline_it_takes_voltages() -> None:
    drive = eq7(4)
    complete = drive.second.complete
    rng = np.random.default_rng(8)
    quiet = [
        Frame(p, even().voltages(p, 1e-3), np.full(p.n_inj, 1e-3), 0.0)
        for p in (drive.base, complete)
        for _ in range(2)
    ]
    baseline = Baseline.learn(
        [Frame(f.pattern, f.voltages + 1e-9 * rng.normal(size=len(f.voltages)), f.currents, 0.0) for f in quiet]
    )
    with_baseline = CompiledCycle(estimator(), drive, (0.02, 0.02), baseline=baseline)
    without = CompiledCycle(estimator(), drive, (0.02, 0.02))
    pressed = touched((0.15, 0.07))
    currents = np.full(drive.base.n_inj, 1.2e-3)
    chosen = with_baseline.base_step(pressed.voltages(drive.base, 1.2e-3), currents)
    without.base_step(pressed.voltages(drive.base, 1.2e-3) - even().voltages(drive.base, 1.2e-3), currents)
    assert_allclose(with_baseline.base_image, without.base_image, atol=1e-3 * without.base_image.max())
    pattern = with_baseline.pattern(chosen)
    found = with_baseline.second_step(pressed.voltages(pattern, 0.8e-3), np.full(pattern.n_inj, 0.8e-3))
    assert len(found) == 1
    assert np.hypot(found[0].position[0] - 0.15, found[0].position[1] - 0.07) < 0.005


def test_frames_leave_nothing_behind() -> None:
    """A frame after others is the frame by itself."""
    drive, rng = eq7(4), np.random.default_rng(9)
    fast = CompiledCycle(estimator(), drive, (0.02, 0.02))
    pressed = touched((0.05, 0.05), (0.14, 0.12))
    base = scanned(pressed, drive.base, rng)
    second = scanned(pressed, fast.pattern(fast.base_step(*base)), rng)
    first = fast.frame(base, lambda _: second)
    quiet = (np.zeros(drive.base.n_meas), np.full(drive.base.n_inj, 1e-3)), (np.zeros(52), np.full(4, 1e-3))
    assert fast.frame(quiet[0], lambda _: quiet[1]) == []
    assert fast.frame(base, lambda _: second) == first
    assert len(first) == 2


def test_a_cycle_refuses_bad_data_and_orders() -> None:
    drive = eq7(4)
    fast = CompiledCycle(estimator(), drive, (0.02, 0.02))
    volts, currents = np.zeros(drive.base.n_meas), np.full(drive.base.n_inj, 1e-3)
    with pytest.raises(DataError, match="base_step"):
        fast.second_step(np.zeros(52), np.full(4, 1e-3))
    fast.base_step(volts, currents)
    with pytest.raises(DataError, match="second scan"):
        fast.second_step(np.full(52, np.nan), np.full(4, 1e-3))
    with pytest.raises(DataError, match="base scan"):
        fast.base_step(volts, 0 * currents)  # no current, no resistance
    volts[5] = np.nan
    with pytest.raises(DataError, match="base scan"):
        fast.base_step(volts, currents)
    with pytest.raises(DataError, match="shape"):
        fast.base_step(np.zeros(7), currents)
    fast.base_step(np.zeros(drive.base.n_meas), currents)
    with pytest.raises(DataError, match=r"0\.\.119"):
        fast.second_step(np.zeros(52), np.full(4, 1e-3), chosen=[0, 1, 2, 120])
    with pytest.raises(ModelError, match="linear"):
        CompiledCycle(GaussNewton(even(), 1e-6, positive=True), drive, (0.1, 0.1))
    with pytest.raises(PatternError, match=r"eq. \(7\)"):
        CompiledCycle(estimator(), DRIVES["position"](DriveSettings(GRID), 0), (0.1, 0.1))


@pytest.mark.parametrize("seed", range(6))
def test_regions_without_new_memory_are_those_of_label_peaks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pixels = Pixels.over(mesh_domain(Disc(0.1), 0.012), 24)
    image = sum(
        height * np.exp(-np.sum((pixels.centroids - place) ** 2, axis=1) / 3e-4)
        for place, height in zip(rng.uniform(-0.08, 0.08, (5, 2)), rng.uniform(0.3, 1, 5), strict=True)
    ).astype(np.float32)
    image[:40] = image[40]  # equal values, too
    n = len(image)
    labels = np.empty(n, np.int32)
    for threshold, dip in ((0.05, 0.2), (0.3, 1.0), (2.0, 0.2)):
        neighbours = pixels.neighbours.astype(np.int32)
        count, above = flood(image, neighbours, threshold, dip, np.empty(n, np.int64), np.empty(n, np.int32), labels)
        expected = label_peaks(image.astype(float), pixels.neighbours, threshold, dip)
        assert above == (expected >= 0).sum()
        assert count == expected.max() + 1
        assert (labels == expected).all()


@pytest.mark.parametrize("seed", range(6))
def test_compiled_choice_is_eq_7(seed: int) -> None:
    rng = np.random.default_rng(seed)
    anchors = rng.uniform(0.01, 0.19, (rng.integers(1, 4), 1, 2)) + rng.normal(size=(1, 3, 2)) * 2e-3
    chosen = np.empty(11, np.int64)
    choose(GRID.positions, all_pairs(16), np.inf, anchors, np.empty((len(anchors), 120)), chosen)
    expected = round_robin(np.array([pair_weights(GRID.positions, a) for a in anchors]), 11)
    assert chosen.tolist() == expected.tolist()


# --- touches ----------------------------------------------------------------------------------------------------------


def places_touched() -> list[np.ndarray]:
    centres = [(0.04, 0.05), (0.1, 0.1), (0.108, 0.1), (0.16, 0.02), (0.0, 0.0)]
    return [np.flatnonzero(np.linalg.norm(mesh().centroids - centre, axis=1) < 0.016) for centre in centres]


@cache
def table() -> TouchTable:
    return TouchTable(model(), places_touched())


@pytest.mark.parametrize("places", [[0], [4], [1, 3], [1, 2], [0, 1, 2, 3, 4]])  # 1 and 2 overlap, 4 is at an electrode
@pytest.mark.parametrize("strength", [1e-3, 0.5, 30.0])
def test_touches_from_the_table_are_those_of_refactorised_models(places: list[int], strength: float) -> None:
    changes = strength * np.linspace(1, 2, len(places))
    factor = np.ones(mesh().n_elem)
    for place, change in zip(places, changes, strict=True):
        factor[places_touched()[place]] += change
    expected = model().with_conductivity(model().conductivity * factor).transfer_resistance
    change = np.abs(expected - model().transfer_resistance).max()
    assert_allclose(
        table().transfer_resistance(places, changes),
        expected,
        rtol=0,
        atol=1e-8 * change + 1e-10 * np.abs(expected).max(),
    )


def test_a_touch_has_fewer_modes_than_nodes() -> None:
    nodes = np.array([len(np.unique(mesh().elements[place])) for place in places_touched()])
    assert (table()._measured < nodes).all()
    assert (table()._measured[1:3] < 0.8 * nodes[1:3]).all()  # away from the rim and electrodes


def test_many_scenes_are_the_scenes_one_by_one_on_any_number_of_threads() -> None:
    rng = np.random.default_rng(10)
    places = np.where(rng.uniform(size=(30, 3)) < 0.3, -1, rng.permuted(np.tile(np.arange(5), (30, 1)), axis=1)[:, :3])
    changes = rng.uniform(0, 3, (30, 3)) * (rng.uniform(size=(30, 3)) < 0.8)
    alone = [table().transfer_resistance(p[p >= 0], c[p >= 0]) for p, c in zip(places, changes, strict=True)]
    for threads in (1, 2, 3):
        assert_allclose(table().many(places, changes, threads), alone, rtol=1e-9)


def test_touch_tables_say_what_is_wrong() -> None:
    with pytest.raises(ModelError, match="one place at least"):
        TouchTable(even(), [])
    for bad in ([], [0, 0], [-1], [10**6], [0.5]):
        with pytest.raises(ModelError, match="place 0 needs elements"):
            TouchTable(even(), [np.array(bad)])
    with pytest.raises(ModelError, match="there are 5"):
        table().transfer_resistance([5], [1.0])
    for bad in (-0.5, np.nan, np.inf):
        with pytest.raises(ModelError, match="LocalUpdate"):
            table().transfer_resistance([0], [bad])
    with pytest.raises(ModelError, match="shapes"):
        table().many(np.zeros((2, 1), int), np.zeros((2, 2)))


def test_green_matrix_at_a_grounded_electrode_is_zero() -> None:
    update = LocalUpdate(even(), [*mesh().nodes_at(GRID.positions[:1]), 30, 31])
    row = int(np.searchsorted(update.nodes, mesh().nodes_at(GRID.positions[:1])[0]))
    assert (update.green[row] == 0).all()
    assert (update.green[:, row] == 0).all()
    assert_allclose(update.green, update.green.T, rtol=1e-9, atol=1e-9 * update.green.max())
