"""Nonsense is refused in words, values stay what they are, and what is read in is not changed without a note."""

import json
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from direct import DirectDevice
from recordings import Bench

import ohmskin as ohm
from ohmskin.device import Capabilities
from ohmskin.errors import (
    DataError,
    DeviceLost,
    GeometryError,
    ModelError,
    OhmskinError,
    PatternError,
    ProtocolError,
    SkinError,
)
from ohmskin.forward import drive_currents, drive_voltages
from ohmskin.importers.pattern import from_list
from ohmskin.inverse import Pixels
from ohmskin.mcap import RecordingReader, recover
from ohmskin.plot import save_picture
from ohmskin.recording import Recorder
from ohmskin.scan import measure_others

SHEET = ohm.Rectangle(0.2, 0.2)
GRID = ohm.Electrodes.grid(SHEET)
PATTERN = ohm.adjacent(GRID.rings)
CURRENTS = np.full(PATTERN.n_inj, 1e-3)
COMPLEX = 1 + 1j


@cache
def model() -> ohm.TransferModel:
    return ohm.TransferModel(ohm.mesh_domain(SHEET, 0.02, GRID.positions), GRID, 1.83e-3)


@cache
def touch() -> ohm.Difference:
    inside = np.linalg.norm(model().mesh.centroids - (0.06, 0.13), axis=1) < 0.02
    touched = model().with_conductivity(1.83e-3 * (1 + 0.5 * inside))
    volts = touched.voltages(PATTERN, 1e-3) - model().voltages(PATTERN, 1e-3)
    return ohm.Difference(PATTERN, np.full(PATTERN.n_meas, 1e-3), volts)


@pytest.mark.parametrize(
    "use",
    [
        lambda: ohm.TransferModel(model().mesh, GRID, 1.83e-3 * COMPLEX),
        lambda: model().with_conductivity(1.83e-3 * COMPLEX),
        lambda: model().voltages(PATTERN, COMPLEX),
        lambda: model().sensitivity(PATTERN, COMPLEX * CURRENTS),
        lambda: ohm.Frame(PATTERN, COMPLEX * touch().volts, CURRENTS),
        lambda: ohm.Frame(PATTERN, touch().volts, COMPLEX * CURRENTS),
        lambda: ohm.Difference(PATTERN, touch().currents, COMPLEX * touch().volts),
        lambda: ohm.Difference(PATTERN, touch().currents, touch().volts, reference=COMPLEX * touch().volts),
        lambda: ohm.Mesh(COMPLEX * model().mesh.nodes, model().mesh.elements),
        lambda: ohm.Electrodes(COMPLEX * GRID.positions, GRID.rings),
        lambda: GRID.with_discs(1e-3, COMPLEX),
        lambda: GRID.with_discs(1e-3, 1.0).with_contact_impedances(COMPLEX),
        lambda: drive_currents(model(), COMPLEX * np.diff(np.eye(16), axis=0)),
        lambda: drive_voltages(model(), COMPLEX * np.eye(16)),
        lambda: ohm.GaussNewton(model(), noise=COMPLEX),
    ],
)
def test_complex_values_are_refused_and_not_made_real(use: Callable[[], object]) -> None:
    with pytest.raises(OhmskinError, match="complex; only resistive skins are modelled"):
        use()


FLAT = np.array([[0, 0], [1, 0], [0.5, 1], [0.5, 0.6]], float)


@pytest.mark.parametrize(
    ("use", "error", "message"),
    [
        (lambda: ohm.adjacent(16), PatternError, r"given as 16; give lists of electrode numbers.*\[range\(16\)\]"),
        (lambda: ohm.adjacent(range(16)), PatternError, r"given as range\(0, 16\); give lists"),
        (lambda: ohm.skip([[0.5, 1, 2, 3, 4]], 2), PatternError, r"given as \[\[0.5, 1"),
        (lambda: ohm.opposite(16), PatternError, "given as 16"),
        (lambda: measure_others([(0, 1)], 16), PatternError, "given as 16"),
        (lambda: model().voltages(PATTERN, np.nan), ModelError, "a current is not finite"),
        (lambda: model().sensitivity(PATTERN, np.append(CURRENTS[1:], np.inf)), ModelError, "a current is not finite"),
        (lambda: model().voltages(PATTERN, CURRENTS[1:]), ModelError, r"shape \(15,\); give one value or \(16,\)"),
        (lambda: model().voltages(PATTERN, "a"), ModelError, "currents are of type str; give real numbers"),
        (lambda: ohm.GaussNewton(model(), np.float64(0)), ModelError, "noise is 0.0; it must be finite and positive"),
        (lambda: ohm.GaussNewton(model(), None), ModelError, "noise is nan; it must|noise is of type NoneType"),
        (lambda: ohm.Difference(PATTERN, 1e-3, touch().volts), DataError, r"currents of .* shape \(\); .*\(208,\)"),
        (lambda: ohm.Difference(PATTERN, touch().currents, [1.0]), DataError, r"volts of a difference have shape \(1,"),
        (
            lambda: ohm.Difference(PATTERN, touch().currents, touch().volts, np.ones(3)),
            DataError,
            "source_loading of a difference have shape",
        ),
        (
            lambda: ohm.Mesh(FLAT, np.array([[0, 1, 2], [0, 1, 3]])),
            GeometryError,
            "folded: triangles 0 and 1 lie on the same side of their edge",
        ),
        (
            lambda: ohm.Mesh(
                np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 1], [0.3, 0.3, 0.5]]),
                np.array([[0, 1, 2, 3], [0, 1, 2, 4]]),
            ),
            GeometryError,
            "folded: tetrahedra 0 and 1 lie on the same side of their face",
        ),
    ],
)
def test_mistakes_give_one_clear_error(use: Callable[[], object], error: type[OhmskinError], message: str) -> None:
    with pytest.raises(error, match=message):
        use()


