"""Skins of many electrodes: near pairs alone are driven, measured and numbered."""

from functools import cache

import numpy as np
import pytest
from direct import DirectDevice
from numpy.testing import assert_allclose

from ohmskin import Engine, Skin, VirtualSkin
from ohmskin.contacts.information import Errors, Information
from ohmskin.contacts.misfit import ridge_solution
from ohmskin.drive import Candidates, OptimalDrive, base_pattern, candidate_pairs, candidate_pattern, part_of
from ohmskin.drive.optimal import pair_weights, round_robin
from ohmskin.drive.patterns import numbers_of
from ohmskin.errors import PatternError
from ohmskin.geometry import Electrodes, Raster, Rectangle
from ohmskin.scan import Difference, Pairs
from ohmskin.scan.pairs import in_series
from ohmskin.sensing.primitives import choose
from ohmskin.skin import Fault


@cache
def grid(columns: int, rows: int) -> Electrodes:
    return Electrodes.grid(Rectangle(0.027 * (columns - 1), 0.027 * (rows - 1)), columns, rows)


@cache
def skin() -> Skin:
    return Skin.parse(
        'name = "many"\n[sheet]\nwidth = 0.17\nheight = 0.143\n[electrode]\ncolumns = 7\nrows = 6\ninset = 0.004\n'
        "[imaging]\nmesh_size = 7e-3\n"
    )


@pytest.mark.parametrize(("columns", "rows"), [(7, 6), (16, 16)])
def test_near_pairs_are_measured_at_as_many_electrodes_each_and_grow_with_the_skin(columns: int, rows: int) -> None:
    electrodes, pattern = grid(columns, rows), candidate_pattern(grid(columns, rows))
    assert (np.bincount(pattern.measurements[:, 0]) == 9).all()
    assert not pattern.driven.any()
    ends = electrodes.positions[pattern.quadruples]
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).max() < 0.06
    assert np.linalg.norm(ends.mean(axis=1, keepdims=True) - ends, axis=2).max() < 0.11
    assert pattern.n_inj < 6 * len(electrodes)
    assert len(candidate_pairs(electrodes)) < 12 * len(electrodes)


def test_of_few_electrodes_and_of_a_rim_all_pairs_are_candidates() -> None:
    for electrodes in (grid(6, 6), Electrodes.rim(Rectangle(0.4, 0.4), 48)):
        n_elec = len(electrodes)
        assert candidate_pattern(electrodes).n_inj == n_elec * (n_elec - 1) // 2
        assert candidate_pairs(electrodes).whole


def test_the_base_scan_is_a_part_of_the_candidates_all_over_the_skin() -> None:
    electrodes, whole = grid(16, 16), candidate_pattern(grid(16, 16))
    base = base_pattern(electrodes)
    assert base == part_of(whole, numbers_of(whole, base.injections))
    assert base.n_inj == 128
    middles = electrodes.positions[base.injections].mean(axis=1)
    places = np.random.default_rng(0).uniform(0, 0.405, (400, 2))
    assert np.linalg.norm(places[:, None] - middles, axis=2).min(axis=1).max() < 0.045


def test_rows_over_near_pairs_are_those_over_all_pairs() -> None:
    near = candidate_pairs(grid(7, 6))
    pattern, random = candidate_pattern(grid(7, 6)).with_driven, np.random.default_rng(0)
    values = random.normal(size=861)
    own = values[Pairs.all(42).index(*near.ends.T)]
    assert_allclose(pattern.combination(near) @ own, pattern.combination(42) @ values, atol=1e-12)
    ones = np.ones(pattern.n_meas)
    change = Difference(pattern, ones, ones, source_loading=ones)
    assert_allclose(change.caused_by(own, near), change.caused_by(values), atol=1e-12)
    with pytest.raises(PatternError, match="electrodes 0 and 11 are not a pair that this skin is driven"):
        near.index([0], [11])


def test_a_model_over_near_pairs_tells_the_same_of_them() -> None:
    model = skin().electrode_model()
    whole, at = model.over(Pairs.all(42)), Pairs.all(42).index(*model.pairs.ends.T)
    assert len(model.pairs) < 500
    for name in ("pair_resistances", "pair_sensitivity", "pair_contact_sensitivity"):
        assert_allclose(getattr(model, name), getattr(whole, name)[at], rtol=1e-12)
    fields = np.random.default_rng(0).normal(size=(model.mesh.n_elem, 3))
    expected = whole.pair_sensitivity[at] @ fields
    assert_allclose(model.field_sensitivity(fields), expected, atol=1e-5 * np.abs(expected).max())


