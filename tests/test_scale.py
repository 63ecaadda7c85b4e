"""What must not grow too fast with the size of a problem: what is stored.

Sizes are small; the benchmark has the large ones.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from ohmskin.bench import Figure, run
from ohmskin.bench.clock import in_turns, ratio, read
from ohmskin.bench.report import last_seconds, write_report
from ohmskin.bench.sheets import CONDUCTIVITY, electrodes, grid, mesh, square
from ohmskin.drive import DRIVES, DriveSettings
from ohmskin.errors import OhmskinError
from ohmskin.forward import TransferModel
from ohmskin.forward.assembly import assemble
from ohmskin.inverse import GaussNewton, Pixels
from ohmskin.inverse.modes import ImageModes
from ohmskin.scan import Difference, adjacent
from ohmskin.sensing import CompiledCycle


def test_a_factor_grows_little_faster_than_the_mesh() -> None:
    kept = []
    for cells in (24, 96):
        system = assemble(mesh(cells), electrodes(), np.full(2 * cells**2, CONDUCTIVITY))
        kept.append(system.elimination().factor_start[-1] / system.matrix.shape[0])
    assert kept[1] < 2.2 * kept[0]  # per unknown: log n; a band matrix would have four times as much


def test_an_image_at_low_noise_factors_no_sensitivity_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    where, layout = mesh(24), electrodes()
    estimator = GaussNewton(TransferModel(where, layout, CONDUCTIVITY), 1e-9, pixels=Pixels.over(where, 16))
    monkeypatch.delattr(ImageModes, "of_relative")
    pattern = adjacent(layout.rings)
    volts = 1e-5 * np.random.default_rng(0).normal(size=pattern.n_meas)
    assert np.isfinite(estimator.reconstruct(Difference(pattern, np.full(pattern.n_meas, 1e-3), volts)).values).all()


def test_a_measured_set_up_loads_nothing_that_draws() -> None:
    """Its memory is compared with pyEIT's."""
    code = "import sys, ohmskin.bench.tasks; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_with_many_electrodes_nothing_has_pairs_times_pairs() -> None:
    """64 electrodes, 2016 pairs, 256 pixels: as many modes as pixels, and the same image as from the pairs' own
    covariance."""
    where, layout = mesh(42), electrodes(8)
    model, pixels = TransferModel(where, layout, CONDUCTIVITY), Pixels.over(where, 16)
    estimator = GaussNewton(model, 1e-5, amplitude=0.1, pixels=pixels)
    assert estimator.modes.n_modes == 256
    assert "pair_sensitivity" not in model.__dict__
    drive = DRIVES["eq7"](DriveSettings(layout, pairs=2), 0)
    cycle = CompiledCycle(estimator, drive, (0.01, 0.01))
    raised = np.where(np.linalg.norm(where.centroids - [0.06, 0.13], axis=1) < 0.012, 1.5, 1.0)
    pressed = model.with_conductivity(model.conductivity * raised)
    base = pressed.voltages(drive.base, 1e-3) - model.voltages(drive.base, 1e-3)
    chosen = cycle.base_step(base, np.full(drive.base.n_inj, 1e-3))
    pattern = cycle.pattern(chosen)
    volts = pressed.voltages(pattern, 1e-3) - model.voltages(pattern, 1e-3)
    contacts = cycle.second_step(volts, np.full(pattern.n_inj, 1e-3))
    assert len(contacts) == 1
    assert np.hypot(contacts[0].position[0] - 0.06, contacts[0].position[1] - 0.13) < 0.006
    # the textbook, in pixels
    both = np.vstack([p.combination(64) @ estimator.relative() * 1e-3 for p in (drive.base, pattern)])
    normal = both.T @ both + (1e-5 / 0.1) ** 2 * estimator.penalty.normalised.toarray()
    exact = np.linalg.solve(normal, both.T @ np.concatenate([base, volts]))
    assert_allclose(cycle.image, exact, rtol=0, atol=5e-5 * np.abs(exact).max())


def test_a_large_second_scan_gives_the_image_of_the_normal_equations() -> None:
    model = TransferModel(mesh(24), electrodes(), CONDUCTIVITY)
    estimator = GaussNewton(model, 1e-5, amplitude=0.1, pixels=Pixels.over(model.mesh, 16))
    drive = DRIVES["eq7"](DriveSettings(model.electrodes, pairs=20), 0)  # 260 measurements
    cycle = CompiledCycle(estimator, drive, (0.01, 0.01))
    rng = np.random.default_rng(0)
    base, second = rng.normal(size=drive.base.n_meas) * 1e-4, rng.normal(size=260) * 1e-4
    pattern = cycle.pattern(cycle.base_step(base, np.full(12, 1e-3)))
    cycle.second_step(second, np.full(20, 1e-3))
    rows = np.vstack([estimator.modes.rows(p) * 1e-3 for p in (drive.base, pattern)])
    normal = rows.T @ rows + 1e-8 * np.eye(rows.shape[1])
    exact = np.linalg.solve(normal, rows.T @ np.concatenate([base, second])) @ estimator.modes.modes
    assert_allclose(cycle.image, exact, rtol=0, atol=5e-5 * np.abs(exact).max())