def test_a_list_is_as_good_as_an_array_and_a_simulated_frame_needs_no_clock() -> None:
    difference = ohm.Difference(PATTERN, touch().currents.tolist(), touch().volts.tolist())
    image, same = (ohm.GaussNewton(model(), 1e-5).reconstruct(d).values for d in (difference, touch()))
    np.testing.assert_array_equal(image, same)
    assert ohm.Frame(PATTERN, touch().volts, CURRENTS).time == 0


def test_discs_and_points_on_a_stretch_of_the_rim_are_refused() -> None:
    """Electrode 1 is a stretch of 20 mm about (67, 0) mm; electrode 12, a point or a disc of 3 mm, comes near it."""

    def skin(place: tuple[float, float], disc: bool) -> ohm.TransferModel:
        places = GRID.positions.copy()
        places[12] = place
        layout = ohm.Electrodes(places, GRID.rings).with_rim_segments(0.02, 1e-3, [1])
        mesh = ohm.mesh_domain(SHEET, 0.01, places)
        return ohm.TransferModel(mesh, layout.with_discs(0.003, 1e-4, [12]) if disc else layout, 1.83e-3)

    x = float(GRID.positions[1, 0])
    for place, disc in (
        ((x + 0.008, 0.0), True),
        ((x + 0.012, 0.0), True),
        ((x, 0.0025), True),
        ((x + 0.008, 0), False),
    ):
        kind = "disc" if disc else "point"
        with pytest.raises(
            GeometryError, match=rf"electrode 12 \({kind}\) lies on electrode 1|electrodes 1 and 12 overlap"
        ):
            skin(place, disc)
    for place, disc in (((x + 0.0135, 0.0), True), ((x, 0.0035), True), ((x + 0.012, 0.0), False)):
        skin(place, disc)


def arrays(something: object) -> dict[str, np.ndarray]:
    return {name: value for name, value in vars(something).items() if isinstance(value, np.ndarray)}


@pytest.mark.parametrize("copy", [lambda kept: kept, lambda kept: pickle.loads(pickle.dumps(kept))])
def test_arrays_of_models_meshes_electrodes_and_patterns_cannot_be_written(copy: Callable[[Any], Any]) -> None:
    whole = model().with_conductivity(2e-3)
    for name in ("pair_sensitivity", "pair_resistances", "pair_contact_sensitivity", "transfer_resistance"):
        assert getattr(whole, name).size
    for changed in (whole, whole.scaled(2.0)):
        kept = copy(changed)
        assert len(arrays(kept)) >= 4
        assert not any(array.flags.writeable for array in arrays(kept).values())
    for kept, names in ((model().mesh, ("nodes", "elements")), (GRID, ("positions",)), (PATTERN, ("injections",))):
        assert not any(getattr(copy(kept), name).flags.writeable for name in names)


ESTIMATORS = ["GaussNewton", "Kalman", "Greit", "SparseBayes", "TotalVariation", "AbsoluteGaussNewton"]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_an_image_goes_through_a_pickle_and_its_estimator_has_a_name(name: str) -> None:
    estimator = getattr(ohm, name)(model(), 1e-5)
    assert repr(estimator).startswith(f"{name}(model=TransferModel(Mesh({model().mesh.n_elem} triangles, ")
    assert len(repr(estimator)) < 400
    image = estimator.reconstruct(touch())
    there = pickle.loads(pickle.dumps(image))
    np.testing.assert_array_equal(there.values, image.values)
    np.testing.assert_allclose(there.noise_std([3, 5]), image.noise_std([3, 5]))
    np.testing.assert_allclose(there.contrast_std(7), image.contrast_std(7))
    assert len(pickle.dumps(image)) < 20 * model().mesh.n_elem + 2000


