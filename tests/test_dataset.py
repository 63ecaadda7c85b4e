"""Data sets: the same whoever makes them, resumable, and true to the twin."""

import multiprocessing
import os
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zarr
from command_line import ohmskin
from waiting import until

from ohmskin import Skin
from ohmskin.dataset import SPLITS, Recipe, TouchData, generate
from ohmskin.dataset.generate import CHUNK
from ohmskin.errors import DataError
from ohmskin.skin import VirtualSkin

PAPER = Skin.load("paper")
RECIPE = Recipe(PAPER.dump(), pattern="12B", seed=5)


def arrays(path: Path) -> dict[str, np.ndarray]:
    group: Any = zarr.open_group(str(path), mode="r")
    return {name: np.asarray(group[name][:]) for name in ("voltages", "currents", "contacts", "count", "truth")}


def test_number_of_workers_changes_nothing(tmp_path: Path) -> None:
    count = 2 * CHUNK + 40
    assert generate(tmp_path / "one", RECIPE, count, jobs=1) == count
    assert generate(tmp_path / "two", RECIPE, count, jobs=2) == count
    one, two = arrays(tmp_path / "one"), arrays(tmp_path / "two")
    for name, values in one.items():
        np.testing.assert_array_equal(values, two[name], err_msg=name)
    assert np.isfinite(one["voltages"]).all()
    assert set(one["count"]) == {0, 1, 2, 3}
    other = replace(RECIPE, seed=6).simulate(0, 4)
    assert not np.isclose(other["voltages"], one["voltages"][:4]).all(axis=1).any()


def test_samples_do_not_depend_on_their_neighbours() -> None:
    together = RECIPE.simulate(100, 12)
    for name, values in RECIPE.simulate(107, 1).items():
        np.testing.assert_array_equal(values[0], together[name][7], err_msg=name)


def test_stopped_run_goes_on_and_a_data_set_grows(tmp_path: Path) -> None:
    path, count = tmp_path / "set", 2 * CHUNK

    def stop(done: int, total: int) -> None:
        if done >= CHUNK:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate(path, RECIPE, count, jobs=1, progress=stop)
    calls: list[tuple[int, int]] = []
    assert generate(path, RECIPE, count, jobs=1, progress=lambda *call: calls.append(call)) == CHUNK
    assert calls[0] == (CHUNK, count)
    assert calls[-1] == (count, count)
    assert generate(path, RECIPE, count, jobs=1) == 0
    assert generate(path, RECIPE, count + 10, jobs=1) == 10
    assert generate(path, RECIPE, CHUNK, jobs=1) == 0  # never smaller
    generate(tmp_path / "whole", RECIPE, count + 10, jobs=1)
    resumed, whole = arrays(path), arrays(tmp_path / "whole")
    for name, values in whole.items():
        np.testing.assert_array_equal(resumed[name], values, err_msg=name)


def test_a_run_that_was_stopped_while_the_arrays_grew_goes_on(tmp_path: Path) -> None:
    generate(tmp_path / "set", RECIPE, 8, jobs=1)
    group: Any = zarr.open_group(str(tmp_path / "set"), mode="r+")
    for name in ("voltages", "currents", "contacts", "count"):
        group[name].resize((CHUNK + 4, *group[name].shape[1:]))
    assert generate(tmp_path / "set", RECIPE, CHUNK + 4, jobs=1) == CHUNK + 4
    assert all(len(values) == CHUNK + 4 for values in arrays(tmp_path / "set").values())


def test_samples_are_what_the_twin_shows() -> None:
    recipe = replace(RECIPE, pattern="complete", contacts=(1, 1))
    sample = recipe.simulate(3, 1)
    x, y, radius, pressure = (float(v) for v in sample["contacts"][0, 0])
    twin = VirtualSkin(PAPER, 0, contacts=4)
    quiet = np.mean([twin.scan(recipe.drive_pattern).voltages for _ in range(20)], axis=0)
    twin.press(0, x, y, radius, pressure)
    change = np.mean([twin.scan(recipe.drive_pattern).voltages for _ in range(20)], axis=0) - quiet
    noise = PAPER.converter.noise
    np.testing.assert_allclose(sample["voltages"][0] - quiet, change, atol=6 * noise)
    assert np.abs(change).max() > 30 * noise
    assert sample["truth"].max() == pytest.approx(pressure, rel=1e-6)
    ny, nx = np.unravel_index(np.argmax(sample["truth"][0]), sample["truth"][0].shape)
    assert np.hypot((nx + 0.5) * 0.2 / 32 - x, (ny + 0.5) * 0.2 / 32 - y) < radius + 0.01
    np.testing.assert_allclose(recipe.quiet().mean(axis=0), quiet, atol=4 * noise)


def test_contacts_keep_their_distance_and_stay_in_range() -> None:
    for index in range(300):
        presses = RECIPE.presses(index)
        for k, press in enumerate(presses):
            assert 4e-3 <= press.radius <= 15e-3
            assert 1e3 <= press.pressure <= 60e3
            assert min(press.position) >= 0
            assert max(press.position) <= 0.2
            for other in presses[:k]:
                assert np.hypot(*np.subtract(press.position, other.position)) >= press.radius + other.radius + 5e-3
    pressures = [p.pressure for i in range(300) for p in RECIPE.presses(i)]
    assert np.median(pressures) == pytest.approx(np.sqrt(1e3 * 60e3), rel=0.25)  # even in the logarithm