# --- the benchmark ----------------------------------------------------------------------------------------------------


def test_the_sheets_are_those_of_the_paper() -> None:
    nodes, triangles = grid(6)
    assert len(nodes) == 49
    assert mesh(6).measures.sum() == pytest.approx(0.04)
    assert len(mesh(6).nodes_at(electrodes().positions)) == 16
    inside = mesh(6).centroids[square(6, 2, 3, 2)]
    assert len(inside) == 8
    assert_allclose([inside.min(axis=0), inside.max(axis=0)], np.array([[2, 3], [4, 5]]) / 30, atol=0.2 / 6)
    assert triangles.shape == (72, 3)


def test_a_figure_says_whether_it_meets_its_target() -> None:
    assert Figure("a", 3.0, "times", least=2).verdict == "pass"
    assert Figure("a", 1.9, "times", least=2).verdict == "short"
    assert Figure("a", 1.2, "times", most=1.2).verdict == "pass"
    assert Figure("a", 1.3, "times", most=1.2).verdict == "short"
    assert Figure("a", None, "times", most=1.2).verdict == "not run"
    assert Figure("a", 1.3, "GB/s").verdict == ""


def test_ratios_are_medians_over_turns() -> None:
    told = ratio("a", np.array([2.0, 8.0, 9.0]), np.array([1.0, 2.0, 1.0]), least=3)
    assert (told.value, told.low, told.high, told.verdict) == (4.0, 3.0, 6.5, "pass")
    order: list[str] = []
    spent = in_turns({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, 0.0, least=2)
    assert {len(times) for times in spent.values()} == {2}
    assert order[-1] == "b"
    assert read(np.arange(5, dtype=np.float32)) == 10


def test_a_run_writes_what_it_measured(tmp_path) -> None:  # type: ignore[no-untyped-def]
    seen: list[tuple[str, str]] = []
    found = dict(run(quick=True, only=("accuracy",), report=lambda *told: seen.append(told)))
    assert seen == [("accuracy", ""), ("accuracy", found["accuracy"][0].name)]
    assert found["accuracy"][0].verdict == "pass"
    found["scale"] = [Figure("growth", 1.1, "power of n", most=1.2, data={
        "triangles": [2_000, 10_000, 100_000], "seconds": [0.01, 0.03, 0.4],
        "stages": [dict.fromkeys(("check mesh", "fields", "pixels", "modes"), s) for s in (1e-3, 1e-2, 1e-1)],
    })]  # fmt: skip
    paths = write_report(found, tmp_path / "out", quick=True)
    assert {path.name for path in paths} == {"benchmarks.json", "benchmarks.md", "benchmarks.html", "scale.png"}
    page = (tmp_path / "out" / "benchmarks.md").read_text()
    assert "2 targets met, 0 short" in page
    assert "| growth | 1.1 power of n |" in page
    with pytest.raises(OhmskinError, match="choose from machine"):
        run(only=("none",))
    (tmp_path / "file").write_text("")
    with pytest.raises(OhmskinError, match="--output"):
        write_report(found, tmp_path / "file", quick=True)


def test_a_start_is_measured_to_the_first_contact() -> None:
    ((*commands, contact),) = dict(run(quick=True, only=("start",))).values()
    assert [figure.unit for figure in (*commands, contact)] == ["s"] * 3
    assert contact.name == "`ohmskin live` to the first contact, as this machine is"
    assert contact.value is not None
    assert contact.value > max(figure.value for figure in commands)  # which import less, and sense nothing


def test_a_killed_benchmark_keeps_the_parts_it_measured(tmp_path: Path) -> None:
    code = """if True:
        import os, sys
        from pathlib import Path
        from ohmskin.bench import GROUPS, Figure
        from ohmskin.cli.bench import bench
        GROUPS["machine"] = lambda effort: iter([Figure("reading", 1.0, "GB/s", least=0.5)])
        GROUPS["setup"] = lambda effort: os.kill(os.getpid(), 9)
        bench(output=Path(sys.argv[1]), only=("machine", "setup", "fields"))
        """
    done = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == -9, done.stderr
    assert "setup: part 2 of 3\n" in done.stdout
    kept = json.loads((tmp_path / "benchmarks.json").read_text())
    assert list(kept["groups"]) == ["machine"]
    assert kept["missing"] == ["setup", "fields"]
    for name in ("benchmarks.html", "benchmarks.md"):
        assert "1 targets met, 0 short, 0 not run; not measured yet: setup, fields." in (tmp_path / name).read_text()
    assert last_seconds(tmp_path, quick=False)["machine"] < 10
    assert last_seconds(tmp_path, quick=True) == {}
