"""Data quality: a network's data obey reciprocity, disconnected electrodes are named, images are never silently
wrong."""

import csv
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ohmskin.drive import complete_pattern
from ohmskin.errors import DataError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Disc, Electrodes, Rectangle, mesh_domain
from ohmskin.importers import Recording, read_recording
from ohmskin.inverse import GaussNewton, match_model
from ohmskin.scan import (
    Baseline,
    Difference,
    DrivePattern,
    Frame,
    NetworkFit,
    Quality,
    Verdict,
    adjacent,
    assess,
    left_out,
    measure_others,
    opposite,
    reciprocity_residuals,
)
from ohmskin.sensing import RECORDED, SkinModel, drive_of, mode_named, perceive
from ohmskin.skin import Skin, VirtualSkin

NOISE = 2e-4
PATTERN = adjacent([range(16)])


@pytest.fixture(scope="module")
def model() -> TransferModel:
    disc = Disc(0.1)
    electrodes = Electrodes.rim(disc, 16)
    return TransferModel(mesh_domain(disc, 0.012, electrodes.positions), electrodes, 2e-3)


@pytest.fixture(scope="module")
def paper() -> Skin:
    return Skin.load("paper")


@pytest.fixture(scope="module")
def paper_model(paper: Skin) -> TransferModel:
    return paper.transfer_model()


@pytest.fixture(scope="module")
def virtual(paper: Skin) -> VirtualSkin:
    return VirtualSkin(paper, 4)


def press(virtual: VirtualSkin, x: float = 0.06, y: float = 0.13, pressure: float = 20e3) -> None:
    virtual.press(1, x, y, 8e-3, pressure)


def quiet_frames(model: TransferModel, count: int = 10, pattern: DrivePattern = PATTERN, seed: int = 0) -> list[Frame]:
    random, clean = np.random.default_rng(seed), model.voltages(pattern, 1e-3)
    currents = np.full(pattern.n_inj, 1e-3)
    return [Frame(pattern, clean + random.normal(0, NOISE, len(clean)), currents, float(k)) for k in range(count)]


def disconnect(frame: Frame, electrodes: Sequence[int], level: float, random: np.random.Generator) -> Frame:
    """Every value in which one of `electrodes` takes part becomes noise of `level` volts."""
    used = np.isin(frame.pattern.quadruples, electrodes).any(axis=1)
    return replace(frame, voltages=np.where(used, random.normal(0, level, len(used)), frame.voltages))


def without(electrodes: Sequence[int]) -> Quality:
    """What an all-knowing judge would say."""
    verdicts = tuple(Verdict(e, "open", 0.0, "") for e in electrodes)
    return Quality(16, verdicts, 0.0, 0.0, 1.0, np.ones(16), 1, 0, 0)


def contacts(
    skin: Skin, model: TransferModel, quiet: Sequence[Frame], frame: Frame, quality: Quality | None
) -> list[np.ndarray]:
    seen = perceive(SkinModel(skin, model, quiet, quality), frame)
    return [np.array([*c.position, c.strength]) for c in seen.detections]


# --- reciprocity in the wide sense ------------------------------------------------------------------------------------


def test_any_conductivity_makes_a_network(model: TransferModel) -> None:
    sigma = np.random.default_rng(1).uniform(0.1, 10, model.mesh.n_elem)
    uneven = TransferModel(model.mesh, model.electrodes, sigma)
    for pattern in (PATTERN, measure_others([(0, 5), (3, 9), (9, 14), (0, 9), (14, 2)], range(16))):
        volts = uneven.voltages(pattern, 1e-3)
        residuals = reciprocity_residuals(pattern, np.full(pattern.n_inj, 1e-3), volts)
        assert np.abs(residuals).max() < 1e-9 * np.abs(volts).max()