def test_another_recipe_or_folder_is_refused_and_loses_nothing(tmp_path: Path) -> None:
    generate(tmp_path / "set", RECIPE, 8, jobs=1)
    before = arrays(tmp_path / "set")
    with pytest.raises(DataError, match="another recipe: seed 5, not 6"):
        generate(tmp_path / "set", replace(RECIPE, seed=6), 8, jobs=1)
    np.testing.assert_array_equal(arrays(tmp_path / "set")["voltages"], before["voltages"])
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("precious")
    with pytest.raises(DataError, match="not a data set"):
        generate(tmp_path / "mine", RECIPE, 8, jobs=1)
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "precious"


@pytest.mark.parametrize(
    "change",
    [
        {"pattern": "99X"},
        {"contacts": (2, 1)},
        {"contacts": (0, 17)},
        {"radius": (0.0, 0.01)},
        {"pressure": (1e3, np.nan)},
        {"gap": -1.0},
        {"pixels": 1},
        {"seed": -1},
    ],
)
def test_recipe_out_of_range_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(DataError):
        replace(RECIPE, **change)


def test_tasks_in_flight_are_bounded() -> None:
    from ohmskin.evaluate import runner

    started = 0

    def tasks() -> list[Any]:
        return [SimpleNamespace(run=os.getpid) for _ in range(40)]

    class Counted(list):  # the runner takes tasks from its iterator only as it hands them out
        def __iter__(self) -> Any:
            nonlocal started
            for task in super().__iter__():
                started += 1
                yield task

    results = runner.spread(Counted(tasks()), 2)
    next(results)
    assert started <= 2 * runner._AHEAD
    assert 1 + sum(1 for _ in results) == 40


def test_what_runs_is_stopped_once_nobody_waits_for_it() -> None:
    from ohmskin.evaluate import runner

    results = runner.spread([SimpleNamespace(run=run) for run in (os.getpid, partial(time.sleep, 600))], 2)
    next(results)
    results.close()
    until(lambda: not multiprocessing.active_children())


def test_command_line(tmp_path: Path) -> None:
    path = str(tmp_path / "touches.zarr")
    first = ohmskin("dataset", path, "--count", "20", "--pattern", "12B", "--jobs", "1", "--contacts", "1", "2")
    assert first.returncode == 0, first.stderr
    assert "20 samples made" in first.stdout
    assert set(arrays(Path(path))["count"]) == {1, 2}
    wrong = ohmskin("dataset", path, "--count", "20", "--pattern", "12B", "--seed", "3", "--contacts", "1", "2")
    assert wrong.returncode == 2
    assert wrong.stderr.count("\n") == 1
    assert "another recipe" in wrong.stderr


def test_it_opens_by_name_and_keeps_its_splits_while_it_grows(tmp_path: Path) -> None:
    path = tmp_path / "touches.zarr"
    generate(path, RECIPE, 20, jobs=1)
    group = zarr.open_group(str(path), mode="r")
    for name, one in group.arrays():
        assert one.metadata.dimension_names is not None, name  # as xarray needs them
        assert len(one.metadata.dimension_names) == one.ndim
    assert group["truth"].metadata.dimension_names == ("sample", "y", "x")
    assert len(group["x"][:]) == group["truth"].shape[2]
    before = {name: TouchData(path, name) for name in SPLITS}
    assert sorted(np.concatenate([one.numbers for one in before.values()])) == list(range(20))
    generate(path, RECIPE, 30, jobs=1)
    for name, one in before.items():
        after = TouchData(path, name)
        assert set(one.numbers) <= set(after.numbers)
        np.testing.assert_array_equal(one[0]["voltages"], after[0]["voltages"])
    everything = TouchData(path)
    assert len(everything) == 30
    np.testing.assert_array_equal(everything[7]["contacts"], group["contacts"][7])
    text = (tmp_path / "touches.zarr.md").read_text()
    assert group.attrs["card"] == text
    assert f"{len(RECIPE.drive_pattern.quadruples)} voltages" in text
    assert "Limits" in text


def test_batches_hold_each_sample_of_a_split_once(tmp_path: Path) -> None:
    path = tmp_path / "touches.zarr"
    generate(path, RECIPE, 25, jobs=1)
    train = TouchData(path, "train")
    whole = np.array([train[k]["voltages"] for k in range(len(train))])
    for seed in (None, 3):
        batches = list(train.batches(8, seed))
        assert [len(batch["count"]) for batch in batches[:-1]] == [8] * (len(batches) - 1)
        found = np.concatenate([batch["voltages"] for batch in batches])
        assert {row.tobytes() for row in found} == {row.tobytes() for row in whole}
        assert len(found) == len(whole)


def test_what_is_no_data_set_or_split_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="not a data set"):
        TouchData(tmp_path)
    generate(tmp_path / "touches.zarr", RECIPE, 3, jobs=1)
    with pytest.raises(DataError, match="choose from train, validation, test"):
        TouchData(tmp_path / "touches.zarr", "dev")
    for size in (0, 2.5):
        with pytest.raises(DataError, match=rf"batches of {size} samples; choose a whole number, 1 or more"):
            next(TouchData(tmp_path / "touches.zarr").batches(size))
