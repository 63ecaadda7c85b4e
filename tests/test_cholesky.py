"""The sparse factors against dense ones, where a mesh does not lead: odd sizes, odd places, odd graphs."""

import numpy as np
import pytest
import scipy.sparse as sp
from numba import njit
from numpy.testing import assert_allclose

from ohmskin.forward.cholesky import Elimination
from ohmskin.forward.tiles import tile


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


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("columns", [1, 8, 17])
def test_any_graph_at_any_places_is_solved(case: str, columns: int) -> None:
    matrix, places, held = CASES[case]
    n = matrix.shape[0]
    free = np.flatnonzero(np.arange(n) != held)
    load = np.random.default_rng(0).normal(size=(n, columns))
    found = Elimination(matrix, places, held).factorise(matrix.data).solve(load)
    expected = np.linalg.solve(matrix.toarray()[np.ix_(free, free)], load[free])
    assert_allclose(found[free], expected, rtol=0, atol=1e-10 * max(1.0, np.abs(expected).max(initial=0)))