def test_residuals_of_adjacent_data_are_half_the_reciprocal_differences() -> None:
    volts = np.random.default_rng(2).normal(size=PATTERN.n_meas)
    residuals = reciprocity_residuals(PATTERN, np.ones(16), volts)
    place = {tuple(q): k for k, q in enumerate(PATTERN.quadruples.tolist())}
    for (a, b, c, d), k in place.items():
        partner = place[c, d, a, b]
        assert residuals[k] == pytest.approx((volts[k] - volts[partner]) / 2, abs=1e-10)


def test_the_error_is_the_noise_put_in(model: TransferModel) -> None:
    (frame,) = quiet_frames(model, 1)
    fit = NetworkFit(PATTERN, frame.currents[PATTERN.measurements[:, 0]], frame.voltages)
    misfit = fit.misfit(fit.known)
    assert misfit.freedom == 104  # half of 208 adjacent measurements are repeats of the other half
    assert misfit.rms == pytest.approx(NOISE, rel=0.2)
    exact = (fit.residuals(fit.known) ** 2).sum()
    assert misfit.squares == pytest.approx(exact, rel=1e-6)


def test_data_that_measure_nothing_twice_say_nothing_of_their_error() -> None:
    once = DrivePattern(np.array([[0, 1]]), np.array([[0, 2, 3], [0, 3, 4]]))
    fit = NetworkFit(once, np.ones(2), np.array([0.1, 0.2]))
    misfit = fit.misfit(fit.known)
    assert misfit.freedom == 0
    assert np.isnan(misfit.rms)


def test_noise_is_told_from_repeats_and_from_reciprocity(model: TransferModel) -> None:
    quality = assess(quiet_frames(model))
    assert quality.noise == pytest.approx(NOISE, rel=0.1)
    assert quality.reciprocity == pytest.approx(NOISE / np.sqrt(10), rel=0.3)  # of the mean of ten frames
    assert (quality.bad, quality.verdicts) == ((), ())
    assert "all 16 electrodes in order" in quality.report()[0]


def test_a_pattern_without_repeats_says_so(model: TransferModel) -> None:
    pattern = measure_others([(0, 8)], range(16))
    quality = assess(quiet_frames(model, 1, pattern))
    assert np.isnan(quality.reciprocity)
    assert "reciprocity unknown" in quality.report()[0]
    with pytest.raises(DataError, match="no quiet frames"):
        assess([])


# --- electrodes that are not in order ---------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["12B", "16I"])
def test_an_intact_skin_gets_no_verdict(paper: Skin, virtual: VirtualSkin, mode: str) -> None:
    pattern = drive_of(mode_named(paper, mode), paper).patterns[0]
    for _ in range(2):
        press(virtual, pressure=0)
        quiet = [virtual.scan(pattern) for _ in range(8)]
        press(virtual)
        assert assess(quiet, [virtual.scan(pattern) for _ in range(3)]).verdicts == ()
        assert assess(quiet[:1], [virtual.scan(pattern)]).verdicts == ()


@pytest.mark.parametrize("level", [1e-3, 0.02, 0.3, 3.0])
@pytest.mark.parametrize("electrodes", [(2, 9), (5, 6), (3, 5), (0, 15)])
def test_two_disconnected_electrodes_are_named_and_no_other(
    paper: Skin, virtual: VirtualSkin, electrodes: tuple[int, int], level: float
) -> None:
    random = np.random.default_rng(3)
    pattern = adjacent(paper.electrodes.rings)
    press(virtual, pressure=0)
    quiet = [virtual.scan(pattern) for _ in range(3)]
    press(virtual)
    touched = virtual.scan(pattern)
    signal = level * float(np.sqrt(np.mean(quiet[0].voltages ** 2)))
    spoilt = [disconnect(frame, electrodes, signal, random) for frame in [*quiet, touched]]
    quality = assess(spoilt[:-1], spoilt[-1:])
    assert quality.bad == tuple(sorted(electrodes))
    assert all("left out" in verdict.words for verdict in quality.verdicts)
    # and where the wires came off after calibration
    assert assess(quiet, spoilt[-1:]).bad == tuple(sorted(electrodes))


