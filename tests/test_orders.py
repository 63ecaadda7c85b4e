"""Press data without a pattern: the order of adjacent measurements is told from the voltages, columns by names."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from ohmskin.arrays import Floats
from ohmskin.importers import read_recording, resolved
from ohmskin.importers.orders import Order, likeliest, orders
from ohmskin.scan import DrivePattern
from ohmskin.skin import Skin

N = 16
ORDERS = [one for count in (208, 224, 240, 256) for one in orders(count)]


@cache
def potentials(skin: str) -> Floats:
    """Of each electrode (N, N) while each drives its neighbour, against electrode 5, with drops at contacts (V)."""
    model, found = Skin.load(skin).transfer_model(), np.zeros((N, N))
    for source in range(N):
        others = np.array([k for k in range(N) if k != 5])
        measured = np.column_stack([0 * others, others, 0 * others + 5])
        found[source, others] = model.voltages(DrivePattern(np.array([[source, (source + 1) % N]]), measured))
        found[source, [source, (source + 1) % N]] += (500.0, -500.0)
    return found


def written(order: Order, seed: int, skin: str) -> Floats:
    """Values (2, n) as they stand in a file."""
    random, count = np.random.default_rng(seed), max(order.plus.max(), order.minus.max()) + 1
    source, _, plus, minus = order.quadruples.T
    at, values = potentials(skin), np.empty(count)
    values[order.plus] = at[source, plus] - (0.0 if order.single else at[source, minus])
    if order.single:
        values[order.minus] = at[source, minus]
    return values * (1 + (5e-3 if order.single else 0.1) * random.standard_normal((2, count)))


@pytest.mark.parametrize("order", ORDERS, ids=lambda one: f"{one.quadruples.shape[0]} {one.words}")
@pytest.mark.parametrize("skin", ["paper-rim16", "tank"])
def test_each_order_is_told_from_rectified_uneven_voltages(order: Order, skin: str) -> None:
    for seed in range(3):
        values = written(order, seed, skin)
        values = values if order.single else np.abs(values)
        found, doubt = likeliest(values)
        assert found is not None
        assert found.words == order.words
        assert not doubt


def test_the_order_of_doubtful_values_is_still_the_likelier_one() -> None:
    """Some injections whose voltages are next to nothing: the likeness falls, of other orders more."""
    order, doubts = next(one for one in orders(208) if "from the driven electrodes on" in one.words), []
    for dead in (0, 1, 2, 3):
        values = np.abs(written(order, 0, "tank"))
        values[:, : 13 * dead] *= 1e-3
        found, doubt = likeliest(values)
        assert found is not None
        assert found.words == order.words
        doubts.append(bool(doubt))
    assert doubts[0] is False
    assert doubts[-1] is True


def test_values_that_are_not_of_adjacent_drive_are_doubted() -> None:
    found, doubt = likeliest(np.random.default_rng(0).normal(size=(4, 208)))
    assert found is orders(208)[0] or found is not None
    assert "is it adjacent drive?" in doubt
    assert likeliest(np.ones((2, 17))) == (None, "")


def test_columns_and_arrays_by_other_names_are_read_with_notes(tmp_path: Path) -> None:
    order = orders(208)[1]
    rest = written(order, 0, "paper-rim16")[0]
    random = np.random.default_rng(1)
    presses = rest * (1 + 0.01 * random.standard_normal((12, 208)))
    places = random.uniform(-80, 80, (12, 2))
    lines = ["time,pos_x [mm],pos_y [mm],z_mm,Fz (N)," + ",".join(f"ch{k}" for k in range(208))]
    lines += [
        f"{k},{x},{y},0,1.5," + ",".join(map(repr, row.tolist()))
        for k, ((x, y), row) in enumerate(zip(places, presses, strict=True))
    ]
    (tmp_path / "presses.csv").write_text("# skin = paper-rim16\n" + "\n".join(lines) + "\n")
    table = read_recording(tmp_path / "presses.csv")
    savemat(tmp_path / "presses.mat", {"V": presses.T, "pos": places.T, "Fz": np.full(12, 1.5), "skin": "paper-rim16"})
    for found, note in (
        (table, "columns 'time', 'z_mm' are left out"),
        (read_recording(tmp_path / "presses.mat"), "'V' is interpreted as voltages"),
    ):
        np.testing.assert_allclose(found.positions, 1e-3 * places)
        np.testing.assert_allclose(found.forces, 1.5)
        assert note in found.notes
        assert any(order.words in one for one in found.notes)
        np.testing.assert_array_equal(found.frames[0].pattern.quadruples[20], order.quadruples[20])
        resolved(found, Skin.load("paper-rim16").transfer_model())
    assert any("interpreted as millimetres" in one for one in found.notes)