def test_the_compiled_choice_of_near_pairs_is_that_of_the_drive() -> None:
    drive, random = OptimalDrive(grid(7, 6), 12), np.random.default_rng(0)
    assert drive.reach < 0.06
    for _ in range(5):
        anchors = random.uniform(0.01, 0.12, (2, 1, 2)) + random.normal(size=(2, 3, 2)) * 2e-3
        chosen, pairs = np.empty(12, np.int64), drive.complete.injections
        space = np.empty((2, len(pairs)))
        choose(drive.electrodes.positions.copy(), pairs.copy(), drive.reach, anchors, space, chosen)
        assert chosen.tolist() == drive.choose(list(anchors)).tolist()
        weights = [pair_weights(drive.electrodes.positions, one, 0.0, pairs, drive.reach) for one in anchors]
        assert chosen.tolist() == round_robin(np.array(weights), 12).tolist()
        middles = drive.electrodes.positions[pairs[chosen]].mean(axis=1)
        assert np.linalg.norm(middles[:, None] - anchors[:, 0], axis=2).min(axis=1).max() <= drive.reach


def test_a_part_of_the_candidates_says_what_they_say() -> None:
    whole = Candidates.at_currents(candidate_pattern(grid(7, 6)), candidate_pairs(grid(7, 6)), 1e-4, contacts=5.0)
    columns, chosen = np.random.default_rng(0).normal(size=(len(whole.pairs), 4)), np.array([3, 50, 51])
    assert_allclose(whole.part(chosen).rows(columns), whole.rows(columns)[chosen], atol=1e-9)


def test_the_likeliest_change_is_that_of_the_normal_equations() -> None:
    pattern, random = base_pattern(grid(7, 6)).with_driven, np.random.default_rng(0)
    near = candidate_pairs(grid(7, 6))
    scan = Difference(pattern, np.full(pattern.n_meas, 1e-3), random.normal(size=pattern.n_meas))
    errors = Errors(1e-3, gain=1e-3, contacts=5 * in_series(range(42), near))
    told, _ = Information.of(near, errors, [scan])
    matrix, vector = told.misfit.matrix[:-1, :-1], told.misfit.vector[:-1]
    found = ridge_solution(told.misfit.rows, told.misfit.downdates, told.misfit.vector, 0.05)
    exact = np.linalg.solve(matrix + 0.05 * np.eye(len(matrix)), vector)
    assert_allclose(found[:-1], exact, atol=1e-6 * np.abs(exact).max())
    assert found[-1] == 0


@pytest.mark.parametrize("mode", ["42O", "42P", "42T"])
def test_presses_all_over_a_skin_of_many_electrodes_are_felt(mode: str) -> None:
    virtual, raster = VirtualSkin(skin(), seed=2), Raster(skin().mesh(), 64)
    with Engine(lambda: DirectDevice(virtual), skin(), mode) as engine:
        assert list(engine.modes) == ["42O", "42P", "42T"]
        engine.calibrate()
        for x, y in ((0.07, 0.06), (0.13, 0.1), (0.02, 0.12)):
            virtual.press(1, x, y, 8e-3, 20e3)
            touches = [engine.step() for _ in range(14)]
            assert touches[-1] is not None
            (contact,) = touches[-1].contacts
            assert np.hypot(contact.position[0] - x, contact.position[1] - y) < 4e-3
            drawn = raster(touches[-1].percept.image.values)  # as page, recorder and publishers draw it
            assert np.nanmax(drawn) > 0.01
            row, column = np.unravel_index(np.nanargmax(drawn), drawn.shape)
            assert np.hypot(raster.x[column] - x, raster.y[row] - y) < 10e-3
            assert not touches[-1].percept.findings
        virtual.press(1, 0.1, 0.1, 8e-3, 0)
        assert not [engine.step() for _ in range(14)][-1].contacts  # type: ignore[union-attr]


def test_an_electrode_of_many_that_comes_off_is_told_and_left_out() -> None:
    virtual, electrode = VirtualSkin(skin(), seed=2), int(base_pattern(skin().electrodes).injections[3, 0])
    with Engine(lambda: DirectDevice(virtual), skin(), "42P") as engine:
        engine.calibrate()
        virtual.rewire(Fault("open", (electrode,)))
        touches = [engine.step() for _ in range(12)]
        assert touches[-1] is not None
        assert any(finding.cause.electrodes == (electrode,) for finding in touches[-1].percept.findings)
        assert not touches[-1].contacts