def test_localisation_with_two_disconnected_is_that_of_the_same_two_left_out(
    paper: Skin, paper_model: TransferModel, virtual: VirtualSkin
) -> None:
    random, pattern = np.random.default_rng(5), adjacent(paper.electrodes.rings)
    errors, blind = [], []
    for _ in range(4):
        press(virtual, pressure=0)
        quiet = [virtual.scan(pattern) for _ in range(8)]
        place = random.uniform(0.04, 0.16, 2)
        press(virtual, *place)
        touched = virtual.scan(pattern)
        electrodes = sorted(random.choice(16, 2, replace=False).tolist())
        level = float(10 ** random.uniform(-3, 0))
        spoilt = [disconnect(frame, electrodes, level, random) for frame in [*quiet, touched]]
        quality = assess(spoilt[:-1], spoilt[-1:])
        assert list(quality.bad) == electrodes
        found = [
            contacts(paper, paper_model, quiet, touched, without(electrodes)),
            contacts(paper, paper_model, spoilt[:-1], spoilt[-1], quality),
            contacts(paper, paper_model, spoilt[:-1], spoilt[-1], None),
        ]
        distance = [min((float(np.linalg.norm(c[:2] - place)) for c in those), default=0.1) for those in found]
        errors.append(distance[:2])
        blind.append(distance[2])
    intact, disconnected = np.mean(errors, axis=0)
    assert intact < 8e-3
    assert disconnected <= 1.5 * intact
    assert np.mean(blind) > 5 * disconnected  # without the assessment the image is worthless


def real_cases(folder: Path) -> list[tuple[Recording, list[tuple[float, np.ndarray]]]]:
    with (folder / "targets.csv").open() as file:
        targets = list(csv.DictReader(file))
    cases = []
    for case in ("1_1", "1_2", "2_1", "3_1"):
        rows = [row for row in targets if row["case"] == case]
        places = [
            (1.0 if row["type"] == "conductive" else -1.0, 1e-3 * np.array([float(row["x_mm"]), float(row["y_mm"])]))
            for row in rows
        ]
        cases.append((read_recording(folder / f"datamat_{case}.mat"), places))
    return cases


def test_two_disconnected_in_real_recordings(uef_folder: Path) -> None:
    skin = Skin.load("uef2017")
    model, random, errors = skin.transfer_model(), np.random.default_rng(6), []
    for recording, places in real_cases(uef_folder):
        electrodes = sorted(random.choice(16, 2, replace=False).tolist())
        level = float(10 ** random.uniform(-4, -0.5))
        quiet = [disconnect(frame, electrodes, level, random) for frame in recording.quiet]
        frame = disconnect(recording.frames[0], electrodes, level, random)
        quality = assess(quiet, [frame])
        assert list(quality.bad) == electrodes
        intact = contacts(skin, model, recording.quiet, recording.frames[0], without(electrodes))
        spoilt = contacts(skin, model, quiet, frame, quality)
        for sign, place in places:
            errors.append([
                min((float(np.linalg.norm(c[:2] - place)) for c in those if c[2] * sign > 0), default=0.14)
                for those in (intact, spoilt)
            ])  # fmt: skip
    intact_error, spoilt_error = np.mean(errors, axis=0)
    assert intact_error < 15e-3
    assert spoilt_error <= 1.5 * intact_error