@pytest.mark.parametrize("mode", ["16O", "16P", "16T", "12B"])
def test_whatever_a_loop_gives_goes_through_a_pickle(mode: str) -> None:
    """To another process, for instance; what is remembered of it for speed stays here."""
    skin = ohm.Skin.parse("[imaging]\nmesh_size = 12e-3\n")
    with ohm.Engine(lambda: DirectDevice(ohm.VirtualSkin(skin, 1)), skin, mode) as engine:
        engine.calibrate()
        engine.press(0, (0.06, 0.12), 8e-3, 20e3)
        touch = [engine.step() for _ in range(8)][-1]
        assert touch is not None
        there: ohm.Touch = pickle.loads(pickle.dumps(touch))
        assert there.contacts == touch.contacts != ()
        for name in ("image", "base_image"):
            np.testing.assert_array_equal(getattr(there.percept, name).values, getattr(touch.percept, name).values)
        known = pickle.loads(pickle.dumps(engine.known))
        frame = touch.percept.frames[-1]
        assert engine.known is not None
        np.testing.assert_array_equal(known.difference(frame).volts, engine.known.difference(frame).volts)


def test_a_baseline_goes_through_a_pickle() -> None:
    frames = model().simulate(PATTERN, noise=1e-6, count=3)
    baseline = ohm.Baseline.learn(frames)
    baseline.difference(frames[0])
    there = pickle.loads(pickle.dumps(baseline))
    np.testing.assert_array_equal(there.difference(frames[0]).volts, baseline.difference(frames[0]).volts)


def test_values_are_shown_in_a_line() -> None:
    pixels = Pixels.over(model().mesh, 12)
    assert repr(pixels) == "Pixels(144 of 0.0167 m)"
    assert repr(model().mesh).endswith("nodes in 2 dimensions)")


@pytest.mark.parametrize("outline", [None, 0.02])
def test_iterations_have_converged_at_a_minimum_only(outline: float | None) -> None:
    """Voltages of the wrong sign cannot be had with any conductivity: rounds no longer help long before a minimum."""
    estimator = ohm.AbsoluteGaussNewton(model(), 1e-5, amplitude=0.3, outline=outline)
    frame = ohm.Frame(PATTERN, model().voltages(PATTERN, 1e-3) + touch().volts, CURRENTS)
    right, wrong = (estimator.iterate(f) for f in (frame, ohm.Frame(PATTERN, -frame.voltages, CURRENTS)))
    assert right.converged
    assert right.residual < 1
    assert not wrong.converged
    assert wrong.residual > 1000
    assert not ohm.AbsoluteGaussNewton(model(), 1e-5, amplitude=0.3, outline=outline, rounds=1).iterate(frame).converged


def test_every_package_is_there_when_it_is_named() -> None:
    code = "import ohmskin as ohm, sys; assert 'numpy' not in sys.modules; print(len(ohm.inverse.PRIORS) > 3)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "True", done.stderr
    with pytest.raises(AttributeError, match="no attribute 'inverses'"):
        ohm.inverses  # noqa: B018


@pytest.mark.parametrize("nested", [False, True])
def test_importers_say_when_they_drop_imaginary_parts(tmp_path: Path, nested: bool) -> None:
    quads = np.array([[1, 2, 3, 4], [2, 3, 4, 1]])
    volts = np.array([[1.0], [2.0]])
    for data, noted in ((volts, False), (volts * (1 + 0j), False), (volts * (1 + 0.1j), True)):
        given = {"vh": {"meas": volts} if nested else volts, "vi": {"meas": data} if nested else data}
        scipy.io.savemat(tmp_path / "a.mat", {"stim_meas_list": quads, **given})
        recording = ohm.read_recording(tmp_path / "a.mat")
        np.testing.assert_allclose(recording.frames[0].voltages, [1, 2])
        assert ("'vi': imaginary parts are left out" in " ".join(recording.notes)) is noted
    rows = "\n".join("1,0.2,1.1,0" for _ in range(208))
    (tmp_path / "tank_55uA_.csv").write_text(rows)
    assert any("imaginary" in note for note in ohm.read_recording(tmp_path / "tank_55uA_.csv").notes)
    (tmp_path / "tank_55uA_.csv").write_text(rows.replace("0.2", "0"))
    assert not any("imaginary" in note for note in ohm.read_recording(tmp_path / "tank_55uA_.csv").notes)


