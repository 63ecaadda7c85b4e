"""Other people's measurements: targets of a real tank where they were, and clear errors for what is no recording."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ohmskin.contacts import ContactFinder
from ohmskin.errors import DataError
from ohmskin.importers import eidors, read_recording
from ohmskin.inverse import GaussNewton
from ohmskin.scan import Baseline, adjacent
from ohmskin.skin import Skin

DATA = Path(__file__).parents[2] / "shared" / "data" / "tank_pyeidors"
FILES = sorted(DATA.glob("*/*.csv"))
needs_data = pytest.mark.skipif(not FILES, reason=f"the tank measurements of PyEIDORS are not at {DATA}")


def truth(folder: str) -> dict[int, int]:
    """Electrode (from 1) and sign of each target, from the name of the folder."""
    words = folder.removeprefix("electrode").split("_electrode")
    return {int(word[:2]): {"metal": 1, "plastic": -1}[word[3:]] for word in words}


@needs_data
@pytest.mark.parametrize(
    "path", FILES, ids=[path.parent.name.replace("electrode", "") + path.stem[10:19] for path in FILES]
)
def test_targets_of_a_real_tank_are_at_their_electrodes_with_their_sign(path: Path) -> None:
    recording = read_recording(path)
    skin = Skin.load(recording.skin)
    baseline = Baseline.learn(recording.quiet)
    model = skin.transfer_model()
    quiet = recording.quiet[0]
    measured, modelled = baseline.reference(quiet.pattern), model.voltages(quiet.pattern)
    assert np.corrcoef(measured, modelled)[0, 1] > 0.99  # the orientation of drive and voltage, and their order
    scale = float(modelled @ modelled / (modelled @ measured))
    assert 0.9 < scale < 1.3  # the shipped conductivity is that of this tank; at 20 uA it was measured 20 % higher
    imaging = skin.imaging
    estimator = GaussNewton(
        model.scaled(scale), baseline.noise, amplitude=imaging.amplitude, model_error=imaging.model_error
    )
    image = estimator.reconstruct(baseline.difference(recording.frames[0]))
    contacts = ContactFinder(0.05, imaging.fraction, imaging.dip, imaging.bipolar).find(image, model.mesh)

    found = {}
    for contact in contacts:
        electrode = np.degrees(np.arctan2(contact.position[1], contact.position[0])) / 22.5 + 1
        nearest = min(truth(path.parent.name), key=lambda k: abs((electrode - k + 8) % 16 - 8))
        assert abs((electrode - nearest + 8) % 16 - 8) < 0.5, (electrode, nearest)
        assert nearest not in found
        assert 0.012 < np.hypot(*contact.position) < 0.03  # close to the rim
        found[nearest] = int(np.sign(contact.peak))
    assert found == truth(path.parent.name)


@needs_data
def test_the_reciprocity_error_of_the_tank_is_a_few_per_cent() -> None:
    for path in FILES:
        quiet = read_recording(path).quiet[0]
        ratio = Baseline.learn([quiet]).noise / np.sqrt(np.mean(quiet.voltages**2))
        assert 0.005 < ratio < 0.03


def table(n: int = 208) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(n, 4))


def written(path: Path, rows: np.ndarray) -> Path:
    path.write_text("\n".join(",".join(repr(float(v)) for v in row) for row in rows))
    return path


@pytest.mark.parametrize(("n_rows", "n_elec"), [(4, 4), (10, 5), (108, 12), (208, 16), (928, 32)])
def test_columns_are_reference_and_target_of_adjacent_drive_from_k_plus_1_to_k(
    tmp_path: Path, n_rows: int, n_elec: int
) -> None:
    rows = table(n_rows)
    recording = read_recording(written(tmp_path / "a_1_10.00_55.5uA_1000Hz.csv", rows))
    (quiet,), (frame,) = recording.quiet, recording.frames
    np.testing.assert_array_equal(quiet.voltages, rows[:, 0])
    np.testing.assert_array_equal(frame.voltages, rows[:, 2])
    assert frame.pattern.injections.tolist() == [[(k + 1) % n_elec, k] for k in range(n_elec)]
    np.testing.assert_array_equal(frame.pattern.measurements, adjacent([range(n_elec)]).measurements)
    np.testing.assert_allclose(frame.currents, 55.5e-6)
    assert recording.skin in ("tank",)


def test_a_name_without_a_current_means_one_ampere(tmp_path: Path) -> None:
    for name in ("plain.csv", "a_1.2.3uA_b.csv", "a_.uA_b.csv"):
        assert (read_recording(written(tmp_path / name, table())).frames[0].currents == 1).all()


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "", "is empty; a recording has a row per measurement"),
        ("a.csv", "1,2,3,4\n" * 207, r"207 rows; adjacent data of n electrodes have n \(n - 3\), such as 208"),
        ("a.csv", "1,2,3,4\n" * 207 + "1,2,3\n", "row 208: 3 columns; the first row has 4"),
        ("a.csv", "1,2,3,4,5\n" * 208, "5 columns and no pattern"),
        ("a.csv", "Re,Im,Re,Im\n" + "1,2,3,4\n" * 208, "two columns have the same name"),
        ("a.csv", "1,2,x,4\n" * 208, "'x'; every entry must be a number"),
        ("a_0uA_.csv", "1,2,3,4\n" * 208, "no current"),
    ],
)
def test_a_malformed_table_is_refused_with_its_place(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(DataError, match=message) as caught:
        read_recording(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)


def test_what_cannot_be_read_at_all_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot read recording"):
        read_recording(tmp_path / "absent.csv")
    with pytest.raises(DataError, match="cannot read recording"):
        read_recording(tmp_path)
    with (tmp_path / "huge.csv").open("wb") as file:
        file.truncate(65 * 2**20)
    with pytest.raises(DataError, match="at most 67108864"):
        read_recording(tmp_path / "huge.csv")


@given(st.one_of(st.binary(max_size=300), st.text("0123456789.,-e\"'\n\r\0 naif_+", max_size=300).map(str.encode)))
@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_are_a_recording_or_a_clear_error(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "any.csv"
    path.write_bytes(data)
    try:
        outcome = read_recording(path)
    except DataError as error:
        outcome = error
    if isinstance(outcome, DataError):
        assert str(path) in str(outcome)
    else:
        assert outcome.frames[0].voltages.shape == outcome.quiet[0].voltages.shape


def test_a_current_in_the_table_holds_for_the_pattern_beside_it(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("# current = 55e-6\n0.1,0.11\n0.2,0.21\n")
    (tmp_path / "a.pattern.csv").write_text("source,sink,plus,minus\n0,1,2,3\n1,2,3,0\n")
    assert read_recording(tmp_path / "a.csv").frames[0].currents.tolist() == [55e-6, 55e-6]


def test_each_stimulation_has_its_own_unit_and_there_is_at_least_one_frame() -> None:
    def stimulation(a: int, unit: str) -> dict[str, object]:
        drive, measure = np.zeros((5, 1)), np.zeros((1, 5))
        drive[[a, a + 1], 0] = measure[0, [(a + 2) % 5, (a + 3) % 5]] = 1, -1
        return {"stim_pattern": drive, "meas_pattern": measure, "stimulation": unit}

    data = {
        "fmdl": [{"stimulation": [stimulation(0, "mA"), stimulation(1, "Amp")]}],
        "vh": np.ones((2, 1)),
        "vi": np.ones((2, 1)),
    }
    _, (frame,), *_ = eidors.read(data, "a.mat", False)
    assert frame.currents.tolist() == [1e-3, 1.0]
    with pytest.raises(DataError, match="vi has no frames"):
        eidors.read(data | {"vi": np.ones((2, 0))}, "a.mat", False)