def test_tank_recordings_are_in_order_and_the_weakest_gets_a_warning(tank_folder: Path) -> None:
    """The 20 uA file obeys reciprocity as well as the others; what sets it apart is an offset of 60 % of its signal."""
    skin = Skin.load("tank")
    model = skin.transfer_model()
    for file in sorted(tank_folder.glob("*/*.csv")):
        recording = read_recording(file)
        quality = assess(recording.quiet, recording.frames)
        assert quality.bad == ()
        assert 0.005 < quality.reciprocity / quality.signal < 0.03
        match = match_model(model, recording.quiet[0])
        assert match.misfit < 0.07  # the shape, the order and the direction of the electrodes are right
        weak = "20uA" in file.name
        assert (abs(match.offset) > 0.5 * match.signal) == weak
        assert "added to every voltage" in match.report()[0]
        random = np.random.default_rng(7)
        level = 0.05 * quality.signal
        spoilt = [disconnect(frame, [4, 11], level, random) for frame in (recording.quiet[0], recording.frames[0])]
        assert assess(spoilt[:1], spoilt[1:]).bad == (4, 11)


def test_a_wrong_skin_is_noticed(tank_folder: Path) -> None:
    (file,) = (tank_folder / "electrode01_metal").glob("*.csv")
    frame = read_recording(file).quiet[0]
    swapped = Skin.load("tank").electrodes.positions[[0, 5, 2, 3, 4, 1, *range(6, 16)]]
    mesh = Skin.load("tank").mesh()
    match = match_model(TransferModel(mesh, Electrodes.at(swapped), 2e-3), frame)
    assert any("electrodes' order" in warning for warning in match.report())


def test_contacts_of_data_that_are_of_another_skin_are_not_believed(tank_folder: Path) -> None:
    tank = Skin.load("tank")
    places = tank.electrodes.positions
    for folder in ("electrode01_metal", "electrode01_metal_electrode05_plastic"):
        (file,) = (tank_folder / folder).glob("*.csv")
        recording = read_recording(file)
        for order in (range(16), [0, 1, 2, 4, 3, *range(5, 16)], [0, 5, 2, 3, 4, 1, *range(6, 16)]):
            model = TransferModel(tank.mesh(), Electrodes.at(places[list(order)]), 2e-3)
            known = SkinModel(tank, model, recording.quiet)
            seen = perceive(known, recording.frames[0]).detections
            assert seen
            assert all((one.confidence > 0.9) == (order == range(16)) for one in seen)
            assert order == range(16) or max(one.confidence for one in seen) < 0.5


@pytest.mark.parametrize("reader", ["centroid", "consensus"])
@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_contacts_of_a_tank_that_only_warms_up_are_not_believed(factor: float, reader: str) -> None:
    """Of those of the image alone; a fit agrees on none."""
    skin = Skin.load("uef2017")
    model, random = skin.transfer_model(), np.random.default_rng(0)
    warm, beside = [], []
    for pattern in (adjacent([range(16)]), opposite(range(16))):
        rest, currents = model.voltages(pattern), np.ones(pattern.n_inj)
        noise = 0.1 * abs(factor - 1) * np.sqrt(np.mean(rest**2))
        near = ((model.mesh.centroids - [0.0, 0.06]) ** 2).sum(axis=1) < 0.02**2
        sheet = TransferModel(model.mesh, skin.discs, model.conductivity * np.where(near, 10.0, 1.0))
        for found, volts in ((warm, factor * rest), (beside, sheet.voltages(pattern))):
            size = noise if found is warm else 0.01 * np.sqrt(np.mean((volts - rest) ** 2))
            quiet, frame = (
                [Frame(pattern, one + size * random.standard_normal(len(rest)), currents) for one in some]
                for some in ([rest] * 10, [volts])
            )
            known = SkinModel(skin, model, quiet)
            seen = perceive(known, frame[0], replace(RECORDED, reader=reader))
            found += [one.confidence for one in seen.detections]
    assert bool(warm) == (reader == "centroid")
    assert max(warm, default=0.0) < 0.05
    assert max(beside) > 0.95