LONG = "f" * 5000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"[sheet]\nwidth = 0x{LONG}", "sheet.width is a number of thousands of digits; it must be 0.001 to 10 m"),
        (f"name = 0x{LONG}", "name is a number of thousands of digits; it must be text"),
        (f"[sheet]\nshape = 0x{LONG}", "sheet.shape is a number of thousands of digits"),
        (f"sheet = 0x{LONG}", "sheet is a number of thousands of digits; it must be a table"),
        (f"[sheet]\nwidth = 1{'0' * 3000}", r"sheet.width is 1000*\.\.\. \(3001 characters\)"),
        (f'"{LONG}" = 1', r"unknown entry 'f{50,60}\.\.\. "),
        (f'[sheet]\nshape = "{LONG}"', r"sheet.shape is 'f*\.\.\. \(5002 characters\)"),
    ],
)
def test_numbers_and_names_of_thousands_of_characters_are_not_shown_whole(text: str, message: str) -> None:
    with pytest.raises(SkinError, match=message) as error:
        ohm.Skin.parse(text)
    assert len(str(error.value)) < 400


def test_what_errors_and_devices_say_cannot_steer_a_terminal() -> None:
    assert str(DeviceLost("a\x1b[31mred\x9b\nnext\ttab")) == "a\\x1b[31mred\\x9b\nnext\ttab"
    assert isinstance(DeviceLost("gone"), ConnectionError)
    assert Capabilities("a\x1b]0;b\x07\u202e", 16, 100, 1000).name == "a?]0;b??"
    assert str(DeviceLost("\u202eback")) == "\\u202eback"
    with pytest.raises(ProtocolError, match=r"settle_time is 1e.09 s; it must be at most 1e.06 s"):
        Capabilities("a", 16, 100, 1000, settle_time=1e9)


@pytest.mark.parametrize("name", ["x" * 300, "x\0", "pipe"])
def test_names_that_no_file_has_and_pipes_are_refused(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")  # whoever opens it waits for ever
    for use in (
        ohm.Skin.load,
        lambda path: ohm.Skin.load(f"{path}.toml"),
        lambda path: ohm.Skin.parse(f"[sheet]\nshape = 'mesh'\nfile = {json.dumps(path)}", folder=tmp_path),
        ohm.read_recording,
        ohm.read_mesh,
        ohm.read_model,
        RecordingReader,
        recover,
        lambda path: Recorder(path, ohm.Skin()).tee(Bench()),
    ):
        with pytest.raises(OhmskinError):
            use(name)


def test_a_table_whose_name_leaves_no_room_for_that_of_a_pattern_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name = "x" * 240 + "_55uA_.csv"
    Path(name).write_text("\n".join("1,0,1.1,0" for _ in range(208)))
    assert ohm.read_recording(name).frames[0].pattern.n_meas == 208


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '[electrode]\nlayout = "rim"\ncount = 256\n[imaging]\nmesh_size = 1e-3',
            "the electrodes make 32640 pairs, .* about 22.. GiB",
        ),
        ("[sheet]\nwidth = 10\nheight = 0.001\n[electrode]\nrows = 2", "3637 nodes on its rim, .* takes about 13 s"),
    ],
)
def test_skins_that_cost_too_much_are_refused_with_the_figure(text: str, message: str) -> None:
    skin = ohm.Skin.parse(text)
    with pytest.raises(SkinError, match=message):
        skin.transfer_model()


def test_a_layer_of_too_many_patches_is_refused_with_the_time_it_would_take() -> None:
    with pytest.raises(SkinError, match="65536 patches takes the virtual skin about 66 s to set up; allowed are 16384"):
        ohm.VirtualSkin(ohm.Skin.parse("[contact_layer]\ncolumns = 256\nrows = 256\npatch = 0.0007"))


def test_patches_that_cover_most_of_the_mesh_are_refused() -> None:
    with pytest.raises(SkinError, match=r"a patch of the contact layer covers 101\d\d nodes .*; allowed are 2000"):
        ohm.VirtualSkin(ohm.Skin.parse("[contact_layer]\npatch = 0.15\n[imaging]\nmesh_size = 2.425e-3"))


def test_a_title_is_text_and_no_formula(tmp_path: Path) -> None:
    image = ohm.GaussNewton(model(), 1e-5).reconstruct(touch())
    save_picture(tmp_path / "a.png", model().mesh, image.values, GRID, [], "$x^{$ \\frac")
    assert (tmp_path / "a.png").stat().st_size > 1000


def test_gains_that_are_nearly_nothing_make_clipped_voltages_without_a_warning() -> None:
    imported = from_list(np.array([[0, 1, 2, 3]]), np.array([1e-3]), False, gains=np.array([1e-300]))
    assert np.isinf(imported.frame(np.array([1e30]), "the test").voltages).all()
