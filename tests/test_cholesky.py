"""The sparse factors against dense ones, where a mesh does not lead: odd sizes, odd places, odd graphs."""

from itertools import product
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from numba import njit
from numpy.testing import assert_allclose

from ohmskin.errors import ModelError
from ohmskin.forward import TransferModel
from ohmskin.forward.assembly import SuperLUElimination, elimination, uncompiled
from ohmskin.forward.cholesky import Elimination
from ohmskin.forward.tiles import tile
from ohmskin.inverse import GaussNewton
from ohmskin.skin import Skin


@njit
def call_tile(c, less, a, a_step, a_next, b, depth):  # type: ignore[no-untyped-def]
    tile(c, 3, 9, less, a, 2, a_step, a_next, b, 1, 10, depth)


@pytest.mark.parametrize("less", [False, True])
@pytest.mark.parametrize("depth", [-2, 0, 1, 7])
def test_tile_is_a_product_of_small_matrices(less: bool, depth: int) -> None:
    rng = np.random.default_rng(0)
    c, a, b = rng.normal(size=60), rng.normal(size=100), rng.normal(size=100)
    for a_step, a_next in ((5, 1), (1, 8)):
        expected = c.copy()
        for i in range(4):
            for j in range(8):
                total = sum(a[2 + k * a_step + i * a_next] * b[1 + k * 10 + j] for k in range(depth))
                expected[3 + i * 9 + j] = c[3 + i * 9 + j] - total if less else total
        found = c.copy()
        call_tile(found, less, a, a_step, a_next, b, depth)
        assert_allclose(found, expected, rtol=1e-13, atol=1e-13)
        assert (found == c).sum() >= 60 - 32  # nothing else is touched


def graph(n: int, density: float, seed: int) -> sp.csc_array:
    half = sp.random_array((n, n), density=density, random_state=np.random.default_rng(seed))
    return sp.csc_array(half @ half.T + sp.eye_array(n))


RNG = np.random.default_rng(5)
CASES = {
    "one": (sp.csc_array(np.eye(1)), np.zeros((1, 2)), -1),
    "none left": (sp.csc_array(np.eye(1)), np.zeros((1, 2)), 0),
    "no edges": (sp.csc_array(2 * np.eye(300)), RNG.normal(size=(300, 2)), 7),
    "everywhere": (graph(200, 0.02, 1), RNG.normal(size=(200, 3)), -1),
    "apart": (
        sp.csc_array(sp.block_diag([graph(150, 0.02, 2), graph(60, 0.1, 3), np.eye(3)])),
        RNG.normal(size=(213, 2)),
        5,
    ),
    "dense": (graph(131, 0.5, 4), RNG.normal(size=(131, 2)), -1),
    "one place": (graph(131, 0.1, 4), np.zeros((131, 2)), 3),
    "ever farther": (graph(200, 0.01, 6), 2.0 ** np.arange(200)[:, None], -1),
}


def by_superlu(matrix: sp.csc_array, _: np.ndarray, held: int) -> SuperLUElimination:
    return SuperLUElimination(matrix, held)


@pytest.mark.parametrize(  # SuperLU refuses a matrix without unknowns, which no skin has
    ("made", "case"),
    [*product([Elimination], CASES), *product([by_superlu], [case for case in CASES if case != "none left"])],
)
@pytest.mark.parametrize("columns", [1, 8, 17])
def test_any_graph_at_any_places_is_solved(made: Any, case: str, columns: int) -> None:
    matrix, places, held = CASES[case]
    n = matrix.shape[0]
    free = np.flatnonzero(np.arange(n) != held)
    load = np.random.default_rng(0).normal(size=(n, columns))
    factor = made(matrix, places, held).factorise(matrix.data)
    expected = np.linalg.solve(matrix.toarray()[np.ix_(free, free)], load[free])
    half = factor.half_solve(load)
    for found in (factor.solve(load)[free], factor.half_solve_transposed(half)[free]):
        assert_allclose(found, expected, rtol=0, atol=1e-10 * max(1.0, np.abs(expected).max(initial=0)))
    assert_allclose(half.T @ half, load[free].T @ expected, rtol=1e-9, atol=1e-9)


def test_superlu_stands_in_where_nothing_was_compiled_and_shows_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    skin = Skin.load("paper")

    def model() -> TransferModel:
        mesh = skin.mesh_for(skin.discs, 8e-3)
        return TransferModel(mesh, skin.discs, skin.conductivity_on(mesh))

    own = model()
    with uncompiled():
        assert isinstance(elimination(*CASES["apart"]), Elimination)  # it was compiled
        monkeypatch.setattr("ohmskin.forward.assembly._is_compiled", lambda: False)
        assert isinstance(elimination(*CASES["apart"]), SuperLUElimination)
        other = model()
        images = [GaussNewton(one, 1e-4).modes.modes for one in (own, other)]
        with monkeypatch.context() as small:
            small.setattr("ohmskin.forward.assembly._LARGEST", 100)
            assert isinstance(elimination(*CASES["apart"]), Elimination)
    assert isinstance(elimination(*CASES["apart"]), Elimination)
    scale = np.abs(own.transfer_resistance).max()
    assert_allclose(other.transfer_resistance, own.transfer_resistance, rtol=0, atol=1e-11 * scale)
    spans = [one.T @ (one @ np.ones(one.shape[1])) for one in images]  # modes may be turned, what they span is the same
    assert_allclose(spans[1], spans[0], rtol=0, atol=1e-9 * np.abs(spans[0]).max())


def test_superlu_refuses_what_is_not_positive_definite() -> None:
    for diagonal in ([1.0, -1.0, 1.0], [1.0, 0.0, 1.0]):
        matrix = sp.csc_array(np.diag(diagonal))
        with pytest.raises(ModelError, match="not positive definite"):
            SuperLUElimination(matrix, 0).factorise(matrix.data)