def test_no_current_no_signal_and_a_short_are_told_apart(model: TransferModel) -> None:
    frames = quiet_frames(model)
    broken = [replace(f, currents=np.where((PATTERN.injections == 7).any(axis=1), 1e-7, f.currents)) for f in frames]
    quality = assess(broken)
    assert [(v.electrode, v.kind) for v in quality.verdicts] == [(7, "open")]
    assert "current" in quality.verdicts[0].words
    # electrodes 4 and 5 bridged: what one terminal does, the other does
    s = model.transfer_resistance.copy()
    s[5], s[:, 5] = s[4], s[:, 4].copy()
    s[5, 5] = s[4, 4]
    a, b, c, d = PATTERN.quadruples.T
    random = np.random.default_rng(8)
    volts = 1e-3 * (s[a, c] - s[a, d] - s[b, c] + s[b, d])
    shorted = assess([replace(f, voltages=volts + random.normal(0, NOISE, len(volts))) for f in frames])
    assert [(v.electrode, v.kind) for v in shorted.verdicts] == [(4, "shorted"), (5, "shorted")]
    assert "electrode 5" in shorted.verdicts[0].words


def test_an_electrode_far_from_all_that_a_part_of_a_scan_drives_is_not_open() -> None:
    """A device that takes few injections at once scans all pairs in parts."""
    sheet = Rectangle(0.2, 0.2)
    electrodes = Electrodes.grid(sheet, 5, 5)
    model = TransferModel(mesh_domain(sheet, 0.01, electrodes.positions), electrodes, 2e-3)
    parts = list(complete_pattern(electrodes).with_driven.split(30))
    scans = [model.simulate(part, noise=1e-6, count=2, seed=k) for k, part in enumerate(parts)]
    assert any(assess(scan).bad for scan in scans)  # one part alone cannot tell
    assert not assess([frame for scan in scans for frame in scan]).verdicts


def test_noisy_and_drifting_electrodes_count_less(model: TransferModel) -> None:
    frames, random = quiet_frames(model, 12), np.random.default_rng(9)
    uses = (PATTERN.quadruples == 6).any(axis=1)
    noisy = [replace(f, voltages=f.voltages + uses * random.normal(0, 12 * NOISE, len(uses))) for f in frames]
    quality = assess(noisy)
    assert [(v.electrode, v.kind) for v in quality.verdicts] == [(6, "noisy")]
    assert quality.weights[6] == pytest.approx(1 / 12, rel=0.3)
    slopes = uses * random.normal(0, 4 * NOISE, len(uses))
    drifting = assess([replace(f, voltages=f.voltages + slopes * k) for k, f in enumerate(frames)])
    assert [(v.electrode, v.kind) for v in drifting.verdicts] == [(6, "drifting")]
    assert 0 < drifting.weights[6] < 0.2


def test_weights_are_those_of_weighted_least_squares(model: TransferModel) -> None:
    """Scaling current and voltage together equals dividing residuals by their own standard deviations."""
    frames = quiet_frames(model, 3)
    quality = replace(without([]), verdicts=(Verdict(6, "noisy", 0.25, ""), Verdict(2, "open", 0.0, "")))
    difference = quality.weigh(Baseline.learn(frames[:2]).difference(frames[2]))
    uses_2, uses_6 = ((PATTERN.quadruples == e).any(axis=1) for e in (2, 6))
    plain = Baseline.learn(frames[:2]).difference(frames[2])
    assert np.isnan(difference.volts[uses_2]).all()
    doubtful = uses_6 & ~uses_2
    np.testing.assert_allclose(difference.volts[doubtful], plain.volts[doubtful] / 4)
    np.testing.assert_allclose(difference.currents[doubtful], plain.currents[doubtful] / 4)
    rest = ~uses_2 & ~uses_6
    np.testing.assert_array_equal(difference.volts[rest], plain.volts[rest])
    assert np.isfinite(GaussNewton(model, NOISE).reconstruct(difference).values).all()


# --- missing and clipped values ---------------------------------------------------------------------------------------


def test_missing_and_clipped_values_are_counted_named_and_left_out(model: TransferModel) -> None:
    frames = quiet_frames(model, 4)
    uses = (PATTERN.quadruples == 3).any(axis=1)
    hurt = [replace(f, voltages=np.where(uses, np.inf, f.voltages)) for f in frames]
    holes = replace(
        hurt[-1], voltages=np.where(np.arange(len(uses)) == np.flatnonzero(~uses)[0], np.nan, hurt[-1].voltages)
    )
    quality = assess(hurt[:-1], [holes])
    assert [(v.electrode, v.kind) for v in quality.verdicts] == [(3, "clipped")]
    assert (quality.missing, quality.clipped) == (1, 4 * int(uses.sum()))
    assert any("1 values missing" in line for line in quality.report())
    difference = Baseline.learn(hurt[:-1]).difference(holes)
    words = left_out(difference)
    assert words.startswith(f"{uses.sum() + 1} of 208")
    assert words.endswith("electrode 3")
    assert left_out(Baseline.learn(frames[:-1]).difference(frames[-1])) == ""
    image = GaussNewton(model, NOISE).reconstruct(difference)
    # the same as if these measurements had never been in the pattern
    kept = np.isfinite(difference.volts)
    shorter = DrivePattern(PATTERN.injections, PATTERN.measurements[kept])
    smaller = Difference(shorter, difference.currents[kept], difference.volts[kept])
    np.testing.assert_allclose(
        image.values, GaussNewton(model, NOISE).reconstruct(smaller).values, rtol=1e-6, atol=1e-12
    )


def test_perception_sees_with_electrodes_missing_since_calibration(
    paper: Skin, paper_model: TransferModel, virtual: VirtualSkin
) -> None:
    pattern = adjacent(paper.electrodes.rings)
    press(virtual, pressure=0)
    gone = (pattern.quadruples == 3).any(axis=1)
    lose: Callable[[Frame], Frame] = lambda f: replace(f, voltages=np.where(gone, np.nan, f.voltages))  # noqa: E731
    quiet = [lose(virtual.scan(pattern)) for _ in range(4)]
    press(virtual)
    found = contacts(paper, paper_model, quiet, lose(virtual.scan(pattern)), None)
    assert np.linalg.norm(found[0][:2] - [0.06, 0.13]) < 8e-3
    with pytest.raises(DataError, match="cannot be estimated"):
        contacts(paper, paper_model, [replace(f, voltages=np.full(len(gone), np.nan)) for f in quiet], quiet[0], None)


def test_a_few_measurements_of_electrodes_with_high_numbers_take_no_memory() -> None:
    quads = np.array([[0, 1000, 500, 700], [500, 700, 0, 1000], [0, 700, 500, 1000], [500, 1000, 0, 700]])
    pattern = DrivePattern(quads[:, :2], np.column_stack([np.arange(4), quads[:, 2:]]))
    volts = np.array([1.0, 1.0, 2.0, 2.0])
    quiet = [Frame(pattern, volts * (1 + 1e-6 * k), np.ones(4)) for k in range(3)]  # 500,500 pairs squared are 2 TB
    assert assess(quiet).n_elec == 1001


def test_data_too_large_to_judge_are_refused_with_the_figure() -> None:
    pattern = measure_others([(k, (k + 1) % 160) for k in range(0, 160, 2)], range(160))
    frame = Frame(pattern, np.ones(pattern.n_meas), np.ones(pattern.n_inj))
    with pytest.raises(DataError, match=r"take 1\.\d GiB to judge; allowed are 0.5: measure with fewer"):
        assess([frame])


@pytest.mark.parametrize("volts", [1e300, -1.7e308])
def test_voltages_that_no_instrument_measures_count_as_clipped(volts: float) -> None:
    frame = Frame(PATTERN, np.full(PATTERN.n_meas, volts), np.ones(PATTERN.n_inj))
    np.testing.assert_array_equal(frame.voltages, np.copysign(np.inf, volts))
    assert assess([frame] * 3).clipped == 3 * PATTERN.n_meas
